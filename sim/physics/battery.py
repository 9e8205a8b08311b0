"""A LiPo pack: voltage under load from power drawn and charge used. N aircraft, computed by battery.c."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.model import Battery
from neuroflight.sim.arrays import Array, Indices
from neuroflight.sim.physics.library import elements, library, pointer, struct

# Voltage of a rested LiPo cell over state of charge. Typical: the chart that suppliers of hobby packs print,
# not a measurement of one pack. Below 0 the cell collapses: what it still gives before 0 V is assumed.
STATE_OF_CHARGE = np.array([-0.02, 0.00, 0.05, 0.10, 0.20, 0.30, 0.40, 0.50, 0.60, 0.70, 0.80, 0.90, 1.00])
CELL_VOLTAGE = np.array([0.00, 3.27, 3.61, 3.69, 3.73, 3.77, 3.80, 3.84, 3.87, 3.95, 4.02, 4.11, 4.20])  # [V]


@lru_cache(maxsize=16)
def pack_struct(battery: Battery) -> Any:  # noqa: ANN401 - a struct of cffi
    """Return the pack as C has it."""
    empty = -STATE_OF_CHARGE[0]  # how far below zero state of charge the voltage is 0
    return struct(
        "pack",
        points=len(STATE_OF_CHARGE),
        state_of_charge=STATE_OF_CHARGE.tolist(),
        voltage=CELL_VOLTAGE.tolist(),
        scale=battery.rest_voltage / CELL_VOLTAGE[-1],
        capacity=battery.capacity,
        resistance=battery.resistance,
        charge_max=(1.0 + empty) * battery.capacity,
    )


def open_circuit_voltage(battery: Battery, state_of_charge: Array) -> Array:
    """Compute the voltage of the pack without load [V], same shape as `state_of_charge` (0..1, 1 is full).

    Linear between the points of `CELL_VOLTAGE`, scaled so that a full pack gives its `rest_voltage`.
    """
    (left,) = elements(state_of_charge)
    voltage = np.empty_like(left)
    library().lib.pack_open_circuit(pack_struct(battery), left.size, pointer(left), pointer(voltage))
    return voltage


def loaded_voltage(open_circuit: Array, power: Array, resistance: float) -> Array:
    """Compute the voltage V [V] at which a pack gives `power` [W]: P = V I with V = OCV - I R, same shape.

    Of the two solutions the one that small powers reach, V >= OCV / 2, which is what it can give at most.
    """
    rest, drawn = elements(open_circuit, power)
    voltage = np.empty_like(rest)
    library().lib.pack_loaded(rest.size, pointer(rest), pointer(drawn), resistance, pointer(voltage))
    return voltage


class BatteryState:
    """The packs of N aircraft: one model, each with its own charge. Full and without load at first."""

    def __init__(self, battery: Battery, count: int) -> None:
        self.battery = battery
        self.charge = np.zeros(count)  # used [A s]
        self.current = np.zeros(count)  # [A]
        self.voltage = np.full((count, 1), battery.rest_voltage)  # under load [V], a column beside (N, M)

    @property
    def state_of_charge(self) -> Array:
        """Charge left, (N,): 1 is full, 0 is empty."""
        return np.asarray(1.0 - self.charge / self.battery.capacity)

    def reset(self, index: Indices, charge: float | Array) -> None:
        """Set the packs of the aircraft of `index` to state of charge `charge`, 0..1, without load.

        charge: one for all, or one each, (len(index),). Raises ValueError outside 0..1 (NaN included).
        """
        left = np.full(len(index), charge)
        if not ((left >= 0.0) & (left <= 1.0)).all():
            raise ValueError(f"battery charge is {charge}, expected 0 to 1")
        self.charge[index] = (1.0 - left) * self.battery.capacity
        self.current[index] = 0.0
        self.voltage[index, 0] = open_circuit_voltage(self.battery, left)

    def step(self, power: Array, dt: float) -> None:
        """Draw `power` [W] for `dt` [s]: (N,), at the pack's terminals, motors and electronics together."""
        drawn = np.ascontiguousarray(power, np.float64)
        state = (pointer(self.charge), pointer(self.current), pointer(self.voltage))
        library().lib.pack_step(pack_struct(self.battery), len(drawn), dt, pointer(drawn), *state)
