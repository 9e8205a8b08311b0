"""pydfuutil, a port of dfu-util in Python, unchanged, on the emulated chip's ROM over USB/IP."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES
from tests.conftest import ROOT
from tests.flash.rom.conftest import BOOT, Served

FULL = bytes(i % 251 + 1 for i in range(FLASH_BYTES))
IMAGE = BOOT + bytes(range(256)) * 11  # more than one transfer, and not a whole number of them
LIMIT_S = 100.0


@pytest.fixture
def chip() -> Iterator[Served]:
    """A chip in use, in its ROM, at a USB cable."""
    served = Served(None, FULL)
    yield served
    served.close()


def pydfuutil(chip: Served, folder: Path, *words: str | Path) -> str:
    """What it says; it ends well."""
    command = [sys.executable, "-m", "tests.peers.usb_computer", chip.usb_port, folder / "links"]
    done = subprocess.run(
        [*map(str, [*command, "tests.peers.pydfuutil_client", *words])],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
    )
    told = done.stdout + done.stderr
    assert done.returncode == 0, told
    return told


def test_it_writes_an_image_and_starts_it(chip: Served, tmp_path: Path) -> None:
    path = tmp_path / "image.bin"
    path.write_bytes(IMAGE)
    place = f"0x{FLASH_BASE:08X}:leave"
    told = pydfuutil(chip, tmp_path, "-a", "0", "-t", "2048", "-s", place, "-D", path)
    assert "File downloaded successfully" in told and "dfuMANIFEST" in told
    chip.stop()
    assert chip.idle.flash() == IMAGE + b"\xff" * (0x4000 - len(IMAGE)) + FULL[0x4000:]
    chip.idle.board.run(0.02)
    assert not chip.idle.board.hardware.rom.runs


def test_it_lists_the_memories_and_reads_flash(chip: Served, tmp_path: Path) -> None:
    told = pydfuutil(chip, tmp_path, "-l")
    assert 'alt=0, name="@Internal Flash  /0x08000000/04*016Kg,01*64Kg,03*128Kg"' in told
    path = tmp_path / "read.bin"
    place = f"0x{FLASH_BASE + 0x4000:08X}:5000"
    pydfuutil(chip, tmp_path, "-a", "0", "-t", "2048", "-s", place, "-U", path)
    assert path.read_bytes() == FULL[0x4000 : 0x4000 + 5000]
    chip.stop()
    assert chip.idle.board.hardware.flash.operations == 0
