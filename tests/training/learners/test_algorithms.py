"""The algorithms as learners: frozen policies, resumed runs, bootstrapped episodes."""

import io
import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.policy.freeze import to_onnx
from neuroflight.training.config.algorithms import (
    Algorithm,
    Ddpg1Config,
    DdpgConfig,
    OffPolicyConfig,
    Ppo1Config,
    PpoConfig,
    SacConfig,
    Td3Config,
    TrpoConfig,
)
from neuroflight.training.config.training_config import OutputMap, TrainingConfig
from neuroflight.training.learners.ddpg1.learner import Ddpg1Learner
from neuroflight.training.learners.ppo1.learner import Ppo1Learner
from neuroflight.training.learners.sb3 import Sb3Learner
from neuroflight.training.runs.make_learner import make_learner
from neuroflight.training.tasks.reward import Transition
from neuroflight.training.tasks.task import PulseTask

NF1 = load_aircraft("nf1")
ON_POLICY: dict[str, Algorithm] = {
    "ppo": PpoConfig(aircraft=16, horizon=16, minibatch=128, leg=4),
    "ppo1": Ppo1Config(aircraft=16, horizon=16, minibatch=100, leg=4),
    "trpo": TrpoConfig(aircraft=16, horizon=16, minibatch=128, leg=4),
}
FEW: dict[str, Any] = {
    "aircraft": 16,
    "minibatch": 32,
    "gradient_steps": 2,
    "buffer": 640,
    "learning_starts": 64,
    "leg": 16,
}
OFF_POLICY: dict[str, Algorithm] = {
    "ddpg": DdpgConfig(**FEW),
    "td3": Td3Config(**FEW),
    "sac": SacConfig(**FEW),
}
DDPG1 = Ddpg1Config(aircraft=20, horizon=5, updates=5, minibatch=50, buffer=1230, leg=15)
ALL = {**ON_POLICY, **OFF_POLICY, "ddpg1": DDPG1}
SHORT = PulseTask(idle_s=0.002, command_s=0.004, rest_s=0.002)
SQUASHED = OutputMap(scale=0.3, offset=0.4, squash=True)
InC = Ppo1Learner | Ddpg1Learner


@dataclass(frozen=True)
class Constant:
    """The same reward for every step."""

    name: ClassVar[str] = "constant"

    def __call__(self, step: Transition) -> NDArray[np.float32]:
        """-0.1 for each aircraft."""
        return np.full(len(step.error), -0.1, np.float32)


@contextmanager
def learning(config: TrainingConfig) -> Iterator[Sb3Learner | InC]:
    torch.set_num_threads(1)
    found = make_learner(NF1, config)
    assert isinstance(found, Sb3Learner | InC)
    try:
        yield found
    finally:
        found.close()


def config_of(algorithm: Algorithm, **options: Any) -> TrainingConfig:
    return TrainingConfig(steps=4096, hidden=(16, 8), algorithm=algorithm, **options)


@pytest.mark.parametrize(
    ("name", "output"),
    [
        *((name, SQUASHED) for name in ALL),
        *((name, OutputMap(scale=0.7, offset=0.2)) for name in ON_POLICY),
    ],
)
def test_the_frozen_policy_is_the_actor_without_exploration_when_it_has_learnt(
    name: str, output: OutputMap
) -> None:
    config = config_of(ALL[name], output=output)
    with learning(config) as trained:
        before = {key: tensor.clone() for key, tensor in trained.policy().items()}
        trained.learn(0, lambda report: None)
        assert any(not torch.equal(tensor, before[key]) for key, tensor in trained.policy().items())
        session = onnxruntime.InferenceSession(to_onnx(config.document(NF1), trained.policy()))
        scale = np.array(config.observation_scale(4), np.float32)
        raw = np.random.default_rng(3).normal(0.0, 1.0 / scale, (50, 6)).astype(np.float32)
        if isinstance(trained, InC):
            outputs = trained.outputs(raw * scale)
        else:
            outputs, _ = trained._model.predict(raw * scale, deterministic=True)
    if output.squash and name in ON_POLICY:
        outputs = np.tanh(outputs)
    expected = np.clip(output.scale * outputs + output.offset, 0.0, 1.0)
    frozen = np.concatenate([session.run(None, {"observation": row[None]})[0] for row in raw])
    assert expected.std() > 1e-3
    np.testing.assert_allclose(frozen, expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("name", ALL)
def test_a_run_continues_as_if_it_had_never_stopped_when_resumed(name: str) -> None:
    config = config_of(ALL[name], output=SQUASHED)

    def bytes_of(trained: Sb3Learner | InC) -> bytes:
        buffer = io.BytesIO()
        torch.save({"policy": trained.policy(), "state": trained.state()}, buffer)
        return buffer.getvalue()

    with learning(config) as whole:
        whole.learn(0, lambda report: None)
        kept = bytes_of(whole)
        whole.learn(1, lambda report: None)
        expected = bytes_of(whole)
    with learning(replace(config)) as resumed:
        resumed.restore(torch.load(io.BytesIO(kept), weights_only=True)["state"])
        resumed.learn(1, lambda report: None)
        assert bytes_of(resumed) == expected
    assert kept != expected


@pytest.mark.parametrize(
    "algorithm",
    [
        PpoConfig(32, 8, 128, epochs=8, learning_rate=1e-2, discount=0.8, leg=30),
        Ppo1Config(32, 8, 128, epochs=8, learning_rate=1e-2, discount=0.8, leg=30),
        TrpoConfig(32, 8, minibatch=128, learning_rate=1e-2, discount=0.8, leg=12),
        pytest.param(
            DdpgConfig(**{**FEW, "leg": 400}, discount=0.8, tau=0.5, learning_rate=1e-2),
            marks=pytest.mark.slow,
        ),
        Ddpg1Config(minibatch=32, discount=0.8, tau=0.5, learning_rate=1e-2, leg=25),
    ],
    ids=lambda algorithm: algorithm.name,
)
def test_the_value_is_bootstrapped_when_an_episodes_time_is_over(algorithm: Algorithm) -> None:
    """The value of an endless episode is its mean reward, -0.1; if it ended after 8 steps, about -0.06."""
    config = TrainingConfig(
        steps=10**6, hidden=(16,), algorithm=algorithm, output=SQUASHED, task=SHORT, reward=Constant()
    )
    with learning(config) as trained:
        trained.learn(0, lambda report: None)
        observation = torch.from_numpy(trained._env.reset())
        model: Any = trained if isinstance(trained, InC) else trained._model
        value: Any
        with torch.no_grad():
            if isinstance(trained, Ppo1Learner) and isinstance(algorithm, Ppo1Config):
                value = (1.0 - algorithm.discount) * trained.values(observation.numpy())
            elif isinstance(trained, Ddpg1Learner) and isinstance(algorithm, Ddpg1Config):
                rows = observation.numpy()
                value = (1.0 - algorithm.discount) * trained.values(rows, trained.outputs(rows))
            elif isinstance(algorithm, OffPolicyConfig):
                value = model.critic(observation, model.actor(observation))[0]
            elif isinstance(algorithm, PpoConfig):
                value = model._values(observation.numpy())
            else:
                value = model.policy.predict_values(observation)
    assert -0.12 < float(value.mean()) < -0.085


@pytest.mark.parametrize("name", ["ddpg", "td3"])
def test_a_draw_of_noise_is_held_for_some_steps_and_begins_anew_with_a_segment(name: str) -> None:
    algorithm = replace(OFF_POLICY[name], hold=3)  # type: ignore[type-var]
    config = TrainingConfig(steps=10**6, hidden=(8,), algorithm=algorithm, output=SQUASHED, task=SHORT)
    with learning(config) as trained:
        assert isinstance(trained, Sb3Learner)
        noise: Any = trained._model.action_noise
        noise.restart()
        drawn = [noise().copy() for _ in range(7)]
        noise.restart()
        drawn.append(noise().copy())
    changed = [bool((before != after).all()) for before, after in itertools.pairwise(drawn)]
    assert changed == [False, False, True, False, False, True, True]


@pytest.mark.parametrize("name", OFF_POLICY)
def test_replay_buffer_holds_an_episodes_last_observation_when_its_time_is_over(name: str) -> None:
    config = TrainingConfig(steps=10**6, hidden=(8,), algorithm=OFF_POLICY[name], output=SQUASHED, task=SHORT)
    with learning(config) as trained:
        trained.learn(0, lambda report: None)
        assert isinstance(trained, Sb3Learner)
        model: Any = trained._model
        memory = model.replay_buffer
        ends = np.argwhere(memory.dones[: memory.pos] == 1.0)
        assert len(ends) >= 16
        assert memory.sample(500).dones.max() == 0.0
        delta = memory.next_observations[ends[:, 0], ends[:, 1], 3:]
        assert (np.abs(delta).max(axis=1) > 0.0).all()  # of a new episode's first step it would be 0


@pytest.mark.parametrize(
    ("algorithm", "message"),
    [
        (PpoConfig(horizon=5000), "horizon 5000, expected 1 to the 4500 control steps of an episode"),
        (Ppo1Config(minibatch=4096), r"a rollout has 2048 steps \(16 aircraft x 128\), expected at least"),
        (TrpoConfig(minibatch=1000), "minibatch 1000 does not divide the 16384 steps"),
        (DdpgConfig(buffer=100), "buffer 100, expected at least the minibatch and the number of aircraft"),
        (
            Ddpg1Config(buffer=99),
            "buffer 99, expected at least the minibatch of 64 and a rollout's 100",
        ),
    ],
)
def test_an_invalid_configuration_is_rejected_before_training_starts(
    algorithm: Algorithm, message: str
) -> None:
    with pytest.raises(TrainingError, match=message):
        TrainingConfig(algorithm=algorithm, output=SQUASHED)


@pytest.mark.parametrize("name", [*OFF_POLICY, "ddpg1"])
def test_rejects_outputs_without_a_bound_when_the_actor_ends_in_tanh(name: str) -> None:
    with pytest.raises(TrainingError, match=f"output.squash false, expected true: {name}'s policies"):
        TrainingConfig(algorithm=ALL[name])


@pytest.mark.parametrize("name", [*OFF_POLICY, "ddpg1"])
def test_a_buffer_larger_than_a_checkpoint_is_refused_before_a_step_is_flown(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_of(ALL[name], output=SQUASHED)
    with learning(config) as learner:
        while learner.steps < FEW["buffer"] * 2:
            learner.learn(0, lambda report: None)
        memory = learner.state()["memory"]
    size = sum(each.nbytes for each in memory.values() if isinstance(each, torch.Tensor))
    monkeypatch.setattr("neuroflight.training.learners.memory.CHECKPOINT_FILE_BYTES_MAX", size)
    with learning(config):
        pass
    monkeypatch.setattr("neuroflight.training.learners.memory.CHECKPOINT_FILE_BYTES_MAX", size - 1)
    with pytest.raises(TrainingError, match=rf"{size} bytes of it.*; choose at most \d+$"), learning(config):
        pass
    with learning(replace(config, steps=500)):  # which do not fill it
        pass
