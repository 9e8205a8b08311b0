"""Image files for the host program, and a host program that comes back when it was told to restart."""

from __future__ import annotations

import struct
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.flash.image.files import Policy, read_images
from neuroflight.toolchain.contract import (
    IMAGE_BOARD_BYTES,
    bound_policy,
    image_checksum,
    image_field_offset,
    image_header,
    policy_header,
)

Stamp = Callable[..., bytes]


def images_in(content: bytes) -> list[bytes]:
    """The images of a .nfi."""
    found = []
    while (header := image_header(content)) is not None:
        found.append(content[: header.image_bytes])
        content = content[header.image_bytes :]
    return found


def stamped(image: bytes, **fields: bytes) -> bytes:
    """`image` with other values of fields of its header, and a checksum that holds unless `crc` is given."""
    changed = bytearray(image)
    for name, value in fields.items():
        at = image_field_offset(name)
        changed[at : at + len(value)] = value
    if "crc" not in fields:
        at = image_field_offset("crc")
        changed[at : at + 4] = struct.pack("<I", image_checksum(changed))
    return bytes(changed)


def for_board(image: bytes, board: str, **fields: bytes) -> bytes:
    """`image` as if it had been built for that board."""
    return stamped(image, board=board.encode().ljust(IMAGE_BOARD_BYTES, b"\0"), **fields)


@pytest.fixture(scope="session")
def board_images(board_image: Path) -> list[bytes]:
    """Of bank A and of bank B, for the MATEKF722."""
    return images_in(board_image.with_suffix(".nfi").read_bytes())


@pytest.fixture(scope="session")
def board_policy(board_image: Path) -> Policy:
    """That comes with them."""
    policy = read_images(board_image.with_suffix(".nfi")).policy
    assert policy is not None
    return policy


def policy_of_build(policy: Policy, build: bytes) -> Policy:
    """The same as if it came with another build."""
    data = bound_policy(policy.data, build)
    header = policy_header(data)
    assert header is not None
    return Policy(policy.file, header, data)


@pytest.fixture(scope="session")
def host_images(board_images: list[bytes]) -> list[bytes]:
    """Likewise, such as the host program takes."""
    return [for_board(image, "HOST") for image in board_images]


@pytest.fixture
def host_file(host_images: list[bytes], board_policy: Policy, tmp_path: Path) -> Path:
    """Both of them and their policy in a file."""
    path = tmp_path / "host.nfi"
    path.write_bytes(b"".join(host_images) + board_policy.data)
    return path


class RevivingHost:
    """A host program on one port, started again whenever it ends; its flash is a file."""

    def __init__(self, program: Path, flash: Path) -> None:
        self._command = [str(program), "--gyro-hz=1000", f"--settings={flash}", "--with-parent"]
        self._command += [f"--{name}-port=0" for name in ("state", "receiver", "power")]
        self._ending = False
        self.starts = 0
        self._process = self._start("0")
        assert self._process.stdout is not None
        words = self._process.stdout.readline().split()[1:]
        self._number = dict(word.split("=") for word in words)["msp"]
        self._thread = threading.Thread(target=self._revive, daemon=True)
        self._thread.start()

    @property
    def port(self) -> str:
        return f"tcp:127.0.0.1:{self._number}"

    def _start(self, number: str) -> subprocess.Popen[str]:
        self.starts += 1
        return subprocess.Popen(
            [*self._command, f"--msp-port={number}"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def _revive(self) -> None:
        while True:
            self._process.communicate()
            if self._ending:
                return
            self._process = self._start(self._number)

    def interrupt(self) -> None:
        """End the program; it is started again, as when the cable that powers a board is pulled."""
        self._process.kill()

    def close(self) -> None:
        self._ending = True
        self._process.terminate()
        self._thread.join(timeout=5)


@pytest.fixture
def reviving_host(host_program: Path, tmp_path: Path) -> Iterator[RevivingHost]:
    """A host program whose flash is tmp_path/flash.bin."""
    host = RevivingHost(host_program, tmp_path / "flash.bin")
    yield host
    host.close()
