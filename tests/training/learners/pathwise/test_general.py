"""Policies for any aircraft: what is learned, what is specialized and what flies are one network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.told import told, told_model
from neuroflight.toolchain.ir.interpreter import advance, clear_state
from neuroflight.toolchain.policy.freeze import to_onnx
from neuroflight.toolchain.policy.model import parse_policy
from neuroflight.toolchain.policy.specialize import REFERENCE, features, specialize
from neuroflight.training.config.any_aircraft import draw_aircraft
from neuroflight.training.config.pathwise_config import PathwiseConfig
from neuroflight.training.config.training_config import TrainingConfig, WorldConfig
from neuroflight.training.learners.pathwise.batch import draw_batch
from neuroflight.training.learners.pathwise.learner import PathwiseLearner
from neuroflight.training.tasks.random_steps import RandomStepsTask
from tests.training.learners.pathwise.reference import Network

NF1 = load_aircraft("nf1")
CONFIG = TrainingConfig(
    steps=10**6,
    observation="rate_error,rate,rate~15Hz,previous_motors,rotor_estimate,throttle,rate_estimate",
    hidden=(6, 5),
    recurrent="gru",
    idle=0.05,
    mix="centred",
    task=RandomStepsTask(length_s=0.1),
    world=WorldConfig(aircraft="any", throttle_max=0.6),
    algorithm=PathwiseConfig(aircraft=32, change_of="motors", gradient_max=1e6),
)


def learner() -> PathwiseLearner:
    """A learner whose every feature has weights."""
    assert isinstance(CONFIG.algorithm, PathwiseConfig)
    made = PathwiseLearner(NF1, CONFIG, CONFIG.algorithm)
    rng = np.random.default_rng(1)
    parameters = made._state.parameters + rng.normal(0.0, 0.05, len(made._state.parameters))
    made._state = replace(made._state, parameters=parameters.astype(np.float32))
    return made


def test_a_specialized_policy_is_the_network_that_was_trained() -> None:
    made, rng = learner(), np.random.default_rng(2)
    general = to_onnx(CONFIG.document(NF1), made.policy())
    assert parse_policy(general).general
    for _ in range(3):
        aircraft = draw_aircraft(NF1, rng)
        model = told_model(aircraft, CONFIG.blocks(), CONFIG.control_rate_hz)
        policy = parse_policy(specialize(general, told(aircraft), "mine", "0" * 64, model))
        assert not policy.general and policy.model == model and policy.aircraft == "mine"
        assert made._general is not None
        trained = Network(made._shape, made._general.network(made._state.parameters, told(aircraft)))
        scale = np.array(CONFIG.observation_scale(4), np.float32)
        state = clear_state(policy.network, 2)
        for _ in range(5):
            seen = rng.normal(0.0, 2.0, (2, len(scale))).astype(np.float32)
            seen[:, 13:17] *= 300.0
            found, state = advance(policy.network, seen, state, exact=False)
            wanted = np.clip(trained(seen * scale), 0.0, 1.0)
            assert found == pytest.approx(wanted, abs=2e-5)
    made.close()


def test_a_run_that_starts_from_it_begins_with_the_aircrafts_own_network() -> None:
    general, aircraft = learner(), draw_aircraft(NF1, np.random.default_rng(5))
    config = replace(CONFIG, world=replace(CONFIG.world, aircraft="file"))
    assert isinstance(config.algorithm, PathwiseConfig) and general._general is not None
    made = PathwiseLearner(aircraft, config, config.algorithm)
    made.start_from(general.policy(), general.state())
    wanted = general._general.network(general._state.parameters, told(aircraft))
    assert made._basis.network(made._state.parameters) == pytest.approx(wanted, abs=2e-5)
    general.close()
    made.close()


def test_the_gradient_is_the_slope_of_what_is_learned() -> None:
    made = learner()
    assert isinstance(CONFIG.algorithm, PathwiseConfig)
    batch = draw_batch(CONFIG, CONFIG.algorithm, NF1, np.random.default_rng(3))
    _, found = made._gradient(batch)
    length = float(np.linalg.norm(found))
    start, losses = made._state.parameters, []
    for way in (1.0, -1.0):
        moved = start + np.float32(way * 2e-3) * found / np.float32(length)
        made._state = replace(made._state, parameters=moved.astype(np.float32))
        figures, _ = made._gradient(batch)
        losses.append(figures.loss(made._state.weights))
    made.close()
    assert (losses[0] - losses[1]) / 4e-3 == pytest.approx(length, rel=0.05)


def test_aircraft_are_drawn_from_whoops_to_lifters_and_none_is_like_the_next() -> None:
    rng = np.random.default_rng(4)
    drawn = [draw_aircraft(NF1, rng) for _ in range(300)]
    known = [told(aircraft) for aircraft in drawn]
    mass = np.array([aircraft.mass_properties.mass for aircraft in drawn])
    assert mass.min() < 0.05 and mass.max() > 3.0
    for axis in range(3):
        authority = np.array([each.authority[axis] for each in known])
        assert authority.max() / authority.min() > 25.0
    rise = np.array([each.rise_s for each in known])
    assert rise.min() < 0.010 and rise.max() > 0.085
    assert np.corrcoef(np.log(mass), np.log(rise))[0, 1] > 0.4
    seen = np.array([features(each) for each in known])
    assert np.abs(seen[:, 1:10]).mean() < 1.0
    assert np.linalg.matrix_rank(seen) == seen.shape[1]
    assert features(REFERENCE).tolist() == [1.0] + [0.0] * (seen.shape[1] - 1)
