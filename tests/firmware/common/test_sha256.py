"""common/sha256.c against the standard library's."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.firmware.conftest import Core
from tests.sampling import examples


def sha256(core: Core, data: bytes, offset: int = 0) -> bytes:
    """Of bytes that lie `offset` behind a multiple of 8."""
    memory = core.new("uint64_t[]", (len(data) + offset) // 8 + 1)
    place = core.ffi.cast("uint8_t *", memory) + offset
    core.ffi.memmove(place, data, len(data))
    digest = core.new("uint8_t[32]")
    core.lib.sha256(place, len(data), digest)
    return bytes(digest)


def test_a_digest_is_the_standards_when_it_gives_an_example(scripted: Core) -> None:
    of_abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-2, appendix B.1
    assert sha256(scripted, b"abc").hex() == of_abc


def test_a_digest_is_right_when_the_padding_fills_any_part_of_a_block(scripted: Core) -> None:
    for size in range(200):
        data = bytes(range(256))[:size]
        assert sha256(scripted, data) == hashlib.sha256(data).digest(), size


@settings(max_examples=examples(300), deadline=None, derandomize=True)
@given(data=st.binary(max_size=2000), offset=st.integers(0, 7))
def test_a_digest_is_the_standard_librarys_whatever_the_bytes(
    scripted: Core, data: bytes, offset: int
) -> None:
    assert sha256(scripted, data, offset) == hashlib.sha256(data).digest()


@pytest.mark.parametrize("size", [131072 - 128, 105 * 1024])
def test_a_digest_is_right_when_the_bytes_fill_a_bank(scripted: Core, size: int) -> None:
    data = np.random.default_rng(3).bytes(size)
    assert sha256(scripted, data) == hashlib.sha256(data).digest()
