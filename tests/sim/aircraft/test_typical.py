"""Typical aircraft against what others measured, and answers that fit no aircraft."""

import itertools
import math
import tomllib
from collections.abc import Callable

import numpy as np
import pytest

from neuroflight.sim.aircraft.known import How, keys_of, mark_of
from neuroflight.sim.aircraft.model import RPM, load_aircraft
from neuroflight.sim.aircraft.typical import Answers, Propeller, typical
from neuroflight.sim.aircraft.typical.answers import completed, parse_stator
from neuroflight.sim.aircraft.typical.drive import figure_of_merit, motor_strength, speed_curve, static_thrust
from neuroflight.sim.design.airworthiness import Level, examine
from neuroflight.sim.design.figures import aircraft_figures
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import AircraftError

# Full throttle at rest: motor, propeller, volts, grams, rpm. Mini Quad Test Bench's Emax Eco 2306 and T-Motor
# F60 Pro II; the Multi-robot Systems group's motor tests, ctu-mrs.github.io/docs/hardware/motor_tests.
THRUST_TESTS = [
    (2400, "2306", "5x4x3", 15.7, 1187, 29656),
    (2400, "2306", "5x4.3x3", 15.7, 1274, 28428),
    (2400, "2306", "5x4.5x3", 15.7, 1283, 28030),
    (2400, "2306", "5.1x4.3x3", 15.7, 1301, 27590),
    (2400, "2306", "5.1x4.9x3", 15.7, 1353, 27140),
    (780, "3110", "11x4.7", 15.95, 1876, 8951),
    (780, "3110", "11x5.5", 15.91, 1576, 9168),
    (780, "3110", "11x5", 16.02, 1538, 9159),
    (780, "3110", "10x4.5", 16.26, 1546, 9836),
    (320, "4114", "15x5.5", 24.41, 2545, 5832),
    (320, "4114", "15x7.5", 24.52, 2373, 6376),
]


@pytest.mark.parametrize(("kv", "motor", "propeller", "volts", "grams", "rpm"), THRUST_TESTS)
def test_full_throttle_is_near_a_published_thrust_test(
    kv: int, motor: str, propeller: str, volts: float, grams: int, rpm: int
) -> None:
    answers = Answers(1.5, 4, kv, Propeller.parse(propeller), 0.3, parse_stator(motor))
    whole = completed(answers)
    c_t = static_thrust(whole.pitch / whole.diameter, whole.blades)
    k_t = c_t * 1.225 * whole.diameter**4 / (2 * math.pi) ** 2
    merit = figure_of_merit(whole.diameter, whole.blades)
    k_q = whole.diameter * math.sqrt(2 * c_t / math.pi) / (2 * math.pi * merit)
    full, _ = speed_curve(kv, volts, k_t * k_q, motor_strength(whole.motor_mass))
    assert full / RPM == pytest.approx(rpm, rel=0.11)
    assert k_t * full**2 == pytest.approx(grams / 1000 * GRAVITY, rel=0.20)


# Rotor speed over the pack's voltage [rpm/V] at steady throttles in flight, medians of a public log with ESC
# telemetry: an iFlight Chimera7 Pro V2, log 3 of dfsilva/bucksaw's btfl_005.bbl, its motors' Kv from memory.
TELEMETRY = {0.18: 242, 0.282: 355, 0.364: 436, 0.449: 513, 0.516: 578, 0.617: 674, 0.705: 755}


def test_speed_over_throttle_is_near_that_of_a_public_log() -> None:
    answers = Answers(1.3, 6, 1250, Propeller.parse("7.5x3.7x3"), 0.165, (28.0, 9.0))
    propulsion = typical(answers).aircraft().propulsion
    assert propulsion.supply_voltage is not None
    for throttle, told in TELEMETRY.items():
        speed = np.polyval(propulsion.speed_curve, throttle) / RPM / propulsion.supply_voltage
        assert speed == pytest.approx(told, rel=0.10), throttle


def test_authority_is_near_that_of_the_measured_nf1() -> None:
    nf1 = aircraft_figures(load_aircraft("nf1"))
    answers = Answers(0.391, 4, 2522, Propeller.parse("5.1x4.5x3"), 0.1067, (22, 4), 1.5)
    mine = aircraft_figures(typical(answers).aircraft())
    # Its propellers push 1.8 times less than such ones do in other tests; in a hover that hardly counts.
    assert mine.hover_acceleration[:2] == pytest.approx(nf1.hover_acceleration[:2], rel=0.12)
    assert mine.hover_acceleration[2] == pytest.approx(nf1.hover_acceleration[2], rel=0.4)
    assert mine.principal_moments == pytest.approx(nf1.principal_moments, rel=0.12)


# Mass, moments, arm and propeller as their authors publish them: the Crazyflie of Penn's flightsim, RotorS'
# Hummingbird, PX4's Iris.
@pytest.mark.parametrize(
    ("answers", "moments"),
    [
        (Answers(0.030, 1, None, Propeller.parse("46mmx2"), 0.046), (1.43e-5, 1.43e-5, 2.89e-5)),
        (Answers(0.68, 3, 1000, Propeller.parse("8x4.5"), 0.17), (7.0e-3, 7.0e-3, 12.0e-3)),
        (Answers(1.5, 3, 850, Propeller.parse("10x4.7"), 0.25), (29e-3, 29e-3, 55e-3)),
    ],
)
def test_moments_are_within_half_of_published_ones(answers: Answers, moments: tuple[float, ...]) -> None:
    ratio = aircraft_figures(typical(answers).aircraft()).principal_moments / np.array(moments)
    assert ratio.min() > 0.6 and ratio.max() < 1.5


def test_every_weight_gives_an_aircraft_that_flies_with_every_number_marked() -> None:
    authority = []
    for weight in (0.02, 0.03, 0.06, 0.1, 0.25, 0.65, 1.2, 3.0):
        made = typical(Answers(weight))
        aircraft = made.aircraft()
        figures, verdicts = examine(aircraft)
        assert not [each for each in verdicts if each.level is Level.ERROR], weight
        assert aircraft.mass_properties.mass == pytest.approx(weight, rel=0.01)
        assert 2 < figures.thrust_to_weight < 14
        authority.append(figures.hover_acceleration[0])
        assert 0.01 < aircraft.propulsion.response.time_constant_up < 0.09  # type: ignore[union-attr]
        assert aircraft.known == made.known
        assert all(mark_of(made.known, key) for key in keys_of(tomllib.loads(made.text)))
    assert authority[1] > authority[4] > authority[5] > authority[7]  # the larger, the slower it turns


def test_an_answer_makes_of_a_guess_what_is_typical_or_measured() -> None:
    few = typical(Answers(0.65)).known
    many = typical(Answers(0.65, 6, 1950, Propeller.parse("5.1x4.3x3"), 0.11, (22, 7), 1.3, "dshot")).known
    for key, how in (
        ("rotor", How.MEASURED),
        ("battery.capacity_ah", How.MEASURED),
        ("propulsion.thrust_coefficient", How.TYPICAL),
        ("propulsion.speed_curve_rpm", How.TYPICAL),
        ("propulsion.response", How.TYPICAL),
    ):
        assert few[key].how is How.GUESSED and many[key].how is how, key
    assert many["body"].how is How.GUESSED


def test_answers_move_what_they_should() -> None:
    base = {"weight_kg": 0.65, "cells": 6, "kv": 1950.0, "arm_m": 0.11}

    def of(**changed: object) -> tuple[float, float, float, float]:
        made = typical(Answers(**(base | changed))).aircraft()  # type: ignore[arg-type]
        moments = made.mass_properties.inertia[0, 0]
        drive = made.propulsion
        return moments, drive.speed_max, drive.thrust_coefficient[0], drive.rotor_inertia

    plain = of()
    assert of(arm_m=0.13)[0] > plain[0]
    assert of(kv=1700.0)[1] < plain[1]
    assert of(cells=5)[1] < plain[1]
    assert of(propeller=Propeller.parse("5.1x5x3"))[2] > of(propeller=Propeller.parse("5.1x4x3"))[2]
    assert of(propeller=Propeller.parse("5.1x4x3"))[2] > of(propeller=Propeller.parse("5.1x4x2"))[2]
    assert of(stator_mm=(24.0, 8.0))[3] > of(stator_mm=(20.0, 5.0))[3]
    turned = typical(Answers(0.65, props_out=True)).aircraft().spins
    assert turned.tolist() == (-typical(Answers(0.65)).aircraft().spins).tolist()


@pytest.mark.parametrize(
    ("text", "diameter", "pitch", "blades"),
    [
        ("5.1x4.3x3", 0.12954, 0.10922, 3),
        (" 10 X 4,7 ", 0.254, 0.11938, 2),
        ("31mmx4", 0.031, None, 4),
        ("40mm", 0.040, None, None),
    ],
)
def test_propellers_are_read_as_they_are_sold(
    text: str, diameter: float, pitch: float | None, blades: int | None
) -> None:
    read = Propeller.parse(text)
    assert read.diameter_m == pytest.approx(diameter) and read.blades == blades
    assert read.pitch_m == (None if pitch is None else pytest.approx(pitch))


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Propeller.parse("51433"), "propeller '51433': expected diameter x pitch x blades"),
        (lambda: Propeller.parse("4.3x9x3"), "propeller '4.3x9x3'"),
        (lambda: parse_stator("22"), "motor size '22': expected the stator's diameter and height"),
        (lambda: Answers(680), "weight: got 680 kg, expected 0.015 to 25 kg: with its battery, in kilograms"),
        (lambda: Answers(math.nan), "weight: got nan"),
        (lambda: Answers(0.68, 0), "cells: got 0, expected 1 to 14"),
        (lambda: Answers(0.68, protocol="dshot600"), "protocol 'dshot600': expected one of: dshot"),
        (lambda: typical(Answers(0.68, arm_m=0.05)), "propellers of 132 mm would touch"),
        (lambda: typical(Answers(3.0, 1, 400)), "on 1S lift .* kg, the aircraft weighs 3 kg; check weight"),
        (lambda: typical(Answers(0.1, stator_mm=(31.0, 15.0))), "weight 100 g: four motors"),
    ],
)
def test_answers_that_fit_no_aircraft_are_refused_by_one_line(make: Callable[[], object], told: str) -> None:
    with pytest.raises(AircraftError, match=told) as refused:
        make()
    assert "\n" not in str(refused.value)


def test_every_combination_of_sizes_gives_a_sound_file_or_one_line() -> None:
    sizes = ("31mmx4", "3x2.5x3", "5.1x4.3x3", "10x4.7")
    made = 0
    for weight, size, cells, arm in itertools.product((0.03, 0.25, 0.68, 3.0), sizes, (1, 4, 8), (None, 0.1)):
        try:
            found = typical(Answers(weight, cells, None, Propeller.parse(size), arm))
        except AircraftError as error:
            assert "\n" not in str(error)
        else:
            found.aircraft()
            made += 1
    assert made > 40
