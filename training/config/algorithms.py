"""Hyperparameters of the algorithms, as frozen data; names as in Stable-Baselines3 where it has them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Protocol

from neuroflight.sim.physics.world import COUNT_MAX
from neuroflight.training.config.pathwise_config import PathwiseConfig
from neuroflight.training.tasks.limits import Limits, NotNegative, OneOf, Positive, Share, value_errors

BUFFER_MAX = 10_000_000  # control steps: more are larger than any checkpoint
BETA_LOG_STD_MAX = -0.5 * math.log(3.0)  # all outputs in -1..1 equally likely

Aircraft = Annotated[int, Limits(1, COUNT_MAX)]
Steps = Annotated[int, Limits(1, BUFFER_MAX)]  # control steps or samples
Repeats = Annotated[int, Limits(1, 10_000)]  # in an update: more would take longer than a day
Leg = Annotated[int, Limits(1, 1_000_000)]  # what a segment repeats
LogStd = Annotated[float, Limits(-10.0, 10.0)]
Noise = Annotated[tuple[float, float], Limits(0.0, 1.0)]


class Algorithm(Protocol):
    """Hyperparameters of one algorithm, with a name in `ALGORITHMS`."""

    name: ClassVar[str]

    @property
    def aircraft(self) -> int:
        """Number of aircraft side by side in the twin."""
        ...

    @property
    def leg_steps(self) -> int:
        """Control steps, all aircraft together, of a segment: a checkpoint is possible at its end.

        Every segment begins with new episodes and its own random stream, so that a run that is resumed at
        the end of a segment continues as if it had never stopped.
        """
        ...

    def errors(self, episode_steps: int) -> Iterator[str]:
        """Yield errors of the values, one line each; episode_steps: control steps of an episode."""
        ...


class Rollouts:
    """An algorithm that learns from rollouts, of which a segment has `leg`."""

    aircraft: int
    horizon: int
    minibatch: int
    leg: int

    @property
    def batch(self) -> int:
        """Control steps of a rollout, all aircraft together."""
        return self.aircraft * self.horizon

    @property
    def leg_steps(self) -> int:
        """See Algorithm."""
        return self.leg * self.batch

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from value_errors(self)

    def whole_errors(self, episode_steps: int) -> Iterator[str]:
        """Yield errors of rollouts that are divided into whole minibatches, and end within an episode."""
        if self.horizon > episode_steps:
            yield f"horizon {self.horizon}, expected 1 to the {episode_steps} control steps of an episode"
        if self.batch % self.minibatch:
            yield (
                f"minibatch {self.minibatch} does not divide the {self.batch} steps of a rollout "
                f"({self.aircraft} aircraft x {self.horizon}); choose a divisor"
            )


@dataclass(frozen=True)
class PpoConfig(Rollouts):
    """Schulman et al. 2017, with smoothness of the mean output in the policy's loss.

    Outputs are drawn from a normal distribution, or with `OutputMap.squash` from tanh of one: bounded. The
    factor that tanh puts on a probability is the same before and after an update, so it cancels in the ratio.
    Or they are drawn from a beta distribution, which is bounded itself: see `training.learners.exploration`.
    """

    name: ClassVar[str] = "ppo"
    aircraft: Aircraft = 256
    horizon: Steps = 128  # control steps of each aircraft between updates
    minibatch: Steps = 4096  # divides the steps of a rollout
    epochs: Repeats = 3  # passes over a rollout
    learning_rate: Positive = 7e-4  # annealed linearly to a tenth
    discount: Share = 0.99  # at 1 kHz: a horizon of 100 ms
    gae_lambda: Share = 0.98  # rotors respond within 40 ms: credit must reach back that far
    clip: Positive = 0.2
    log_std: tuple[float, float] = (-1.0, -2.5)  # exploration, network output units, first to last step
    hold: Repeats = 8  # control steps for which a draw of the exploration is held
    distribution: Annotated[str, OneOf(("normal", "beta"))] = "normal"  # "beta" needs `output.squash`
    smoothness_spatial: NotNegative = 1.0  # weight of the mean output's change under gyro noise
    smoothness_temporal: NotNegative = 0.0  # of its change from a control step to the next
    leg: Leg = 16  # rollouts

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from super().errors(episode_steps)
        if self.distribution == "beta" and not max(self.log_std) <= BETA_LOG_STD_MAX:
            yield (
                f"log_std {list(self.log_std)}, expected at most {BETA_LOG_STD_MAX:.3f}: a beta distribution "
                f"is no wider"
            )
        yield from self.whole_errors(episode_steps)


@dataclass(frozen=True)
class Ppo1Config(Rollouts):
    """PPO as OpenAI Baselines' PPO1 has it, Koch 2019's learner; see `training.learners.ppo1.learner`.

    Its horizon (Tables 3.1, 4.2, 5.5) is `aircraft` times `horizon` here. The defaults are Table 3.1's.
    """

    name: ClassVar[str] = "ppo1"
    aircraft: Aircraft = 16
    horizon: Steps = 128  # control steps of each aircraft between updates
    minibatch: Steps = 64  # samples of a rollout that do not fill one are left out of an epoch
    epochs: Repeats = 10  # passes over a rollout
    learning_rate: Positive = 3e-4
    discount: Share = 0.99
    gae_lambda: Share = 0.95
    clip: Positive = 0.2
    entropy: NotNegative = 0.0  # weight of the distribution's entropy in the loss
    log_std: LogStd = 0.0  # exploration at first, network output units; learned
    anneal: bool = True  # learning rate and clip range fall linearly to 0 over the run
    leg: Leg = 48  # rollouts

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from super().errors(episode_steps)
        if not self.minibatch <= self.batch <= BUFFER_MAX:
            yield (
                f"a rollout has {self.batch} steps ({self.aircraft} aircraft x {self.horizon}), expected at "
                f"least the minibatch of {self.minibatch} and at most {BUFFER_MAX}"
            )


@dataclass(frozen=True)
class TrpoConfig(Rollouts):
    """Schulman et al. 2015: the largest step along the natural gradient within a distance of the old policy.

    Its exploration is learned. Bounded outputs as in PPO.
    """

    name: ClassVar[str] = "trpo"
    aircraft: Aircraft = 256
    horizon: Steps = 64  # control steps of each aircraft between updates
    target_kl: Positive = 0.01
    cg_max_steps: Repeats = 15  # of conjugate gradients
    cg_damping: NotNegative = 0.1
    critic_updates: Repeats = 4  # passes of the critic over a rollout
    minibatch: Steps = 2048  # of the critic
    learning_rate: Positive = 1e-3  # of the critic, annealed linearly to a tenth
    discount: Share = 0.99
    gae_lambda: Share = 0.98
    log_std: float = -1.0  # exploration at first, network output units
    leg: Leg = 16  # rollouts

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from super().errors(episode_steps)
        yield from self.whole_errors(episode_steps)


@dataclass(frozen=True)
class OffPolicyConfig:
    """Common to DDPG, TD3 and SAC: they learn from a replay buffer of steps, and their actor ends in tanh.

    All aircraft take a control step, then `gradient_steps` updates follow.
    """

    aircraft: Aircraft = 64
    gradient_steps: Repeats = 16  # updates after each control step of all aircraft
    minibatch: Steps = 256
    buffer: Steps = 100_000  # control steps kept, all aircraft together; part of every checkpoint
    # Control steps with uniformly drawn outputs, before the first update.
    learning_starts: Annotated[int, Limits(0)] = 8192
    learning_rate: Positive = 1e-3  # annealed linearly to a tenth
    discount: Share = 0.99
    tau: Share = 0.005  # share of the network in its target after each update
    leg: Leg = 256  # control steps of each aircraft

    @property
    def leg_steps(self) -> int:
        """See Algorithm."""
        return self.leg * self.aircraft

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from value_errors(self)
        if self.buffer < max(self.minibatch, self.aircraft):
            yield f"buffer {self.buffer}, expected at least the minibatch and the number of aircraft"


@dataclass(frozen=True)
class DdpgConfig(OffPolicyConfig):
    """Lillicrap et al. 2016, exploring with normal noise."""

    name: ClassVar[str] = "ddpg"
    noise: Noise = (0.2, 0.05)  # exploration: of an output in -1..1, first to last step
    hold: Repeats = 8  # control steps for which a draw of the exploration is held


@dataclass(frozen=True)
class Ddpg1Config(Rollouts):
    """DDPG as OpenAI Baselines had it in 2018, Koch 2019's learner; see `training.learners.ddpg1.learner`.

    Its rollout steps (Table 3.3) are `aircraft` times `horizon` here. The defaults are Table 3.3's, and
    Baselines' where the table has none, but for `buffer` and `critic_decay`. The actor ends in tanh.
    """

    name: ClassVar[str] = "ddpg1"
    aircraft: Aircraft = 20
    horizon: Steps = 5  # control steps of each aircraft between updates
    updates: Repeats = 50  # after each rollout
    minibatch: Steps = 64
    buffer: Steps = 200_000  # control steps kept, all aircraft together; part of every checkpoint
    learning_rate: Positive = 1e-3  # of the critic
    actor_learning_rate: Positive = 1e-4
    critic_decay: NotNegative = 0.0  # weight of the critic's squared weights, halved, in its loss
    discount: Share = 0.99
    tau: Share = 0.01  # share of the network in its target after each update
    # Of the actor's parameters at first, then as much as changes an output by that much.
    noise: Annotated[float, Limits(0.0, 1.0, above=True)] = 0.2
    leg: Leg = 400  # rollouts

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from super().errors(episode_steps)
        if self.buffer < max(self.minibatch, self.batch):
            yield (
                f"buffer {self.buffer}, expected at least the minibatch of {self.minibatch} and a rollout's "
                f"{self.batch} steps"
            )


@dataclass(frozen=True)
class Td3Config(OffPolicyConfig):
    """Fujimoto et al. 2018: the lower of two critics counts, and the actor is updated less often."""

    name: ClassVar[str] = "td3"
    noise: Noise = (0.2, 0.05)  # exploration: of an output in -1..1, first to last step
    hold: Repeats = 8  # control steps for which a draw of the exploration is held
    policy_delay: Repeats = 2  # updates of the critics for one of the actor
    target_noise: Positive = 0.1  # of the target's output
    target_noise_clip: NotNegative = 0.2


@dataclass(frozen=True)
class SacConfig(OffPolicyConfig):
    """Haarnoja et al. 2018: entropy is rewarded, with the weight that keeps it at a target."""

    name: ClassVar[str] = "sac"
    learning_rate: Positive = 7e-4
    target_entropy: float = -2.0  # nats per motor; lower means less exploration, as low outputs are rewarded


ENDS_IN_TANH = OffPolicyConfig | Ddpg1Config  # the actors of these
ALGORITHMS: dict[str, type[Algorithm]] = {
    algorithm.name: algorithm
    for algorithm in (
        PpoConfig,
        Ppo1Config,
        TrpoConfig,
        DdpgConfig,
        Ddpg1Config,
        Td3Config,
        SacConfig,
        PathwiseConfig,
    )
}
