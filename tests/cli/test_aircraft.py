"""`neuroflight aircraft check` as a user runs it."""

import json
import re
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import FOLDER

NF1 = (FOLDER / "nf1.toml").read_text()


def heavy(folder: Path) -> Path:
    path = folder / "heavy.toml"
    path.write_text(re.sub(r"^mass_kg = 0.194$", "mass_kg = 19.4", NF1, count=1, flags=re.MULTILINE))
    return path


def test_prints_figures_and_verdicts_when_the_aircraft_is_well(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["aircraft", "check", "nf1"]) == 0
    out = capsys.readouterr().out
    for expected in ("0.3909 kg", "6.69", "27 %", "3.2 A, 21 min", "the body's", "rad/s²"):
        assert expected in out
    assert "warning" not in out
    assert "error" not in out


def test_exit_status_is_1_when_it_cannot_fly(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["aircraft", "check", str(heavy(tmp_path))]) == 1
    assert "cannot lift itself" in " ".join(capsys.readouterr().out.split())


def test_prints_one_document_when_json_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["aircraft", "check", "hexa", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["motors"] == 6
    assert found["mass_kg"] == pytest.approx(2.172)
    assert len(found["hover"]["throttle"]) == 6
    assert {verdict["level"] for verdict in found["verdicts"]} == {"ok"}
    assert main(["aircraft", "check", str(heavy(tmp_path)), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["hover"] is None
    assert "error" in {verdict["level"] for verdict in found["verdicts"]}


def test_draws_when_asked_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["aircraft", "check", "iris", "--draw", str(tmp_path / "iris.png")]) == 0
    assert (tmp_path / "iris.png").read_bytes().startswith(b"\x89PNG")
    assert "iris.png" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["none.toml"], "no such file"),
        (["nf1", "--draw", "nf1.pdf"], "ends in .png"),
        (["nf1", "--draw", "/dev/null/nf1.png"], "/dev/null is no directory; choose another place"),
    ],
)
def test_says_one_line_when_it_is_asked_wrongly(
    arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["aircraft", "check", *arguments]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("neuroflight: ") and err.count("\n") == 1
    assert expected in err
