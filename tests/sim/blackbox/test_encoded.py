"""Logs of random fields: every value comes back, however it wraps, whatever the clock, whatever line is lost.

The independent reading is the encoder's: it knows what it wrote.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.random import Generator

from neuroflight.sim.blackbox.log import Log, read_log
from tests.sim.blackbox.encoder import (
    AVERAGE,
    LINE,
    MID,
    MINMOTOR,
    MINTHROTTLE,
    MOTOR_0,
    NEG_14BIT,
    NOTHING,
    PREVIOUS,
    SIGNED_VB,
    STEP,
    TAG2_3S32,
    TAG8_4S16,
    TAG8_8SVB,
    UNSIGNED_VB,
    VBATREF,
    WORD,
    ZERO,
    Field,
    Written,
    encode,
    logged_steps,
)

CASES = 1000  # of each kind
FEW = 20  # of these, in an ordinary run
ROWS = 70
EDGES = (0, 1, 137, 138, 1069, 1070, 1500, WORD // 2 - 1)


def few_and_all(kind: str) -> pytest.MarkDecorator:
    """Return parameters: the first FEW cases, and in the long run also all of them."""
    slow = pytest.param(range(FEW, CASES), marks=pytest.mark.slow, id=f"{kind}-all")
    return pytest.mark.parametrize("cases", [pytest.param(range(FEW), id=f"{kind}-few"), slow])


def fields_of(rng: Generator) -> list[Field]:
    """Draw fields: step and time, then groups and single ones of any sign, encoding and predictor."""
    fields = [
        Field("loopIteration", signed=False, intra=(ZERO, UNSIGNED_VB), inter=(STEP, NOTHING)),
        Field("time", signed=False, intra=(ZERO, UNSIGNED_VB), inter=(LINE, SIGNED_VB)),
    ]

    def add(count: int, encoding: int, *, name: str = "", predictors: tuple[int, ...] = (PREVIOUS,)) -> None:
        for at in range(count):
            sign = bool(rng.integers(2))
            constant = int(rng.choice([ZERO, MINTHROTTLE, MID, MINMOTOR]))
            # A value below its prediction in an unsigned encoding wraps: the case that these tests are about.
            intra = (constant, int(rng.choice([SIGNED_VB, UNSIGNED_VB])))
            inter = (int(rng.choice(predictors)), encoding)
            fields.append(Field(f"{name or f'x{len(fields)}'}[{at}]", sign, intra, inter))

    for kind in rng.permutation(8).tolist():
        if kind == 0:
            add(3, TAG2_3S32, name="axisI")
        elif kind == 1:
            add(4, TAG8_4S16, name="rcCommand")
        elif kind == 2:
            add(int(rng.integers(1, 11)), TAG8_8SVB, name="debug")
        elif kind == 3:
            add(
                int(rng.integers(1, 5)), SIGNED_VB, name="gyroADC", predictors=(PREVIOUS, AVERAGE, LINE, ZERO)
            )
        elif kind == 4:
            add(2, UNSIGNED_VB, predictors=(ZERO, PREVIOUS, MINTHROTTLE))
        elif kind == 5:
            fields.append(
                Field("vbatLatest", signed=False, intra=(VBATREF, NEG_14BIT), inter=(PREVIOUS, TAG8_8SVB))
            )
            add(1, SIGNED_VB)
        elif kind == 6:
            fields.append(
                Field("motor[0]", signed=False, intra=(MINMOTOR, UNSIGNED_VB), inter=(AVERAGE, SIGNED_VB))
            )
            fields.append(
                Field("motor[1]", signed=False, intra=(MOTOR_0, SIGNED_VB), inter=(AVERAGE, SIGNED_VB))
            )
    return fields


def column(one: Field, rng: Generator, count: int) -> list[int]:
    """Draw values that the field can hold, some near its limits and far from each other."""
    if one.name.startswith(("motor", "vbat")):
        return rng.choice([0, 1, 137, 138, 139, 1640, 2047], count).tolist()  # type: ignore[no-any-return]
    low, high = (-(WORD // 2), WORD // 2) if one.signed else (0, WORD)
    if one.inter[1] == TAG8_4S16:
        walk = int(rng.integers(low + count * 40_000, high - count * 40_000))
        steps = rng.choice([-32_768, -129, -9, -8, -1, 0, 0, 7, 8, 127, 32_767], count)
        return (walk + np.cumsum(steps)).tolist()  # type: ignore[no-any-return]
    if AVERAGE in (one.inter[0], one.intra[0]):  # whose sum must not wrap, as C leaves that open
        low, high = max(low, -(1 << 30)), min(high, 1 << 30)
    kinds = (
        rng.integers(low, high, count),
        np.clip(rng.integers(-3, 4, count).cumsum() + int(rng.choice(EDGES)), low, high - 1),
        rng.choice([low, low + 1, high - 2, high - 1, 0], count),
    )
    return kinds[int(rng.integers(3))].tolist()  # type: ignore[no-any-return]


def written(rng: Generator, *, uneven: bool = False) -> Written:
    """Write a random log of ROWS rows."""
    interval = int(rng.choice([1, 4, 32, 64]))
    of = int(rng.choice([1, 2, 3, 4]))
    intervals = interval, int(rng.integers(1, of + 1)), of
    fields = fields_of(rng)
    columns = [column(one, rng, ROWS) for one in fields]
    columns[0] = logged_steps(intervals, ROWS)
    apart = rng.choice([1, 31, 250, 1000, 3200, 700_000, 9_999_999], ROWS) if uneven else np.full(ROWS, 1000)
    start = int(rng.choice([5_000_000, WORD - 20_000, WORD - 2]))
    columns[1] = ((start + np.cumsum(apart)) % WORD).tolist()
    return encode(fields, [list(row) for row in zip(*columns, strict=True)], intervals, rng)


def read(tmp_path: Path, data: bytes) -> Log:
    path = tmp_path / "a.bfl"
    path.write_bytes(data)
    return read_log(path)


def wrong(log: Log, made: Written, but: tuple[str, ...] = ("time",)) -> list[str]:
    """Return the fields whose decoded values differ from the written ones."""
    return [
        one.name
        for one, values in zip(made.fields, zip(*made.rows, strict=True), strict=True)
        if one.name not in but and log.columns[one.name].tolist() != list(values)
    ]


@few_and_all("wrap")
def test_values_come_back_when_they_wrap(tmp_path: Path, cases: range) -> None:
    for case in cases:
        made = written(np.random.default_rng((39, case)))
        log = read(tmp_path, made.data())
        assert not log.notes and log.ended and len(log) == ROWS, (case, log.notes)
        assert not wrong(log, made), (case, wrong(log, made))


@few_and_all("clock")
def test_time_comes_back_when_the_clock_is_uneven_and_begins_anew(tmp_path: Path, cases: range) -> None:
    for case in cases:
        made = written(np.random.default_rng((40, case)), uneven=True)
        log = read(tmp_path, made.data())
        clock = np.array([row[1] for row in made.rows])
        apart = (clock[1:] - clock[:-1]) % WORD
        expected = np.concatenate(([0], np.cumsum(apart)))
        assert not log.notes and not wrong(log, made), case
        assert log.time_us.tolist() == (clock[0] + expected).tolist(), case
        assert log.t.tolist() == (expected / 1e6).tolist(), case


@few_and_all("lost")
def test_a_lost_line_is_told_when_the_meaning_of_fields_depends_on_it(tmp_path: Path, cases: range) -> None:
    """Remove one header line: either its name is reported, or no value changes."""
    told = 0
    for case in cases:
        rng = np.random.default_rng((41, case))
        made = written(rng)
        lines = [*made.lines, "Data version"]
        line = lines[int(rng.integers(len(lines)))]
        if line in ("Field I name", "Field I predictor", "Field I encoding"):
            continue  # without them nothing is read
        log = read(tmp_path, made.data(without=[line]))
        if line.startswith("Field P"):
            assert any("P frames cannot be read" in note for note in log.notes), (case, log.notes)
            continue
        notes = [note for note in log.notes if "lost" in note]
        told += bool(notes)
        assert not notes or line in notes[0], (case, line, log.notes)
        # If steps are counted wrong they may go backwards: rows are dropped then, which is reported too.
        assert len(log.notes) == len(notes) or (notes and line == "I interval"), (case, line, log.notes)
        if not notes:
            assert not wrong(log, made), (case, line)
        elif line in ("minthrottle", "motorOutput", "vbatref"):
            # Only fields that a note names may have wrong values.
            named = notes[0].partition(f"{line}: values of ")[2].split(" may be wrong")[0].split(", ")
            assert {name.partition("[")[0] for name in wrong(log, made)} <= set(named), (case, line)
    assert told > len(cases) / 10
