"""Distributions that PPO draws from."""

from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray
from scipy import stats

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.policy.freeze import to_onnx
from neuroflight.toolchain.policy.model import parse_policy
from neuroflight.training.config.algorithms import PpoConfig
from neuroflight.training.config.training_config import OutputMap, TrainingConfig
from neuroflight.training.learners.exploration import BetaExploration, NormalExploration, concentration
from neuroflight.training.learners.sb3 import Sb3Learner
from neuroflight.training.runs.make_learner import make_learner
from neuroflight.training.tasks.reward import Transition

NF1 = load_aircraft("nf1")
SQUASHED = OutputMap(scale=0.5, offset=0.5, squash=True)
SMALL = PpoConfig(
    32,
    16,
    128,
    epochs=8,
    learning_rate=5e-3,
    discount=0.8,
    leg=16,
    smoothness_spatial=0.0,
    distribution="beta",
)
CONFIG = TrainingConfig(steps=8192, hidden=(16, 8), algorithm=SMALL, output=SQUASHED)
LOG_STD = -1.5


def test_beta_draws_have_the_distribution_whose_mode_is_the_networks_output() -> None:
    rng = np.random.default_rng(1)
    centre = np.full((20_000, 3), (-0.9, 0.0, 0.5), np.float32)
    noise = rng.standard_normal(centre.shape).astype(np.float32)
    drawn = BetaExploration().drawn(centre, noise, LOG_STD)
    assert drawn.dtype == np.float32
    assert (np.abs(drawn) < 1.0).all()
    assert drawn[:, 1].std() == pytest.approx(np.exp(LOG_STD), rel=0.02)
    assert drawn[:, 0].std() < 0.7 * drawn[:, 1].std()  # beside a bound
    k = concentration(LOG_STD)
    for column, output in zip(drawn.T, centre[0], strict=True):
        mode = (float(output) + 1.0) / 2.0
        expected = stats.beta(1.0 + k * mode, 1.0 + k * (1.0 - mode))
        assert stats.kstest((column.astype(np.float64) + 1.0) / 2.0, expected.cdf).pvalue > 0.01
        shares = np.linspace(0.001, 0.999, 999)
        assert shares[expected.pdf(shares).argmax()] == pytest.approx(mode, abs=0.001)


def test_log_densities_are_those_of_scipy_and_have_a_derivative() -> None:
    rng = np.random.default_rng(2)
    centre = rng.uniform(-0.99, 0.99, (50, 4)).astype(np.float32)
    noise = rng.standard_normal(centre.shape).astype(np.float32)
    log_std, k = torch.full((4,), LOG_STD), concentration(LOG_STD)
    mode = (centre.astype(np.float64) + 1.0) / 2.0
    for exploration in (NormalExploration(), BetaExploration()):
        drawn = exploration.drawn(centre, noise, LOG_STD)
        if isinstance(exploration, BetaExploration):
            each = stats.beta(1.0 + k * mode, 1.0 + k * (1.0 - mode), loc=-1.0, scale=2.0).logpdf(drawn)
        else:
            each = stats.norm(centre, np.exp(LOG_STD)).logpdf(drawn)
        actions, where = torch.from_numpy(drawn), torch.from_numpy(centre).requires_grad_()
        found = exploration.log_prob(actions, where, log_std)
        found.sum().backward()  # type: ignore[no-untyped-call]
        at_draw = exploration.log_prob_drawn(actions, where, torch.from_numpy(noise), LOG_STD)
        np.testing.assert_allclose(found.detach().numpy(), each.sum(axis=1), atol=2e-4, rtol=1e-4)
        np.testing.assert_allclose(at_draw.detach().numpy(), each.sum(axis=1), atol=2e-4, rtol=1e-4)
        assert where.grad is not None
        assert torch.isfinite(where.grad).all()


def test_log_density_is_finite_when_noise_is_extreme_and_the_mode_at_a_bound() -> None:
    centre = np.array([[-1.0, 1.0, -1.0, 1.0]], np.float32)
    noise = np.array([[-9.0, 9.0, 9.0, -9.0]], np.float32)
    drawn = BetaExploration().drawn(centre, noise, -2.5)
    assert (np.abs(drawn) < 1.0).all()
    found = BetaExploration().log_prob(
        torch.from_numpy(drawn), torch.from_numpy(centre), torch.full((4,), -2.5)
    )
    assert torch.isfinite(found).all()


@dataclass(frozen=True)
class Low:
    """The higher, the lower the outputs."""

    name: ClassVar[str] = "low"

    def __call__(self, step: Transition) -> NDArray[np.float32]:
        """-mean output of each aircraft."""
        mean: NDArray[np.float32] = step.action.mean(axis=1)
        return -mean


def test_beta_policy_learns_and_is_frozen_as_its_mode_for_the_compiler() -> None:
    config = replace(CONFIG, reward=Low())
    torch.set_num_threads(1)
    rewards: list[float] = []
    with closing(make_learner(NF1, config)) as learner:
        assert isinstance(learner, Sb3Learner)
        learner.learn(0, lambda update: rewards.append(update.reward))
        model: Any = learner._model
        actor, frozen = model.actor, to_onnx(config.document(NF1), learner.policy())
    assert rewards[0] < -0.35  # a fresh network gives about a half
    assert rewards[-1] > -0.2, rewards
    raw = np.random.default_rng(3).normal(0.0, 1.0, (20, 6)).astype(np.float32)
    with torch.no_grad():
        scaled = torch.from_numpy(raw * np.array(config.observation_scale(4), np.float32))
        modes = 0.5 * (actor(scaled).numpy() + 1.0)
    session = onnxruntime.InferenceSession(frozen)
    outputs = np.concatenate([session.run(None, {"observation": row[None]})[0] for row in raw])
    np.testing.assert_allclose(outputs, modes, atol=1e-6, rtol=0)
    assert compile_policy(parse_policy(frozen)).network.outputs == 4


@pytest.mark.parametrize(
    ("options", "output", "message"),
    [
        ({"log_std": (-0.5, -1.0)}, SQUASHED, r"log_std \[-0.5, -1.0\], expected at most -0.549"),
        ({}, OutputMap(), "output.squash false, expected true: a beta distribution"),
    ],
)
def test_an_impossible_distribution_is_rejected(
    options: dict[str, Any], output: OutputMap, message: str
) -> None:
    with pytest.raises(TrainingError, match=message):
        replace(CONFIG, algorithm=replace(SMALL, **options), output=output)
