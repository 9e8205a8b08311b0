"""A log by both ways over USB: by MSP, and from the card as a disk, which mtools and fsck.vfat look at."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from tests.cli.test_board import Running
from tests.conftest import ROOT
from tests.flash.card.conftest import put, run
from tests.peers.conftest import usb_port
from tests.peers.usb_computer import Computer, computer, plug, wait_until
from tests.peers.usb_disk import DISK, Disk

LOG = b"H Product:Blackbox\n" + bytes(range(1, 256)) * 30
CARD_BYTES = 33 << 20  # about the least that is FAT32
LIMIT_S = 200.0


def neuroflight(at: Computer, *words: str | Path) -> str:
    """What the command says at that computer; it ends well."""
    command = [sys.executable, "-m", "tests.peers.usb_computer", at.port, at.links, "neuroflight.cli.main"]
    done = subprocess.run(
        [*map(str, [*command, *words])], cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_log_is_the_same_by_msp_and_from_the_disk(
    board_image: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = tmp_path / "card.img"
    with image.open("wb") as file:
        file.truncate(CARD_BYTES)
    run("mkfs.vfat", "-F", "32", "-s", "1", image)
    assert main(["log", "card", str(image), "--files", "2", "--size", "1"]) == 0
    put(image, "LOG00001.BBL", LOG)
    copy, sound = tmp_path / "disk.img", image.read_bytes()
    board = Running(board_image.with_suffix(".bin"), "--usb", "0", "--card", str(image))
    try:
        with computer(usb_port(board.told), tmp_path / "by-id") as at:
            wait_until(lambda: list(at.links.iterdir()))
            neuroflight(at, "board", "logs", "fetch", "--out", tmp_path)
            assert (tmp_path / "LOG00001.BBL").read_bytes().rstrip(b"\0") == LOG
            told = neuroflight(at, "board", "reboot", "--card")
            assert "shows its SD card as a disk by USB, which can be read, not written" in told
            wait_until(lambda: DISK in at.ids())
            assert not list(at.links.iterdir())
            plug(at.port, at.links, monkeypatch.setattr)
            disk = Disk()
            speed = disk.copy(copy, blocks=(700 << 10) // 512)
            print(f"{speed / 1000:.0f} KB/s of this computer's time")
            assert disk.write_protected()
            disk.eject()
            wait_until(lambda: list(at.links.iterdir()))
            assert "policy check" in neuroflight(at, "board", "info")
    finally:
        board.end()
    with copy.open("r+b") as file:
        file.truncate(CARD_BYTES)
    whole = copy.read_bytes()
    assert whole[: 700 << 10] == sound[: 700 << 10]
    run("fsck.vfat", "-n", copy)
    assert "LOG00002 BBL" in run("mdir", "-i", copy, "::")
    run("mcopy", "-i", copy, "::LOG00001.BBL", tmp_path / "copied.bbl")
    assert (tmp_path / "copied.bbl").read_bytes()[: len(LOG)] == LOG
