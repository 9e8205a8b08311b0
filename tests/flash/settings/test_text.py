"""Values of settings as text and back: exact, and refused in one line where they are none."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neuroflight.flash.settings.text import (
    BY_NAME,
    as_stored,
    default_of,
    parse_change,
    parse_setting,
    parse_value,
    same,
    set_line,
    shortest,
    value_text,
)
from neuroflight.flash.settings.values import in_order
from neuroflight.toolchain.contract import MODE_STEPS, SETTING_LEAST, SETTING_TEXT_BYTES, Mode, ModeRange
from neuroflight.toolchain.errors import LinkError

FLOATS = st.floats(0.0, 4000.0, width=32)
TEXTS = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=SETTING_TEXT_BYTES)


def packed(mode: Mode, aux: int, low: int, high: int, also: bool) -> int:
    return mode | (aux - 1) << 8 | low << 12 | high << 18 | also << 24


@given(FLOATS)
def test_a_float_reads_back_to_the_bit_when_written(value: float) -> None:
    text = shortest(value)
    assert "e" not in text
    assert struct.pack("<f", parse_value("roll_rate", text)) == struct.pack("<f", value)


@pytest.mark.parametrize("name", ["roll_expo", "pitch_expo", "yaw_expo", "failsafe_throttle"])
def test_a_bare_1_of_a_ratio_is_refused_as_it_may_be_a_percent(name: str) -> None:
    assert value_text(name, 1.0) == "1.0"
    assert parse_value(name, "1.0") == 1.0
    assert parse_value(name, "0") == 0.0
    with pytest.raises(LinkError, match=r"got '1', expected 1\.0 for all of it, or 0\.01 for a percent"):
        parse_value(name, " 1 ")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1, "0.1"),
        (as_stored("roll_expo", 0.1), "0.1"),
        (4000.0, "4000"),
        (0.70710677, "0.70710677"),
        (0, "0"),
    ],
)
def test_a_float_takes_the_fewest_digits_when_written(value: float, text: str) -> None:
    assert shortest(value) == text


@given(
    st.sampled_from(Mode),
    st.integers(1, 12),
    st.integers(0, MODE_STEPS),
    st.integers(0, MODE_STEPS),
    st.booleans(),
)
def test_a_mode_range_reads_back_when_written(mode: Mode, aux: int, one: int, two: int, also: bool) -> None:
    value = packed(mode, aux, min(one, two), max(one, two), also)
    text = value_text("mode1", value)
    assert parse_value("mode1", text) == value
    if one != two:
        assert text == str(ModeRange.unpack(value))


@given(TEXTS)
def test_a_text_reads_back_when_written(text: str) -> None:
    name, _, value = set_line("craft_name", text).removeprefix("set ").partition("=")
    assert parse_value(name.strip(), value) == text


def test_a_number_is_0_when_the_firmware_keeps_it_as_0() -> None:
    assert as_stored("roll_expo", SETTING_LEAST) == SETTING_LEAST
    assert as_stored("roll_expo", SETTING_LEAST / 1.001) == 0.0
    assert as_stored("board_roll_deg", -1e-6) == 0.0


def test_a_value_is_rounded_when_the_firmware_keeps_it_as_float32() -> None:
    assert as_stored("roll_expo", 0.1) == 0.10000000149011612
    assert as_stored("gyro_rate_hz", 16_777_217.0) == 16_777_217.0


def test_the_style_of_rates_comes_first_when_changes_are_put_in_order() -> None:
    changes = {"yaw_max": 0.5, "rates_style": 1.0, "deadband_us": 3.0}
    assert list(in_order(changes)) == ["rates_style", "yaw_max", "deadband_us"]
    assert in_order(changes) == changes


def test_each_default_reads_back_when_written() -> None:
    for name, (_, setting) in BY_NAME.items():
        value = default_of(setting)
        assert same(name, parse_value(name, value_text(name, value)), value), name


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("gyro_rate_hz=8000", ("gyro_rate_hz", 8000.0)),
        (" roll_expo = 0.25 ", ("roll_expo", 0.25)),
        ("filter1_kind=notch", ("filter1_kind", 5.0)),
        ("filter1_kind=5", ("filter1_kind", 5.0)),
        ("motor_stop=on", ("motor_stop", 1.0)),
        ("craft_name= my quad ", ("craft_name", "my quad")),
        ('craft_name=" my quad "', ("craft_name", " my quad ")),
        ("craft_name=-", ("craft_name", "")),
        ("craft_name=", ("craft_name", "")),
        ("mode2=none", ("mode2", 0.0)),
        ("mode2=ARM AUX1 1700 2100", ("mode2", float(ModeRange(Mode.ARM, 1, 1700, 2100).packed))),
        ("mode2=pid aux12 900 925 and", ("mode2", float(ModeRange(Mode.PID, 12, 900, 925, True).packed))),
        ("filter1_kind=NOTCH", ("filter1_kind", 5.0)),
    ],
)
def test_a_change_is_read_when_it_is_a_number_a_choice_a_text_or_a_mode_range(
    text: str, change: tuple[str, object]
) -> None:
    assert parse_setting(text) == change
    if not isinstance(change[1], str):
        assert parse_change(text) == change


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gyro_rate_hz", "setting 'gyro_rate_hz', expected NAME=VALUE"),
        ("gyro_rat=1", "setting 'gyro_rat' is unknown"),
        ("roll_expo=much", "setting roll_expo got 'much', expected a number"),
        ("motor_stop=maybe", "setting motor_stop got 'maybe', expected one of off, on"),
        ("roll_expo=", "setting roll_expo got '', expected a number"),
        ("battery_scale=nan", "setting battery_scale got 'nan', expected a number within its limits"),
        ("battery_scale=-inf", "setting battery_scale got '-inf', expected a number within its limits"),
        ("battery_scale=1e300", "setting battery_scale got '1e300', expected a number within its limits"),
        ("craft_name=seventeen letters", "expected at most 16 characters of ASCII"),
        ("craft_name=Fl\u00fcgel", "expected at most 16 characters of ASCII"),
        ("craft_name=two\nlines", "expected at most 16 characters of ASCII"),
        ("mode1=", "expected MODE AUX LOW HIGH such as 'arm aux1 1700 2100'"),
        ("mode1=arm aux1 1700", "expected MODE AUX LOW HIGH"),
        ("mode1=arm aux1 1700 2100 or", "expected MODE AUX LOW HIGH"),
        ("mode1=turtle aux1 1700 2100", "MODE one of arm, "),
        ("mode1=arm aux13 1700 2100", "got 'aux13', expected aux1 to aux12"),
        ("mode1=arm auxx 1700 2100", "got 'auxx', expected aux1 to aux12"),
        ("mode1=arm aux1 1701 2100", "got '1701', expected 900 to 2100 us in steps of 25"),
        ("mode1=arm aux1 1700 2125", "got '2125', expected 900 to 2100 us in steps of 25"),
        ("mode1=arm aux1 2100 1700", "expected the lower end first"),
    ],
)
def test_a_change_is_refused_in_one_line_when_it_is_none(text: str, words: str) -> None:
    for parse in (parse_setting, parse_change):
        with pytest.raises(LinkError) as caught:
            parse(text)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_text_is_refused_when_a_flight_is_to_have_it() -> None:
    with pytest.raises(LinkError, match="setting craft_name is a text, expected one that changes a flight"):
        parse_change("craft_name=my quad")


def test_a_value_that_this_tool_has_no_word_for_is_told_as_a_number() -> None:
    assert value_text("mode1", 250 | 1 << 18) == str(250 | 1 << 18)
    assert value_text("filter1_kind", 99) == "99"
    assert value_text("from_the_future", 0.5) == "0.5"
