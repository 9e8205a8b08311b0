"""The monitor gives the same metrics in its own process and in this one."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.errors import PolicyError
from neuroflight.training.checkpoints.monitor import FLIGHT, flown, fly
from neuroflight.training.checkpoints.monitor_process import Monitor
from neuroflight.training.config.algorithms import PpoConfig
from neuroflight.training.config.pathwise_config import PathwiseConfig
from neuroflight.training.config.randomization import Randomization
from neuroflight.training.config.training_config import TrainingConfig, WorldConfig
from neuroflight.training.learners.pathwise.learner import PathwiseLearner
from neuroflight.training.tasks.random_steps import RandomStepsTask
from neuroflight.training.tasks.task import ContinuousTask, EpisodicTask, PulseTask

NF1 = load_aircraft("nf1")
PPO = PpoConfig(aircraft=8, horizon=16, minibatch=64)
CONFIG = TrainingConfig(hidden=(8,), task=EpisodicTask(hold_s=0.05), algorithm=PPO)


@pytest.fixture(autouse=True)
def monitor_here() -> None:
    """Let monitors be where they are asked to be."""


def weights(seed: int, bias: float = -0.6) -> dict[str, torch.Tensor]:
    """A policy of CONFIG's shape with outputs of about 0.5 + 0.5 bias."""
    rng = np.random.default_rng(seed)

    def tensor(*shape: int) -> torch.Tensor:
        return torch.as_tensor(rng.normal(0.0, 0.1 * (seed > 0), shape), dtype=torch.float32)

    return {
        "mlp_extractor.policy_net.0.weight": tensor(8, 6),
        "mlp_extractor.policy_net.0.bias": tensor(8),
        "action_net.weight": tensor(4, 8),
        "action_net.bias": tensor(4) + bias,
    }


def arrays(policy: dict[str, torch.Tensor]) -> dict[str, np.ndarray]:
    """The same as numpy arrays."""
    return {name: tensor.numpy() for name, tensor in policy.items()}


def test_metrics_are_the_same_when_another_process_takes_them() -> None:
    history = []
    for apart in (False, True):
        with Monitor(NF1, CONFIG, apart=apart) as monitor:
            for steps, seed in ((100, 1), (200, 2)):
                monitor.submit(steps, weights(seed))
            history.append(monitor.collect(wait=True))
            assert monitor.collect(wait=True) == []
    assert [metrics.steps for metrics in history[0]] == [100, 200]
    assert history[0] == history[1]
    assert history[0][0].mae != history[0][1].mae


def test_a_policy_with_constant_outputs_has_no_change() -> None:
    metrics = fly(NF1, CONFIG, 1, arrays(weights(0)))
    assert metrics.output.mean == pytest.approx(0.2, abs=1e-6)
    assert metrics.change.greatest == 0.0
    # Nothing turns the aircraft: it errs by the commands, on average half of 300 deg/s an axis.
    assert 80.0 < metrics.mae.mean < 220.0
    assert metrics.mae.least < metrics.mae.mean < metrics.mae.greatest
    # TrackingReward: the axes' errors over 100 deg/s, and 0.6 of the output; over one step more or less.
    assert metrics.reward.mean == pytest.approx(-3 * metrics.mae.mean / 100 - 0.6 * 0.2, rel=0.02)


@pytest.mark.parametrize("apart", [False, True])
def test_weights_that_make_no_policy_are_rejected_in_one_line(apart: bool) -> None:
    policy = weights(1)
    policy["action_net.bias"] = policy["action_net.bias"] * float("nan")
    with (
        Monitor(NF1, CONFIG, apart=apart) as monitor,
        pytest.raises(PolicyError, match="did training diverge"),
    ):
        monitor.submit(1, policy)
        monitor.collect(wait=True)


def test_randomization_is_off_and_noise_is_on_in_the_monitors_world() -> None:
    wild = WorldConfig(noise=False, randomization=Randomization(mass=(0.5, 2.0)))
    policy = arrays(weights(1))
    assert fly(NF1, replace(CONFIG, world=wild), 1, policy) == fly(NF1, CONFIG, 1, policy)


def test_the_policy_flies_with_its_idle() -> None:
    policy = arrays(weights(1))
    assert fly(NF1, replace(CONFIG, idle=0.2), 1, policy).mae != fly(NF1, CONFIG, 1, policy).mae


def test_a_run_on_a_task_of_training_alone_is_monitored_in_flights() -> None:
    config = flown(TrainingConfig(task=RandomStepsTask()))
    assert config.task == FLIGHT
    assert FLIGHT.duration_s == pytest.approx(28.0)  # four pulses of 4.5 s and a hover of 10 s
    config.document(NF1)
    assert flown(TrainingConfig(task=ContinuousTask())).task == PulseTask()
    assert flown(CONFIG).task == CONFIG.task


def test_a_policy_for_any_flies_other_aircraft_and_is_told_of_them() -> None:
    algorithm = PathwiseConfig(aircraft=16, change_of="motors")
    config = TrainingConfig(
        observation="rate_error,rate,rate_estimate",
        hidden=(4,),
        mix="centred",
        task=PulseTask(idle_s=0.0, command_s=0.15, rest_s=0.05),
        world=WorldConfig(aircraft="any", throttle_max=0.6),
        algorithm=algorithm,
    )
    learner = PathwiseLearner(NF1, config, algorithm)
    policy = arrays(learner.policy())
    learner.close()
    bent = policy | {name: part + 0.3 for name, part in policy.items() if name.startswith("basis.5.")}
    first, again, other = (fly(NF1, config, 1, each) for each in (policy, policy, bent))
    assert first == again != other
    assert first.mae.greatest > 2.0 * first.mae.least
