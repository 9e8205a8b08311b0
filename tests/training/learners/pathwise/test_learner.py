"""The pathwise learner: repeatable, resumable, and it learns; errors of unsupported configurations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.controller import PolicyController
from neuroflight.sim.control.motors import throttle_mix
from neuroflight.sim.control.observation import Observer
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.policy.freeze import to_onnx
from neuroflight.toolchain.policy.model import parse_policy
from neuroflight.training.config.pathwise_config import PathwiseConfig
from neuroflight.training.config.randomization import Randomization
from neuroflight.training.config.training_config import TrainingConfig, WorldConfig
from neuroflight.training.learners.pathwise.descent import (
    DIVERGED,
    SETBACKS_MAX,
    SETTLED,
    State,
    adapted,
    descended,
    guarded,
)
from neuroflight.training.learners.pathwise.loss import LossFigures, Weights
from neuroflight.training.learners.protocol import Report
from neuroflight.training.runs.checkpoint import snapshot
from neuroflight.training.runs.make_learner import make_learner
from neuroflight.training.tasks.random_steps import RandomStepsTask
from tests.training.learners.pathwise.cases import EVERY_BLOCK as WITH_ROTORS
from tests.training.learners.pathwise.reference import Network

EVERY_BLOCK = WITH_ROTORS.replace("rotor_speed,", "")  # that the firmware has
UPDATE = 4 * 150  # control steps of an update of `config`


def config(**changes: Any) -> TrainingConfig:
    """A run so short that it learns next to nothing."""
    whole: dict[str, Any] = {
        "steps": 4 * UPDATE,
        "observation": "rate_error,rate_error_integral,rate~15Hz,rate_error_delta@1,previous_action",
        "hidden": (8,),
        "idle": 0.2,
        "task": RandomStepsTask(length_s=0.15),
        "world": WorldConfig(
            throttle_max=0.5, randomization=Randomization(inertia=(0.8, 1.2), delay_s=(0.0, 0.004))
        ),
        "algorithm": PathwiseConfig(aircraft=4, leg_steps=2 * UPDATE),
    }
    return TrainingConfig(**(whole | changes))


def unheard(report: Report) -> None:
    """Ignore the report."""


def equal(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)


def test_a_run_continues_as_if_it_had_never_stopped_when_restored_at_a_segment() -> None:
    aircraft = load_aircraft("nf1")
    whole = make_learner(aircraft, config())
    whole.learn(0, unheard)
    state, policy = whole.state(), whole.policy()
    whole.learn(1, unheard)
    resumed = make_learner(aircraft, config())
    resumed.restore(state)
    assert resumed.steps == 2 * UPDATE
    assert equal(resumed.policy(), policy)
    resumed.learn(1, unheard)
    assert whole.steps == resumed.steps == 4 * UPDATE
    assert equal(whole.policy(), resumed.policy())
    assert not equal(whole.policy(), policy)


def test_the_policy_differs_when_the_seed_differs() -> None:
    policies = []
    for seed in (1, 1, 2):
        model = make_learner(load_aircraft("nf1"), config(seed=seed))
        model.learn(0, unheard)
        policies.append(model.policy())
    assert equal(policies[0], policies[1])
    assert not equal(policies[0], policies[2])


def test_reports_have_steps_and_figures_when_updates_are_made() -> None:
    reports: list[Report] = []
    make_learner(load_aircraft("nf1"), config()).learn(0, reports.append)
    assert [report.steps for report in reports] == [UPDATE, 2 * UPDATE]
    assert reports[0].figures["train/mae_deg_s"] > 0.0
    assert reports[0].reward < 0.0


def test_the_loss_falls_when_a_policy_learns() -> None:
    updates = 40
    run = config(
        steps=updates * 8 * 300,
        observation="rate_error,rate,previous_action",
        task=RandomStepsTask(length_s=0.3),
        world=WorldConfig(),
        algorithm=PathwiseConfig(aircraft=8, leg_steps=updates * 8 * 300, warm_up=5, learning_rate=0.02),
    )
    errors: list[float] = []
    make_learner(load_aircraft("nf1"), run).learn(0, lambda r: errors.append(r.figures["train/mae_deg_s"]))
    assert np.mean(errors[-8:]) < 0.5 * np.mean(errors[:8])


@pytest.mark.parametrize("recurrent", ["none", "gru", "lstm"])
def test_the_frozen_policy_does_what_the_network_did_when_it_flew(recurrent: str) -> None:
    aircraft, run = load_aircraft("nf1"), config(recurrent=recurrent, hidden=(8, 6), observation=EVERY_BLOCK)
    model = make_learner(aircraft, run)
    model.learn(0, unheard)
    policy = parse_policy(to_onnx(run.document(aircraft), model.policy()))
    controller = PolicyController(policy, 1)
    observer = Observer(run.blocks(), 1, 4, 1000, model=policy.model, idle=policy.idle)
    shape = model._shape  # type: ignore[attr-defined]
    network = Network(shape, model._basis.network(model._state.parameters))  # type: ignore[attr-defined]
    scale = np.array(run.observation_scale(4), np.float32)
    rng, action, throttle = np.random.default_rng(0), np.zeros((1, 4), np.float32), np.zeros(1, np.float32)
    for _ in range(20):
        setpoint, gyro = rng.normal(0.0, 1.0, (2, 1, 3)).astype(np.float32)
        seen = observer.observe(slice(None), setpoint, gyro, action, throttle)
        action = np.clip(network(seen * scale), np.float32(0.0), np.float32(1.0))
        observer.commanded(slice(None), throttle_mix(action, throttle, policy.mix), throttle)
        assert controller.step(setpoint, gyro, throttle) == pytest.approx(action, abs=2e-5)


@pytest.mark.parametrize(
    ("world", "observation", "message"),
    [
        (WorldConfig(mount="free"), "rate_error", "mount 'free'"),
        (WorldConfig(gust_m_s=3.0), "rate_error", "calm air only"),
        (WorldConfig(), "rate_error,gravity", "does not follow the attitude"),
    ],
)
def test_a_run_is_rejected_when_it_has_no_pathwise_gradient(
    world: WorldConfig, observation: str, message: str
) -> None:
    with pytest.raises(TrainingError, match=message):
        make_learner(load_aircraft("nf1"), config(world=world, observation=observation))


def state(weights: Weights, figures: LossFigures | None = None) -> State:
    start = State.fresh(np.zeros(20, np.float32), weights)
    return replace(start, figures=figures)


def test_weights_rise_above_their_limits_and_fall_below_when_they_adapt() -> None:
    hyperparameters = PathwiseConfig(output_limit=0.1, change_limit=0.01, adaption=0.01)
    figures = LossFigures(mae=1.0, mse=1.0, output=0.2, change=0.001)
    weights = adapted(state(Weights(0.1, 5.0, 6.0)), figures, hyperparameters, adapting=True).weights
    assert weights.output == pytest.approx(5.0 * 1.01, rel=1e-3)
    assert weights.change == pytest.approx(6.0 / 1.01, rel=1e-3)
    assert weights.square == 0.1


def test_weights_stay_when_there_is_no_limit_or_it_is_too_early() -> None:
    figures = LossFigures(mae=1.0, mse=1.0, output=0.2, change=0.001)
    start = Weights(0.1, 5.0, 6.0)
    free = PathwiseConfig(output_limit=None, change_limit=None)
    assert adapted(state(start), figures, free, adapting=True).weights == start
    assert adapted(state(start), figures, PathwiseConfig(), adapting=False).weights == start


def test_the_first_step_is_the_learning_rate_along_each_weight_when_adam_begins() -> None:
    before = state(Weights(0.1, 5.0, 6.0))
    found = np.sign(np.random.default_rng(1).normal(size=20)).astype(np.float32)
    after = descended(before, found, 0.01, PathwiseConfig(gradient_max=0.5))
    assert before.parameters - after.parameters == pytest.approx(0.01 * found, rel=1e-3)


def test_nothing_moves_but_the_count_when_a_gradient_is_not_finite() -> None:
    before = state(Weights(0.1, 5.0, 6.0))
    after = descended(before, np.full(20, np.nan, np.float32), 0.01, PathwiseConfig())
    assert (after.updates, after.skipped) == (1, 1)
    assert after.parameters is before.parameters


def test_a_gradient_is_skipped_when_it_is_an_outlier_but_not_when_it_stays() -> None:
    one = np.ones(20, np.float32)
    hyperparameters = PathwiseConfig(outlier=5.0)
    usual = descended(state(Weights(0.1, 5.0, 6.0)), one, 0.01, hyperparameters)
    after = descended(usual, 8.0 * one, 0.01, hyperparameters)
    assert (usual.skipped, after.skipped) == (0, 1)
    assert after.parameters is usual.parameters
    assert after.mean is usual.mean
    for _ in range(5):
        after = descended(after, 8.0 * one, 0.01, hyperparameters)
    assert after.skipped == 3
    assert after.parameters is not usual.parameters


def told(before: State, error: float) -> State:
    """A state some updates later, with other parameters, after batches that all had this error."""
    after = replace(
        before,
        updates=before.updates + SETTLED,
        parameters=before.parameters + np.float32(1.0),
        mean=np.ones(20, np.float32),
        error=error,
    )
    return guarded(after, error)


@pytest.mark.parametrize("error", [1.01 * DIVERGED, float("inf"), float("nan")])
def test_the_best_parameters_come_back_when_the_error_grows_far_beyond_theirs(error: float) -> None:
    first = told(state(Weights(0.0, 5.0, 6.0)), 3.0)
    best = told(replace(first, weights=Weights(0.0, 5.0, 7.0)), 1.0)
    worse = told(replace(best, weights=Weights(0.0, 5.0, 90.0)), 0.99 * DIVERGED)
    assert worse.parameters is not best.parameters
    assert worse.setbacks == ()
    back = told(worse, error)
    assert back.parameters is best.parameters
    assert back.weights == best.weights
    assert not back.mean.any()
    assert (back.updates, back.begun, back.rate_factor) == (4 * SETTLED, 4 * SETTLED, 0.5)
    assert [(each.back_to, each.least) for each in back.setbacks] == [(2 * SETTLED, 1.0)]
    # The running mean says nothing before it has settled again.
    early = replace(back, updates=back.updates + SETTLED - 1, error=100.0)
    assert guarded(early, 100.0).setbacks == back.setbacks


@pytest.mark.parametrize("error", [1000.0, float("nan")])
def test_one_batch_with_flights_out_of_control_is_no_divergence_but_many_are(error: float) -> None:
    now = guarded(told(state(Weights(0.0, 5.0, 6.0)), 1.0), error)
    assert now.error == pytest.approx(1.1)
    for _ in range(13):
        now = guarded(now, error)
    assert now.setbacks == ()
    assert guarded(now, error).setbacks


def test_a_run_ends_with_an_error_when_it_diverges_again_and_again() -> None:
    now = told(state(Weights(0.0, 5.0, 6.0)), 1.0)
    for _ in range(SETBACKS_MAX):
        now = told(now, 10.0)
    with pytest.raises(TrainingError, match=f"diverged {SETBACKS_MAX + 1} times"):
        told(now, 10.0)


def test_a_run_that_diverged_goes_on_as_if_it_had_never_stopped_when_restored() -> None:
    aircraft = load_aircraft("nf1")
    updates = 4 * SETTLED
    run = config(
        steps=updates * UPDATE,
        algorithm=PathwiseConfig(aircraft=4, leg_steps=UPDATE * updates // 2, learning_rate=0.005),
    )
    whole = make_learner(aircraft, run)
    # An error that no run reaches: every running mean that has settled is one of a diverged run.
    own = whole._state  # type: ignore[attr-defined]
    good = replace(own.good, error=0.1, parameters=own.parameters + np.float32(0.01))
    whole._state = replace(own, good=good)  # type: ignore[attr-defined]
    notes: list[str] = []
    whole.learn(0, lambda report: notes.append(report.note))
    state, policy = snapshot(whole.state()), whole.policy()
    assert [note.partition(":")[0] for note in notes if note] == [
        f"diverged at {count * SETTLED * UPDATE:,} steps" for count in (1, 2)
    ]
    whole.learn(1, unheard)
    resumed = make_learner(aircraft, run)
    resumed.restore(state)
    assert equal(resumed.policy(), policy)
    resumed.learn(1, unheard)
    assert equal(whole.policy(), resumed.policy())
    assert len(resumed.state()["setbacks"]) == 4
