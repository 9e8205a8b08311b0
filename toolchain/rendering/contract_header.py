"""Renders the contract as the C header nf_contract.h.

    python -m neuroflight.toolchain.rendering.contract_header FILE

Every public constant of the contract becomes `NF_<NAME>`: integers as they are, floats with an f
suffix, strings quoted, tuples as initializers with a `_COUNT`, memory regions as `_ADDRESS` and `_SIZE`
(several also as an initializer), and the layout of a packet (`..._FORMAT`) as its size `..._BYTES`. The
headers of the policy blob and of an image become structs whose offsets the C compiler checks.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from functools import cache
from pathlib import Path

from neuroflight.toolchain import contract
from neuroflight.toolchain.rendering.jinja import render
from neuroflight.toolchain.rendering.msp_fields import render_commands, render_configurations, render_replies

# What only Python speaks: the metadata of an ONNX file, a torch checkpoint, names for printing, where
# switches are by default.
PYTHON_ONLY = (
    *("META_", "CHECKPOINT_", "AXES", "OBSERVATION_BLOCKS", "MODEL_BLOCKS", "ESC_BLOCKS"),
    *("POLICY_FILE_", "POLICY_FORMAT_"),
    *("IMAGE_FILE_", "FAULT_REGISTERS"),
    *("GYRO_FILES", "SWITCH_ON_US", "CHANNEL_ARM", "CHANNEL_PID", "CHANNEL_BEEPER", "CHANNEL_TRIAL"),
)
TABLES = (
    *("POLICY_BLOB_FIELDS", "IMAGE_FIELDS", "IMAGE_STATE_FIELDS"),
    *("SETTINGS", "CONFIGURATIONS", "LAYOUTS", "STRUCTS", "BOARD_STRUCTS"),
)  # rendered as structs and tables


@dataclass(frozen=True)
class Member:
    """One enumerator; `meaning` is its comment, empty for none."""

    name: str
    value: int
    meaning: str = ""
    word: str = ""  # its name without the prefix


@dataclass(frozen=True)
class Enumeration:
    """One C enum with the comment above it."""

    name: str
    meaning: str
    members: tuple[Member, ...]
    names: str = ""  # of a macro that lists them by name, for texts; empty: none


@dataclass(frozen=True)
class BlobField:
    """One member of a struct that lies over bytes of flash; an array where `count` is above 1."""

    c_type: str
    name: str
    count: int
    comment: str
    offset: int  # from the blob's begin [bytes]
    size: int  # [bytes]


def blob_header_fields() -> tuple[BlobField, ...]:
    """Return the header of the policy blob for the macros of templates/blob_header.j2."""
    return _struct_fields(contract.POLICY_BLOB_FIELDS)


def _struct_fields(source: tuple[contract.HeaderField, ...]) -> tuple[BlobField, ...]:
    """Return the struct's members in order, without gaps."""
    fields, offset = [], 0
    for field in source:
        comment = f"{field.unit}: {field.meaning}" if field.unit else field.meaning
        size = struct.calcsize("<" + field.format)
        fields.append(BlobField(field.c_type, field.name, field.count, comment, offset, size))
        offset += size
    return tuple(fields)


def render_contract() -> str:
    """Render the text of nf_contract.h. Deterministic: the contract in its own order."""
    return render(
        "nf_contract.h.j2",
        defines=[define for name, value in _constants() for define in _defines(f"NF_{name}", value)],
        enums=_enumerations(),
        blocks=[
            {"name": block.name, "code": block.code, "width": int(block.width)}
            for block in contract.OBSERVATION_BLOCKS
            if block.in_firmware
        ],
        blob_fields=blob_header_fields(),
        structs={
            name: _struct_fields(fields)
            for name, fields in (contract.STRUCTS | contract.BOARD_STRUCTS).items()
        },
        image_fields=_struct_fields(contract.IMAGE_FIELDS),
        image_state_fields=_struct_fields(contract.IMAGE_STATE_FIELDS),
        settings=[_setting(setting, setting) for setting in contract.SETTINGS],
        betaflight=[
            _setting(setting, setting.betaflight)
            for setting in contract.SETTINGS
            if setting.betaflight is not None
        ],
        choices=[
            (f"{setting.name}_{choice}".upper(), value)
            for setting in contract.SETTINGS
            if setting.choices[:2] != ("off", "on") and not setting.name.startswith("filter")
            for value, choice in enumerate(setting.choices)
        ],
        limits=_limits_used(),
        units=_UNITS,
        choice_lists=_CHOICES,
        msp=render_configurations(),
        msp_replies=render_replies(),
        msp_commands=render_commands(),
    )


def _choices(setting: contract.Setting) -> str:
    """Return the names of a setting's choices as the firmware has them."""
    return ",".join(setting.choices)


# Each once, as many settings share them; a setting has its number.
_UNITS = list(
    dict.fromkeys(span.unit for s in contract.SETTINGS for span in (s, s.betaflight) if span is not None)
)
_CHOICES = list(dict.fromkeys(map(_choices, contract.SETTINGS)))


def _setting(setting: contract.Setting, span: contract.Setting | contract.Span) -> dict[str, str | int]:
    """Return a row of the macros NF_SETTINGS..., with the limits of `span`."""
    return {
        "name": setting.name,
        "kind": setting.kind,
        "member": {
            "text": f"char {setting.name}[NF_SETTING_TEXT_BYTES]",
            "mode": f"uint32_t {setting.name}",
        }.get(setting.kind, f"{setting.kind} {setting.name}"),
        "choices": _CHOICES.index(_choices(setting)),
        "limits": _limits_used().index(_limits(setting, span)),
        "unit": _UNITS.index(span.unit),
        "comment": f"{span.unit}: {setting.meaning}" if span.unit else setting.meaning,
    }


def _limits(setting: contract.Setting, span: contract.Setting | contract.Span) -> str:
    """Format kind, limits and default."""
    return ", ".join((setting.kind, *(_number(setting, x) for x in (span.low, span.high, span.default))))


@cache
def _limits_used() -> tuple[str, ...]:
    """Return the limits of all settings, each once."""
    both = ((s, span) for s in contract.SETTINGS for span in (s, s.betaflight) if span is not None)
    return tuple(dict.fromkeys(_limits(setting, span) for setting, span in both))


def _number(setting: contract.Setting, value: float) -> str:
    return _literal(float(value)) if setting.kind == "float" else _literal(int(value))


def _constants() -> Iterator[tuple[str, object]]:
    for name, value in vars(contract).items():
        if name.isupper() and not name.startswith(("_", *PYTHON_ONLY, *TABLES)):
            yield name, value


def _defines(name: str, value: object) -> Iterator[tuple[str, str]]:
    """Yield name and value of each `#define`."""
    match value:
        case contract.Region():
            yield (f"{name}_ADDRESS", f"0x{value.address:08X}u")
            yield (f"{name}_SIZE", f"0x{value.size:X}u")
        case tuple() if all(isinstance(item, contract.Region) for item in value):
            yield (f"{name}_COUNT", str(len(value)))
            rows = ", ".join(f"{{ 0x{item.address:08X}u, 0x{item.size:X}u }}" for item in value)
            yield (name, f"{{ {rows} }}")
            for index, item in enumerate(value):
                yield from _defines(f"{name}_{index}", item)
        case tuple():
            yield (f"{name}_COUNT", str(len(value)))
            yield (name, "{ " + ", ".join(_literal(item) for item in value) + " }")
        case str() if name.endswith("_FORMAT"):
            yield (name.removesuffix("FORMAT") + "BYTES", str(struct.calcsize(value)))
        case _:
            yield (name, _literal(value))


def _literal(value: object) -> str:
    """Format `value` as a C constant. Large integers are addresses, magics and sizes: unsigned and hex."""
    match value:
        case int() if 0 <= value < 1 << 16:
            return str(value)
        case int() if 0 <= value < 1 << 32:
            return f"0x{value:X}u"
        case float():
            return f"{value!r}f"
        case str() if value.isascii() and value.isprintable() and not set(value) & set('"\\'):
            return f'"{value}"'
    raise TypeError(f"the contract holds {value!r}, which has no C constant")


def _enumerations() -> tuple[Enumeration, ...]:
    observation = tuple(
        Member(f"NF_OBSERVATION_{block.name.upper()}", block.code, f"{block.unit}: {block.meaning}")
        for block in contract.OBSERVATION_BLOCKS
    )
    return (
        Enumeration("nf_observation", "Codes of the observation blocks, with unit and meaning.", observation),
        _enumeration("nf_msp", "NF_MSP", contract.Msp),
        _enumeration("nf_msp_how", "NF_MSP_HOW", contract.MspHow),
        _enumeration("nf_msp_source", "NF_MSP_SOURCE", contract.MspSource),
        _enumeration("nf_dshot_command", "NF_DSHOT_COMMAND", contract.DshotCommand),
        _enumeration("nf_esc_told", "NF_ESC", contract.EscTold),
        _enumeration("nf_flight_state", "NF_FLIGHT", contract.FlightState, "NF_FLIGHT_STATES"),
        _enumeration("nf_arming_reason", "NF_ARMING_REASON", contract.ArmingReason, "NF_ARMING_REASONS"),
        _enumeration("nf_stop_cause", "NF_STOP", contract.StopCause, "NF_STOP_CAUSES"),
        _enumeration("nf_fallback_cause", "NF_FALLBACK", contract.FallbackCause, "NF_FALLBACK_CAUSES"),
        _enumeration("nf_gyro_health", "NF_GYRO_HEALTH", contract.GyroHealth, "NF_GYRO_HEALTHS"),
        _enumeration("gyro_chip", "GYRO", contract.GyroChip),
        _enumeration("board_alignment", "ALIGN", contract.Alignment),
        _enumeration("nf_task", "NF_TASK", contract.Task, "NF_TASKS"),
        _enumeration("nf_refusal", "NF_REFUSAL", contract.Refusal),
        _enumeration("nf_err", "NF", contract.FirmwareError),
        _enumeration("setting_kind", "SETTING", contract.SettingKind),
        _enumeration("fault_kind", "FAULT", contract.FaultKind),
        _enumeration("firmware_weights", "WEIGHTS", contract.Weights),
        _enumeration("log_edge", "LOG_EDGE", contract.LogEdge),
        _enumeration("log_sample_flag", "LOG_SAMPLE", contract.LogSampleFlag),
        _enumeration("nf_reboot", "NF_REBOOT", contract.Reboot),
        _enumeration("nf_mode", "NF_MODE", contract.Mode, "NF_MODES"),
        _enumeration("board_log", "BOARD_LOG", contract.BoardLog),
        _enumeration("nf_log_device", "NF_LOG_DEVICE", contract.LogDevice, "NF_LOG_DEVICES"),
        _enumeration("nf_log_state", "NF_LOG_STATE", contract.LogState, "NF_LOG_STATES"),
        _enumeration("nf_log_error", "NF_LOG_ERROR", contract.LogError, "NF_LOG_ERRORS"),
        _enumeration("nf_log_group", "NF_LOG_GROUP", contract.LogGroup),
        _enumeration("nf_log_event", "NF_LOG_EVENT", contract.LogEvent),
        _enumeration("nf_mix", "NF_MIX", contract.Mix),
        _enumeration("nf_filter_kind", "NF_FILTER", contract.FilterKind),
    )


def _enumeration(name: str, prefix: str, source: type[IntEnum | IntFlag], names: str = "") -> Enumeration:
    meaning = (source.__doc__ or "").splitlines()[0]
    members = tuple(Member(f"{prefix}_{item.name}", item.value, word=item.name or "") for item in source)
    return Enumeration(name, meaning, members, names)


if __name__ == "__main__":
    from neuroflight.toolchain.files import write_text

    write_text(Path(sys.argv[1]), render_contract())
