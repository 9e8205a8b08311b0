"""get, set, diff, dump, save, defaults: settings as text, and back to the same settings."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable

import pytest

from neuroflight.toolchain.contract import (
    AUX_COUNT,
    MODE_LOW_US,
    MODE_STEP_US,
    MODE_STEPS,
    SETTINGS,
    Mode,
    ModeRange,
    Setting,
)
from tests.firmware.command_line.conftest import IdleFirmware

MakeIdle = Callable[..., IdleFirmware]
PRINTABLE = [chr(code) for code in range(ord(" "), ord("~") + 1)]
SAVE_REFUSED = "###ERROR save: nothing written, for there were errors"


def legal(setting: Setting, rng: random.Random, betaflight: bool) -> float | str:
    """Any value that the setting takes."""
    span = setting.betaflight if betaflight and setting.betaflight else setting
    if setting.kind == "text":
        return "".join(rng.choices(PRINTABLE, k=rng.randint(0, 16)))
    if setting.kind == "mode":
        low, high = sorted(rng.choices(range(MODE_STEPS + 1), k=2))
        low_us, high_us = MODE_LOW_US + low * MODE_STEP_US, MODE_LOW_US + high * MODE_STEP_US
        return ModeRange(
            rng.choice(list(Mode)), rng.randint(1, AUX_COUNT), low_us, high_us, rng.random() < 0.5
        ).packed
    if setting.kind == "uint32_t":
        return rng.randint(int(setting.low), int(setting.high))
    value = rng.uniform(span.low, span.high)
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def shuffle(idle: IdleFirmware, seed: int, count: int = 40) -> None:
    """So many settings to legal values."""
    rng = random.Random(seed)
    chosen = rng.sample([setting for setting in SETTINGS if setting.name != "rates_style"], count)
    betaflight = rng.random() < 0.5
    idle.set("rates_style", int(betaflight), "uint32_t")
    for setting in chosen:
        idle.set(setting.name, legal(setting, rng, betaflight), setting.kind)


@pytest.mark.parametrize("listing", ["diff all", "dump"])
@pytest.mark.parametrize("seed", range(6))
def test_a_listing_restores_the_settings_exactly_when_it_is_pasted(
    make_idle: MakeIdle, idle: IdleFirmware, seed: int, listing: str
) -> None:
    shuffle(idle, seed)
    wanted = idle.settings()
    idle.open()
    text = "\r\n".join(idle.tell(listing)) + "\r\n"
    other = make_idle()
    shuffle(other, seed + 100, count=60)  # whatever it had
    assert other.settings() != wanted
    other.open()
    said = other.send(text.encode()).decode()
    assert "ERROR" not in said
    assert other.settings() == wanted
    assert "\r\n".join(other.tell(listing)) + "\r\n" == text


def test_diff_names_what_differs_and_nothing_else(idle: IdleFirmware) -> None:
    idle.open()
    assert idle.tell("diff") == []
    idle.type("set motor_protocol = dshot300\r\nset craft_name = A b\r\nset roll_expo=0.25")
    assert idle.tell("diff") == [
        "set roll_expo = 0.25",
        "set motor_protocol = dshot300",
        "set craft_name = A b",
    ]
    idle.type("set rates_style = betaflight")
    assert idle.tell("diff") == [
        "set rates_style = betaflight",
        "set motor_protocol = dshot300",
        "set craft_name = A b",
    ], "rates stand at the defaults of their style"
    all_ = idle.tell("diff all")
    assert all_[:3] == [
        "# Neuroflight 0.1.0 on HOST",
        "# policy scripted 00112233, craft A b",
        "defaults",
    ]
    assert all_[-1].startswith("#")


def test_a_setting_changes_when_it_is_set_in_any_spelling(idle: IdleFirmware) -> None:
    idle.open()
    for line in (
        "set motor_protocol=DSHOT300",
        "set  failsafe_throttle   =   0.3",
        "  set mode5 = PID aux7 1300 1700 and  ",
        "set craft_name = x = y",
    ):
        assert idle.type(line).count("\r\n") == 1, line
    told = [
        line.split(" (")[0]
        for name in ("motor_pro", "e_throttle", "mode5", "craft")
        for line in idle.tell(f"get {name}")
    ]
    assert told == [
        "motor_protocol = dshot300",
        "failsafe_throttle = 0.3",
        "mode5 = pid aux7 1300 1700 and",
        "craft_name = x = y",
    ]


def test_get_tells_value_limits_and_default(idle: IdleFirmware) -> None:
    idle.open()
    assert idle.tell("get gyro_rate") == ["gyro_rate_hz = 4000 (1000 to 8000 Hz; default 4000)"]
    assert idle.tell("get motor_protocol") == [
        "motor_protocol = dshot600 (one of dshot300,dshot600,dshot150; default dshot600)"
    ]
    assert idle.tell("get pilot_name") == ["pilot_name = - (at most 16 characters, - for none)"]
    names = [line.split(" = ")[0] for line in idle.tell("get")]
    assert names[-len(SETTINGS) :] == [setting.name for setting in SETTINGS]
    assert names[: -len(SETTINGS)] == [
        *("version", "board", "uid", "policy", "policy_idle", "policy_mix", "control_rate_hz")
    ]
    assert idle.tell("set") == idle.tell("get")
    idle.type("set rates_style = betaflight")
    assert idle.tell("get roll_max") == ["roll_max = 0.7 (0 to 1.0; default 0.7)"]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("set gyro_rat = 1000", "set: got 'gyro_rat', expected a setting's name; 'get' lists them"),
        ("set version = 2", "set: got 'version', expected a setting; that can only be read"),
        ("set uid = 2", "set: got 'uid', expected a setting; that can only be read"),
        ("set policy_idle = 0", "set: got 'policy_idle', expected a setting; that can only be read"),
        ("set gyro_rate_hz", "set: got 'gyro_rate_hz', expected NAME = VALUE"),
        ("set gyro_rate_hz 1000", "set: got 'gyro_rate_hz 1000', expected NAME = VALUE"),
        ("set gyro_rate_hz = 999", "gyro_rate_hz: got '999', expected 1000 to 8000 Hz"),
        ("set gyro_rate_hz = fast", "gyro_rate_hz: got 'fast', expected a whole number from 1000 to 8000 Hz"),
        ("set gyro_rate_hz = -1", "gyro_rate_hz: got '-1', expected 1000 to 8000 Hz"),
        ("set failsafe_throttle = 1.01", "failsafe_throttle: got '1.01', expected 0 to 1"),
        ("set failsafe_throttle = nan", "failsafe_throttle: got 'nan', expected a number from 0 to 1"),
        ("set failsafe_throttle = 1", "failsafe_throttle: got '1', expected 1.0, or 0.01 for a percent"),
        ("set yaw_expo = 1", "yaw_expo: got '1', expected 1.0, or 0.01 for a percent; a diff"),
        ("set yaw_expo = 20", "yaw_expo: got '20', expected 0 to 1.0"),
        ("set motor_protocol = pwm", "motor_protocol: got 'pwm', expected one of dshot300,dshot600,dshot150"),
        ("set craft_name = 12345678901234567", "craft_name: got '12345678901234567', expected at most 16"),
        ("set mode1 = arm aux1 1701 2100", "expected ends from 900 to 2100 us, multiples of 25"),
        ("set mode1 = fly aux1 1700 2100", "expected a mode: arm, beeper, pid or trial"),
        ("set mode1 = arm aux13 1700 2100", "expected aux1 to aux12"),
        ("set mode1 = arm aux1 2100 1700", "expected the lower end first"),
        ("set mode1 = arm", "expected MODE AUX LOW HIGH such as arm aux1 1700 2100"),
        ("get xyz", "get: got 'xyz', expected a part of a name"),
        ("diff everything", "diff: got 'everything', expected nothing or 'all'"),
        ("save me", "save: got 'me', expected nothing or 'force'"),
        ("defaults now", "defaults: got 'now', expected nothing"),
        ("fly", "fly: unknown command, expected one that 'help' lists"),
        ("SET gyro_rate_hz = 1000", "unknown command"),
        ("help fly", "help: got 'fly', expected a command that 'help' lists"),
        ("faults forget", "faults: got 'forget', expected nothing or 'ack'"),
    ],
)
def test_an_error_says_what_was_got_and_expected_in_one_line(
    idle: IdleFirmware, line: str, words: str
) -> None:
    idle.open()
    before = idle.settings()
    (said,) = idle.tell(line)
    assert said.startswith("###ERROR ")
    assert words in said
    assert idle.settings() == before
    assert SAVE_REFUSED in idle.type("save")
    assert idle.stored() == []


@pytest.mark.parametrize(
    "line",
    [
        *("batch start", "board_name MATEKF722", "resource MOTOR 1 C09", "feature -AIRMODE", "map TAER1234"),
        *("serial 2 32 115200 57600 0 115200", "aux 0 0 0 1300 2100 0 0", "profile 0", "rateprofile 0"),
        *("beeper -ON_USB", "name EXAMPLE", "rxfail 4 h", "set roll_srate = 70", "set roll_expo = 1"),
    ],
)
def test_a_line_of_betaflights_diff_is_told_who_takes_it(idle: IdleFirmware, line: str) -> None:
    idle.open()
    before = idle.settings()
    (said,) = idle.tell(line)
    assert said.startswith("###ERROR ")
    assert said.endswith("; a diff of Betaflight's: neuroflight board settings import")
    assert idle.settings() == before
    assert SAVE_REFUSED in idle.type("save")


def test_a_pasted_diff_of_betaflights_stores_nothing(idle: IdleFirmware) -> None:
    """Paste settings that have the same names here: the `save` at their end is refused."""
    idle.open()
    said = idle.type(
        "# version\r\n# Betaflight / MATEKF722 (MKF7) 4.0.0 Mar  8 2019 / 11:37:03 (52c4e96c8)\r\n"
        "batch start\r\ndefaults nosave\r\nset failsafe_throttle = 1100\r\nset blackbox_mode = ALWAYS\r\n"
        "rateprofile 0\r\nset roll_expo = 1\r\nset yaw_expo = 0\r\nbatch end\r\nsave"
    )
    assert SAVE_REFUSED in said
    assert idle.stored() == []
    assert "set roll_expo" not in "".join(idle.tell("diff"))


def test_the_whole_of_a_ratio_is_listed_with_its_point_and_read_back(idle: IdleFirmware) -> None:
    idle.open()
    assert idle.tell("set roll_expo = 1.0") == []
    assert idle.tell("diff") == ["set roll_expo = 1.0"]
    assert idle.tell("get motor_limit") == ["motor_limit = 1.0 (0.45 to 1.0; default 1.0)"]


def test_nothing_is_saved_after_an_error_unless_it_is_forced(idle: IdleFirmware) -> None:
    idle.open()
    said = idle.type("set craft_name = A\r\nset craft_nam = B\r\nset pilot_name = C\r\nsave")
    assert said.count("###ERROR") == 2
    assert SAVE_REFUSED in said
    assert "Rebooting" not in said
    assert idle.stored() == []
    assert "saved\r\nRebooting\r\n" in idle.type("save force")
    assert idle.stored() == ["craft_name", "pilot_name"]


def test_defaults_begins_anew(idle: IdleFirmware) -> None:
    idle.open()
    idle.type("set craft_name = A\r\nset craft_nam = B")
    (said,) = idle.tell("defaults")
    assert "not saved" in said
    assert "'save'" in said
    assert idle.tell("diff") == []
    assert "saved" in idle.type("save")


def test_settings_that_do_not_go_together_are_not_saved(idle: IdleFirmware) -> None:
    idle.open()
    idle.type("set map_pitch = 0")
    said = idle.type("save")
    assert "###ERROR save: nothing written, map_" in said
    assert idle.stored() == []
    idle.type("set map_pitch = 1")
    assert "saved" in idle.type("save"), "an error of save is mended by what it names"


def test_save_stores_restarts_and_ends_the_session(idle: IdleFirmware) -> None:
    idle.open()
    said = idle.type("set craft_name = A\r\nsave")
    assert said.endswith("saved\r\nRebooting\r\n")
    assert idle.send(b"version\r") == b""
    assert idle.stored() == ["craft_name"]


def test_exit_drops_what_is_not_saved(idle: IdleFirmware) -> None:
    idle.open()
    before = idle.settings()
    assert idle.type("set craft_name = A\r\nexit").endswith("Rebooting\r\n")
    assert idle.settings() == before


def test_nothing_is_saved_when_flash_fails(idle: IdleFirmware) -> None:
    idle.open()
    idle.break_flash()
    assert "###ERROR save: nothing written, flash did not take it" in idle.type("set craft_name = A\r\nsave")
