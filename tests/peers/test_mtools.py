"""mkfs.vfat, mtools and fsck.vfat, unchanged, on the image file of an emulated SD card."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from neuroflight.sim.board.devices.sd_card import SdCard
from tests.sim.board.devices.host import Host, pattern

BLOCKS = 64  # of the file
SIZE = 40 << 20  # of the card: about the least that is FAT32 with clusters of a block


def run(*command: str | Path) -> bytes:
    found = shutil.which(str(command[0]), path=os.environ["PATH"] + ":/usr/sbin:/sbin")
    assert found, f"{command[0]} is missing; run: make peers"
    return subprocess.run([found, *command[1:]], check=True, capture_output=True).stdout


def first_block(host: Host, start: int) -> int:
    """Of the file LOG00001.BBL in the root directory, whose file system begins at block `start`."""
    boot = host.read(start)
    assert boot[13] == 1, "clusters of one block"
    reserved, tables = int.from_bytes(boot[14:16], "little"), boot[16]
    data = start + reserved + tables * int.from_bytes(boot[36:40], "little")
    root = host.read(data)  # cluster 2
    entries = [root[i : i + 32] for i in range(0, 512, 32)]
    entry = next(entry for entry in entries if entry[:11] == b"LOG00001BBL")
    assert int.from_bytes(entry[28:32], "little") == BLOCKS * 512
    return data + int.from_bytes(entry[26:28], "little") - 2


@pytest.mark.parametrize("start", [0, 2048])
def test_both_sides_read_what_the_other_has_written(tmp_path: Path, start: int) -> None:
    """start: the block at which the file system begins; 0: there is no partition table."""
    path, content = tmp_path / "card.img", tmp_path / "LOG00001.BBL"
    content.write_bytes(b"".join(pattern(i) for i in range(BLOCKS)))
    with path.open("wb") as file:
        file.truncate(SIZE + start * 512)
    run("mkfs.vfat", "-F", "32", "-s", "1", "--offset", str(start), path, str(SIZE // 1024))
    inside = f"{path}@@{start * 512}"
    run("mcopy", "-i", inside, content, "::LOG00001.BBL")
    host = Host(SdCard(path))
    host.start()
    first = first_block(host, start)
    assert host.read(first, BLOCKS) == content.read_bytes()
    changed = [pattern(1000 + i) for i in range(BLOCKS)]
    assert host.write(first, *changed) == [5] * BLOCKS
    host.card.close()
    assert run("mcopy", "-i", inside, "::LOG00001.BBL", "-") == b"".join(changed)
    system = tmp_path / "system.img"
    system.write_bytes(path.read_bytes()[start * 512 :])
    run("fsck.vfat", "-n", system)
