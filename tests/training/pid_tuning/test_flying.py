"""Trial flights of a PID tuning by flying terms: the C flights against the twin, and what costs."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.analysis.metrics import effort
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.control.pid_table import mixer, pid_settings
from neuroflight.sim.physics.variation import Variation
from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.policy.gyro_filters import MEAN
from neuroflight.training.evaluation.evaluation import record
from neuroflight.training.learners.pathwise.flights import LANES
from neuroflight.training.pid_tuning import flying
from neuroflight.training.pid_tuning.flying import (
    AS_FILED,
    HARDER,
    FlyingTrials,
    throttle_for,
)
from neuroflight.training.pid_tuning.trial import Limits
from tests.given_task import Given
from tests.sampling import sampled

NF1 = load_aircraft("nf1")
FLYING = pid_settings(NF1, "flying")
LIMITS = Limits(1.0, flying.CHANGE, flying.IDLE, of_motors=True)


def twin_figures(aircraft: Aircraft, trials: FlyingTrials) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return MAE, MSE and change of the same flights, flown in the twin without the lasting moments."""
    flights = AS_FILED + HARDER
    delay = aircraft.propulsion.delay + np.array([flight.late_s for flight in flights])
    slow = np.array([flight.slow for flight in flights])
    flown = record(
        Pid(mixer(aircraft), FLYING, LANES, 1000),
        replace(aircraft, gyro=replace(aircraft.gyro, bias=0.0)),
        Given(np.ascontiguousarray(trials.setpoint.transpose(2, 0, 1))),
        episodes=LANES,
        seed=3,
        control_rate_hz=1000,
        throttle=np.array([throttle_for(aircraft, f.level, FLYING.idle) for f in flights], np.float32),
        idle=FLYING.idle,
        mix=Mix.CENTRED,
        gyro_filters=MEAN,
        variation=replace(Variation.nominal(LANES, aircraft.propulsion.delay), delay_s=delay, lag=slow),
    )
    error = np.rad2deg((flown.setpoint - flown.rate)[:, 500:].astype(np.float64))
    assert flown.motors is not None
    change = np.array([effort(motors[499:], 1e-3).change for motors in flown.motors])
    return np.abs(error).mean(axis=(1, 2)), (error**2).mean(axis=(1, 2)), change


@pytest.mark.parametrize(
    "which", sampled(product(("nf1", "hexa"), (True, False)), ("hexa", True), ("nf1", False))
)
def test_flights_are_those_of_the_twin(which: tuple[str, bool], monkeypatch: pytest.MonkeyPatch) -> None:
    """The twin's, by the firmware's PID; with noise, which is another there, nearly."""
    monkeypatch.setattr(flying, "OFF_CENTRE", 0.0)
    name, noisy = which
    aircraft, nothing = load_aircraft(name), (0.0, 0.0, 0.0)
    if not noisy:
        aircraft = replace(aircraft, gyro=replace(aircraft.gyro, noise=nothing, vibration=nothing))
    trials = FlyingTrials(aircraft, LIMITS, np.random.default_rng(5), pulses=1)
    trials.moment[:] = 0.0
    for own, twin in zip(trials.figures(FLYING), twin_figures(aircraft, trials), strict=True):
        assert own == pytest.approx(twin, rel=0.05 if noisy else 0.01)
        assert own.mean() == pytest.approx(twin.mean(), rel=0.015)


def test_integral_is_what_holds_a_lasting_moment() -> None:
    trials = FlyingTrials(NF1, LIMITS, np.random.default_rng(5), pulses=1)
    roll, pitch, yaw = ((p, max(i, 10.0), d) for p, i, d in FLYING.gains)
    steady = replace(FLYING, gains=(roll, pitch, yaw))
    without, held = (trials.figures(settings)[0] for settings in (FLYING, steady))
    hard = slice(len(AS_FILED), len(AS_FILED) + 2)  # not slow, commands as usual
    assert (held[hard] < 0.75 * without[hard]).all()


def test_cost_rises_beyond_the_limit_and_a_swinging_candidate_costs_most() -> None:
    rng = np.random.default_rng
    free, tight = (
        FlyingTrials(NF1, replace(LIMITS, change=change), rng(5), pulses=1) for change in (0.1, 0.003)
    )
    (loose,), (bound,) = free.fly([FLYING]), tight.fly([FLYING])
    assert (loose.mae, loose.change) == (bound.mae, bound.change)
    assert bound.cost == pytest.approx(loose.cost * (bound.change / (0.97 * 0.003)) ** 3)
    roll, pitch, yaw = ((8 * p, i, 8 * d) for p, i, d in FLYING.gains)
    (swinging,) = free.fly([replace(FLYING, gains=(roll, pitch, yaw))])
    assert swinging.cost > 2.5 * loose.cost


def test_same_figures_when_it_flies_alone_or_among_others() -> None:
    trials = FlyingTrials(NF1, LIMITS, np.random.default_rng(5), pulses=1)
    (alone,) = trials.fly([FLYING])
    assert trials.fly([replace(FLYING, derivative_cutoff_hz=60.0), FLYING])[1] == alone


def test_throttle_gives_the_thrust_and_leaves_room_to_steer() -> None:
    iris = load_aircraft("iris")
    assert throttle_for(iris, 0.0, 0.055) == 0.0
    assert throttle_for(iris, 50.0, 0.055) == flying.THROTTLE_MAX
    assert throttle_for(NF1, 1.0, 0.055) == pytest.approx(0.229, abs=0.003)
