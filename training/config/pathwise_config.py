"""Hyperparameters of the pathwise gradient."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from neuroflight.sim.physics.world import COUNT_MAX

BATCH_STEPS_MAX = 6_000_000  # control steps of an update
BLOCK = 16  # aircraft that are flown side by side
BLOCK_STEPS_MAX = 600_000  # control steps of a block: half a gigabyte a core with two layers of 64
CHANGES = ("outputs", "motors")


@dataclass(frozen=True)
class PathwiseConfig:
    """SVG(inf), Heess et al. 2015: see `training.learners.pathwise.learner`.

    The loss is mean |e| + square e^2 [deg/s] + output mean(y) + change mean|dy| + closed mean(u), over axes,
    motors and control steps, weighted by the task; the last over those at closed throttle alone. Where a
    limit is given, the weight is adapted until the mean stays at the limit. The run's reward is not used: it
    has no derivatives.
    """

    name: ClassVar[str] = "pathwise"
    aircraft: int = 64  # each flies one episode for an update; a multiple of 16 leaves no lane empty
    learning_rate: float = 1e-2
    warm_up: int = 20  # updates in which the learning rate rises; then it falls to 2 % along half a cosine
    square: float = 0.03  # [s/deg], weight of the squared error
    soft: float = 0.0  # [deg/s]: |e| is rounded off to sqrt(e^2 + soft^2) - soft
    output: float = 8.0  # [deg/s], weight of the mean output; the initial one if there is a limit
    output_limit: float | None = 0.085  # target of the mean output
    change: float = 15.0  # [deg/s], weight of the mean change, likewise
    change_limit: float | None = 0.0095  # target of the mean change
    change_of: str = "outputs"  # in a control step; or "motors": of motor fractions after the mix, in 1 ms
    # Weight of the mean motor fraction above the idle while the throttle is closed [deg/s].
    closed: float = 0.0
    # Largest standard deviation [rad/s^2] of angular accelerations by moments from outside, as of drag in
    # fast air, that change within 0.15 s, and of one that stays; 30 % of the aircraft have none; a fifth of
    # it in yaw.
    disturbance: float = 0.0
    # Likewise between 3 and 80 Hz, as of prop wash; half the aircraft have none; a tenth of it in yaw.
    wash: float = 0.0
    adaption: float = 0.01  # greatest relative change of such a weight in an update
    adaption_start: float = 0.1  # part of the run before adaption starts; an early policy keeps no limit
    start_output: float = 0.1  # output of an untrained policy, motor fraction
    gradient_max: float = 1.0  # a longer gradient is scaled to this length
    outlier: float = 10.0  # times the usual length: a gradient that is longer changes nothing
    leg_steps: int = 500_000  # see Algorithm; rounded up to whole updates

    def errors(self, episode_steps: int) -> Iterator[str]:
        """See Algorithm."""
        if not 1 <= self.aircraft <= COUNT_MAX:
            yield f"{self.aircraft} aircraft, expected 1 to {COUNT_MAX}"
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
        if self.change_of not in CHANGES:
            yield f"change_of {self.change_of!r}, expected one of: {', '.join(CHANGES)}"
        for name, low, high in (
            ("learning_rate", 1e-7, 1.0),
            ("square", 0.0, 1e3),
            ("soft", 0.0, 1e3),
            ("output", 0.0, 1e6),
            ("change", 0.0, 1e6),
            ("closed", 0.0, 1e6),
            ("disturbance", 0.0, 1e4),
            ("wash", 0.0, 1e4),
            ("outlier", 1.0, 1e6),
            ("adaption", 0.0, 1.0),
            ("adaption_start", 0.0, 1.0),
            ("start_output", 0.0, 1.0),
            ("gradient_max", 1e-6, 1e6),
            ("warm_up", 0, 10**6),
            ("leg_steps", 1, 10**9),
        ):
            if not low <= (value := getattr(self, name)) <= high:
                yield f"{name} {value}, expected {low:g} to {high:g}"
        for name in ("output_limit", "change_limit"):
            limit = getattr(self, name)
            if limit is not None and not 0.0 < limit <= 1.0:
                yield f"{name} {limit}, expected above 0 and at most 1"
            if limit is not None and getattr(self, name.removesuffix("_limit")) <= 0.0:
                yield f"{name} {limit} with a weight of 0, which no adaption changes; give one above 0"
