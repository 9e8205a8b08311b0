"""Betaflight beside controllers: its defaults, or a pilot's settings, fly the same commands and noise.

Each command is flown by a Betaflight of its own, a copy of one that armed at rest (see
sim/ports/betaflight/fleet.py): an episode begins as every controller's, with rotors and integral at rest, and
knows nothing of the others. Flown first or tenth among others, an episode gives the same bits.

Its loop runs at each gyro sample and faster, with its own filters, mixer and idle; rows are kept at
1 kHz, as of the others. It tells no outputs before its mixer: what stands for them is its motor values above
idle, 0..1, which hold the throttle too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.control import sticks
from neuroflight.sim.physics.imu import counts
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.variation import Variation
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.betaflight.build import VERSION
from neuroflight.sim.ports.betaflight.fleet import ArmedBetaflight, BetaflightFleet
from neuroflight.sim.ports.betaflight.port import IDLE, ROW_RATE_HZ
from neuroflight.sim.ports.betaflight.tune import Tune
from neuroflight.toolchain.policy.gyro_filters import UNFILTERED, GyroFilters
from neuroflight.training.evaluation.evaluation import Event, Flights, Rows, drawn
from neuroflight.training.tasks.task import Task

BETAFLIGHT = "betaflight"


@dataclass(frozen=True)
class BetaflightSpec:
    """Betaflight with its default PID, filters, mixer and idle, or a pilot's."""

    armed: ArmedBetaflight
    name: str = BETAFLIGHT  # as the user wrote it
    control_rate_hz: ClassVar[int] = ROW_RATE_HZ
    gyro_filters: ClassVar[GyroFilters] = UNFILTERED  # its own take in all samples

    @property
    def label(self) -> str:
        """A short name for tables and plots."""
        return betaflight_label(self.armed.tune)

    @property
    def idle(self) -> float:
        """Motor fraction of armed motors at no thrust."""
        return betaflight_idle(self.armed.tune)

    @property
    def facts(self) -> dict[str, str]:
        """The description in a stored result."""
        return betaflight_facts(self.armed.tune)


def betaflight_label(tune: Tune | None) -> str:
    """Return a short name of Betaflight with these settings."""
    return "Betaflight 4.6" if tune is None else f"Betaflight 4.6 {tune.name}"


def betaflight_idle(tune: Tune | None) -> float:
    """Return the motor fraction of its armed motors at no thrust."""
    own = None if tune is None else tune.idle
    return IDLE if own is None else own


def betaflight_facts(tune: Tune | None) -> dict[str, str]:
    """Return the description of Betaflight with these settings in a stored result."""
    own = (
        {} if tune is None else {"betaflight_settings": tune.name, "betaflight_settings_sha256": tune.sha256}
    )
    return {BETAFLIGHT: VERSION, **own}


def record_betaflight(
    armed: Sequence[ArmedBetaflight],
    aircraft: Aircraft,
    task: Task,
    *,
    episodes: int,
    seed: int,
    mount: Mount = Mount.CENTRE,
    ground: bool = False,
    noise: bool = True,
    throttle: float | NDArray[np.float32] = 0.0,
    charge: float | None = None,
    variation: Variation | None = None,
    event: Event | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Flights:
    """Fly `episodes` commands of `task`, a Betaflight and an aircraft each, all at once; see `record`.

    armed: those that are flown, each by an equal share of the episodes, one share after the other.
    Commands and throttle are rounded to what sticks can say, and errors are to these setpoints. Raises
    LinkError when a Betaflight fails, ScenarioError on commands beyond full stick.
    """
    commands, noise_rng = drawn(seed)
    wanted = task.episodes(episodes, commands, ROW_RATE_HZ)
    steps, samples = wanted.shape[1], armed[0].gyro_rate_hz // ROW_RATE_HZ
    thrust = np.broadcast_to(np.asarray(throttle, np.float32).T, (steps, episodes))
    rows = Rows(steps, episodes, aircraft.motor_count)
    setpoints = np.empty((steps, episodes, 3), np.float32)
    twin = Twin(
        aircraft,
        episodes,
        rate_hz=armed[0].gyro_rate_hz,
        mount=mount,
        ground=ground,
        noise=noise,
        charge=charge,
        variation=variation,
        rng=noise_rng,
    )
    with closing(twin), BetaflightFleet(armed, twin.live) as fleet:
        before = None
        for k in range(steps):
            if event is not None and k == round(event.at_s * ROW_RATE_HZ):
                event.change(twin)
            asked = (wanted[:, k].tobytes(), thrust[k].tobytes())
            frame = None
            if asked != before:
                frame = sticks.channels(np.rad2deg(wanted[:, k]), thrust[k], armed=True)
                before = asked
            setpoints[k] = setpoints[k - 1] if frame is None else sticks.setpoint(frame)
            for sample in range(samples):
                motors = fleet.exchange(counts(twin.live.gyro), frame if sample == 0 else None)
                if sample == 0:
                    rows.put(k, twin, motors)
                twin.step(motors)
            if progress is not None:
                progress(k + 1, steps)
    idle = np.repeat([betaflight_idle(one.tune) for one in armed], episodes // len(armed))[:, None]
    np.divide(rows.motors - idle.astype(np.float32), (1.0 - idle).astype(np.float32), out=rows.output)
    return rows.flights(setpoints.swapaxes(0, 1), 1.0 / ROW_RATE_HZ, task, samples)
