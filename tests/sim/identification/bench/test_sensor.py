"""Lines of a sensor, whole, in pieces, damaged, and without end."""

from __future__ import annotations

import random

import pytest

from neuroflight.sim.identification.bench.sensor import LINE_BYTES_MAX, LineReader, parse_layout
from neuroflight.toolchain.errors import DynoError

HEADING = b"time_us,thrust_raw,torque_raw,pulses,foo\r\n"
LINES = b"".join(b"%d,%d,-%d,%d,x1\r\n" % (1000 * k, 84_000 + k, k, k) for k in range(1, 50))


def test_rows_are_the_same_when_they_come_whole_or_byte_by_byte() -> None:
    whole, single = LineReader(), LineReader()
    data = b"# version 3\nhello\n" + HEADING + LINES
    rows = whole.feed(data, 1.0)
    assert [row for byte in data for row in single.feed(bytes([byte]), 1.0)] == rows
    assert len(rows) == 49 and rows[0].values == (1000.0, 84_001.0, -1.0, 1.0)
    assert whole.layout is not None and whole.layout.time == "time_us"
    assert whole.bad == single.bad == 1, "the greeting"


@pytest.mark.parametrize("apart", [b",", b";", b"\t", b" , ", b"  "])
def test_cells_are_read_however_they_are_set_apart(apart: bytes) -> None:
    reader = LineReader(parse_layout(["time_s", "rpm", "thrust_n", "torque_n_m"]))
    (row,) = reader.feed(b"\n" + apart.join([b"0.5", b"1e4", b"-3.25", b".02"]) + b"\n", 2.0)
    assert row.values == (0.5, 1e4, -3.25, 0.02) and row.arrival == 2.0


@pytest.mark.parametrize(
    "line",
    [
        b"1,2,3",
        b"1,2,3,4,5",
        b"1,,3,4",
        b"nan,2,3,4",
        b"inf,2,3,4",
        b"1,2,3,1e300",
        b"1,2,\xff,4",
        b"1,2,3,4x",
    ],
)
def test_a_line_is_no_reading_when_it_is_damaged(line: bytes) -> None:
    reader = LineReader(parse_layout(["time_s", "rpm", "thrust_n", "torque_n_m"]))
    assert reader.feed(b"\n1,2,3,4\n" + line + b"\n2,2,3,4\n", 0.0) == reader.feed(b"1,2,3,4\n2,2,3,4\n", 0.0)
    assert reader.bad == 1


def test_the_first_line_is_no_error_when_it_was_cut() -> None:
    reader = LineReader(parse_layout(["time_s", "rpm", "thrust_n", "torque_n_m"]))
    assert len(reader.feed(b"2,3,4\n1,2,3,4\n", 0.0)) == 1 and reader.bad == 0


def test_memory_stays_small_when_no_line_ends() -> None:
    reader = LineReader(parse_layout(["time_s", "rpm", "thrust_n", "torque_n_m"]))
    reader.feed(b"1,2,3,4\n", 0.0)
    for _ in range(1000):
        assert reader.feed(b"1" * 1000, 0.0) == []
        assert len(reader._rest) <= LINE_BYTES_MAX
    assert reader.bad == 1
    assert len(reader.feed(b"\n1,2,3,4\n", 0.0)) == 1


@pytest.mark.parametrize("seed", range(20))
def test_nothing_but_rows_and_refusals_comes_out_when_bytes_are_random(seed: int) -> None:
    rng = random.Random(seed)
    data = bytearray(HEADING + LINES * 3)
    for _ in range(60):
        data[rng.randrange(len(HEADING), len(data))] = rng.randrange(256)
    reader = LineReader()
    rows = reader.feed(bytes(data), 0.0)
    assert 60 < len(rows) < 147 and reader.bad > 0
    assert all(len(row.values) == 4 for row in rows)


@pytest.mark.parametrize(
    ("names", "says"),
    [
        ("time_s,thrust_n,torque_n_m", "expected one of rpm, pulses too"),
        ("thrust_n,rpm", "expected one of torque_n_m, torque_raw, torque_left_raw too"),
        ("a,b,c", "none that is known"),
        ("thrust_n,thrust_raw,torque_raw,rpm", "thrust_n and thrust_raw"),
        ("thrust_n,torque_left_raw,rpm", "expected both"),
        ("thrust_n,torque_raw,rpm,rpm", "stands twice"),
        ("thrust_n,torque_raw,pulses,pulse_us", "expected all three"),
        ("time_s,time_us,thrust_n,torque_raw,rpm", "time_s and time_us"),
    ],
)
def test_columns_are_refused_when_something_lacks_or_contradicts(names: str, says: str) -> None:
    with pytest.raises(DynoError, match=says):
        parse_layout(names.split(","))


def test_another_heading_is_refused_when_columns_were_given() -> None:
    reader = LineReader(parse_layout(["time_us", "torque_raw", "thrust_raw", "pulses", "foo"]))
    with pytest.raises(DynoError, match="as before"):
        reader.feed(b"\n" + HEADING, 0.0)
