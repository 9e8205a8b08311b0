"""Trial flights as a pilot makes them, in C: throttle up, mean of the gyro's samples, the centred mix.

A candidate flies the LANES flights of a block, and all candidates fly the same ones. Twelve are of the
aircraft as its file says, three at each of LEVELS. The other four are harder, so that a setting that is only
just stable costs more: commands that act later, slower rotors, commands three times as large, each under a
lasting moment as of a battery off the centre. Flights have several pulses: what an integral has gathered in
one of them shows in the next.

Cost [deg/s]: the cube root of MAE times MSE, geometric mean over the flights, the harder ones with a share of
HARD, times the cube of what the change of the motors exceeds its limit by. In a geometric mean a per cent
counts the same at every thrust.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft, PidSettings
from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.control.gyro_filter import samples_per_step
from neuroflight.sim.control.pid_table import mixer, settings_table
from neuroflight.sim.physics.rotor import response_rows, target_speed, thrust_and_torque
from neuroflight.toolchain.contract import GRAVITY, Mix
from neuroflight.toolchain.policy.gyro_filters import MEAN
from neuroflight.toolchain.rendering.pid_table import pid_gains
from neuroflight.training.config.training_config import OutputMap
from neuroflight.training.learners.network.library import load, pointer
from neuroflight.training.learners.network.shape import Shape
from neuroflight.training.learners.pathwise.flights import LANES
from neuroflight.training.learners.pathwise.loss import Weights
from neuroflight.training.learners.pathwise.plan import Surroundings
from neuroflight.training.pid_tuning.trial import MARGIN, RATE_HZ, Limits, Trial, Trials, training_commands
from neuroflight.training.tasks.task import PulseTask

IDLE = 0.055  # motor fraction without thrust: Betaflight's default, a few percent of the weight
CHANGE = 0.0045  # mean |change| of a motor value in 1 ms; Betaflight's defaults make 0.002 to 0.004
LEVELS = (0.36, 1.0, 2.0, 4.0)  # thrust at rest, of the weight
THROTTLE_MAX = (
    0.85  # where an aircraft lifts less than the last of them: there must be something to steer with
)
PULSES = 5  # of a flight
HARD = 0.25
PENALTY = 3  # power of an exceeded limit
LATE_S = 0.004  # added to the delay
SLOW = 1.8  # factor of the rotors' time constants
LARGE = 3.0  # factor of the commands
OFF_CENTRE = 0.02  # of the rotors' mean distance: how far from the centre of mass the thrust acts


@dataclass(frozen=True)
class Flight:
    """The differences between flights."""

    level: float  # thrust at rest, of the weight
    late_s: float = 0.0
    slow: float = 1.0
    large: float = 1.0
    off_centre: float = 0.0


HARDER = (
    Flight(1.0, late_s=LATE_S, off_centre=OFF_CENTRE),
    Flight(4.0, late_s=LATE_S, off_centre=-OFF_CENTRE),
    Flight(0.36, slow=SLOW, off_centre=OFF_CENTRE),
    Flight(1.0, large=LARGE, off_centre=-OFF_CENTRE),
)
AS_FILED = tuple(Flight(level) for level in LEVELS for _ in range((LANES - len(HARDER)) // len(LEVELS)))


def throttle_for(aircraft: Aircraft, level: float, idle: float) -> float:
    """Return the throttle at which the rotors lift `level` times the weight at rest, at most THROTTLE_MAX."""
    throttle = np.linspace(0.0, THROTTLE_MAX, 1000)
    thrust, _ = thrust_and_torque(
        target_speed(idle + (1.0 - idle) * throttle, aircraft.propulsion), aircraft.propulsion
    )
    lifted = aircraft.motor_count * thrust / (aircraft.mass_properties.mass * GRAVITY)
    return float(np.interp(level, lifted, throttle))


class FlyingTrials(Trials):
    """The flights that every candidate of a search makes."""

    mix, gyro_filters = Mix.CENTRED, MEAN

    def __init__(
        self, aircraft: Aircraft, limits: Limits, rng: np.random.Generator, pulses: int = PULSES
    ) -> None:
        """Draw commands and noise from `rng`."""
        self.aircraft, self.limits, self.idle = aircraft, limits, limits.idle
        flights = AS_FILED + HARDER
        setpoint = self.setpoint = _setpoints(flights, pulses, rng)
        samples = samples_per_step(self.gyro_filters, RATE_HZ)
        surroundings = Surroundings(
            aircraft=aircraft,
            steps=len(setpoint),
            control_rate_hz=RATE_HZ,
            samples=samples,
            filters=self.gyro_filters,
            terms=(),
            scales=(),
            mix=self.mix,
            idle=self.idle,
            model=None,
            shape=Shape((1, aircraft.motor_count), "tanh", OutputMap()),  # of a policy; none flies
        )
        self._library = load("pathwise", "float32")
        self._plan = surroundings.plan(Weights(0.0, 0.0, 0.0), battery=False, number="float32")
        self._arrays = _rows(aircraft, flights, setpoint, self.idle, surroundings.dt, rng)
        self._block = self._struct("block", self._arrays)
        self.moment = _moments(aircraft, flights)

    def fly(self, candidates: Sequence[PidSettings]) -> list[Trial[PidSettings]]:
        """See Trials."""
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            return list(pool.map(self._trial, candidates))

    def figures(self, settings: PidSettings) -> tuple[Array, Array, Array]:
        """Return MAE [deg/s], MSE [deg^2/s^2] and the motors' change of each flight, (LANES,)."""
        gains = pid_gains(settings_table(settings, mixer(self.aircraft), "", ""), RATE_HZ)
        trial = self._struct(
            "pid_trial",
            {
                **{name: gains[name].tolist() for name in ("p", "i", "d", "integral_max", "smoothing")},
                "mixer": gains["mixer"],
                "moment": self.moment,
                "begin": round(PulseTask().idle_s * RATE_HZ),
            },
        )
        flown = np.empty((7, LANES), np.float32)
        self._library.lib.pid_trial_run(self._plan, self._block, trial, pointer(flown))
        absolute, square, (change,) = np.split(flown.astype(np.float64), [3, 6])
        return np.rad2deg(absolute.mean(axis=0)), np.rad2deg(np.rad2deg(square.mean(axis=0))), change

    def _trial(self, settings: PidSettings) -> Trial[PidSettings]:
        mae, mse, change = self.figures(settings)
        filed = slice(len(AS_FILED))
        moved = float(change[filed].mean())
        if not np.isfinite([*mae, *mse, *change]).all():
            return Trial(settings, math.inf, math.inf, math.inf)
        each = np.log(mae * mse) / 3.0
        cost = math.exp((1.0 - HARD) * each[filed].mean() + HARD * each[len(AS_FILED) :].mean())
        cost *= max(1.0, moved / (MARGIN * self.limits.change)) ** PENALTY
        return Trial(settings, float(mae[filed].mean()), moved, cost)

    def _struct(self, name: str, values: dict[str, Any]) -> Any:  # noqa: ANN401 - a struct of cffi
        """Return a struct of C that points to arrays, which the caller keeps alive."""
        made = self._library.ffi.new(f"struct {name} *")
        for key, value in values.items():
            setattr(made, key, pointer(value) if isinstance(value, np.ndarray) else value)
        return made


def _setpoints(flights: Sequence[Flight], pulses: int, rng: np.random.Generator) -> Array32:
    """Return rest, then pulses one after another, (T, 3, LANES) [rad/s]."""
    task = PulseTask()
    rest, held, released = (round(s * RATE_HZ) for s in (task.idle_s, task.command_s, task.rest_s))
    commands = training_commands(len(flights) * pulses, rng).reshape(len(flights), pulses, 3)
    setpoint = np.zeros((rest + pulses * (held + released), 3, len(flights)), np.float32)
    large = np.array([flight.large for flight in flights])
    for pulse in range(pulses):
        start = rest + pulse * (held + released)
        setpoint[start : start + held] = (commands[:, pulse] * large[:, None]).T
    return setpoint


def _rows(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    setpoint: Array32,
    idle: float,
    dt: float,
    rng: np.random.Generator,
) -> dict[str, NDArray[Any]]:
    """Return the block's arrays; dt: [s], of a sample. The gyro has no bias: see DissertationTrials."""
    propulsion, steps = aircraft.propulsion, len(setpoint)
    samples = round(1.0 / (RATE_HZ * dt))
    noise = rng.standard_normal(((steps - 1) * samples + 1, 3, LANES), np.float32)
    noise *= np.array(aircraft.gyro.noise, np.float32)[:, None]
    throttle = np.array([throttle_for(aircraft, flight.level, idle) for flight in flights], np.float32)
    delay = propulsion.delay + np.array([flight.late_s for flight in flights])
    slow = np.array([flight.slow for flight in flights])
    same = np.ones(LANES, np.float32)
    return {
        "response": np.ascontiguousarray(response_rows(propulsion, dt, slow).T, np.float32),
        "speed": np.ones((aircraft.motor_count, LANES), np.float32),
        **dict.fromkeys(("lift", "drag", "light", "load"), same),
        "charge": -same,  # the bench supply
        "delay": np.maximum(1, np.rint(delay / dt)).astype(np.int32),
        "shake": same * np.float32(max(aircraft.gyro.vibration)),
        "phase": rng.uniform(-0.5, 0.5, (aircraft.motor_count, LANES)).astype(np.float32),
        "setpoint": setpoint,
        "throttle": np.tile(throttle, (steps, 1)),
        "noise": noise,
    }


def _moments(aircraft: Aircraft, flights: Sequence[Flight]) -> Array32:
    """Return the lasting moments of thrust off the centre, (3, LANES) [N m]."""
    distance = np.linalg.norm(aircraft.rotor_positions[:, :2], axis=1).mean()
    weight = aircraft.mass_properties.mass * GRAVITY
    arm = weight * distance * np.array([flight.level * flight.off_centre for flight in flights])
    return np.stack([arm, arm, 0.0 * arm]).astype(np.float32)
