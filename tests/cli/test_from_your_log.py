"""docs/guides/from-your-log.md: its commands, on a log of Betaflight's SITL of an aircraft without a file."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import parse
from neuroflight.sim.aircraft.model import load_aircraft
from tests.cli.test_first_board import clone as clone
from tests.cli.test_own_aircraft import Shell
from tests.conftest import ROOT
from tests.sim.identification.hidden_flights import BETAFLIGHT, betaflight_log
from tests.sim.identification.hidden_twins import CLASSES, draw, loop_parameters

LOG = "LOG00001.BFL"
SECONDS = 62.0
ADDED = {" compare ": " --json"}  # to a line
OFF_MAX = 0.1  # of what the fit tells


def commands() -> list[str]:
    """Every line of the page's block, in order."""
    text = (ROOT / "docs" / "guides" / "from-your-log.md").read_text()
    found = re.search(r"^```\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert found is not None
    return found[1].splitlines()


@pytest.mark.parametrize("line", [line for line in commands() if not line.startswith("make ")])
def test_a_printed_step_is_understood(line: str) -> None:
    parse(shlex.split(line.removeprefix("neuroflight ")))


@pytest.mark.slow
def test_the_steps_lead_from_a_log_to_an_image(clone: Path) -> None:
    kind = next(kind for kind in CLASSES if kind.name == "inch5")
    hidden = replace(draw(kind, 1), name="mine")
    log, flight = betaflight_log(hidden, "freestyle", SECONDS, 1)
    (clone / LOG).write_bytes(log)
    (clone / "build").mkdir()
    (clone / "build" / "BETAFLIGHT").symlink_to(BETAFLIGHT)  # that the log was flown with
    run = Shell(clone)
    told = {}
    for line in commands():
        more = next((more for word, more in ADDED.items() if word in line), "")
        told[line] = run(f"{line}{more}")
    at = float(np.median(flight.trace.motors))
    true = loop_parameters(hidden.aircraft, at, flight.volts, hidden.shares)
    found = loop_parameters(load_aircraft(clone / "mine.toml"), at)
    for key in ("authority_roll", "authority_pitch", "authority_yaw", "up_s", "down_s"):
        assert found[key] == pytest.approx(true[key], rel=OFF_MAX), key
    (compare,) = (line for line in commands() if " compare " in line)
    (level,) = json.loads(told[compare])["equal_thrust"]
    own, _, pid, betaflight = (np.mean(each["mae"]) for each in level["controllers"])
    assert own < betaflight and own < pid
