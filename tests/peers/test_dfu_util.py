"""Debian's dfu-util, unchanged: it takes our .dfu files, and its own packer makes the same of the same parts.

dfu-util reads the elements of a file only once a device is there; its package's `dfuse-pack` reads them here.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from neuroflight.toolchain.contract import FLASH_BANK_A, FLASH_BASE
from neuroflight.toolchain.image.dfu import Loaded, dfu_file, loaded_parts

NO_DEVICE = 74  # dfu-util's exit code: it has read the file and found no device


def run(folder: Path, *command: str, code: int = 0) -> str:
    """What a program of the package says, in `folder`; it must end with `code`."""
    assert shutil.which(command[0]), f"{command[0]} is missing; run: make peers"
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_it_accepts_the_build_s_file(board_image: Path, tmp_path: Path) -> None:
    dfu = tmp_path / "neuroflight.dfu"
    dfu.write_bytes(board_image.with_suffix(".dfu").read_bytes())
    said = run(tmp_path, "dfu-suffix", "-c", dfu.name)
    for line in ("Product ID:\t0xDF11", "Vendor ID:\t0x0483", "BCD DFU:\t0x011A", "Length:\t\t16"):
        assert line in said
    said = run(tmp_path, "dfu-util", "-D", dfu.name, "-d", "ffff:fffe", code=NO_DEVICE)
    assert "Match vendor ID from file" in said or "No DFU capable USB device" in said
    assert "Invalid" not in said and "orrupt" not in said


def test_it_finds_our_parts_when_it_takes_the_file_apart(board_image: Path, tmp_path: Path) -> None:
    dfu = tmp_path / "neuroflight.dfu"
    dfu.write_bytes(board_image.with_suffix(".dfu").read_bytes())
    said = run(tmp_path, "dfuse-pack", "-d", dfu.name)
    assert "CRC ERROR" not in said and "usb: 0483:df11" in said
    for number, part in enumerate(loaded_parts(board_image)):
        assert f"{number}, address: 0x{part.address:08x}, size: {len(part.data)}" in said
        assert (tmp_path / f"neuroflight.dfu.target0.image{number}.bin").read_bytes() == part.data


def test_it_makes_the_same_file_of_the_same_parts(tmp_path: Path) -> None:
    """But for names and the device's version, which are free, and the CRC over them."""
    parts = (Loaded(FLASH_BASE, b"boot" * 70), Loaded(FLASH_BANK_A.address, b"bank" * 80))
    builds = []
    for number, part in enumerate(parts):
        (tmp_path / f"{number}.bin").write_bytes(part.data)
        builds += ["-b", f"0x{part.address:08x}:{number}.bin"]
    run(tmp_path, "dfuse-pack", *builds, "theirs.dfu")
    theirs, ours = (tmp_path / "theirs.dfu").read_bytes(), dfu_file(parts)
    name, version = slice(22, 22 + 255), slice(-16, -14)

    def bare(file: bytes) -> bytes:
        changed = bytearray(file)
        changed[name], changed[version] = bytes(255), bytes(2)
        return bytes(changed[:-4])

    assert bare(ours) == bare(theirs)
