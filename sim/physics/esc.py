"""ESC telemetry: speed, voltage and current, rounded as an ESC reports them; and the words in which an ESC
tells its rotor's speed over the motor wire, as the firmware reads them. Pure and vectorised.

The words are bidirectional DShot's, toolchain/contract/motors.py. An ESC answers a frame with the period of
an electrical turn as it measured it last, whole microseconds rounded down, of which nine bits fit: the lower
ones are cut off. The words of a sample are of its rotor speeds; the firmware has them at the next sample. A
real ESC measures the period over the last turn, which on our twins is 0.3 to 1 ms: the words are as much
fresher than its. (Formats and rounding are from memory of what Betaflight's and Bluejay's documentation say.)

Beside them stand thrust and drag torque of each rotor and the temperature of its winding, which a simulator
knows: they are the force, torque and temperature topics of Koch 2019, table 5.1. They are not rounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import EscTelemetry
from neuroflight.sim.arrays import Array, Array32
from neuroflight.toolchain.contract import (
    ESC_MANTISSA_BITS,
    ESC_PERIOD_MAX_US,
    ESC_STANDS,
    MOTOR_POLES_DEFAULT,
)

ELECTRICAL_TURN = 4e6 * np.pi  # rad/s times us for one magnet: two of them are an electrical turn
_MANTISSA = (1 << ESC_MANTISSA_BITS) - 1

Words = NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class Telemetry:
    """One report; shapes are those of what was measured."""

    speed: Array  # [rad/s]
    voltage: Array  # [V]
    current: Array  # [A]
    force: Array  # [N], thrust of each rotor
    torque: Array  # [N m], that the air holds each rotor back with
    temperature: Array  # [degC] of each motor's winding; NaN: the aircraft file has no [esc.thermal]


def telemetry(
    speed: Array,
    voltage: Array,
    current: Array,
    force: Array,
    torque: Array,
    temperature: Array,
    esc: EscTelemetry,
) -> Telemetry:
    """Round rotor speed [rad/s], supply voltage [V] and current [A] as `esc` reports them: half to even.

    Arrays of any shape; a step of 0 leaves the number as it is. force [N], torque [N m] and
    temperature [degC] pass as they are.
    """
    return Telemetry(
        speed=_rounded(speed, esc.speed_step),
        voltage=_rounded(voltage, esc.voltage_step),
        current=_rounded(current, esc.current_step),
        force=force,
        torque=torque,
        temperature=temperature,
    )


def _rounded(values: Array, step: float) -> Array:
    return np.asarray(np.rint(values / step) * step) if step > 0.0 else values


def rotor_words(speed: Array, poles: int = MOTOR_POLES_DEFAULT) -> Words:
    """Return the words in which ESCs tell rotor speeds [rad/s], any shape, of motors with `poles` magnets."""
    with np.errstate(divide="ignore"):
        period = np.maximum(np.floor(ELECTRICAL_TURN / poles / np.asarray(speed, np.float64)), 1.0)
    turns = period <= ESC_PERIOD_MAX_US
    whole = np.where(turns, period, 1.0)
    exponent = np.maximum(np.frexp(whole)[1] - ESC_MANTISSA_BITS, 0)
    words = exponent << ESC_MANTISSA_BITS | whole.astype(np.int64) >> exponent
    return np.where(turns, words, ESC_STANDS).astype(np.uint16)


def words_speed(words: Words, poles: int = MOTOR_POLES_DEFAULT) -> Array32:
    """Return the rotor speeds [rad/s] that the firmware reads from `words` of speeds, to its bits.

    poles: as the firmware is told them.
    """
    period = (words & _MANTISSA).astype(np.int64) << (words >> ESC_MANTISSA_BITS)
    turn = np.float32(ELECTRICAL_TURN) / np.float32(poles)
    speed: Array32 = np.where(words == ESC_STANDS, np.float32(0.0), turn / period.astype(np.float32))
    return speed
