"""settings_text.c: values of settings as people write them, and back to the bit."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import settings as effort
from hypothesis import strategies as st

from neuroflight.toolchain.contract import (
    AUX_COUNT,
    MODE_LOW_US,
    MODE_STEP_US,
    MODE_STEPS,
    SETTING_TEXT_BYTES,
    SETTINGS,
    Mode,
    ModeRange,
    Refusal,
    Setting,
)
from tests.sampling import examples

BYTES = 32
BY_NAME = {setting.name: (index, setting) for index, setting in enumerate(SETTINGS)}


class Error(IntEnum):
    """enum settings_text_error."""

    GOOD = 0
    NO_NUMBER = 1
    NOT_WHOLE = 2
    TOO_LARGE = 3
    NO_CHOICE = 4
    TOO_LONG = 5
    MODE_FORM = 6
    MODE_NAME = 7
    MODE_AUX = 8
    MODE_GRID = 9
    MODE_ORDER = 10


def raw(core: Any, value: Any) -> bytes:
    return bytes(core.ffi.buffer(value))


def parse(core: Any, name: str, text: str) -> tuple[Error, bytes]:
    """What it says, and the value's bytes; those from before where it is refused."""
    value = core.new("union setting_value *")
    core.ffi.buffer(value)[:] = b"\xa5" * SETTING_TEXT_BYTES
    error = Error(
        core.lib.settings_text_parse(core.lib.settings_info(BY_NAME[name][0]), text.encode(), value)
    )
    assert error is Error.GOOD or raw(core, value) == b"\xa5" * SETTING_TEXT_BYTES
    return error, raw(core, value)


def format_(core: Any, name: str, value: bytes) -> str:
    held = core.new("union setting_value *")
    core.ffi.buffer(held)[:] = value.ljust(SETTING_TEXT_BYTES, b"\0")
    text = core.new("char[]", b"\x55" * BYTES)
    out = core.new("struct printer *", core.lib.printer_init(text, BYTES))
    core.lib.settings_text_print(out, core.lib.settings_info(BY_NAME[name][0]), held)
    assert out.at < out.end, "cut"
    return bytes(core.ffi.buffer(text, out.at - text)).decode()


def padded(value: int | float | bytes) -> bytes:
    packed = struct.pack("<f", value) if isinstance(value, float) else value
    packed = struct.pack("<I", packed) if isinstance(packed, int) else packed
    return packed.ljust(SETTING_TEXT_BYTES, b"\0")


LEAST_BITS, MOST_BITS = (
    0x37800000,
    0x4B7FFFFF,
)  # of the floats from 2^-16 to below 2^24, as decimal.h takes them


@st.composite
def legal(draw: st.DrawFn) -> tuple[str, bytes]:
    """A setting and a value of it."""
    setting: Setting = draw(st.sampled_from(SETTINGS))
    if setting.kind == "text":
        return setting.name, draw(st.text(PRINTABLE, max_size=SETTING_TEXT_BYTES)).encode()
    if setting.kind == "mode":
        mode = draw(st.sampled_from(Mode))
        low, high = sorted(draw(st.tuples(st.integers(0, MODE_STEPS), st.integers(0, MODE_STEPS))))
        low_us, high_us = MODE_LOW_US + low * MODE_STEP_US, MODE_LOW_US + high * MODE_STEP_US
        range_ = ModeRange(mode, draw(st.integers(1, AUX_COUNT)), low_us, high_us, draw(st.booleans()))
        return setting.name, struct.pack("<I", range_.packed)
    if setting.kind == "float":
        bits = draw(st.just(0) | st.integers(LEAST_BITS, MOST_BITS)) | draw(st.booleans()) << 31
        return setting.name, struct.pack("<I", bits)
    return setting.name, struct.pack("<I", draw(st.integers(int(setting.low), int(setting.high))))


PRINTABLE = "".join(map(chr, range(ord(" "), ord("~") + 1)))


@effort(max_examples=examples(2000), deadline=None)
@given(case=legal())
@example(case=("craft_name", b"-"))
@example(case=("craft_name", b" "))
@example(case=("craft_name", b'"'))
@example(case=("craft_name", b'""'))
@example(case=("craft_name", b'"quoted"'))
@example(case=("craft_name", b"                "))
@example(case=("mode3", struct.pack("<I", 7 << 8)))
def test_a_value_reads_back_to_the_bit_when_it_was_written(scripted: Any, case: tuple[str, bytes]) -> None:
    name, value = case
    assert parse(scripted, name, format_(scripted, name, value)) == (Error.GOOD, padded(value))


@effort(max_examples=examples(500), deadline=None)
@given(name=st.sampled_from([setting.name for setting in SETTINGS]), text=st.text(PRINTABLE, max_size=40))
@example(name="roll_rate", text="1e100")
@example(name="roll_rate", text="99999999")
def test_what_is_taken_is_written_as_it_was_meant_when_it_is_any_text(
    scripted: Any, name: str, text: str
) -> None:
    error, value = parse(scripted, name, text)
    if error is Error.GOOD:
        assert parse(scripted, name, format_(scripted, name, value)) == (Error.GOOD, value)


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("motor_protocol", "dshot300", 0),
        ("motor_protocol", "DShot600", 1),
        ("filter2_kind", "Notch", 5),
        ("filter2_kind", "5", 5),
        ("crash_detection", "OFF", 0),
        ("crash_detection", "on", 1),
        ("gyro_rate_hz", "8000", 8000),
        ("gyro_rate_hz", "4294967295", 4294967295),
        ("gyro_rate_hz", " 0 ", 0),
        ("failsafe_throttle", "0.25", 0.25),
        ("craft_name", "NF1", b"NF1"),
        ("craft_name", "a b", b"a b"),
        ("craft_name", "-", b""),
        ("craft_name", "", b""),
        ("craft_name", '""', b""),
        ("craft_name", '"-"', b"-"),
        ("craft_name", '" x "', b" x "),
        ("craft_name", "--", b"--"),
        ("craft_name", '"', b'"'),
        ("mode1", "arm aux1 1700 2100", ModeRange(Mode.ARM, 1, 1700, 2100).packed),
        ("mode1", "ARM  AUX12   900 925  AND", ModeRange(Mode.ARM, 12, 900, 925, True).packed),
        ("mode1", "trial aux9 900 900", ModeRange(Mode.TRIAL, 9, 900, 900).packed),
        ("mode1", "None", 0),
    ],
)
def test_a_text_is_read_when_it_says_a_value(
    scripted: Any, name: str, text: str, value: int | float | bytes
) -> None:
    assert parse(scripted, name, text) == (Error.GOOD, padded(value))


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("motor_protocol", "dshot", Error.NO_CHOICE),
        ("motor_protocol", "dshot600x", Error.NO_CHOICE),
        ("motor_protocol", "dshot300,dshot600", Error.NO_CHOICE),
        ("motor_protocol", "dshot300 dshot600", Error.NO_CHOICE),
        ("motor_protocol", "3", Error.NO_CHOICE),
        ("motor_protocol", "", Error.NO_CHOICE),
        ("motor_protocol", ",", Error.NO_CHOICE),
        ("gyro_rate_hz", "", Error.NOT_WHOLE),
        ("gyro_rate_hz", "-", Error.NOT_WHOLE),
        ("gyro_rate_hz", "4000.0", Error.NOT_WHOLE),
        ("gyro_rate_hz", "4000 Hz", Error.NOT_WHOLE),
        ("gyro_rate_hz", "0x10", Error.NOT_WHOLE),
        ("gyro_rate_hz", "-1", Error.TOO_LARGE),
        ("gyro_rate_hz", "4294967296", Error.TOO_LARGE),
        ("gyro_rate_hz", "9" * 60, Error.TOO_LARGE),
        ("failsafe_throttle", "nan", Error.NO_NUMBER),
        ("failsafe_throttle", "inf", Error.NO_NUMBER),
        ("failsafe_throttle", "0,2", Error.NO_NUMBER),
        ("failsafe_throttle", "", Error.NO_NUMBER),
        ("craft_name", "x" * 17, Error.TOO_LONG),
        ("craft_name", '"' + "x" * 17 + '"', Error.TOO_LONG),
        ("craft_name", "x" * 90, Error.TOO_LONG),
        ("mode1", "", Error.MODE_FORM),
        ("mode1", "arm", Error.MODE_FORM),
        ("mode1", "arm aux1 1700", Error.MODE_FORM),
        ("mode1", "arm aux1 1700 2100 or", Error.MODE_FORM),
        ("mode1", "arm aux1 1700 2100 and and", Error.MODE_FORM),
        ("mode1", "none aux1 1700 2100", Error.MODE_NAME),
        ("mode1", "angle aux1 1700 2100", Error.MODE_NAME),
        ("mode1", "a aux1 1700 2100", Error.MODE_NAME),
        ("mode1", "arm aux0 1700 2100", Error.MODE_AUX),
        ("mode1", "arm aux13 1700 2100", Error.MODE_AUX),
        ("mode1", "arm aux 1700 2100", Error.MODE_AUX),
        ("mode1", "arm 1 1700 2100", Error.MODE_AUX),
        ("mode1", "arm aux1 1701 2100", Error.MODE_GRID),
        ("mode1", "arm aux1 875 2100", Error.MODE_GRID),
        ("mode1", "arm aux1 900 2125", Error.MODE_GRID),
        ("mode1", "arm aux1 900 x", Error.MODE_GRID),
        ("mode1", "arm aux1 2100 1700", Error.MODE_ORDER),
    ],
)
def test_a_text_is_refused_with_its_reason_when_it_says_no_value(
    scripted: Any, name: str, text: str, error: Error
) -> None:
    assert parse(scripted, name, text)[0] is error


def test_each_choice_is_written_by_name_and_read_by_it(scripted: Any) -> None:
    for setting in SETTINGS:
        for number, choice in enumerate(setting.choices):
            assert format_(scripted, setting.name, struct.pack("<I", number)) == choice
            assert parse(scripted, setting.name, choice.upper()) == (Error.GOOD, padded(number))


@effort(max_examples=examples(300), deadline=None)
@given(case=legal())
def test_what_a_setting_takes_it_takes_as_text(scripted: Any, case: tuple[str, bytes]) -> None:
    name, value = case
    index, setting = BY_NAME[name]
    settings = scripted.new("struct nf_settings *")
    scripted.lib.settings_default(settings)
    held = scripted.new("union setting_value *")
    scripted.ffi.buffer(held)[:] = padded(value)
    taken = scripted.lib.settings_set(settings, index, held) == Refusal.NONE
    if taken and setting.kind != "text":
        scripted.lib.settings_get(settings, index, held)
        kept = bytes(scripted.ffi.buffer(held))
        assert parse(scripted, name, format_(scripted, name, kept)) == (Error.GOOD, kept)
