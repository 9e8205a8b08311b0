"""A policy as a controller in Python, and the rotor speed and attitude that it may observe."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.controller import PolicyController
from neuroflight.sim.control.estimator import Estimator
from neuroflight.sim.control.motors import throttle_mix
from neuroflight.sim.control.observation import Observer
from neuroflight.toolchain.contract import Mix, observation_blocks
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.ir.network import chain
from neuroflight.toolchain.ir.operations import Clip, Linear
from neuroflight.toolchain.policy.model import PolicyModel, read_policy
from neuroflight.training.evaluation.evaluation import record
from neuroflight.training.tasks.task import PulseTask

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
    assert controller.senses == {"rotor_speed", "gravity"}
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


def test_an_estimating_policys_bits_are_the_same_alone_and_in_a_batch(estimating_policy: Path) -> None:
    policy, rng = read_policy(estimating_policy), np.random.default_rng(4)
    batch = PolicyController(policy, 5)
    alone = [PolicyController(policy, 1) for _ in range(5)]
    throttle = rng.random(5, np.float32)
    seen = []
    for _ in range(30):
        setpoint, gyro = rng.normal(size=(2, 5, 3)).astype(np.float32)
        together = batch.step(setpoint, gyro, throttle)
        apart = [
            one.step(setpoint[i : i + 1], gyro[i : i + 1], throttle[i : i + 1]) for i, one in enumerate(alone)
        ]
        assert np.concatenate(apart).tobytes() == together.tobytes()
        seen.append(together.copy())
    assert np.ptp(seen, axis=0).min() > 0.0  # it answers what it sees


def test_an_estimating_policy_observes_its_own_mixed_commands(estimating_policy: Path) -> None:
    policy, rng = read_policy(estimating_policy), np.random.default_rng(6)
    assert policy.mix is Mix.CENTRED
    controller = PolicyController(policy, 1)
    observer = Observer(policy.blocks, 1, 4, 1000, model=policy.model, idle=policy.idle)
    action, throttle = np.zeros((1, 4), np.float32), np.full(1, 0.4, np.float32)
    for _ in range(50):
        setpoint, gyro = rng.normal(size=(2, 1, 3)).astype(np.float32)
        action = evaluate(policy.network, observer.observe(slice(None), setpoint, gyro, action, throttle))
        observer.commanded(slice(None), throttle_mix(action, throttle, Mix.CENTRED), throttle)
        assert np.abs(controller.step(setpoint, gyro, throttle) - action).max() < 1e-5


def test_an_estimating_policy_begins_anew_when_reset(estimating_policy: Path) -> None:
    controller = PolicyController(read_policy(estimating_policy), 2)
    first = [controller.step(ZERO, ZERO + 1, NO_THRUST).copy() for _ in range(20)]
    controller.reset()
    again = [controller.step(ZERO, ZERO + 1, NO_THRUST).copy() for _ in range(20)]
    assert np.array_equal(first, again)


def test_a_policy_estimates_with_the_idle_that_it_flies_with(estimating_policy: Path) -> None:
    shipped = read_policy(estimating_policy)
    assert shipped.model is not None
    # Its actions are thousandths of how far its rotors are below rest.
    thousandth = np.diag(np.full(4, -1e-3, np.float32))
    below = chain(4, [Linear(thousandth, np.zeros(4, np.float32)), Clip(0.0, 1.0)])
    policy = replace(showing("rotor_estimate", [0, 1, 2, 3]), model=shipped.model, idle=0.055, network=below)
    begun = []
    for idle in (None, 0.2):
        controller = PolicyController(policy, 1, idle=idle)
        estimator = Estimator(shipped.model, 1, 0.055 if idle is None else idle)
        for _ in range(3):
            action = controller.step(ZERO[:1], ZERO[:1], NO_THRUST[:1])
            estimator.observe(slice(None), None, ZERO[:1])
            rotor = estimator.rotor_estimate(slice(None), NO_THRUST[:1])
            assert action == pytest.approx(np.clip(rotor / -1000, 0, 1), abs=1e-6)
            estimator.command(slice(None), throttle_mix(action, NO_THRUST[:1]))
        begun.append(float(action.min()))
    assert begun[0] + 0.1 < begun[1]
