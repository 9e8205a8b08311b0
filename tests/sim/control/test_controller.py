"""A policy as a controller in Python, and the rotor speed and attitude that it may observe."""

from __future__ import annotations

import numpy as np
import pytest

from sim.aircraft.model import load_aircraft
from sim.control.controller import PolicyController
from toolchain.contract import observation_blocks
from toolchain.ir.network import chain
from toolchain.ir.operations import Clip, Linear
from toolchain.policy.model import PolicyModel
from training.evaluation.evaluation import record
from training.tasks.task import PulseTask

ZERO, NO_THRUST = np.zeros((2, 3), np.float32), np.zeros(2, np.float32)


def showing(observation: str, columns: list[int]) -> PolicyModel:
    """A policy whose four actions are these columns of its observation, within 0..1."""
    terms = observation_blocks(observation)
    width = sum(term.count(4) for term in terms)
    weight = np.zeros((4, width), np.float32)
    weight[range(4), columns] = 1.0
    return PolicyModel(
        blocks=terms,
        control_rate_hz=1000,
        filters=(),
        aircraft="nf1",
        aircraft_sha256="0" * 64,
        training={},
        source_sha256="0" * 64,
        network=chain(width, [Linear(weight, np.zeros(4, np.float32)), Clip(0.0, 1.0)]),
    )


def test_rotor_speed_and_gravity_are_those_it_was_given_when_it_observes_them() -> None:
    controller = PolicyController(showing("rotor_speed,gravity", [0, 3, 5, 6]), 2)
    assert controller.senses
    speed = np.array([[0.25, 0, 0, 0.5], [0.125, 0, 0, 0.75]])
    upside_down = np.diag([1.0, -1.0, -1.0])
    on_its_left = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # its y axis points down
    controller.sense(speed, np.array([upside_down, on_its_left]))
    shown = controller.step(ZERO, ZERO, NO_THRUST)
    assert shown.tolist() == [[0.25, 0.5, 0, 1], [0.125, 0.75, 1, 0]]


def test_a_step_is_refused_when_it_was_not_given_what_it_observes() -> None:
    controller = PolicyController(showing("rotor_speed,gravity", [0, 3, 4, 6]), 2)
    with pytest.raises(ValueError, match="observe needs rotor_speed, got none"):
        controller.step(ZERO, ZERO, NO_THRUST)
    assert not PolicyController(showing("rate,rate_error", [0, 1, 2, 3]), 2).senses


def test_an_evaluation_gives_the_twins_rotor_speed_when_the_policy_observes_it() -> None:
    policy = showing("rotor_speed", [0, 1, 2, 3])
    task = PulseTask(idle_s=0.01, command_s=0.01, rest_s=0.01)
    flights = record(
        PolicyController(policy, 2),
        load_aircraft("nf1"),
        task,
        episodes=2,
        seed=1,
        control_rate_hz=1000,
        idle=0.1,
    )
    assert (flights.output[:, 0] == 0).all()  # at rest
    assert (flights.output[:, -1] == 1).all()  # idling, so many rad/s
