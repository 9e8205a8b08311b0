"""What N aircraft draw their power from: the bench supply, a battery each, or some of both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.model import Aircraft
from sim.physics.battery import BatteryState, shaft_power
from sim.physics.esc import Telemetry, telemetry
from sim.physics.rotor import thrust_and_torque
from toolchain.errors import AircraftError

Array = NDArray[np.float64]


class Supply:
    """voltage: under load [V], (N, 1); None while all are on the bench supply of the speed curve."""

    def __init__(self, aircraft: Aircraft, count: int, rate_hz: int, charge: float | None) -> None:
        """charge: of every battery at reset, 0..1; None: the bench supply.

        Raises AircraftError on a charge if the aircraft lacks a battery.
        """
        self._aircraft = aircraft
        self._count = count
        self._rate_hz = rate_hz
        self._battery = None if charge is None else _battery(aircraft, count)
        self._charge: float | Array = 0.0 if charge is None else charge
        self._bench: NDArray[np.bool_] | None = None  # (N, 1), those on the bench supply beside batteries
        self._torque: Array | None = None  # (N, 1), factors of the drag torque
        self.voltage: Array | None = None
        self._update_voltage()

    def vary(self, charge: Array, torque: Array) -> None:
        """State of charge at reset of each aircraft, NaN for the bench supply, (N,); torque factors (N, 1).

        Raises AircraftError on a charge if the aircraft lacks a battery.
        """
        bench = np.isnan(charge)
        if self._battery is None and not bench.all():
            self._battery = _battery(self._aircraft, self._count)
        self._bench = bench[:, None] if bench.any() else None
        self._charge = np.where(bench, 1.0, charge)
        self._torque = torque
        self._update_voltage()

    def reset(self, index: NDArray[np.intp]) -> None:
        """Batteries of the aircraft of `index` as at the start, without load."""
        if self._battery is not None:
            charge = self._charge
            self._battery.reset(index, charge[index] if isinstance(charge, np.ndarray) else charge)
            self._update_voltage()

    def step(self, before: Array, after: Array) -> None:
        """Draw the power of one sample: rotor speeds at its ends [rad/s], (N, M)."""
        if self._battery is not None:
            self._battery.step(self._power(before, after), 1.0 / self._rate_hz)
            self._update_voltage()

    def telemetry(self, speed: Array) -> Telemetry:
        """What the ESCs report at rotor speeds (N, M); voltage and current are NaN where unknown."""
        voltage = np.full(self._count, self._aircraft.propulsion.supply_voltage or np.nan)
        current = self._power(speed, speed) / voltage
        if self._battery is not None:
            drained = slice(None) if self._bench is None else ~self._bench[:, 0]
            voltage[drained] = self._battery.voltage[drained, 0]
            current[drained] = self._battery.current[drained]
        return telemetry(speed, voltage, current, self._aircraft.esc)

    def _power(self, before: Array, after: Array) -> Array:
        """What motors and electronics draw over a sample [W], (N,)."""
        propulsion, battery = self._aircraft.propulsion, self._aircraft.battery
        gained = propulsion.rotor_inertia * (after - before) * self._rate_hz
        torque = thrust_and_torque(after, propulsion)[1]
        if self._torque is not None:
            torque *= self._torque
        torque += gained
        electronics = 0.0 if battery is None else battery.electronics_power
        drawn: Array = shaft_power(after, torque) / propulsion.efficiency + electronics
        return drawn

    def _update_voltage(self) -> None:
        if self._battery is None:
            return
        self.voltage = self._battery.voltage
        if self._bench is not None:
            bench = np.float64(self._aircraft.propulsion.supply_voltage)  # known where there is a battery
            self.voltage = np.where(self._bench, bench, self.voltage)


def _battery(aircraft: Aircraft, count: int) -> BatteryState:
    if aircraft.battery is None:
        raise AircraftError(
            f"aircraft {aircraft.name}: no [battery] table, so it flies on the bench supply only"
        )
    if aircraft.propulsion.supply_voltage is None:
        raise AircraftError(
            f"aircraft {aircraft.name}: propulsion.supply_voltage_v missing; without it a battery's voltage "
            f"says nothing about rotor speed"
        )
    return BatteryState(aircraft.battery, count)
