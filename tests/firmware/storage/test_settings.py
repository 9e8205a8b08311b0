"""settings.c: limits, names and forbidden combinations."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import pytest

from toolchain.contract import SETTINGS, Refusal, Setting, Span

COUNT = len(SETTINGS)
INDEX = {setting.name: index for index, setting in enumerate(SETTINGS)}
SMALLEST = 1e-45  # the float32 above 0


@pytest.fixture
def settings(scripted: Any) -> Any:
    made = scripted.new("struct nf_settings *")
    scripted.lib.settings_default(made)
    return made


def value_of(core: Any, setting: Setting, value: float) -> Any:
    name = "as_float" if setting.kind == "float" else "as_uint32_t"
    return core.new("union setting_value *", {name: value})


Put = Callable[[Any, str, float], int]


@pytest.fixture
def put(scripted: Any) -> Put:
    def call(settings: Any, name: str, value: float) -> int:
        raw = value_of(scripted, SETTINGS[INDEX[name]], value)
        return int(scripted.lib.settings_set(settings, INDEX[name], raw))

    return call


def float32(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def test_each_setting_is_the_contracts_when_asked_for(scripted: Any, settings: Any) -> None:
    for index, setting in enumerate(SETTINGS):
        info = scripted.lib.settings_info(index)
        member = "as_float" if setting.kind == "float" else "as_uint32_t"
        assert scripted.ffi.string(info.name).decode() == setting.name
        assert scripted.ffi.string(info.unit).decode() == setting.unit
        limits = [getattr(part, member) for part in (info.low, info.high, info.preset)]
        wanted = [setting.low, setting.high, setting.default]
        assert limits == [float32(number) if setting.kind == "float" else number for number in wanted]
        assert getattr(settings, setting.name) == limits[2]
        value = scripted.new("union setting_value *")
        scripted.lib.settings_get(settings, index, value)
        assert getattr(value, member) == limits[2]
        assert scripted.lib.settings_find(setting.name.encode()) == index


def test_nothing_is_known_when_the_index_or_the_name_is_none(scripted: Any) -> None:
    assert scripted.lib.settings_info(COUNT) == scripted.lib.settings_info(2**32 - 1) == scripted.ffi.NULL
    for name in (b"", b"gyro", b"gyro_rate_hz2", b"GYRO_RATE_HZ"):
        assert scripted.lib.settings_find(name) == COUNT


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda setting: setting.name)
def test_limits_may_be_taken_and_not_passed_when_set(
    scripted: Any, settings: Any, put: Put, setting: Setting
) -> None:
    for value in (setting.low, setting.high):
        assert put(settings, setting.name, value) == Refusal.NONE
        assert getattr(settings, setting.name) == pytest.approx(value, rel=1e-7)
    if setting.kind == "float":
        low, high = float32(setting.low), float32(setting.high)
        past = [low - max(abs(low) * 1e-7, SMALLEST), high + high * 2e-7, math.nan, math.inf, -math.inf]
    else:
        past = [setting.high + 1, 2**32 - 1]
        past += [setting.low - 1] if setting.low > 0 else []
    before = bytes(scripted.ffi.buffer(settings))
    for value in past:
        assert put(settings, setting.name, value) == Refusal.RANGE, value
        assert bytes(scripted.ffi.buffer(settings)) == before


def test_one_setting_alone_changes_when_set(scripted: Any, settings: Any, put: Put) -> None:
    before = {setting.name: getattr(settings, setting.name) for setting in SETTINGS}
    assert put(settings, "battery_scale", 12.5) == Refusal.NONE
    after = {setting.name: getattr(settings, setting.name) for setting in SETTINGS}
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
    "a low-pass that rings": (
        {"filter4_kind": 4, "filter4_q": 1.3},
        "filter1_kind",
        {"filter4_kind", "filter4_q"},
    ),
    "notch too wide": (
        {"filter1_kind": 5, "filter1_q": 0.39},
        "filter1_kind",
        {"filter1_kind", "filter1_q"},
    ),
    "dynamic notches too wide": (
        {"dynamic_notch_count": 3, "dynamic_notch_q": 1.1},
        "filter1_kind",
        {"dynamic_notch_count", "dynamic_notch_q"},
    ),
    "map": ({"map_roll": 1, "map_arm": 9}, "map_roll", {"map_roll", "map_arm"}),
    "map's ends": ({"map_beeper": 0}, "map_roll", {"map_beeper"}),
    "baud of no UART": ({"msp_baud": 100_000}, "msp_baud", {"msp_baud"}),
    "battery": ({"battery_low_v": 3.5}, "battery_warn_v", {"battery_low_v"}),
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
        {"filter2_kind": 1, "filter2_hz": 41.0},
        {"filter2_kind": 2, "filter2_hz": 53.0},
        {"filter2_kind": 3, "filter2_hz": 62.0},
        {"filter4_kind": 4, "filter4_q": 1.2},
        {"filter4_kind": 4, "filter4_q": 0.41},
        {"filter1_kind": 5, "filter1_q": 0.41},
        {"dynamic_notch_count": 3, "dynamic_notch_q": 1.3},
        {"dynamic_notch_low_hz": 30.0, "dynamic_notch_q": 0.5},  # none is flown
        {"map_roll": 15, "map_beeper": 0},
        {"battery_low_v": 3.4999},
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
    assert [told.low.as_float, told.high.as_float, told.preset.as_float] == [
        float32(number) for number in (span.low, span.high, span.default)
    ]
    assert scripted.ffi.string(told.unit).decode() == span.unit
    for value in (span.low, span.high):
        assert put(settings, rate.name, value) == Refusal.NONE
    for value in (span.high * 1.001, float32(span.low) - 1e-3, math.nan):
        assert put(settings, rate.name, value) == Refusal.RANGE
    assert getattr(settings, rate.name) == float32(span.high)


def test_rates_of_the_other_style_are_a_conflict_and_mended_when_they_were_put_there(
    scripted: Any, settings: Any
) -> None:
    settings.rates_style = BETAFLIGHT  # and 1000 as RC rate and as super rate
    assert scripted.lib.settings_conflict(settings) == INDEX["rates_style"]
    settings.deadband_us = 9
    scripted.lib.settings_mend(settings)
    assert (settings.rates_style, settings.roll_rate, settings.deadband_us) == (ACTUAL, 1000.0, 9)
