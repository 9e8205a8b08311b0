"""`evaluate` and `compare` on a named command and on many continuous ones, as a user types them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.cli.main import main

Capture = pytest.CaptureFixture[str]
POLICIES = Path(__file__).resolve().parents[3] / "training" / "policies"
TUNED, PUBLISHED = "pid:tuned", "pid:published"


def told(capsys: Capture, *words: str) -> dict[str, Any]:
    assert main([*words, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_a_named_command_is_flown_by_all_and_compared_by_axis(tmp_path: Path, capsys: Capture) -> None:
    plot = tmp_path / "step.png"
    words = ["compare", TUNED, PUBLISHED, "--task", "episodic", "--command", "126.1", "-294.5", "-103.7"]
    document = told(capsys, *words, "--plot", str(plot))
    assert (document["task"], document["episodes"]) == ("episodic", 1)
    assert document["command_deg_s"] == [126.1, -294.5, -103.7]
    first, other = document["comparison"]
    errors = [np.array(each["response"]["error"]["value"]) for each in (first, other)]
    # A thousand samples a second of an error that begins at the command.
    assert 0.02 * np.deg2rad(294.5) * 1000 < errors[0][1] < 0.5 * np.deg2rad(294.5) * 1000
    assert other["percent"]["error"]["value"] == pytest.approx(100 * (errors[1].sum() / errors[0].sum() - 1))
    rises = [np.array(each["response"]["rise_ms"]["value"]) for each in (first, other)]
    assert other["times_faster"] == pytest.approx((rises[0] / rises[1]).tolist())
    assert plot.read_bytes().startswith(b"\x89PNG")
    again = told(capsys, *document["command"].split()[1:])
    assert again == document
    alone = told(capsys, "evaluate", TUNED, *words[3:], "--plot", str(plot))
    assert alone["response"] == first["response"]


@pytest.mark.slow
def test_continuous_commands_are_as_long_and_as_large_as_asked_for(tmp_path: Path, capsys: Capture) -> None:
    plot = tmp_path / "long.png"
    words = ["--task", "continuous", "--length", "1", "--max-rate", "50", "--episodes", "3", "--no-noise"]
    document = told(capsys, "compare", TUNED, PUBLISHED, *words, "--plot", str(plot))
    assert (document["task"], document["length_s"], document["limit_deg_s"]) == ("continuous", 1.0, 50.0)
    first, other = document["comparison"]
    assert first["response"] is None
    assert other["percent"]["mae"]["value"] == pytest.approx(
        100 * (np.mean(other["mae"]) / np.mean(first["mae"]) - 1)
    )
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert told(capsys, *document["command"].split()[1:])["comparison"] == document["comparison"]
    wide = told(capsys, "evaluate", TUNED, *words, "--max-rate", "300", "--plot", str(plot))
    assert np.mean(wide["mae"]) > 2 * np.mean(first["mae"])


@pytest.mark.slow
def test_flights_are_flown_unless_the_user_says_and_tell_rest_and_drift(
    tmp_path: Path, capsys: Capture
) -> None:
    plot = tmp_path / "flights.png"
    document = told(capsys, "compare", TUNED, PUBLISHED, "--episodes", "2", "--plot", str(plot))
    assert (document["task"], document["commands_per_flight"], document["episodes"]) == ("flight", 2, 2)
    assert document["length_s"] == 24.0  # [s], two pulses of 4.5 s and a hover of 15 s
    assert "--task flight --episodes 2 --seed 0 --throttle 0.3" in document["command"]
    first, other = document["comparison"]
    assert np.mean(first["holding"]["mae"]["value"]) == pytest.approx(np.mean(first["mae"]))
    assert first["response"]["success"]["count"] == [2, 2, 2]
    drift = np.mean(other["holding"]["drift"]["value"]) - np.mean(first["holding"]["drift"]["value"])
    assert other["difference"]["drift"]["value"] == pytest.approx(drift)
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert main(["evaluate", TUNED, "--episodes", "3", "--length", "20", "--throttle", "0.2"]) == 0
    table = capsys.readouterr().out
    assert "3 flights of a command and a hover, 20 s" in table
    assert "rest, fifth 5" in table and "drift, °" in table


@pytest.mark.slow
def test_agents_are_averaged_and_the_best_has_the_lowest_error(capsys: Capture) -> None:
    """Koch 2019, chapter 3: the best agent has the lowest sum of the errors of the three axes."""
    agents = [str(POLICIES / name / "policy.onnx") for name in ("nf1-nominal", "nf1")]
    words = ["compare", TUNED, *agents, "--task", "episodic", "--episodes", "4"]
    document = told(capsys, *words, "--average")
    (average,) = document["average"]
    assert (average["controllers"], average["episodes"]) == (agents, 8)
    first, other = (entry["response"] for entry in document["comparison"][1:])
    for name in ("success", "rise_ms", "peak", "error", "slope"):
        means, counts = (np.array([each[name][key] for each in (first, other)]) for key in ("value", "count"))
        pooled = (means * counts).sum(axis=0) / counts.sum(axis=0)
        assert average["response"][name]["value"] == pytest.approx(pooled)
        assert average["response"][name]["count"] == counts.sum(axis=0).tolist()
    sums = [sum(each["error"]["value"]) for each in (first, other)]
    assert average["sum_of_errors"] == pytest.approx(sums)
    assert sums[0] != pytest.approx(sums[1], rel=1e-3)
    best = agents[0] if sums[0] < sums[1] else agents[1]
    assert average["best"] == best
    assert main(["compare", TUNED, *reversed(agents), *words[4:], "--average"]) == 0
    assert f"best of 2: {best}" in capsys.readouterr().out.replace("\n", "")
