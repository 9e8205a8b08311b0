"""Images of cards, made and looked into by dosfstools and mtools."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

MEBIBYTE = 1 << 20
MakeImage = Callable[..., Path]


def run(program: str, *words: str | Path) -> str:
    """Run a peer; its output."""
    assert shutil.which(program), f"{program} is missing; run: make peers"
    done = subprocess.run(
        [program, *map(str, words)],
        env=os.environ | {"MTOOLS_SKIP_CHECK": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{program} {words}: {done.stdout}{done.stderr}"
    return done.stdout


def fsck(image: Path, offset: int = 0) -> None:
    """Fails unless fsck.vfat finds nothing to mend."""
    whole = image
    if offset:
        whole = image.with_suffix(".part")
        whole.write_bytes(image.read_bytes()[offset:])
    run("fsck.vfat", "-n", whole)


def chains(image: Path, name: str) -> int:
    """In how many pieces mtools finds a file."""
    return len(re.findall(r"<\d+(?:-\d+)?>", run("mshowfat", "-i", image, f"::{name}")))


def put(image: Path, name: str, data: bytes) -> None:
    """Write at the front of a file of the card, as a firmware does: what lies behind stays."""
    from neuroflight.flash.card.fat32 import Fat32

    with image.open("r+b") as file:
        system = Fat32(file, str(image))
        entry = next(entry for entry in system.files() if entry.name == name)
        file.seek(system.pieces(entry)[0].at)
        file.write(data)


@pytest.fixture
def card_image(tmp_path: Path) -> MakeImage:
    """Make images: of 40 MB, FAT32 unless told."""

    def make(*words: str, size: int = 40 * MEBIBYTE, bits: int = 32) -> Path:
        image = tmp_path / "card.img"
        with image.open("wb") as file:
            file.truncate(size)
        run("mkfs.vfat", "-F", str(bits), "-n", "FLIGHTS", *words, image)
        return image

    return make
