"""The fit of a twin from its own flights, flown here by a controller that answers to noise."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Aircraft, aircraft_file, parse_aircraft
from neuroflight.sim.flight.trace import Trace, save_trace
from neuroflight.sim.identification.fit.fit import fit
from neuroflight.sim.identification.fit.flight import read_flight
from neuroflight.sim.identification.fit.held import explained
from neuroflight.sim.identification.fit.report import report_page
from neuroflight.sim.identification.fit.result import Fit
from neuroflight.sim.identification.fit.write import fitted_text
from neuroflight.sim.physics.twin import Twin
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


TRUE = text(UP_S, DOWN_S, DELAY_S)
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
    assert found["delay_s"].value == pytest.approx(DELAY_S, abs=6e-4)
    for axis in ("roll", "pitch"):
        one = found[f"authority.{axis}"]
        assert one.value == pytest.approx(one.start / 1.4, rel=0.08), axis
        assert one.low < one.start / 1.4 < one.high, axis
    assert not fitted(folder).props_out and not fitted(folder).rewired


def test_the_written_file_flies_as_the_true_one_when_it_is_read_back(folder: Path) -> None:
    found = fitted(folder)
    written = aircraft(fitted_text(WRONG, aircraft(WRONG), found))
    flight = read_flight(folder / "flight.npz", 4)
    assert (explained([flight], written) > 0.97).all()
    assert (explained([flight], written) > explained([flight], aircraft(WRONG))).all()
    assert written.known["propulsion.delay_s"].range is not None


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
