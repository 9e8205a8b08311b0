"""`evaluate`, `compare` and `fly` on recorded commands, as a user types them."""

import json
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main

Capture = pytest.CaptureFixture[str]
ROWS = 301


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Three seconds of commands at 100 Hz, no two alike; throttle in the last second."""
    path = tmp_path / "pilot.csv"
    k = np.arange(ROWS)
    rates = np.column_stack([200 * np.sin(k / 15), 100 * np.cos(k / 30), 50 * np.sin(k / 40)])
    rows = [
        f"{row / 100},{roll:.1f},{pitch:.1f},{yaw:.1f},{0.4 * (row >= 200)}"
        for row, (roll, pitch, yaw) in enumerate(rates)
    ]
    path.write_text("\n".join(["t_s,roll_deg_s,pitch_deg_s,yaw_deg_s,throttle", *rows]))
    return path


@pytest.mark.slow
def test_evaluate_flies_the_recording_in_pieces_or_whole(recording: Path, capsys: Capture) -> None:
    found = {}
    for piece in ("1", "0"):
        words = ["compare", "--one", "pid", "--commands", str(recording), "--piece", piece]
        assert main([*words, "--json"]) == 0
        found[piece] = json.loads(capsys.readouterr().out)
        assert main(words) == 0
        assert "the recording pilot" in capsys.readouterr().out
    assert [found[piece]["episodes"] for piece in ("1", "0")] == [3, 1]
    for document in found.values():
        assert (document["task"], document["throttle"]) == ("recorded", "recorded")
        assert all(0.0 < value < 30.0 for value in document["mae"])


def test_compare_flies_the_recording_with_every_controller(recording: Path, capsys: Capture) -> None:
    words = ["--commands", str(recording), "--piece", "1", "--json"]
    assert main(["compare", "pid:tuned", "pid:published", *words]) == 0
    entries = json.loads(capsys.readouterr().out)["comparison"]
    assert [entry["throttle"] for entry in entries] == ["recorded"] * 2
    alone = []
    for name in ("pid:tuned", "pid:published"):
        assert main(["compare", "--one", name, *words]) == 0
        alone.append(json.loads(capsys.readouterr().out))
    assert [entry["mae"] for entry in entries] == [document["mae"] for document in alone]
    assert main(["compare", "--one", "pid:tuned", *words, "--throttle", "0.9"]) == 0
    assert json.loads(capsys.readouterr().out)["mae"] != alone[0]["mae"]


def test_a_flight_is_refused_with_its_row_and_flown_around_it(recording: Path, capsys: Capture) -> None:
    rows = recording.read_text().split("\n")
    rows[151] = ",".join([*rows[151].split(",")[:4], "4294968.296"])
    recording.write_text("\n".join(rows))
    words = ["compare", "--one", "pid", "--commands", str(recording), "--piece", "1", "--json"]
    assert main(words) == 1
    error = capsys.readouterr().err
    assert (
        f"recording {recording}: in row 150 (1.500 s) the throttle is 4.29497e+06, expected 0 to 1" in error
    )
    assert "--from and --to" in error and error.count("\n") == 1
    assert main(["fly", "--on", "reference", "--scenario", str(recording)]) == 1
    assert "in row 150 (1.500 s)" in capsys.readouterr().err
    assert main([*words, "--to", "1.5"]) == 0
    assert json.loads(capsys.readouterr().out)["episodes"] == 1
    assert main([*words, "--from", "1.51"]) == 0
    capsys.readouterr()
    assert main(["fly", "--scenario", "roll", "--from", "1"]) == 1
    assert (
        "--from, --to, --header and --cut-rates: of recorded commands, got the scenario roll"
        in capsys.readouterr().err
    )
