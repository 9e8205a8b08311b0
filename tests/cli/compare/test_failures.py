"""`neuroflight failure` as a user types it, on few short flights."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from neuroflight.cli.main import main

Capture = pytest.CaptureFixture[str]
PID = "pid:flying"
SHORT = ["--episodes", "3", "--at", "0.5", "--after", "0.6"]
LOAD = "60@0.04,0,0.02"


def told(capsys: Capture, *arguments: str) -> dict[str, Any]:
    """The document of a run."""
    assert main(["failure", PID, *SHORT, *arguments, "--json"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


def cases(document: dict[str, Any]) -> dict[str, Any]:
    """The PID's cases."""
    found: dict[str, Any] = document["failure"]["controllers"][PID]["cases"]
    return found


def test_a_dead_motor_shows_after_the_change_and_not_before(capsys: Capture) -> None:
    document = told(capsys, "--fail", "1=1", "--fail", "2=0.3")
    calm, dead, weak = cases(document).values()
    assert list(cases(document)) == ["nothing", "motor 1 loses 100 %", "motor 2 loses 30 %"]
    # The same commands, noise and aircraft until the change: the same figures to the bit.
    assert calm["before"] == dead["before"] == weak["before"]
    assert calm["lost_axes"] == [] and calm["recovered_share"]["roll"] == 1.0
    for axis in ("roll", "pitch"):
        assert dead["settled"][axis] > 100 > 20 * calm["settled"][axis]
        assert dead["peak"][axis] > weak["peak"][axis] > calm["peak"][axis]
        assert axis in dead["lost_axes"] and dead["recovery_s"][axis] is None
    assert document["command"] == (
        f"neuroflight compare {PID} --fail 1=1 --fail 2=0.3 --suite failures --aircraft nf1 --at 0.5 "
        "--after 0.6 --episodes 3 --seed 0 --throttle 0.4 --max-rate 200"
    )


def test_a_payload_is_on_board_before_it_goes_and_not_before_it_comes(capsys: Capture) -> None:
    there, back = LOAD, LOAD.split("@")[1].replace("0.04", "-0.04")
    document = told(capsys, "--payload", there, "--drop", there, "--shift", f"{there}:{back}")
    calm, comes, goes, moves = cases(document).values()
    assert [case["kind"] for case in cases(document).values()] == ["none", "attach", "drop", "shift"]
    assert comes["before"] == calm["before"]
    assert goes["before"] == moves["before"] != calm["before"]
    # 60 g in front of the centre of mass push the nose down: pitch is what is disturbed.
    assert comes["peak"]["pitch"] > 3 * calm["peak"]["pitch"]
    assert comes["peak"]["pitch"] > 3 * comes["peak"]["roll"]


@pytest.mark.slow
def test_without_a_case_motor_1_fails_and_it_is_told_and_drawn(tmp_path: Path, capsys: Capture) -> None:
    plot = tmp_path / "errors.png"
    words = ["failure", PID, "--episodes", "2", *SHORT[2:], "--no-noise", "--give-up-yaw"]
    assert main([*words, "--plot", str(plot)]) == 0
    out = capsys.readouterr().out
    for share in (25, 50, 100):
        assert f"motor 1 loses {share} %" in out
    assert plot.read_bytes().startswith(b"\x89PNG")
