"""Settings as MAVLink parameters: which there are, and what a value looks like in PARAM_VALUE and PARAM_SET.

A parameter's float field holds a number of type REAL32 as it is. For a whole number there are two customs:
its four bytes stand in the field (PX4, MAVSDK, QGroundControl), or its value as a float (ArduPilot and its
tools). What is told as REAL32 is read right by both, so whole numbers are told so, too, unless the reader has
asked how they are encoded and was told: in bytes, as INT32. A mode range, packed, takes 25 bits, more than a
float32 keeps: what does not fit comes as INT32 in any case. Texts are left out.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.link.requests import SettingInfo
from neuroflight.flash.mavlink.parameter_names import parameter_name
from neuroflight.flash.settings.text import Value

REAL32, INT32 = mavlink.MAV_PARAM_TYPE_REAL32, mavlink.MAV_PARAM_TYPE_INT32
# How the first bytes of the field hold a whole number, by param_type.
_WHOLE = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<B",
    mavlink.MAV_PARAM_TYPE_INT8: "<b",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H",
    mavlink.MAV_PARAM_TYPE_INT16: "<h",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    INT32: "<i",
}
FLOAT32_WHOLE_MAX = 1 << 24  # up to here a float32 has every whole number


@dataclass(frozen=True)
class Parameter:
    """A setting under its MAVLink name."""

    name: str  # in capitals, as it is told
    setting: str
    whole: bool
    index: int  # among the parameters
    number: int  # among the settings


class TypeMismatchError(ValueError):
    """The param_type does not fit this parameter."""


def parameter_list(settings: Iterable[SettingInfo]) -> tuple[Parameter, ...]:
    """Return the parameters of a firmware's settings, in its order."""
    kept = [(number, info) for number, info in enumerate(settings) if info.kind != "text"]
    return tuple(
        Parameter(parameter_name(info.name).upper(), info.name, info.whole, index, number)
        for index, (number, info) in enumerate(kept)
    )


def encode_value(parameter: Parameter, value: Value, *, in_bytes: bool) -> tuple[float, int]:
    """Return the float field that tells `value`, and its param_type. in_bytes: whole numbers bytewise."""
    if not parameter.whole or (not in_bytes and float(value) <= FLOAT32_WHOLE_MAX):
        return float(value), REAL32
    (field,) = struct.unpack("<f", struct.pack("<i", int(value)))
    return float(field), INT32


def came_in_bytes(field: float, told: int) -> bool:
    """Return True if the field of a PARAM_SET holds a whole number bytewise. told: the param_type.

    Clients that put the value there as a float may tell INT32 as well; but no float that is a whole number
    has the bytes of one that a setting can have.
    """
    return told != REAL32 and not (math.isfinite(field) and (field == 0 or abs(field) >= 1))


def decode_value(parameter: Parameter, field: float, told: int) -> float:
    """Decode the value that a PARAM_SET asks for; the firmware checks its limits.

    told: the param_type beside it. Raises ValueError that says what is wrong.
    """
    if told not in (_WHOLE.keys() | {REAL32}) if parameter.whole else told != REAL32:
        wanted = "INT32 or REAL32" if parameter.whole else "REAL32"
        raise TypeMismatchError(f"got param_type {told}, expected {wanted}")
    value = field
    if in_bytes := came_in_bytes(field, told):
        (value,) = struct.unpack_from(_WHOLE[told], struct.pack("<f", field))
    if not math.isfinite(value):
        raise ValueError("the value is no number")
    if not parameter.whole:
        return value
    if value < 0 or value != int(value):
        raise ValueError(f"got {value:g}, expected a whole number from 0")
    if not in_bytes and value > FLOAT32_WHOLE_MAX:
        raise ValueError(f"got {value:.0f} as a float, which may have been rounded: expected INT32")
    return float(value)
