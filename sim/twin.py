"""The digital twin: world, rotors and gyro of N copies of an aircraft, advanced together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.aircraft import Aircraft
from sim.imu import draw_bias, measured_rate
from sim.rotor import next_speed, rotor_geometry, rotor_wrench, target_speed
from sim.world import Mount, World

Array = NDArray[np.float64]


class Twin:
    """N aircraft in lockstep; one `step` is one sample of the gyro.

    A command given at a sample acts `delay` later (the aircraft's ESC and loop delay, rounded to whole
    samples), at the earliest from the next sample on. `rng` is the only source of chance: the same
    generator state and commands repeat a run exactly.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        count: int = 1,
        *,
        rate_hz: int = 1000,
        mount: Mount = Mount.CENTRE,
        gravity: bool | None = None,
        noise: bool = True,
        rng: np.random.Generator,
    ) -> None:
        self.aircraft = aircraft
        self.count = count
        self.rate_hz = rate_hz
        self.mount = mount
        self._dt = 1.0 / rate_hz
        self._gravity = gravity if gravity is not None else mount is Mount.FREE
        self._world = World(aircraft, count, self._dt, mount, self._gravity)
        self._geometry = rotor_geometry(aircraft)
        self._noise = noise
        self._rng = rng
        self._delay = max(1, round(aircraft.propulsion.delay * rate_hz))
        shape = (count, aircraft.motor_count)
        self._commands = np.zeros((self._delay + 1, *shape))  # the last ones, by sample modulo length
        self._sample = 0
        self.rotor_speed = np.zeros(shape)
        self.specific_force = np.zeros((count, 3))  # [m/s^2] body axes, of the rotors; a mount's is not in it
        self._bias = np.zeros((count, 3))
        self.gyro = np.zeros((count, 3))
        self.reset()

    def close(self) -> None:
        """Leave the physics client; the twin cannot be used afterwards."""
        self._world.close()

    @property
    def rate(self) -> Array:
        """True body rate [rad/s], (N, 3)."""
        return self._world.rate

    @property
    def rotation(self) -> Array:
        """Attitude as matrices from body to world, (N, 3, 3)."""
        return self._world.rotation

    @property
    def velocity(self) -> Array:
        """Velocity of the centre of mass [m/s], world axes, (N, 3); zero where the mount holds it."""
        return self._world.velocity

    @property
    def position(self) -> Array:
        """Position of the centre of mass [m], world axes, (N, 3)."""
        return self._world.position

    def reset(self, index: NDArray[np.intp] | None = None) -> None:
        """At rest, level, rotors and commands zero, a new gyro bias: all aircraft or those of `index`."""
        index = np.arange(self.count) if index is None else index
        self._commands[:, index] = 0.0
        self.rotor_speed[index] = 0.0
        self.specific_force[index] = 0.0
        self._world.reset(index.tolist())
        if self._noise:
            self._bias[index] = draw_bias(self.aircraft.gyro, len(index), self._rng)
        self.measure()

    def step(self, motors: NDArray[np.floating]) -> None:
        """Advance one sample with `motors`, the commands (N, M) in 0..1 computed from this sample.

        Raises ValueError on a wrong shape or a command that is not in 0..1 (NaN included).
        """
        if motors.shape != self.rotor_speed.shape:
            raise ValueError(f"motor commands have shape {motors.shape}, expected {self.rotor_speed.shape}")
        if not (motors.min() >= 0.0 and motors.max() <= 1.0):
            raise ValueError(f"motor commands are {motors.min()}..{motors.max()}, expected 0..1")
        slots = len(self._commands)
        self._commands[self._sample % slots] = motors
        self._sample += 1
        acting = self._commands[self._sample % slots]  # the oldest slot: `delay` samples before this one

        before = self.rotor_speed
        target = target_speed(acting, self.aircraft.propulsion)
        after = next_speed(before, target, self._dt, self.aircraft.propulsion)
        world = self._world
        velocity = world.velocity
        if self.mount is not Mount.CENTRE:
            velocity = np.matmul(velocity[:, None, :], world.rotation)[:, 0, :]
        wrench = rotor_wrench(before, after, self._dt, velocity, world.rate, self._geometry)
        world.step(wrench)
        self.rotor_speed = after
        self.specific_force = wrench[:, :3] / self.aircraft.mass_properties.mass
        self.measure()

    def measure(self) -> None:
        """Read the gyro anew, as at the next sample of aircraft that are held where they are."""
        rate = self._world.rate
        self.gyro = measured_rate(rate, self._bias, self.aircraft.gyro, self._rng) if self._noise else rate
