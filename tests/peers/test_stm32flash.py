"""Debian's stm32flash, unchanged, on the emulated ROM: it writes our image, ours verifies it, it boots."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.flash.rom.segments import Segment, read_segments
from neuroflight.sim.board.serial.bridge import PtyEnd
from neuroflight.toolchain.contract import FLASH_BANK_A, FLASH_BASE, FLASH_BYTES, Msp
from tests.flash.rom.conftest import BANK, BOOT, Served, flash_with

LIMIT_S = 120.0  # of a test that hangs
FULL = bytes(i % 251 + 1 for i in range(FLASH_BYTES))


def stm32flash(*arguments: str) -> str:
    """What it says; on a pseudo terminal it has to be told that there is no parity. It must succeed."""
    assert shutil.which("stm32flash"), "stm32flash is missing; run: make peers"
    done = subprocess.run(
        ["stm32flash", "-b", "115200", "-m", "8n1", *arguments],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-500:] + done.stderr
    return done.stdout


@pytest.fixture
def serve() -> Iterator[Callable[..., Served]]:
    """Chips in their ROM behind a pseudo terminal."""
    served = []

    def make(flash: bytes = b"") -> Served:
        served.append(Served(PtyEnd(), flash))
        return served[-1]

    yield make
    for one in served:
        one.close()


def test_it_knows_the_chip_and_reads_it_when_asked(serve: Callable[..., Served], tmp_path: Path) -> None:
    chip = serve(FULL)
    said = stm32flash(chip.end.name)
    assert "Device ID    : 0x0452 (STM32F72xxx/73xxx)" in said
    assert "Version      : 0x31" in said
    assert "Up to 512KiB" in said
    copy = tmp_path / "copy.bin"
    stm32flash("-r", str(copy), "-S", f"0x{FLASH_BASE:x}:4096", chip.end.name)
    assert copy.read_bytes() == FULL[:4096]


def test_what_it_writes_is_verified_and_started_when_it_is_a_part(
    serve: Callable[..., Served], tmp_path: Path
) -> None:
    """It erases the sectors that it writes to, and no other."""
    chip = serve(FULL)
    for address, content in ((FLASH_BANK_A.address, BANK), (FLASH_BASE, BOOT)):
        path = tmp_path / "part.bin"
        path.write_bytes(content)
        said = stm32flash("-w", str(path), "-v", "-S", f"0x{address:x}", chip.end.name)
        assert "100.00%" in said
    stm32flash("-g", f"0x{FLASH_BASE:x}", chip.end.name)
    chip.stop()
    parts = (Segment(FLASH_BASE, BOOT), Segment(FLASH_BANK_A.address, BANK))
    under = bytearray(FULL)
    under[:0x4000] = b"\xff" * 0x4000
    under[0x20000:0x40000] = b"\xff" * 0x20000
    assert chip.idle.flash() == flash_with(parts, bytes(under))
    assert not chip.idle.board.hardware.rom.runs


def by_parts(chip: Served, image: Path, folder: Path) -> None:
    """Boot part and bank, each for itself: what lies between them stays."""
    for segment in read_segments(image):
        path = folder / "part.bin"
        path.write_bytes(segment.data)
        stm32flash("-w", str(path), "-S", f"0x{segment.address:x}", chip.end.name)


def whole(chip: Served, image: Path, folder: Path) -> None:
    """It fills what lies between the parts, and reads back itself."""
    assert "100.00%" in stm32flash("-w", str(image), "-v", chip.end.name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flash", "write"),
    [(FULL, by_parts), (b"", whole)],
    ids=["parts on a chip that held other things", "whole on an erased chip"],
)
def test_our_image_boots_when_it_wrote_it_and_our_tool_verified_it(
    serve: Callable[..., Served],
    board_image: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    flash: bytes,
    write: Callable[[Served, Path, Path], None],
) -> None:
    chip = serve(flash)
    path = board_image.with_suffix(".hex")
    write(chip, path, tmp_path)
    assert main(["board", "rescue", str(path), "--port", chip.end.name, "--verify-only"]) == 0
    assert "equal" in capsys.readouterr().out
    chip.stop()
    board = chip.idle.board
    board.hold_boot_button(False)
    board.reset()
    chip.idle.boot()
    assert not board.hardware.rom.runs
    assert b"MATEKF722" in chip.idle.client().request(Msp.BOARD_INFO)
