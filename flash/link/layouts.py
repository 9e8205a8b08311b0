"""Packs and unpacks the payload of any message that the contract has a layout of.

Values are a dict, by the names of the fields: numbers; a tuple where a field is several; text, `bytes`; a
list of dicts where fields are repeated.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from neuroflight.flash.link.payload import Reader
from neuroflight.toolchain.contract import Msp, MspField, MspGroup, MspLayout, layout_of
from neuroflight.toolchain.contract.msp_fields import NUMBERS
from neuroflight.toolchain.errors import LinkError

Values = dict[str, Any]


def decode(layout: MspLayout, payload: bytes, *, whole: bool = False) -> Values:
    """Unpack the fields of `payload`. Missing fields of newer versions are left out, bytes behind the known
    ones ignored.

    whole: nothing may be missing or left over. Raises LinkError.
    """
    reader = Reader(layout.message, payload)
    needed = len(layout.fields) if whole else layout.needed
    values: Values = {}
    for index, field in enumerate(layout.fields):
        if index >= needed and reader.at == len(payload):
            break
        values[field.name] = _read(reader, field)
    if whole and reader.at != len(payload):
        raise LinkError(
            f"MSP {layout.message.name} has {len(payload)} bytes, expected {reader.at}; "
            "the firmware speaks another layout: bring it and this tool to the same version"
        )
    return values


def read(message: Msp, payload: bytes, upto: str = "") -> Values:
    """Unpack a reply. upto: a field that must be there though the layout requires less. Raises LinkError."""
    layout = layout_of(message)
    if upto:
        names = [field.name for field in layout.fields]
        layout = replace(layout, required=names.index(upto) + 1)
    return decode(layout, payload)


def _read(reader: Reader, field: MspField | MspGroup) -> object:
    if isinstance(field, MspGroup):
        return list(_groups(reader, field))
    left = len(reader.payload) - reader.at
    match field.kind:
        case "text":
            return reader.text(field.count or left)
        case "counted":
            return reader.counted_text()
        case "bytes":
            return reader.bytes(field.count or left)
    values = reader.fields(f"{field.count}{NUMBERS[field.kind]}")
    return values[0] if field.count == 1 else values


def _groups(reader: Reader, group: MspGroup) -> Iterator[Values]:
    count = reader.fields("B")[0] if group.counted else group.count
    done = 0
    while done < count if group.counted or group.count else reader.at < len(reader.payload):
        yield {field.name: _read(reader, field) for field in group.fields}
        done += 1


def encode(layout: MspLayout, values: Mapping[str, Any]) -> bytes:
    """Pack `values` into a payload; the last fields may be missing if only newer versions have them.

    Raises ValueError for a field that is missing, unknown or out of range.
    """
    unknown = set(values) - {field.name for field in layout.fields}
    if unknown:
        raise ValueError(f"MSP {layout.message.name} has no field {', '.join(sorted(unknown))}")
    parts = []
    for index, field in enumerate(layout.fields):
        if field.name not in values:
            if index < layout.needed or any(f.name in values for f in layout.fields[index:]):
                raise ValueError(f"MSP {layout.message.name} lacks {field.name}")
            break
        parts.append(_pack(layout, field, values[field.name]))
    return b"".join(parts)


def _pack(layout: MspLayout, field: MspField | MspGroup, value: Any) -> bytes:  # noqa: ANN401
    where = f"MSP {layout.message.name}, {field.name}"
    if isinstance(field, MspGroup):
        return _pack_groups(layout, field, value, where)
    if field.kind in ("text", "counted", "bytes"):
        return _pack_text(field, value, where)
    items: Sequence[Any] = (value,) if field.count == 1 else tuple(value)
    if len(items) != field.count:
        raise ValueError(f"{where}: {len(items)} numbers, expected {field.count}")
    try:
        return struct.pack(f"<{field.count}{NUMBERS[field.kind]}", *items)
    except struct.error as error:
        raise ValueError(f"{where}: {value!r} is no {field.kind} ({error})") from None


def _pack_groups(layout: MspLayout, group: MspGroup, value: Sequence[Values], where: str) -> bytes:
    if group.count and len(value) != group.count:
        raise ValueError(f"{where}: {len(value)} entries, expected {group.count}")
    if group.counted and len(value) > 0xFF:
        raise ValueError(f"{where}: {len(value)} entries, expected at most 255")
    head = bytes([len(value)]) if group.counted else b""
    return head + b"".join(_pack(layout, field, item[field.name]) for item in value for field in group.fields)


def _pack_text(field: MspField, value: str | bytes, where: str) -> bytes:
    data = value if isinstance(value, bytes) else value.encode("latin-1", "replace")
    if field.kind == "counted":
        if len(data) > 0xFF:
            raise ValueError(f"{where}: {len(data)} characters, expected at most 255")
        return bytes([len(data)]) + data
    if (field.count and len(data) > field.count) or (
        field.kind == "bytes" and field.count and len(data) < field.count
    ):
        raise ValueError(f"{where}: {len(data)} characters, expected {field.count}")
    return data.ljust(field.count, b"\0")
