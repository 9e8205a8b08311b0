"""The Gymnasium environment of one aircraft."""

import copy
import json
import math
import pickle
import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3

from neuroflight.toolchain.errors import AircraftError, TrainingError
from neuroflight.training.config.config_file import recipes
from neuroflight.training.config.training_config import TrainingConfig, WorldConfig
from neuroflight.training.envs.gym_env import AttitudeEnv
from neuroflight.training.tasks.reward import NormalizedReward
from neuroflight.training.tasks.task import EpisodicTask
from tests.conftest import ROOT

ID = "neuroflight/Attitude-v0"
AIRCRAFT = {"hexa": "hexa", "iris-ppo": "iris"}
SHORT = EpisodicTask(hold_s=0.02)


@pytest.fixture
def make() -> Iterator[Any]:
    made = []

    def build(**options: Any) -> gymnasium.Env:
        made.append(gymnasium.make(ID, **options))
        return made[-1]

    yield build
    for env in made:
        env.close()


OPTIONS: list[dict[str, Any]] = [
    {"aircraft": "nf1", "task": "pulse"},
    {
        "aircraft": "hexa",
        "task": "continuous",
        "observation": "rate~15Hz,rate_error,rate_error@2,rate_error_integral,previous_action,gravity",
        "control_rate_hz": 2000,
    },
    {"config": TrainingConfig(world=WorldConfig(mount="free", throttle_max=0.8))},
]


@pytest.mark.parametrize("options", OPTIONS)
def test_passes_the_checkers_without_a_warning(options: dict[str, Any], make: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = make(**options)
        check_env(env.unwrapped)
        check_env_of_sb3(env)


def test_observations_stay_within_the_space_at_extreme_actions(make: Any) -> None:
    env = make(**OPTIONS[1])
    observation, _ = env.reset(seed=1)
    rng = np.random.default_rng(1)
    for _ in range(12):
        action = rng.choice([-1, 1], 6).astype(np.float32)
        for _ in range(50):
            assert env.observation_space.contains(observation)
            observation, *_ = env.step(action)


def rollout(env: gymnasium.Env, seed: int, steps: int = 60) -> np.ndarray:
    observation, _ = env.reset(seed=seed)
    rng = np.random.default_rng(0)
    rows = [observation]
    for _ in range(steps):
        rows.append(env.step(rng.uniform(-1, 1, 4).astype(np.float32))[0])
    return np.array(rows)


def test_a_seed_repeats_an_episode_exactly(make: Any) -> None:
    env = make()
    first, second, other = rollout(env, 5), rollout(env, 5), rollout(env, 6)
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)
    assert np.array_equal(rollout(make(), 5), first)


def test_episodes_without_a_seed_go_on_from_the_last_one(make: Any) -> None:
    env = make(task=SHORT)
    rows = [rollout(env, 5, 20), env.reset()[0], env.reset()[0]]
    again = [rollout(env, 5, 20), env.reset()[0], env.reset()[0]]
    for one, other in zip(rows, again, strict=True):
        assert np.array_equal(one, other)
    assert not np.array_equal(rows[1], rows[2])


def test_ends_by_truncation_when_its_time_is_over(make: Any) -> None:
    env = make()
    env.reset(seed=1)
    for step in range(1, 4501):
        _, reward, terminated, truncated, info = env.step(np.full(4, 0.1, np.float32))
        assert math.isfinite(reward)
        assert not terminated
        assert truncated == (step == 4500)
    assert info["setpoint"].shape == (3,)


def test_the_reward_is_the_configured_one(make: Any) -> None:
    for reward in ("dissertation-3", NormalizedReward(), {"name": "dissertation-3", "rate_max_deg_s": 300}):
        env = make(task={"name": "episodic", "limit_deg_s": 90, "hold_s": 0.5}, reward=reward)
        env.reset(seed=1)
        _, seen, _, _, info = env.step(np.zeros(4, np.float32))
        assert np.abs(info["setpoint"]).max() <= math.radians(90)
        error = np.abs(info["setpoint"] - info["rate"]).sum()
        assert seen == pytest.approx(-0.01 * error / (3 * math.radians(300)), rel=1e-5)


def test_arguments_replace_values_of_the_configuration() -> None:
    still = WorldConfig(noise=False)
    base = TrainingConfig(task=EpisodicTask(), control_rate_hz=2000, observation="rate", world=still)
    env = AttitudeEnv(config=base, task=SHORT, observation="rate,throttle", control_rate_hz=1000)
    observation, _ = env.reset(seed=1)
    assert observation.tolist() == [0, 0, 0, 0]  # no noise and no throttle: the configuration's world
    steps, over = 0, False
    while not over:
        *_, over, _ = env.step(np.zeros(4, np.float32))
        steps += 1
    env.close()
    assert steps == 20


@pytest.mark.parametrize("recipe", recipes())
def test_every_recipe_is_an_environment(recipe: str, make: Any) -> None:
    env = make(config=recipe, aircraft=AIRCRAFT.get(recipe, "nf1"))
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert math.isfinite(env.step(env.action_space.sample())[1])


def test_the_shipped_policys_configuration_is_a_file_too(make: Any) -> None:
    env = make(config=ROOT / "training/policies/nf1/training.json")
    config = env.unwrapped.batch.setup.config
    told = json.loads((ROOT / "training/policies/nf1/training.json").read_text())["config"]
    assert (config.observation, config.task.name) == (told["observation"], told["task"]["name"])
    assert config.task.length_s == told["task"]["length_s"]
    assert config.world.randomization.delay_s == tuple(told["world"]["randomization"]["delay_s"])
    assert (config.idle, config.mix, config.gyro_filter) == (0.055, "centred", "mean")


def test_the_throttle_moves_where_the_world_says_so(make: Any) -> None:
    env = make(observation="throttle", throttle_max=0.8, throttle_share=1.0, throttle_steps=1.0, task="pulse")
    seen = [env.reset(seed=3)[0], *(env.step(np.zeros(4, np.float32))[0] for _ in range(1500))]
    assert np.ptp(seen) > 0.2
    assert np.abs(np.diff(seen, axis=0)).max() < 0.8


def test_an_action_is_scaled_to_motor_fractions_and_limited(make: Any) -> None:
    env = make(observation="previous_action", output={"scale": 0.25, "offset": 0.5})
    env.reset(seed=1)
    seen = env.step(np.array([-1, 0, 1, 3], np.float32))[0]
    assert seen.tolist() == [0.25, 0.5, 0.75, 0.75]


def test_a_picture_shows_the_aircraft_in_its_attitude(make: Any) -> None:
    env = make(render_mode="rgb_array")
    env.reset(seed=1)
    level = env.render()
    assert level.shape == (400, 400, 3)
    assert level.dtype == np.uint8
    for _ in range(150):
        env.step(np.array([1, 1, -1, -1], np.float32))
    assert (env.render() != level).any(axis=2).mean() > 0.05
    assert make().unwrapped.render() is None


def test_a_copy_or_pickle_is_a_new_environment_of_the_same_arguments(make: Any) -> None:
    env = make(task=SHORT, observation="rate,throttle").unwrapped
    env.step(np.zeros(4, np.float32))
    for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert np.array_equal(rollout(other, 5, 20), rollout(env, 5, 20))
        other.close()


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_rejects_an_action_that_is_not_finite(value: float, make: Any) -> None:
    env = make().unwrapped
    env.reset(seed=1)
    with pytest.raises(ValueError, match="is not finite"):
        env.step(np.array([0.1, value, 0.1, 0.1], np.float32))


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"aircraft": "zeppelin"}, AircraftError, "no such file"),
        ({"task": {"name": "pulse", "sigma": 1}}, TrainingError, r"task\.sigma: unknown key; nearest: sig"),
        ({"task": {"name": "pulse", "idle_s": -1}}, TrainingError, "idle_s -1.0, expected 0 to 600"),
        ({"task": "recorded"}, TrainingError, r"task\.file: missing"),
        ({"config": {"idle": 1}}, TrainingError, "config: got a dict, expected a recipe's name, a file or"),
        ({"aircraft": 5}, TrainingError, "aircraft: got a int, expected a shipped name"),
        ({"throttle": 0.5}, TrainingError, "environment: throttle: unknown argument; nearest: throttle_"),
        ({"throttle_max": "half"}, TrainingError, "throttle_max: got 'half', expected a finite number"),
        ({"reward_scale": 0}, TrainingError, "reward_scale: got 0, expected 1e-09 to 1e"),
        ({"output": {"gain": 1}}, TrainingError, r"output\.gain: unknown key"),
        ({"wind_m_s": 2}, TrainingError, "wind_m_s: got 2, expected a list of 3"),
        ({"render_mode": "ansi"}, ValueError, "render_mode 'ansi', expected one of: rgb_array"),
    ],
)  # fmt: skip
def test_rejects_unknown_options(options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message) as refused:
        gymnasium.make(ID, **options)
    assert refused.value.__cause__ is None, "one line, not two exceptions"


def test_a_stock_learner_trains_on_it(make: Any) -> None:
    torch.set_num_threads(1)
    model = PPO("MlpPolicy", make(), n_steps=500, batch_size=250, n_epochs=2, seed=1, device="cpu")
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(2000)
    assert model.num_timesteps == 2000
    after = list(model.policy.parameters())
    assert all(np.isfinite(parameter.detach().numpy()).all() for parameter in after)
    assert any(not np.array_equal(a.detach(), b) for a, b in zip(after, before, strict=True))
