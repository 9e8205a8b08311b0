"""docs/guides/own-aircraft.md, section 3: its commands on a 5-inch's file, to a flashed emulated board."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.cli.main import parse
from neuroflight.sim.aircraft.model import parse_aircraft
from neuroflight.sim.aircraft.typical import Answers, Propeller, typical
from neuroflight.sim.design.airworthiness import Level, examine
from tests.cli.test_first_board import clone as clone
from tests.conftest import ROOT

PORT = "/dev/ttyUSB0"
HEADING = "3. From the file to the board"
LIMIT_S = 1800.0  # of a command that hangs, beside other work
MINUTES_MAX = (
    10.0  # of the whole way, on an idle machine; asserted where TIMED is set, as CI shares its cores
)
TIMED = "NEUROFLIGHT_TIMED" in os.environ


@contextmanager
def powered(chip: Path, *options: str) -> Iterator[str]:
    """An emulated board with that chip; the name of UART1's port."""
    words = ["image", "emulate", "--chip", str(chip), "--serial", "pty", *options]
    command = [sys.executable, "-m", "neuroflight.cli.main", *words]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            told = ""
            while "Ctrl-C" not in told and (line := process.stdout.readline()):
                told += line
            found = re.search(r"^(?:ROM|MSP) +(/dev/\S+),", told, re.MULTILINE)
            assert found is not None, told
            yield found[1]
        finally:
            process.terminate()
            process.wait(LIMIT_S)


def five_inch() -> str:
    """A 5-inch as `neuroflight aircraft new` makes it of what its pilot knows: no PID, no thrust stand."""
    propeller = Propeller.parse("5.1x4.3x3")
    return typical(Answers(0.68, 6, 1950, propeller, 0.112, (22, 7), 1.3, "dshot")).text


def commands() -> list[str]:
    """Every line of the section's block, in order."""
    text = (ROOT / "docs" / "guides" / "own-aircraft.md").read_text()
    found = re.search(rf"^## {re.escape(HEADING)}\n.*?^```\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert found is not None
    return found[1].splitlines()


def test_the_file_is_one_that_a_check_has_nothing_against() -> None:
    aircraft = parse_aircraft(five_inch().encode(), "mine.toml")
    assert not aircraft.pids
    assert {verdict.level for verdict in examine(aircraft)[1]} == {Level.OK}
    assert 0.5 < aircraft.mass_properties.mass < 0.8


@pytest.mark.parametrize("line", commands())
def test_a_printed_step_calls_commands_that_are_understood(line: str) -> None:
    calls = [line.removeprefix("neuroflight ")]
    if line.startswith("make "):
        told = subprocess.run(
            [*shlex.split(line), "--dry-run", "--always-make"],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.replace("\\\n", " ")
        calls = re.findall(r"-m neuroflight\.cli\.main (.+)", told)
    assert calls
    for call in calls:
        parse(shlex.split(call))


class Shell:
    """Runs lines in a clone, as they are printed but for the port."""

    def __init__(self, clone: Path, port: str = PORT) -> None:
        self._clone, self._port = clone, port

    def __call__(self, line: str, code: int = 0) -> str:
        typed = re.sub("^neuroflight", ".venv/bin/neuroflight", line).replace(PORT, self._port)
        done = subprocess.run(
            ["sh", "-c", typed],
            cwd=self._clone,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            env=os.environ | {"PYTHONPATH": str(self._clone)},  # an editable installation is of another tree
        )
        print(f"$ {line}\n{done.stdout}{done.stderr}")
        assert (done.returncode == 0) == (code == 0), line
        return done.stdout if code == 0 else done.stderr

    def json(self, line: str) -> Any:
        """What a line with --json tells."""
        return json.loads(self(line))


@pytest.mark.slow
def test_the_steps_lead_from_a_file_to_a_flashed_board(clone: Path, tmp_path: Path) -> None:
    chip, own = tmp_path / "chip.bin", clone / "mine.toml"
    run = Shell(clone)
    run("make firmware")  # the board flies the NF1 until now
    with powered(chip, "--boot0") as port:
        Shell(clone, port)(f"neuroflight board rescue --port {PORT}")
    own.write_text(five_inch())
    report = clone / "build" / "MATEKF722" / "report.json"
    began = time.monotonic()
    with powered(chip) as port:
        board = Shell(clone, port)
        for line in commands():
            if "--other-aircraft" in line:  # not without it
                refusal = board(line.replace("--other-aircraft", ""), code=1)
                assert "the board flies the aircraft 'nf1', the image is for 'mine'" in refusal
            board(line)
        minutes = (time.monotonic() - began) / 60
        assert minutes < MINUTES_MAX or not TIMED, minutes
        known = json.loads(report.read_text())
        digest = parse_aircraft(own.read_bytes(), str(own)).sha256
        assert known["aircraft"]["own"] and known["aircraft"]["file"] == str(own)
        assert known["policy"]["aircraft_sha256"] == known["aircraft"]["sha256"] == digest
        assert known["pid"]["aircraft"] == "mine"
        assert known["check"]["fit"] and known["check"]["aircraft_sha256"] == digest
        info = board(f"neuroflight board info --port {PORT}")
        assert f"aircraft mine, digest {digest[:12]}" in info
        assert "PID built in" in " ".join(board(f"neuroflight board status --port {PORT}").split())

        # What must not happen by a slip: another's policy, another's PID, the NF1's image on this board.
        image = (report.parent / "neuroflight.nfi").read_bytes()
        nf1 = "training/policies/nf1/policy.onnx"
        assert "--other-aircraft" in run(f"make firmware AIRCRAFT=mine.toml POLICY={nf1}", code=1)
        assert "--aircraft FILE" in run("make firmware POLICY=runs/mine-1/policy.onnx", code=1)
        assert "--other-aircraft" in run("make firmware AIRCRAFT=nf1 POLICY=runs/mine-1/policy.onnx", code=1)
        assert (report.parent / "neuroflight.nfi").read_bytes() == image
        assert "no policy is named" in run("make firmware 2>&1")
        assert "is for 'nf1'" in board(f"make flash PORT={PORT}", code=1)

    (compare,) = (line for line in commands() if " compare " in line)
    (level,) = run.json(f"{compare} --json")["equal_thrust"]
    policy, pid, betaflight = (np.mean(each["mae"]) for each in level["controllers"])
    assert policy < betaflight and policy < pid


@pytest.mark.slow
def test_propellers_out_are_trained_and_flown_by_name(clone: Path) -> None:
    """On the host, and in the image on an emulated board; the policy for propellers in is refused."""
    run = Shell(clone)
    run("neuroflight policy train --aircraft nf1:props-out --steps 8000000 --out runs/out")
    for target, on in (("HOST", "host"), ("MATEKF722", "emulator")):
        run(f"neuroflight image build --target {target} --policy runs/out/policy.onnx")
        flown = run.json(f"neuroflight fly --on {on} --scenario pulses --count 4 --json")
        assert flown["aircraft"] == "nf1-props-out" and flown["policy_refused"] is None
        mae = flown["flights"]["firmware"]["tracking"]["mae"]
        assert max(mae) < 5.0
    nf1 = "training/policies/nf1/policy.onnx"
    assert "--other-aircraft" in run(f"make host AIRCRAFT=nf1:props-out POLICY={nf1}", code=1)
    assert "flies the twin of another" in run(
        "neuroflight fly --on host --aircraft nf1 --scenario pulses --count 1 2>&1 || true"
    )
