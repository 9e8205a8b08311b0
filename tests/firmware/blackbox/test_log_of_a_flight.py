"""The log of a flight on the library holds what the firmware was given and gave."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.sim.blackbox.decoding import decode
from neuroflight.sim.blackbox.export import save_csv
from neuroflight.sim.blackbox.log import Log, floats, list_logs, read_log
from neuroflight.sim.ports.library import Reference
from neuroflight.toolchain.contract import (
    CHANNEL_ARM,
    CHANNEL_COUNT,
    CHANNEL_THROTTLE,
    GYRO_BAD_MS,
    LOG_FIELDS_MAX,
    FlightState,
    LogEvent,
    LogGroup,
    StopCause,
)
from tests.firmware.blackbox.flights import ARMED_S, Flown, fly
from tests.firmware.blackbox.test_layout import POINTERS, layout
from tests.firmware.conftest import Core
from tests.sampling import sampled

orangebox = pytest.importorskip("orangebox")
GROUPS = {
    LogGroup.PID: "axisError[0]",
    LogGroup.COMMANDS: "rcCommand[0]",
    LogGroup.SETPOINT: "setpoint[0]",
    LogGroup.BATTERY: "vbatLatest",
    LogGroup.RSSI: "rssi",
    LogGroup.GYRO: "gyroADC[0]",
    LogGroup.ATTITUDE: "imuQuaternion[0]",
    LogGroup.ACC: "accSmooth[0]",
    LogGroup.DEBUG: "debug[0]",
    LogGroup.MOTOR: "motor[0]",
    LogGroup.GYRO_UNFILTERED: "gyroUnfilt[0]",
    LogGroup.EXACT: "gyroFloat[0]",
    LogGroup.REPLAY: "gyroRaw[0]",
    LogGroup.TIMING: "controlTime",
}


@pytest.fixture(scope="module")
def flown(reference_library: Path) -> Flown:
    """A flight of half a second."""
    return fly(reference_library)


def matrix(log: Log, name: str) -> NDArray[np.int64]:
    """All fields of an array, which the log has."""
    found = log.matrix(name)
    assert found is not None
    return found


def held(log: Log, name: str) -> NDArray[np.int64]:
    """A field of slow frames at each row."""
    found = log.held(name)
    assert found is not None
    return np.asarray(found)


def assert_the_same(flown: Flown, log: Log) -> None:
    """Every decoded value is the flight's."""
    rows = flown.rows(log)
    assert matrix(log, "motor").tolist() == flown.dshot[rows].tolist()
    assert (floats(matrix(log, "gyroFloat")) == flown.gyro[rows]).all()
    setpoint = floats(matrix(log, "setpointFloat"))
    assert (setpoint[:, :3] == flown.setpoint[rows]).all() and (setpoint[:, 3] == flown.throttle[rows]).all()
    raw = matrix(log, "gyroRaw")
    assert (raw == flown.counts[rows].reshape(len(rows), -1)).all()
    assert np.array_equal(matrix(log, "accRaw"), flown.forces[rows])
    degrees = np.degrees(flown.gyro[rows].astype(float))
    assert np.abs(matrix(log, "gyroADC") - degrees).max() <= 0.501


def test_logs_of_equal_flights_are_equal_bytes_and_hold_no_pointer(
    flown: Flown, reference_library: Path, tmp_path: Path
) -> None:
    """Of two firmwares in one process, whose memory lies elsewhere; other processes: tests/cli."""
    assert fly(reference_library).data == flown.data
    header = flown.log(tmp_path).header
    state = bytes.fromhex("".join(header[name] for name in sorted(header) if re.match(r"nf_state_\d", name)))
    assert int(header["nf_state_crc"], 16) == zlib.crc32(state)
    places = {path: at for path, at in layout(reference_library, "firmware").items() if "pointer" in path}
    assert len(places) == POINTERS and len(state) == layout(reference_library, "firmware")["whole"][1]
    assert {path: state[at : at + size].hex() for path, (at, size) in places.items()} == dict.fromkeys(
        places, "00" * 8
    )


def after_uptime(core: Core, samples: int) -> Callable[[Reference], None]:
    """Makes a firmware that has been on for so many gyro samples already, and has done nothing else."""

    def prepare(board: Reference) -> None:
        firmware = core.ffi.cast("struct firmware *", core.ffi.from_buffer(board._memory))
        assert firmware.samples == firmware.control_steps == 0, "struct reference begins with it"
        firmware.samples = firmware.window = samples

    return prepare


def test_no_frame_is_lost_and_the_time_goes_on_when_its_32_bits_of_us_begin_anew(
    reference_library: Path, reference_core: Core, tmp_path: Path
) -> None:
    """After 71.6 minutes, 0.25 s behind arming."""
    gyro_hz, word = 4000, 1 << 32
    uptime_us = (word // 1000 - round(1000 * (ARMED_S + 0.25))) * 1000
    flown = fly(reference_library, prepared=after_uptime(reference_core, uptime_us * gyro_hz // 1_000_000))
    log = flown.log(tmp_path)
    assert log.lost == 0 and not log.notes and log.ended
    assert log.frames.unusable == log.frames.corrupt == 0
    rows = flown.rows(log)
    assert_the_same(flown, log)
    time = uptime_us + 1000 * flown.step[rows]
    assert time[0] < word < time[-1]
    assert log.columns["loopIteration"][np.argmax(time > word)] % 32, "an I frame tells the whole 32 bits"
    assert np.array_equal(log.columns["time"], time)
    assert np.array_equal(log.time_us, time)
    (arming,) = (event for event in log.events if event.kind == LogEvent.SYNC_BEEP)
    assert arming.values["time"] == time[arming.row]
    save_csv(tmp_path / "flight.csv", log)
    table = np.genfromtxt(tmp_path / "flight.csv", delimiter=",", names=True, usecols=(0, 1))
    assert np.array_equal(table["time_us"], time)


def test_every_value_is_the_flights_when_its_log_is_read(flown: Flown, tmp_path: Path) -> None:
    log = flown.log(tmp_path)
    assert_the_same(flown, log)
    assert log.ended and log.lost == 0 and not log.notes
    assert np.array_equal(log.columns["time"], 1000 * flown.step[flown.rows(log)]), "us since boot"
    armed = held(log, "flightModeFlags") & 1
    assert len(armed) > 700 and 480 < armed.sum() < 520
    assert armed[0] == 0 and armed[-150:].sum() == 0  # it leads up to arming, and goes on behind it
    assert [event.kind for event in log.events] == [
        *(LogEvent.SYNC_BEEP, LogEvent.FLIGHT_MODE, LogEvent.FLIGHT_MODE, LogEvent.DISARM, LogEvent.LOG_END),
    ]


def test_no_flag_of_ours_is_a_mode_to_programs_of_others(flown: Flown, tmp_path: Path) -> None:
    log = flown.log(tmp_path)
    (one,) = list_logs(log.path)
    events = decode(flown.data[one.extent.body : one.extent.end], one.headers).events
    modes = [
        (event.values["old"], event.values["new"]) for event in events if event.kind == LogEvent.FLIGHT_MODE
    ]
    assert modes == [(0, 1), (1, 0)], "armed and disarmed"
    assert one.headers.values["Firmware revision"].startswith("Betaflight 2025.12.0 (Neuroflight) ")
    assert one.headers.values["Firmware API version"] == "1.47.0", "as the app's Autotune reads it"
    state = [event.values["new"] >> 17 & 7 for event in log.events if event.kind == LogEvent.FLIGHT_MODE]
    assert state == [FlightState.ARMED, FlightState.DISARMED]
    assert log.events[-3].values["new"] >> 20 & 15 == StopCause.SWITCH


def test_orangebox_finds_no_invalid_frame_when_it_reads_a_log(flown: Flown, tmp_path: Path) -> None:
    path = tmp_path / "flight.bbl"
    path.write_bytes(flown.data)
    parser = orangebox.Parser.load(str(path))
    names, frames = parser.field_names, [frame.data for frame in parser.frames()]
    column = dict(zip(names, zip(*frames, strict=True), strict=True))
    rows = np.array(column["loopIteration"]) + parser.headers["nf_first_step"] - flown.step[0]
    assert list(column["motor[0]"]) == flown.dshot[rows, 0].tolist()
    assert len(rows) == rows[-1] - rows[0] + 1 > 700
    assert max(len(frame) for frame in frames) <= LOG_FIELDS_MAX
    known = {event.name for event in orangebox.types.EventType}
    assert parser._ctx.invalid_frame_count == 0 or "DISARM" not in known  # 0.4.0 knows no DISARM


@pytest.mark.parametrize("rate", [1000, 2000, 8000])
def test_a_log_holds_all_samples_when_the_gyro_has_another_rate(
    reference_library: Path, tmp_path: Path, rate: int
) -> None:
    flown = fly(reference_library, 0.2, gyro_hz=rate)
    log = flown.log(tmp_path)
    rows = flown.rows(log)
    assert np.array_equal(matrix(log, "gyroRaw"), flown.counts[rows].reshape(len(rows), -1))
    assert (log.columns["sampleFlags"] >> 16 == rate // 1000).all()
    assert log.lost == 0


def test_frames_are_the_dividers_when_it_is_set(reference_library: Path, tmp_path: Path) -> None:
    flown = fly(reference_library, 0.2, {"blackbox_divider": 8})
    log = flown.log(tmp_path)
    assert (np.diff(log.columns["loopIteration"]) == 8).all() and log.lost == 0
    assert np.array_equal(matrix(log, "motor"), flown.dshot[flown.rows(log)])


@pytest.mark.parametrize(
    "left_out",
    sampled(
        [*([group] for group in GROUPS), [*GROUPS], [LogGroup.TIMING, LogGroup.REPLAY]],
        *([group] for group in list(GROUPS)[::5]),
        [*GROUPS],
    ),
)
def test_a_group_is_missing_when_it_is_masked(
    reference_library: Path, tmp_path: Path, left_out: list[LogGroup]
) -> None:
    mask = sum(1 << group for group in left_out)
    flown = fly(reference_library, 0.02, {"blackbox_disabled_mask": mask})
    log = flown.log(tmp_path)
    there = {group for group, name in GROUPS.items() if name in log.columns}
    assert there == set(GROUPS) - set(left_out)
    assert (np.diff(log.columns["loopIteration"]) == 1).all() and not log.notes
    if LogGroup.MOTOR in there:
        assert np.array_equal(matrix(log, "motor"), flown.dshot[flown.rows(log)])


def test_drops_are_told_when_the_device_takes_nothing_for_a_while(
    reference_library: Path, tmp_path: Path
) -> None:
    stalls = range(int(4.7 * 4000), int(6.2 * 4000))  # more than memory and ring hold
    flown = fly(reference_library, 2.0, drained=lambda sample: sample not in stalls)
    log = flown.log(tmp_path)
    assert_the_same(flown, log)
    gaps = np.diff(log.columns["loopIteration"]) - 1
    assert gaps.sum() > 100
    assert held(log, "dropped")[-1] == gaps.sum()
    assert sum(event.kind == LogEvent.LOGGING_RESUME for event in log.events) == (gaps > 0).sum()
    assert log.ended


def test_a_damaged_log_goes_on_with_the_next_intra_frame(flown: Flown, tmp_path: Path) -> None:
    at = len(flown.data) // 2
    hurt = Flown(flown.data[:at] + b"\xff" * 9 + flown.data[at + 9 :], *list(vars(flown).values())[1:])
    log = hurt.log(tmp_path)
    whole = len(flown.log(tmp_path).columns["time"])
    assert whole - 40 < len(log.columns["time"]) < whole


@pytest.mark.slow
def test_a_minute_of_flight_is_read_as_it_was(reference_library: Path, tmp_path: Path) -> None:
    flown = fly(reference_library, 60.0)
    log = flown.log(tmp_path)
    assert_the_same(flown, log)
    assert log.lost == 0 and len(log.columns["time"]) > 60_000


def test_a_log_tells_why_it_ends_when_the_gyro_says_nothing_any_more(
    reference_library: Path, tmp_path: Path
) -> None:
    board = Reference(reference_library, 4000, {"gyro_stuck_ms": 0})
    data = [board.blackbox()]
    rng = np.random.default_rng(3)
    for index in range(int(5.0 * 4000)):
        if index % 40 == 0:
            sticks = [1500] * 4 + [1000] * (CHANNEL_COUNT - 4)
            sticks[CHANNEL_THROTTLE], sticks[CHANNEL_ARM] = 1000, 2000 if index > ARMED_S * 4000 else 1000
            board.receiver(sticks)
        board.sample(rng.normal(size=3) * 0.01, np.array([0.0, 0.0, 9.80665]))
        data.append(board.blackbox())
    assert board.trace().armed
    for _ in range(600 // GYRO_BAD_MS):
        board.silent()
        data.append(board.blackbox())
    path = tmp_path / "silent.bbl"
    path.write_bytes(b"".join(data))
    log = read_log(path)
    assert log.ended and log.lost == 0 and held(log, "flightModeFlags")[-1] & 1, "its last step was armed"
    told, disarmed, _ = log.events[-3:]
    assert [event.kind for event in log.events[-3:]] == [
        *(LogEvent.FLIGHT_MODE, LogEvent.DISARM, LogEvent.LOG_END),
    ]
    new, old = told.values["new"], told.values["old"]
    assert (
        old & 1
        and not new & 1
        and new >> 17 & 7 == FlightState.FAULT
        and new >> 20 & 15 == StopCause.GYRO_SILENT
    )
    assert disarmed.values["reason"] == 0, "the ecosystem has no number for a gyro"
