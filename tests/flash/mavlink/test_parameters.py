"""Settings as parameters: names, types, values in a float's four bytes."""

from __future__ import annotations

import math
import struct

import pytest

from neuroflight.flash.link.requests import SettingInfo
from neuroflight.flash.mavlink.parameter_names import NAME_MAX, parameter_name
from neuroflight.flash.mavlink.parameters import (
    FLOAT32_WHOLE_MAX,
    INT32,
    REAL32,
    Parameter,
    TypeMismatchError,
    came_in_bytes,
    decode_value,
    encode_value,
    parameter_list,
)
from neuroflight.toolchain.contract import SETTINGS

INFOS = [SettingInfo(len(SETTINGS), s.name, s.unit, s.low, s.high, s.default, s.kind) for s in SETTINGS]
ALL = parameter_list(INFOS)
WHOLE = Parameter("WHOLE", "whole", True, 0, 0)
REAL = Parameter("REAL", "real", False, 1, 1)
UINT8, INT8, UINT16, INT16, UINT32 = range(1, 6)  # MAV_PARAM_TYPE
INT64, REAL64 = 8, 10


def as_float(value: int) -> float:
    (field,) = struct.unpack("<f", struct.pack("<I", value))
    return float(field)


def float32(value: float) -> float:
    """Return the value as a message's float32 field keeps it."""
    (kept,) = struct.unpack("<f", struct.pack("<f", value))
    return float(kept)


def test_every_setting_has_a_name_of_its_own_that_mavlink_has_room_for() -> None:
    names = {parameter_name(setting.name).upper(): setting.name for setting in SETTINGS}
    assert len(names) == len(SETTINGS)
    assert all(len(name) <= NAME_MAX and name.isascii() and name.isprintable() for name in names)


def test_only_long_names_are_shortened_and_all_of_them_by_the_table() -> None:
    long = {setting.name for setting in SETTINGS if len(setting.name) > NAME_MAX}
    short = {setting.name for setting in SETTINGS if setting.parameter != setting.name}
    assert short == long, "a setting of more than 16 characters needs a row of _PARAMETERS in settings.py"


def test_a_long_name_of_a_newer_firmware_keeps_its_beginning() -> None:
    first, second = parameter_name("some_setting_of_tomorrow"), parameter_name("some_setting_of_today")
    assert first != second
    assert first.startswith("some_settin_") and len(first) == NAME_MAX


def test_all_settings_but_texts_are_parameters_in_their_order() -> None:
    kinds = {setting.name: setting.kind for setting in SETTINGS}
    assert [one.setting for one in ALL] == [name for name, kind in kinds.items() if kind != "text"]
    assert [one.index for one in ALL] == list(range(len(ALL)))
    assert [SETTINGS[one.number].name for one in ALL] == [one.setting for one in ALL]
    assert {one.setting for one in ALL if one.whole} == {
        name for name, kind in kinds.items() if kind in ("uint32_t", "mode")
    }
    assert all(one.name == one.name.upper() for one in ALL)


@pytest.mark.parametrize("in_bytes", [False, True])
def test_limits_survive_a_message_when_encoded_and_decoded(in_bytes: bool) -> None:
    for parameter in ALL:
        setting = SETTINGS[parameter.number]
        for value in (setting.low, setting.high, setting.default):
            field, told = encode_value(parameter, value, in_bytes=in_bytes)
            stored = value if parameter.whole else float32(value)
            assert decode_value(parameter, float32(field), told) == stored, setting.name
            assert told in (REAL32, INT32), setting.name
            if not parameter.whole or (not in_bytes and value <= FLOAT32_WHOLE_MAX):
                assert (field, told) == (value, REAL32), f"{setting.name}: read right by who takes a float"


def test_a_whole_number_is_its_four_bytes_for_who_reads_it_so() -> None:
    field, told = encode_value(WHOLE, 0x01234567, in_bytes=True)
    assert (struct.pack("<f", field), told) == (bytes.fromhex("67452301"), INT32)


def test_what_a_float_cannot_hold_is_told_in_bytes_to_everybody() -> None:
    assert encode_value(WHOLE, FLOAT32_WHOLE_MAX, in_bytes=False) == (FLOAT32_WHOLE_MAX, REAL32)
    field, told = encode_value(WHOLE, FLOAT32_WHOLE_MAX + 1, in_bytes=False)
    assert (decode_value(WHOLE, field, told), told) == (FLOAT32_WHOLE_MAX + 1, INT32)


@pytest.mark.parametrize("told", [UINT8, INT8, UINT16, INT16, UINT32, INT32])
@pytest.mark.parametrize("value", [0, 1, 100])
def test_a_whole_number_is_taken_in_either_custom_whatever_its_type(told: int, value: int) -> None:
    assert decode_value(WHOLE, as_float(value), told) == value
    assert decode_value(WHOLE, float(value), told) == value
    assert decode_value(WHOLE, float(value), REAL32) == value
    assert came_in_bytes(as_float(value), told) == (value != 0)
    assert not came_in_bytes(float(value), told)


def test_no_setting_has_bytes_that_could_be_a_number_meant_as_a_float() -> None:
    highest = max(setting.high for setting in SETTINGS if setting.kind in ("uint32_t", "mode"))
    assert as_float(int(highest)) < 1.0 and came_in_bytes(as_float(int(highest)), INT32)


@pytest.mark.parametrize(
    ("parameter", "field", "told"),
    [
        (WHOLE, 1.5, REAL32),
        (WHOLE, -1.0, REAL32),
        (WHOLE, 2.0**25, REAL32),
        (WHOLE, 2.0**25, INT32),
        (WHOLE, as_float(0xFF), INT8),
        (WHOLE, math.nan, REAL32),
        (WHOLE, math.inf, REAL32),
        (REAL, math.nan, REAL32),
        (REAL, -math.inf, REAL32),
        (WHOLE, as_float(0xBF800000), INT32),
        (WHOLE, -1.0, INT32),
        (WHOLE, 1.5, INT32),
    ],
)
def test_a_value_is_refused_when_it_is_none(parameter: Parameter, field: float, told: int) -> None:
    with pytest.raises(ValueError, match=r"expected|no number"):
        decode_value(parameter, field, told)


@pytest.mark.parametrize(
    ("parameter", "told"),
    [(REAL, UINT32), (REAL, INT32), (REAL, 0), (WHOLE, INT64), (WHOLE, REAL64), (WHOLE, 0), (WHOLE, 255)],
)
def test_a_type_is_refused_that_the_parameter_cannot_be_set_with(parameter: Parameter, told: int) -> None:
    with pytest.raises(TypeMismatchError, match="expected"):
        decode_value(parameter, 1.0, told)
