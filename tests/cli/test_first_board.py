"""docs/start/first-board.md leads from a clone to a flashed board: its commands, on the emulated board."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from neuroflight.cli.main import parse
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "start" / "first-board.md"
PORT = "/dev/ttyUSB0"
NEUROFLIGHT = ".venv/bin/neuroflight "
LIMIT_S = 300.0  # of a command that hangs
TOLD = {  # by what a command's line holds, what it ends in
    "make firmware": "build/MATEKF722/neuroflight.nfi",
    " rescue ": "the image runs; let BOOT go",
    " info": "policy check passed",
    " status": "",
    "make flash": "the new image runs and has proven itself",
    " swap ": "its self-test passed there",
    " list ": "flown",
    " revert ": "its self-test passed",
}


def section() -> str:
    """The page up to its first heading, which is of what comes after a flight."""
    return PAGE.read_text().partition("\n## ")[0]


def commands() -> list[str]:
    """Every line of its blocks, in order."""
    blocks = re.findall(r"^```\n(.*?)^```$", section(), re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines()]


def test_every_step_of_the_way_is_printed_once_and_in_order() -> None:
    assert [next(key for key in TOLD if key in line) for line in commands()] == list(TOLD)


@pytest.mark.parametrize("line", [line for line in commands() if line.startswith(NEUROFLIGHT)])
def test_a_printed_command_is_understood(line: str) -> None:
    args = parse(shlex.split(line.removeprefix(NEUROFLIGHT)))
    assert args.port == PORT


@pytest.mark.parametrize("line", [line for line in commands() if line.startswith("make ")])
def test_a_printed_target_calls_commands_that_are_understood(line: str) -> None:
    told = subprocess.run(
        [*shlex.split(line), "--dry-run", "--always-make"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    calls = re.findall(r"-m neuroflight\.cli\.main (.+)", told.stdout)
    assert calls
    for call in calls:
        args = parse(shlex.split(call))
        if "flash" in line and args.command == "board flash":
            assert args.port == PORT


def test_policies_that_are_named_are_there() -> None:
    for policy in re.findall(r"\S*?(training/\S+\.onnx)", section()):
        assert (ROOT / policy).is_file(), policy


# --- Followed ---------------------------------------------------------------------------------------
@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """What a clone would hold, with the environment that runs this test in place of one made anew."""
    folder = tmp_path / "neuroflight"
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    environment = folder / ".venv"
    environment.unlink(missing_ok=True)
    environment.mkdir()
    for entry in Path(sys.prefix).iterdir():
        if not entry.name.startswith("."):
            (environment / entry.name).symlink_to(entry)
    for extra in ("firmware", "gateway", "sim", "train", "dev"):
        (environment / f".{extra}").touch()  # nothing is to be installed
    return folder


@contextmanager
def powered(chip: Path, *options: str) -> Iterator[str]:
    """An emulated board with that chip; the name of its port."""
    command = [
        sys.executable,
        "-m",
        "neuroflight.cli.main",
        "board",
        "--chip",
        str(chip),
        "--serial",
        "pty",
        *options,
    ]
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


def follow(line: str, clone: Path, port: str = PORT) -> None:
    """Run it as it is printed, but for the port, and see it end well."""
    done = subprocess.run(
        ["sh", "-c", line.replace(PORT, port)],
        cwd=clone,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        env=os.environ | {"PYTHONPATH": str(clone)},  # an editable installation is of another tree
    )
    print(f"$ {line}\n{done.stdout}{done.stderr}")
    assert done.returncode == 0, line
    assert next(told for key, told in TOLD.items() if key in line) in " ".join(done.stdout.split()), line


@pytest.mark.slow
def test_the_commands_lead_from_a_clone_to_a_flashed_board(clone: Path, tmp_path: Path) -> None:
    chip = tmp_path / "chip.bin"
    build, first, *others = commands()
    follow(build, clone)
    with powered(chip, "--boot0") as port:
        follow(first, clone, port)
    with powered(chip) as port:
        for line in others:
            follow(line, clone, port)
