"""`neuroflight image time IMAGE.bin` as a user types it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from neuroflight.cli.main import main
from neuroflight.training.results_page.page import render
from neuroflight.training.results_page.stored_results import Stored
from tests.conftest import ROOT

Capture = pytest.CaptureFixture[str]
CONTROL_TASK_CYCLES = 22_000  # predicted, of the shipped policy: a tenth of a control period of 1 ms


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["image", "time", "image.bin", "--count", "0"], "--count 0, expected 1 to 100"),
        (["image", "time", "image.bin", "--disarmed", "-1"], "--disarmed -1, expected 0 to 1000000"),
        (
            ["image", "time", "image.bin", "--uart-tasks", "1000001"],
            "--uart-tasks 1000001, expected 0 to 1000000",
        ),
        (["image", "time", "image.bin", "--plot", "runs.jpg"], "runs.jpg: expected a name that ends in .png"),
        (
            ["image", "time", "image.bin", "--set", "motor_poles=1"],
            "setting motor_poles got 1, expected a whole number from 2 to 100 magnets",
        ),
        (["image", "time", "image.bin"], "report.json (No such file or directory); build image.bin anew"),
        (
            ["image", "time", "policy.onnx"],
            "policy.onnx: is a policy; run: neuroflight policy time policy.onnx",
        ),
        (["policy", "time", "image.bin"], "image.bin: is an image; run: neuroflight image time image.bin"),
        (["policy", "time", "policy.onnx", "--inputs", "0"], "--inputs 0, expected 1 to 1000000"),
    ],
)
def test_it_refuses_in_one_line_what_makes_no_sense(
    words: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line


@pytest.mark.parametrize(
    "words", [["policy", "time", "a.onnx", "--seed", "1"], ["image", "time", "a.bin", "--blocks"]]
)
def test_it_knows_no_option_of_the_other(words: list[str], capsys: Capture) -> None:
    with pytest.raises(SystemExit):
        main(words)
    assert f"unrecognized arguments: {words[3]}" in capsys.readouterr().err


def test_it_tells_what_optimization_saves_when_a_policy_has_something_to_fold(
    tmp_path: Path, capsys: Capture
) -> None:
    policy = tmp_path / "policy.onnx"
    checkpoint = ROOT / "training" / "policies" / "nf1" / "checkpoint.pt"
    assert main(["policy", "import", str(checkpoint), "--unfolded", "--out", str(policy), "--json"]) == 0
    graph = json.loads(capsys.readouterr().out)["graph"]
    assert main(["policy", "time", str(policy), "--unoptimized", "--inputs", "1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    before, after, saved = (told["optimization"][name] for name in ("before", "after", "saved"))
    assert (graph["nodes"], graph["operations"]) == (before["nodes"], before["operations"])
    assert after["instructions"] == told["instructions"]["worst"]
    assert after["code_bytes"] == told["code_bytes"]
    assert saved["nodes"] == 3  # the observation's scale, and two of the output's map
    assert all(value > 0 for value in saved.values() if value is not None)


@pytest.mark.slow
def test_it_tells_what_other_counts_tell_when_the_image_has_flown(
    board_image: Path, tmp_path: Path, capsys: Capture
) -> None:
    image = board_image.with_suffix(".bin")
    report = json.loads(image.with_name("report.json").read_text())
    plot = tmp_path / "runs.png"
    more = ["--disarmed", "1000", "--serial", "1000", "--plot", str(plot)]
    assert main(["image", "time", str(image), "--count", "1", *more, "--json"]) == 0
    assert plot.read_bytes().startswith(b"\x89PNG")
    document = json.loads(capsys.readouterr().out)
    assert document["image_sha256"] == hashlib.sha256(image.read_bytes()).hexdigest()
    rows: dict[tuple[Any, ...], Any] = {
        (row["work"], row["controller"], row["armed"]): row for row in document["board_timing"]
    }
    policy = rows["control algorithm", "policy", True]
    assert policy["runs"] == rows["control task", "policy", True]["runs"] >= 4_500
    assert set(policy["instructions"].values()) == {report["step_instructions"]}
    disarmed = rows["control task", None, False]
    assert disarmed["runs"] >= 3_000  # of two flights, until they armed, and of the board that never did
    for row in rows.values():
        assert 0 < row["instructions"]["best"] <= row["instructions"]["worst"]
        if row["predicted_cycles"] is not None:
            worst, best = row["predicted_cycles"]["worst"], row["predicted_cycles"]["best"]
            assert row["variability"] == (worst - best) / worst
            assert worst < document["core_hz"] / 1000
            assert row["microseconds"]["worst"] == pytest.approx(worst / 216)
            assert row["microseconds"]["window"] == pytest.approx((worst - best) / 216)
    task = rows["control task", "policy", True]["predicted_cycles"]
    if task is not None:
        assert task["worst"] <= CONTROL_TASK_CYCLES
        assert document["highest_rate_hz"]["policy"] == pytest.approx(216e6 / task["worst"])
    if policy["predicted_cycles"] is not None:
        assert round(policy["predicted_cycles"]["worst"]) == report["predicted_cycles"]
    still, *flown = document["firmware_timing"]
    assert (still["armed"], still["missed_deadlines"]) == (False, 0)
    assert still["runs"] >= 1_000
    assert {row["controller"] for row in flown} == {"policy", "pid"}
    assert all(row["armed"] and row["runs"] >= 1_000 for row in flown)
    for row in document["firmware_timing"]:
        us = row["microseconds"]
        assert us["window"] == pytest.approx(us["worst"] - us["best"])
        assert 0 < row["cycles"]["best"] <= row["cycles"]["mean"] <= row["cycles"]["worst"]
    assert "| policy 19-64-64-4 tanh, armed |" in render([Stored("board-timing.json", document)])
