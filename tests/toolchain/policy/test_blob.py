"""The policy blob: bytes out and in, held against a layout written down here a second time."""

from __future__ import annotations

import re
import struct
import subprocess
import zlib
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pytest

from neuroflight.toolchain import contract
from neuroflight.toolchain.codegen.emit import header_literals
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy.blob import (
    PolicyBlob,
    blob_terms,
    filters_hash,
    header_values,
    pack,
    parse,
)
from neuroflight.toolchain.policy.model_constants import ModelConstants
from neuroflight.toolchain.rendering.contract_header import blob_header_fields

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "policy-blob.md"
HEADER_BYTES = 584
WEIGHTS = np.array([1.5, -0.0, 1e-45, 3.4028235e38, -2.0], np.float32)
OBSERVATION = np.array([[0, np.nan, np.inf, -np.inf, 1e-45, -0.0], [1, 2, 3, 4, 5, 6]], np.float32)
ACTION = np.array([[0, 1, 0.5, 1e-45], [0.25, 0.75, 1, 0]], np.float32)


def terms(text: str) -> Any:
    """The terms in `text` at 1 kHz."""
    return blob_terms(contract.observation_blocks(text), 1000)


BLOB = PolicyBlob(
    sequence=7,
    architecture_hash=0x89ABCDEF,
    filters_hash=contract.POLICY_FILTERS_NONE,
    control_rate_hz=1000,
    terms=terms("rate_error,rate_error_delta~15Hz@3"),
    aircraft="nf1",
    aircraft_sha256="0f" * 32,
    policy_sha256="a1" * 32,
    idle=0.25,
    weights=WEIGHTS,
    selftest_observation=OBSERVATION,
    selftest_action=ACTION,
    selftest_steps=2,
)
# The first bytes of layout version 5, by hand. Changing them means another layout version.
TOTAL_BYTES = HEADER_BYTES + 4 * (5 + 12 + 8) + 4
NUMBERS = struct.pack("<4sHHI", b"NFPB", 5, HEADER_BYTES, TOTAL_BYTES)
NUMBERS += struct.pack("<IIIIHH", 7, 0x89ABCDEF, 0x0D4CBB29, 1000, 6, 4)
NUMBERS += struct.pack("<IIIHHI", HEADER_BYTES, 5, HEADER_BYTES + 4 * 5, 2, 2, 2)
TERMS = bytes([2, 3]).ljust(32, b"\0") + bytes([0, 3]).ljust(32, b"\0") + bytes(4)
TERMS += struct.pack("<f", 1 - np.exp(-2 * np.pi * 15 / 1000)).ljust(4 * 31, b"\0")
NAMES = b"nf1".ljust(32, b"\0") + b"\x0f" * 32 + b"\xa1" * 32
REST = TERMS + NAMES + struct.pack("<fII", 0.25, 0, 0) + bytes(32 + 96 + 96) + bytes(8)
# A model of four rotors; every number is exactly a float32.
MODEL = ModelConstants(
    delay_steps=3,
    speed_curve=(-900.0, 4000.0, 150.0),
    rise=0.0625,
    fall=0.03125,
    gain_max=1e9,
    loss_max=40.0,
    correction=0.0625,
    turn=((1.0, -1.0, 2.0, -2.0), (3.0, 3.5, -3.0, -3.5), (4.0, -4.0, -4.5, 4.5)),
    reaction=((0.0, 0.0, 0.0, 0.0), (0.5, 0.0, 0.25, 0.0), (0.125, -0.125, -0.125, 0.125)),
)


def at(name: str) -> int:
    """Offset of a field of the header."""
    return next(field.offset for field in blob_header_fields() if field.name == name)


def sealed(data: bytes) -> bytes:
    """`data` with the CRC that belongs to it."""
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


def patched(name: str, value: bytes) -> bytes:
    """A sealed blob whose header says `value` at `name`."""
    data = pack(BLOB)
    offset = at(name)
    return sealed(data[:offset] + value + data[offset + len(value) :])


def same(a: PolicyBlob, b: PolicyBlob) -> bool:
    """Every field, floats bit for bit."""
    pairs = [(getattr(a, field.name), getattr(b, field.name)) for field in fields(PolicyBlob)]
    return all(
        x.tobytes() == y.tobytes() and x.shape == y.shape and x.dtype == y.dtype
        if isinstance(x, np.ndarray)
        else x == y
        for x, y in pairs
    )


# --- Bytes out, bytes in ----------------------------------------------------------------------
def test_bytes_are_those_of_layout_five_when_packed() -> None:
    data = pack(BLOB)
    floats = WEIGHTS.tobytes() + OBSERVATION.tobytes() + ACTION.tobytes()
    assert data[:52] == NUMBERS
    assert data[52:HEADER_BYTES] == REST
    assert data[HEADER_BYTES:-4] == floats
    assert data[-4:] == struct.pack("<I", zlib.crc32(NUMBERS + REST + floats))


def test_mix_and_model_stand_behind_the_idle_when_packed() -> None:
    data = pack(replace(BLOB, mix=contract.Mix.CENTRED, model=MODEL))
    rotor = struct.pack("<8f", -900, 4000, 150, 0.0625, 0.03125, 1e9, 40, 0.0625)
    rows = [struct.pack("<8f", *row, 0, 0, 0, 0) for row in (*MODEL.turn, *MODEL.reaction)]
    assert data[344:HEADER_BYTES] == struct.pack("<II", 1, 3) + rotor + b"".join(rows) + bytes(8)


def test_nothing_is_lost_when_packed_and_parsed() -> None:
    data = pack(BLOB)
    assert same(parse(data), BLOB)
    assert pack(parse(data)) == data == pack(replace(BLOB))


@pytest.mark.parametrize(
    "change",
    [
        {"sequence": 0},
        {"sequence": 0xFFFFFFFF, "architecture_hash": 0, "filters_hash": 0xFFFFFFFF},
        {"control_rate_hz": 8000},
        {"aircraft": "A" * 32},
        {"idle": 0.0},
        {"idle": 0.5},
        {"mix": contract.Mix.CENTRED},
        {"model": MODEL},
        {"model": replace(MODEL, delay_steps=8, gain_max=0.25, loss_max=1e9, rise=1.0)},
        {"selftest_steps": 1},
        {"weights": np.zeros(0, np.float32)},
        {"weights": np.linspace(-1, 1, 12288, dtype=np.float32)},
        {
            "terms": terms(",".join(["throttle~499.999Hz@16"] * 32)),
            "selftest_observation": np.ones((2, 32), np.float32),
        },
        {
            "terms": terms("rotor_speed"),
            "selftest_observation": ACTION,
        },
    ],
    ids=lambda change: "-".join(change),
)
def test_nothing_is_lost_when_fields_are_at_their_limits(change: dict[str, Any]) -> None:
    blob = replace(BLOB, **change)
    assert same(parse(pack(blob)), blob)


def test_a_blob_is_its_own_when_the_bytes_it_came_from_change() -> None:
    data = bytearray(pack(BLOB))
    blob = parse(bytes(data))
    blob.weights[0] = 3  # a copy: writable, and of nobody else
    assert parse(bytes(data)).weights[0] == 1.5


def test_weights_lie_eight_byte_aligned_when_packed() -> None:
    values = header_values(BLOB)
    assert values["weight_offset"] == HEADER_BYTES
    assert HEADER_BYTES % 8 == 0


def test_the_largest_policy_of_the_board_fits_when_put_in_a_slot() -> None:
    row = contract.OBSERVATION_COUNT_MAX + contract.MOTOR_COUNT_MAX
    floats = contract.POLICY_WEIGHT_COUNT_MAX + contract.SELFTEST_COUNT * row
    assert all(HEADER_BYTES + 4 * floats + 4 <= slot.size for slot in contract.FLASH_POLICY_SLOTS)


# --- Refusals ---------------------------------------------------------------------------------
def refusal(action: Callable[[], object]) -> str:
    with pytest.raises(PolicyError) as caught:
        action()
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_a_blob_is_refused_when_any_byte_is_another() -> None:
    data = pack(BLOB)
    for index in range(len(data)):
        for flip in (0x01, 0x80, 0xFF):
            damaged = bytearray(data)
            damaged[index] ^= flip
            refusal(lambda damaged=damaged: parse(bytes(damaged)))  # type: ignore[misc]


def test_a_blob_is_refused_when_cut_or_longer() -> None:
    data = pack(BLOB)
    for length in range(len(data)):
        text = refusal(lambda length=length: parse(data[:length]))  # type: ignore[misc]
        assert f"is {length} bytes, expected" in text
    assert "is 689 bytes, expected 688 by its header" in refusal(lambda: parse(data + b"\0"))


def test_nothing_but_a_refusal_comes_out_when_bytes_are_random() -> None:
    rng = np.random.default_rng(3)
    data = pack(BLOB)
    for _ in range(3000):
        noise = rng.integers(0, 256, rng.integers(0, 932), np.uint8).tobytes()
        keep = int(rng.integers(0, 60))
        refusal(lambda noise=noise, keep=keep: parse(sealed(data[:keep] + noise)))  # type: ignore[misc]


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("magic", b"NFPX", r"begins with b'NFPX', expected b'NFPB'; is it a policy blob\?"),
        ("layout", b"\x01\x00", "layout version 1, expected 5"),
        ("header_bytes", b"\xe0\x00", "header_bytes is 224, expected 584"),
        ("total_bytes", b"\xff" * 4, "total_bytes is 4294967295, expected 688 by its counts"),
        ("weight_offset", b"\0" * 4, "weight_offset is 0, expected 584"),
        ("weight_count", b"\xff" * 4, "selftest_offset is 604, expected 17179869764"),
        ("weight_count", b"\x04\0\0\0", "selftest_offset is 604, expected 600"),
        ("selftest_offset", b"\x5d\2\0\0", "selftest_offset is 605, expected 604"),
        ("selftest_count", b"\xff\xff", "total_bytes is 688, expected"),
        ("observation_count", b"\x05\x00", "total_bytes is 688, expected"),
        ("action_count", b"\x00\x00", "total_bytes is 688, expected"),
        ("selftest_steps", b"\0\0", "self-test steps is 0, expected 1 to 2"),
        ("selftest_steps", b"\3\0", "self-test steps is 3, expected 1 to 2"),
        ("control_rate_hz", b"\0" * 4, "control rate is 0, expected 1 to"),
        ("observation_term_count", b"\1\0\0\0", "1 observation terms are not those of its lists"),
        ("observation_term_count", b"\x21\0\0\0", "33 observation terms are not those of its lists"),
        ("observation_term_count", b"\xff" * 4, "4294967295 observation terms are not"),
        ("observation_term_count", b"\3\0\0\0", "observation block 0 is unknown, known are"),
        ("observation_blocks", b"\x02\x0e", "observation block 14 is unknown, known are"),
        ("observation_blocks", b"\x02\x06", "takes 6 values, but its blocks make 4"),
        ("aircraft", b"n\0f", "aircraft is 'n.x00f', expected at most 32 letters"),
        ("aircraft", b'"; ', "expected at most 32 letters"),
        ("aircraft", b"\xff", "expected at most 32 letters"),
        ("aircraft", b"\0\0\0", "aircraft is '', expected"),
        ("observation_ages", b"\0\3\1", "2 observation terms are not those of its lists"),
        ("observation_ages", b"\0\x11", "rate_error_delta 17 steps old, expected 0 to 16"),
        (
            "observation_gains",
            struct.pack("<3f", 0, 0, 0.5),
            "2 observation terms are not those of its lists",
        ),
        ("observation_gains", struct.pack("<3f", 0, 0, np.nan), "2 observation terms are not those of its"),
        (
            "observation_gains",
            struct.pack("<2f", 0, 1),
            "low-pass of rate_error_delta has the gain 1.0, expected",
        ),
        ("observation_gains", struct.pack("<f", -0.5), "low-pass of rate_error has the gain -0.5, expected"),
        ("observation_gains", struct.pack("<f", np.nan), "low-pass of rate_error has the gain nan, expected"),
        ("idle", struct.pack("<f", np.nan), "idle is nan, expected 0 to 0.5"),
        ("idle", struct.pack("<f", 0.75), "idle is 0.75, expected 0 to 0.5"),
        ("idle", struct.pack("<f", -0.25), "idle is -0.25, expected 0 to 0.5"),
        ("mix", b"\2\0\0\0", r"mix is 2, known are \[0, 1\]; write it again with"),
        ("mix", b"\xff" * 4, "mix is 4294967295, known are"),
        ("model_rotor", struct.pack("<f", 1), "has no model, but constants of one"),
        ("model_turn", bytes(92) + struct.pack("<f", 1), "has no model, but constants of one"),
        ("model_reaction", struct.pack("<f", np.nan), "has no model, but constants of one"),
        ("model_delay", b"\1\0\0\0", "model: rise is 0.0, expected above 0 and at most 1"),
    ],
)
def test_a_blob_is_refused_in_its_words_when_a_field_lies(name: str, value: bytes, text: str) -> None:
    assert re.search(text, refusal(lambda: parse(patched(name, value))))


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("model_delay", b"\0\0\0\0", "has no model, but constants of one"),
        ("model_delay", b"\x09\0\0\0", "model: delay_steps is 9, expected 1 to 8"),
        ("model_delay", b"\xff" * 4, "model: delay_steps is 4294967295, expected 1 to 8"),
        ("model_rotor", struct.pack("<f", np.nan), "model: speed_curve holds 'nan', expected a number"),
        ("model_rotor", struct.pack("<f", 2e9), r"model: a number is not finite or beyond 1e\+09"),
        ("model_turn", struct.pack("<f", np.inf), "model: turn holds 'inf', expected a number"),
        (
            "model_turn",
            bytes(16) + struct.pack("<f", 1),
            "model has values of more motors than the 4 it drives",
        ),
        ("model_reaction", bytes(92) + b"\1\0\0\0", "model has values of more motors than the 4 it drives"),
    ],
)
def test_a_model_is_refused_in_its_words_when_a_number_lies(name: str, value: bytes, text: str) -> None:
    data = pack(replace(BLOB, model=MODEL))
    changed = data[: at(name)] + value + data[at(name) + len(value) :]
    assert re.search(text, refusal(lambda: parse(sealed(changed))))


def vectors(count: int) -> dict[str, Any]:
    """So many vectors of the self-test."""
    return {"selftest_observation": np.ones((count, 6), "f4"), "selftest_action": np.ones((count, 4), "f4")}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"weights": np.array([1, np.nan, np.inf], np.float32)}, "2 NaN or infinite values"),
        ({"selftest_action": np.full((2, 4), 1.0000001, np.float32)}, "action outside 0 to 1"),
        ({"selftest_action": np.full((2, 4), -1e-45, np.float32)}, "action outside 0 to 1"),
        ({"selftest_action": np.full((2, 4), np.nan, np.float32)}, "action outside 0 to 1"),
        ({"selftest_steps": 3}, "self-test steps is 3, expected 1 to 2"),
        ({"selftest_steps": 0}, "self-test steps is 0, expected 1 to 2"),
        ({"sequence": 1 << 32}, "sequence number is 4294967296, expected 0 to 4294967295"),
        ({"sequence": -1}, "sequence number is -1, expected 0"),
        ({"control_rate_hz": 0}, "control rate is 0, expected 1 to"),
        ({"aircraft": "A" * 33}, "at most 32 letters"),
        ({"aircraft": "ünf"}, "at most 32 letters"),
        ({"policy_sha256": "a1" * 31}, "SHA-256 of the policy is .*, expected 64 hexadecimal digits"),
        ({"aircraft_sha256": "A1" * 32}, "SHA-256 of the aircraft is"),
        ({"terms": terms("rate_error")}, "takes 6 values, but its blocks make 3"),
        (
            {"terms": terms("rate_error,rate_estimate")},
            "observes what a model of its aircraft tells, but has",
        ),
        (
            {"model": replace(MODEL, turn=((0.0,) * 6,) * 3, reaction=((0.0,) * 6,) * 3)},
            "model is of 6 motors, it drives 4",
        ),
        (
            {
                "terms": terms(",".join(["throttle"] * 33)),
                "selftest_observation": np.ones((2, 33), np.float32),
            },
            "number of observation terms is 33, expected 1 to 32",
        ),
        (vectors(0), "number of self-test vectors is 0, expected 1 to 65535"),
        (vectors(3), "3 self-test vectors are no multiple of 2 steps"),
    ],
)
def test_a_blob_is_not_packed_when_it_could_not_be_read_back(change: dict[str, Any], text: str) -> None:
    assert re.search(text, refusal(lambda: pack(replace(BLOB, **change))))


def test_a_blob_is_not_made_when_its_arrays_do_not_belong_together() -> None:
    for change in (
        {"weights": WEIGHTS.astype(np.float64)},
        {"selftest_observation": OBSERVATION[:1]},
        {"selftest_action": ACTION[0]},
    ):
        with pytest.raises(ValueError, match="a blob of"):
            replace(BLOB, **change)  # type: ignore[arg-type]


# --- What may be exchanged --------------------------------------------------------------------
def test_filters_hash_tells_chains_apart_but_not_the_order_of_keys() -> None:
    assert filters_hash([]) == filters_hash(()) == contract.POLICY_FILTERS_NONE == zlib.crc32(b"[]")
    lowpass = {"type": "lowpass", "hz": 100}
    assert filters_hash([lowpass]) == filters_hash([{"hz": 100, "type": "lowpass"}])
    assert len({filters_hash(chain) for chain in ([], [lowpass], [lowpass, lowpass])}) == 3


# --- C and the page ---------------------------------------------------------------------------
MACROS = jinja2.Environment(loader=jinja2.PackageLoader("neuroflight.toolchain.rendering"), trim_blocks=True)
COMPILERS = (("gcc", "objcopy"), ("arm-none-eabi-gcc", "arm-none-eabi-objcopy"))


@pytest.mark.parametrize(("compiler", "objcopy"), COMPILERS)
def test_compiled_in_bytes_are_the_packed_ones_when_c_writes_them(
    tmp_path: Path, compiler: str, objcopy: str
) -> None:
    blob = replace(BLOB, selftest_observation=np.ones((2, 6), np.float32), aircraft="A-b.c_" + "9" * 26)
    macros: Any = MACROS.get_template("blob_header.j2").module
    head = macros.struct("header", blob_header_fields())
    initial = macros.initializer(blob_header_fields(), header_literals(blob))
    weights, observation, action = (
        ", ".join(f"{float(value).hex()}f" for value in array.ravel())
        for array in (blob.weights, blob.selftest_observation, blob.selftest_action)
    )
    source = f"""
#include <stddef.h>
#include <stdint.h>
{head}
struct blob {{ struct header header; float weights[5], observation[12], action[8]; uint32_t crc32; }};
extern const struct blob blob;
_Alignas(8) const struct blob blob = {{
    .header = {{ {initial} }},
    .weights = {{ {weights} }}, .observation = {{ {observation} }}, .action = {{ {action} }},
    .crc32 = {zlib.crc32(pack(blob)[:-4])}u,
}};
"""
    made, raw = tmp_path / "blob.o", tmp_path / "blob.bin"
    flags = ["-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Wpadded", "-pedantic", "-Werror"]
    command = [compiler, *flags, "-x", "c", "-c", "-", "-o", str(made)]
    done = subprocess.run(command, input=source, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    subprocess.run([objcopy, "-O", "binary", "-j", ".rodata", str(made), str(raw)], check=True)
    assert raw.read_bytes() == pack(blob)


def test_the_page_says_what_the_contract_does_when_read() -> None:
    rows = re.findall(r"^\| (\d+) \| `(\S+) (\w+)(?:\[(\d+)\])?` \| (.*) \| (.*) \|$", PAGE.read_text(), re.M)
    told = [(int(at), kind, name, int(count or 1), unit, text) for at, kind, name, count, unit, text in rows]
    offsets = [field.offset for field in blob_header_fields()]
    assert told == [
        (offset, field.c_type, field.name, field.count, field.unit, field.meaning)
        for offset, field in zip(offsets, contract.POLICY_BLOB_FIELDS, strict=True)
    ]
