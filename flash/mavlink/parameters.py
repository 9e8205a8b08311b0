"""Settings as MAVLink parameters: which there are, and what a value looks like in PARAM_VALUE and PARAM_SET.

A parameter's float field holds a REAL32 as the number, a UINT32 as its four bytes (the protocol's bytewise
encoding): a mode range, packed, takes 25 bits, more than a float32 keeps. Texts are left out.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from flash.mavlink.parameter_names import parameter_name
from flash.requests import SettingInfo
from flash.setting_text import Value

REAL32, UINT32, INT32 = (
    mavlink.MAV_PARAM_TYPE_REAL32,
    mavlink.MAV_PARAM_TYPE_UINT32,
    mavlink.MAV_PARAM_TYPE_INT32,
)
FLOAT32_WHOLE_MAX = 1 << 24  # up to here a float32 has every whole number


@dataclass(frozen=True)
class Parameter:
    """A setting under its MAVLink name."""

    name: str
    setting: str
    type: int  # MAV_PARAM_TYPE
    index: int  # among the parameters
    number: int  # among the settings


def parameter_list(settings: Iterable[SettingInfo]) -> tuple[Parameter, ...]:
    """The parameters that the settings of a firmware are, in its order."""
    kept = [(number, info) for number, info in enumerate(settings) if info.kind != "text"]
    return tuple(
        Parameter(parameter_name(info.name), info.name, UINT32 if info.whole else REAL32, index, number)
        for index, (number, info) in enumerate(kept)
    )


def parameter_value(parameter: Parameter, value: Value, count: int) -> Any:  # noqa: ANN401
    """PARAM_VALUE, of so many parameters in all."""
    return mavlink.MAVLink_param_value_message(
        parameter.name.encode(), encode_value(parameter, value), parameter.type, count, parameter.index
    )


def encode_value(parameter: Parameter, value: Value) -> float:
    """The float field that tells `value`."""
    if parameter.type == REAL32:
        return float(value)
    (field,) = struct.unpack("<f", struct.pack("<I", int(value)))
    return float(field)


def decode_value(parameter: Parameter, field: float, told: int) -> float:
    """The value that a PARAM_SET asks for; its limits are the firmware's business.

    told: the param_type beside it, which says how `field` is to be read. A whole number may come as REAL32
    too, from scripts that know no other type. Raises ValueError that says what is wrong.
    """
    if told == REAL32:
        if not math.isfinite(field):
            raise ValueError("the value is no number")
        if parameter.type == UINT32 and not (field.is_integer() and 0 <= field <= FLOAT32_WHOLE_MAX):
            raise ValueError(f"got {field:g}, expected a whole number from 0")
        return field
    if told in (UINT32, INT32) and parameter.type == UINT32:
        (value,) = struct.unpack("<I" if told == UINT32 else "<i", struct.pack("<f", field))
        if value < 0:
            raise ValueError(f"got {value}, expected a whole number from 0")
        return float(value)
    wanted = "REAL32" if parameter.type == REAL32 else "UINT32"
    raise ValueError(f"got param_type {told}, expected {wanted}")
