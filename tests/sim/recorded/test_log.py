"""Recorded commands of blackbox logs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.control import sticks
from sim.recorded.files import load_commands, load_flight
from tests.sim.blackbox.writer import END, PRODUCT, Column, fields, flight, header, slow
from toolchain.errors import ScenarioError

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
    path = tmp_path / "fine.bbl"
    path.write_bytes(log(blackbox_high_resolution=1))
    assert np.abs(load_commands(path).setpoint - np.array(ROWS[10:], float)[:, :3] / 10).max() < 1e-4


def test_sticks_are_flown_and_told_when_a_log_has_no_setpoints(tmp_path: Path) -> None:
    path = tmp_path / "old.TXT"
    path.write_bytes(log(STICKS, [[*row[:3], 1000 + row[3]] for row in ROWS]))
    commands = load_commands(path)
    armed = np.array(ROWS[10:], float)
    assert np.abs(commands.setpoint - 2 * armed[:, :3]).max() < 1e-9
    assert np.abs(commands.throttle - armed[:, 3] / 1000).max() < 1e-9
    [words] = commands.warnings()
    assert (
        words == "old.TXT: no setpoint was logged: the sticks (rcCommand) are flown, 1000 deg/s at full stick"
    )


def test_a_log_is_chosen_by_its_number_when_the_file_holds_several(tmp_path: Path) -> None:
    path = tmp_path / "two.bbl"
    other = [[-value for value in row[:3]] + [0] for row in ROWS]
    path.write_bytes(log() + log(rows=other))
    first = load_commands(Path(f"{path}:1"))
    last = load_commands(path)
    assert first.warnings() == ()
    assert last.warnings() == ("two.bbl holds 2 logs: number 2 is flown; two.bbl:1 names one",)
    assert np.abs(first.setpoint + last.setpoint).max() < 1e-4
    with pytest.raises(ScenarioError, match="holds 2 logs"):
        load_commands(Path(f"{path}:3"))


def test_damage_is_told_and_the_rest_is_flown(tmp_path: Path) -> None:
    path = tmp_path / "damaged.bbl"
    whole = log()
    at = whole.index(b"I", len(whole) - 400) + 30
    path.write_bytes(whole[:at] + b"\xff" * 40 + whole[at + 40 :])
    commands = load_commands(path)
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
    with pytest.raises(ScenarioError) as error:
        load_commands(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
