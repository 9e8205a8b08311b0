"""The tables of docs/reference/msp.md, which `python -m tests.reference` writes into the page.

Messages and numbers come from the contract, the commands of the command line from the firmware's table.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import Bound, Direction, Msp, MspField, MspGroup, MspHow
from neuroflight.toolchain.contract.msp_messages import access_of
from neuroflight.toolchain.contract.msp_table import Access, MspWhen

COMMANDS = Path(__file__).resolve().parents[2] / "firmware" / "src" / "command_line" / "commands.c"
COMMAND = re.compile(r'\{ "(\w+)", "([^"]*)",\s*"([^"]*)"')
SHORT = {
    MspWhen.ALWAYS: "always",
    MspWhen.STOPPED: "disarmed",
    MspWhen.STORING: "stores",
    MspWhen.NEVER: "",
}
NUMBERED = {
    "state": contract.FlightState,
    "stop cause": contract.StopCause,
    "fallback cause": contract.FallbackCause,
    "gyro health": contract.GyroHealth,
    "gyro chip": contract.GyroChip,
    "task": contract.Task,
    "device of the log": contract.LogDevice,
    "state of the log": contract.LogState,
    "error of the log": contract.LogError,
    "error of a policy or an image": contract.FirmwareError,
}


def commands() -> list[tuple[str, str, str]]:
    """Return name, arguments and meaning of each command of the command line, from the firmware's `help`."""
    return COMMAND.findall(COMMANDS.read_text())


def msp_tables() -> dict[str, str]:
    """Render the page's tables, by their names there; messages by number, a row for each direction."""
    typed = (
        (f"{name} {arguments}".strip().replace("|", "\\|"), meaning)
        for name, arguments, meaning in commands()
    )
    numbered = (
        (name, ", ".join(f"{number:d} {number.name}" for number in numbers))
        for name, numbers in NUMBERED.items()
    )
    reasons = (
        (f"{reason:d}", reason.name, str(contract.ARMING_FLAGS[reason])) for reason in contract.ArmingReason
    )
    heads = ("number", "message", "direction", "payload", "when", "refused as")
    return {
        "commands": table(("command", "what it does"), ((f"`{words}`", meaning) for words, meaning in typed)),
        "numbers": table(("what", "numbers"), numbered),
        "reasons": table(("SAFETY", "reason", "STATUS"), reasons),
        "messages": table(heads, _messages()),
    }


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [f"| {' | '.join(row)} |" for row in (heads, *rows)]
    return "\n".join([lines[0], f"|{'---|' * len(heads)}", *lines[1:]])


def _messages() -> Iterator[tuple[str, ...]]:
    """Yield the rows, requests before replies."""
    keys = {(layout.message, layout.direction): layout for layout in contract.LAYOUTS}
    for message in sorted(Msp):
        for direction in Direction:
            if (layout := keys.get((message, direction))) is None:
                continue
            payload = ", ".join(map(_field, layout.fields)) or "empty"
            asks = direction is Direction.REQUEST or (message, Direction.REQUEST) not in keys
            access = access_of(message) if asks else None
            if message.row.acknowledges and direction is Direction.REQUEST:
                yield _row(message, direction, "empty: reads", access)
                access = message.row.acknowledges
            yield _row(message, direction, payload, access)


def _row(message: Msp, direction: Direction, payload: str, access: Access | None) -> tuple[str, ...]:
    when, note = "", ""
    if access is not None:
        when = SHORT[access.when]
        reasons = ", ".join(f"`{reason.name.lower()}`" for reason in access.refusals)
        note = ": ".join(filter(None, (reasons, access.note)))
    return f"{message:d}", message.name, direction.value, payload, when, note


def _field(field: MspField | MspGroup) -> str:
    if isinstance(field, MspGroup):
        inner = ", ".join(_field(part) for part in field.fields)
        repeated = f"{field.count} times" if field.count else "up to the end"
        times = "u8 count, then each" if field.counted else repeated
        meaning = f"; {field.meaning}" if field.meaning else ""
        return f"{field.name} ({times}: {inner}{meaning})"
    count = f"[{field.count}]" if field.count > 1 else ""
    unit = f" [{field.unit}]" if field.unit else ""
    words = "; ".join(word for word in (field.meaning, _bound(field.bound)) if word)
    meaning = f" ({words})" if words else ""
    constant = field.bound is not None and field.bound.how is MspHow.CONSTANT
    fixed = f" = {field.bound.number}" if field.bound is not None and constant else ""
    return f"{field.name}:{field.kind}{count}{unit}{fixed}{meaning}".replace("|", "or")


def _bound(bound: Bound | None) -> str:
    """Describe the setting or rule behind a field of a configuration message, if it is a single one."""
    if bound is None:
        return ""
    return "unused" if bound.how is MspHow.UNUSED else f"`{bound.setting}`" if bound.setting else ""
