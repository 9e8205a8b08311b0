"""Motor values of a log as fractions of full power and as DShot values, by the protocol that wrote them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.firmware import Firmware, Maker
from neuroflight.sim.blackbox.headers import FieldDefinition
from neuroflight.sim.blackbox.log import Log
from neuroflight.sim.blackbox.scales import header_number
from neuroflight.sim.control.motors import motor_fractions
from neuroflight.toolchain.contract import DSHOT_MAX, DSHOT_MIN, DSHOT_SPAN, DSHOT_STOP, MOTOR_COUNT_MAX

Words = NDArray[np.uint16]

PULSE_STOP_US, PULSE_FULL_US = 1000.0, 2000.0  # motor values of an analog protocol
PULSE_LEAST_US, PULSE_MOST_US = 750.0, 2250.0  # limits of a pulse in Betaflight's settings
ROTORFLIGHT_FULL = 1000.0  # motor value at full power
DSHOT_ROUNDED = DSHOT_MAX + 1  # Betaflight 3.4's full power in its logs, which its driver cuts to DSHOT_MAX
IMPOSSIBLE = 0xFFFF  # in place of a DShot value that no motor can be given
MINTHROTTLE, MINMOTOR = 4, 11  # predictors
BASE = {MINTHROTTLE: "minthrottle", MINMOTOR: "motorOutput"}  # header line that a predictor of motor[0] adds
DIGITAL = range(5, 9)  # DShot and ProShot in motor_pwm_protocol; below it, pulses
PROTOCOLS = ("motor_pwm_protocol", "fast_pwm_protocol")


@dataclass(frozen=True, eq=False)
class Motors:
    """Values of M motors in N rows; None if they are not logged or their unit is unknown."""

    fractions: Array | None = None  # (N, M) 0..1 as an ESC decodes them; NaN where the value is no motor's
    dshot: Words | None = None  # (N, M) DShot values; for an analog protocol the equal ones
    digital: bool = False  # whether the protocol is digital
    note: str = ""  # for the user: on the values, or why there are none


def motors(log: Log, firmware: Firmware) -> Motors:
    """Read the motor values of a log."""
    values = log.matrix("motor")
    if values is None:
        return Motors()
    values = values[:, :MOTOR_COUNT_MAX]
    if firmware.maker is Maker.NEUROFLIGHT:
        commands = (values > DSHOT_STOP) & (values < DSHOT_MIN)
        return _digital(np.where(commands, DSHOT_STOP, values))
    if firmware.maker is Maker.ROTORFLIGHT:
        return _analog(values, 0.0, ROTORFLIGHT_FULL, 0.0, ROTORFLIGHT_FULL)
    if note := _lost_base(log):
        return Motors(note=note)
    # INAV's are pulses, whatever the protocol (in public logs of INAV 8 with DSHOT600): its driver converts.
    digital, note = (False, "") if firmware.maker is Maker.INAV else _protocol(log, values)
    if digital is None:
        return Motors(note=note)
    if digital:
        return replace(_digital(values), note=note)
    return replace(_analog(values, PULSE_STOP_US, PULSE_FULL_US, PULSE_LEAST_US, PULSE_MOST_US), note=note)


def motor_idle(log: Log) -> float | None:
    """Return the motor fraction at zero thrust from the header line motorOutput; None if it has none."""
    output = log.headers.integers("motorOutput")
    if len(output) != 2:
        return None
    if output[1] > PULSE_FULL_US:
        return max(0.0, (output[0] - DSHOT_MIN) / DSHOT_SPAN)
    return min(1.0, max(0.0, (output[0] - PULSE_STOP_US) / (PULSE_FULL_US - PULSE_STOP_US)))


def _digital(values: NDArray[np.int64]) -> Motors:
    values = np.where(values == DSHOT_ROUNDED, DSHOT_MAX, values)
    stopped, running = values == DSHOT_STOP, (values >= DSHOT_MIN) & (values <= DSHOT_MAX)
    dshot = np.where(stopped | running, values, IMPOSSIBLE).astype(np.uint16)
    fractions = motor_fractions(np.where(running, values, DSHOT_STOP).astype(np.uint16))
    return Motors(np.where(stopped | running, fractions, np.nan), dshot, True)


def _analog(values: NDArray[np.int64], stop: float, full: float, least: float, most: float) -> Motors:
    fractions = np.clip((values - stop) / (full - stop), 0.0, 1.0)
    dshot = np.where(fractions > 0, DSHOT_MIN + np.floor(DSHOT_SPAN * fractions + 0.5), DSHOT_STOP)
    possible = (values == 0) | ((values >= least) & (values <= most))
    dshot = np.where(possible, dshot, IMPOSSIBLE)
    return Motors(np.where(possible, fractions, np.nan), dshot.astype(np.uint16), False)


def _first(log: Log) -> FieldDefinition | None:
    """Return the definition of the first motor's field."""
    return next((one for one in log.headers.fields.get("I", ()) if one.name == "motor[0]"), None)


def _lost_base(log: Log) -> str:
    """Return a note on the lost header line that motor values are measured from; "" if none is lost."""
    first = _first(log)
    name = BASE.get(first.predictor, "") if first else ""
    if not name or header_number({name: log.header.get(name, "").split(",")[0]}, name) is not None:
        return ""
    example = "LOW,HIGH" if name == "motorOutput" else "LOW"
    for told in ("dshot_idle_value", "digitalIdleOffset", "digital_idle_value"):
        hundredths = header_number(log.header, told)
        if name == "motorOutput" and hundredths is not None:
            example = f"{DSHOT_MIN + round(DSHOT_SPAN * hundredths / 1e4)},{DSHOT_MAX}"
    return (
        f"no line {name} in its headers, from which motor values count: they cannot be read; add --header "
        f"{name}={example}"
    )


def _protocol(log: Log, values: NDArray[np.int64]) -> tuple[bool | None, str]:
    """Return if the values are DShot's (None: unknown), and a note for the user.

    The header decides, else values that only one protocol has: DShot idles below 750, pulses do not.
    """
    output = log.headers.integers("motorOutput")
    if len(output) == 2:
        return output[1] > PULSE_FULL_US, ""
    for line in PROTOCOLS:
        if (protocol := header_number(log.header, line)) is not None:
            return protocol in DIGITAL, ""
    if (first := _first(log)) is not None and first.predictor == MINTHROTTLE:
        return False, ""  # pulses: there was no other protocol yet
    lost = "no line motorOutput nor motor_pwm_protocol in its headers"
    turning = values[values > 0]
    least, most = (int(turning.min()), int(turning.max())) if len(turning) else (0, 0)
    if least >= PULSE_LEAST_US and most <= PULSE_MOST_US:
        return False, f"{lost}: motor values of {least} to {most} are taken for pulses in us"
    if least >= DSHOT_MIN and most <= DSHOT_MAX:
        return True, f"{lost}: motor values of {least} to {most} are taken for DShot's"
    return None, (
        f"{lost}, and motor values of {least} to {most} tell nothing: add --header motorOutput=LOW,HIGH, "
        "those at idle and at full power"
    )
