"""Renders the contract's messages as docs/msp.md: `python -m toolchain.rendering.msp_page FILE`."""

from __future__ import annotations

import sys
from pathlib import Path

from toolchain.contract import (
    LAYOUTS,
    MSP_API_MAJOR,
    MSP_API_MINOR,
    MSP_PORT_COUNT,
    Msp,
    MspField,
    MspGroup,
    Refusal,
)
from toolchain.files import write_text

HEAD = f"""# MSP

The firmware answers the MultiWii Serial Protocol, versions 1 and 2, API {MSP_API_MAJOR}.{MSP_API_MINOR},
for {MSP_PORT_COUNT} peers at once: on UART1 and, where the setting `uart3_function` says so, UART3 of a
board; two TCP clients of the host program. While armed no setting is changed and no flash is written.

## From the command line
```
neuroflight msp --port /dev/ttyUSB0 status          # state, what forbids arming and how to lift it
neuroflight msp --port tcp:127.0.0.1:5761 tasks     # the processor's time
neuroflight msp --port /dev/ttyUSB0 get roll_expo   # a setting with its limits; all without a name
neuroflight msp --port /dev/ttyUSB0 set roll_expo=0.1 mode1="arm aux1 1700 2100" --save --reboot
neuroflight msp --port /dev/ttyUSB0 diff > mine.txt # what differs from the defaults
neuroflight msp --port /dev/ttyUSB0 restore mine.txt
neuroflight msp --port /dev/ttyUSB0 stream --rate 500 --seconds 10 --out flight.npz
neuroflight msp --port /dev/ttyUSB0 faults --ack
```
A mistake gives one line and exit code 1; wrong words on the command line give 2, Ctrl-C 130, but `stream`
ends by it with 0.

## The Betaflight app
It connects over the board's UART1 at `msp_baud`, or over TCP at the host program. FC_VARIANT tells it `BTFL`
while the setting `msp_variant` is `btfl`; IDENTITY tells who this is in any case. While it says so by
ARMING_DISABLE nothing arms; its motor test is opened by the same message, under the firmware's own interlock.
SAFETY tells the reasons against arming by this project's numbers, STATUS and STATUS_EX by the ecosystem's.

This page is written by `python -m toolchain.rendering.msp_page docs/msp.md`.

## Refusals
A refused request is answered by an error frame; for a message that changes something its payload is a
reason (u8) and a detail (i16).

| reason | number |
|---|---|
"""
MESSAGES = """
## Messages
Numbers are little-endian. `counted` is a text behind its length (u8).

| number | message | direction | payload |
|---|---|---|---|
"""


def msp_page() -> str:
    """The text of the page, a row a message and direction, by number."""
    refusals = "".join(f"| {r.name.lower()} | {int(r)} |\n" for r in Refusal)
    told = {layout.message for layout in LAYOUTS}
    rows = [
        (int(layout.message), _row(layout.message, layout.direction.value, layout.fields))
        for layout in LAYOUTS
    ]
    rows += [
        (int(message), f"| {message:d} | {message.name} | | |\n") for message in Msp if message not in told
    ]
    return HEAD + refusals + MESSAGES + "".join(row for _, row in sorted(rows, key=lambda pair: pair[0]))


def _row(message: Msp, direction: str, fields: tuple[MspField | MspGroup, ...]) -> str:
    return (
        f"| {message:d} | {message.name} | {direction} | {', '.join(_field(field) for field in fields)} |\n"
    )


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
        return f"{field.name} ({times}: {inner})"
    count = f"[{field.count}]" if field.count > 1 else ""
    unit = f" [{field.unit}]" if field.unit else ""
    meaning = f" ({field.meaning})" if field.meaning else ""
    return f"{field.name}:{field.kind}{count}{unit}{meaning}".replace("|", "or")


if __name__ == "__main__":
    write_text(Path(sys.argv[1]), msp_page())
