"""The digital twin: N copies of an aircraft, advanced together by one sample of the gyro a step.

A step runs its stages in order:

    commands -> delay -> rotor speed -> wind, wash -> wrench of rotors and drag -> supply -> world -> sensors

It runs in C (twin.c), in one call. Each stage is a module beside this one, and a C file of the same name: the
module makes the arrays and fills in a struct that points to them; air.py has wind and wash. What keeps a
state between samples is an object: command delay, supply, wind, wash, sensors, and the world, whose bodies
live in a pybullet client. The twin keeps rotor speeds and angles and the last readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.mass import Vector
from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Array32, Indices
from neuroflight.sim.physics.air import AIR_DENSITY, Wash, Wind
from neuroflight.sim.physics.battery import BatteryState
from neuroflight.sim.physics.delay import CommandDelay
from neuroflight.sim.physics.esc import Telemetry, rotor_words, words_speed
from neuroflight.sim.physics.heat import Heat
from neuroflight.sim.physics.imu import AccelerometerModel, GyroModel
from neuroflight.sim.physics.library import assign, library, pointer, struct
from neuroflight.sim.physics.rotor import (
    load_factors,
    propulsion_struct,
    response_rows,
    rotor_geometry,
    rotors_struct,
)
from neuroflight.sim.physics.supply import Draw, Supply
from neuroflight.sim.physics.variation import Variation
from neuroflight.sim.physics.world import Held, Mount, World
from neuroflight.toolchain.contract import GRAVITY

CALM: Vector = (0.0, 0.0, 0.0)
WIND_ALTITUDE = 10.0  # [m], at which gusts are drawn: where such aircraft fly


@dataclass(frozen=True, eq=False)
class Live:
    """A twin's state as C keeps it: the arrays that `step`, `measure` and `reset` overwrite."""

    rate: Array  # (N, 3) [rad/s], true, body axes
    rotation: Array  # (N, 3, 3), attitude as matrices from body to world
    velocity: Array  # (N, 3) [m/s] of the centre of mass, world axes; zero where the mount holds it
    position: Array  # (N, 3) [m] of the centre of mass, world axes
    rotor_speed: Array  # (N, M) [rad/s]
    thrust_factor: Array  # (N, M), of each rotor's thrust by its advance ratio and wash; 1 without either
    specific_force: Array  # (N, 3) [m/s^2], body axes; where the centre is held, the rotors' alone
    gyro: Array  # (N, 3) [rad/s], readings of this sample, body axes, unrounded
    # Readings of this sample, (N, 3) [m/s^2], body axes. On a mount they include 1 g even if the world has no
    # gravity: on the rig beside the acceleration of the swing, held at the centre 1 g alone, without noise.
    accelerometer: Array


class _Copy:
    """A copy of the twin's live array of the same name."""

    def __set_name__(self, owner: type[Twin], name: str) -> None:
        self._name = name

    def __get__(self, twin: Twin, owner: type[Twin]) -> Array:
        live: Array = getattr(twin.live, self._name)
        return live.copy()


class Twin:
    """N aircraft in lockstep; one `step` is one sample of the gyro.

    A command given at a sample acts `delay` later (the aircraft's ESC and loop delay, rounded to whole
    samples), at the earliest from the next sample on. All random numbers come from `rng`: the
    same generator state and commands repeat a run exactly. Properties are copies of the state; `live` is the
    state itself, for who reads it at every sample.
    """

    rate, rotation, velocity, position = _Copy(), _Copy(), _Copy(), _Copy()
    rotor_speed, specific_force, gyro, accelerometer = _Copy(), _Copy(), _Copy(), _Copy()

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
        wash: bool = True,
        variation: Variation | None = None,
        held: Held | None = None,
        rng: np.random.Generator,
    ) -> None:
        """Bring up `count` aircraft at rest.

        gravity: on in free flight unless given. noise: of gyro and accelerometer; without it they are ideal.
        charge: the battery's state of charge at the start, 0..1; None: the bench supply that the speed curve
        was measured with. wind: [m/s], world axes; gust: wind speed 20 feet above the ground that sets the
        Dryden turbulence [m/s]. ground: the plane z = 0, free flight only. wash: free aircraft whose
        propellers have a diameter are shaken by their own wake while they sink into it. variation: how each
        aircraft differs from its file, the charge of its battery included; None: not at all, and `vary` is
        refused. held: what turns an aircraft on the rig back to level; None: nothing.
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
        self._world = World(aircraft, count, self._dt, mount, self._gravity, ground=ground, held=held)
        self._geometry = rotor_geometry(aircraft)
        speed_max = aircraft.propulsion.speed_max
        shape = (count, aircraft.motor_count)
        self._delay = CommandDelay(*shape, max(1, round(aircraft.propulsion.delay * rate_hz)))
        self._variation = variation
        self._mass = np.full(count, aircraft.mass_properties.mass)  # [kg]
        self._load_factor = np.ones((count, 6))  # of the wrench of thrust and torque
        self._strength = np.ones(shape)  # of each rotor's thrust at a command, as `weaken` left it
        self._speed_factor = np.ones(shape)  # of the speed that a command settles at
        self._response = response_rows(aircraft.propulsion, self._dt, np.ones(count))
        self._wind = None
        if any(wind) or gust:
            # A stream of its own: the sensors' noise is the same with and without wind.
            self._wind = Wind(np.array(wind), gust, WIND_ALTITUDE, count, self._dt, rng.spawn(1)[0])
        self._gyro = GyroModel(aircraft.gyro, count, self._dt, rng, speed_max) if noise else None
        self._accelerometer = None
        if noise and aircraft.accelerometer is not None and mount is not Mount.CENTRE:
            own = rng.spawn(1)[0]
            self._accelerometer = AccelerometerModel(aircraft.accelerometer, count, self._dt, own, speed_max)
        sensors = [sensor for sensor in (self._gyro, self._accelerometer) if sensor is not None]
        self._ideal = not (noise and any(aircraft.gyro.noise))
        if self._gyro is not None and variation is not None:
            self._gyro.shake(variation.vibration)
        self._phase = np.zeros(shape) if any(sensor.vibrates for sensor in sensors) else None  # [rad]
        self._phase_rng = rng.spawn(1)[0]
        self._wash = None
        if wash and mount is Mount.FREE and aircraft.propulsion.propeller_diameter is not None:
            self._wash = Wash(aircraft, count, self._dt, rng.spawn(1)[0])
        self.live = Live(
            rate=self._world.rate,
            rotation=self._world.rotation,
            velocity=self._world.velocity,
            position=self._world.position,
            rotor_speed=np.zeros(shape),
            thrust_factor=np.ones(shape),
            specific_force=np.zeros((count, 3)),
            gyro=np.zeros((count, 3)),
            accelerometer=np.zeros((count, 3)),
        )
        thermal = aircraft.esc.thermal
        self._heat = None if thermal is None else Heat(thermal, shape, self._dt)
        self._command = np.zeros(shape)
        self._state = self._make_state()
        self._run, self._measure = library().lib.twin_run, library().lib.twin_measure
        if variation is not None:
            self.vary(np.arange(count), variation)
        self.reset()

    def _make_state(self) -> Any:  # noqa: ANN401 - a struct of cffi
        """Return the twin as C has it."""
        count, shape = self.count, self._command.shape
        propulsion, body = self.aircraft.propulsion, self.aircraft.body
        self._rotors = rotors_struct(self._geometry)
        self._propulsion = propulsion_struct(propulsion)
        self._scratch: dict[str, Array] = {name: np.zeros(shape) for name in ("acting", "before")}
        self._scratch |= {name: np.zeros((count, 3)) for name in ("air_velocity", "earlier")}
        self._scratch |= {"airspeed": np.zeros(count), "wrench": np.zeros((count, 6))}
        state = struct(
            "twin",
            count=count,
            dt=self._dt,
            rate_hz=self.rate_hz,
            field=self._field,
            gravity=GRAVITY,
            air_density=AIR_DENSITY,
            drag_area=body.drag_area if body else CALM,
            propulsion=self._propulsion,
            rotors=self._rotors,
            delay=self._delay.state,
            supply=self._supply.state,
            world=self._world.state,
            response=self._response,
            speed_factor=self._speed_factor,
            load_factor=self._load_factor,
            mass=self._mass,
            command=self._command,
            rotor_speed=self.live.rotor_speed,
            specific_force=self.live.specific_force,
            gyro=self.live.gyro,
            acceleration=self.live.accelerometer,
            **self._scratch,
        )
        if propulsion.advance is not None or self._wash is not None:
            assign(state, thrust_factor=self.live.thrust_factor, torque_factor=self._supply.advance)
        if self._phase is not None:
            assign(state, phase=self._phase)
        parts = {
            "wind": self._wind,
            "wash": self._wash,
            "gyroscope": self._gyro,
            "accelerometer": self._accelerometer,
        }
        assign(state, **{name: part.state for name, part in parts.items() if part is not None})
        return state

    def close(self) -> None:
        """Disconnect from pybullet; the twin cannot be used afterwards."""
        self._world.close()

    @property
    def telemetry(self) -> Telemetry:
        """ESC telemetry of this sample, the rotors' thrust and drag torque, temperature of the windings.

        Voltage and current are NaN on a supply of unknown voltage, temperature without [esc.thermal].
        """
        speed, heat = self.live.rotor_speed, self._heat
        temperature = np.full_like(speed, np.nan) if heat is None else heat.temperature.copy()
        return self._supply.telemetry(speed, self.live.thrust_factor * self._load_factor[:, 2:3], temperature)

    @property
    def told_speed(self) -> Array32:
        """Rotor speeds [rad/s] as the firmware has them from the ESCs at this sample, (N, M); see esc.py.

        Of a twin without noise of the gyro they are the sample's own: its sensors are ideal.
        """
        if self._ideal:
            return self.live.rotor_speed.astype(np.float32)
        return words_speed(rotor_words(self._scratch["before"]))

    @property
    def motor_current(self) -> Array:
        """Current of each motor over the last sample [A], (N, M), unrounded; see Supply.motor_current."""
        return self._supply.motor_current(self._scratch["before"], self.live.rotor_speed)

    @property
    def draw(self) -> Draw:
        """Power drawn by each aircraft over the last sample, unrounded; see Supply.draw."""
        return self._supply.draw(self._scratch["before"], self.live.rotor_speed)

    @property
    def pack_voltage(self) -> Array:
        """Voltage of each battery under load [V], (N,), unrounded; NaN on the bench supply."""
        return self._supply.pack_voltage

    @property
    def battery(self) -> BatteryState | None:
        """Packs of the aircraft, which change with each step; None: bench supply."""
        return self._supply.battery

    @property
    def variation(self) -> Variation | None:
        """Differences of each aircraft from its file; None: there are none."""
        return self._variation

    def vary(self, index: Indices, variation: Variation) -> None:
        """Change the aircraft of `index` to `variation` (len(index)); `reset` them afterwards.

        Raises ValueError if the twin was made without a variation, AircraftError on a charge if the
        aircraft has no battery.
        """
        if self._variation is None:
            raise ValueError("this twin was made without a variation; give it one to begin with")
        self._variation = everyone = self._variation.changed(index, variation)
        self._response[:] = response_rows(self.aircraft.propulsion, self._dt, everyone.lag)
        self._speed_factor[:] = everyone.speeds(self.aircraft.motor_count) * np.sqrt(self._strength)
        self._mass[:] = self.aircraft.mass_properties.mass * everyone.mass
        self._load_factor[:] = load_factors(everyone.thrust, everyone.torque)
        self._world.vary(index, variation.mass, variation.inertia)
        if self._gyro is not None:
            self._gyro.vary(everyone.noise)
            if self._phase is not None:
                self._gyro.shake(everyone.vibration)
        self._delay.vary(np.maximum(1, np.rint(everyone.delay_s * self.rate_hz).astype(np.intp)))
        self._supply.vary(everyone.charge, self._load_factor[:, 5])

    def weaken(self, shares: Array) -> None:
        """Reduce each motor's thrust at a command to these shares (M,) from now on: 1 all, 0 none.

        A motor turns as much slower as its share takes; a dead one runs down. `reset` does not restore it.
        Raises ValueError for a wrong shape or a share outside 0..1.
        """
        if shares.shape != (self.aircraft.motor_count,) or not ((shares >= 0.0) & (shares <= 1.0)).all():
            raise ValueError(f"got thrust shares {shares}, expected {self.aircraft.motor_count} of 0 to 1")
        self._strength[:] = shares
        self._speed_factor[:] = np.sqrt(self._strength)
        if self._variation is not None:
            self._speed_factor *= self._variation.speeds(self.aircraft.motor_count)

    def load(self, aircraft: Aircraft) -> None:
        """Give all aircraft the mass, its centre and the inertia of `aircraft` from now on, in flight.

        Rates continue without a jump, as with a payload that is fixed, released or moved without a push. For
        twins held at the centre of mass, without a variation. Raises ValueError for others, and for an
        aircraft with other rotors.
        """
        if self.mount is not Mount.CENTRE or self._variation is not None:
            raise ValueError("only a twin held at its centre, without a variation, can be loaded in flight")
        if aircraft.rotors != self.aircraft.rotors:
            raise ValueError(f"aircraft {aircraft.name} has other rotors than {self.aircraft.name}")
        self._mass[:] = aircraft.mass_properties.mass
        self._geometry = rotor_geometry(aircraft)
        self._rotors = rotors_struct(self._geometry)
        assign(self._state, rotors=self._rotors)
        self._world.load(aircraft.mass_properties.inertia)

    def reset(self, index: Indices | None = None) -> None:
        """Reset all aircraft, or those of `index`: at rest, level, with new biases, gusts and batteries."""
        index = np.arange(self.count) if index is None else index
        self._delay.reset(index)
        self.live.rotor_speed[index] = self._scratch["before"][index] = 0.0
        self.live.thrust_factor[index] = self._supply.advance[index] = 1.0
        if self._phase is not None:
            self._phase[index] = self._phase_rng.uniform(0.0, 2 * np.pi, (len(index), self._phase.shape[1]))
        self._world.reset(index.tolist())
        self.live.specific_force[index] = (0.0, 0.0, self._field)  # held where it is
        self._supply.reset(index)
        if self._heat is not None:
            self._heat.reset(index)
        if self._wind is not None:
            self._wind.reset(index)
        if self._wash is not None:
            self._wash.reset(index)
        for sensor in (self._gyro, self._accelerometer):
            if sensor is not None:
                sensor.reset(index)
        self.measure(index)

    def step(self, motors: NDArray[np.floating], samples: int = 1) -> Array:
        """Advance samples with `motors`, the commands (N, M) in 0..1 computed from this sample.

        Returns what the gyros read after each, (samples, N, 3) [rad/s]. Raises ValueError on a wrong shape or
        a command that is not in 0..1 (NaN included), RuntimeError if pybullet refuses.
        """
        if motors.shape != self._command.shape:
            raise ValueError(f"motor commands have shape {motors.shape}, expected {self._command.shape}")
        self._command[:] = motors
        read = np.empty((samples, self.count, 3))
        # Windings warm sample by sample.
        for part in [read] if self._heat is None else np.split(read, samples):
            failed = self._run(self._state, len(part), pointer(part))
            if failed:
                if failed == library().lib.STEP_BAD_COMMAND:
                    raise ValueError(f"motor commands are {motors.min()}..{motors.max()}, expected 0..1")
                raise RuntimeError("pybullet refuses a step of the twin; is it closed?")
            if self._heat is not None:
                self._heat.step(self.motor_current)
        return read

    def measure(self, which: Indices | None = None) -> None:
        """Draw new sensor readings, also without a step while aircraft are held: of all, or of `which`."""
        if which is None:
            self._measure(self._state, self.count, library().ffi.NULL)
        else:
            index = np.ascontiguousarray(which, np.int64)
            self._measure(self._state, len(index), pointer(index))
