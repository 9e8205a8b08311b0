"""The gradient of a batch of flights against differences of flights, both in double precision."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.policy.gyro_filters import GyroFilters, RpmFilter
from neuroflight.training.learners.pathwise.flights import Flights
from tests.training.learners.pathwise.cases import EVERY_BLOCK, MEASURED, WEIGHTS, Case

Floats = NDArray[np.floating]

NO_ROTORS = EVERY_BLOCK.replace("rotor_speed,", "")  # of ESCs: these are told in steps, which have no slope
CASES = {
    "every block": Case(),
    "iris": Case("iris"),
    "hexa": Case("hexa"),
    "attitude first": Case(mix=Mix.ATTITUDE_FIRST),
    "a sample a control step": Case(samples=1),
    "change of the outputs": Case(of_motors=False),
    "small errors rounded off": Case(soft=30.0),
    "disturbed": Case(disturbance=100.0),
    "relu": Case(activation="relu", strength=0.05),
    "squashed": Case(squash=True),
    "a gru alone": Case(hidden=(7,), recurrent="gru"),
    "a gru before a layer": Case(recurrent="gru"),
    "an lstm alone": Case(hidden=(7,), recurrent="lstm"),
    "an lstm before a layer": Case(recurrent="lstm"),
    "measured rotors": Case(observation=MEASURED),
    "measured rotors without delay": Case(observation=MEASURED, noise=False),
    "notches": Case(observation=NO_ROTORS, filters=GyroFilters(RpmFilter(), mean=True)),
    "notches alone": Case("hexa", observation=NO_ROTORS, filters=GyroFilters(RpmFilter(2, 60.0, 3.0))),
    "low-passes": Case(observation=",".join(f"{name}~40Hz" for name in EVERY_BLOCK.split(","))),
    "ages": Case(observation=",".join(f"{name}@{1 + k}" for k, name in enumerate(EVERY_BLOCK.split(",")))),
    "all of a block": Case(observation="rate,rate~15Hz,rate~60Hz@3,rate@2,previous_motors@1,previous_motors"),
    "more than a block of aircraft": Case(observation="rate_error,rate", count=21),
}


def slope(flights: Flights, case: Case, start: Floats, direction: Floats, length: float) -> float:
    """Slope of the loss along `direction` in the space of weights, by a central difference."""
    batch = case.batch()
    ahead, behind = (
        flights.record(batch, start + way * direction, WEIGHTS)[0].loss(WEIGHTS) for way in (length, -length)
    )
    return (ahead - behind) / (2.0 * length)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_gradient_is_the_slope_of_the_loss_when_flights_are_repeated(case: Case) -> None:
    shape = case.surroundings.shape
    start = case.parameters().astype(np.float64)
    flights = Flights(case.surroundings, number="float64")
    _, found = flights.gradient(case.batch(), start, WEIGHTS)
    ends = np.cumsum([0, *(int(np.prod(part)) for part in shape.parts)])
    for begin, end in pairwise(ends):
        steepest = np.zeros_like(found)
        steepest[begin:end] = found[begin:end]
        length = float(np.linalg.norm(steepest))
        # The loss has kinks, where an error or a change passes through 0; one step or the other misses them.
        slopes = [slope(flights, case, start, steepest / length, step) for step in (1e-6, 1e-7, 1e-8)]
        assert min(abs(value / length - 1.0) for value in slopes) < 2e-6
    flights.close()


def test_gradient_misses_little_when_a_battery_sags() -> None:
    case = Case(charge=0.5)
    start = case.parameters().astype(np.float64)
    flights = Flights(case.surroundings, number="float64")
    _, found = flights.gradient(case.batch(), start, WEIGHTS)
    length = float(np.linalg.norm(found))
    assert slope(flights, case, start, found / length, 1e-6) == pytest.approx(length, rel=5e-3)
    flights.close()


@pytest.mark.parametrize("recurrent", ["none", "gru", "lstm"])
def test_single_precision_finds_the_gradient_of_double_precision(recurrent: str) -> None:
    case = Case(steps=400, recurrent=recurrent, noise=False)
    gradients = []
    for number in ("float32", "float64"):
        flights = Flights(case.surroundings, number=number)
        gradients.append(flights.gradient(case.batch(), case.parameters(), WEIGHTS)[1].astype(np.float64))
        flights.close()
    single, double = gradients
    assert np.linalg.norm(single - double) < 1e-3 * np.linalg.norm(double)


@pytest.mark.parametrize("count", [16, 33])
def test_gradient_has_the_same_bits_whatever_the_number_of_workers(count: int) -> None:
    case = Case(count=count, rounded=True)
    results = []
    for workers in (1, 2, 3):
        flights = Flights(case.surroundings, workers=workers)
        figures, found = flights.gradient(case.batch(), case.parameters(), WEIGHTS)
        results.append((figures, found.tobytes()))
        flights.close()
    assert results[0] == results[1] == results[2]
