"""flash/settings/text.py and settings_text.c write the same text of a value, and each reads the other's."""

from __future__ import annotations

import struct
from typing import Any

from hypothesis import example, given
from hypothesis import settings as effort
from hypothesis import strategies as st

from neuroflight.flash.settings.text import Value, as_float32, parse_value, value_text
from neuroflight.toolchain.contract import (
    AUX_COUNT,
    MODE_LOW_US,
    MODE_STEP_US,
    MODE_STEPS,
    SETTING_TEXT_BYTES,
    SETTINGS,
    Mode,
    ModeRange,
    Setting,
)
from neuroflight.toolchain.contract.settings import Span
from tests.firmware.storage.test_settings_text import BY_NAME, PRINTABLE, Error, format_, padded, parse
from tests.sampling import examples


@st.composite
def mode_ranges(draw: st.DrawFn) -> int:
    """A mode range as a setting holds it; also none."""
    low, high = sorted(draw(st.tuples(st.integers(0, MODE_STEPS), st.integers(0, MODE_STEPS))))
    if low == high:
        return 0
    low_us, high_us = MODE_LOW_US + low * MODE_STEP_US, MODE_LOW_US + high * MODE_STEP_US
    mode, aux = draw(st.sampled_from(Mode)), draw(st.integers(1, AUX_COUNT))
    return ModeRange(mode, aux, low_us, high_us, draw(st.booleans())).packed


def floats(span: Setting | Span) -> st.SearchStrategy[float]:
    """Within the limits, as a setting holds them; 0 without a sign."""
    return st.floats(as_float32(span.low), as_float32(span.high), width=32).map(as_float32)


def legal(setting: Setting) -> st.SearchStrategy[Value]:
    """Values within the limits of a setting, in either style of rates."""
    if setting.kind == "text":
        return st.text(PRINTABLE, max_size=SETTING_TEXT_BYTES)
    if setting.kind == "mode":
        return mode_ranges()
    spans: list[Setting | Span] = [setting] if setting.betaflight is None else [setting, setting.betaflight]
    if setting.kind == "float":
        return st.sampled_from(spans).flatmap(floats)
    return st.sampled_from(spans).flatmap(lambda span: st.integers(int(span.low), int(span.high)))


def stored(value: Value, setting: Setting) -> bytes:
    """As the firmware holds it."""
    if isinstance(value, str):
        return padded(value.encode())
    return padded(struct.pack("<f", value) if setting.kind == "float" else int(value))


CASES = st.sampled_from(SETTINGS).flatmap(lambda setting: st.tuples(st.just(setting), legal(setting)))
NAME = SETTINGS[BY_NAME["craft_name"][0]]


@effort(max_examples=examples(2000), deadline=None)
@given(case=CASES)
@example(case=(SETTINGS[BY_NAME["filter4_hz"][0]], 1024.53125))  # half way between two texts
@example(case=(SETTINGS[BY_NAME["yaw_max"][0]], 1.0))  # a whole of one style of rates, 1 deg/s of the other
@example(case=(NAME, "-"))
@example(case=(NAME, '"'))
@example(case=(NAME, '""'))
@example(case=(NAME, " a "))
@example(case=(NAME, "none"))
def test_both_write_the_same_text_and_read_it_back(scripted: Any, case: tuple[Setting, Value]) -> None:
    setting, value = case
    text = value_text(setting.name, value)
    assert format_(scripted, setting.name, stored(value, setting)) == text
    assert parse(scripted, setting.name, text) == (Error.GOOD, stored(value, setting))
    assert stored(parse_value(setting.name, text), setting) == stored(value, setting)


def test_both_agree_on_each_setting_at_its_default_and_its_ends(scripted: Any) -> None:
    for setting in SETTINGS:
        if setting.kind in ("text", "mode"):
            continue
        for number in (setting.low, setting.high, setting.default):
            value = as_float32(number) if setting.kind == "float" else int(number)
            text = format_(scripted, setting.name, stored(value, setting))
            assert value_text(setting.name, value) == text
            assert stored(parse_value(setting.name, text), setting) == stored(value, setting)


@effort(max_examples=examples(1000), deadline=None)
@given(case=CASES, style=st.sampled_from([str.upper, str.lower, str.title]))
def test_both_read_the_same_when_capitals_are_others(
    scripted: Any, case: tuple[Setting, Value], style: Any
) -> None:
    setting, value = case
    text = value_text(setting.name, value)
    if setting.kind != "text":
        text = style(text)
    assert parse(scripted, setting.name, text) == (Error.GOOD, stored(value, setting))
    assert stored(parse_value(setting.name, text), setting) == stored(value, setting)
