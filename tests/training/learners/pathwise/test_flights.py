"""Flights in C against the twin, pybullet included."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.gyro_filter import GyroFilter
from neuroflight.sim.control.motors import raised, throttle_mix
from neuroflight.sim.control.observation import Observer
from neuroflight.sim.physics.esc import rotor_words, words_speed
from neuroflight.sim.physics.imu import quantised_rate
from neuroflight.sim.physics.twin import Twin
from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.policy.gyro_filters import GyroFilters, RpmFilter
from neuroflight.training.learners.pathwise.flights import Flights, Record
from tests.sampling import sampled
from tests.training.learners.pathwise.cases import MEASURED, RATE_HZ, WEIGHTS, Case
from tests.training.learners.pathwise.reference import Network

NAMES = ("nf1", "iris", "hexa")


def recorded(case: Case) -> Record:
    flights = Flights(case.surroundings)
    _, record = flights.record(case.batch(), case.parameters(), WEIGHTS)
    flights.close()
    return record


def flown_by_twin(case: Case) -> Record:
    """The same flights in the twin, with the observation and the mix that everybody uses."""
    own, batch = case.surroundings, case.batch()
    count, aircraft = case.count, own.aircraft
    twin = Twin(
        aircraft,
        count,
        rate_hz=RATE_HZ * case.samples,
        noise=False,
        variation=batch.variation,
        rng=np.random.default_rng(0),
    )
    observer = Observer(own.terms, count, aircraft.motor_count, RATE_HZ, model=own.model, idle=own.idle)
    network = Network(own.shape, case.parameters())
    scale = [
        own.scales[i] for i, term in enumerate(own.terms) for _ in range(term.count(aircraft.motor_count))
    ]
    action, everyone = np.zeros((count, aircraft.motor_count), np.float32), slice(None)
    rates, speeds, seen, fractions = [twin.rate], [twin.rotor_speed], [], []
    for k in range(case.steps):
        last = np.array(rates[-case.samples :])
        gyro = np.concatenate([np.repeat(last[:1], case.samples - len(last), axis=0), last]).mean(axis=0)
        sensed = {"rotor_speed": twin.told_speed} if "rotor_speed" in observer.names else {}
        throttle = batch.throttle[:, k]
        raw = observer.observe(
            everyone, batch.setpoint[:, k], gyro.astype(np.float32), action, throttle, **sensed
        )
        seen.append(raw * np.array(scale, np.float32))
        action = np.clip(network(seen[-1]), np.float32(0.0), np.float32(1.0))
        mixed = throttle_mix(action, throttle, own.mix)
        observer.commanded(everyone, mixed, throttle)
        fractions.append(raised(mixed, own.idle))
        for _ in range(case.samples if k + 1 < case.steps else 0):
            twin.step(fractions[-1])
            rates.append(twin.rate)
            speeds.append(twin.rotor_speed)
    twin.close()
    told = [np.moveaxis(np.array(part, np.float64), 1, 2) for part in (rates, speeds, seen, fractions)]
    return Record(told[0], told[1], told[2], told[3])


def assert_close(case: Case, found: Record, twin: Record) -> None:
    speed_max = case.surroundings.aircraft.propulsion.speed_max
    assert np.abs(twin.rate).max() > 0.2
    assert found.rotor_speed == pytest.approx(twin.rotor_speed, abs=1e-4 * speed_max)
    assert found.rate == pytest.approx(twin.rate, abs=1e-4 * np.abs(twin.rate).max())
    assert found.motors == pytest.approx(twin.motors, abs=1e-4)
    assert found.observation == pytest.approx(twin.observation, abs=1e-3)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("charge", sampled([None, 0.6], 0.6))
def test_flight_is_the_twins_when_outputs_do_not_depend_on_it(name: str, charge: float | None) -> None:
    # Later the Iris' battery and rotors swing against each other from sample to sample, the twin's likewise.
    steps = 700 if charge is None else 400
    case = Case(name, "rate_error", steps=steps, noise=False, charge=np.nan if charge is None else charge)
    parameters = np.zeros_like(case.parameters())
    motors = case.surroundings.aircraft.motor_count
    parameters[-motors:] = np.random.default_rng(6).uniform(-1.0, 1.0, motors) * (
        0.02 if name == "nf1" else 0.1
    )
    case = replace(case, weights=parameters)
    assert_close(case, recorded(case), flown_by_twin(case))


@pytest.mark.parametrize(
    "which", sampled(product(NAMES, Mix), ("nf1", Mix.CENTRED), ("hexa", Mix.ATTITUDE_FIRST))
)
def test_flight_is_the_twins_when_a_policy_flies(which: tuple[str, Mix]) -> None:
    name, mix = which
    case = Case(name, mix=mix, steps=350, noise=False, strength=0.05)
    assert_close(case, recorded(case), flown_by_twin(case))


@pytest.mark.parametrize(
    "case",
    [
        Case(noise=False, samples=1, strength=0.05, steps=250),
        Case(noise=False, recurrent="gru", strength=0.05, steps=250),
        Case(noise=False, recurrent="lstm", strength=0.05, steps=250),
        Case(noise=False, activation="relu", squash=True, strength=0.05, steps=250),
        Case(observation="rate~15Hz,rate_error~40Hz@3,previous_motors@2,rotor_estimate~90Hz@1", noise=False),
        Case(observation=MEASURED, noise=False, strength=0.05, steps=250),
    ],
    ids=["a sample a control step", "gru", "lstm", "relu and squash", "low-passes and ages", "measured"],
)
def test_flight_is_the_twins_when_the_policy_differs(case: Case) -> None:
    assert_close(case, recorded(case), flown_by_twin(case))


def test_rotor_speeds_are_those_of_the_esc_words_a_sample_late() -> None:
    case = Case(observation="rotor_speed", rounded=True, strength=0.3, steps=300)
    record = recorded(case)
    late = np.concatenate([np.zeros_like(record.rotor_speed[:1]), record.rotor_speed[3:-1:4]])
    told = words_speed(rotor_words(late))
    seen = record.observation / case.surroundings.scales[0]
    assert seen.max() > 100.0
    near = np.abs(seen - told) <= 1e-3 * told
    assert near.mean() > 0.999  # periods beside a whole microsecond are rounded in float32 or in float64
    assert np.abs(seen - told).max() < 0.005 * told.max()


def test_gyro_has_bias_white_noise_and_counts() -> None:
    case = Case(observation="rate", samples=1, steps=2000, rounded=True, count=16, varied=False, strength=0.0)
    record = recorded(case)
    read = record.observation / 0.3
    noise = np.asarray(read) - record.rate
    gyro = load_aircraft("nf1").gyro
    assert noise.std(axis=0).mean(axis=1) == pytest.approx(gyro.noise, rel=0.03)
    assert noise.mean(axis=0).std() == pytest.approx(gyro.bias, rel=0.3)
    assert quantised_rate(read.astype(np.float64)) == pytest.approx(read, abs=1e-6)


def test_mean_of_four_samples_has_half_the_noise() -> None:
    case = Case(observation="rate", samples=4, steps=2000, count=16, varied=False, strength=0.0)
    noise = recorded(case).observation / 0.3 - recorded(case).rate[::4]
    assert noise.std(axis=0).mean(axis=1) == pytest.approx(
        np.array(load_aircraft("nf1").gyro.noise) / 2, rel=0.03
    )


def test_gyro_lags_turns_and_vibrates_as_the_twins() -> None:
    aircraft = load_aircraft("nf1")
    gyro = replace(
        aircraft.gyro,
        noise=(0.0, 0.0, 0.0),
        bias=0.0,
        bandwidth_hz=80.0,
        misalignment=(0.02, -0.03, 0.05),
        vibration=(0.3, 0.2, 0.1),
        harmonics=(0.5, 0.7),
    )
    case = Case(
        aircraft=replace(aircraft, gyro=gyro), observation="rate", samples=1, steps=400, count=3, varied=False
    )
    record = recorded(case)
    assert record.observation / 0.3 == pytest.approx(sensed_by_twin(case, record), abs=2e-3)


def sensed_by_twin(case: Case, record: Record) -> NDArray[np.float64]:
    """What the twin's gyro reads while its rotors do what they did in `record`, phases included."""
    own, samples = case.surroundings, case.samples
    twin = Twin(
        own.aircraft,
        case.count,
        rate_hz=samples * RATE_HZ,
        variation=case.batch().variation,
        rng=np.random.default_rng(0),
    )
    filter_ = GyroFilter(own.filters, case.count, 4, RATE_HZ, samples)
    phases = np.random.Generator(np.random.SFC64([case.batch().seed, 0])).uniform(-0.5, 0.5, (4, 16))
    twin._phase[:] = 2.0 * np.pi * phases[:, : case.count].T  # type: ignore[index]
    filter_.add(record.rate[0].T.astype(np.float32))
    read = [filter_.read()]
    for k in range(case.steps - 1):
        for left in reversed(range(samples)):
            twin.step(record.motors[k].T)
            if left == 0:
                filter_.told(twin.told_speed)
            filter_.add(twin.gyro.astype(np.float32))
        read.append(filter_.read())
    twin.close()
    return np.moveaxis(np.array(read), 1, 2)


@pytest.mark.parametrize(
    "filters", [GyroFilters(RpmFilter(), mean=True), GyroFilters(RpmFilter(2, 120.0, 4.0))]
)
def test_gyro_is_filtered_as_the_twins_at_the_rotors_turns(filters: GyroFilters) -> None:
    aircraft = load_aircraft("nf1")
    gyro = replace(aircraft.gyro, noise=(0.0, 0.0, 0.0), bias=0.0, vibration=(0.6, 0.5, 0.3))
    case = Case(
        aircraft=replace(aircraft, gyro=gyro),
        observation="rate",
        filters=filters,
        steps=400,
        count=3,
        varied=False,
        strength=0.05,
    )
    record = recorded(case)
    seen = record.observation / 0.3
    assert seen == pytest.approx(sensed_by_twin(case, record), abs=5e-3)
    unfiltered = recorded(replace(case, filters=GyroFilters(mean=filters.mean)))
    assert np.abs(unfiltered.observation / 0.3 - unfiltered.rate[::4]).max() > 0.2


def test_gyro_vibrates_as_the_twins_by_what_is_drawn_for_each_aircraft() -> None:
    aircraft = load_aircraft("nf1")
    quiet = replace(aircraft, gyro=replace(aircraft.gyro, noise=(0.0, 0.0, 0.0), bias=0.0))
    case = Case(
        aircraft=quiet,
        observation="rate",
        samples=1,
        steps=400,
        count=3,
        varied=False,
        vibration=(0.0, 0.4, np.nan),
    )
    record = recorded(case)
    assert record.observation / 0.3 == pytest.approx(sensed_by_twin(case, record), abs=2e-3)
    shaken = np.abs(record.observation / 0.3 - record.rate).max(axis=(0, 1))
    assert shaken[1] > 0.3 and shaken[[0, 2]].max() < 1e-6


def test_an_aircraft_turns_as_fast_as_a_disturbance_accelerates_it() -> None:
    case = Case(observation="rate", steps=200, count=3, varied=False, noise=False, idle=0.0)
    acceleration = np.zeros((3, 200, 3), np.float32)
    for axis, value in enumerate((40.0, -25.0, 10.0)):  # an axis each, so that nothing couples them
        acceleration[axis, :, axis] = value
    acceleration[:, 100:] = 0.0
    still = replace(case.batch(), throttle=np.zeros((3, 200), np.float32), disturbance=acceleration)
    flights = Flights(case.surroundings, number="float64")
    _, record = flights.record(still, np.zeros(case.surroundings.shape.count), WEIGHTS)
    flights.close()
    t = np.minimum(np.arange(len(record.rate)) / 4000, 0.1)
    turned = record.rate.transpose(2, 0, 1)
    for aircraft, rate in enumerate((40.0, -25.0, 10.0)):
        np.testing.assert_allclose(turned[aircraft, :, aircraft], rate * t, rtol=0.02, atol=1e-9)
