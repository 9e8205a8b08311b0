"""docs/start/first-board.md leads from a clone to a flashed board over USB alone: its commands, at the end of
the emulated board's cable."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from neuroflight.cli.main import parse
from tests.conftest import ROOT
from tests.peers.conftest import usb_port
from tests.peers.usb_computer import Computer, computer, wait_until

PAGE = ROOT / "docs" / "start" / "first-board.md"
NEUROFLIGHT = ".venv/bin/neuroflight "
LIMIT_S = 300.0  # of a command that hangs
TOLD = {  # by what a command's line holds, what it ends in
    "make firmware": "build/MATEKF722/neuroflight.nfi",
    " rescue": "the image runs, and the board is back",
    " info": "policy check passed",
    " status": "",
    "make flash": "the new image runs and has proven itself",
    " swap": "its self-test passed there",
    " list": "flown",
    " revert": "its self-test passed",
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
    words = shlex.split(line.removeprefix(NEUROFLIGHT))
    assert parse([*words, "--port", "/dev/ttyACM0"]).port == "/dev/ttyACM0"


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
        words = shlex.split(call)
        parse([*words, "--port", "/dev/ttyACM0"] if words[:2] == ["board", "flash"] else words)


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
def powered(chip: Path, folder: Path, *options: str) -> Iterator[Computer]:
    """An emulated board with that chip, and the computer at its USB cable."""
    words = ["image", "emulate", "--chip", str(chip), "--usb", "0", *options]
    command = [sys.executable, "-m", "neuroflight.cli.main", *words]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            told = ""
            while "Ctrl-C" not in told and (line := process.stdout.readline()):
                told += line
            with computer(usb_port(told), folder / "by-id") as at:
                yield at
        finally:
            process.terminate()
            process.wait(LIMIT_S)


def at_computer(at: Computer, folder: Path) -> dict[str, str]:
    """What makes every Python of a command run at that computer."""
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(
        "from pathlib import Path\nfrom tests.peers.usb_computer import plug\n"
        f"plug({at.port}, Path({str(at.links)!r}))\n"
    )
    return {"PYTHONPATH": str(folder)}


def follow(line: str, clone: Path, at: dict[str, str] | None = None, told: str = "") -> None:
    """Run it as it is printed, and see it end well; print how long it took."""
    paths = [str(clone), *(at or {}).values()]  # the clone: an editable installation is of another tree
    begin = time.monotonic()
    done = subprocess.run(
        ["sh", "-c", line],
        cwd=clone,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
    )
    print(f"$ {line}  # {time.monotonic() - begin:.0f} s\n{done.stdout}{done.stderr}")
    assert done.returncode == 0, line
    told = told or next(told for key, told in TOLD.items() if key in line)
    assert told in " ".join(done.stdout.split()), line


@pytest.mark.slow
def test_the_commands_lead_from_a_clone_to_a_flashed_board(clone: Path, tmp_path: Path) -> None:
    chip, custom = tmp_path / "chip.bin", tmp_path / "computer"
    build, first, *others = commands()
    follow(build, clone)
    with powered(chip, tmp_path, "--boot0") as at:
        follow(first, clone, at_computer(at, custom))
    with powered(chip, tmp_path) as at:
        wait_until(lambda: list(at.links.iterdir()))
        site = at_computer(at, custom)
        follow(first, clone, site)  # again, without the button: the firmware starts the ROM
        follow(f"{NEUROFLIGHT}board reboot --dfu", clone, site, "waits in its ROM's USB boot loader")
        follow(f"{NEUROFLIGHT}board rescue --verify-only", clone, site, "nothing was written")
        follow(first, clone, site)
        for line in others:
            follow(line, clone, site)
