"""Hyperparameters of the pathwise gradient."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar

from neuroflight.sim.physics.world import COUNT_MAX
from neuroflight.training.tasks.limits import Limits, OneOf, Share, value_errors

BATCH_STEPS_MAX = 6_000_000  # control steps of an update
BLOCK = 16  # aircraft that are flown side by side
BLOCK_STEPS_MAX = 600_000  # control steps of a block: half a gigabyte a core with two layers of 64
Weight = Annotated[float, Limits(0.0, 1e6)]
Limit = Annotated[float | None, Limits(0.0, 1.0, above=True)]
Acceleration = Annotated[float, Limits(0.0, 1e4)]


@dataclass(frozen=True)
class PathwiseConfig:
    """SVG(inf), Heess et al. 2015: see `training.learners.pathwise.learner`.

    The loss is mean |e| + square e^2 [deg/s] + output mean(y) + change mean|dy| + closed mean(u), over axes,
    motors and control steps, weighted by the task; the last over those at closed throttle alone. Where a
    limit is given, the weight is adapted until the mean stays at the limit. The run's reward is not used: it
    has no derivatives.
    """

    name: ClassVar[str] = "pathwise"
    # Each flies one episode for an update; a multiple of 16 leaves no lane empty.
    aircraft: Annotated[int, Limits(1, COUNT_MAX)] = 64
    learning_rate: Annotated[float, Limits(1e-7, 1.0)] = 1e-2
    # Updates in which the learning rate rises; then it falls to 2 % along half a cosine.
    warm_up: Annotated[int, Limits(0, 10**6)] = 20
    square: Annotated[float, Limits(0.0, 1e3)] = 0.03  # [s/deg], weight of the squared error
    # [deg/s]: |e| is rounded off to sqrt(e^2 + soft^2) - soft.
    soft: Annotated[float, Limits(0.0, 1e3)] = 0.0
    output: Weight = 8.0  # [deg/s], weight of the mean output; the initial one if there is a limit
    output_limit: Limit = 0.085  # target of the mean output
    change: Weight = 15.0  # [deg/s], weight of the mean change, likewise
    change_limit: Limit = 0.0095  # target of the mean change
    # In a control step; or "motors": of motor fractions after the mix, in 1 ms.
    change_of: Annotated[str, OneOf(("outputs", "motors"))] = "outputs"
    # Weight of the mean motor fraction above the idle while the throttle is closed [deg/s].
    closed: Weight = 0.0
    # Largest standard deviation [rad/s^2] of angular accelerations by moments from outside, as of drag in
    # fast air, that change within 0.15 s, and of one that stays; 30 % of the aircraft have none; a fifth of
    # it in yaw.
    disturbance: Acceleration = 0.0
    # Likewise between 3 and 80 Hz, as of prop wash; half the aircraft have none; a tenth of it in yaw.
    wash: Acceleration = 0.0
    adaption: Share = 0.01  # greatest relative change of such a weight in an update
    adaption_start: Share = 0.1  # part of the run before adaption starts; an early policy keeps no limit
    start_output: Share = 0.1  # output of an untrained policy, motor fraction
    gradient_max: Annotated[float, Limits(1e-6, 1e6)] = 1.0  # a longer gradient is scaled to this length
    # Times the usual length: a gradient that is longer changes nothing.
    outlier: Annotated[float, Limits(1.0, 1e6)] = 10.0
    # See Algorithm; rounded up to whole updates.
    leg_steps: Annotated[int, Limits(1, 10**9)] = 500_000

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        yield from value_errors(self)
        if self.aircraft * episode_steps > BATCH_STEPS_MAX:
            yield (
                f"{self.aircraft} aircraft with episodes of {episode_steps} control steps, expected at most "
                f"{BATCH_STEPS_MAX} steps of memory; choose fewer, or a task with short episodes"
            )
        if BLOCK * episode_steps > BLOCK_STEPS_MAX:
            yield (
                f"episodes of {episode_steps} control steps, expected at most {BLOCK_STEPS_MAX // BLOCK} of "
                f"memory; choose a task with shorter episodes"
            )
        for name in ("output_limit", "change_limit"):
            limit = getattr(self, name)
            if limit is not None and getattr(self, name.removesuffix("_limit")) <= 0.0:
                yield f"{name} {limit} with a weight of 0, which no adaption changes; give one above 0"
