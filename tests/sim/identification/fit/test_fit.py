"""The fit of a twin from its own flights, flown here by a controller that answers to noise."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.known import How
from neuroflight.sim.aircraft.model import Aircraft, aircraft_file, parse_aircraft
from neuroflight.sim.flight.trace import Trace, save_trace
from neuroflight.sim.identification.fit.estimate import prepare
from neuroflight.sim.identification.fit.fit import fit
from neuroflight.sim.identification.fit.flight import read_flight
from neuroflight.sim.identification.fit.held import explained
from neuroflight.sim.identification.fit.model import layout
from neuroflight.sim.identification.fit.parameters import authority
from neuroflight.sim.identification.fit.report import report_page
from neuroflight.sim.identification.fit.result import Fit
from neuroflight.sim.identification.fit.shaking import QUICK, shaking
from neuroflight.sim.identification.fit.write import fitted_text
from neuroflight.sim.physics.rotor import target_speed
from neuroflight.sim.physics.twin import Twin
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import TraceError

UP_S, DOWN_S, DELAY_S = 0.024, 0.032, 0.003
SECONDS, RATE = 14.0, 1000
RESPONSE = 'kind = "first_order"\ntime_constant_up_s = {}\ntime_constant_down_s = {}\n'


def text(up: float, down: float, delay: float, thrust: float = 1.0) -> str:
    """Return the NF1's file with this response, delay and factor of K_T."""
    whole = aircraft_file("nf1").read_text()
    whole = re.sub(
        r"(?s)(\[propulsion.response\]\n).*?(?=\n# |\n\[)", lambda m: m[1] + RESPONSE.format(up, down), whole
    )
    whole = whole.replace("delay_s = 0.002", f"delay_s = {delay}")
    return whole.replace("thrust_coefficient = 9.37e-7", f"thrust_coefficient = {9.37e-7 * thrust}")


TURNED_DEG = (1.0, -0.7, 1.5)  # of the gyro's chip
TRUE = text(UP_S, DOWN_S, DELAY_S).replace("[gyro]", f"[gyro]\nmisalignment_deg = {list(TURNED_DEG)}")
WRONG = text(0.036, 0.046, 0.0015, 1.4)


def aircraft(whole: str) -> Aircraft:
    return parse_aircraft(whole.encode(), "test")


@lru_cache(maxsize=2)
def flown(out: bool = False) -> Trace:
    """Fly stick taps of all axes on the true twin, held at its centre; out: propellers turn the other way."""
    craft = parse_aircraft(TRUE.encode(), "true", out=out)
    twin = Twin(craft, rate_hz=RATE, rng=np.random.default_rng(5))
    mix = np.column_stack(
        [np.sign(craft.rotor_positions[:, 1]), -np.sign(craft.rotor_positions[:, 0]), -craft.spins]
    )
    rng, steps = np.random.default_rng(7), int(SECONDS * RATE)
    asked = np.repeat(rng.normal(0.0, 2.0, (steps // 120 + 1, 3)), 120, axis=0)[:steps]
    rate, gyro, motors = np.zeros((steps, 3)), np.zeros((steps, 3)), np.zeros((steps, craft.motor_count))
    held = np.zeros(3)
    for step in range(steps):
        rate[step], gyro[step] = twin.rate[0], twin.gyro[0]
        error = asked[step] - gyro[step]
        held += error / RATE
        command = 0.35 + mix @ (np.array([0.02, 0.02, 0.05]) * error + np.array([0.1, 0.1, 0.3]) * held)
        motors[step] = np.clip(command, 0.05, 1.0)
        twin.step(motors[step : step + 1])
    return Trace(
        t=np.arange(steps) / RATE,
        setpoint=asked.astype(np.float32),
        rate=rate,
        gyro=gyro.astype(np.float32),
        motors=motors,
        dshot=(48 + 1999 * motors).astype(np.uint16),
        throttle=np.full(steps, 0.35, np.float32),
    )


@lru_cache(maxsize=1)
def fitted(folder: Path) -> Fit:
    path = folder / "flight.npz"
    save_trace(path, flown())
    return fit([read_flight(path, 4)], aircraft(WRONG))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fit")


def test_response_delay_and_authority_are_found_when_the_start_is_far_off(folder: Path) -> None:
    found = fitted(folder).parameters
    assert found["response.up_s"].value == pytest.approx(UP_S, rel=0.08)
    assert found["response.down_s"].value == pytest.approx(DOWN_S, rel=0.08)
    assert found["delay_s"].value == pytest.approx(DELAY_S, abs=3e-4)
    for axis in AXES:
        one = found[f"authority.{axis}"]
        assert one.value == pytest.approx(one.start / 1.4, rel=0.08), axis
        assert one.low < one.start / 1.4 < one.high, axis
    assert not fitted(folder).props_out and not fitted(folder).rewired


def test_the_written_file_flies_as_the_true_one_when_it_is_read_back(folder: Path) -> None:
    found = fitted(folder)
    written = aircraft(fitted_text(WRONG, aircraft(WRONG), found))
    flight = read_flight(folder / "flight.npz", 4)
    assert (explained([flight], written) > 0.99).all()
    assert (explained([flight], aircraft(WRONG)) < 0.95).all()
    assert written.known["propulsion.delay_s"].range is not None
    assert written.known["part"].how is How.MEASURED


def test_what_is_not_told_keeps_the_number_and_the_mark_of_the_start(folder: Path) -> None:
    untold = {key: replace(one, told=False) for key, one in fitted(folder).parameters.items()}
    wrong = aircraft(WRONG)
    written = aircraft(fitted_text(WRONG, wrong, replace(fitted(folder), parameters=untold)))
    assert written.propulsion == wrong.propulsion and written.gyro == wrong.gyro
    assert np.allclose(written.mass_properties.inertia, wrong.mass_properties.inertia, rtol=1e-12)
    assert written.known == wrong.known


def test_authority_that_is_told_holds_when_the_curve_is_not(folder: Path) -> None:
    found, wrong = fitted(folder), aircraft(WRONG)
    told = {**found.parameters, "curve": replace(found.parameters["curve"], told=False)}
    bent = replace(found, parameters=told, theta={**found.theta, "bend": found.theta["bend"] + 0.2})
    written = aircraft(fitted_text(WRONG, wrong, bent))
    assert written.propulsion.speed_curve == wrong.propulsion.speed_curve
    laid = layout(written, speeds=False, pack=False)
    there = authority(written, laid.values(laid.start), found.wiring, found.usual, found.volts)
    for axis, made in zip(AXES, there, strict=True):
        one = told[f"authority.{axis}"]
        assert made == pytest.approx(one.value if one.told else one.start, rel=1e-4), axis


def test_the_centre_of_mass_is_written_where_the_motors_hold_it(folder: Path) -> None:
    found, wrong = fitted(folder), aircraft(WRONG)
    off = replace(found.parameters["centre.y"], value=0.004, told=True)
    written = aircraft(
        fitted_text(WRONG, wrong, replace(found, parameters={**found.parameters, "centre.y": off}))
    )
    moved = wrong.rotor_positions.mean(axis=0) - written.rotor_positions.mean(axis=0)
    assert moved[1] == pytest.approx(0.004, rel=0.01)
    for name in ("x", "y"):
        assert abs(found.parameters[f"centre.{name}"].value) < 1e-3, name


def test_a_turned_gyro_is_found_and_written_where_the_log_tells_it(folder: Path) -> None:
    found, wrong = fitted(folder), aircraft(WRONG)
    for axis, true in zip(AXES, TURNED_DEG, strict=True):
        one = found.parameters[f"gyro.turn.{axis}"]
        assert one.told and one.low < true < one.high and one.value == pytest.approx(true, abs=0.5), axis
    untold = replace(found.parameters["gyro.turn.pitch"], told=False)
    written = aircraft(
        fitted_text(WRONG, wrong, replace(found, parameters={**found.parameters, "gyro.turn.pitch": untold}))
    )
    assert np.rad2deg(written.gyro.misalignment) == pytest.approx((1.0, 0.0, 1.5), abs=0.5)
    assert written.gyro.misalignment[1] == 0.0
    assert "gyro.misalignment_deg[0]" in written.known and "gyro.misalignment_deg[1]" not in written.known


def test_shaking_is_told_from_white_noise(folder: Path) -> None:
    rng, path = np.random.default_rng(8), folder / "shaken.npz"
    quiet = flown()
    motors = np.repeat(0.5 + 0.3 * np.sin(quiet.t)[:, None], 4, axis=1)
    share = target_speed(motors[:, :1], aircraft(TRUE).propulsion) / sum(
        aircraft(TRUE).propulsion.speed_curve
    )
    shake = (
        np.deg2rad(10.0) * np.sqrt(2.0) * share**2 * rng.normal(0.0, 1.0, (len(share), 3))
    )  # of four rotors
    save_trace(path, replace(quiet, gyro=(quiet.gyro + shake).astype(np.float32), motors=motors))
    flight, laid = read_flight(path, 4), fitted(folder)
    told = {one.key: one for one in shaking(prepare([flight], aircraft(WRONG)), laid.theta, flight.rate_hz,
                                            np.zeros((2, 3)), raw=True)}  # fmt: skip
    one = told["gyro.vibration.roll"]
    assert one.told and one.value == pytest.approx(10.0 * np.sqrt(1.0 - QUICK), rel=0.1)
    assert not fitted(folder).parameters["gyro.vibration.roll"].told


def test_propellers_that_turn_the_other_way_are_found_and_written(folder: Path) -> None:
    path = folder / "out.npz"
    save_trace(path, flown(out=True))
    found = fit([read_flight(path, 4)], aircraft(TRUE))
    assert found.props_out
    assert aircraft(fitted_text(TRUE, aircraft(TRUE), found)).spins.tolist() == [1.0, -1.0, -1.0, 1.0]


def test_the_page_says_whether_a_policy_would_fly(folder: Path) -> None:
    page = report_page([read_flight(folder / "flight.npz", 4)], aircraft(WRONG), fitted(folder))
    assert "should fly the logged aircraft" in page and page.count("data:image/png") == 2


def test_a_flight_is_refused_when_it_is_too_short(folder: Path) -> None:
    path = folder / "short.npz"
    save_trace(path, flown().first(2500))
    with pytest.raises(TraceError, match="expected at least 3; fly longer"):
        read_flight(path, 4)
