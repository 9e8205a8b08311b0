"""The messages of MSP as rows of C.

Of configuration messages, one row a kind of field, its number for each field of the messages, one a message
with its counterpart. Most fields are alike (a byte 0, for what this firmware has
not), so that kinds save flash.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import Bound, Msp, MspField, MspGroup, MspHow, MspLayout
from neuroflight.toolchain.contract.msp_fields import NUMBERS
from neuroflight.toolchain.contract.msp_table import Answers, MspWhen, Payload

WIDTHS = {
    "u8": "1, 0",
    "i8": "1, 1",
    "u16": "2, 0",
    "i16": "2, 1",
    "u32": "4, 0",
    "i32": "4, 1",
}  # bytes, signed
CHOICE_BITS, CHOICE_COUNT_MAX = 4, 3  # of the numbers that stand for choices, as msp_fields.c unpacks them
_SETTINGS = {setting.name: index for index, setting in enumerate(contract.SETTINGS)}


@dataclass(frozen=True)
class MspTables:
    """The rows of the macros NF_MSP_FIELDS, NF_MSP_FIELD_ORDER and NF_MSP_CONFIGURATIONS."""

    fields: tuple[str, ...]  # each once: bytes, signed, how, index, number, gain
    order: tuple[int, ...]  # of the messages' fields: indices of `fields`
    configurations: tuple[
        str, ...
    ]  # GET, its first field in the order and their number; SET, first, number, required; read first


def render_replies() -> list[str]:
    """Return a row for each message that msp_replies.c answers: name, and name of its function."""
    return [
        f"{message.name}, {message.name.lower()}" for message in Msp if message.row.answers is Answers.REPLY
    ]


def render_commands() -> list[str]:
    """Return a row for each payload that msp_commands.c carries out: when, its least and most bytes."""
    rows = []
    for message in (m for m in Msp if m.row.answers is Answers.COMMAND):
        row, name = message.row, message.name.lower()
        shortest, longest = _sizes(row.request)
        if row.acknowledges is None:
            rows.append(_command(message, name, row.access.when, shortest, longest))
        else:
            rows.append(_command(message, name, row.access.when, shortest, shortest))
            rows.append(_command(message, f"{name}_acknowledge", row.acknowledges.when, longest, longest))
    return rows


def _command(message: Msp, function: str, when: MspWhen, shortest: int, longest: int) -> str:
    return f"{message.name}, {when.name}, {shortest}, {longest}, {function}"


def _sizes(request: Payload | None) -> tuple[int, int]:
    """Return the shortest and the longest payload; ValueError where its fields do not tell."""
    if request is None:
        return 0, 0
    if request.sizes is not None:
        return request.sizes
    sizes = []
    for field in request.fields:
        if isinstance(field, MspGroup) or field.kind == "counted" or field.count == 0:
            raise ValueError(f"field {field.name} may be of any length: say the payload's `sizes`")
        sizes.append(struct.calcsize(f"<{NUMBERS.get(field.kind, 's')}") * field.count)
    return sum(sizes[: request.required]), sum(sizes)


def render_configurations() -> MspTables:
    """Render all configuration messages. Raises ValueError for a field that is bound to nothing."""
    fields: list[str] = []
    rows: list[str] = []
    for pair in contract.CONFIGURATIONS:
        get = _rows(pair.reply, setting=False)
        told = _place(fields, get)
        if pair.request is None:
            rows.append(f"NF_MSP_{pair.reply.message.name}, {told}, 0, 0, 0, 0, 0")
            continue
        set_ = _rows(pair.request, setting=True)
        brought = told if set_ == get else _place(fields, set_)
        required = sum(field.count for field in _fields(pair.request, needed=True))
        name = pair.request.message.name
        rows.append(
            f"NF_MSP_{pair.reply.message.name}, {told}, NF_MSP_{name}, {brought}, "
            f"{required}, {int(pair.read_first)}"
        )
    kinds = list(dict.fromkeys(fields))
    return MspTables(tuple(kinds), tuple(map(kinds.index, fields)), tuple(rows))


def _fields(layout: MspLayout, needed: bool = False) -> Iterator[MspField]:
    for field in layout.fields[: layout.needed] if needed else layout.fields:
        if not isinstance(field, MspField) or field.bound is None:
            raise ValueError(
                f"{layout.message.name}: field {field.name} of a configuration is bound to nothing"
            )
        yield field


def _rows(layout: MspLayout, setting: bool) -> list[str]:
    rows = []
    for field in _fields(layout):
        assert field.bound is not None
        bound = Bound(MspHow.UNUSED) if setting and field.told_only else field.bound
        rows += [f"{WIDTHS[field.kind]}, {_bound(bound)}"] * field.count
    return rows


def _place(table: list[str], rows: list[str]) -> str:
    """Append rows; returns where they begin, and how many they are."""
    table += rows
    return f"{len(table) - len(rows)}, {len(rows)}"


def _bound(bound: Bound) -> str:
    """Format how a field is bound, index of the setting or source, number, gain."""
    index = (
        int(bound.source) if bound.how is MspHow.SOURCE else _SETTINGS[bound.setting] if bound.setting else 0
    )
    number = int(bound.offset) if bound.how is MspHow.SCALED else bound.number
    for place, value in enumerate(bound.choices):
        assert value < 1 << CHOICE_BITS and place < CHOICE_COUNT_MAX, f"{bound.setting}: 16 bits hold no more"
        number |= value << CHOICE_BITS * place
    return f"NF_MSP_HOW_{bound.how.name}, {index}, {number}, {float(bound.gain)!r}f"
