"""`neuroflight aircraft propeller`."""

import json
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.advance import AdvanceRatio
from neuroflight.sim.aircraft.model import FOLDER, load_aircraft
from tests.refusal import refused

ROWS = [(0.1 * k, 0.14 * (1 - 0.1 * k), 0.07 * (1 - 0.05 * k)) for k in range(11)]


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "prop.csv"
    path.write_text("J,CT,CP\n" + "".join(f"{j},{ct},{cp}\n" for j, ct, cp in ROWS))
    return path


def test_an_aircraft_takes_what_was_fitted(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own, plot = tmp_path / "own.toml", tmp_path / "prop.png"
    own.write_bytes((FOLDER / "nf1.toml").read_bytes())
    words = ["aircraft", "propeller", str(table), "--degree", "1", "--write", str(own), "--plot", str(plot)]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "thrust = [-1.0, 0.0]" in out and f"written to {own}" in out
    assert load_aircraft(own).propulsion.advance == AdvanceRatio((-1.0, 0.0), (-0.5, 0.0))
    assert own.read_text().startswith((FOLDER / "nf1.toml").read_text())
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_figures_and_a_climb_are_one_document_when_json_is_asked_for(
    table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "aircraft",
        "propeller",
        str(table),
        "--degree",
        "1",
        "--aircraft",
        "nf1",
        "--climb",
        "8",
        "--json",
    ]
    assert main(words) == 0
    document = json.loads(capsys.readouterr().out)
    climb = document["climb"]
    ratio = 6.283185 * 8.0 / (climb["rotor_rad_s"] * 0.12954)
    assert climb["thrust_percent"] == pytest.approx(100 * (1 - ratio), rel=1e-5)
    assert climb["torque_percent"] == pytest.approx(100 * (1 - 0.5 * ratio), rel=1e-5)
    assert document["advance_ratio"] == {"thrust": [-1.0, 0.0], "torque": [-0.5, 0.0]}
    assert document["warnings"] == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--climb", "nan"], "--climb nan, expected 0 to 200 m/s"),
        (["--plot", "a.jpg"], "expected a name that ends in .png"),
        (["--aircraft", "none"], "no such file"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    own = tmp_path / "own.toml"
    own.write_bytes((FOLDER / "nf1.toml").read_bytes())
    assert message in refused(capsys, ["aircraft", "propeller", str(table), "--write", str(own), *words])
    assert own.read_bytes() == (FOLDER / "nf1.toml").read_bytes()


def test_an_aircraft_without_a_diameter_is_refused(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = tmp_path / "bare.toml"
    lines = (FOLDER / "nf1.toml").read_text().splitlines(keepends=True)
    bare.write_text("".join(line for line in lines if not line.startswith("propeller_diameter_m")))
    for option in ("--aircraft", "--write"):
        assert main(["aircraft", "propeller", str(table), option, str(bare)]) == 1
        assert "propeller_diameter_m" in capsys.readouterr().err
