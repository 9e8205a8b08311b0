"""`compare --suite fleet`: a table by class, JSON, a picture, files of the aircraft, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft

Capture = pytest.CaptureFixture[str]
FEW = ("--suite", "fleet", "--count", "1", "--pulses", "2", "--long", "0", "--jobs", "1")


def test_an_aircraft_is_flown_told_and_drawn(tmp_path: Path, capsys: Capture) -> None:
    keep, files, picture = tmp_path / "keep", tmp_path / "files", tmp_path / "fleet.png"
    both = ("any@new", "pid:scaled")
    common = (*FEW, "--keep", str(keep))
    assert main(["compare", *both, *common, "--files", str(files), "--json", "--plot", str(picture)]) == 0
    told = json.loads(capsys.readouterr().out)["fleet"]
    names = list(told["aircraft"])
    assert len(names) == len(list(keep.iterdir())) / 2 == 1
    assert set(told["controllers"]["any@new"]) == set(names)
    compared = told["ratios"]["pid:scaled"]["pulses"]["all"]
    own, other = (told["controllers"][who][names[0]]["pulses"]["mae"] for who in both)
    assert compared["mae"] == pytest.approx(own / other)
    weight = told["aircraft"][names[0]]["weight_kg"]
    assert load_aircraft(files / f"{names[0]}.toml").mass_properties.mass == pytest.approx(weight, rel=1e-4)
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert main(["compare", *both, *common]) == 0  # from what is kept
    table = capsys.readouterr().out
    assert "1 unseen aircraft" in table
    assert all(name in table for name in names)


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (("pid:scaled", *FEW, "--aircraft", "iris"), "the aircraft are the fleet's"),
        (("any@most", *FEW), "expected one of @exact, @new, @nothing"),
    ],
)
def test_what_the_fleet_cannot_fly_is_one_line(words: tuple[str, ...], answer: str, capsys: Capture) -> None:
    assert main(["compare", *words]) != 0
    error = capsys.readouterr().err.strip()
    assert answer in error
    assert "\n" not in error
