"""A run's log, two clocks and counts, to a recording that `dyno fit` reads: one clock and SI units."""

from __future__ import annotations

import numpy as np

from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.identification.bench.clocks import Clock, fit_clock
from neuroflight.sim.identification.bench.drive import Log
from neuroflight.sim.identification.bench.quantities import Rig, own_time, speed_of, thrust_of, torque_of
from neuroflight.sim.identification.dyno.recording import ROWS_MIN, Recording
from neuroflight.toolchain.errors import DynoError

UNEVEN_S = 0.05  # lines of a sensor without a clock may be late by so much


def reduce_log(log: Log, rig: Rig) -> tuple[Recording, Clock]:
    """Convert `log` to a recording, and return the sensor's clock with it.

    Throttle is the command in force at each row. Thrust and torque are turned such that both are above zero
    while the rotor turns, as the sense of the rotor decides about one, and how a cell is mounted about both.
    Raises DynoError where rows are too few or their times do not go together.
    """
    if len(log.arrival) < ROWS_MIN:
        raise DynoError(
            f"{len(log.arrival)} readings, expected at least {ROWS_MIN}; send more lines a second"
        )
    own = own_time(rig, log.values)
    if own is None:
        own, clock = _counted(log.arrival)
        rising = np.ones(len(own), bool)
    else:
        rising = np.concatenate([[True], np.diff(own) > 0])  # a line that came twice
        clock = fit_clock(own[rising], log.arrival[rising])
    values, time = log.values[rising], clock.host(own[rising])
    speed = speed_of(rig, values, time)
    command = np.maximum(np.searchsorted(log.command_time, time, side="right") - 1, 0)
    throttle = log.throttle[command]
    thrust, torque = (of(rig, values, log.zeros) for of in (thrust_of, torque_of))
    turning = speed > 0.5 * speed.max()
    return (
        Recording(time, throttle, speed, _upright(thrust, turning), _upright(torque, turning)),
        clock,
    )


def _upright(values: Array, turning: Flags) -> Array:
    return -values if turning.any() and np.median(values[turning]) < 0 else values


def _counted(arrival: Array) -> tuple[Array, Clock]:
    """Return the time of a sensor without a clock that sends at an even rate, by the number of the row."""
    period = float(arrival[-1] - arrival[0]) / (len(arrival) - 1)
    own: Array = np.arange(len(arrival), dtype=np.float64) * period
    clock = fit_clock(own, arrival)
    late = float((arrival - clock.host(own)).max())
    if late > UNEVEN_S:
        raise DynoError(
            f"lines of the sensor were late by up to {1000 * late:.0f} ms, or some were lost, expected "
            f"{1000 * UNEVEN_S:.0f} ms at most of a sensor without a clock; let it send time_us"
        )
    return own, clock
