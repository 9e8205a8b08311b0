"""Hyperparameters of the algorithms, as frozen data; names as in Stable-Baselines3 where it has them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Protocol

from neuroflight.sim.physics.world import COUNT_MAX
from neuroflight.training.config.pathwise_config import PathwiseConfig

REPEATS_MAX = 10_000  # of repetitions in an update: more would take longer than a day
LEG_MAX = 1_000_000  # of what a segment repeats
BUFFER_MAX = 10_000_000  # control steps: more are larger than any checkpoint
LOG_STD_MAX = 10.0
DISTRIBUTIONS = ("normal", "beta")
BETA_LOG_STD_MAX = -0.5 * math.log(3.0)  # all outputs in -1..1 equally likely
MOST = {"leg": LEG_MAX, "minibatch": BUFFER_MAX, "horizon": BUFFER_MAX}  # these have their own error messages


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


@dataclass(frozen=True)
class PpoConfig:
    """Schulman et al. 2017, with smoothness of the mean output in the policy's loss.

    Outputs are drawn from a normal distribution, or with `OutputMap.squash` from tanh of one: bounded. The
    factor that tanh puts on a probability is the same before and after an update, so it cancels in the ratio.
    Or they are drawn from a beta distribution, which is bounded itself: see `training.learners.exploration`.
    """

    name: ClassVar[str] = "ppo"
    aircraft: int = 256
    horizon: int = 128  # control steps of each aircraft between updates
    minibatch: int = 4096  # divides the steps of a rollout
    epochs: int = 3  # passes over a rollout
    learning_rate: float = 7e-4  # annealed linearly to a tenth
    discount: float = 0.99  # at 1 kHz: a horizon of 100 ms
    gae_lambda: float = 0.98  # rotors respond within 40 ms: credit must reach back that far
    clip: float = 0.2
    log_std: tuple[float, float] = (-1.0, -2.5)  # exploration, network output units, first to last step
    hold: int = 8  # control steps for which a draw of the exploration is held
    distribution: str = "normal"  # or "beta", which needs `output.squash`
    smoothness_spatial: float = 1.0  # weight of the mean output's change under gyro noise
    smoothness_temporal: float = 0.0  # of its change from a control step to the next
    leg: int = 16  # rollouts

    @property
    def leg_steps(self) -> int:
        """See Algorithm."""
        return self.leg * self.aircraft * self.horizon

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from _count_errors(self, ("horizon", "minibatch", "epochs", "hold", "leg"))
        yield from _number_errors(self, positive=("learning_rate", "clip"))
        yield from _share_errors(self, ("discount", "gae_lambda"))
        yield from _number_errors(self, not_negative=("smoothness_spatial", "smoothness_temporal"))
        if self.distribution not in DISTRIBUTIONS:
            yield f"distribution {self.distribution!r}, expected one of: {', '.join(DISTRIBUTIONS)}"
        if self.distribution == "beta" and not max(self.log_std) <= BETA_LOG_STD_MAX:
            yield (
                f"log_std {list(self.log_std)}, expected at most {BETA_LOG_STD_MAX:.3f}: a beta distribution "
                f"is no wider"
            )
        yield from _rollout_errors(self.aircraft, self.horizon, self.minibatch, episode_steps)


@dataclass(frozen=True)
class Ppo1Config:
    """PPO as OpenAI Baselines' PPO1 has it, Koch 2019's learner; see `training.learners.ppo1.learner`.

    Its horizon (Tables 3.1, 4.2, 5.5) is `aircraft` times `horizon` here. The defaults are Table 3.1's.
    """

    name: ClassVar[str] = "ppo1"
    aircraft: int = 16
    horizon: int = 128  # control steps of each aircraft between updates
    minibatch: int = 64  # samples of a rollout that do not fill one are left out of an epoch
    epochs: int = 10  # passes over a rollout
    learning_rate: float = 3e-4
    discount: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy: float = 0.0  # weight of the distribution's entropy in the loss
    log_std: float = 0.0  # exploration at first, network output units; learned
    anneal: bool = True  # learning rate and clip range fall linearly to 0 over the run
    leg: int = 48  # rollouts

    @property
    def leg_steps(self) -> int:
        """See Algorithm."""
        return self.leg * self.aircraft * self.horizon

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from _aircraft_errors(self.aircraft)
        yield from _count_errors(self, ("horizon", "minibatch", "epochs", "leg"))
        yield from _number_errors(self, positive=("learning_rate", "clip"), not_negative=("entropy",))
        yield from _share_errors(self, ("discount", "gae_lambda"))
        if not abs(self.log_std) <= LOG_STD_MAX:
            yield f"log_std {self.log_std}, expected {-LOG_STD_MAX:g} to {LOG_STD_MAX:g}"
        batch = self.aircraft * self.horizon
        if not self.minibatch <= batch <= BUFFER_MAX:
            yield (
                f"a rollout has {batch} steps ({self.aircraft} aircraft x {self.horizon}), expected at least "
                f"the minibatch of {self.minibatch} and at most {BUFFER_MAX}"
            )


@dataclass(frozen=True)
class TrpoConfig:
    """Schulman et al. 2015: the largest step along the natural gradient within a distance of the old policy.

    Its exploration is learned. Bounded outputs as in PPO.
    """

    name: ClassVar[str] = "trpo"
    aircraft: int = 256
    horizon: int = 64  # control steps of each aircraft between updates
    target_kl: float = 0.01
    cg_max_steps: int = 15  # of conjugate gradients
    cg_damping: float = 0.1
    critic_updates: int = 4  # passes of the critic over a rollout
    minibatch: int = 2048  # of the critic
    learning_rate: float = 1e-3  # of the critic, annealed linearly to a tenth
    discount: float = 0.99
    gae_lambda: float = 0.98
    log_std: float = -1.0  # exploration at first, network output units
    leg: int = 16  # rollouts

    @property
    def leg_steps(self) -> int:
        """See Algorithm."""
        return self.leg * self.aircraft * self.horizon

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from _count_errors(self, ("horizon", "minibatch", "cg_max_steps", "critic_updates", "leg"))
        yield from _number_errors(self, positive=("learning_rate", "target_kl"))
        yield from _number_errors(self, not_negative=("cg_damping",))
        yield from _share_errors(self, ("discount", "gae_lambda"))
        yield from _rollout_errors(self.aircraft, self.horizon, self.minibatch, episode_steps)


@dataclass(frozen=True)
class OffPolicyConfig:
    """Common to DDPG, TD3 and SAC: they learn from a replay buffer of steps, and their actor ends in tanh.

    All aircraft take a control step, then `gradient_steps` updates follow.
    """

    aircraft: int = 64
    gradient_steps: int = 16  # updates after each control step of all aircraft
    minibatch: int = 256
    buffer: int = 100_000  # control steps kept, all aircraft together; part of every checkpoint
    learning_starts: int = 8192  # control steps with uniformly drawn outputs, before the first update
    learning_rate: float = 1e-3  # annealed linearly to a tenth
    discount: float = 0.99
    tau: float = 0.005  # share of the network in its target after each update
    leg: int = 256  # control steps of each aircraft

    @property
    def leg_steps(self) -> int:
        """See Algorithm."""
        return self.leg * self.aircraft

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from _aircraft_errors(self.aircraft)
        yield from _count_errors(self, ("gradient_steps", "minibatch", "leg"))
        yield from _number_errors(self, positive=("learning_rate",), not_negative=("learning_starts",))
        yield from _share_errors(self, ("discount", "tau"))
        if not max(self.minibatch, self.aircraft) <= self.buffer:
            yield f"buffer {self.buffer}, expected at least the minibatch and the number of aircraft"
        if self.buffer > BUFFER_MAX:
            yield f"buffer {self.buffer}, expected at most {BUFFER_MAX}"


@dataclass(frozen=True)
class DdpgConfig(OffPolicyConfig):
    """Lillicrap et al. 2016, exploring with normal noise."""

    name: ClassVar[str] = "ddpg"
    noise: tuple[float, float] = (0.2, 0.05)  # exploration: of an output in -1..1, first to last step
    hold: int = 8  # control steps for which a draw of the exploration is held

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from super().errors(episode_steps)
        yield from _noise_errors(self.noise)
        yield from _count_errors(self, ("hold",))


@dataclass(frozen=True)
class Ddpg1Config:
    """DDPG as OpenAI Baselines had it in 2018, Koch 2019's learner; see `training.learners.ddpg1.learner`.

    Its rollout steps (Table 3.3) are `aircraft` times `horizon` here. The defaults are Table 3.3's, and
    Baselines' where the table has none, but for `buffer` and `critic_decay`. The actor ends in tanh.
    """

    name: ClassVar[str] = "ddpg1"
    aircraft: int = 20
    horizon: int = 5  # control steps of each aircraft between updates
    updates: int = 50  # after each rollout
    minibatch: int = 64
    buffer: int = 200_000  # control steps kept, all aircraft together; part of every checkpoint
    learning_rate: float = 1e-3  # of the critic
    actor_learning_rate: float = 1e-4
    critic_decay: float = 0.0  # weight of the critic's squared weights, halved, in its loss
    discount: float = 0.99
    tau: float = 0.01  # share of the network in its target after each update
    noise: float = 0.2  # of the actor's parameters at first, then as much as changes an output by that much
    leg: int = 400  # rollouts

    @property
    def leg_steps(self) -> int:
        """See Algorithm."""
        return self.leg * self.aircraft * self.horizon

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from _aircraft_errors(self.aircraft)
        yield from _count_errors(self, ("horizon", "updates", "minibatch", "leg"))
        yield from _number_errors(
            self, positive=("learning_rate", "actor_learning_rate", "noise"), not_negative=("critic_decay",)
        )
        yield from _share_errors(self, ("discount", "tau", "noise"))
        rollout = self.aircraft * self.horizon
        if not max(self.minibatch, rollout) <= self.buffer <= BUFFER_MAX:
            yield (
                f"buffer {self.buffer}, expected at least the minibatch of {self.minibatch} and a rollout's "
                f"{rollout} steps, and at most {BUFFER_MAX}"
            )


@dataclass(frozen=True)
class Td3Config(OffPolicyConfig):
    """Fujimoto et al. 2018: the lower of two critics counts, and the actor is updated less often."""

    name: ClassVar[str] = "td3"
    noise: tuple[float, float] = (0.2, 0.05)  # exploration: of an output in -1..1, first to last step
    hold: int = 8  # control steps for which a draw of the exploration is held
    policy_delay: int = 2  # updates of the critics for one of the actor
    target_noise: float = 0.1  # of the target's output
    target_noise_clip: float = 0.2

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from super().errors(episode_steps)
        yield from _noise_errors(self.noise)
        yield from _count_errors(self, ("policy_delay", "hold"))
        yield from _number_errors(self, positive=("target_noise",), not_negative=("target_noise_clip",))


@dataclass(frozen=True)
class SacConfig(OffPolicyConfig):
    """Haarnoja et al. 2018: entropy is rewarded, with the weight that keeps it at a target."""

    name: ClassVar[str] = "sac"
    learning_rate: float = 7e-4
    target_entropy: float = -2.0  # nats per motor; lower means less exploration, as low outputs are rewarded


def _aircraft_errors(count: int) -> Iterator[str]:
    if not 1 <= count <= COUNT_MAX:
        yield f"{count} aircraft, expected 1 to {COUNT_MAX}"


def _rollout_errors(aircraft: int, horizon: int, minibatch: int, episode_steps: int) -> Iterator[str]:
    yield from _aircraft_errors(aircraft)
    batch = aircraft * horizon
    if not 1 <= horizon <= episode_steps:
        yield f"horizon {horizon}, expected 1 to the {episode_steps} control steps of an episode"
    if batch > 0 and (minibatch < 1 or batch % minibatch):
        yield (
            f"minibatch {minibatch} does not divide the {batch} steps of a rollout "
            f"({aircraft} aircraft x {horizon}); choose a divisor"
        )


def _count_errors(config: object, names: tuple[str, ...]) -> Iterator[str]:
    for name in names:
        most = MOST.get(name, REPEATS_MAX)
        if not 1 <= getattr(config, name) <= most:
            yield f"{name} {getattr(config, name)}, expected at least 1 and at most {most}"


def _number_errors(
    config: object, positive: tuple[str, ...] = (), not_negative: tuple[str, ...] = ()
) -> Iterator[str]:
    for name in (*positive, *not_negative):
        value = getattr(config, name)
        if not 0.0 <= value < math.inf or (name in positive and value == 0.0):
            yield f"{name} {value}, expected {'more than' if name in positive else 'at least'} 0"


def _share_errors(config: object, names: tuple[str, ...]) -> Iterator[str]:
    for name in names:
        if not 0.0 <= getattr(config, name) <= 1.0:
            yield f"{name} {getattr(config, name)}, expected 0 to 1"


def _noise_errors(noise: tuple[float, float]) -> Iterator[str]:
    if not all(0.0 <= deviation <= 1.0 for deviation in noise):
        yield f"noise {list(noise)}, expected 0 to 1 each: outputs lie in -1 to 1"


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
