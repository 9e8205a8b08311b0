"""Batches of flights for the tests of the pathwise learner."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.control.estimator import model_constants
from neuroflight.sim.physics.variation import Variation
from neuroflight.toolchain.contract import Mix, needs_model, observation_blocks
from neuroflight.toolchain.policy.gyro_filters import MEAN, GyroFilters
from neuroflight.training.config.training_config import OBSERVATION_SCALES, OutputMap
from neuroflight.training.learners.network.shape import Shape
from neuroflight.training.learners.pathwise.batch import Batch, disturbances
from neuroflight.training.learners.pathwise.loss import Weights
from neuroflight.training.learners.pathwise.plan import Surroundings
from neuroflight.training.tasks.random_steps import StepWeights

RATE_HZ = 1000
WEIGHTS = Weights(square=0.03, output=10.0, change=5.0, closed=20.0)
EVERY_BLOCK = (
    "rate_error,rate,rate_error_integral,rate_error_delta,previous_action,rotor_speed,"
    "previous_motors,rotor_estimate,throttle,rate_estimate,rate_estimate_error"
)


MEASURED = EVERY_BLOCK.replace("rotor_estimate", "rotor_measured")


class InWords(Surroundings):
    """As it is, but ESCs tell rotor speeds in steps: a small change of a flight changes none of them."""

    def plan(self, weights: Weights, battery: bool, number: str) -> Any:
        made = super().plan(weights, battery, number)
        made.controller.words = True
        return made


@dataclass(frozen=True)
class Case:
    """A batch of flights whose weights, commands and aircraft are drawn, the same at every call."""

    name: str = "nf1"
    observation: str = EVERY_BLOCK
    hidden: tuple[int, ...] = (12, 10)
    activation: str = "tanh"
    squash: bool = False
    recurrent: str = "none"
    mix: Mix = Mix.CENTRED
    samples: int = 4
    filters: GyroFilters = MEAN
    of_motors: bool = True
    soft: float = 0.0
    idle: float = 0.1
    steps: int = 100
    count: int = 5
    charge: float = np.nan
    vibration: tuple[float, ...] = ()  # [rad/s], drawn for each of the aircraft
    disturbance: float = 0.0
    varied: bool = True
    noise: bool = True
    rounded: bool = False
    strength: float = 0.2  # of the last layer
    aircraft: Aircraft | None = None  # instead of the one with this name
    weights: NDArray[np.float32] | None = field(default=None, compare=False)  # instead of drawn ones

    @property
    def surroundings(self) -> Surroundings:
        """What is flown."""
        aircraft = self.aircraft or load_aircraft(self.name)
        terms, motors = observation_blocks(self.observation), aircraft.motor_count
        inputs = sum(term.count(motors) for term in terms)
        kind = Surroundings if self.filters.rpm is None else InWords
        return kind(
            aircraft=aircraft,
            steps=self.steps,
            control_rate_hz=RATE_HZ,
            samples=self.samples,
            filters=self.filters,
            terms=terms,
            scales=tuple(OBSERVATION_SCALES[term.name] for term in terms),
            mix=self.mix,
            idle=self.idle,
            model=model_constants(aircraft, RATE_HZ) if needs_model(terms) else None,
            shape=Shape(
                (inputs, *self.hidden, motors),
                self.activation,
                OutputMap(squash=self.squash),
                self.recurrent,
            ),
            of_motors=self.of_motors,
            soft=self.soft,
            noise=self.noise,
            rounded=self.rounded,
            shaken=bool(self.vibration),
        )

    def batch(self) -> Batch:
        """Episodes with a step of all axes and of the throttle."""
        rng, count = np.random.default_rng(3), self.count
        setpoint = np.zeros((count, self.steps, 3), np.float32)
        setpoint[:, 30:] = rng.normal(0.0, 1.5, (count, 1, 3))
        throttle = np.tile(np.linspace(0.0, 0.8, count, dtype=np.float32)[:, None], (1, self.steps))
        throttle[1:, 60:] = 0.4
        variation = self.variation(rng)
        weights = StepWeights(*rng.uniform(0.5, 1.5, (3, count, self.steps)))
        disturbance = None
        if self.disturbance:
            disturbance = disturbances(count, self.steps, RATE_HZ, self.disturbance, rng)
        return Batch(setpoint, weights, throttle, variation, seed=7, disturbance=disturbance)

    def variation(self, rng: np.random.Generator) -> Variation:
        """Aircraft that differ in all, if they are to."""
        count = self.count
        nominal = Variation.nominal(count, self.surroundings.aircraft.propulsion.delay)
        nominal = replace(nominal, charge=np.full(count, self.charge))
        if self.vibration:
            nominal = replace(nominal, vibration=np.array(self.vibration))
        if not self.varied:
            return nominal
        names = ("inertia", "thrust", "torque", "speed", "lag")
        factors = {name: rng.uniform(0.8, 1.2, count) for name in names}
        delay = rng.uniform(0.0, 0.005, count)
        motors = rng.uniform(0.8, 1.2, nominal.motors.shape)
        return replace(nominal, **factors, delay_s=delay, motors=motors)

    def parameters(self) -> NDArray[np.float32]:
        """Weights of the network; its last layer is `strength` strong."""
        if self.weights is not None:
            return self.weights
        shape = self.surroundings.shape
        rng = np.random.default_rng(4)
        parameters = shape.fresh(0.4, rng)
        last = shape.split(parameters)[-2]
        last *= self.strength / 0.02
        # No two outputs are equal: which of them is the least or the greatest would have no derivative.
        return parameters + rng.normal(0.0, 0.01, len(parameters)).astype(np.float32)
