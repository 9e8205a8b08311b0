"""Gymnasium's view of one aircraft."""

import math
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from toolchain.errors import AircraftError, TrainingError

ID = "training:neuroflight/Attitude-v0"


def test_passes_gymnasiums_checker_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(ID, aircraft="nf1", task="pulse")
        check_env(env.unwrapped)
    env.close()


def rollout(env: gymnasium.Env, seed: int, steps: int = 60) -> np.ndarray:
    observation, _ = env.reset(seed=seed)
    rng = np.random.default_rng(0)
    rows = [observation]
    for _ in range(steps):
        rows.append(env.step(rng.uniform(0, 1, 4).astype(np.float32))[0])
    return np.array(rows)


def test_a_seed_repeats_an_episode_exactly() -> None:
    env = gymnasium.make(ID)
    first, second, other = rollout(env, 5), rollout(env, 5), rollout(env, 6)
    env.close()
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_ends_by_truncation_when_the_clock_runs_out() -> None:
    env = gymnasium.make(ID)
    env.reset(seed=1)
    for step in range(1, 4501):
        _, reward, terminated, truncated, info = env.step(np.full(4, 0.1, np.float32))
        assert math.isfinite(reward)
        assert not terminated
        assert truncated == (step == 4500)
    env.close()
    assert info["setpoint"].shape == (3,)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_refuses_an_action_that_is_not_finite(value: float) -> None:
    env = gymnasium.make(ID).unwrapped
    env.reset(seed=1)
    with pytest.raises(ValueError, match="is not finite"):
        env.step(np.array([0.1, value, 0.1, 0.1], np.float32))
    env.close()


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"aircraft": "zeppelin"}, AircraftError, "no such file"),
        ({"task": "ballet"}, TrainingError, "task 'ballet', expected one of: pulse"),
        ({"observation": "rate,smell"}, TrainingError, "unknown observation block 'smell'"),
        ({"control_rate_hz": 900}, TrainingError, "control rate 900 Hz, expected one of"),
    ],
)
def test_refuses_options_it_does_not_know(
    options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        gymnasium.make(ID, **options)


@pytest.mark.parametrize(("task", "seconds"), [("pulse", 4.5), ("episodic", 1.0), ("envelope", 1.0)])
def test_an_episode_lasts_as_long_as_its_task(task: str, seconds: float) -> None:
    env = gymnasium.make(ID, aircraft="nf1", task=task)
    env.reset(seed=1)
    steps, over = 0, False
    while not over:
        *_, over, _ = env.step(np.zeros(4, np.float32))
        steps += 1
    env.close()
    assert steps == round(1000 * seconds)
