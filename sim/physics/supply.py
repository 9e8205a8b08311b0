"""The power supply of N aircraft: the bench supply, a battery each, or some of both; see supply.c."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Indices
from neuroflight.sim.physics.battery import BatteryState, pack_struct
from neuroflight.sim.physics.esc import Telemetry, telemetry
from neuroflight.sim.physics.library import assign, library, pointer, struct
from neuroflight.sim.physics.rotor import propulsion_struct, thrust_and_torque
from neuroflight.toolchain.errors import AircraftError


@dataclass(frozen=True, eq=False)
class Draw:
    """The power drawn by each of N aircraft from its supply, motors and electronics together; (N,) each."""

    power: Array  # [W]
    voltage: Array  # [V], under load; NaN on a bench supply of unknown voltage
    current: Array  # [A], likewise


class Supply:
    """Voltages and currents of N aircraft; the rotors meet the voltage as its ratio to the bench supply's."""

    def __init__(self, aircraft: Aircraft, count: int, rate_hz: int, charge: float | None) -> None:
        """charge: of every battery at reset, 0..1; None: the bench supply.

        Raises AircraftError for a charge if the aircraft lacks a battery.
        """
        self._aircraft = aircraft
        self._count = count
        self._battery: BatteryState | None = None
        self._charge: float | Array = 0.0 if charge is None else charge
        self._bench = np.full(count, charge is None)  # those on the bench supply beside batteries
        self._torque = np.ones(count)  # factors of the drag torque
        # Of each rotor's drag torque at its advance ratio, as the twin's step leaves them.
        self.advance = np.ones((count, aircraft.motor_count))
        self._power = np.zeros(count)  # [W]
        self._ratio = np.ones(count)
        self.state = struct(
            "supply",
            motors=aircraft.motor_count,
            rate_hz=rate_hz,
            electronics_power=0.0 if aircraft.battery is None else aircraft.battery.electronics_power,
            bench_voltage=_known(aircraft.propulsion.supply_voltage),
            bench=self._bench,
            torque_factor=self._torque,
            power=self._power,
            voltage_ratio=self._ratio,
        )
        if aircraft.propulsion.advance is not None:
            assign(self.state, advance=self.advance)
        if charge is not None:
            self._connect()

    def vary(self, charge: Array, torque: Array) -> None:
        """Set each aircraft's charge at reset, NaN for the bench supply, and torque factor; both (N,).

        Raises AircraftError for a charge if the aircraft lacks a battery.
        """
        bench = np.isnan(charge)
        if self._battery is None and not bench.all():
            self._connect()
        self._bench[:] = bench
        self._charge = np.where(bench, 1.0, charge)
        self._torque[:] = torque
        library().lib.supply_update(self.state, self._count)

    def reset(self, index: Indices) -> None:
        """Reset the batteries of the aircraft of `index` to the start, without load."""
        if self._battery is not None:
            charge = self._charge
            self._battery.reset(index, charge[index] if isinstance(charge, np.ndarray) else charge)
            library().lib.supply_update(self.state, self._count)

    @property
    def pack_voltage(self) -> Array:
        """Voltage of each battery under load [V], (N,); NaN on the bench supply."""
        if self._battery is None:
            return np.full(self._count, math.nan)
        return np.where(self._bench, math.nan, self._battery.voltage[:, 0])

    @property
    def battery(self) -> BatteryState | None:
        """Packs themselves, also those of aircraft on the bench supply; None: no aircraft has one."""
        return None if self._bench.all() else self._battery

    def telemetry(self, speed: Array, thrust_factor: Array, temperature: Array) -> Telemetry:
        """Return the ESCs' reports at rotor speeds (N, M); voltage and current are NaN if unknown.

        thrust_factor: of each rotor's thrust, (N, M); those of the drag torque are the supply's own.
        temperature: of the windings [degC], (N, M).
        """
        drawn = self.draw(speed, speed)
        thrust, torque = thrust_and_torque(speed, self._aircraft.propulsion)
        return telemetry(
            speed.copy(),
            drawn.voltage,
            drawn.current,
            thrust * thrust_factor,
            torque * self.advance * self._torque[:, None],
            temperature,
            self._aircraft.esc,
        )

    def motor_current(self, before: Array, after: Array) -> Array:
        """Compute the current of each motor [A], (N, M), over a sample of these rotor speeds (N, M) [rad/s].

        By the power of supply.c's formula: drag torque and gained speed; braking gives nothing back. On a
        battery at its voltage under load. NaN on a bench supply of unknown voltage.
        """
        propulsion = self._aircraft.propulsion
        drag = thrust_and_torque(after, propulsion)[1] * self.advance * self._torque[:, None]
        torque = drag + propulsion.rotor_inertia * (after - before) * self.state.rate_hz
        voltage = np.full(self._count, _known(propulsion.supply_voltage))
        if self._battery is not None:
            voltage = np.where(self._bench, voltage, self._battery.voltage[:, 0])
        shaft = np.maximum(after * torque, 0.0)
        return np.asarray(shaft / propulsion.efficiency / voltage[:, None])

    def draw(self, before: Array, after: Array) -> Draw:
        """Compute the power drawn over a sample that rotors begin and end with these speeds (N, M) [rad/s].

        Accelerating a rotor costs power, and braking gives nothing back. A battery: its value of the last
        sample.
        """
        if self._battery is not None and not self._bench.any():
            voltage, current = self._battery.voltage[:, 0].copy(), self._battery.current.copy()
            return Draw(voltage * current, voltage, current)
        power, propulsion = np.empty(self._count), propulsion_struct(self._aircraft.propulsion)
        library().lib.supply_power(
            self.state, propulsion, self._count, pointer(before), pointer(after), pointer(power)
        )
        voltage = np.full(self._count, _known(self._aircraft.propulsion.supply_voltage))
        current = power / voltage
        if self._battery is not None:
            drained = ~self._bench
            voltage[drained] = self._battery.voltage[drained, 0]
            current[drained] = self._battery.current[drained]
            power[drained] = voltage[drained] * current[drained]
        return Draw(power, voltage, current)

    def _connect(self) -> None:
        """Give each aircraft a battery."""
        aircraft = self._aircraft
        if aircraft.battery is None:
            raise AircraftError(
                f"aircraft {aircraft.name}: no [battery] table, so it flies on the bench supply only"
            )
        if aircraft.propulsion.supply_voltage is None:
            raise AircraftError(
                f"aircraft {aircraft.name}: propulsion.supply_voltage_v missing; without it a battery's "
                f"voltage says nothing about rotor speed"
            )
        self._battery = battery = BatteryState(aircraft.battery, self._count)
        self._pack = pack_struct(aircraft.battery)
        assign(
            self.state,
            pack=self._pack,
            charge=battery.charge,
            current=battery.current,
            pack_voltage=battery.voltage,
        )
        library().lib.supply_update(self.state, self._count)


def _known(value: float | None) -> float:
    return math.nan if value is None else value
