"""Reading logs: what was written comes back, and what the format's corners are."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.blackbox.firmware import Maker
from neuroflight.sim.blackbox.log import GLANCE_BYTES, floats, glance, list_logs, read_log
from neuroflight.sim.blackbox.units import channels
from neuroflight.toolchain.errors import TraceError
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
    signed,
    slow,
    unsigned,
)

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


def test_the_last_log_with_frames_is_read_when_those_behind_it_have_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Append 44 logs that were begun but hold no frames, as dumps of flash chips do."""
    head = [PRODUCT, NUMBERS, fields(COLUMNS, ["flightModeFlags"])]
    flown = [*head, flight(COLUMNS, ROWS), END]
    empty = [[*head], [*head, END], [*head, event(15, 4), END], [*head, slow([0]), event(30, 1, 0)]]
    path = save(tmp_path, *flown, *flown, *(part for at in range(44) for part in empty[at % 4]))
    log = read_log(path)
    assert log.number == 2 and len(log) == 200 and len(list_logs(path)) == 46 and not log.notes
    for action in ("quality", "decode"):
        assert main(["log", action, str(path), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["log"] == 2
    assert main(["log", "list", str(path), "--json"]) == 0
    notes = [row["note"] for row in json.loads(capsys.readouterr().out)]
    assert notes == ["", "", *["no frames that can be read"] * 44]
    with pytest.raises(TraceError, match="log 46 of 46 has no frame that can be read"):
        read_log(path, 46)
    # Damage to the log behind it is reported.
    path = save(tmp_path, *flown, *head, b"\x80" * 500, *flown[:2], flown[-2])
    assert read_log(path).number == 1 and "2 logs behind this one cannot be read" in read_log(path).notes
    path = save(tmp_path, *head, END, *head, END)
    with pytest.raises(TraceError, match="log 2 of 2 has no frame that can be read"):
        read_log(path)


def test_length_is_told_without_decoding_when_the_clock_begins_anew_twice(tmp_path: Path) -> None:
    """Log a row each 9 s for four hours; noise makes the file larger than the part that is read."""
    columns = [Column(f"debug[{at}]") for at in range(80)]
    rows = np.random.default_rng(7).integers(-(1 << 30), 1 << 30, (1600, 80)).tolist()
    clock = [(5_000_000 + 9_000_000 * at) % (1 << 32) for at in range(len(rows))]
    path = save(tmp_path, PRODUCT, NUMBERS, fields(columns), flight(columns, rows, clock=clock), END)
    [one] = list_logs(path)
    assert one.size > 4 * GLANCE_BYTES
    assert glance(path.read_bytes(), one) == 9.0 * (len(rows) - 1)


def gps_log(*frames: bytes, home: bool = True) -> list[bytes]:
    """Write a log of main frames, with the header lines of GPS frames as Betaflight has them."""
    position = {
        "Field G name": "time,GPS_numSat,GPS_coord[0],GPS_coord[1],GPS_speed",
        "Field G signed": "0,0,1,1,0",
        "Field G predictor": "10,0,7,7,0",
        "Field G encoding": "1,1,0,0,1",
    }
    where = {
        "Field H name": "GPS_home[0],GPS_home[1]",
        "Field H signed": "1,1",
        "Field H predictor": "0,0",
        "Field H encoding": "0,0",
    }
    return [PRODUCT, NUMBERS, fields(COLUMNS), header(position | (where if home else {})), *frames, END]


def test_positions_are_kept_with_their_own_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Log a home at 52.1 N, 5.2 W and two positions between which the clock's 32 bits wrap."""
    start = (1 << 32) - 40_500
    first, second = flight(COLUMNS, ROWS[:32], start=start), flight(COLUMNS, ROWS[:64], start=start)
    home = b"H" + signed(521_000_000) + signed(-52_000_000)
    here = b"G" + unsigned(250) + unsigned(11) + signed(-1500) + signed(70) + unsigned(9)
    there = b"G" + unsigned(400) + unsigned(12) + signed(1500) + signed(-70) + unsigned(10)
    parts = gps_log(first[: len(flight(COLUMNS, ROWS[:1], start=start))], home, here)
    frames = first[len(flight(COLUMNS, ROWS[:1], start=start)) :] + second[len(first) :]
    path = save(tmp_path, *parts[:-1], frames, there, END)
    log = read_log(path)
    assert len(log) == 64 and not log.notes and log.positions == 2
    assert log.gps["time"].tolist() == [start + 250, start + 63_400]
    assert log.gps["GPS_coord[0]"].tolist() == [520_998_500, 521_001_500]
    assert log.gps["GPS_coord[1]"].tolist() == [-51_999_930, -52_000_070]
    csv, npz = tmp_path / "a.csv", tmp_path / "a.npz"
    assert main(["log", "decode", str(path), "--csv", str(csv), "--npz", str(npz)]) == 0
    assert "2 GPS rows in a.gps.csv" in " ".join(capsys.readouterr().out.split())
    heading, *rows = (tmp_path / "a.gps.csv").read_text().splitlines()
    assert heading == "time (us),GPS_numSat,GPS_coord[0],GPS_coord[1],GPS_speed"
    assert rows[1] == f"{start + 63_400},12,521001500,-52000070,10"
    with np.load(npz) as arrays:
        assert arrays["gps/GPS_speed"].tolist() == [9, 10]
    # Without a home frame positions are unknown.
    path = save(
        tmp_path, *gps_log(first, here, flight(COLUMNS, ROWS[:32], start=start), home=False)[:-2], END
    )
    log = read_log(path)
    assert log.positions == 0 and any("Field H name: positions are told" in note for note in log.notes)
    assert "1 GPS frames before a home, or behind damage, left out" in log.notes


def test_a_setpoint_of_16_bits_wraps_when_it_reverses_in_tenths(tmp_path: Path) -> None:
    """+1998 to -1998 deg/s is -39960 tenths, of which 16 bits are written: 25576."""
    columns = [Column(f"setpoint[{at}]", 8) for at in range(4)] + [
        Column(f"other[{at}]", 8) for at in range(4)
    ]
    frames = intra(0, 5_000_000, [19980, 0, -19980, 500, 19980, 0, 0, 0])
    up, down = (number.to_bytes(2, "big", signed=True) for number in (25576, -25576))
    frames += b"P" + signed(1000) + bytes((0b00_11_00_11,)) + up + down + bytes((0b00_00_00_11,)) + up
    log = read_log(save(tmp_path, PRODUCT, NUMBERS, fields(columns), frames, END))
    rows = np.stack([log.columns[one.name] for one in columns], axis=1).tolist()
    assert not log.notes
    assert rows[1] == [-19980, 0, 19980, 500, 19980 + 25576, 0, 0, 0]


def test_sticks_of_data_version_1_are_read(tmp_path: Path) -> None:
    """Read groups of four fields whose half bytes and 16-bit values come with the lower half first."""
    columns = [Column(f"rcCommand[{at}]", 8) for at in range(4)]
    head = PRODUCT.replace(b"version:2", b"version:1") + NUMBERS + fields(columns)
    frames = intra(0, 5_000_000, [10, -20, 30, 1000])
    frames += b"P" + signed(1000) + bytes((0b11_10_01_01, 0xE3, 0x80, 0x2C, 0x01))  # +3, -2, -128, +300
    frames += b"P" + signed(0) + bytes((0b01_01_00_11, 0x00, 0x80, 0x7F))  # -32768, 0, -1, +7
    log = read_log(save(tmp_path, head, frames, END))
    rows = np.stack([log.columns[one.name] for one in columns], axis=1).tolist()
    assert not log.notes and log.time_us.tolist() == [5_000_000, 5_001_000, 5_002_000]
    assert rows == [[10, -20, 30, 1000], [13, -22, -98, 1300], [13 - 32768, -22, -99, 1307]]


OLD_HEADERS: dict[str, dict[str, object]] = {
    "Betaflight 3.0.1 (48b7b4f) X_RACERSPI": {"Firmware type": "Cleanflight"},
    "0aac025": {"Firmware type": "Cleanflight"},  # of Cleanflight 1.12
    "INAV 8.0.1 (ae47bcba) SPEEDYBEEF405AIO": {
        "Firmware type": "Cleanflight",
        "motorOutput": "1100,2000",
        "motor_pwm_protocol": 6,
    },
}


@pytest.mark.parametrize("revision", OLD_HEADERS)
def test_a_lost_line_changes_no_number_in_silence(tmp_path: Path, revision: str) -> None:
    """Each header line of firmwares that scale by many of them, one lost at a time."""
    lines: dict[str, object] = {
        **OLD_HEADERS[revision],
        "Firmware revision": revision,
        "I interval": 32,
        "P interval": "1/1",
        "gyro_scale": "0x3f800000",
        "minthrottle": 1070,
        "maxthrottle": 1850,
        "vbatref": 200,
        "vbatscale": 110,
        "currentMeter": "0,400",
        "acc_1G": 4096,
    }
    names = ("rcCommand[3]", "motor[0]", *(f"gyroADC[{axis}]" for axis in range(3)))
    columns = [Column(name) for name in (*names, "vbatLatest", "amperageLatest")]
    rows = [[1070 + 7 * at, 1070 + 8 * at, at, -at, 0, 1800 + at, 40 + at] for at in range(64)]

    def read(kept: Mapping[str, object]) -> tuple[dict[str, Any], str]:
        path = save(tmp_path, PRODUCT, header(kept), fields(columns), flight(columns, rows), END)
        log = read_log(path)
        ch = channels(log)
        units = ("gyro", "throttle", "motors", "dshot", "voltage", "current", "idle")
        values = {name: getattr(ch, name) for name in units}
        return {name: value for name, value in values.items() if value is not None}, "; ".join(log.notes)

    whole, notes = read(lines)
    assert not notes
    assert whole["throttle"][-1] == pytest.approx(7 * 63 / (1850 - 1070))
    for lost, value in lines.items():
        kept = {name: value for name, value in lines.items() if name != lost}
        damages: list[dict[str, object]] = [{}, {lost: f"{value}?"}, {lost: ""}]
        for damaged in damages:
            part, notes = read(kept | damaged)
            same = part.keys() == whole.keys() and all(
                np.array_equal(part[name], whole[name]) for name in whole
            )
            assert same or lost in notes, (lost, damaged)


def test_lost_lines_of_the_sticks_rates_are_told_when_no_setpoint_was_logged(tmp_path: Path) -> None:
    lines = {
        "Firmware revision": "Betaflight 4.3.1 (8d4f005) STM32F7X2",
        "I interval": 32,
        "P interval": "1/1",
        "deadband": 10,
        "yaw_deadband": 20,
        "rate_limits": "300,300,300",
        "rates": "70,70,70",
    }
    for lost in (None, *list(lines)[3:6]):
        kept = header({name: value for name, value in lines.items() if name != lost})
        for name in ("rcCommand", "setpoint"):
            columns = [Column(f"{name}[{at}]") for at in range(3)] + [Column("rcCommand[0]")] * (
                name[0] == "s"
            )
            rows = [row[: len(columns)] for row in ROWS[:40]]
            log = read_log(save(tmp_path, PRODUCT, kept, fields(columns), flight(columns, rows), END))
            told = [] if lost is None or name == "setpoint" else [lost]
            assert list(log.headers.lost()) == told


@pytest.mark.parametrize(
    ("lost", "told"),
    [
        ("gyro_scale", "a count of the gyro is taken as 1 deg/s"),
        ("motorOutput", "what motor values mean is not known"),
        ("blackbox_high_resolution", "they may be tenths"),
        ("Firmware revision", "whose log it is is not known"),
        ("looptime", ""),
        ("", ""),
    ],
)
def test_a_lost_line_is_told_when_a_firmware_always_writes_it(tmp_path: Path, lost: str, told: str) -> None:
    lines = {
        "Firmware type": "Cleanflight",
        "Firmware revision": "Betaflight 4.4.2 (23d066d08) STM32F405",
        "I interval": 32,
        "P interval": "1/1",
        "gyro_scale": "0x3f800000",
        "motorOutput": "158,2047",
        "blackbox_high_resolution": 0,
        "looptime": 125,
    }
    kept = header({name: value for name, value in lines.items() if name != lost})
    log = read_log(save(tmp_path, PRODUCT, kept, fields(COLUMNS), flight(COLUMNS, ROWS), END))
    assert log.notes == ((f"header lines are lost: {lost}: {log.headers.lost()[lost]}",) if told else ())
    assert told in "".join(log.notes)
    assert (rows_of(log.path, [column.name for column in COLUMNS]) == ROWS).all()


def test_events_of_other_firmwares_do_not_cost_rows(tmp_path: Path) -> None:
    others = (
        b"E\x0d\x05" + signed(-3),
        b"E\x0d\x85\0\0\x80?",
        event(50, 3),
        event(40, 1),
        b"E\x0a\1\2\3\4\5",
    )
    begun, whole = len(flight(COLUMNS, ROWS[:50])), flight(COLUMNS, ROWS)
    data = [whole[:begun], *others, whole[begun:], END]
    log = read_log(save(tmp_path, PRODUCT, NUMBERS, fields(COLUMNS), *data))
    assert len(log) == 200 and not log.notes
    assert [(one.name, one.row) for one in log.events[:2]] == [("adjustment", 50)] * 2
    assert log.events[0].values == {"function": 5, "value": -3}
    assert log.events[1].values["float_bits"] == 0x3F800000
