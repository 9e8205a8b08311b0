"""ESC telemetry: speed, voltage and current, rounded as an ESC reports them. Pure and vectorised.

Beside them stand the thrust and the drag torque of each rotor, which a simulator knows and no ESC measures:
they are the force and torque topics of the motors that Koch 2019, table 5.1, lists. They are not rounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.model import EscTelemetry

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Telemetry:
    """One report; shapes are those of what was measured."""

    speed: Array  # [rad/s]
    voltage: Array  # [V]
    current: Array  # [A]
    force: Array  # [N], thrust of each rotor
    torque: Array  # [N m], that the air holds each rotor back with


def telemetry(
    speed: Array, voltage: Array, current: Array, force: Array, torque: Array, esc: EscTelemetry
) -> Telemetry:
    """Rotor speed [rad/s], supply voltage [V] and current [A] as `esc` reports them: half to even.

    Arrays of any shape; a step of 0 leaves the number as it is. force [N] and torque [N m] pass as they are.
    """
    return Telemetry(
        speed=_rounded(speed, esc.speed_step),
        voltage=_rounded(voltage, esc.voltage_step),
        current=_rounded(current, esc.current_step),
        force=force,
        torque=torque,
    )


def _rounded(values: Array, step: float) -> Array:
    return np.asarray(np.rint(values / step) * step) if step > 0.0 else values
