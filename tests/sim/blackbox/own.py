"""A log of ours as its firmware writes it, made of a trace: known to the bit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuroflight.sim.flight.trace import Trace
from neuroflight.toolchain.contract import FlightState
from tests.sim.blackbox.writer import END, PRODUCT, Column, event, fields, flight, header, slow

AXES = range(3)
LEAD = 7  # rows before the motors turn


def trace(steps: int, seed: int = 1, rate_hz: int = 1000) -> Trace:
    """A flight of noise around a held command, as a trace."""
    from neuroflight.sim.control.motors import motor_fractions

    rng = np.random.default_rng(seed)
    setpoint = np.zeros((steps, 3), np.float32)
    setpoint[steps // 8 :] = rng.normal(0, 2, 3).astype(np.float32)
    dshot = rng.integers(100, 2048, (steps, 4)).astype(np.uint16)
    return Trace(
        t=np.arange(steps) / rate_hz,
        setpoint=setpoint,
        rate=rng.normal(0, 3, (steps, 3)),
        gyro=(setpoint + rng.normal(0, 0.3, (steps, 3))).astype(np.float32),
        motors=motor_fractions(dshot),
        dshot=dshot,
        throttle=rng.uniform(0, 1, steps).astype(np.float32),
    )


COLUMNS = [
    *(Column(f"setpoint[{axis}]") for axis in range(4)),
    *(Column(f"gyroADC[{axis}]") for axis in AXES),
    *(Column(f"motor[{motor}]") for motor in range(4)),
    *(Column(f"gyroFloat[{axis}]") for axis in AXES),
    *(Column(f"setpointFloat[{axis}]") for axis in range(4)),
]


def log_of(
    flown: Trace,
    *,
    exact: bool = True,
    divider: int = 1,
    clock: Sequence[int] | None = None,
    own_flags: bool = False,
    **headers: object,
) -> bytes:
    """Encode LEAD disarmed rows, the flight, and LEAD disarmed rows.

    clock: time of each row [us]. own_flags: slow frames have nfFlags too, in the first the state DISARMED.
    """
    deg = np.rad2deg(flown.setpoint), np.rad2deg(flown.gyro)
    wanted = np.column_stack((deg[0], 1000 * flown.throttle))
    bits = np.column_stack((flown.gyro, flown.setpoint, flown.throttle)).astype(np.float32).view(np.int32)
    rows = np.column_stack((np.rint(wanted), np.rint(deg[1]), flown.dshot, bits)).astype(np.int64)
    still = np.zeros((LEAD, rows.shape[1]), np.int64)
    columns = COLUMNS if exact else COLUMNS[:11]
    whole = np.vstack((still, rows, still))[::divider, : len(columns)].tolist()
    rate = flown.control_rate_hz
    told = {
        "nf_version": "0.1.0",
        "nf_control_rate": rate,
        "nf_idle": "0.055,0.06",
        "gyro_scale": "0x3f800000",
        "motorOutput": "48,2047",
        "I interval": 32 * divider,
        "P interval": f"1/{divider}",
        **headers,
    }
    period = 1_000_000 * divider // rate
    frames = flight(columns, whole, period=period, divider=divider, clock=clock)
    first = {"flightModeFlags": 1, **({"nfFlags": FlightState.DISARMED << 1} if own_flags else {})}
    parts = (
        PRODUCT,
        header(told),
        fields(columns, list(first)),
        event(0, 5_000_000),
        slow([*first.values()]),
    )
    return b"".join((*parts, frames, event(15, 4), END))
