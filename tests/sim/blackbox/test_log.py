"""Reading logs: what was written comes back, and what the format's corners are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.blackbox.firmware import Maker
from sim.blackbox.log import floats, list_logs, read_log
from tests.sim.blackbox.writer import (
    END,
    GROUP,
    PRODUCT,
    Column,
    event,
    fields,
    flight,
    header,
    inter,
    intra,
    slow,
)
from toolchain.errors import TraceError

COLUMNS = [*(Column(f"gyroADC[{axis}]") for axis in range(3)), *(Column(f"motor[{m}]") for m in range(4))]
NUMBERS = header({"I interval": 32, "P interval": "1/1", "looptime": 125})
rng = np.random.default_rng(20)
ROWS = rng.integers(-2000, 2000, (200, 7)).tolist()


def save(folder: Path, *parts: bytes) -> Path:
    path = folder / "LOG00001.BFL"
    path.write_bytes(b"".join(parts))
    return path


def rows_of(path: Path, names: list[str], number: int | None = None) -> np.ndarray:
    log = read_log(path, number)
    return np.stack([log.columns[name] for name in names], axis=1)


def test_rows_come_back_as_they_were_written(tmp_path: Path) -> None:
    path = save(tmp_path, PRODUCT, NUMBERS, fields(COLUMNS), flight(COLUMNS, ROWS), END)
    log = read_log(path)
    assert (rows_of(path, [column.name for column in COLUMNS]) == ROWS).all()
    assert (log.columns["loopIteration"] == np.arange(200)).all()
    assert (log.time_us == 5_000_000 + 1000 * np.arange(200)).all()
    assert log.ended and not log.notes and log.lost == 0 and log.rate_hz == 1000.0
    assert log.maker is Maker.OTHER and log.header["looptime"] == "125"


@pytest.mark.parametrize("count", [1, 2, 3, 7, 8, 9, 15])
def test_group_at_the_end_of_a_frame_is_read_when_it_has_any_count_of_fields(
    tmp_path: Path, count: int
) -> None:
    columns = [Column("gyroADC[0]"), *(Column(f"debug[{at}]", GROUP) for at in range(count))]
    rows = rng.integers(-3, 4, (100, count + 1)).tolist()
    path = save(tmp_path, PRODUCT, NUMBERS, fields(columns), flight(columns, rows), END)
    assert (rows_of(path, [column.name for column in columns]) == rows).all()
    assert not read_log(path).notes


def test_first_frames_are_read_when_the_first_is_no_intra_frame(tmp_path: Path) -> None:
    parts = (event(0, 4_999_000), slow([1, 7]), flight(COLUMNS, ROWS), slow([0, 7]), event(15, 4), END)
    path = save(tmp_path, PRODUCT, NUMBERS, fields(COLUMNS, ["flightModeFlags", "stateFlags"]), *parts)
    log = read_log(path)
    assert len(log) == 200 and log.events[0].name == "arming" and log.events[0].values == {"time": 4_999_000}
    assert [(one.name, one.row) for one in log.events[1:]] == [("disarming", 200), ("end", 200)]
    held = log.held("flightModeFlags")
    assert held is not None and (held == 1).all() and log.slow_row.tolist() == [0, 200]


def test_each_log_of_a_file_is_read_when_there_are_several(tmp_path: Path) -> None:
    one = [PRODUCT, NUMBERS, fields(COLUMNS)]
    path = save(tmp_path, *one, flight(COLUMNS, ROWS[:50]), END, *one, flight(COLUMNS, ROWS[50:90]))
    assert [item.number for item in list_logs(path)] == [1, 2]
    names = [column.name for column in COLUMNS]
    assert (rows_of(path, names, 1) == ROWS[:50]).all()
    assert (rows_of(path, names) == ROWS[50:90]).all()
    with pytest.raises(TraceError, match="--log 3, but it holds 2 logs"):
        read_log(path, 3)


def test_float_bits_and_the_32_bits_of_time_come_back_when_they_wrap(tmp_path: Path) -> None:
    values = np.linspace(-3, 5, 40, dtype=np.float32)
    columns = [Column("gyroFloat[0]")]
    bits = values.view(np.int32).tolist()
    rows = [[bit] for bit in bits]
    start = (1 << 32) - 10_000
    frames = intra(0, start, rows[0]) + b"".join(
        inter(columns, 1000 if step == 1 else 0, rows[step - 1], rows[step]) for step in range(1, 40)
    )
    log = read_log(save(tmp_path, PRODUCT, NUMBERS, fields(columns), frames, END))
    assert floats(log.columns["gyroFloat[0]"]).tobytes() == values.tobytes()
    assert (log.time_us == start + 1000 * np.arange(40)).all()


def test_time_of_rows_and_events_goes_on_when_intra_frames_begin_anew(tmp_path: Path) -> None:
    word = 1 << 32
    start = 2 * word - 10_500  # a log holds no more than the lower 32 bits of it
    frames = flight(COLUMNS, ROWS[:80], start=start)
    told = event(0, (start + 80_000) % word) + event(14, 80, (start + 80_000) % word)
    log = read_log(save(tmp_path, PRODUCT, NUMBERS, fields(COLUMNS), frames, told, END))
    time = start - word + 1000 * np.arange(80)
    assert log.lost == 0 and not log.notes
    assert log.columns["time"].tolist() == log.time_us.tolist() == time.tolist()
    assert [one.values["time"] for one in log.events[:2]] == [time[-1] + 1000] * 2
    assert log.seconds == 0.079


def test_missing_steps_are_counted_when_logging_resumes(tmp_path: Path) -> None:
    later = intra(500, 5_500_000, ROWS[100]) + intra(501, 5_501_000, ROWS[101])
    parts = (flight(COLUMNS, ROWS[:100]), event(14, 500, 5_500_000), later, END)
    log = read_log(save(tmp_path, PRODUCT, NUMBERS, fields(COLUMNS), *parts))
    assert log.lost == 400 and log.missing[100] == 400 and not log.notes
    assert log.events[0].values == {"step": 500, "time": 5_500_000}


def test_blank_rest_of_a_cards_file_is_no_damage(tmp_path: Path) -> None:
    path = save(tmp_path, PRODUCT, NUMBERS, fields(COLUMNS), flight(COLUMNS, ROWS), END, bytes(1 << 20))
    assert not read_log(path).notes
    path = save(tmp_path, PRODUCT, NUMBERS, fields(COLUMNS), flight(COLUMNS, ROWS), bytes(1 << 20))
    log = read_log(path)
    assert len(log) == 200 and log.notes == ("no end of the log: the power was cut, or the file",)
