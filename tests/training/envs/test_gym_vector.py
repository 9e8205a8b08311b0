"""Many aircraft behind Gymnasium's vector interface."""

import copy
import pickle
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics
from numpy.typing import NDArray

from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.envs.gym_env import AttitudeEnv
from neuroflight.training.envs.gym_vector import AttitudeVectorEnv
from neuroflight.training.envs.sb3_vector import AttitudeVecEnv
from neuroflight.training.envs.simulation import AttitudeSimulation

ID = "neuroflight/Attitude-v0"
SHORT = {"name": "episodic", "hold_s": 0.03}  # 30 control steps
STILL = np.zeros((3, 4), np.float32)


@pytest.fixture
def make() -> Iterator[Any]:
    made = []

    def build(count: int = 3, **options: Any) -> gymnasium.vector.VectorEnv:
        made.append(gymnasium.make_vec(ID, num_envs=count, **{"task": SHORT} | options))
        return made[-1]

    yield build
    for env in made:
        env.close()


def actions(steps: int, count: int = 3) -> NDArray[np.float32]:
    return np.random.default_rng(2).uniform(-1, 1, (steps, count, 4)).astype(np.float32)


def flown(env: gymnasium.vector.VectorEnv, seed: Any, steps: int = 70) -> NDArray[np.float32]:
    rows = [env.reset(seed=seed)[0]]
    return np.array(rows + [env.step(action)[0] for action in actions(steps)])


def test_gymnasium_makes_the_batch_unless_another_kind_is_asked_for(make: Any) -> None:
    assert isinstance(make(), AttitudeVectorEnv)
    assert isinstance(make(vectorization_mode="vector_entry_point"), AttitudeVectorEnv)
    env = make(vectorization_mode="sync")
    assert isinstance(env, gymnasium.vector.SyncVectorEnv)
    assert flown(env, 1).shape == (71, 3, 6)


def test_is_the_simulation_between_the_scales(make: Any) -> None:
    env = make(4, reward_scale=0.5)
    config, aircraft = env.batch.setup.config, env.batch.setup.aircraft
    twins = AttitudeSimulation(aircraft, 4, config=config, rng=np.random.default_rng(7))
    scale = np.array(config.observation_scale(4), np.float32)
    assert np.array_equal(env.reset(seed=7)[0], twins.reset() * scale)
    for action in actions(25, 4):
        observation, reward, _, ended, infos = env.step(action)
        result = twins.step(np.float32(0.25) * action + np.float32(0.5))
        assert np.array_equal(observation, result.observation * scale)
        assert np.array_equal(reward, result.reward * np.float32(0.5))
        assert np.array_equal(ended, result.ended)
        assert np.array_equal(infos["rate"], twins.rate)
        assert infos["_rate"].all()
    twins.close()


def test_one_aircraft_flies_alike_in_all_environments() -> None:
    alone, vector, stable = (
        AttitudeEnv(task=SHORT),
        AttitudeVectorEnv(1, task=SHORT),
        AttitudeVecEnv(1, task=SHORT),
    )
    stable.seed(5)
    rows: list[list[Any]] = [[alone.reset(seed=5)[0]], [vector.reset(seed=5)[0][0]], [stable.reset()[0]]]
    for action in actions(29, 1):
        rows[0].append(alone.step(action[0])[0])
        rows[1].append(vector.step(action)[0][0])
        rows[2].append(np.asarray(stable.step(action)[0])[0])
    for env in (alone, vector, stable):
        env.close()
    assert np.array_equal(rows[0], rows[1])
    assert np.array_equal(rows[0], rows[2])


@pytest.mark.parametrize("seed", [5, [5, 6, 7]])
def test_a_seed_repeats_the_flights_of_all_aircraft(seed: Any, make: Any) -> None:
    env = make()
    first = flown(env, seed)
    assert not np.array_equal(first, flown(env, None))
    assert not np.array_equal(first, flown(env, 8))
    assert np.array_equal(first, flown(make(), seed))
    with pytest.raises(ValueError, match="2 seeds, expected one for each of 3 aircraft"):
        env.reset(seed=[1, 2])


def test_an_ended_episode_begins_anew_with_the_next_step(make: Any) -> None:
    env = make()
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    env.reset(seed=1)
    for step in range(1, 62):
        observation, reward, terminated, truncated, infos = env.step(STILL)
        assert not terminated.any()
        assert truncated.all() == truncated.any() == (step in (30, 61))
        assert "final_obs" not in infos
        assert (reward == 0.0).all() == (step == 31)
        if step == 31:
            assert not observation[:, 3:].any()  # a new episode: no difference yet


def test_an_ended_episode_begins_anew_with_the_same_step_when_asked(make: Any) -> None:
    env, other = make(autoreset_mode=AutoresetMode.SAME_STEP), make(autoreset_mode="NextStep")
    env.reset(seed=1)
    other.reset(seed=1)
    for step in range(1, 31):
        observation, reward, _, truncated, infos = env.step(STILL)
        last, paid, *_, told = other.step(STILL)
        assert truncated.all() == ("final_obs" in infos) == (step == 30)
        assert np.array_equal(reward, paid)
    assert np.array_equal(np.stack(infos["final_obs"]), last)
    assert infos["_final_obs"].all()
    assert infos["_final_info"].all()
    assert np.array_equal(infos["final_info"]["rate"], told["rate"])
    assert not observation[:, 3:].any()
    assert not infos["rate"].any()  # at rest


def test_without_autoreset_the_caller_begins_episodes(make: Any) -> None:
    env = make(autoreset_mode=AutoresetMode.DISABLED)
    env.reset(options={"reset_mask": np.ones(3, bool)})
    for _ in range(10):
        before = env.step(STILL)[0]
    mask = np.array([True, False, False])
    after, _ = env.reset(options={"reset_mask": mask})
    assert not np.array_equal(after[0], before[0])
    assert np.array_equal(after[1:], before[1:])
    for _ in range(20):
        truncated = env.step(STILL)[3]
    assert truncated.tolist() == [False, True, True]
    with pytest.raises(RuntimeError, match=r"episodes of \[1, 2\] are over"):
        env.step(STILL)
    env.reset(options={"reset_mask": truncated})
    assert not env.step(STILL)[3].any()


@pytest.mark.parametrize("mask", [np.zeros(3, bool), np.ones(2, bool), np.ones(3)])
def test_a_mask_that_names_no_aircraft_is_refused(mask: NDArray[Any], make: Any) -> None:
    env = make()
    env.reset()
    with pytest.raises(ValueError, match="expected bool"):
        env.reset(options={"reset_mask": mask})


def test_an_episode_may_be_cut_short(make: Any) -> None:
    env = make(max_episode_steps=12)
    env.reset()
    ends = [int(env.step(STILL)[3].sum()) for _ in range(25)]
    assert [step for step, ended in enumerate(ends, 1) if ended] == [12, 25]


def test_wrappers_of_gymnasium_count_its_episodes(make: Any) -> None:
    env = NormalizeObservation(RecordEpisodeStatistics(make()))
    env.reset(seed=1)
    rewards = []
    for _ in range(30):
        observation, reward, *_, infos = env.step(STILL)
        rewards.append(reward)
    assert infos["episode"]["l"].tolist() == [30, 30, 30]
    assert infos["episode"]["r"] == pytest.approx(np.sum(rewards, axis=0))
    assert env.observation_space.contains(observation)


def test_a_copy_or_pickle_is_a_new_environment_of_the_same_arguments(make: Any) -> None:
    env = make(autoreset_mode="SameStep", max_episode_steps=20)
    for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert np.array_equal(flown(other, 5), flown(env, 5))
        other.close()


def test_pictures_show_each_aircraft(make: Any) -> None:
    env = make(render_mode="rgb_array")
    env.reset()
    frames = env.render()
    assert [frame.shape for frame in frames] == [(400, 400, 3)] * 3


def test_a_closed_one_says_so_and_a_seed_opens_it(make: Any) -> None:
    env = make()
    env.close()
    with pytest.raises(RuntimeError, match="is closed"):
        env.step(STILL)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"autoreset_mode": "later"},
            "autoreset_mode: got 'later', expected one of: NextStep, SameStep",
        ),
        ({"max_episode_steps": 0}, "max_episode_steps: got 0, expected at least 1"),
    ],
)
def test_rejects_unknown_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        gymnasium.make_vec(ID, num_envs=2, **options)


@pytest.mark.parametrize("count", [0, -1, 10**9, 2.5])
def test_rejects_a_number_of_aircraft_that_is_none(count: Any) -> None:
    with pytest.raises(TrainingError, match=r"aircraft") as error:
        gymnasium.make_vec(ID, num_envs=count)
    assert "\n" not in str(error.value)
