"""The algorithms' knobs, as plain frozen data; names as in Stable-Baselines3 where it has them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Protocol

from sim.world import COUNT_MAX


class Algorithm(Protocol):
    """Knobs of one algorithm, with a name in `ALGORITHMS`."""

    name: ClassVar[str]

    @property
    def aircraft(self) -> int:
        """Side by side in the twin."""
        ...

    @property
    def leg_steps(self) -> int:
        """Control steps, all aircraft together, of a leg: what is learnt between two possible checkpoints.

        Every leg begins with new episodes and chance of its own, so that a run resumed at a leg's end goes
        on as if it had never stopped.
        """
        ...

    def refusals(self, episode_steps: int) -> Iterator[str]:
        """What cannot be run, one line each; episode_steps: control steps of an episode."""
        ...


@dataclass(frozen=True)
class PpoConfig:
    """Schulman et al. 2017, with smoothness of the mean output in the policy's loss."""

    name: ClassVar[str] = "ppo"
    aircraft: int = 256
    horizon: int = 128  # control steps an aircraft between updates
    minibatch: int = 8192
    epochs: int = 4
    learning_rate: float = 7e-4  # annealed linearly to a tenth
    discount: float = 0.99  # at 1 kHz: a horizon of 100 ms
    gae_lambda: float = 0.98  # rotors answer over 40 ms: credit must reach back as far
    clip: float = 0.2
    log_std: tuple[float, float] = (-1.0, -2.5)  # exploration, network output units, first to last step
    smoothness: float = 0.45  # weight of the mean output's change under gyro noise, see smooth_ppo
    leg: int = 16  # rollouts

    @property
    def leg_steps(self) -> int:
        """See Algorithm."""
        return self.leg * self.aircraft * self.horizon

    def refusals(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        batch = self.aircraft * self.horizon
        if not 1 <= self.aircraft <= COUNT_MAX:
            yield f"{self.aircraft} aircraft, expected 1 to {COUNT_MAX}"
        if not 1 <= self.horizon <= episode_steps:
            yield f"horizon {self.horizon}, expected 1 to the {episode_steps} control steps of an episode"
        if batch and (self.minibatch < 1 or batch % self.minibatch):
            yield (
                f"minibatch {self.minibatch} does not divide the {batch} steps of a rollout "
                f"({self.aircraft} aircraft x {self.horizon}); choose a divisor"
            )


ALGORITHMS: dict[str, type[Algorithm]] = {algorithm.name: algorithm for algorithm in (PpoConfig,)}
