"""Image files for the host program."""

from __future__ import annotations

import struct
from collections.abc import Callable
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
