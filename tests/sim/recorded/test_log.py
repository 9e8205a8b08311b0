"""Recorded commands of blackbox logs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.blackbox.flight import Part
from neuroflight.sim.control import sticks
from neuroflight.sim.recorded.files import load_commands, load_flight
from neuroflight.toolchain.errors import ScenarioError
from tests.sim.blackbox.writer import END, PRODUCT, Column, fields, flight, header, slow
from tests.sim.recorded.reading import commands_of, refused

BETAFLIGHT: dict[str, object] = {
    "Firmware revision": "Betaflight 4.6.0 (abc) SITL",
    "I interval": 32,
    "P interval": "1/1",
    "looptime": 250,
    "motorOutput": "48,2047",
    "blackbox_high_resolution": 0,
}
SETPOINTS = [Column(f"setpoint[{axis}]") for axis in range(4)]
STICKS = [Column(f"rcCommand[{axis}]") for axis in range(4)]
ROWS = np.column_stack(
    [np.arange(-200, 200, 4), np.arange(100)[::-1], np.arange(100) // 9 - 5, 10 * np.arange(100)]
).tolist()


def log(columns: list[Column] = SETPOINTS, rows: list[Any] = ROWS, **more: object) -> bytes:
    """A log that is armed from row 10 on."""
    head = PRODUCT + header({**BETAFLIGHT, **more}) + fields(columns, ["flightModeFlags"])
    before, after = flight(columns, rows[:32]), flight(columns, rows)
    armed = flight(columns, rows[:10])
    assert after.startswith(before) and before.startswith(armed)
    return head + slow([0]) + armed + slow([1]) + after[len(armed) :] + END


def test_the_armed_setpoints_of_a_log_are_flown(tmp_path: Path) -> None:
    path = tmp_path / "LOG00001.BFL"
    path.write_bytes(log())
    commands = load_commands(path)
    armed = np.array(ROWS[10:], float)
    assert np.abs(commands.setpoint - armed[:, :3]).max() < 1e-4
    assert np.abs(commands.throttle - armed[:, 3] / 1000).max() < 1e-6
    assert np.abs(commands.time - np.arange(90) / 1000).max() < 1e-9
    assert commands.warnings() == ()
    scenario, _ = load_flight(str(path), seed=1, count=1)
    flown = np.rad2deg(sticks.setpoint(scenario.timeline(1000)[0]))
    assert np.abs(flown - armed[:, :3]).max() < 1.001  # a microsecond of the stick is 2 deg/s


def test_tenths_are_read_when_the_log_has_them(tmp_path: Path) -> None:
    assert (
        np.abs(
            commands_of(tmp_path, log(blackbox_high_resolution=1), "fine.bbl").setpoint
            - np.array(ROWS[10:], float)[:, :3] / 10
        ).max()
        < 1e-4
    )


OLD: dict[str, object] = {
    "Firmware revision": "Betaflight 3.1.7 (e1c4b5c) BETAFLIGHTF3",
    "gyro_scale": "0x3f800000",
    "rates": "78,78,78",
    "rcRate": 105,
    "rcYawRate": 105,
    "rcExpo": 10,
    "rcYawExpo": 0,
}
STICK_ROWS = [[*row[:3], 1000 + row[3]] for row in ROWS]


def test_sticks_are_flown_by_the_rates_of_the_header_when_a_log_has_no_setpoints(tmp_path: Path) -> None:
    commands = commands_of(tmp_path, log(STICKS, STICK_ROWS, **OLD), "old.TXT")
    x = np.array(ROWS[10:], float)[:, :3] / 500
    expo = np.array([0.1, 0.1, 0.0])
    expected = 200 * 1.05 * x * (1 - expo + expo * np.abs(x) ** 3) / (1 - 0.78 * np.abs(x))
    assert np.abs(commands.setpoint - expected).max() < 1e-9
    assert np.abs(commands.throttle - np.array(ROWS[10:], float)[:, 3] / 1000).max() < 1e-9
    [words] = commands.warnings()
    assert words.startswith(
        "old.TXT: no setpoint was logged: rcCommand is flown by Betaflight rates of the header"
    )
    assert words.endswith("not held against the gyro: no row of it is a flight by rates with a gyro")


def test_rates_are_asked_for_when_a_header_does_not_tell_them(tmp_path: Path) -> None:
    path = tmp_path / "old.TXT"
    path.write_bytes(log(STICKS, STICK_ROWS))
    assert "no setpoint[0..3], and the header has no line rc_rates: tell" in refused(path)
    told = {"rates_type": "1", "rc_rates": "50,50,50", "rc_expo": "0,0,0", "rates": "0,0,0"}
    commands = load_commands(path, told=told)
    assert commands.setpoint == pytest.approx(np.array(ROWS[10:], float)[:, :3])


GYRO = [*STICKS, *(Column(f"gyroADC[{axis}]") for axis in range(3))]


@pytest.mark.parametrize("factor", [1.0, 0.3])
def test_rates_are_held_against_the_gyro_of_the_flight(factor: float, tmp_path: Path) -> None:
    path = tmp_path / "old.bfl"
    strokes = np.rint(300 * np.sin(np.arange(1000)[:, None] / np.array([40, 55, 70])))
    x = strokes / 500
    expo = np.array([0.1, 0.1, 0.0])
    rates = 210 * x * (1 - expo + expo * np.abs(x) ** 3) / (1 - 0.78 * np.abs(x))
    gyro = np.rint(factor * np.vstack([np.zeros((20, 3)), rates[:-20]]))
    rows = np.column_stack([strokes, np.full(1000, 1400), gyro]).astype(int).tolist()
    path.write_bytes(log(GYRO, rows, **OLD))
    if factor == 1.0:
        commands = load_commands(path)
        assert np.abs(commands.setpoint - rates[10:]).max() < 1e-9
        assert commands.warnings() == (
            "old.bfl: no setpoint was logged: rcCommand is flown by Betaflight rates of the header",
        )
        return
    words = "the gyro does not follow the sticks by Betaflight rates: on roll, pitch, yaw it turns 0.3"
    with pytest.raises(ScenarioError, match=words):
        load_commands(path)
    # The user's word counts, and is told to be odd.
    commands = load_commands(path, told={"rates_type": "0"})
    assert np.abs(commands.setpoint - rates[10:]).max() < 1e-9
    assert words in commands.warnings()[0]


@pytest.mark.parametrize("mode", [2, 4])
def test_sticks_that_command_an_angle_are_not_flown(mode: int, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="the stick commands an angle"):
        commands_of(
            tmp_path, log(STICKS, STICK_ROWS, **OLD).replace(b"S\x01", bytes((0x53, 1 | mode))), "angle.bfl"
        )


def test_a_mode_that_made_the_setpoints_is_told(tmp_path: Path) -> None:
    commands = commands_of(tmp_path, log().replace(b"S\x01", b"S\x03"), "angle.bfl")
    assert len(commands.time) == 90
    [words] = commands.warnings()
    assert words == "angle.bfl: in 100 % of the rows ANGLE or HORIZON mode made the rates, not the stick"


def test_a_log_is_not_flown_when_a_value_is_no_stick(tmp_path: Path) -> None:
    path = tmp_path / "wrapped.bfl"
    rows = [[*row[:3], row[3] if at < 60 else 2_000_000_000] for at, row in enumerate(ROWS)]
    path.write_bytes(log(rows=rows))
    assert "log 1: in row 60 (0.050 s) and 39 more the throttle is 2e+06, expected 0 to 1" in refused(path)
    assert len(load_commands(path, Part(0.0, 0.05)).time) == 50
    rows = [[1500 if at == 80 else row[0], *row[1:]] for at, row in enumerate(ROWS)]
    path.write_bytes(log(rows=rows))
    words = "in row 80 (0.070 s) roll is asked to turn at 1500 deg/s, expected at most 1000; leave"
    assert words in refused(path)


def test_a_log_is_chosen_by_its_number_when_the_file_holds_several(tmp_path: Path) -> None:
    path = tmp_path / "two.bbl"
    other = [[-value for value in row[:3]] + [0] for row in ROWS]
    path.write_bytes(log() + log(rows=other))
    first = load_commands(Path(f"{path}:1"))
    last = load_commands(path)
    assert first.warnings() == ()
    assert last.warnings() == ("two.bbl holds 2 logs: number 2 is flown; two.bbl:1 names one",)
    assert np.abs(first.setpoint + last.setpoint).max() < 1e-4
    assert "holds 2 logs" in refused(Path(f"{path}:3"))


def test_damage_is_told_and_the_rest_is_flown(tmp_path: Path) -> None:
    whole = log()
    at = whole.index(b"I", len(whole) - 400) + 30
    commands = commands_of(tmp_path, whole[:at] + b"\xff" * 40 + whole[at + 40 :], "damaged.bbl")
    assert len(commands.time) >= 40
    assert any("damaged" in words for words in commands.warnings())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty; expected a Betaflight blackbox log"),
        (b"nothing of the kind", "holds no log"),
        (log([Column("motor[0]")], [[1]] * 50), "log 1 has neither setpoint nor rcCommand"),
        (log().replace(b"S\x01", b"S\x00"), "log 1 has no armed row: nothing was commanded"),
        (log()[:600], "log 1"),
    ],
)
def test_a_log_that_cannot_be_flown_is_rejected_in_one_line(
    content: bytes, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "bad.bbl"
    path.write_bytes(content)
    assert message in refused(path)


def wild(rng: np.random.Generator) -> tuple[bytes, int | None, str]:
    """Write a log with some impossible values; return it, its first wrong armed row, and the error's word."""
    rows = int(rng.integers(40, 90))
    rates, power = rng.integers(-900, 901, (rows, 3)), rng.integers(0, 1001, rows)
    bad = rng.random(rows) < 0.03
    fast = bad & (rng.random(rows) < 0.4)
    far = rng.integers(1400, 1 << 30, rows) * rng.choice([-1, 1], rows)
    rates[fast, 1], power[bad & ~fast] = far[fast], far[bad & ~fast]
    kind = int(rng.integers(3))
    if kind == 0:
        columns, lines, values = SETPOINTS, BETAFLIGHT, np.column_stack([rates, power])
    elif kind == 1:  # INAV: targets, and the throttle of the stick
        columns = [*(Column(f"axisRate[{axis}]") for axis in range(3)), Column("rcCommand[3]")]
        lines = {"Firmware revision": "INAV 7.1.2 (a) X", "minthrottle": 1000, "maxthrottle": 2000}
        values = np.column_stack([rates, 1000 + power])
    else:  # sticks: their rates end at 955 deg/s, so that only the throttle can be none
        columns, lines = STICKS, OLD
        values = np.column_stack([np.clip(rates, -500, 500), 1000 + power])
        fast, bad = np.zeros(rows, bool), (power < 0) | (power > 1000)
    first = fast[10:] if fast[10:].any() else bad[10:]
    row = 10 + int(first.argmax()) if first.any() else None
    return log(columns, values.tolist(), **lines), row, "turn at" if fast[10:].any() else "the throttle is"


@pytest.mark.parametrize("count", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_no_log_is_flown_from_a_value_that_is_no_stick(count: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(20260928)
    path = tmp_path / "LOG00001.BFL"
    wrong = 0
    for _ in range(count):
        data, row, word = wild(rng)
        path.write_bytes(data)
        if row is None:
            scenario, _ = load_flight(str(path), seed=1, count=1)
            assert max(abs(rate) for one in scenario.segments for rate in one.setpoint_deg_s) <= 1000
            continue
        wrong += 1
        error = refused(path)
        assert f"in row {row} ({(row - 10) / 1000:.3f} s)" in error and word in error
    assert count / 4 < wrong < count
