"""The digital twin: N copies of an aircraft, advanced together by one sample of the gyro a step.

`Twin.step` is the list of stages, each a module beside this one:

    commands -> delay -> rotor speed -> supply -> wind -> wrench of rotors and drag -> world -> sensors

The formulas (rotor, battery, esc, rotation, drag) are pure functions over arrays of N aircraft. What keeps
a state between samples is an object of its own: command delay, supply, wind, sensors, and the world, whose
bodies live in a pybullet client. The twin keeps rotor speeds and angles, velocity and the last readings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.mass import Vector
from sim.aircraft.model import Aircraft
from sim.physics.air import Wind, body_drag
from sim.physics.delay import CommandDelay
from sim.physics.esc import Telemetry
from sim.physics.imu import EVERYONE, AccelerometerModel, GyroModel, Which
from sim.physics.rotation import turned_back
from sim.physics.rotor import (
    load_factors,
    next_speed,
    rotor_geometry,
    rotor_wrench,
    target_speed,
)
from sim.physics.supply import Supply
from sim.physics.variation import Variation
from sim.physics.world import Mount, World
from toolchain.contract import GRAVITY

Array = NDArray[np.float64]
CALM: Vector = (0.0, 0.0, 0.0)
WIND_ALTITUDE = 10.0  # [m], at which gusts are drawn: where such aircraft fly


class Twin:
    """N aircraft in lockstep; one `step` is one sample of the gyro.

    A command given at a sample acts `delay` later (the aircraft's ESC and loop delay, rounded to whole
    samples), at the earliest from the next sample on. All random numbers come from `rng`: the
    same generator state and commands repeat a run exactly.
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
        charge: float | None = None,
        wind: Vector = CALM,
        gust: float = 0.0,
        ground: bool = False,
        variation: Variation | None = None,
        rng: np.random.Generator,
    ) -> None:
        """Bring up `count` aircraft at rest.

        gravity: on in free flight unless given. noise: of gyro and accelerometer; without it they are ideal.
        charge: the battery's state of charge at the start, 0..1; None: the bench supply that the speed curve
        was measured with. wind: [m/s], world axes; gust: wind speed 20 feet above the ground that sets the
        Dryden turbulence [m/s]. ground: the plane z = 0, free flight only. variation: how each aircraft
        differs from its file, the charge of its battery included; None: not at all, and `vary` is refused.
        Raises AircraftError if the aircraft lacks what is asked for, ValueError on numbers out of range.
        """
        if variation is not None and len(variation) != count:
            raise ValueError(f"a variation of {len(variation)} aircraft, expected {count}")
        if variation is not None and charge is not None:
            raise ValueError(f"charge {charge} and a variation, which says the charge: expected one of them")
        self.aircraft = aircraft
        self.count = count
        self.rate_hz = rate_hz
        self.mount = mount
        self._dt = 1.0 / rate_hz
        self._gravity = gravity if gravity is not None else mount is Mount.FREE
        # Specific force at rest, upwards [m/s^2]: of a rig in the Earth's field even if that does not pull.
        self._field = GRAVITY if mount is Mount.RIG or (self._gravity and mount is Mount.FREE) else 0.0
        self._supply = Supply(aircraft, count, rate_hz, charge)
        self._world = World(aircraft, count, self._dt, mount, self._gravity, ground=ground)
        self._geometry = rotor_geometry(aircraft)
        self._speed_max = aircraft.propulsion.speed_max
        shape = (count, aircraft.motor_count)
        self._delay = CommandDelay(*shape, max(1, round(aircraft.propulsion.delay * rate_hz)))
        self.rotor_speed = np.zeros(shape)
        self.specific_force = np.zeros((count, 3))  # [m/s^2] body axes; where the centre is held, the rotors'
        self._variation = variation
        self._lag: float | Array = 1.0
        self._mass: float | Array = aircraft.mass_properties.mass  # [kg], or (N, 1)
        self._load_factor: Array | None = None  # (N, 6), of the wrench of thrust and torque
        self._speed_factor: Array | None = None  # (N, 1), of the speed that a command settles at
        self._wind = None
        if any(wind) or gust:
            # A stream of its own: the sensors' noise is the same with and without wind.
            self._wind = Wind(np.array(wind), gust, WIND_ALTITUDE, count, self._dt, rng.spawn(1)[0])
        self._drag_area = np.array(aircraft.body.drag_area) if aircraft.body else np.zeros(3)
        self._gyro = GyroModel(aircraft.gyro, count, self._dt, rng) if noise else None
        self._accelerometer = None
        if noise and aircraft.accelerometer is not None and mount is not Mount.CENTRE:
            own = rng.spawn(1)[0]
            self._accelerometer = AccelerometerModel(aircraft.accelerometer, count, self._dt, own)
        sensors = [sensor for sensor in (self._gyro, self._accelerometer) if sensor is not None]
        self._phase = np.zeros(shape) if any(sensor.vibrates for sensor in sensors) else None  # [rad]
        self._phase_rng = rng.spawn(1)[0]
        self.gyro = np.zeros((count, 3))
        self._acceleration = np.zeros((count, 3))  # [m/s^2], read off the centre
        if variation is not None:
            self.vary(np.arange(count), variation)
        self.reset()

    def close(self) -> None:
        """Disconnect from pybullet; the twin cannot be used afterwards."""
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
        return self._velocity

    @property
    def position(self) -> Array:
        """Position of the centre of mass [m], world axes, (N, 3)."""
        return self._world.position

    @property
    def accelerometer(self) -> Array:
        """Accelerometer readings of this sample [m/s^2], (N, 3), body axes.

        On a mount they include 1 g even if the world has no gravity: on the rig beside the acceleration of
        the swing, held at the centre 1 g alone and without noise.
        """
        if self.mount is Mount.CENTRE:
            upwards: Array = self._world.rotation[:, 2] * GRAVITY  # the world's upward axis in the body's
            return upwards
        return self._acceleration

    @property
    def telemetry(self) -> Telemetry:
        """ESC telemetry of this sample; voltage and current are NaN on a supply of unknown voltage."""
        return self._supply.telemetry(self.rotor_speed)

    @property
    def variation(self) -> Variation | None:
        """How each aircraft differs from its file; None: not at all."""
        return self._variation

    def vary(self, index: NDArray[np.intp], variation: Variation) -> None:
        """Change the aircraft of `index` to `variation` (len(index)); `reset` them afterwards.

        Raises ValueError if the twin was made without a variation, AircraftError on a charge if the
        aircraft has no battery.
        """
        if self._variation is None:
            raise ValueError("this twin was made without a variation; give it one to begin with")
        self._variation = everyone = self._variation.changed(index, variation)
        self._lag = everyone.lag[:, None]
        self._speed_factor = everyone.speed[:, None]
        self._mass = self.aircraft.mass_properties.mass * everyone.mass[:, None]
        self._load_factor = load_factors(everyone.thrust, everyone.torque)
        self._world.vary(index, variation.mass, variation.inertia)
        if self._gyro is not None:
            self._gyro.vary(everyone.noise)
        self._delay.vary(np.maximum(1, np.rint(everyone.delay_s * self.rate_hz).astype(np.intp)))
        self._supply.vary(everyone.charge, self._load_factor[:, 5:])

    def reset(self, index: NDArray[np.intp] | None = None) -> None:
        """At rest, level, rotors and commands zero, new biases and gusts, the battery as at the start.

        All aircraft, or those of `index`.
        """
        index = np.arange(self.count) if index is None else index
        self._delay.reset(index)
        self.rotor_speed[index] = 0.0
        if self._phase is not None:
            self._phase[index] = self._phase_rng.uniform(0.0, 2 * np.pi, (len(index), self._phase.shape[1]))
        self._world.reset(index.tolist())
        self._velocity = self._world.velocity
        self.specific_force[index] = (0.0, 0.0, self._field)  # held where it is
        self._supply.reset(index)
        if self._wind is not None:
            self._wind.reset(index)
        for sensor in (self._gyro, self._accelerometer):
            if sensor is not None:
                sensor.reset(index)
        self.measure(index)

    def step(self, motors: NDArray[np.floating]) -> None:
        """Advance one sample with `motors`, the commands (N, M) in 0..1 computed from this sample.

        Raises ValueError on a wrong shape or a command that is not in 0..1 (NaN included).
        """
        world, dt, propulsion = self._world, self._dt, self.aircraft.propulsion
        before = self.rotor_speed
        target = target_speed(self._delay.step(motors), propulsion, self._supply.voltage)
        if self._speed_factor is not None:
            target *= self._speed_factor
        after = next_speed(before, target, dt, propulsion, self._lag)
        self._supply.step(before, after)
        through_air = world.body_velocity if self._wind is None else self._air_velocity(self._wind)
        wrench = rotor_wrench(before, after, dt, through_air, world.rate, self._geometry, self._load_factor)
        if self.mount is Mount.FREE:
            wrench[:, :3] += body_drag(through_air, self._drag_area)
        if self._phase is not None:
            self._phase += 0.5 * dt * (before + after)
        self.rotor_speed = after
        self._move(wrench)
        self.measure()

    def measure(self, which: Which = EVERYONE) -> None:
        """Draw new sensor readings of the aircraft of `which`, also without a step while they are held."""
        phase = None if self._phase is None else self._phase[which]
        rotors = (phase, self.rotor_speed[which], self._speed_max, which)
        rate, force = self._world.rate[which], self.specific_force[which]
        meter = self._accelerometer
        gyro = rate if self._gyro is None else self._gyro.measure(rate, *rotors)
        acceleration = force if meter is None else meter.measure(force, *rotors)
        if which is EVERYONE:
            self.gyro, self._acceleration = gyro, acceleration
        else:
            self.gyro[which], self._acceleration[which] = gyro, acceleration

    def _move(self, wrench: Array) -> None:
        """Advance the world, and find the specific force from the change of velocity."""
        world = self._world
        if self.mount is Mount.CENTRE:
            world.step(wrench)
            self.specific_force = wrench[:, :3] / self._mass
            return
        world.step(wrench)
        earlier, self._velocity = self._velocity, world.velocity
        gained = (self._velocity - earlier) * self.rate_hz
        gained[:, 2] += self._field
        self.specific_force = turned_back(world.rotation, gained)

    def _air_velocity(self, wind: Wind) -> Array:
        """Velocity through moving air [m/s], (N, 3), body axes; advances the gusts."""
        through_air: Array = self._velocity - wind.velocity
        wind.step(np.sqrt((through_air * through_air).sum(axis=1)))
        return turned_back(self._world.rotation, through_air)
