"""A LiPo pack: voltage under load from power drawn and charge used. Vectorised over N aircraft."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.model import Battery

Array = NDArray[np.float64]

# Voltage of a rested LiPo cell over state of charge. Typical: the chart that suppliers of hobby packs print,
# not a measurement of one pack. Below 0 the cell collapses: what it still gives before 0 V is assumed.
STATE_OF_CHARGE = np.array([-0.02, 0.00, 0.05, 0.10, 0.20, 0.30, 0.40, 0.50, 0.60, 0.70, 0.80, 0.90, 1.00])
CELL_VOLTAGE = np.array([0.00, 3.27, 3.61, 3.69, 3.73, 3.77, 3.80, 3.84, 3.87, 3.95, 4.02, 4.11, 4.20])  # [V]


def open_circuit_voltage(battery: Battery, state_of_charge: Array) -> Array:
    """Voltage of the pack without load [V], same shape as `state_of_charge` (0..1, 1 is full).

    Linear between the points of `CELL_VOLTAGE`, scaled so that a full pack gives its `rest_voltage`.
    """
    scale = battery.rest_voltage / CELL_VOLTAGE[-1]
    return np.asarray(scale * np.interp(state_of_charge, STATE_OF_CHARGE, CELL_VOLTAGE))


def loaded_voltage(open_circuit: Array, power: Array, resistance: float) -> Array:
    """Voltage V [V] at which a pack gives `power` [W]: P = V I with V = OCV - I R, same shape.

    Of the two solutions the one that small powers reach, V >= OCV / 2. More than OCV^2 / 4R a pack cannot
    give: there V is OCV / 2.
    """
    root = np.sqrt(np.maximum(open_circuit * open_circuit - 4.0 * resistance * power, 0.0))
    return np.asarray(0.5 * (open_circuit + root))


def shaft_power(speed: Array, torque: Array) -> Array:
    """Mechanical power that the motors of each aircraft give [W], (N,); braking gives none back.

    speed [rad/s] and torque [N m] of each motor on its rotor, (N, M).
    """
    return np.asarray(np.maximum(speed * torque, 0.0).sum(axis=1))


class BatteryState:
    """The packs of N aircraft: one model, each with its own charge. Full and without load at first."""

    def __init__(self, battery: Battery, count: int) -> None:
        self.battery = battery
        self.charge = np.zeros(count)  # used [A s]
        self.current = np.zeros(count)  # [A]
        self.voltage = np.full((count, 1), battery.rest_voltage)  # under load [V], a column beside (N, M)
        self._empty = -STATE_OF_CHARGE[0]  # how far below zero state of charge the voltage is 0

    @property
    def state_of_charge(self) -> Array:
        """Charge left, (N,): 1 is full, 0 is empty."""
        return np.asarray(1.0 - self.charge / self.battery.capacity)

    def reset(self, index: NDArray[np.intp], charge: float | Array) -> None:
        """Packs of the aircraft of `index` at state of charge `charge`, 0..1, without load.

        charge: one for all, or one each, (len(index),). Raises ValueError where it is not in 0..1 (NaN
        included).
        """
        left = np.full(len(index), charge)
        if not ((left >= 0.0) & (left <= 1.0)).all():
            raise ValueError(f"battery charge is {charge}, expected 0 to 1")
        self.charge[index] = (1.0 - left) * self.battery.capacity
        self.current[index] = 0.0
        self.voltage[index, 0] = open_circuit_voltage(self.battery, left)

    def step(self, power: Array, dt: float) -> None:
        """Draw `power` [W] for `dt` [s]: (N,), at the pack's terminals, motors and electronics together."""
        battery = self.battery
        open_circuit = open_circuit_voltage(battery, self.state_of_charge)
        voltage = loaded_voltage(open_circuit, power, battery.resistance)
        self.voltage = voltage[:, None]
        if battery.resistance > 0.0:
            power = np.minimum(power, open_circuit * open_circuit / (4.0 * battery.resistance))
        self.current = np.divide(power, voltage, out=np.zeros_like(voltage), where=voltage > 0.0)
        self.charge = np.minimum(self.charge + self.current * dt, (1.0 + self._empty) * battery.capacity)
