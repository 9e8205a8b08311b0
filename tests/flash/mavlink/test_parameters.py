"""Settings as parameters: names, types, values in a float's four bytes."""

from __future__ import annotations

import math
import struct

import pytest

from flash.mavlink.parameter_names import NAME_MAX, SHORT, parameter_name
from flash.mavlink.parameters import (
    INT32,
    REAL32,
    UINT32,
    Parameter,
    decode_value,
    encode_value,
    parameter_list,
    parameter_value,
)
from flash.requests import SettingInfo
from toolchain.contract import SETTINGS

INFOS = [SettingInfo(len(SETTINGS), s.name, s.unit, s.low, s.high, s.default, s.kind) for s in SETTINGS]
ALL = parameter_list(INFOS)
WHOLE = Parameter("whole", "whole", UINT32, 0, 0)
REAL = Parameter("real", "real", REAL32, 1, 1)


def as_float(value: int) -> float:
    (field,) = struct.unpack("<f", struct.pack("<I", value))
    return float(field)


def test_every_setting_has_a_name_of_its_own_that_mavlink_has_room_for() -> None:
    names = {parameter_name(setting.name): setting.name for setting in SETTINGS}
    assert len(names) == len(SETTINGS)
    assert all(len(name) <= NAME_MAX and name.isascii() and name.isprintable() for name in names)


def test_only_long_names_are_shortened_and_all_of_them_by_the_table() -> None:
    long = {setting.name for setting in SETTINGS if len(setting.name) > NAME_MAX}
    assert set(SHORT) == long, "a setting of more than 16 characters needs a row of SHORT"


def test_a_long_name_of_a_newer_firmware_keeps_its_beginning() -> None:
    first, second = parameter_name("some_setting_of_tomorrow"), parameter_name("some_setting_of_today")
    assert first != second
    assert first.startswith("some_settin_") and len(first) == NAME_MAX


def test_all_settings_but_texts_are_parameters_in_their_order() -> None:
    kinds = {setting.name: setting.kind for setting in SETTINGS}
    assert [one.setting for one in ALL] == [name for name, kind in kinds.items() if kind != "text"]
    assert [one.index for one in ALL] == list(range(len(ALL)))
    assert [SETTINGS[one.number].name for one in ALL] == [one.setting for one in ALL]
    assert {one.type for one in ALL if kinds[one.setting] == "float"} == {REAL32}
    assert {one.type for one in ALL if kinds[one.setting] in ("uint32_t", "mode")} == {UINT32}


@pytest.mark.parametrize("parameter", ALL, ids=lambda one: one.setting)
def test_limits_survive_a_message_when_encoded_and_decoded(parameter: Parameter) -> None:
    setting = SETTINGS[parameter.number]
    for value in (setting.low, setting.high, setting.default):
        (kept,) = struct.unpack("<f", struct.pack("<f", encode_value(parameter, value)))
        stored = struct.unpack("<f", struct.pack("<f", value))[0] if parameter.type == REAL32 else value
        assert decode_value(parameter, kept, parameter.type) == stored


def test_a_whole_number_is_its_four_bytes_in_the_message() -> None:
    message = parameter_value(WHOLE, 0x01234567, 2)
    assert struct.pack("<f", message.param_value) == bytes.fromhex("67452301")
    assert (message.param_id, message.param_type) == ("whole", UINT32)
    assert (message.param_count, message.param_index) == (2, 0)


def test_a_whole_number_is_taken_from_a_script_that_knows_floats_alone() -> None:
    assert decode_value(WHOLE, 4000.0, REAL32) == 4000
    assert decode_value(WHOLE, as_float(4000), INT32) == 4000


@pytest.mark.parametrize(
    ("parameter", "field", "told"),
    [
        (WHOLE, 1.5, REAL32),
        (WHOLE, -1.0, REAL32),
        (WHOLE, 2.0**25, REAL32),
        (WHOLE, math.nan, REAL32),
        (WHOLE, math.inf, REAL32),
        (REAL, math.nan, REAL32),
        (REAL, -math.inf, REAL32),
        (REAL, 1.0, UINT32),
        (WHOLE, as_float(0xBF800000), INT32),
        (WHOLE, 1.0, 1),
        (WHOLE, 1.0, 255),
    ],
)
def test_a_value_is_refused_when_it_is_none(parameter: Parameter, field: float, told: int) -> None:
    with pytest.raises(ValueError, match=r"expected|no number"):
        decode_value(parameter, field, told)
