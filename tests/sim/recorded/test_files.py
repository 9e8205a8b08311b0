"""Recorded commands from tables and archives: what they hold, and the errors of invalid ones."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.control import sticks
from sim.recorded.files import load_commands, load_flight
from toolchain.contract import CHANNEL_THROTTLE
from toolchain.errors import ScenarioError

# As the Blackbox Explorer exports a log: settings, then the heading, then rows; time in microseconds.
EXPLORER = """"Product","Blackbox flight data recorder by Nicholas Sherlock"
"looptime","125"
"loopIteration","time","rcCommand[0]","rcCommand[1]","rcCommand[2]","rcCommand[3]","setpoint[0]","setpoint[1]",\
"setpoint[2]","setpoint[3]","gyroADC[0]"
0,5000000,1,2,3,1000,10,-20,30,0,7
4,5004000,1,2,3,1250,11,-20,30,250,7
8,5008000,1,2,3,1500,12,-20,30,500,7
"""
# As blackbox_decode writes one: a blank before each name, units in parentheses, words of the slow frames.
DECODED = """loopIteration, time (us), rcCommand[0], rcCommand[1], rcCommand[2], rcCommand[3], setpoint[0], \
setpoint[1], setpoint[2], setpoint[3], flightModeFlags (flags)
0, 5000000, 1, 2, 3, 1000, 10, -20, 30, 0, ARM|ANGLE
4, 5004000, 1, 2, 3, 1250, 11, -20, 30, 250, ARM
8, 5008000, 1, 2, 3, 1500, 12, -20, 30, 500, ARM
"""


@pytest.mark.parametrize("text", [EXPLORER, DECODED])
def test_a_betaflight_table_has_its_setpoints_and_throttle_when_read(text: str, tmp_path: Path) -> None:
    path = tmp_path / "flight.CSV"
    path.write_text(text)
    commands = load_commands(path)
    assert commands.time.tolist() == pytest.approx([5.0, 5.004, 5.008])
    # Nose down and yaw left are positive in Betaflight's logs as here.
    assert commands.setpoint.tolist() == [[10, -20, 30], [11, -20, 30], [12, -20, 30]]
    assert commands.throttle.tolist() == [0.0, 0.25, 0.5]
    assert commands.length_s == pytest.approx(0.012)
    assert commands.warnings() == ()


def test_tenths_are_read_when_the_settings_before_the_table_say_so(tmp_path: Path) -> None:
    path = tmp_path / "fine.csv"
    path.write_text(EXPLORER.replace('"looptime","125"', '"blackbox_high_resolution","1"'))
    commands = load_commands(path)
    assert np.abs(commands.setpoint - [[1, -2, 3], [1.1, -2, 3], [1.2, -2, 3]]).max() < 1e-12
    assert commands.throttle.tolist() == [0.0, 0.25, 0.5]


def test_sticks_are_flown_and_told_when_a_table_has_no_setpoints(tmp_path: Path) -> None:
    path = tmp_path / "sticks.csv"
    path.write_text("time,rcCommand[0],rcCommand[1],rcCommand[2]\n0,500,-250,0\n4000,0,0,100\n")
    commands = load_commands(path)
    assert commands.setpoint.tolist() == [[1000, -500, 0], [0, 0, 200]]
    assert commands.throttle.tolist() == [0, 0]
    [words] = commands.warnings()
    assert "no column setpoint[0]: the sticks (rcCommand) are flown, 1000 deg/s at full stick" in words


@pytest.mark.parametrize(("name", "unit"), [("setpoint", np.pi / 180), ("setpoint_deg_s", 1.0)])
def test_an_archive_has_its_setpoints_in_its_unit_when_read(name: str, unit: float, tmp_path: Path) -> None:
    path = tmp_path / "flight.npz"
    rates = np.array([[0.0, 0, 0], [100, -50, 20]])
    arrays: dict[str, Any] = {name: rates * unit}
    np.savez(path, t=[0.0, 0.5], throttle=[0.0, 0.3], other=np.zeros(7), **arrays)
    commands = load_commands(path)
    assert np.abs(commands.setpoint - rates).max() < 1e-12
    assert commands.throttle.tolist() == [0.0, 0.3]


def test_commands_hold_until_the_next_when_flown_at_another_rate(tmp_path: Path) -> None:
    path = tmp_path / "steps.csv"
    path.write_text(
        "t_s,roll_deg_s,pitch_deg_s,yaw_deg_s,throttle\n3.000,10,0,0,0\n3.010,20,0,0,0.5\n3.020,20,0,-40,0.5\n"
    )
    scenario, words = load_flight(str(path), seed=1, count=1)
    assert words == ()
    channels, heard = scenario.timeline(500)
    assert heard.all()
    rates = np.rad2deg(sticks.setpoint(channels))
    assert np.rint(rates).tolist() == [[10, 0, 0]] * 5 + [[20, 0, 0]] * 5 + [[20, 0, -40]] * 5
    assert channels[:, CHANNEL_THROTTLE].tolist() == [1000] * 5 + [1500] * 10


def test_commands_beyond_full_stick_are_told_and_flown_as_full_stick(tmp_path: Path) -> None:
    path = tmp_path / "fast.csv"
    path.write_text(
        "time (us),setpoint[0],setpoint[1],setpoint[2],setpoint[3]\n0,1210,0,0,0\n4000,0,0,-1000,1003"
    )
    scenario, [beyond, throttle] = load_flight(str(path), seed=1, count=1)
    assert "fast: 1 of 2 commands ask for more than full stick (1210 deg/s, full stick is 1000)" in beyond
    assert "fast: 1 of 2 throttles are outside 0 to 1" in throttle
    rates = np.rad2deg(sticks.setpoint(scenario.timeline(1000)[0]))
    assert np.rint(rates).tolist() == [[1000, 0, 0]] * 4 + [[0, 0, -1000]] * 4


def archive(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, allow_pickle=True, **arrays)
    return file.getvalue()


def lone(name: str, content: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as out:
        out.writestr(name, content)
    return file.getvalue()


def npy() -> bytes:
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    return file.getvalue()


RATES = np.zeros((2, 3))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"a,b\n1,2\n", "no heading line with known columns ('a, b'); expected t_s, roll_deg_s"),
        ("a.csv", EXPLORER.replace("1250,11", "1250,eleven").encode(), "line 5: setpoint[0] is 'eleven'"),
        ("a.csv", EXPLORER.replace("5008000", "5003000").encode(), "5.003 s after 5.004 s, expected it"),
        ("a.csv", EXPLORER.replace("5008000", "1e13").encode(), "s of commands, expected at most 3600"),
        ("a.npz", b"no archive", "damaged or no .npz file"),
        ("a.npz", npy(), "damaged or no .npz file"),
        ("a.npz", archive(t=[0.0, 1.0])[:-40], "damaged or no .npz file"),
        ("a.npz", lone("t.npy", b""), "arrays t; expected t [s] and setpoint [rad/s]"),
        ("a.npz", archive(t=[0.0, 1.0], setpoint=np.array([None, 1])), "damaged or no .npz file"),
        ("a.npz", archive(t=[0.0, 1.0], setpoint=np.array(["a", "b"])), "setpoint is <U1 (2,), expected"),
        ("a.npz", archive(t=[0.0, 1.0, 2.0], setpoint=RATES), "setpoint has shape (2, 3), expected (3, 3)"),
        ("a.npz", archive(t=[0.0, 1.0], setpoint=RATES, throttle=RATES), "throttle has shape (2, 3)"),
        ("a.npz", archive(t=[0.0, 1.0], setpoint=RATES * np.nan), "setpoint has a value that is no number"),
        ("a.npz", archive(t=[0.0], setpoint=RATES[:1]), "1 rows of commands, expected 2 to"),
    ],
)  # fmt: skip
def test_an_invalid_recording_is_rejected_in_one_line(
    name: str, content: bytes, message: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ScenarioError) as error:
        load_commands(tmp_path / name)
    assert message in str(error.value)
    assert str(error.value).startswith(f"recording {tmp_path / name}: ")
    assert "\n" not in str(error.value)
