"""The twin's motion in a flight beyond its trace: place, speed, attitude and the rotors' thrust."""

from __future__ import annotations

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.rotor import thrust_and_torque
from neuroflight.sim.physics.twin import Twin
from neuroflight.toolchain.contract import GRAVITY


class Motion:
    """One row each time that it is called: the `watch` of a flight of one aircraft."""

    def __init__(self, twin: Twin) -> None:
        self._twin = twin
        self._rows: list[tuple[float, ...]] = []
        aircraft = twin.aircraft
        self._propulsion = aircraft.propulsion
        self._weight = aircraft.mass_properties.mass * GRAVITY  # [N]
        self._motors = aircraft.motor_count

    def __call__(self) -> None:
        """Keep the twin's state as it is now."""
        live = self._twin.live
        parts = (
            live.position[0],
            live.velocity[0],
            live.rotation[0, 2],
            live.rotor_speed[0],
            live.thrust_factor[0],
        )
        self._rows.append(tuple(value for part in parts for value in part.tolist()))

    @property
    def position(self) -> Array:
        """Position of the centre of mass from the origin [m], world axes, (N, 3)."""
        return self._columns(0, 3)

    @property
    def velocity(self) -> Array:
        """Velocity of the centre of mass [m/s], world axes, (N, 3)."""
        return self._columns(3, 6)

    @property
    def tilt(self) -> Array:
        """Angle between the body's z axis and the vertical [rad], (N,)."""
        angle: Array = np.arccos(self._columns(8, 9)[:, 0].clip(-1.0, 1.0))
        return angle

    @property
    def thrust(self) -> Array:
        """Thrust of all rotors together over the aircraft's weight, (N,)."""
        thrust, _ = thrust_and_torque(self._columns(9, 9 + self._motors), self._propulsion)
        factor = self._columns(9 + self._motors, 9 + 2 * self._motors)
        return np.asarray((thrust * factor).sum(axis=1) / self._weight)

    def _columns(self, begin: int, end: int) -> Array:
        return np.array(self._rows, np.float64).reshape(-1, 9 + 2 * self._motors)[:, begin:end]
