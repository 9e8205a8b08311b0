"""policy_blob.c: which bytes of a policy slot may be flown, held against blobs that Python packed."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain import contract
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy.blob import PolicyBlob, blob_terms, pack, parse
from neuroflight.toolchain.policy.model_constants import ModelConstants
from neuroflight.toolchain.rendering.contract_header import blob_header_fields

Check = Callable[..., int]
SUCCESS, SHORT, MAGIC, LAYOUT, SIZE, CRC, RATE, FILTERS, ARCHITECTURE, IDLE = 0, *range(-6, -15, -1)
NO_MODEL = -26
HEADER_BYTES = 584

BLOB = PolicyBlob(
    sequence=3,
    architecture_hash=0x89ABCDEF,
    filters_hash=contract.POLICY_FILTERS_NONE,
    control_rate_hz=1000,
    terms=blob_terms(contract.observation_blocks("rate_error,rate~15Hz@2"), 1000),
    aircraft="nf1",
    aircraft_sha256="0f" * 32,
    policy_sha256="a1" * 32,
    idle=0.25,
    weights=np.linspace(-1, 1, 21, dtype=np.float32),
    selftest_observation=np.linspace(-9, 9, 24, dtype=np.float32).reshape(4, 6),
    selftest_action=np.linspace(0, 1, 16, dtype=np.float32).reshape(4, 4),
    selftest_steps=2,
)
GOOD = pack(BLOB)


@pytest.fixture
def check(scripted: Any) -> Check:
    """policy_blob_check in an image built around BLOB; `offset` moves the blob off its alignment."""
    identity = {
        "architecture_hash": BLOB.architecture_hash,
        "filters_hash": BLOB.filters_hash,
        "control_rate_hz": BLOB.control_rate_hz,
        "weight_count": BLOB.weights.size,
        "observation_count": BLOB.observation_count,
        "action_count": BLOB.action_count,
    }

    def call(data: bytes, size: int | None = None, offset: int = 0, **running: int) -> int:
        memory = scripted.new("unsigned char[]", bytes(offset) + data)
        known = scripted.new("struct policy_blob_identity *", {**identity, **running})
        length = len(data) if size is None else size
        return int(scripted.lib.policy_blob_check(memory + offset, length, known))

    return call


def at(name: str) -> int:
    """Offset of a field of the header."""
    return next(field.offset for field in blob_header_fields() if field.name == name)


def sealed(data: bytes) -> bytes:
    """`data` with the CRC that belongs to it."""
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


def patched(name: str, value: bytes) -> bytes:
    """A sealed blob whose header says `value` at `name`."""
    return sealed(GOOD[: at(name)] + value + GOOD[at(name) + len(value) :])


# --- What is taken ----------------------------------------------------------------------------
@pytest.mark.parametrize("offset", range(8))
def test_a_blob_is_taken_when_it_begins_anywhere(check: Check, offset: int) -> None:
    assert check(GOOD, offset=offset) == SUCCESS


def test_a_blob_is_taken_when_the_slot_is_longer(check: Check) -> None:
    assert check(GOOD.ljust(0x10000, b"\xff")) == SUCCESS


@pytest.mark.parametrize(
    "change",
    [
        {"sequence": 0xFFFFFFFF},
        {"weights": -BLOB.weights},
        {"aircraft": "A" * 32, "aircraft_sha256": "c3" * 32, "policy_sha256": "d4" * 32},
        {"selftest_steps": 4},
        {"idle": 0.0},
        {"idle": 0.5},
        {"selftest_observation": np.ones((1, 6), np.float32), "selftest_action": np.ones((1, 4), np.float32)}
        | {"selftest_steps": 1},
    ],
    ids=lambda change: "-".join(change),
)
def test_a_blob_is_taken_when_it_differs_in_what_may_be_exchanged(
    check: Check, change: dict[str, Any]
) -> None:
    assert check(pack(replace(BLOB, **change))) == SUCCESS


def test_the_crc_is_zlibs_when_blobs_are_of_many_lengths_and_bytes(check: Check) -> None:
    rng = np.random.default_rng(11)
    for count in [*range(40), 12288]:
        weights = rng.standard_normal(count).astype(np.float32)
        blob = replace(BLOB, weights=weights, policy_sha256=rng.bytes(32).hex())
        assert check(pack(blob), weight_count=count) == SUCCESS


# --- What is refused --------------------------------------------------------------------------
def test_a_blob_is_refused_when_any_byte_is_another(check: Check) -> None:
    expected = {0: MAGIC, 4: LAYOUT, 6: SIZE, 12: CRC, 28: SIZE, 48: CRC}
    for index in range(len(GOOD)):
        error = next(expected[start] for start in sorted(expected, reverse=True) if start <= index)
        for flip in (0x01, 0x80, 0xFF):
            damaged = bytearray(GOOD)
            damaged[index] ^= flip
            assert check(bytes(damaged)) == error, (index, flip)


def test_a_blob_is_refused_when_it_brings_no_selftest(check: Check) -> None:
    body = GOOD[: HEADER_BYTES + 4 * 21] + bytes(4)
    total = struct.pack("<I", len(body))
    without = body[:8] + total + body[12:44] + bytes(2) + body[46:]
    assert check(sealed(without)) == SIZE


def test_a_blob_is_refused_when_it_is_cut_anywhere(check: Check) -> None:
    for length in range(len(GOOD)):
        assert check(GOOD, size=length) == (SHORT if length < HEADER_BYTES + 4 else SIZE), length


def test_bytes_are_refused_when_they_are_random(check: Check) -> None:
    rng = np.random.default_rng(5)
    for _ in range(3000):
        noise = rng.integers(0, 256, rng.integers(0, 900), np.uint8).tobytes()
        keep = int(rng.integers(0, 60))
        assert check(GOOD[:keep] + noise) < 0


def test_nothing_is_read_as_a_blob_when_a_slot_is_erased_or_cleared(check: Check) -> None:
    assert check(b"\xff" * 0x1000) == MAGIC
    assert check(bytes(0x1000)) == MAGIC


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("magic", b"NFPX", MAGIC),
        ("layout", b"\0\0", LAYOUT),
        ("layout", b"\1\0", LAYOUT),
        ("header_bytes", b"\xd0\0", SIZE),
        ("weight_offset", b"\xdc\0\0\0", SIZE),
        ("selftest_offset", b"\xff\xff\xff\xff", SIZE),
        ("total_bytes", b"\0\0\0\0", SIZE),
        ("total_bytes", b"\3\0\0\0", SIZE),
        ("total_bytes", b"\xff\xff\xff\xff", SIZE),
        ("weight_count", b"\xff\xff\xff\xff", SIZE),
        ("weight_count", b"\x15\0\0\x40", SIZE),  # 2^30 more: the same number of bytes in 32 bits
        ("selftest_count", b"\xff\xff", SIZE),
        ("observation_count", b"\xff\xff", SIZE),
        ("selftest_steps", b"\0\0", SIZE),
        ("selftest_steps", b"\3\0", SIZE),
        ("selftest_steps", b"\5\0", SIZE),
        ("control_rate_hz", b"\xd0\7\0\0", RATE),
        ("filters_hash", b"\0\0\0\0", FILTERS),
        ("architecture_hash", b"\0\0\0\0", ARCHITECTURE),
        ("idle", struct.pack("<f", 0.50000006), IDLE),
        ("idle", struct.pack("<f", -1e-45), IDLE),
        ("idle", struct.pack("<f", -0.0), IDLE),
        ("idle", struct.pack("<f", float("nan")), IDLE),
        ("idle", struct.pack("<f", float("inf")), IDLE),
        ("observation_count", b"\4\0\6\0", ARCHITECTURE),  # as many floats a row, otherwise divided
    ],
)
def test_a_sealed_blob_is_refused_by_name_when_a_field_lies(
    check: Check, name: str, value: bytes, error: int
) -> None:
    assert check(patched(name, value)) == error


@pytest.mark.parametrize(
    ("running", "error"),
    [
        ({"control_rate_hz": 2000}, RATE),
        ({"filters_hash": 1}, FILTERS),
        ({"architecture_hash": 1}, ARCHITECTURE),
        ({"weight_count": 20}, ARCHITECTURE),
        ({"weight_count": 22}, ARCHITECTURE),
        ({"observation_count": 5}, ARCHITECTURE),
        ({"action_count": 5}, ARCHITECTURE),
        ({"control_rate_hz": 2000, "architecture_hash": 1}, RATE),
        ({"filters_hash": 1, "architecture_hash": 1}, FILTERS),
    ],
)
def test_a_good_blob_is_refused_when_the_image_is_for_another(
    check: Check, running: dict[str, int], error: int
) -> None:
    assert check(GOOD, **running) == error


def test_damage_is_told_before_what_is_damaged_when_both_are_wrong(check: Check) -> None:
    damaged = bytearray(GOOD)
    damaged[at("control_rate_hz")] ^= 1
    assert check(bytes(damaged)) == CRC


def test_c_and_python_agree_when_sizes_lie(check: Check) -> None:
    """Both readers over the same sealed lies: what one finds of another shape, the other does too."""
    rng = np.random.default_rng(6)
    taken = 0
    for _ in range(3000):
        data = bytearray(GOOD)
        for _ in range(int(rng.integers(1, 3))):
            data[int(rng.integers(0, at("observation_term_count")))] ^= 1 << int(rng.integers(8))
        lie = sealed(bytes(data))
        error = check(lie)
        if error == SUCCESS:
            taken += 1
            assert pack(parse(lie)) == lie
        elif error >= SIZE:
            with pytest.raises(PolicyError):
                parse(lie)
    assert taken > 50, "flips of the sequence number are no lies"


# --- The model of an aircraft ----------------------------------------------------------------
MODEL = ModelConstants(
    delay_steps=3,
    speed_curve=(-900.0, 4000.0, 150.0),
    rise=0.0625,
    fall=0.03125,
    gain_max=1e9,
    loss_max=40.0,
    correction=0.0625,
    turn=((1.0, -1.0, 2.0, -2.0),) * 3,
    reaction=((0.5, 0.0, 0.25, 0.0),) * 3,
)


@pytest.mark.parametrize("block", contract.MODEL_BLOCKS)
def test_a_blob_without_a_model_is_refused_when_one_term_comes_from_it(check: Check, block: str) -> None:
    terms = contract.observation_blocks(f"throttle,{block}")
    count = contract.observation_count(terms, 4)
    tried = np.zeros((4, count), np.float32)
    data = pack(replace(BLOB, terms=blob_terms(terms, 1000), model=MODEL, selftest_observation=tried))
    assert check(data, observation_count=count) == SUCCESS
    begin = at("model_delay")
    without = sealed(data[:begin] + bytes(4) + data[begin + 4 :])
    assert check(without, observation_count=count) == NO_MODEL


def test_a_blob_with_a_model_is_refused_when_no_term_comes_from_it(check: Check) -> None:
    assert check(pack(replace(BLOB, model=MODEL))) == NO_MODEL
