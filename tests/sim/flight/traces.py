"""Traces that tests make of rows."""

import numpy as np

from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.flight.trace import Trace


def trace_of(
    setpoint: Array | Array32, rate: Array, gyro: Array | Array32 | None = None, motors: Array | float = 0.25
) -> Trace:
    """A flight at 1 kHz of these rows (N, 3) [rad/s]; the gyro reads the rates if nothing else is told."""
    steps = len(rate)
    return Trace(
        t=np.arange(steps) / 1000,
        setpoint=np.asarray(setpoint, np.float32),
        rate=np.array(rate, np.float64),
        gyro=np.asarray(rate if gyro is None else gyro, np.float32),
        motors=np.broadcast_to(np.asarray(motors, np.float64), (steps, 4)).copy(),
        dshot=np.full((steps, 4), 548, np.uint16),
        throttle=np.zeros(steps, np.float32),
    )
