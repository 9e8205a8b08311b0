"""Many aircraft behind Stable-Baselines3's interface."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.training.config.algorithms import PpoConfig
from neuroflight.training.config.training_config import OutputMap, TrainingConfig, WorldConfig
from neuroflight.training.envs.sb3_vector import AttitudeVecEnv, BatchVecEnv, LearnerVecEnv
from neuroflight.training.tasks.reward import Transition
from neuroflight.training.tasks.task import PulseTask

NF1 = load_aircraft("nf1")
SMALL = PpoConfig(aircraft=8, horizon=16, minibatch=128)
SHORT = PulseTask(idle_s=0.02, command_s=0.03, rest_s=0.02)
Build = Callable[..., LearnerVecEnv]


@pytest.fixture
def build() -> Iterator[Build]:
    envs = []

    def make(**options: object) -> LearnerVecEnv:
        envs.append(LearnerVecEnv(NF1, TrainingConfig(steps=1000, algorithm=SMALL, **options), 8))  # type: ignore[arg-type]
        return envs[-1]

    yield make
    for env in envs:
        env.close()


Step = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]


def advance(env: BatchVecEnv, actions: NDArray[np.float32]) -> Step:
    env.step_async(actions)
    return env.step_wait()


def test_every_end_is_a_truncation_with_its_last_observation(build: Build) -> None:
    env = build(task=SHORT)
    env.reset()
    ends = np.zeros(8, int)
    for _ in range(200):
        observation, reward, done, infos = advance(env, np.zeros((8, 4), np.float32))
        assert observation.shape == (8, 6)
        assert np.isfinite(observation).all()
        assert reward.shape == (8,)
        for i in np.flatnonzero(done):
            assert infos[i]["TimeLimit.truncated"] is True
            assert infos[i]["terminal_observation"].shape == (6,)
            assert not np.array_equal(infos[i]["terminal_observation"], observation[i])
            assert observation[i, 3:].tolist() == [0, 0, 0]  # a new episode: no delta yet
        ends += done
    assert (ends >= 2).all()  # 70 ms episodes in 200 ms


def test_aircraft_begin_spread_over_the_episodes_time(build: Build) -> None:
    env = build(task=SHORT)
    env.reset()
    first_ends = np.zeros(8, int)
    for step in range(1, 71):
        done = advance(env, np.zeros((8, 4), np.float32))[2]
        first_ends[(first_ends == 0) & done] = step
    assert len(set(first_ends.tolist())) > 3


def test_observations_are_scaled_and_actions_mapped_as_the_configuration_says(build: Build) -> None:
    env = build(observation="previous_action,throttle", world=WorldConfig(throttle_max=0.5))
    env.reset()
    assert isinstance(env.action_space, spaces.Box)
    low, high = env.action_space.low, env.action_space.high
    middle = advance(env, np.tile((low + high) / 2, (8, 1)))[0]
    assert middle[:, :4] == pytest.approx(np.full((8, 4), 0.5))
    top = advance(env, np.tile(high * 10, (8, 1)))[0]
    assert top[:, :4] == pytest.approx(np.ones((8, 4)))
    assert (top[:, 4] <= 0.5).all()
    assert top[:, 4].std() > 0.01


@dataclass(frozen=True)
class Excess:
    """The excess of the outputs beyond 0..1."""

    name: ClassVar[str] = "excess"

    def __call__(self, step: Transition) -> NDArray[np.float32]:
        """Of each aircraft, summed over motors."""
        excess: NDArray[np.float32] = np.abs(step.unclipped - step.action).sum(axis=1)
        return excess


def test_a_reward_sees_the_outputs_before_they_are_clipped(build: Build) -> None:
    env = build(reward=Excess())
    env.reset()
    unclipped = np.tile(np.array([3.0, -3.0, 0.0, 1.0], np.float32), (8, 1))  # fractions 2, -1, 0.5 and 1
    assert isinstance(env.action_space, spaces.Box)
    unclipped = np.clip(unclipped, env.action_space.low, env.action_space.high)  # as Stable-Baselines3 does
    assert advance(env, unclipped)[1] == pytest.approx(np.full(8, 2.0))


def test_outputs_keep_within_the_map_when_squashed(build: Build) -> None:
    env = build(observation="previous_action", output=OutputMap(scale=0.3, offset=0.4, squash=True))
    env.reset()
    seen = advance(env, np.tile(np.array([100.0, -100.0, 0.0, 0.5], np.float32), (8, 1)))[0]
    assert seen[0] == pytest.approx([0.7, 0.1, 0.4, 0.4 + 0.3 * 0.46211716])  # tanh(0.5)


@pytest.fixture
def public() -> Iterator[AttitudeVecEnv]:
    env = AttitudeVecEnv(3, task={"name": "episodic", "hold_s": 0.03})
    yield env
    env.close()


def test_every_episode_of_the_public_one_is_whole(public: AttitudeVecEnv) -> None:
    public.reset()
    for step in range(1, 91):
        observation, _, done, infos = advance(public, np.zeros((3, 4), np.float32))
        assert done.all() == done.any() == (step % 30 == 0)
        for i in np.flatnonzero(done):
            assert infos[i]["TimeLimit.truncated"] is True
            assert not np.array_equal(infos[i]["terminal_observation"], observation[i])
        assert done.any() or not any(infos)


def test_the_public_one_takes_the_wrappers_and_learners_of_stable_baselines(public: AttitudeVecEnv) -> None:
    env = VecNormalize(VecMonitor(public))
    model = PPO("MlpPolicy", env, n_steps=60, batch_size=60, n_epochs=1, seed=1, device="cpu")
    model.learn(360)
    assert {episode["l"] for episode in model.ep_info_buffer or ()} == {30}
    rewards, lengths = evaluate_policy(model, env, n_eval_episodes=3, return_episode_rewards=True)
    assert lengths == [30, 30, 30]
    assert np.isfinite(rewards).all()


def test_pictures_of_all_aircraft_are_tiled() -> None:
    env = AttitudeVecEnv(2, render_mode="rgb_array")
    env.reset()
    picture = env.render()
    env.close()
    assert picture is not None
    assert picture.shape == (800, 400, 3)
    assert 0.05 < (picture < 200).mean() < 0.5  # there is an aircraft on white
