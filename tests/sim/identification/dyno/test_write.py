"""A fit is written into an aircraft file, and nothing else in the file changes."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import pytest

from neuroflight.sim.aircraft.model import FOLDER, RPM, FirstOrderResponse, TorqueResponse, load_aircraft
from neuroflight.sim.identification.dyno.bench import STEPS, duration, run, sample_times
from neuroflight.sim.identification.dyno.fit import Fit, fit
from neuroflight.sim.identification.dyno.write import write_fit
from neuroflight.toolchain.errors import AircraftError

NF1 = load_aircraft("nf1")
SOURCE = FOLDER / "nf1.toml"


@pytest.fixture(scope="module")
def found() -> Fit:
    """Of a rotor that is not the NF1's: half its thrust, twice its clamp."""
    propulsion = dataclasses.replace(
        NF1.propulsion, thrust_coefficient=(4.7e-7,), response=TorqueResponse(1e-4, 0.1, 0.2)
    )
    return fit(run(propulsion, STEPS, sample_times(duration(STEPS), 250)), kind="torque")


@pytest.fixture(scope="module")
def lagging() -> Fit:
    """Of a rotor that follows as a first-order lag."""
    propulsion = dataclasses.replace(NF1.propulsion, response=FirstOrderResponse(0.05, 0.03))
    return fit(run(propulsion, STEPS, sample_times(duration(STEPS), 250)), kind="first_order")


def document(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text())


def test_fit_stands_in_the_file_and_all_else_stays_when_written(tmp_path: Path, found: Fit) -> None:
    target = tmp_path / "mine.toml"
    write_fit(SOURCE, target, found, "bench.csv")
    propulsion = load_aircraft(target).propulsion
    assert propulsion.speed_max == pytest.approx(found.speed_max, rel=1e-5)
    assert propulsion.thrust_coefficient[0] == pytest.approx(4.7e-7, rel=1e-3)
    assert isinstance(propulsion.response, TorqueResponse)
    assert propulsion.response.torque_up == pytest.approx(0.1, rel=0.01)
    assert propulsion.response.torque_down == pytest.approx(0.2, rel=0.01)
    marks = load_aircraft(target).known
    assert list(marks) == [
        "propulsion.speed_curve_rpm",
        "propulsion.thrust_coefficient",
        "propulsion.torque_ratio_m",
        "propulsion.response",
    ]
    assert all(mark.source == "dyno fit to bench.csv" for mark in marks.values())
    text = target.read_text().partition("\n[known]\n")[0]
    before, after = SOURCE.read_text().splitlines(), text.splitlines()
    note = [line for line in after if "dyno fit" in line]
    assert len(note) == 1 and "bench.csv" in note[0]
    after.remove(note[0])
    changed = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    keys = [new.split("=")[0].strip() for _, new in changed]
    assert keys == [
        "speed_curve_rpm",
        "thrust_coefficient",
        "torque_ratio_m",
        "gain",
        "torque_up_n_m",
        "torque_down_n_m",
    ]
    assert all(old.partition("#")[2] == new.partition("#")[2] for old, new in changed)


def test_response_changes_its_kind_when_another_was_fitted(tmp_path: Path, lagging: Fit) -> None:
    target = tmp_path / "mine.toml"
    write_fit(SOURCE, target, lagging, "bench.csv")
    response = load_aircraft(target).propulsion.response
    assert isinstance(response, FirstOrderResponse)
    assert response.time_constant_up == pytest.approx(0.05, rel=0.01)
    assert response.time_constant_down == pytest.approx(0.03, rel=0.01)
    text, _, marks = target.read_text().partition("\n[known]\n")
    assert text.count("\n") == SOURCE.read_text().count("\n")  # a note more, a key less
    write_fit(target, target, lagging, "again.csv")
    again, _, marks_again = target.read_text().partition("\n[known]\n")
    assert again.count("`neuroflight dyno fit`") == 1 and "again.csv" in again
    assert marks_again == marks.replace("bench.csv", "again.csv")


def test_response_changes_back_when_torques_are_fitted_again(
    tmp_path: Path, found: Fit, lagging: Fit
) -> None:
    target = tmp_path / "mine.toml"
    write_fit(SOURCE, target, lagging, "a.csv")
    write_fit(target, target, found, "b.csv")
    response = load_aircraft(target).propulsion.response
    assert isinstance(response, TorqueResponse)
    assert response.torque_up == pytest.approx(0.1, rel=0.01)
    assert response.torque_down == pytest.approx(0.2, rel=0.01)


def test_dimensionless_coefficients_give_way_when_the_file_has_them(tmp_path: Path, found: Fit) -> None:
    source = tmp_path / "mine.toml"
    lines = [line for line in SOURCE.read_text().splitlines() if not line.startswith("propeller_diameter_m")]
    text = "\n".join(lines).replace("thrust_coefficient = 9.37e-7", "c_t = 0.1")
    text = text.replace("torque_ratio_m = 8.64e-3", "c_q = 0.005").replace(
        "[propulsion]\n", "[propulsion]\npropeller_diameter_m = 0.13\nair_density_kg_m3 = 1.2\n"
    )
    source.write_text(text)
    write_fit(source, source, found, "bench.csv")
    propulsion = load_aircraft(source).propulsion
    assert propulsion.thrust_coefficient[0] == pytest.approx(4.7e-7, rel=1e-3)
    table = document(source)["propulsion"]
    assert not {"c_t", "c_q", "air_density_kg_m3"} & set(table)
    assert document(source)["propulsion"]["propeller_diameter_m"] == 0.13


def test_torques_follow_the_inertia_when_one_is_given(tmp_path: Path, found: Fit) -> None:
    target = tmp_path / "mine.toml"
    write_fit(SOURCE, target, found, "bench.csv", inertia=8.48e-6)
    propulsion = load_aircraft(target).propulsion
    assert propulsion.rotor_inertia == 8.48e-6
    assert isinstance(propulsion.response, TorqueResponse)
    assert propulsion.response.torque_up == pytest.approx(0.2, rel=0.01)  # twice, as the inertia is


def test_file_stays_as_it_was_when_it_cannot_be_edited(tmp_path: Path, found: Fit) -> None:
    text = SOURCE.read_text()
    start = text.index("[propulsion.response]")
    end = text.index("[", text.index("torque_down_n_m"))
    inline = 'response = { kind = "torque", gain = 1e-4, torque_up_n_m = 0.05, torque_down_n_m = 0.1 }\n\n'
    inside = text[:start] + text[end:]
    inside = inside.replace("[propulsion]\n", f"[propulsion]\n{inline}")
    target = tmp_path / "mine.toml"
    target.write_text(inside)
    load_aircraft(target)  # a valid aircraft, only written in another way
    with pytest.raises(AircraftError, match="cannot be edited") as caught:
        write_fit(target, target, found, "bench.csv")
    assert str(target) in str(caught.value)
    assert target.read_text() == inside
    assert list(tmp_path.iterdir()) == [target]


def test_response_of_the_file_stays_when_none_was_fitted(tmp_path: Path, found: Fit) -> None:
    target = tmp_path / "mine.toml"
    write_fit(SOURCE, target, dataclasses.replace(found, response=None), "ramp.csv")
    assert load_aircraft(target).propulsion.response == NF1.propulsion.response
    assert load_aircraft(target).propulsion.speed_max / RPM == pytest.approx(24982.94, rel=0.01)
