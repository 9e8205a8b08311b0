"""decimal.c: float32 as text and back, against numpy and the C library."""

from __future__ import annotations

import ctypes
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

DECIMAL_BYTES = 20
LIBC = ctypes.CDLL(None)
LIBC.strtof.restype = ctypes.c_float
LIBC.strtof.argtypes = (ctypes.c_char_p, ctypes.c_void_p)

LEAST, LEAST_NORMAL, LARGEST = 1, 0x00800000, 0x7F7FFFFF  # bits
finite = st.integers(0, LARGEST) | st.integers(LEAST_NORMAL - 40, LEAST_NORMAL + 40) | st.integers(0, 40)
powers_of_two = st.integers(1, 254).map(lambda exponent: exponent << 23)


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


def digits(text: str) -> str:
    """The digits that count."""
    return text.lstrip("-").partition("e")[0].replace(".", "").strip("0")


@settings(max_examples=3000, deadline=None)
@given(bits=finite | powers_of_two, negative=st.booleans())
@example(bits=LEAST, negative=False)
@example(bits=LEAST_NORMAL - 1, negative=True)
@example(bits=LEAST_NORMAL, negative=False)
@example(bits=LARGEST, negative=True)
@example(bits=0, negative=True)
def test_a_float_is_written_shortest_and_reads_back_when_it_is_finite(
    scripted: Any, bits: int, negative: bool
) -> None:
    value = of_bits(bits | negative << 31)
    text = format_(scripted, value)
    read = parse(scripted, text)
    assert read is not None
    assert bits_of(read) == bits_of(value) == bits_of(LIBC.strtof(text.encode(), None))
    numpys = np.format_float_scientific(np.float32(value), unique=True, trim="-")
    assert len(digits(text)) == len(digits(numpys))
    assert abs(float(text) - value) <= abs(float(numpys) - value), "of the shortest, the nearest"


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
        (1e-06, "1e-6"),
        (4000000000.0, "4000000000"),
        (10000000000.0, "1e10"),
        (of_bits(LEAST), "1e-45"),
        (of_bits(LARGEST), "3.4028235e38"),
        (float("inf"), "inf"),
        (float("-inf"), "-inf"),
        (float("nan"), "nan"),
        (16777216.0, "16777216"),
    ],
)
def test_a_float_is_written_as_people_write_it(scripted: Any, value: float, text: str) -> None:
    assert format_(scripted, value) == text


@settings(max_examples=3000, deadline=None)
@given(
    sign=st.sampled_from(["", "-", "+"]),
    whole=st.text("0123456789", min_size=1, max_size=14),
    fraction=st.none() | st.text("0123456789", max_size=16),
    exponent=st.none() | st.integers(-60, 45),
)
@example(sign="", whole="16777217", fraction=None, exponent=None)  # half way: to even
@example(sign="", whole="16777219", fraction=None, exponent=None)
@example(sign="", whole="7", fraction="00649232162408535461864791644", exponent=-46)  # half the least float
@example(sign="", whole="7", fraction="00649232162408535461864791645", exponent=-46)
@example(sign="-", whole="3", fraction="4028235677973366", exponent=38)  # half way above the largest
@example(sign="", whole="9", fraction=None, exponent=99999999999)
@example(sign="", whole="9", fraction=None, exponent=-99999999999)
@example(sign="", whole="0", fraction="0", exponent=99999999999)
@example(sign="", whole="000000000000000000000000000000000001", fraction="5", exponent=None)
def test_a_number_is_read_as_the_c_library_reads_it(
    scripted: Any, sign: str, whole: str, fraction: str | None, exponent: int | None
) -> None:
    text = sign + whole + ("" if fraction is None else f".{fraction}")
    text += "" if exponent is None else f"e{exponent}"
    read = parse(scripted, text)
    assert read is not None
    assert bits_of(read) == bits_of(LIBC.strtof(text.encode(), None))


@settings(max_examples=1000, deadline=None)
@given(bits=st.integers(0, LARGEST - 1))
def test_half_way_between_two_floats_is_the_even_one(scripted: Any, bits: int) -> None:
    # The sum is exact in float64; 26 digits of it are on the middle or near.
    text = f"{(of_bits(bits) + of_bits(bits + 1)) / 2:.25e}"
    read = parse(scripted, text)
    assert read is not None
    assert bits_of(read) == bits_of(LIBC.strtof(text.encode(), None))


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
        "1" * 31,
        "0." + "1" * 31,
        "1f",
        "1e5x",
        "infinity",
        "1e5.0",
    ],
)
def test_a_text_is_refused_when_it_is_no_number(scripted: Any, text: str) -> None:
    assert parse(scripted, text) is None


@pytest.mark.parametrize("text", ["5.", ".5", "+5", "1E3", "1e+3", "0" * 60 + "1", "0." + "0" * 40 + "1"])
def test_a_text_is_read_when_it_is_an_unusual_number(scripted: Any, text: str) -> None:
    read = parse(scripted, text)
    assert read is not None
    assert bits_of(read) == bits_of(LIBC.strtof(text.encode(), None))
