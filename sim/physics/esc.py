"""ESC telemetry: speed, voltage and current, rounded as an ESC reports them. Pure and vectorised.

Beside them stand thrust and drag torque of each rotor and the temperature of its winding, which a simulator
knows: they are the force, torque and temperature topics of Koch 2019, table 5.1. They are not rounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.model import EscTelemetry
from neuroflight.sim.arrays import Array


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
