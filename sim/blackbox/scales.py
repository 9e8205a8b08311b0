"""The unit of one count of a log's fields: gyro, battery voltage and current, rotor speed.

It comes from the header where this has a line for it, else from the sources of each version of Betaflight,
Cleanflight, INAV and Rotorflight.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.firmware import Firmware, Maker

Columns = Mapping[str, NDArray[np.int64]]

BASEFLIGHT_SCALE = 1e-5  # a gyro_scale below it is in rad/us, as Baseflight had it; others are in deg/s
ADC_FULL, ADC_VOLTS = 4095.0, 3.3
CELL_LEAST_V = 2.5  # least voltage of a cell in flight
ERPM = 100.0  # electrical revolutions a minute in one count of eRPM
WORD = 1 << 32
_HUNDREDTHS = {Maker.INAV: ("vbat", "amperage"), Maker.ROTORFLIGHT: ("Vbat", "Ibat")}  # of a volt, an ampere


def header_number(header: Mapping[str, str], name: str) -> float | None:
    """Return the number in a header line: decimal, or the bits of a float32 with 0x; None: it has none."""
    text = header.get(name, "").strip()
    try:
        if text.lower().startswith("0x"):
            number = struct.unpack("<f", (int(text, 16) % WORD).to_bytes(4, "little"))[0]
        else:
            number = float(text)
    except ValueError:
        return None
    return float(number) if math.isfinite(number) else None


def fine(header: Mapping[str, str]) -> float:
    """Return the steps per deg/s of gyro and setpoint, and per unit of rcCommand: 10 with high resolution."""
    return 10.0 if header_number(header, "blackbox_high_resolution") else 1.0


def gyro_count(header: Mapping[str, str], firmware: Firmware) -> float | None:
    """Return the rad/s of one count of gyroADC, without high resolution; None if nothing in the log tells it.

    Firmware that filters the gyro in deg/s writes 1, which is assumed where the line is lost.
    """
    for name in ("gyro_scale", "gyro.scale"):
        scale = header_number(header, name)
        if scale is not None and scale > 0:
            return scale * 1e6 if scale < BASEFLIGHT_SCALE else float(np.deg2rad(scale))
    makers = (Maker.NEUROFLIGHT, Maker.INAV, Maker.ROTORFLIGHT)
    in_deg_s = _is_converted(firmware) or firmware.maker in makers
    return float(np.deg2rad(1.0)) if in_deg_s else None


def voltage(columns: Columns, header: Mapping[str, str], firmware: Firmware) -> Array | None:
    """Return the battery's voltage (N,) [V]; None if it is not logged or its unit is unknown."""
    counts = columns.get(_HUNDREDTHS.get(firmware.maker, ("", ""))[0])
    if counts is not None:
        return counts / 100.0
    counts = columns.get("vbatLatest")
    if counts is None:
        return None
    fine_since = firmware.since(Maker.BETAFLIGHT, 4) or firmware.since(Maker.CLEANFLIGHT, 4)
    if firmware.maker is Maker.NEUROFLIGHT or fine_since:
        return counts / 100.0
    if _is_converted(firmware):
        return counts / 10.0
    scale = header_number(header, "vbatscale")  # ten times the divider's ratio
    if scale is None or scale <= 0 or not is_adc(firmware):
        return None
    volts = np.asarray(counts * (ADC_VOLTS / ADC_FULL * scale / 10.0), np.float64)
    # Development builds of Betaflight 3.1 call themselves 3.0 but log tenths: read as counts they would give
    # a voltage too low for any battery.
    if firmware.since(Maker.BETAFLIGHT, 3) and len(volts) and 0 < np.median(volts) < CELL_LEAST_V:
        return counts / 10.0
    return volts


def current(columns: Columns, header: Mapping[str, str], firmware: Firmware) -> Array | None:
    """Return the battery's current (N,) [A]; None if it is not logged or its unit is unknown."""
    counts = columns.get(_HUNDREDTHS.get(firmware.maker, ("", ""))[1])
    if counts is not None:
        return counts / 100.0
    counts = columns.get("amperageLatest")
    if counts is None:
        return None
    if firmware.maker is Maker.NEUROFLIGHT or _is_converted(firmware):
        return counts / 100.0
    try:
        offset_mv, scale = (float(part) for part in header.get("currentMeter", "").split(","))
    except ValueError:
        return None
    if scale == 0 or not is_adc(firmware):  # scale: in 0.1 mV an ampere
        return None
    return np.asarray((counts * (1e3 * ADC_VOLTS / ADC_FULL) - offset_mv) * 10.0 / scale, np.float64)


def rotor_rpm(erpm: NDArray[np.int64] | None, header: Mapping[str, str]) -> Array | None:
    """Return the rotors' speeds (N, M) [rpm] of eRPM; None without eRPM or without motor_poles."""
    poles = header_number(header, "motor_poles")
    if erpm is None or poles is None or poles < 2:
        return None
    return np.asarray(erpm * (ERPM * 2.0 / poles), np.float64)


def _is_converted(firmware: Firmware) -> bool:
    """Return True if voltage is logged in tenths of a volt and current in hundredths of an ampere."""
    return (
        firmware.since(Maker.BETAFLIGHT, 3, 1)
        or firmware.since(Maker.CLEANFLIGHT, 2)
        or firmware.maker is Maker.EMUFLIGHT
    )


def is_adc(firmware: Firmware) -> bool:
    """Return True if voltage and current are logged as counts of the analog-to-digital converter."""
    if _is_converted(firmware):
        return False
    return firmware.maker in (Maker.CLEANFLIGHT, Maker.BASEFLIGHT, Maker.INAV) or (
        firmware.maker is Maker.BETAFLIGHT and firmware.version != ()
    )
