"""A policy file of an actor that was trained in one of our environments."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from neuroflight.sim.control.controller import PolicyController
from neuroflight.toolchain.contract import needs_model
from neuroflight.toolchain.errors import PolicyError, TrainingError
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.policy.model import read_policy
from neuroflight.training.config.training_config import OutputMap
from neuroflight.training.envs.export import batch_of, export_policy
from neuroflight.training.envs.gym_vector import AttitudeVectorEnv
from neuroflight.training.envs.sb3_vector import AttitudeVecEnv

ID = "neuroflight/Attitude-v0"


def actor(inputs: int) -> torch.nn.Module:
    torch.manual_seed(1)
    return torch.nn.Sequential(torch.nn.Linear(inputs, 16), torch.nn.Tanh(), torch.nn.Linear(16, 4))


def test_the_file_flies_as_the_actor_does_in_its_environment(tmp_path: Path) -> None:
    env = AttitudeVectorEnv(
        1, config="nf1", output=OutputMap(0.3, 0.6), noise=False, throttle_max=0.0, randomization={}
    )
    config, aircraft = env.batch.setup.config, env.batch.setup.aircraft
    network = actor(len(env.batch.scale))
    network.train()
    export_policy(network, env, tmp_path / "policy.onnx")
    assert network.training
    policy = read_policy(tmp_path / "policy.onnx")
    assert (policy.observation, policy.control_rate_hz) == (config.observation, config.control_rate_hz)
    assert (policy.idle, policy.mix.text, list(policy.filters)) == (0.055, "centred", [["mean"]])
    assert (policy.aircraft, policy.aircraft_sha256) == (aircraft.name, aircraft.sha256)
    assert needs_model(config.blocks())
    assert policy.model is not None
    observation = env.reset(seed=1)[0]
    for _ in range(300):  # raw observations that a flight leads through
        action = network(torch.from_numpy(observation)).detach().numpy()
        told = evaluate(policy.network, observation / env.batch.scale)
        expected = np.clip(0.3 * action + 0.6, 0.3, 0.9)
        np.testing.assert_allclose(told, expected, rtol=0, atol=2e-6)
        observation = env.step(action)[0]
    env.close()
    assert PolicyController(policy, 1, exact=False) is not None


def test_an_environment_is_found_behind_wrappers_and_in_vectors() -> None:
    def made() -> gymnasium.Env[Any, Any]:
        return gymnasium.make(ID, control_rate_hz=2000)

    envs: list[Any] = [
        VecMonitor(AttitudeVecEnv(2, control_rate_hz=2000)),
        VecMonitor(DummyVecEnv([made])),
        gymnasium.wrappers.NormalizeObservation(made()),
        gymnasium.vector.SyncVectorEnv([made]),
        gymnasium.wrappers.vector.RecordEpisodeStatistics(gymnasium.make_vec(ID, 2, control_rate_hz=2000)),
    ]
    for env in envs:
        assert batch_of(env).setup.config.control_rate_hz == 2000
        env.close()


def test_nothing_is_written_when_it_is_no_policy(tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    with pytest.raises(TrainingError, match="no environment of ours in this process"):
        export_policy(actor(3), gymnasium.make("Pendulum-v1"), path)
    env = AttitudeVecEnv(1)
    whole = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu")
    for wrong, message in (
        (torch.nn.Linear(6, 8), r"the actor gives \(1, 8\), expected the mean action \(1, 4\)"),
        (torch.nn.Linear(5, 4), r"the actor does not take observations \(1, 6\)"),
        (torch.nn.LSTM(6, 4), "the actor gives a tuple, expected the mean action"),
        (whole.policy, "the actor gives a tuple, expected the mean action"),
        (SAC("MlpPolicy", env, device="cpu").actor, "torch cannot export the actor; give the layers"),
        (whole, "the actor is a PPO, expected a torch.nn.Module"),
    ):
        with pytest.raises(PolicyError, match=message) as refused:
            export_policy(wrong, env, path)  # type: ignore[arg-type]
        assert "\n" not in str(refused.value)
    env.close()
    assert not path.exists()
