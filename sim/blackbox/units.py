"""What a log says of a flight in the units of this house: seconds, rad/s in body axes (x forward, y left,
z up), fractions, volts.

Betaflight's gyro and setpoint have these axes already (measured on its SITL, whose simulator link turns them
on arrival), so nothing changes sign; only units do. Our own logs hold the float32 values themselves, where
their group EXACT is on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.blackbox.log import Log, Maker, floats, header_float
from sim.control.motors import motor_fractions
from toolchain.contract import DSHOT_MAX, DSHOT_MIN, DSHOT_SPAN, DSHOT_STOP, GRAVITY, MOTOR_COUNT_MAX, Mix

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

BASEFLIGHT_SCALE = 1e-5  # a gyro_scale below it is in rad/us, as Baseflight had it; others are in deg/s
PULSE_STOP_US, PULSE_FULL_US = 1000.0, 2000.0  # motor values of an analog protocol
PID_BIT = 1  # of our slow field nfFlags: the PID flies
ARM_BIT = 1  # of flightModeFlags, Betaflight's and ours
CENTIVOLTS_FROM = (4, 0)  # Betaflight's version since which vbatLatest is in 0.01 V


@dataclass(frozen=True, eq=False)
class Channels:
    """N rows of a flight with M motors; None: the log does not have it."""

    clock_us: NDArray[np.int64]  # (N,) the log's own clock
    armed: NDArray[np.bool_]  # (N,)
    exact: bool  # setpoint, gyro and throttle are the bits that the controller had
    setpoint: Floats | None  # (N, 3) [rad/s]
    gyro: Floats | None  # (N, 3) [rad/s], filtered
    gyro_unfiltered: Floats | None  # (N, 3) [rad/s]
    throttle: Floats | None  # (N,) the pilot's thrust, 0..1
    motors: Array | None  # (N, M) fractions 0..1 as an ESC decodes them
    dshot: NDArray[np.uint16] | None  # (N, M) DShot values; of an analog protocol those that mean the same
    digital: bool  # the motors' protocol has such values
    idle: float | None  # motor fraction at zero thrust
    mix: Mix | None  # of outputs and throttle; None: by another rule than ours
    voltage: Array | None  # (N,) [V]
    current: Array | None  # (N,) [A]
    acceleration: Array | None  # (N, 3) [m/s^2], specific force

    def time(self, start: int = 0) -> Array:
        """Time (N - start,) [s] of the rows from `start` on, 0 at that row, as a trace's t has it."""
        return np.asarray((self.clock_us[start:] - self.clock_us[start]) / 1e6, np.float64)


def channels(log: Log) -> Channels:
    """Columns of `log` in units."""
    scale = _gyro_scale(log)
    fine = 10.0 if log.headers.integer("blackbox_high_resolution", 0) else 1.0
    gyro, setpoint = log.matrix("gyroADC", 3), log.matrix("setpoint", 4)
    exact_gyro, exact_setpoint = log.matrix("gyroFloat", 3), log.matrix("setpointFloat", 4)
    exact = log.maker is Maker.NEUROFLIGHT and exact_gyro is not None and exact_setpoint is not None
    unfiltered = log.matrix("gyroUnfilt", 3)
    dshot, motors, digital = _motors(log)
    forces, one_g = log.matrix("accSmooth", 3), log.headers.integer("acc_1G", 0)
    armed = _armed(log, dshot)
    rates: Floats | None
    wanted: Floats | None
    throttle: Floats | None
    if exact and exact_gyro is not None and exact_setpoint is not None:
        rates, wanted, throttle = _exact(exact_gyro, exact_setpoint)
    else:
        rates = None if gyro is None else (gyro * (scale / fine)).astype(np.float32)
        wanted = None if setpoint is None else np.deg2rad(setpoint[:, :3] / fine).astype(np.float32)
        throttle = None if setpoint is None else np.clip(setpoint[:, 3] / 1000.0, 0, 1).astype(np.float32)
    return Channels(
        clock_us=log.time_us,
        armed=armed,
        exact=exact,
        setpoint=wanted,
        gyro=rates,
        gyro_unfiltered=None if unfiltered is None else (unfiltered * (scale / fine)).astype(np.float32),
        throttle=throttle,
        motors=motors,
        dshot=dshot,
        digital=digital,
        idle=_idle(log, armed),
        mix=_mix(log, armed),
        voltage=_hundredths(log, "vbatLatest"),
        current=_hundredths(log, "amperageLatest"),
        acceleration=None if forces is None or one_g < 1 else forces.astype(np.float64) * (GRAVITY / one_g),
    )


def control_rate_hz(log: Log) -> float:
    """Control steps a second: as the header says, else as rows come; 0 where nothing tells."""
    told = header_float(log.headers, "nf_control_rate")
    if told and told > 0:
        return told
    return log.rate_hz * log.stride


def version(log: Log) -> tuple[int, ...]:
    """The version in `Firmware revision:Betaflight 4.6.0 ..`; empty for others."""
    parts = log.header.get("Firmware revision", "").split()
    numbers = parts[1].split(".") if len(parts) > 1 and parts[0] == "Betaflight" else []
    return tuple(int(one) for one in numbers if one.isdigit() and len(one) < 6)


def _exact(gyro: NDArray[np.int64], setpoint: NDArray[np.int64]) -> tuple[Floats, Floats, Floats]:
    wanted = floats(setpoint)
    return floats(gyro), np.ascontiguousarray(wanted[:, :3]), np.ascontiguousarray(wanted[:, 3])


def _gyro_scale(log: Log) -> float:
    """[rad/s] of one count of gyroADC."""
    scale = header_float(log.headers, "gyro_scale")
    if scale is None or scale <= 0:
        scale = 1.0
    return scale * 1e6 if scale < BASEFLIGHT_SCALE else float(np.deg2rad(scale))


def _armed(log: Log, dshot: NDArray[np.uint16] | None) -> NDArray[np.bool_]:
    """By the motors where the values say so, else by the flags, else everywhere."""
    if log.maker is Maker.NEUROFLIGHT and dshot is not None:
        return np.asarray((dshot > DSHOT_STOP).all(axis=1))
    flags = log.held("flightModeFlags")
    if flags is None or log.maker is Maker.OTHER:
        return np.ones(len(log), bool)
    return np.asarray((flags & ARM_BIT) != 0)


def _motors(log: Log) -> tuple[NDArray[np.uint16] | None, Array | None, bool]:
    """DShot values, fractions, and whether the protocol is digital."""
    values = log.matrix("motor")
    if values is None:
        return None, None, False
    values = values[:, :MOTOR_COUNT_MAX]
    output = log.headers.integers("motorOutput")
    if log.maker is Maker.NEUROFLIGHT or (len(output) == 2 and output[1] > PULSE_FULL_US):
        bounded = np.where(values < DSHOT_MIN, DSHOT_STOP, np.minimum(values, DSHOT_MAX)).astype(np.uint16)
        return bounded, motor_fractions(bounded), True
    fraction = np.clip((values - PULSE_STOP_US) / (PULSE_FULL_US - PULSE_STOP_US), 0.0, 1.0)
    dshot = np.where(fraction > 0, DSHOT_MIN + np.floor(DSHOT_SPAN * fraction + 0.5), DSHOT_STOP)
    return dshot.astype(np.uint16), fraction, False


def _idle(log: Log, armed: NDArray[np.bool_]) -> float | None:
    """Ours tells the policy's and the PID's: that of the one that flew for longer."""
    if log.maker is Maker.NEUROFLIGHT:
        return _part(_controllers(log, "nf_idle", armed))
    output = log.headers.integers("motorOutput")
    if len(output) != 2:
        return None
    if output[1] > PULSE_FULL_US:
        return max(0.0, (output[0] - DSHOT_MIN) / DSHOT_SPAN)
    return min(1.0, max(0.0, (output[0] - PULSE_STOP_US) / (PULSE_FULL_US - PULSE_STOP_US)))


def _mix(log: Log, armed: NDArray[np.bool_]) -> Mix | None:
    """Ours tells that of both, too; logs from before there were two mixes do not."""
    if log.maker is not Maker.NEUROFLIGHT:
        return None
    told = _controllers(log, "nf_mix", armed)
    return {"": Mix.ATTITUDE_FIRST, **{mix.text: mix for mix in Mix}}.get(told)


def _controllers(log: Log, name: str, armed: NDArray[np.bool_]) -> str:
    """Of a header "policy's,PID's" the text of the one that flew for longer."""
    told = log.header.get(name, "").split(",")
    flags = log.held("nfFlags")
    pid = flags is not None and bool(armed.any()) and float((flags[armed] & PID_BIT).mean()) > 0.5
    return told[1] if pid and len(told) > 1 else told[0]


def _part(text: str) -> float | None:
    """A part of full power; None where the text is none."""
    try:
        part = float(text)
    except ValueError:
        return None
    return part if 0.0 <= part < 1.0 else None


def _hundredths(log: Log, name: str) -> Array | None:
    values = log.columns.get(name)
    known = log.maker is Maker.NEUROFLIGHT or version(log) >= CENTIVOLTS_FROM
    return None if values is None or not known else values / 100.0
