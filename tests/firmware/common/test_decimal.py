"""decimal.c: float32 as text and back, against numpy and the C library."""

from __future__ import annotations

import ctypes
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.sampling import examples

DECIMAL_BYTES, PLACES = 24, 12
LIBC = ctypes.CDLL(None)
LIBC.strtof.restype = ctypes.c_float
LIBC.strtof.argtypes = (ctypes.c_char_p, ctypes.c_void_p)

LEAST, LARGEST = 0x37800000, 0x4B7FFFFF  # bits of 2^-16 and of the last float below 2^24
numbers = st.just(0) | st.integers(LEAST, LARGEST)
powers_of_two = st.integers(LEAST >> 23, LARGEST >> 23).map(lambda exponent: exponent << 23)


def of_bits(bits: int) -> float:
    return float(struct.unpack("<f", struct.pack("<I", bits))[0])


def bits_of(value: float) -> int:
    return int(struct.unpack("<I", struct.pack("<f", value))[0])


def format_(core: Any, value: float) -> str:
    text = core.new("char[]", b"\x55" * DECIMAL_BYTES)
    length = core.lib.decimal_format(value, text)
    words = bytes(core.ffi.string(text)).decode()
    assert length == len(words) < DECIMAL_BYTES
    return words


def parse(core: Any, text: str) -> float | None:
    value = core.new("float *", 7.0)
    taken = core.lib.decimal_parse(text.encode(), value)
    assert taken or value[0] == 7.0
    return float(value[0]) if taken else None


@settings(max_examples=examples(3000), deadline=None)
@given(bits=numbers | powers_of_two, negative=st.booleans())
@example(bits=LEAST, negative=False)
@example(bits=LEAST + 1, negative=False)
@example(bits=LARGEST, negative=True)
@example(bits=0, negative=True)
def test_a_float_is_written_with_the_fewest_places_and_reads_back_when_it_is_of_a_settings_size(
    scripted: Any, bits: int, negative: bool
) -> None:
    value = of_bits(bits | negative << 31)
    text = format_(scripted, value)
    read = parse(scripted, text)
    assert read is not None
    assert bits_of(read) == bits_of(value) == bits_of(LIBC.strtof(text.encode(), None))
    assert text == np.format_float_positional(np.float32(value), unique=True, trim="-")


@settings(max_examples=examples(1000), deadline=None)
@given(bits=st.integers(0, LEAST - 1))
@example(bits=1)
@example(bits=LEAST - 1)
@example(bits=722255053)  # a little more than 5e-13
def test_a_float_is_rounded_to_twelve_places_when_it_is_smaller(scripted: Any, bits: int) -> None:
    value = of_bits(bits)
    text = format_(scripted, value)
    assert len(text.partition(".")[2]) <= PLACES
    assert abs(float(text) - value) <= 0.5e-12


@pytest.mark.parametrize("bits", [LARGEST + 1, 0x7F7FFFFF, 0x7F800000, 0x7FC00000, 0xFFFFFFFF])
def test_some_text_is_written_when_a_float_is_no_settings(scripted: Any, bits: int) -> None:
    assert format_(scripted, of_bits(bits)).lstrip("-").isdecimal()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (-0.0, "-0"),
        (1.0, "1"),
        (1998.0, "1998"),
        (0.2, "0.2"),
        (0.70710678, "0.70710677"),
        (100.0, "100"),
        (-180.0, "-180"),
        (0.0001, "0.0001"),
        (1024.53125, "1024.5312"),  # half way between two texts
        (0.0000152587890625, "0.000015258789"),
        (16777215.0, "16777215"),
    ],
)
def test_a_float_is_written_as_people_write_it(scripted: Any, value: float, text: str) -> None:
    assert format_(scripted, value) == text


@settings(max_examples=examples(3000), deadline=None)
@given(
    sign=st.sampled_from(["", "-", "+"]),
    whole=st.text("0123456789", min_size=1, max_size=6),
    fraction=st.none() | st.text("0123456789", max_size=11),
)
@example(sign="", whole="8388609", fraction="5")  # half way: to even
@example(sign="", whole="8388610", fraction="5")
@example(sign="-", whole="000000000000000000000000000000000001", fraction="5")
@example(sign="", whole="0", fraction="000000000001")
def test_a_number_is_read_as_the_c_library_reads_it(
    scripted: Any, sign: str, whole: str, fraction: str | None
) -> None:
    text = sign + whole + ("" if fraction is None else f".{fraction}")
    read = parse(scripted, text)
    assert read is not None
    assert bits_of(read) == bits_of(LIBC.strtof(text.encode(), None))


@settings(max_examples=examples(1000), deadline=None)
@given(bits=st.integers(0x45800000, LARGEST - 1))  # from 4096 on twelve places say the middle exactly
def test_half_way_between_two_floats_is_the_even_one(scripted: Any, bits: int) -> None:
    text = f"{(of_bits(bits) + of_bits(bits + 1)) / 2:.{PLACES}f}"  # exact in float64
    read = parse(scripted, text)
    assert read is not None
    assert bits_of(read) == bits_of(LIBC.strtof(text.encode(), None))


def test_places_do_not_count_when_they_stand_behind_the_twelfth(scripted: Any) -> None:
    assert parse(scripted, "0." + "0" * 12 + "9") == 0.0
    assert parse(scripted, "0.70710678118654752440") == of_bits(bits_of(0.70710678))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "-",
        "+",
        ".",
        "-.",
        "e5",
        "1e",
        "1e-",
        "1e+",
        "1 ",
        " 1",
        "1,5",
        "0x10",
        "1.2.3",
        "--1",
        "1-",
        "nan",
        "inf",
        "1e5",
        "1E3",
        "16777216",
        "16777215.5",
        "9" * 18,
        "9" * 30,
        "1" + "0" * 40,
        "9" * 60 + ".5",
        "1f",
        "1e5x",
        "infinity",
        "1e5.0",
    ],
)
def test_a_text_is_refused_when_it_is_no_number(scripted: Any, text: str) -> None:
    assert parse(scripted, text) is None


@pytest.mark.parametrize("text", ["5.", ".5", "+5", "0" * 60 + "1", "00.50"])
def test_a_text_is_read_when_it_is_an_unusual_number(scripted: Any, text: str) -> None:
    read = parse(scripted, text)
    assert read is not None
    assert bits_of(read) == bits_of(LIBC.strtof(text.encode(), None))
