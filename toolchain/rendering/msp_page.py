"""Renders the contract's messages as docs/reference/msp.md, which `python -m tests.reference` writes.

The prose stands in templates/msp_page.md.j2; the commands of the command line are read from the firmware's
table.
"""

from __future__ import annotations

import re
from pathlib import Path

from neuroflight.toolchain.contract import (
    ARMING_FLAG_FAILSAFE,
    ARMING_FLAG_SWITCH,
    ARMING_FLAGS,
    LAYOUTS,
    MOTOR_TEST_MAX,
    MOTOR_TEST_SUM_MAX,
    MOTOR_TEST_TIMEOUT_MS,
    MSP_API_MAJOR,
    MSP_API_MINOR,
    MSP_PORT_COUNT,
    MSP_STREAM_RATE_MAX_HZ,
    ArmingReason,
    Bound,
    Direction,
    FallbackCause,
    FirmwareError,
    FlightState,
    GyroHealth,
    LogDevice,
    LogError,
    LogState,
    Msp,
    MspField,
    MspGroup,
    MspHow,
    Refusal,
    StopCause,
    Task,
)
from neuroflight.toolchain.contract.msp_messages import access_of
from neuroflight.toolchain.contract.msp_table import Access, MspWhen
from neuroflight.toolchain.rendering.jinja import render

PROSE = "msp_page.md.j2"
COMMANDS = Path(__file__).resolve().parents[2] / "firmware" / "src" / "command_line" / "commands.c"
COMMAND = re.compile(r'\{ "(\w+)", "([^"]*)",\s*"([^"]*)"')
EXAMPLES = (
    ("board info", "who it is, which policy it flies, what forbids arming"),
    ("board status", "state, what forbids arming and how to lift it, battery, receiver"),
    ("board tasks", "the processor's time"),
    ("board settings get roll_expo", "a setting with its limits; all without a name"),
    ('board settings set roll_expo=0.1 mode1="arm aux1 1700 2100" --save --reboot', ""),
    ("board settings diff > mine.txt", "what differs from the defaults"),
    ("board settings dump > all.txt", "all settings"),
    (
        "board settings restore mine.txt",
        "that, defaults beside it, checked and stored; --keep leaves the rest",
    ),
    (
        "board settings import betaflight.txt",
        "what of Betaflight's `diff all` has a counterpart: shown, asked for, stored",
    ),
    ("board settings save", "stores what `set` without --save has changed"),
    ("board settings defaults --save", "every setting to its default; asks, unless --yes is given"),
    ("board stream --rate 500 --seconds 10 --out flight.npz", "or .csv; a table without --out"),
    ("board calibrate", "the gyro's bias anew; the aircraft lies still"),
    ("board faults --ack", "the last fault, and that you know of it"),
    ("board acknowledge", "all faults, and a policy that was refused in flight"),
    ("board reboot", "starts it anew, waits until it answers"),
    ("board reboot --rom", "starts the boot loader in the chip's ROM instead, for `board rescue`"),
)
PROGRAM = "neuroflight "
COLUMN = 58  # where an example's comment begins, if it fits
REFUSALS = {
    Refusal.NONE: "of no refusal",
    Refusal.ARMED: "the motors are armed or under test; or, for what needs the state disarmed, it is another",
    Refusal.PAYLOAD: "a length or a value that the message does not take",
    Refusal.INDEX: "there is none of that number",
    Refusal.RANGE: "beyond a setting's limits",
    Refusal.CONFLICT: "it does not fit the policy or the settings beside it",
    Refusal.FLASH: "flash did not take it; what was stored before still holds",
    Refusal.ORDER: "something has to come before it: opening, beginning, reading",
    Refusal.BLOB: "the policy is none for this image",
    Refusal.SEQUENCE: "the policy is not newer than the one that stays",
    Refusal.ABSENT: "this build, or its settings, have no such thing",
    Refusal.SPOILT: "stored, but not all: some of a change before it was refused",
    Refusal.IMAGE: "the image is none for the board's other bank, or not whole, or not the one that was told",
    Refusal.LOG: "the device that keeps the logs failed",
}
SHORT = {
    MspWhen.ALWAYS: "always",
    MspWhen.STOPPED: "disarmed",
    MspWhen.STORING: "stores",
    MspWhen.NEVER: "",
}


NUMBERED = {
    "state": FlightState,
    "stop cause": StopCause,
    "fallback cause": FallbackCause,
    "gyro health": GyroHealth,
    "task": Task,
    "device of the log": LogDevice,
    "state of the log": LogState,
    "error of the log": LogError,
    "error of a policy or an image": FirmwareError,
}


def commands() -> list[tuple[str, str, str]]:
    """Return name, arguments and meaning of each command of the command line, from the firmware's `help`."""
    return COMMAND.findall(COMMANDS.read_text())


def msp_page() -> str:
    """Render the page; messages by number, a row for each direction."""
    parts = {
        "api": f"{MSP_API_MAJOR}.{MSP_API_MINOR}",
        "ports": "Two" if MSP_PORT_COUNT == 2 else str(MSP_PORT_COUNT),
        "examples": "\n".join(_example(words, meaning) for words, meaning in EXAMPLES),
        "test_max": f"{MOTOR_TEST_MAX * 100:g}",
        "test_sum": f"{MOTOR_TEST_SUM_MAX * 100:g}",
        "test_timeout": str(MOTOR_TEST_TIMEOUT_MS),
        "stream_max": str(MSP_STREAM_RATE_MAX_HZ),
        "commands": "".join(_command(*command) for command in commands()),
        "refusals": "".join(
            f"| `{reason.name.lower()}` | {reason:d} | {REFUSALS[reason]} |\n" for reason in Refusal
        ),
        "numbered": "".join(
            f"| {name} | {', '.join(f'{number:d} {number.name}' for number in numbers)} |\n"
            for name, numbers in NUMBERED.items()
        ),
        "reasons": "".join(f"| {r:d} | {r.name} | {ARMING_FLAGS[r]} |\n" for r in ArmingReason),
        "flag_failsafe": str(ARMING_FLAG_FAILSAFE),
        "flag_switch": str(ARMING_FLAG_SWITCH),
        "messages": "".join(_messages()),
    }
    return render(PROSE, **parts).rstrip("\n") + "\n"


def _example(words: str, meaning: str) -> str:
    line = PROGRAM + words
    if not meaning:
        return line
    return f"{line:{COLUMN}} # {meaning}" if len(line) < COLUMN else f"{line}  # {meaning}"


def _command(name: str, arguments: str, meaning: str) -> str:
    words = f"{name} {arguments}".strip().replace("|", "\\|")
    return f"| `{words}` | {meaning} |\n"


def _messages() -> list[str]:
    """Return the rows, requests before replies."""
    keys = {(layout.message, layout.direction): layout for layout in LAYOUTS}
    rows = []
    for message in sorted(Msp):
        for direction in Direction:
            layout = keys.get((message, direction))
            if layout is None:
                continue
            asks = direction is Direction.REQUEST or (message, Direction.REQUEST) not in keys
            access = access_of(message) if asks else None
            rows.append(_row(message, direction, _payload(layout.fields), access))
            if message.row.acknowledges and direction is Direction.REQUEST:
                rows[-1] = _row(message, direction, "empty: reads", access)
                rows.append(_row(message, direction, _payload(layout.fields), message.row.acknowledges))
    return rows


def _row(message: Msp, direction: Direction, payload: str, access: Access | None) -> str:
    when = SHORT[access.when] if access else ""
    reasons = ", ".join(f"`{reason.name.lower()}`" for reason in access.refusals) if access else ""
    note = f"{reasons}: {access.note}" if access and access.note and reasons else reasons
    if access and access.note and not reasons:
        note = access.note
    return f"| {message:d} | {message.name} | {direction.value} | {payload} | {when} | {note} |\n"


def _payload(fields: tuple[MspField | MspGroup, ...]) -> str:
    return ", ".join(_field(field) for field in fields) or "empty"


def _field(field: MspField | MspGroup) -> str:
    if isinstance(field, MspGroup):
        inner = ", ".join(_field(part) for part in field.fields)
        times = (
            "u8 count, then each"
            if field.counted
            else f"{field.count} times"
            if field.count
            else "up to the end"
        )
        meaning = f"; {field.meaning}" if field.meaning else ""
        return f"{field.name} ({times}: {inner}{meaning})"
    count = f"[{field.count}]" if field.count > 1 else ""
    unit = f" [{field.unit}]" if field.unit else ""
    words = "; ".join(word for word in (field.meaning, _bound(field.bound)) if word)
    meaning = f" ({words})" if words else ""
    fixed = ""
    if field.bound is not None and field.bound.how is MspHow.CONSTANT:
        fixed = f" = {field.bound.number}"
    return f"{field.name}:{field.kind}{count}{unit}{fixed}{meaning}".replace("|", "or")


def _bound(bound: Bound | None) -> str:
    """Describe the setting or rule behind a field of a configuration message, if it is a single one."""
    if bound is None:
        return ""
    return "unused" if bound.how is MspHow.UNUSED else f"`{bound.setting}`" if bound.setting else ""
