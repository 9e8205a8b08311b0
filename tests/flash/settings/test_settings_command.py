"""`board settings` get, set, diff, dump, restore, save and defaults against the running host program."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.flash.link.client import Client
from neuroflight.flash.link.msp import Decoder, Message, encode
from neuroflight.flash.link.transport import open_transport
from neuroflight.flash.settings.text import value_text
from neuroflight.flash.settings.values import Settings
from neuroflight.toolchain.contract import SETTINGS, Msp
from neuroflight.toolchain.errors import LinkError
from tests.flash.peers import Run, answering

LayLine = Callable[..., str]
CHANGES = ("roll_expo=0.1", "mode5=beeper aux7 900 1000 and", "craft_name= my quad", "motor_stop=on")
LINES = [
    "set mode5 = beeper aux7 900 1000 and",
    "set roll_expo = 0.1",
    "set motor_stop = on",
    "set craft_name = my quad",
]


@pytest.fixture
def msp(msp: Run, resting_host: str) -> Run:
    """Give it words behind `settings`: exit code, stdout, stderr. `port`: another than the host program's."""
    return Run(lambda *words, port=resting_host: msp(port, "settings", *words))


def lines(text: str) -> list[str]:
    """What `diff` and `dump` print, without their head."""
    head, *rest = text.splitlines()
    assert head.startswith("# ")
    return rest


def test_every_setting_is_at_its_default_when_the_firmware_is_new(msp: Run) -> None:
    assert lines(msp("diff")[1]) == []
    told = json.loads(msp("get", "--json")[1])
    assert list(told) == [setting.name for setting in SETTINGS]
    assert (told["mode1"], told["gyro_alignment"], told["roll_expo"]) == ("arm aux1 1700 2100", "board", 0)
    assert told["filter1_q"] == 0.70710677
    assert (told["gyro_rate_hz"], told["craft_name"]) == (4000, "")


def test_settings_are_changed_by_every_kind_of_value_when_set(msp: Run) -> None:
    out = msp.told("set", *CHANGES)
    assert out == (
        "4 settings set; rates, dead bands and PID factors are flown at once, "
        "others after `save` and a restart; a restart without `save` forgets them\n"
    )
    assert lines(msp("diff")[1]) == LINES
    dumped = lines(msp("dump")[1])
    assert len(dumped) == len(SETTINGS)
    assert set(LINES) < set(dumped)


def test_the_style_of_rates_comes_first_when_set_or_dumped(msp: Run) -> None:
    assert "a new style of rates sets the other rates to its defaults" in msp.told(
        "set", "yaw_max=0.5", "rates_style=betaflight"
    )
    assert lines(msp("diff")[1]) == ["set rates_style = betaflight", "set yaw_max = 0.5"]
    assert lines(msp("dump")[1])[0] == "set rates_style = betaflight"


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("yaw_expo=3", "setting yaw_expo got 3, expected 0 to 1"),
        ("deadband_us=1.5", "setting deadband_us got 1.5, expected a whole number from 0 to 100 us"),
        ("no_such=1", "setting 'no_such' is unknown"),
        ("roll_expo=0.2", "setting roll_expo is given twice"),
        ("gyro_rate_hz=7000", "setting gyro_rate_hz got 7000, expected one of 1000, 2000, 4000, 8000"),
        ("msp_baud=115201", "setting msp_baud got 115201, expected one of 9600, "),
        ("battery_low_v=3.6", "battery_low_v would be 3.6, expected below battery_warn_v, which is 3.5"),
        ("map_roll=1", "settings map_roll and map_pitch would both be 1, expected different ones"),
        ("dynamic_notch_low_hz=700", "expected below dynamic_notch_high_hz, which is 600"),
        ("roll_max=1998", "setting roll_max got 1998, expected 0 to 1600 deg/s"),
        (
            "failsafe_delay_ms=300",
            "failsafe_hold_ms would be 300, expected below failsafe_delay_ms, which is 300",
        ),
    ],
)
def test_nothing_is_set_when_one_of_several_is_wrong(msp: Run, wrong: str, words: str) -> None:
    err = msp.refused("set", "roll_expo=0.1", wrong, "--save")
    assert words in err
    assert lines(msp("diff")[1]) == []


def test_limits_are_those_of_the_new_style_when_it_is_set_with_its_rates(msp: Run) -> None:
    err = msp.refused("set", "roll_rate=100", "rates_style=betaflight")
    assert "setting roll_rate got 100, expected 0.01 to 2.38" in err
    assert msp("set", "roll_rate=1.5", "rates_style=betaflight")[0] == 0
    assert lines(msp("diff")[1]) == ["set rates_style = betaflight", "set roll_rate = 1.5"]


def test_rates_that_ask_for_more_than_is_flown_are_refused_with_the_line(msp: Run) -> None:
    told = "would ask for 2000 deg/s at full stick, expected at most 1600; lower one of them"
    err = msp.refused("set", "roll_rate=2", "roll_max=0.8", "rates_style=betaflight", "--save")
    assert f"settings roll_rate 2 and roll_max 0.8 {told}" in err
    assert lines(msp("diff")[1]) == []
    assert msp("set", "roll_rate=2", "rates_style=betaflight")[0] == 0
    err = msp.refused("set", "roll_max=0.8")
    assert f"settings roll_rate 2 and roll_max 0.8 {told}" in err


def test_a_filter_is_refused_when_the_gyro_is_too_slow_for_it_as_both_are_set(msp: Run) -> None:
    err = msp.refused("set", "filter1_kind=pt1", "filter1_hz=500", "gyro_rate_hz=1000")
    assert "filter1_hz would be 500 Hz, expected below half of gyro_rate_hz, which is 1000 Hz" in err
    assert msp("set", "filter1_kind=pt1", "filter1_hz=499", "gyro_rate_hz=1000")[0] == 0


def test_everything_is_put_back_when_the_firmware_refuses_to_store_it(msp: Run) -> None:
    """Four slow filters together delay too much: a rule that only the firmware knows."""
    chain = [f"filter{stage}_{what}" for stage in range(1, 5) for what in ("kind=pt3", "hz=40")]
    err = msp.refused("set", "rates_style=betaflight", *chain, "--save")
    assert "refuses MSP EEPROM_WRITE: filter1_kind does not fit" in err
    assert err.endswith("; all settings are as they were\n")
    assert lines(msp("diff")[1]) == []


def test_settings_are_there_after_a_restart_when_saved(msp: Run, tmp_path: Path) -> None:
    assert b"NFPS" not in (tmp_path / "flash.bin").read_bytes()
    out = msp.told("set", *CHANGES, "--save")
    assert out == (
        "4 settings set and stored; rates, dead bands and PID factors are flown at once, "
        "others from the next boot on\n"
    )
    assert b"NFPS" in (tmp_path / "flash.bin").read_bytes()


@pytest.mark.parametrize(
    ("change", "flags", "told"),
    [
        ("roll_expo=0.1", ("--save",), "1 setting set and stored; flown at once"),
        ("pid_yaw_p=1.1", (), "1 setting set; flown at once; a restart without `save` forgets them"),
        ("motor_stop=on", ("--save",), "1 setting set and stored; flown from the next boot on"),
        (
            "mode5=none",
            (),
            "1 setting set; flown after `save` and a restart; a restart without `save` forgets them",
        ),
    ],
)
def test_it_is_told_when_a_change_is_flown(msp: Run, change: str, flags: tuple[str, ...], told: str) -> None:
    assert msp("set", change, *flags) == (0, told + "\n", "")


def test_a_restart_is_refused_when_it_would_forget_what_is_set(msp: Run) -> None:
    err = msp.refused("set", *CHANGES, "--reboot")
    assert "--reboot without --save forgets what is set" in err
    assert lines(msp("diff")[1]) == []


def test_the_settings_are_the_same_again_when_a_diff_is_restored(msp: Run, tmp_path: Path) -> None:
    msp("set", *CHANGES, "rates_style=betaflight", "yaw_max=0.5")
    whole, changed = msp("dump")[1], tmp_path / "mine.txt"
    changed.write_text(msp("diff")[1])
    msp("set", "rates_style=actual", "pilot_name=another", "deadband_us=9", "--save")
    out = msp.told("restore", str(changed))
    assert "6 settings read" in out and "all stored" in out
    assert msp("dump")[1] == whole


def test_what_a_file_does_not_name_stays_when_it_is_to_be_kept(msp: Run, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("set roll_expo = 0.5\nset craft_name = -\n")
    msp("set", *CHANGES, "rates_style=betaflight", "yaw_max=0.5")
    assert msp("restore", "--keep", str(tmp_path / "mine.txt"))[0] == 0
    assert lines(msp("diff")[1]) == [
        "set rates_style = betaflight",
        LINES[0],
        "set roll_expo = 0.5",
        "set yaw_max = 0.5",
        "set motor_stop = on",
    ]
    assert msp("restore", str(tmp_path / "mine.txt"))[0] == 0
    assert lines(msp("diff")[1]) == ["set roll_expo = 0.5"]


def test_rates_are_those_of_the_style_when_only_the_style_is_in_the_file(msp: Run, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("set rates_style = betaflight\n")
    msp("set", "roll_rate=77", "yaw_expo=0.5")
    assert msp("restore", "--keep", str(tmp_path / "mine.txt"))[0] == 0
    assert lines(msp("diff")[1]) == ["set rates_style = betaflight"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("set yaw_expo = 0.5\nset roll_expo = 3\n", ":2: setting roll_expo got 3, expected 0 to 1"),
        ("set yaw_expo = 0.5\nset roll_exp = 0\n", ":2: setting 'roll_exp' is unknown"),
        (
            "set roll_rate = 100\nset rates_style = betaflight\n",
            ":1: setting roll_rate got 100, expected 0.01 to 2.38",
        ),
        ("set map_roll = 1\n", "settings map_roll and map_pitch would both be 1"),
    ],
)
def test_nothing_changes_when_a_line_of_the_file_is_wrong(
    msp: Run, tmp_path: Path, text: str, words: str
) -> None:
    (tmp_path / "mine.txt").write_text(text)
    msp("set", *CHANGES)
    err = msp.refused("restore", str(tmp_path / "mine.txt"))
    assert words in err
    assert lines(msp("diff")[1]) == LINES


def test_everything_is_as_before_when_flash_does_not_take_what_is_restored(msp: Run, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("set rates_style = betaflight\nset deadband_us = 5\n")
    msp("set", *CHANGES)
    (tmp_path / "flash.bin").unlink()
    err = msp.refused("restore", str(tmp_path / "mine.txt"))
    assert "refuses MSP EEPROM_WRITE: flash did not take it" in err
    assert err.endswith("; all settings are as they were\n")
    assert lines(msp("diff")[1]) == LINES


def test_everything_is_as_before_when_one_set_is_refused_midway(
    msp: Run, resting_host: str, pty_line: LayLine, tmp_path: Path
) -> None:
    """On the way down the fifth SETTING_SET becomes one of a setting that does not exist."""
    (tmp_path / "mine.txt").write_text("".join(f"set mode{slot} = none\n" for slot in range(1, 9)))
    seen = 0

    def spoil(data: bytes) -> bytes:
        nonlocal seen
        (asked,) = Decoder().feed(data)
        assert isinstance(asked, Message)
        seen += asked.command == Msp.SETTING_SET
        if seen != 5 or asked.command != Msp.SETTING_SET:
            return data
        seen += 1
        return encode(Message(asked.version, asked.direction, asked.command, b"\xff\xff" + asked.payload[2:]))

    assert msp("set", *CHANGES)[0] == 0
    code, _, err = msp("restore", str(tmp_path / "mine.txt"), port=pty_line(resting_host, down=spoil))
    assert seen > 5
    assert code == 1
    assert "refuses MSP SETTING_SET: there is none of that number; all settings are as they were" in err
    assert lines(msp("diff")[1]) == LINES


@pytest.mark.slow
def test_it_says_what_stays_when_the_line_breaks_midway(
    msp: Run, resting_host: str, pty_line: LayLine, tmp_path: Path
) -> None:
    (tmp_path / "mine.txt").write_text("".join(f"set mode{slot} = none\n" for slot in range(1, 5)))
    broken = False

    def cut(data: bytes) -> bytes:
        nonlocal broken
        (asked,) = Decoder().feed(data)
        assert isinstance(asked, Message)
        broken |= asked.command == Msp.SETTING_SET and asked.payload[2:] == bytes(4)
        return b"" if broken else data

    flash = tmp_path / "flash.bin"
    before = flash.read_bytes()
    err = msp.refused("restore", str(tmp_path / "mine.txt"), port=pty_line(resting_host, down=cut))
    assert "got silence, expected a reply to MSP SETTING_SET" in err
    assert err.endswith("; what was set before that stays until the next boot, nothing is stored\n")
    assert flash.read_bytes() == before


def test_another_value_than_was_set_is_noticed_when_read_back(
    resting_host: str, tcp_server: Callable[..., str]
) -> None:
    """Somebody between us and the firmware confirms a change and forgets it."""
    forgetful = answering({Msp.SETTING_SET: b""}, through=resting_host)
    told = r"roll_expo reads 0 after it was set, expected 0\.5; .* as they were"
    with Client(open_transport(tcp_server(forgetful))) as client, pytest.raises(LinkError, match=told):
        Settings(client).change({"roll_expo": 0.5})


def test_defaults_are_set_only_when_somebody_means_it(msp: Run) -> None:
    msp("set", *CHANGES, "rates_style=betaflight", "yaw_max=0.5", "--save")
    err = msp.refused("defaults")
    assert "nobody can be asked here, give --yes; nothing is changed" in err
    assert len(lines(msp("diff")[1])) == 6
    assert "every setting has its default now, stored; " in msp.told("defaults", "--yes", "--save")
    assert lines(msp("diff")[1]) == []


def test_defaults_are_one_request_and_everything_is_put_back_when_they_cannot_be_stored(
    msp: Run, resting_host: str
) -> None:
    msp("set", *CHANGES, "rates_style=betaflight", "yaw_max=0.5")
    before = msp("diff")[1]
    asked: list[Msp] = []

    class Watched(Client):
        def request(
            self, command: Msp, payload: bytes = b"", timeout: float | None = None, retries: int | None = None
        ) -> bytes:
            asked.append(command)
            if command is Msp.EEPROM_WRITE:
                raise LinkError("flash is worn out")
            return super().request(command, payload, timeout, retries)

    with Watched(open_transport(resting_host)) as client:
        with pytest.raises(LinkError, match="flash is worn out; all settings are as they were"):
            Settings(client).set_defaults(save=True)
        assert asked.count(Msp.SETTINGS_DEFAULT) == 1
        until = asked.index(Msp.EEPROM_WRITE)
        assert Msp.SETTING_SET not in asked[:until] and Msp.SETTING_SET in asked[until:]
    assert msp("diff")[1] == before


@pytest.mark.parametrize(("typed", "code", "left"), [("yes\n", 0, 0), ("no\n", 1, 4), ("", 1, 4)])
def test_defaults_ask_on_a_terminal_when_not_told_yes(
    msp: Run, monkeypatch: pytest.MonkeyPatch, typed: str, code: int, left: int
) -> None:
    msp("set", *CHANGES)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdin.readline", lambda: typed, raising=False)
    assert msp("defaults")[0] == code
    assert len(lines(msp("diff")[1])) == left


def test_save_stores_what_was_set_before(msp: Run, tmp_path: Path) -> None:
    msp("set", *CHANGES)
    before = (tmp_path / "flash.bin").read_bytes()
    told = (
        "settings stored; rates, dead bands and PID factors are flown at once, others from the next boot on\n"
    )
    assert msp("save") == (0, told, "")
    assert (tmp_path / "flash.bin").read_bytes() != before


def test_a_setting_is_shown_with_its_limits_when_asked_for(msp: Run) -> None:
    out = msp.told("get", "roll_rate", "mode1", "craft_name", "filter1_kind")
    words = " ".join(out.split())
    for shown in (
        "roll_rate 70 70 0.01 to 1000 deg/s",
        "mode1 arm aux1 1700 2100 arm aux1 1700 2100 MODE AUX LOW HIGH, or none",
        "craft_name - - 0 to 16 characters",
        "filter1_kind none none none, pt1, pt2, pt3, biquad, notch",
    ):
        assert shown in words
    assert "\x1b" not in out
    err = msp.refused("get", "rol_rate")
    assert "setting 'rol_rate': the firmware has none of that name" in err


def test_values_are_the_contracts_defaults_when_the_firmware_is_new(resting_host: str) -> None:
    with Client(open_transport(resting_host)) as client:
        for stored in Settings(client).read():
            assert value_text(stored.name, stored.value) == value_text(stored.name, stored.default)
            assert not stored.changed


def test_one_line_says_so_when_the_peer_has_no_settings(tcp_server: Callable[..., str], msp: Run) -> None:
    betaflight = answering({Msp.API_VERSION: b"\x00\x01\x2f"})
    err = msp.refused("get", port=tcp_server(betaflight))
    assert "the firmware refuses MSP SETTING_INFO" in err
