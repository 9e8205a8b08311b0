"""settings.c: limits, names and forbidden combinations."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    SETTING_LEAST,
    SETTING_TEXT_BYTES,
    SETTINGS,
    Mode,
    ModeRange,
    Refusal,
    Setting,
    Span,
)
from neuroflight.toolchain.policy.gyro_filters import GyroFilters

COUNT = len(SETTINGS)
INDEX = {setting.name: index for index, setting in enumerate(SETTINGS)}
SMALLEST = SETTING_LEAST  # number above 0


@pytest.fixture
def settings(scripted: Any) -> Any:
    made = scripted.new("struct nf_settings *")
    scripted.lib.settings_default(made)
    return made


def value_of(core: Any, setting: Setting, value: float | bytes) -> Any:
    return core.new("union setting_value *", {f"as_{setting.kind}": value})


Put = Callable[[Any, str, float | bytes], int]


@pytest.fixture
def put(scripted: Any) -> Put:
    def call(settings: Any, name: str, value: float | bytes) -> int:
        raw = value_of(scripted, SETTINGS[INDEX[name]], value)
        return int(scripted.lib.settings_set(settings, INDEX[name], raw))

    return call


def held(core: Any, settings: Any, setting: Setting) -> float | bytes:
    value = getattr(settings, setting.name)
    return bytes(core.ffi.buffer(value)) if setting.kind == "text" else float(value)


def float32(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def test_each_setting_is_the_contracts_when_asked_for(scripted: Any, settings: Any) -> None:
    for index, setting in enumerate(SETTINGS):
        info = scripted.lib.settings_info(index)
        member = f"as_{setting.kind}"
        assert scripted.ffi.string(info.name).decode() == setting.name
        assert scripted.ffi.string(scripted.lib.settings_unit(info)).decode() == setting.unit
        assert scripted.ffi.string(scripted.lib.settings_choices(info)).decode() == ",".join(setting.choices)
        span = scripted.lib.settings_limits(info)
        limits = [getattr(part, member) for part in (span.low, span.high, span.preset)]
        wanted = [setting.low, setting.high, setting.default]
        assert limits == [float32(number) if setting.kind == "float" else number for number in wanted]
        default = bytes(SETTING_TEXT_BYTES) if setting.kind == "text" else limits[2]
        assert held(scripted, settings, setting) == default
        value = scripted.new("union setting_value *")
        scripted.lib.settings_get(settings, index, value)
        told = bytes(scripted.ffi.buffer(value.as_text)) if setting.kind == "text" else getattr(value, member)
        assert told == default
        assert scripted.lib.settings_find(setting.name.encode()) == index


def test_nothing_is_known_when_the_index_or_the_name_is_none(scripted: Any) -> None:
    assert scripted.lib.settings_info(COUNT) == scripted.lib.settings_info(2**32 - 1) == scripted.ffi.NULL
    for name in (b"", b"gyro", b"gyro_rate_hz2", b"GYRO_RATE_HZ"):
        assert scripted.lib.settings_find(name) == COUNT


@pytest.mark.parametrize("text", [b"", b"x", b"Neuroflight NF-1", b" ~", b"sixteen letters!"])
def test_a_text_is_taken_when_it_is_printable(scripted: Any, settings: Any, put: Put, text: bytes) -> None:
    padded = text.ljust(SETTING_TEXT_BYTES, b"\0")
    assert put(settings, "craft_name", padded) == Refusal.NONE
    assert held(scripted, settings, SETTINGS[INDEX["craft_name"]]) == padded


@pytest.mark.parametrize("text", [b"a\nb", b"\x7f", b"\xe9", b"a\0b", b"\0" * 15 + b"x", b"#\x1b"])
def test_a_text_is_refused_when_it_is_not_printable(
    scripted: Any, settings: Any, put: Put, text: bytes
) -> None:
    before = bytes(scripted.ffi.buffer(settings))
    assert put(settings, "craft_name", text.ljust(SETTING_TEXT_BYTES, b"\0")) == Refusal.RANGE
    assert bytes(scripted.ffi.buffer(settings)) == before


RANGES = [
    ModeRange(Mode.ARM, 1, 900, 2100),
    ModeRange(Mode.TRIAL, 12, 2075, 2100, and_others=True),
    ModeRange(Mode.BEEPER, 5, 1300, 1300 + 25),
]


@pytest.mark.parametrize("range_", RANGES, ids=str)
def test_a_mode_range_is_taken_and_read_back_when_it_is_one(
    settings: Any, put: Put, range_: ModeRange
) -> None:
    assert put(settings, "mode7", range_.packed) == Refusal.NONE
    assert settings.mode7 == range_.packed
    assert ModeRange.unpack(settings.mode7) == range_


BAD_RANGES = {
    "mode unknown": 1,
    "no such channel": 12 << 8 | 48 << 18,
    "ends crossed": 30 << 12 | 29 << 18,
    "beyond the last step": 49 << 18,
    "bits that mean nothing": 48 << 18 | 1 << 25,
}


@pytest.mark.parametrize("packed", BAD_RANGES.values(), ids=BAD_RANGES)
def test_a_mode_range_is_refused_when_it_is_none(settings: Any, put: Put, packed: int) -> None:
    before = settings.mode7
    assert put(settings, "mode7", packed) == Refusal.RANGE
    assert settings.mode7 == before


NUMBERS = [setting for setting in SETTINGS if setting.kind in ("uint32_t", "float")]


def test_limits_may_be_taken_and_not_passed_when_set(scripted: Any, settings: Any, put: Put) -> None:
    for setting in NUMBERS:
        scripted.lib.settings_default(settings)
        name = setting.name
        for value in (setting.low, setting.high):
            assert put(settings, name, value) == Refusal.NONE, name
            assert getattr(settings, name) == pytest.approx(value, rel=1e-7), name
        if setting.kind == "float":
            low, high = float32(setting.low), float32(setting.high)
            past = [low - max(abs(low) * 1e-7, SMALLEST), high + high * 2e-7, math.nan, math.inf, -math.inf]
        else:
            past = [setting.high + 1, 2**32 - 1]
            past += [setting.low - 1] if setting.low > 0 else []
        before = bytes(scripted.ffi.buffer(settings))
        for value in past:
            assert put(settings, name, value) == Refusal.RANGE, (name, value)
            assert bytes(scripted.ffi.buffer(settings)) == before, name


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_number_is_0_when_it_is_too_small_for_a_text(
    scripted: Any, settings: Any, put: Put, sign: float
) -> None:
    below = float(np.nextafter(np.float32(SETTING_LEAST), np.float32(0)))
    setting = next(setting for setting in SETTINGS if setting.name == "board_roll_deg")
    for value, kept in ((SETTING_LEAST, SETTING_LEAST), (below, 0.0), (2.0**-149, 0.0)):
        assert put(settings, setting.name, sign * value) == Refusal.NONE
        assert held(scripted, settings, setting) == sign * kept
    assert put(settings, "filter1_q", sign * below) == Refusal.RANGE


def test_one_setting_alone_changes_when_set(scripted: Any, settings: Any, put: Put) -> None:
    before = {setting.name: held(scripted, settings, setting) for setting in SETTINGS}
    assert put(settings, "battery_scale", 12.5) == Refusal.NONE
    after = {setting.name: held(scripted, settings, setting) for setting in SETTINGS}
    assert after == {**before, "battery_scale": 12.5}


@pytest.mark.parametrize("index", [COUNT, 2**32 - 1])
def test_no_setting_changes_when_the_index_is_none(scripted: Any, settings: Any, index: int) -> None:
    before = bytes(scripted.ffi.buffer(settings))
    raw = scripted.new("union setting_value *", {"as_uint32_t": 0})
    assert scripted.lib.settings_set(settings, index, raw) == Refusal.INDEX
    assert bytes(scripted.ffi.buffer(settings)) == before


# What does not go together, and which settings mending sets to their defaults.
CONFLICTS = {
    "gyro rate unknown": ({"gyro_rate_hz": 3000}, "gyro_rate_hz", {"gyro_rate_hz"}),
    "filter at half the gyro rate": (
        {"gyro_rate_hz": 2000, "filter2_kind": 1, "filter2_hz": 1000.0},
        "filter2_kind",
        {"filter2_kind", "filter2_hz"},
    ),
    "first filter": (
        {"gyro_rate_hz": 1000, "filter1_kind": 5, "filter1_hz": 700.0, "filter1_q": 9.0},
        "filter1_kind",
        {"filter1_kind", "filter1_hz", "filter1_q"},
    ),
    "third filter": (
        {"filter3_kind": 4, "filter3_hz": 3000.0},
        "filter3_kind",
        {"filter3_kind", "filter3_hz"},
    ),
    "last filter": (
        {"filter4_kind": 2, "filter4_hz": 2000.0},
        "filter4_kind",
        {"filter4_kind", "filter4_hz"},
    ),
    "an output for two motors": ({"motor2_output": 3}, "motor1_output", {"motor2_output"}),
    "an output that this aircraft has not": ({"motor1_output": 8}, "motor1_output", {"motor1_output"}),
    "a PID gain behind a slow filter": (
        {"filter1_kind": 1, "filter1_hz": 79.0, "pid_pitch_d": 0.9},  # 2.01 ms
        "pid_roll_p",
        {"pid_pitch_d"},
    ),
    "UART3's speed": ({"uart3_baud": 9601}, "uart3_baud", {"uart3_baud"}),
    "notch limits": (
        {"dynamic_notch_low_hz": 600.0},
        "dynamic_notch_count",
        {"dynamic_notch_low_hz"},
    ),
    "notch at half the gyro rate": (
        {"dynamic_notch_count": 1, "dynamic_notch_high_hz": 2000.0},
        "dynamic_notch_count",
        {"dynamic_notch_count", "dynamic_notch_high_hz"},
    ),
    "one filter too slow": (
        {"filter2_kind": 1, "filter2_hz": 39.0},
        "filter1_kind",
        {"filter2_kind", "filter2_hz"},
    ),
    "filters too slow together": (
        {"filter1_kind": 3, "filter3_kind": 4, "dynamic_notch_low_hz": 90.0},
        "filter1_kind",
        {"filter1_kind", "filter3_kind", "dynamic_notch_low_hz"},
    ),
    "the mean behind a filter that is fast enough alone": (
        {"gyro_mean": 2, "filter2_kind": 1, "filter2_hz": 46.5},
        "filter1_kind",
        {"gyro_mean", "filter2_kind", "filter2_hz"},
    ),
    "the mean that a policy may bring behind notches at the rotors' turns": (
        {"motor_telemetry": 1, "rpm_filter_harmonics": 3, "rpm_filter_min_hz": 73.0},
        "filter1_kind",
        {"rpm_filter_harmonics", "rpm_filter_min_hz"},
    ),
    "a low-pass that rings": (
        {"filter4_kind": 4, "filter4_q": 1.11},
        "filter1_kind",
        {"filter4_kind", "filter4_q"},
    ),
    "notch too wide": (
        {"filter1_kind": 5, "filter1_q": 0.45},
        "filter1_kind",
        {"filter1_kind", "filter1_q"},
    ),
    "dynamic notches too wide": (
        {"dynamic_notch_count": 3, "dynamic_notch_q": 1.36},
        "filter1_kind",
        {"dynamic_notch_count", "dynamic_notch_q"},
    ),
    "map": ({"map_roll": 4, "map_aux1": 7}, "map_roll", {"map_roll", "map_aux1"}),
    "map's ends": ({"map_aux4": 0}, "map_roll", {"map_aux4"}),
    "baud of no UART": ({"msp_baud": 100_000}, "msp_baud", {"msp_baud"}),
    "battery": ({"battery_low_v": 3.5}, "battery_warn_v", {"battery_low_v"}),
    "hold": ({"failsafe_delay_ms": 300}, "failsafe_hold_ms", {"failsafe_delay_ms"}),
    "hold's end": (
        {"failsafe_hold_ms": 1000, "failsafe_delay_ms": 1000},
        "failsafe_hold_ms",
        {"failsafe_hold_ms"},
    ),
}


@pytest.mark.parametrize(("changes", "first", "mended"), CONFLICTS.values(), ids=CONFLICTS.keys())
def test_a_conflict_is_found_and_mended_when_settings_do_not_go_together(
    scripted: Any, settings: Any, put: Put, changes: dict[str, float], first: str, mended: set[str]
) -> None:
    assert put(settings, "yaw_expo", 0.5) == Refusal.NONE
    for name, value in changes.items():
        assert put(settings, name, value) == Refusal.NONE
    assert scripted.lib.settings_conflict(settings) == INDEX[first]
    scripted.lib.settings_mend(settings)
    assert scripted.lib.settings_conflict(settings) == COUNT
    assert settings.yaw_expo == 0.5
    for name, value in changes.items():
        kept = SETTINGS[INDEX[name]].default if name in mended else value
        assert getattr(settings, name) == float32(kept), name


def test_later_rules_see_the_mended_gyro_rate_when_several_are_broken(
    scripted: Any, settings: Any, put: Put
) -> None:
    for name, value in {"gyro_rate_hz": 1001, "filter1_kind": 1, "filter1_hz": 1500.0}.items():
        assert put(settings, name, value) == Refusal.NONE
    scripted.lib.settings_mend(settings)
    assert (settings.gyro_rate_hz, settings.filter1_kind, settings.filter1_hz) == (4000, 1, 1500.0)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        *({"gyro_rate_hz": rate} for rate in (1000, 2000, 4000, 8000)),
        {"filter1_hz": 4000.0},  # of no kind: not flown
        {"filter1_kind": 1, "filter1_hz": 1999.0},
        {"dynamic_notch_high_hz": 2000.0},  # none is flown
        {"filter2_kind": 1, "filter2_hz": 46.0},
        {"filter2_kind": 1, "filter2_hz": 46.5, "gyro_mean": 1},
        {"motor_telemetry": 1, "rpm_filter_harmonics": 3, "rpm_filter_min_hz": 76.0},
        {"filter2_kind": 1, "filter2_hz": 51.0, "gyro_mean": 2},
        {"filter2_kind": 2, "filter2_hz": 59.0},
        {"filter2_kind": 3, "filter2_hz": 70.0},
        {"filter4_kind": 4, "filter4_q": 1.09},
        {"filter4_kind": 4, "filter4_q": 0.46},
        {"filter1_kind": 5, "filter1_q": 0.46},
        {"dynamic_notch_count": 3, "dynamic_notch_q": 1.37},
        {"dynamic_notch_low_hz": 30.0, "dynamic_notch_q": 0.5},  # none is flown
        {"map_roll": 7, "map_aux4": 0},
        {"battery_low_v": 3.4999},
        {"failsafe_hold_ms": 199, "failsafe_delay_ms": 200},
        {"failsafe_delay_ms": 301},
    ],
)
def test_no_conflict_is_found_when_settings_go_together(
    scripted: Any, settings: Any, put: Put, changes: dict[str, float]
) -> None:
    for name, value in changes.items():
        assert put(settings, name, value) == Refusal.NONE
    assert scripted.lib.settings_conflict(settings) == COUNT
    before = bytes(scripted.ffi.buffer(settings))
    scripted.lib.settings_mend(settings)
    assert bytes(scripted.ffi.buffer(settings)) == before


@pytest.mark.parametrize(
    "text", ["rpm:3:76", "rpm:3:73", "rpm:2:62:5", "rpm:2:60:5", "rpm:1:100:2.1", "rpm:1:100:2"]
)
def test_notches_are_as_late_as_a_build_says(scripted: Any, settings: Any, put: Put, text: str) -> None:
    filters = GyroFilters.parse(text)
    for name, value in filters.settings.items():
        assert put(settings, name, value) == Refusal.NONE
    fits = scripted.lib.settings_conflict(settings) == COUNT
    try:
        filters.check(4, 1000)
    except ValueError:
        assert not fits
    else:
        assert fits


# --- The two styles of rates -------------------------------------------------------------------
RATES = [setting for setting in SETTINGS if setting.betaflight is not None]
STYLES = (ACTUAL, BETAFLIGHT) = SETTINGS[INDEX["rates_style"]].choices.index("actual"), 1


def span_of(setting: Setting, style: int) -> Setting | Span:
    """Its limits in that style."""
    if style == ACTUAL:
        return setting
    assert setting.betaflight is not None
    return setting.betaflight


def test_nine_rates_have_limits_of_their_own_when_the_style_is_betaflights() -> None:
    axes = ("roll", "pitch", "yaw")
    assert [each.name for each in RATES] == [
        f"{axis}_{what}" for axis in axes for what in ("rate", "max", "expo")
    ]


@pytest.mark.parametrize("style", STYLES)
def test_rates_are_at_the_defaults_of_the_style_when_it_changes(
    scripted: Any, settings: Any, put: Put, style: int
) -> None:
    if style == ACTUAL:
        assert put(settings, "rates_style", BETAFLIGHT) == Refusal.NONE
    for each in RATES:
        assert put(settings, each.name, 0.5) == Refusal.NONE
    assert put(settings, "deadband_us", 9) == Refusal.NONE
    assert put(settings, "rates_style", style) == Refusal.NONE
    for each in RATES:
        assert getattr(settings, each.name) == float32(span_of(each, style).default), each.name
    assert settings.deadband_us == 9
    assert scripted.lib.settings_conflict(settings) == COUNT


@pytest.mark.parametrize("style", STYLES)
def test_rates_are_kept_when_the_same_style_is_set_again(settings: Any, put: Put, style: int) -> None:
    put(settings, "rates_style", style)
    for each in RATES:
        assert put(settings, each.name, 0.25) == Refusal.NONE
    assert put(settings, "rates_style", style) == Refusal.NONE
    assert {getattr(settings, each.name) for each in RATES} == {0.25}


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("rate", RATES, ids=lambda rate: rate.name)
def test_a_rate_keeps_to_the_limits_of_its_style_when_set(
    scripted: Any, settings: Any, put: Put, style: int, rate: Setting
) -> None:
    put(settings, "rates_style", style)
    span = span_of(rate, style)
    told = scripted.lib.settings_info_beside(settings, INDEX[rate.name])
    limits = scripted.lib.settings_limits(told)
    assert [limits.low.as_float, limits.high.as_float, limits.preset.as_float] == [
        float32(number) for number in (span.low, span.high, span.default)
    ]
    assert scripted.ffi.string(scripted.lib.settings_unit(told)).decode() == span.unit
    for value in (span.low, span.high):
        assert put(settings, rate.name, value) == Refusal.NONE
    for value in (span.high * 1.001, float32(span.low) - 1e-3, math.nan):
        assert put(settings, rate.name, value) == Refusal.RANGE
    assert getattr(settings, rate.name) == float32(span.high)


def test_rates_of_the_other_style_are_a_conflict_and_mended_when_they_were_put_there(
    scripted: Any, settings: Any
) -> None:
    settings.rates_style = BETAFLIGHT  # and 70 as RC rate, 670 as super rate
    assert scripted.lib.settings_conflict(settings) == INDEX["rates_style"]
    settings.deadband_us = 9
    scripted.lib.settings_mend(settings)
    assert (settings.rates_style, settings.roll_rate, settings.deadband_us) == (ACTUAL, 70.0, 9)


@pytest.mark.parametrize(
    ("axis", "rate", "top", "flown"),
    [
        ("roll", 1.6, 0.8, True),  # 1600 deg/s
        ("pitch", 1.62, 0.8, False),
        ("yaw", 2.38, 0.0, True),  # 1582: what is above 2 counts 15.54 times
        ("roll", 2.38, 0.02, False),
        ("pitch", 0.07, 1.0, True),  # 1400: a hundredth is left of the divisor
        ("yaw", 0.09, 1.0, False),
    ],
)
def test_rates_that_ask_together_for_more_than_is_flown_are_a_conflict_of_their_axis(
    scripted: Any, settings: Any, put: Put, axis: str, rate: float, top: float, flown: bool
) -> None:
    put(settings, "rates_style", BETAFLIGHT)
    for name in ("roll", "pitch", "yaw"):
        put(settings, f"{name}_expo", 0.5)
    assert put(settings, f"{axis}_rate", rate) == Refusal.NONE
    assert put(settings, f"{axis}_max", top) == Refusal.NONE
    assert scripted.lib.settings_conflict(settings) == (COUNT if flown else INDEX[f"{axis}_rate"])
    scripted.lib.settings_mend(settings)
    assert settings.rates_style == BETAFLIGHT
    for name in ("roll", "pitch", "yaw"):
        numbers = [getattr(settings, f"{name}_{what}") for what in ("rate", "max", "expo")]
        here = (1.0, 0.7, 0.0) if not flown else (rate, top, 0.5)
        assert numbers == pytest.approx(here if name == axis else (1.0, 0.7, 0.5))
