"""`board settings import` against the running host program, and against the emulated board's image."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.flash.betaflight.diff_file import read_diff
from neuroflight.flash.betaflight.plan import fitted, needed
from neuroflight.flash.betaflight.planner import plan_import
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.msp import Decoder, Message, encode
from neuroflight.flash.link.records import safety
from neuroflight.flash.settings.text import Value, value_text
from neuroflight.flash.settings.values import Settings
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.serial.bridge import LineTransport, UartLine
from neuroflight.sim.board.serial.idle_board import IdleBoard, with_image
from neuroflight.toolchain.contract import FlightState, Msp
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.image.elf import read_flashable
from tests.flash.lockstep import Lockstep
from tests.flash.peers import Run

LayLine = Callable[..., str]
DIFF = """Entering CLI Mode, type 'exit' to return, or 'help'

# diff all

# version
# Betaflight / MATEKF722 (MKF7) 4.1.1 Nov 15 2019 / 12:36:09 (1e5e3d369) MSP API: 1.42

batch start
defaults nosave
name EXAMPLE
resource MOTOR 1 C09
resource MOTOR 4 C06
map TAER1234
serial 2 8192 115200 57600 0 115200
aux 0 0 0 1900 2100 0 0
aux 1 1 1 1750 2100 0 0
set osd_vbat_pos = 2423
set small_angle = 180
set failsafe_delay = 2
rateprofile 0
set roll_srate = 75
set roll_expo = 1
rateprofile 1
set roll_srate = 10
rateprofile 0
batch end
save
"""
WANTED = {
    "craft_name": "EXAMPLE",
    **{"motor1_output": 4, "motor4_output": 1},
    **{"map_throttle": 0, "map_roll": 1, "map_pitch": 2},
    "mode1": "arm aux1 1900 2100",
    "level_limit_deg": 180,
    **{
        "rates_style": "betaflight",
        "roll_max": 0.75,
        "roll_expo": 0.01,
    },  # the rest by default
}


@pytest.fixture
def diff(tmp_path: Path) -> Path:
    file = tmp_path / "diff.txt"
    file.write_text(DIFF)
    return file


@pytest.fixture
def msp(msp: Run, resting_host: str) -> Run:
    """Give it words behind `settings`: exit code, stdout, stderr. `port`: another than the host program's."""
    return Run(lambda *words, port=resting_host: msp(port, "settings", *words))


def changed(msp: Run) -> dict[str, object]:
    """Return the settings that differ from their defaults."""
    told = json.loads(msp("diff", "--json")[1])
    assert isinstance(told, dict)
    return told


def test_what_has_a_counterpart_is_stored_and_the_rest_is_told(msp: Run, diff: Path, tmp_path: Path) -> None:
    out = msp.told("import", str(diff), "--yes")
    assert changed(msp) == pytest.approx(WANTED)
    assert b"NFPS" in (tmp_path / "flash.bin").read_bytes()
    for words in (
        "Betaflight 4.1.1 of MATEKF722, 21 lines: 8 brought over, 13 left",
        "left, there is no on-screen display:\n  17: set osd_vbat_pos = 2423",
        "left, ANGLE: there is no such mode here:\n  16: aux 1 1 1 1750 2100 0 0",
        "left, of rate profile 1, which was not flown:\n  24: set roll_srate = 10",
        "note: mode2 = pid aux2 1700 2100 stays, and in the file AUX 2 switched ANGLE",
        "note: failsafe delay: not brought over, as setting failsafe_hold_ms would be 300",
        "note: check the motors' order, propellers off",
        "all stored; rates, dead bands and PID factors are flown at once, others from the next boot on",
    ):
        assert words in out, out
    out = msp.told("import", str(diff))
    assert "nothing is changed; all of it is so already" in out


def test_a_dry_run_says_the_same_and_changes_nothing(msp: Run, diff: Path, tmp_path: Path) -> None:
    before = (tmp_path / "flash.bin").read_bytes()
    code, dry, _ = msp("import", str(diff), "--dry-run")
    assert code == 0
    assert dry.endswith("nothing is changed: a dry run\n")
    told = json.loads(msp("import", str(diff), "--dry-run", "--json")[1])
    assert told["stored"] is False and told["changed"] and f"{told['brought']} brought over" in dry
    assert f"{len(told['left'])} left" in dry
    assert changed(msp) == {}
    wet = msp("import", str(diff), "--yes")[1]
    assert dry.splitlines()[:-1] == wet.splitlines()[:-1]
    assert (tmp_path / "flash.bin").read_bytes() != before


def test_the_settings_of_before_are_there_again_from_the_backup(msp: Run, diff: Path, tmp_path: Path) -> None:
    assert msp("set", "deadband_us=9", "yaw_expo=0.25", "--save")[0] == 0
    before, backup = msp("dump")[1], tmp_path / "before.txt"
    assert msp("import", str(diff), "--yes", "--backup", str(backup))[0] == 0
    assert backup.read_text() == before != msp("dump")[1]
    assert msp("restore", str(backup))[0] == 0
    assert msp("dump")[1] == before


@pytest.mark.parametrize(("typed", "code"), [("yes\n", 0), ("no\n", 1), ("", 1)])
def test_it_asks_on_a_terminal_and_needs_yes_elsewhere(
    msp: Run, diff: Path, monkeypatch: pytest.MonkeyPatch, typed: str, code: int
) -> None:
    got, _, err = msp("import", str(diff))
    assert got == 1
    assert "about to set and store " in err and "give --yes; nothing is changed" in err
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdin.readline", lambda: typed, raising=False)
    assert msp("import", str(diff))[0] == code
    assert bool(changed(msp)) == (code == 0)


def test_nothing_half_done_is_kept_when_one_set_is_refused_midway(
    msp: Run, resting_host: str, pty_line: LayLine, diff: Path, tmp_path: Path
) -> None:
    seen, before = 0, (tmp_path / "flash.bin").read_bytes()

    def spoil(data: bytes) -> bytes:
        nonlocal seen
        (asked,) = Decoder().feed(data)
        assert isinstance(asked, Message)
        seen += asked.command == Msp.SETTING_SET
        if seen != 7 or asked.command != Msp.SETTING_SET:
            return data
        seen += 1
        unknown = b"\xff\xff" + asked.payload[2:]
        return encode(Message(asked.version, asked.direction, asked.command, unknown))

    code, _, err = msp("import", str(diff), "--yes", port=pty_line(resting_host, down=spoil))
    assert seen > 7
    assert code == 1
    assert "refuses MSP SETTING_SET: there is none of that number; all settings are as they were" in err
    assert changed(msp) == {}
    assert (tmp_path / "flash.bin").read_bytes() == before


@pytest.mark.slow
def test_nothing_is_stored_when_the_line_is_cut_midway(
    msp: Run, resting_host: str, pty_line: LayLine, diff: Path, tmp_path: Path
) -> None:
    sets, before = 0, (tmp_path / "flash.bin").read_bytes()

    def cut(data: bytes) -> bytes:
        nonlocal sets
        (asked,) = Decoder().feed(data)
        assert isinstance(asked, Message)
        sets += asked.command == Msp.SETTING_SET
        return b"" if sets > 5 else data

    err = msp.refused("import", str(diff), "--yes", port=pty_line(resting_host, down=cut))
    assert "nothing is stored" in err
    assert (tmp_path / "flash.bin").read_bytes() == before


def asked_for(client: Client, diff: Path, board: str = "HOST") -> tuple[Settings, dict[str, Value]]:
    """Return a firmware's settings, and which of them the file would change."""
    settings = Settings(client)
    present = {stored.name: stored.value for stored in settings.read()}
    return settings, needed(fitted(plan_import(read_diff(diff), board, present), settings), present)


def test_it_arms_nothing_and_turns_no_motor(booted: Lockstep, diff: Path) -> None:
    """Move the arming range onto the switch's position; lockstep shows every step that follows."""
    diff.write_text(DIFF.replace("aux 0 0 0 1900 2100", "aux 0 0 0 900 1100"))
    with booted.client() as client:
        settings, changes = asked_for(client, diff)
        settings.change(changes, save=True)
        booted.run(1000)
        assert safety(client.request(Msp.SAFETY)).state is FlightState.DISARMED
    assert booted.most == (0.0,) * len(booted.most)


def test_nothing_changes_while_armed(booted: Lockstep, diff: Path, tmp_path: Path) -> None:
    before = (tmp_path / "flash.bin").read_bytes()
    with booted.client() as client:
        settings, changes = asked_for(client, diff)
        booted.run(3000)
        booted.sticks = {"arm": 2000}
        booted.run(500)
        assert safety(client.request(Msp.SAFETY)).state is FlightState.ARMED
        with pytest.raises(LinkError, match="the motors are armed"):
            settings.change(changes, save=True)
        assert not [stored.name for stored in settings.read() if stored.changed]
    assert (tmp_path / "flash.bin").read_bytes() == before


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("set roll_srate = 75\n", "give --betaflight VERSION"),
        (
            "# INAV/MATEKF405 7.1.0 Apr 21 2024 / 13:25:29 (03a5c1922)\nset roll_rate = 70\n",
            "written by INAV 7.1.0",
        ),
        ("# Betaflight / X 4.5.0\nrateprofile 0\n", "--rate-profile got 4, expected one of the file's: 0"),
    ],
)
def test_one_line_says_why_a_file_is_refused(msp: Run, tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "other.txt"
    file.write_text(text)
    err = msp.refused("import", str(file), "--yes", "--rate-profile", "4")
    assert words in err
    assert changed(msp) == {}


def test_the_version_and_the_rate_profile_can_be_told(msp: Run, tmp_path: Path) -> None:
    file = tmp_path / "rates.txt"
    file.write_text("rateprofile 0\nset roll_srate = 75\nrateprofile 1\nset roll_srate = 20\n")
    assert msp("import", str(file), "--yes", "--betaflight", "4.2", "--rate-profile", "1")[0] == 0
    assert changed(msp) == {"rates_style": "betaflight", "roll_max": pytest.approx(0.2)}


@pytest.mark.slow
def test_the_image_on_the_emulated_board_takes_it(board_image: Path, diff: Path) -> None:
    idle = IdleBoard(with_image(read_flashable(board_image.with_suffix(".bin")), None), elf=board_image)
    try:
        idle.boot()
        line = UartLine(idle.board)
        with Client(LineTransport(line, idle.run_to), lambda: idle.board.cycle / TIME_HZ) as client:
            settings, changes = asked_for(client, diff, "MATEKF722")
            settings.change(changes, save=True)
            told = {stored.name: value_text(stored.name, stored.value) for stored in settings.read(WANTED)}
        assert told == {name: str(value) for name, value in WANTED.items()}
    finally:
        idle.close()
