"""The common plan of a run's flights, as C has it: aircraft, surroundings of the policy, network."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft, TorqueResponse
from neuroflight.sim.physics.battery import CELL_VOLTAGE, STATE_OF_CHARGE
from neuroflight.sim.physics.esc import ELECTRICAL_TURN
from neuroflight.sim.physics.imu import rotation_by, vibration_axes
from neuroflight.sim.physics.rotor import rotor_geometry
from neuroflight.toolchain.contract import (
    ESC_MANTISSA_BITS,
    ESC_PERIOD_MAX_US,
    GYRO_COUNTS,
    GYRO_FULL_SCALE_DEG_S,
    MOTOR_POLES_DEFAULT,
    OBSERVATION_BLOCKS,
    RATE_ERROR_INTEGRAL_LIMIT_RAD,
    RPM_FILTER_FADE_HZ,
    RPM_FILTER_HIGHEST,
    Mix,
    ObservationTerm,
    hears_rotors,
    measures_rotors,
    needs_model,
)
from neuroflight.toolchain.policy.gyro_filters import GyroFilters, RpmFilter
from neuroflight.toolchain.policy.model_constants import ModelConstants
from neuroflight.training.learners.network.library import load
from neuroflight.training.learners.network.shape import Shape
from neuroflight.training.learners.pathwise.loss import Weights


@dataclass(frozen=True)
class Surroundings:
    """The aircraft, and everything between it and the network."""

    aircraft: Aircraft
    steps: int  # control steps of an episode
    control_rate_hz: int
    samples: int  # of the gyro, and steps of the physics, in a control step
    filters: GyroFilters  # of the gyro
    terms: tuple[ObservationTerm, ...]
    scales: tuple[float, ...]  # of the network's input, one a term
    mix: Mix
    idle: float
    model: ModelConstants | None  # that the observation needs
    shape: Shape
    of_motors: bool = (
        False  # whether the change of the motors is in the loss, in 1 ms, or that of the outputs
    )
    soft: float = 0.0  # [deg/s], of the loss: see PathwiseConfig
    noise: bool = True  # of the gyro
    shaken: bool = False  # whether its vibration is drawn for each aircraft
    rounded: bool = True  # the gyro has counts, and ESCs have steps

    @property
    def dt(self) -> float:
        """Time of a sample [s]."""
        return 1.0 / (self.control_rate_hz * self.samples)

    def plan(self, weights: Weights, battery: bool, number: str) -> Any:  # noqa: ANN401 - a struct of cffi
        """Make the plan for C. battery: True if any aircraft flies on one."""
        made = load("pathwise", number).ffi.new("struct plan *")
        made.steps, made.samples = self.steps, self.samples
        made.seen = self.samples if self.filters.mean else 1
        made.rounded = self.rounded
        put_aircraft(made, self.aircraft, self.dt)
        if battery:
            self._pack(made.pack)
        self._gyro(made.gyro)
        if self.filters.rpm is not None:
            self._notches(made.notches, self.filters.rpm)
        self._controller(made.controller)
        made.loss.of_motors, made.loss.soft = self.of_motors, self.soft
        made.loss.change_scale = self.control_rate_hz / 1000.0 if self.of_motors else 1.0
        for name, weight in vars(weights).items():
            setattr(made.loss, name, weight)
        return made

    def _pack(self, made: Any) -> None:  # noqa: ANN401
        battery, propulsion = self.aircraft.battery, self.aircraft.propulsion
        bench = propulsion.supply_voltage
        assert battery is not None and bench is not None  # TrainingConfig.check
        made.present = True
        made.points = len(STATE_OF_CHARGE)
        _fill(made.left, STATE_OF_CHARGE)
        _fill(made.volts, CELL_VOLTAGE * (battery.rest_voltage / CELL_VOLTAGE[-1] / bench))
        made.capacity = battery.capacity
        made.resistance = battery.resistance / bench**2
        made.amperes = 1.0 / bench
        made.electronics = battery.electronics_power
        made.efficiency = propulsion.efficiency
        made.rotor_inertia = propulsion.rotor_inertia / self.dt

    def _gyro(self, made: Any) -> None:  # noqa: ANN401
        gyro = self.aircraft.gyro
        made.counts = math.degrees(1.0) * GYRO_COUNTS / GYRO_FULL_SCALE_DEG_S
        made.count_max = GYRO_COUNTS - 1
        made.follow = 1.0
        if not self.noise:
            return
        made.turned = any(gyro.misalignment)
        made.turn = rotation_by(np.array(gyro.misalignment)).ravel().tolist()
        if gyro.bandwidth_hz is not None:
            made.follow = -math.expm1(-2.0 * math.pi * gyro.bandwidth_hz * self.dt)
        made.vibrates = self.shaken or any(gyro.vibration)
        made.amplitude, harmonics = vibration_axes(gyro)
        _fill(made.harmonics, np.array(harmonics))
        made.speed_max = self.aircraft.propulsion.speed_max

    def _notches(self, made: Any, rpm: RpmFilter) -> None:  # noqa: ANN401
        made.harmonics, made.damping = rpm.harmonics, 1.0 / rpm.q
        made.turns = self.dt / (2.0 * math.pi)
        made.least, made.highest = rpm.min_hz * self.dt, RPM_FILTER_HIGHEST
        made.fade = 1.0 / (RPM_FILTER_FADE_HZ * self.dt)
        made.least_gain = math.tan(math.pi * made.least)

    def _controller(self, made: Any) -> None:  # noqa: ANN401
        rate_hz, motors = self.control_rate_hz, self.aircraft.motor_count
        enums = load("pathwise", "float32").lib
        made.mix = getattr(enums, f"MIX_{self.mix.name}")
        made.idle, made.dt = self.idle, 1.0 / rate_hz
        made.integral_max = RATE_ERROR_INTEGRAL_LIMIT_RAD
        assert (enums.ESC_BITS, enums.ESC_PERIOD_MAX) == (ESC_MANTISSA_BITS, ESC_PERIOD_MAX_US)
        made.sees_rotors = hears_rotors(self.terms)
        made.rotors_late = self.noise and any(self.aircraft.gyro.noise)
        made.words = self.rounded and made.rotors_late
        made.rotor_turn = ELECTRICAL_TURN / MOTOR_POLES_DEFAULT
        made.terms = len(self.terms)
        for term, scale, own in zip(self.terms, self.scales, made.term, strict=False):
            own.block, own.width, own.age = _code(term), term.count(motors), term.age
            own.gain, own.scale = term.gain(rate_hz), scale
        if needs_model(self.terms):
            self._estimator(made.estimator)
        shape, network = self.shape, made.network
        network.layers = len(shape.widths) - 1
        _fill(network.width, np.array(shape.widths))
        network.memory = getattr(enums, f"MEMORY_{shape.recurrent.upper()}")
        network.activation = getattr(enums, f"ACTIVATION_{shape.activation.upper()}")
        output = shape.output
        network.scale, network.offset, network.squash = output.scale, output.offset, output.squash

    def _estimator(self, made: Any) -> None:  # noqa: ANN401
        model = self.model
        assert model is not None
        made.present = True
        made.measures = measures_rotors(self.terms)
        made.delay = model.delay_steps
        made.speed_curve = list(model.speed_curve)
        for name in ("rise", "fall", "gain_max", "loss_max", "correction"):
            setattr(made, name, getattr(model, name))
        _fill(made.turn, np.array(model.turn))
        _fill(made.reaction, np.array(model.reaction))


def _code(term: ObservationTerm) -> int:
    """Return the block that C takes the term from: the model's rotors are the measured ones, or not."""
    name = "rotor_estimate" if term.name == "rotor_measured" else term.name
    return next(block.code for block in OBSERVATION_BLOCKS if block.name == name)


def put_aircraft(made: Any, aircraft: Aircraft, dt: float) -> None:  # noqa: ANN401
    """Fill in a plan what rotors and body of `aircraft` do in samples of `dt` [s]."""
    propulsion, geometry, motors = aircraft.propulsion, rotor_geometry(aircraft), aircraft.motor_count
    made.dt, made.motors = dt, motors
    inertia = aircraft.mass_properties.inertia
    made.body.inertia = inertia.ravel().tolist()
    made.body.inverse = np.linalg.inv(inertia).ravel().tolist()
    own = made.propulsion
    own.speed_curve = list(propulsion.speed_curve)
    for name, terms in (("thrust", propulsion.thrust_coefficient), ("torque", propulsion.torque_ratio)):
        polynomial = getattr(own, name)
        polynomial.terms = len(terms)
        _fill(polynomial.term, np.array(terms))
    own.limited = isinstance(propulsion.response, TorqueResponse)
    _fill(own.lever, geometry.thrust_wrench[:, 3:5])
    _fill(own.drag, geometry.torque_wrench[:, 5])
    _fill(own.reaction, geometry.reaction_wrench[:, 5] / dt)
    _fill(own.motion, geometry.motion_wrench.reshape(motors, 6, 6)[:, 3:, 3:].transpose(0, 2, 1))


def _fill(members: Any, values: NDArray[Any]) -> None:  # noqa: ANN401
    """Fill the start of an array of a struct."""
    for i, value in enumerate(values.ravel().tolist()):
        members[i] = value
