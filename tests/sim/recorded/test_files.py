"""Recorded commands from tables and archives: what they hold, and the errors of invalid ones."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.blackbox.flight import Part
from neuroflight.sim.control import sticks
from neuroflight.sim.recorded.files import load_commands, load_flight
from neuroflight.toolchain.contract import CHANNEL_THROTTLE
from neuroflight.toolchain.errors import ScenarioError
from tests.sampling import examples
from tests.sim.recorded.reading import commands_of, refused

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
    commands = commands_of(tmp_path, text, "flight.CSV")
    assert commands.time.tolist() == pytest.approx([5.0, 5.004, 5.008])
    # Nose down and yaw left are positive in Betaflight's logs as here.
    assert commands.setpoint.tolist() == [[10, -20, 30], [11, -20, 30], [12, -20, 30]]
    assert commands.throttle.tolist() == [0.0, 0.25, 0.5]
    assert commands.length_s == pytest.approx(0.012)
    told = commands.warnings()
    assert [("no header of the log" in each) for each in told] == ([True] if text is DECODED else [])


def test_tenths_are_read_when_the_settings_before_the_table_say_so(tmp_path: Path) -> None:
    commands = commands_of(
        tmp_path, EXPLORER.replace('"looptime","125"', '"blackbox_high_resolution","1"'), "fine.csv"
    )
    assert np.abs(commands.setpoint - [[1, -2, 3], [1.1, -2, 3], [1.2, -2, 3]]).max() < 1e-12
    assert commands.throttle.tolist() == [0.0, 0.25, 0.5]


STICKS = "time,rcCommand[0],rcCommand[1],rcCommand[2]\n0,500,-250,0\n4000,0,0,100\n"
RATES = '"Firmware revision","Betaflight 4.3.0 (a) X"\n"rates_type","1"\n"rc_rates","70,60,50"\n'
RATES += '"rc_expo","0,0,0"\n"rates","0,0,0"\n'


def test_sticks_are_flown_by_the_rates_of_the_settings_when_a_table_has_no_setpoints(tmp_path: Path) -> None:
    commands = commands_of(tmp_path, RATES + STICKS, "sticks.csv")
    assert commands.setpoint == pytest.approx(np.array([[700.0, -300, 0], [0, 0, 100]]))
    assert commands.throttle.tolist() == [0, 0]
    [words] = commands.warnings()
    assert "no column setpoint[0]: rcCommand is flown by Raceflight rates, not held against the gyro" in words


def test_rates_of_a_table_are_asked_for_and_taken_when_it_has_none(tmp_path: Path) -> None:
    path = tmp_path / "sticks.csv"
    path.write_text(STICKS)
    error = refused(path)
    assert "no column setpoint[0], and the header has no line rc_rates: tell the rates" in error
    assert "--header NAME=VALUE" in error
    told = {"rates_type": "1", "rc_rates": "70,60,50", "rc_expo": "0,0,0", "rates": "0,0,0"}
    commands = load_commands(path, told=told)
    assert commands.setpoint == pytest.approx(np.array([[700.0, -300, 0], [0, 0, 100]]))


@pytest.mark.parametrize("modes", ["ARM|ANGLE", "HORIZON", "3"])
def test_sticks_that_command_an_angle_are_not_flown(modes: str, tmp_path: Path) -> None:
    first, *rows = STICKS.split()
    text = RATES + f"{first},flightModeFlags (flags)\n{rows[0]},{modes}\n{rows[1]},ARM\n"
    with pytest.raises(ScenarioError, match=r"row 0 \(0\.000 s\) and 0 more command an angle"):
        commands_of(tmp_path, text)


def test_rates_of_inavs_table_are_its_targets(tmp_path: Path) -> None:
    names = "time (us),axisRate[0],axisRate[1],axisRate[2],rcCommand[0],rcCommand[1],rcCommand[2]\n"
    commands = commands_of(tmp_path, names + "0,350,0,0,250,0,0\n1000,350,-20,0,250,0,0\n")
    assert commands.setpoint.tolist() == [[350, 0, 0], [350, -20, 0]]


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


def test_a_stick_a_little_beyond_its_end_is_at_its_end(tmp_path: Path) -> None:
    path = tmp_path / "ends.csv"
    path.write_text(
        "time (us),setpoint[0],setpoint[1],setpoint[2],setpoint[3]\n0,1000.4,0,0,-4\n4000,0,0,-1000,1003"
    )
    scenario, words = load_flight(str(path), seed=1, count=1, told={"blackbox_high_resolution": "0"})
    assert not words
    channels, _ = scenario.timeline(1000)
    assert np.rint(np.rad2deg(sticks.setpoint(channels))).tolist() == [[1000, 0, 0]] * 4 + [[0, 0, -1000]] * 4
    assert channels[:, CHANNEL_THROTTLE].tolist() == [1000] * 4 + [2000] * 4


def test_nothing_is_flown_from_a_value_that_is_no_stick(tmp_path: Path) -> None:
    """Judge each row of many tables and archives here; the error has to name the first wrong one."""
    rng, count, bad_ones = np.random.default_rng(11), examples(1000), 0
    for number in range(count):
        rows = int(rng.integers(3, 12))
        rates, throttle = rng.uniform(-1000, 1000, (rows, 3)), rng.uniform(-0.1, 1.1, rows)
        wild = rng.random(rows) < 0.1
        far = 10.0 ** rng.uniform(0.15, 9, rows) * rng.choice([-1, 1], rows)
        throttle = np.where(wild & (rng.random(rows) < 0.5), far, throttle)
        rates[wild & (rng.random(rows) < 0.5), int(rng.integers(3))] = 1000 * far[int(rng.integers(rows))]
        name = f"{number}.npz" if number % 2 else f"{number}.csv"
        if number % 2:
            np.savez(tmp_path / name, t=np.arange(rows) / 100, setpoint_deg_s=rates, throttle=throttle)
        else:
            table = np.column_stack([np.arange(rows) / 100, rates, throttle])
            heading = "t_s,roll_deg_s,pitch_deg_s,yaw_deg_s,throttle"
            np.savetxt(tmp_path / name, table, delimiter=",", header=heading, comments="", fmt="%.17g")
        fast = (np.abs(rates) > 1000.51).any(axis=1)
        bad = fast if fast.any() else (throttle < -0.115) | (throttle > 1.115)
        if bad.any():
            bad_ones += 1
            row, error = int(bad.argmax()), refused(tmp_path / name)
            assert f"in row {row} ({row / 100:.3f} s)" in error
            assert ("turn at" if fast.any() else "the throttle is") in error
            continue
        commands = load_commands(tmp_path / name)
        assert commands.setpoint == pytest.approx(rates)
        assert commands.throttle == pytest.approx(throttle.clip(0, 1))
    assert 0.3 * count < bad_ones < 0.7 * count


def test_a_part_is_flown_around_what_is_no_stick(tmp_path: Path) -> None:
    path = tmp_path / "wild.csv"
    rows = [f"{row / 100},{row},0,0,{4294967 if row == 40 else 0.5}" for row in range(100)]
    path.write_text("\n".join(["t_s,roll_deg_s,pitch_deg_s,yaw_deg_s,throttle", *rows]))
    words = r"in row 40 \(0\.400 s\) the throttle is 4\.29497e\+06, expected 0 to 1; leave them out by --from"
    with pytest.raises(ScenarioError, match=words):
        load_commands(path)
    before, after = load_commands(path, Part(0.0, 0.4)), load_commands(path, Part(0.41))
    assert before.setpoint[:, 0].tolist() == list(range(40))
    assert after.setpoint[:, 0].tolist() == list(range(41, 100)) and after.first_row == 41
    with pytest.raises(ScenarioError, match="has no row from 2 s to its end"):
        load_commands(path, Part(2.0))


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


STILL = np.zeros((2, 3))


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
        ("a.npz", archive(t=[0.0, 1.0, 2.0], setpoint=STILL), "setpoint has shape (2, 3), expected (3, 3)"),
        ("a.npz", archive(t=[0.0, 1.0], setpoint=STILL, throttle=STILL), "throttle has shape (2, 3)"),
        ("a.npz", archive(t=[0.0, 1.0], setpoint=STILL * np.nan), "setpoint has a value that is no number"),
        ("a.npz", archive(t=[0.0], setpoint=STILL[:1]), "1 rows of commands, expected 2 to"),
    ],
)  # fmt: skip
def test_an_invalid_recording_is_rejected_in_one_line(
    name: str, content: bytes, message: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    error = refused(tmp_path / name)
    assert message in error and error.startswith(f"recording {tmp_path / name}: ")


def test_the_header_beside_a_table_tells_tenths_and_the_throttles_range(tmp_path: Path) -> None:
    """`log decode --csv` writes it; without it, whole deg/s are taken and told."""
    path = tmp_path / "a.csv"
    path.write_text(
        "time (us),setpoint[0],setpoint[1],setpoint[2],rcCommand[3]\n0,1000,0,0,1100\n1000,-500,0,0,1850\n"
    )
    alone = load_commands(path)
    assert alone.setpoint[:, 0].tolist() == [1000, -500]
    assert any("blackbox_high_resolution=1" in note for note in alone.warnings())
    (tmp_path / "a.headers.csv").write_text(
        "fieldname,fieldvalue\nFirmware revision,INAV 8.0.1 (ae47bcba) X\nblackbox_high_resolution,1\n"
        "minthrottle,1100\nmaxthrottle,1850\n"
    )
    path.write_text(path.read_text().replace("1100", "11000").replace("1850", "18500"))
    told = load_commands(path)
    assert told.setpoint[:, 0].tolist() == [100, -50]
    assert told.throttle.tolist() == [0.0, 1.0] and not told.warnings()
