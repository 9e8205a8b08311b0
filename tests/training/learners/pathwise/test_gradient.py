"""The gradient of a batch of flights against differences of flights, through pybullet from end to end."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.aircraft.model import load_aircraft
from sim.control.observation import Observer
from sim.physics.derivative import StepModel
from sim.physics.twin import Twin
from sim.physics.variation import Variation
from toolchain.contract import observation_blocks
from training.config.training_config import OBSERVATION_SCALES, OutputMap
from training.learners.pathwise import flight as flying
from training.learners.pathwise.descent import with_parameters
from training.learners.pathwise.flight import Batch, Flight, fly
from training.learners.pathwise.gradient import gradient
from training.learners.pathwise.loss import Figures, Weights, figures_and_gradient
from training.learners.pathwise.network import Network
from training.tasks.random_steps import StepWeights

Floats = NDArray[np.float32]
STEPS, RATE_HZ, IDLE = 120, 1000, 0.2
WEIGHTS = Weights(square=0.03, output=10.0, change=5.0)
TERMS = (
    "rate_error,rate_error_delta,rate_error_integral,previous_action,throttle",
    "rate,rate~15Hz,rate_error~40Hz@3,rate_error_delta~60Hz,previous_action~30Hz@2",
    "rate_error@1,rate_error@2,rate_error_delta@1,rate_error_integral@4,rotor_speed",
)


class Case:
    """A batch of flights of an aircraft, repeatable with other weights."""

    def __init__(
        self, name: str, observation: str, *, activation: str = "tanh", squash: bool = False
    ) -> None:
        self.aircraft = load_aircraft(name)
        motors, count = self.aircraft.motor_count, 4
        self.terms = observation_blocks(observation)
        self.scale = np.array(
            [OBSERVATION_SCALES[t.name] for t in self.terms for _ in range(t.count(motors))], np.float32
        )
        rng = np.random.default_rng(3)
        output = OutputMap(squash=squash)
        widths = [len(self.scale), 12, 10, motors]
        self.network = Network.fresh(widths, activation, output, 0.4, rng)
        last = self.network.layers[-1]
        last.weight[:] *= 10.0
        setpoint = np.zeros((STEPS, count, 3), np.float32)
        setpoint[30:] = rng.normal(0.0, 1.5, (count, 3))
        self.batch = Batch(
            setpoint=setpoint,
            step_weights=StepWeights(*rng.uniform(0.5, 1.5, (3, count, STEPS))),
            throttle=np.array([0.0, 0.3, 0.0, 0.6], np.float32),
            variation=Variation.nominal(count, self.aircraft.propulsion.delay),
        )

    def flown(self, network: Network) -> tuple[Flight, Figures]:
        count, motors = self.batch.setpoint.shape[1], self.aircraft.motor_count
        twin = Twin(self.aircraft, count, rate_hz=RATE_HZ, rng=np.random.default_rng(5))
        try:
            observer = Observer(self.terms, count, motors, RATE_HZ)
            flight = fly(twin, observer, network, self.scale, self.batch, IDLE)
        finally:
            twin.close()
        return flight, figures_and_gradient(flight, self.batch, WEIGHTS)[0]

    def gradient(self) -> list[Floats]:
        flight, _ = self.flown(self.network)
        _, by_flight = figures_and_gradient(flight, self.batch, WEIGHTS)
        model = StepModel.of(self.aircraft, RATE_HZ, self.batch.variation)
        gyro = self.aircraft.gyro
        return gradient(
            flight, self.batch, by_flight, self.network, self.scale, self.terms, model, gyro, IDLE
        )

    def slope(self, direction: list[Floats], length: float) -> float:
        """Slope of the loss along `direction` in the space of weights, by a central difference."""
        losses = []
        for way in (length, -length):
            moved = [p + np.float32(way) * d for p, d in zip(self.network.parameters, direction, strict=True)]
            losses.append(self.flown(with_parameters(self.network, moved))[1].loss(WEIGHTS))
        return (losses[0] - losses[1]) / (2.0 * length)


@pytest.fixture
def smooth(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chip without counts and ESCs without steps, so that rounding does not dominate differences."""

    def commands(y: Floats, throttle: Floats, idle: float) -> NDArray[np.float64]:
        u = y + (throttle * (1.0 - y.max(axis=1)))[:, None]
        return np.asarray(idle + (1.0 - idle) * u.astype(np.float64))

    monkeypatch.setattr(flying, "quantised_rate", lambda rate: rate.astype(np.float32))
    monkeypatch.setattr(flying, "motor_commands", commands)


def only(found: list[Floats], part: int) -> tuple[list[Floats], float]:
    """The direction of steepest ascent in one array of weights alone, and the slope along it."""
    length = float(np.linalg.norm(found[part]))
    return [a / np.float32(length) if i == part else np.zeros_like(a) for i, a in enumerate(found)], length


@pytest.mark.usefixtures("smooth")
@pytest.mark.parametrize("observation", TERMS)
@pytest.mark.parametrize("name", ["nf1", "hexa"])
def test_gradient_is_the_slope_of_the_loss_when_flights_are_repeated(name: str, observation: str) -> None:
    case = Case(name, observation)
    found = case.gradient()
    for part in range(len(found)):
        direction, slope = only(found, part)
        # Short: a racer's rotor speeds drive the first layer far up its curve.
        assert case.slope(direction, 4e-4) == pytest.approx(slope, rel=0.01)
