"""`neuroflight aircraft new` as a user runs it: by options, by answers, and what it refuses."""

import io
import json
import sys
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.known import How
from neuroflight.sim.aircraft.model import load_aircraft

FIVE_INCH = ["--weight", "0.68", "--cells", "6", "--kv", "1950", "--motor", "2207", "--props", "5.1x4.3x3"]


class Terminal(io.StringIO):
    """Answers typed by somebody at a terminal."""

    def isatty(self) -> bool:
        return True


def new(out: Path, *options: str) -> int:
    return main(["aircraft", "new", "--out", str(out), *options])


def test_options_give_a_file_that_a_check_has_nothing_against(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine.toml"
    assert new(out, *FIVE_INCH, "--arm", "0.11", "--capacity", "1.3") == 0
    printed = capsys.readouterr().out
    assert "680 g, 1950 Kv motors, 5.1x4.3x3 propellers, 6S" in printed
    assert "measure first" in printed and "aircraft fit LOG" in printed
    assert load_aircraft(out).name == "mine"
    assert main(["aircraft", "check", str(out)]) == 0
    checked = capsys.readouterr().out
    assert "\nok" in checked and "\nwarning" not in checked and "\nerror" not in checked
    assert "How its numbers are known: 4 measured" in checked
    assert main(["aircraft", "check", str(out), "--json"]) == 0
    known = json.loads(capsys.readouterr().out)["known"]
    assert known["rotor"].pop("cost_of_half") > 0
    assert known["rotor"] == {"how": "measured", "range": None, "from": "your answer"}
    assert known["part"]["how"] == "guessed" and known["part"]["cost_of_half"] == pytest.approx(0.1, abs=0.01)


def test_weight_alone_is_enough_for_a_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert new(tmp_path / "tiny.toml", "--weight", "0.03", "--props-out", "--name", "gnat", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["name"] == "gnat" and document["mass_kg"] == pytest.approx(0.03, rel=0.01)
    aircraft = load_aircraft(tmp_path / "tiny.toml")
    assert aircraft.spins.tolist() == [1, -1, -1, 1]
    assert {mark.how for mark in aircraft.known.values()} == {How.TYPICAL, How.GUESSED}


def test_ten_questions_are_asked_at_a_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    typed = "a lot\n680\n\n1950\n2207\n51433\n5.1x4.3x3\n0.11\n110\nout\n1300\nbluejay\n\nracer\n"
    monkeypatch.setattr(sys, "stdin", Terminal(typed))
    out = tmp_path / "mine.toml"
    assert new(out) == 0
    asked = capsys.readouterr().err
    for refused in ("'a lot': expected a number", "propeller '51433'", "arm: got 0.00011 m", "'bluejay'"):
        assert refused in asked
    assert asked.count("typical: ") == 8 + 3  # of the ten two have no typical answer; three are asked twice
    by_options = tmp_path / "same.toml"
    options = [*FIVE_INCH, "--arm", "0.11", "--capacity", "1.3", "--props-out", "--name", "racer"]
    del options[2:4]  # the cells, which the pilot did not know
    assert new(by_options, *options) == 0
    assert out.read_text() == by_options.read_text()


def test_what_an_option_answers_is_not_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal("680\n\n\n\n\n\n\n"))
    assert new(tmp_path / "mine.toml", "--cells", "6", "--kv", "1950", "--name", "mine") == 0
    asked = capsys.readouterr().err
    assert "Weight" in asked and "Cells" not in asked and "Kv" not in asked and "Name" not in asked


def test_nothing_is_written_when_the_answers_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal("680\n6\n"))
    assert new(tmp_path / "mine.toml") == 1
    assert (
        capsys.readouterr().err.splitlines()[-1].endswith("no answer, expected a line; nothing was written")
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ([], "--weight: not given and nobody can be asked here; nothing was written"),
        (["--weight", "680"], "weight: got 680 kg, expected 0.015 to 25 kg"),
        (["--weight", "nan"], "weight: got nan"),
        (["--weight", "0.68", "--props", "big"], "propeller 'big': expected diameter x pitch x blades"),
        (["--weight", "0.68", "--motor", "x"], "motor size 'x'"),
        (["--weight", "0.68", "--arm", "0.04"], "would touch"),
        (["--weight", "0.05", "--motor", "3115"], "weight 50 g: four motors and propellers"),
        (["--weight", "0.68", "--name", "a b"], "name 'a b': expected at most 32 letters"),
    ],
)
def test_says_one_line_and_writes_nothing_when_it_is_asked_wrongly(
    tmp_path: Path, options: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(tmp_path / "mine.toml", *options) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("neuroflight: ") and err.count("\n") == 1
    assert told in err
    assert not list(tmp_path.iterdir())


def test_a_file_that_exists_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "mine.toml"
    out.write_text("mine\n")
    assert new(out, "--weight", "0.68") == 1
    assert "exists; name a new file" in capsys.readouterr().err
    assert out.read_text() == "mine\n"
