"""The columns of a log in SI units: seconds, rad/s in body axes (x forward, y left, z up), fractions, volts.

Betaflight's gyro and setpoint have these axes already (measured on its SITL, whose simulator link turns them
on arrival), so nothing changes sign; only units do. Our own logs hold the float32 values themselves, where
their group EXACT is on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Array32, Flags
from neuroflight.sim.blackbox.firmware import Firmware, Maker, firmware, has_box_mask
from neuroflight.sim.blackbox.log import Log, floats
from neuroflight.sim.blackbox.motors import motor_idle, motors
from neuroflight.sim.blackbox.scales import current, fine, gyro_count, header_number, rotor_rpm, voltage
from neuroflight.sim.blackbox.sticks import Pilot, mode_flags, pilot
from neuroflight.toolchain.contract import DSHOT_STOP, GRAVITY, MOTOR_COUNT_MAX, Mix

PID_BIT = 1  # of our slow field nfFlags: the PID flies
ARM_BIT = 1  # in flightModeFlags, where its bits are boxes


@dataclass(frozen=True, eq=False)
class Channels:
    """N rows of a flight with M motors; None: the log does not have it."""

    clock_us: NDArray[np.int64]  # (N,) the log's own clock
    armed: Flags  # (N,)
    exact: bool  # setpoint, gyro and throttle are the bits that the controller had
    pilot: Pilot  # commands in the log's units, and the field they come from
    setpoint: Array32 | None  # (N, 3) [rad/s]; NaN where the stick commanded an angle
    gyro: Array32 | None  # (N, 3) [rad/s], filtered
    gyro_unfiltered: Array32 | None  # (N, 3) [rad/s]
    throttle: Array32 | None  # (N,) the pilot's thrust, 0..1; beyond where the log's number is no stick's
    motors: Array | None  # (N, M) fractions 0..1 as an ESC decodes them; NaN where a value is no motor's
    dshot: NDArray[np.uint16] | None  # (N, M) DShot values; of an analog protocol those that mean the same
    digital: bool  # the motors' protocol has such values
    motors_note: str  # for the user: on motor values, or why there are none; "": nothing
    rpm: Array | None  # (N, M) [rpm] of the rotors
    idle: float | None  # motor fraction at zero thrust
    mix: Mix | None  # of outputs and throttle; None: by another rule than ours
    voltage: Array | None  # (N,) [V]
    current: Array | None  # (N,) [A]
    acceleration: Array | None  # (N, 3) [m/s^2], specific force

    def time(self, start: int = 0) -> Array:
        """Time (N - start,) [s] of the rows from `start` on, 0 at that row, as a trace's t has it."""
        return np.asarray((self.clock_us[start:] - self.clock_us[start]) / 1e6, np.float64)


def channels(log: Log) -> Channels:
    """Convert the columns of `log` to these units."""
    told = firmware(log.header)
    count, parts = gyro_count(log.header, told), fine(log.header)
    turned = motors(log, told)
    forces, one_g = log.matrix("accSmooth", 3), log.headers.integer("acc_1G", 0)
    erpm = log.matrix("eRPM")
    armed = _armed(log, told, turned.dshot)
    exact = _exact(log)
    gyro: Array32 | None
    setpoint: Array32 | None
    throttle: Array32 | None
    if exact is not None:
        gyro, setpoint, throttle = exact
        rates = np.rad2deg(setpoint.astype(np.float64))
        asked = Pilot(rates, throttle.astype(np.float64), "setpointFloat[0..3]")
    else:
        gyro = _rates(log, "gyroADC", count, parts)
        asked = pilot(log, told, None if gyro is None else np.rad2deg(gyro.astype(np.float64)), armed)
        setpoint = None if asked.rates is None else np.deg2rad(asked.rates).astype(np.float32)
        throttle = None if asked.throttle is None else asked.throttle.astype(np.float32)
    return Channels(
        clock_us=log.time_us,
        armed=armed,
        exact=exact is not None,
        pilot=asked,
        setpoint=setpoint,
        gyro=gyro,
        gyro_unfiltered=_rates(log, "gyroUnfilt", count, parts),
        throttle=throttle,
        motors=turned.fractions,
        dshot=turned.dshot,
        digital=turned.digital,
        motors_note=turned.note,
        rpm=rotor_rpm(None if erpm is None else erpm[:, :MOTOR_COUNT_MAX], log.header),
        idle=_idle(log, armed),
        mix=_mix(log, armed),
        voltage=voltage(log.columns, log.header, told),
        current=current(log.columns, log.header, told),
        acceleration=None if forces is None or one_g < 1 else forces.astype(np.float64) * (GRAVITY / one_g),
    )


def control_rate_hz(log: Log) -> float:
    """Return control steps a second: from the header, otherwise from the rows; 0 if unknown."""
    told = header_number(log.header, "nf_control_rate")
    if told and told > 0:
        return told
    return log.rate_hz * log.stride


def _exact(log: Log) -> tuple[Array32, Array32, Array32] | None:
    """Return gyro, setpoint and throttle with the bits our controller had; None if these are not logged."""
    gyro, setpoint = log.matrix("gyroFloat", 3), log.matrix("setpointFloat", 4)
    if log.maker is not Maker.NEUROFLIGHT or gyro is None or setpoint is None:
        return None
    wanted = floats(setpoint)
    return floats(gyro), np.ascontiguousarray(wanted[:, :3]), np.ascontiguousarray(wanted[:, 3])


def _rates(log: Log, name: str, count: float | None, parts: float) -> Array32 | None:
    """Return a gyro's field [rad/s]; count: rad/s of one gyro count, parts: logged steps per count."""
    values = log.matrix(name, 3)
    if values is None and name == "gyroADC":
        values = log.matrix("gyroData", 3)  # its name in the first versions
    return None if values is None or count is None else (values * (count / parts)).astype(np.float32)


def _armed(log: Log, told: Firmware, dshot: NDArray[np.uint16] | None) -> Flags:
    """Return for each row whether motors are armed: by motor values, else by the boxes, else True for all.

    Firmware whose logs have neither logs only while the motors are armed.
    """
    if told.maker is Maker.NEUROFLIGHT and dshot is not None:
        return np.asarray((dshot > DSHOT_STOP).all(axis=1))
    flags = mode_flags(log)
    if flags is None or not has_box_mask(told):
        return np.ones(len(log), bool)
    return np.asarray((flags & ARM_BIT) != 0)


def _idle(log: Log, armed: Flags) -> float | None:
    """Return the idle of the controller that flew for longer; our header gives the policy's and the PID's."""
    if log.maker is Maker.NEUROFLIGHT:
        return _part(_controllers(log, "nf_idle", armed))
    return motor_idle(log)


def _mix(log: Log, armed: Flags) -> Mix | None:
    """Return the mix of the controller that flew for longer; old logs know only one mix."""
    if log.maker is not Maker.NEUROFLIGHT:
        return None
    told = _controllers(log, "nf_mix", armed)
    return {"": Mix.ATTITUDE_FIRST, **{mix.text: mix for mix in Mix}}.get(told)


def _controllers(log: Log, name: str, armed: Flags) -> str:
    """Return, of a header "policy's,PID's", the text of the controller that flew for longer."""
    told = log.header.get(name, "").split(",")
    flags = log.held("nfFlags")
    pid = flags is not None and bool(armed.any()) and float((flags[armed] & PID_BIT).mean()) > 0.5
    return told[1] if pid and len(told) > 1 else told[0]


def _part(text: str) -> float | None:
    """Parse a fraction of full power; None if the text is none."""
    try:
        part = float(text)
    except ValueError:
        return None
    return part if 0.0 <= part < 1.0 else None
