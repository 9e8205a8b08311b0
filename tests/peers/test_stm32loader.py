"""stm32loader 0.7.1 as published, on the emulated ROM: what its reports 33 and 61 tell of.

It opens serial devices only, and pulls their lines RTS and DTR, which no pseudo terminal has: its port is
opened by a URL of pyserial instead. Nothing else of it is touched.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.flash.link.transport import open_transport
from neuroflight.flash.rom.client import RomClient
from neuroflight.flash.rom.segments import Segment
from neuroflight.sim.board.serial.bridge import TcpEnd
from neuroflight.toolchain.contract import FLASH_BANK_A, FLASH_BASE, FLASH_BYTES
from tests.flash.rom.conftest import BANK, BOOT, Served, flash_with

pytestmark = pytest.mark.slow

PACKAGES = ("stm32loader==0.7.1", "progress==1.6", "intelhex==2.3.0")
START = """
import sys, serial
serial.Serial = lambda port, **rest: serial.serial_for_url(port, **rest)
from stm32loader.__main__ import main
main()
"""
LIMIT_S = 120.0  # of a test that hangs
FULL = bytes(i % 251 + 1 for i in range(FLASH_BYTES))


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where stm32loader is installed for these tests."""
    folder = tmp_path_factory.mktemp("stm32loader")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(folder)]
    done = subprocess.run([*command, *PACKAGES], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(
            f"pip cannot install {PACKAGES[0]}: {(done.stderr.splitlines() or ['no reason given'])[-1]}"
        )
    return folder


@pytest.fixture
def chip() -> Iterator[Served]:
    """Return a chip that runs its ROM, with other contents in its flash."""
    served = Served(TcpEnd(), FULL)
    yield served
    served.close()


@pytest.fixture
def start(packages: Path, chip: Served) -> Callable[..., subprocess.Popen[str]]:
    """Start the command."""

    def begin(*arguments: object) -> subprocess.Popen[str]:
        port = f"socket://{chip.end.name.removeprefix('tcp:')}"
        return subprocess.Popen(
            [sys.executable, "-c", START, "-p", port, "-n", *map(str, arguments)],
            env={**os.environ, "PYTHONPATH": str(packages)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    return begin


@pytest.fixture
def run(start: Callable[..., subprocess.Popen[str]]) -> Callable[..., str]:
    """Run the command to its end, which must be exit code 0; return its output."""

    def end(*arguments: object) -> str:
        process = start(*arguments)
        said = process.communicate(timeout=LIMIT_S)[0]
        assert process.returncode == 0, said[-500:]
        return said

    return end


def test_it_comes_again_without_a_reset_of_the_chip(run: Callable[..., str], tmp_path: Path) -> None:
    """Report 33: a 0x7F is acknowledged once; later ones are answered by NACK, or not at all."""
    copy = tmp_path / "copy.bin"
    for i in range(3):
        said = run("-r", "-a", hex(FLASH_BASE + 1000 * i), "-l", 1000, copy)
        assert "Chip id: 0x452 (STM32F72xxx/73xxx)" in said
        assert ("retrying" in said) == (i > 0)
        assert copy.read_bytes() == FULL[1000 * i : 1000 * (i + 1)]


def test_flashing_goes_on_when_the_address_of_the_flash_size_is_refused(
    run: Callable[..., str], tmp_path: Path
) -> None:
    """Report 61, of another chip: its F7 is the F74x, whose 0x1FF0F442 no F72x lets anyone read."""
    copy = tmp_path / "copy.bin"
    said = run("-f", "F7", "-r", "-a", "0x1FF07A00", "-l", 256, copy)
    assert "reading chip family data: NACK 0x11 address failed" in said
    assert copy.read_bytes()[0x22:0x24] == (512).to_bytes(2, "little"), "KiB of flash, where an F72x has it"


def test_what_it_writes_is_verified_and_started(
    run: Callable[..., str], chip: Served, tmp_path: Path
) -> None:
    parts = (Segment(FLASH_BANK_A.address, BANK), Segment(FLASH_BASE, BOOT))
    for segment, options in zip(parts, (("-e",), ("-g", hex(FLASH_BASE))), strict=True):
        path = tmp_path / "part.bin"
        path.write_bytes(segment.data)
        assert "Verification OK" in run(*options, "-w", "-v", "-a", hex(segment.address), path)
    chip.stop()
    assert chip.idle.flash() == flash_with(parts)
    assert not chip.idle.board.hardware.rom.runs


def test_our_tool_finds_the_chip_when_it_was_killed_amid_a_write(
    start: Callable[..., subprocess.Popen[str]], chip: Served, tmp_path: Path
) -> None:
    path = tmp_path / "whole.bin"
    path.write_bytes(FULL)
    process = start("-w", "-e", path)
    began = chip.idle.board.hardware.flash.operations
    end = time.monotonic() + LIMIT_S
    while chip.idle.board.hardware.flash.operations < began + 2000 and time.monotonic() < end:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait(LIMIT_S)
    with RomClient(open_transport(chip.end.name)) as client:
        assert client.connect().product_id == 0x452
        assert client.read(FLASH_BASE, 256) == FULL[:256]
