"""Inputs of the USB targets: how hosts begin, what they ask, and what nobody should."""

from __future__ import annotations

import struct
from enum import IntEnum

IN, CLASS, INTERFACE, ENDPOINT = 0x80, 0x20, 0x01, 0x02
DEVICE_TEXT, CONFIGURATION = 0x302, 0x200


class Step(IntEnum):
    """What happens next; usb.c's table."""

    SETUP = 0
    GIVE_CONTROL = 1
    GIVE_DATA = 2
    TAKE = 3
    BUS = 4
    WORK = 5
    MEDIUM = 6
    COMMAND = 7


def step(kind: Step, amount: int = 0) -> bytes:
    return bytes([kind | amount << 3])


def setup(kind: int, request: int, value: int = 0, index: int = 0, length: int = 0) -> bytes:
    """A request's first stage."""
    return step(Step.SETUP) + struct.pack("<BBHHH", kind, request, value, index, length)


def take(endpoint: int, packets: int = 1) -> bytes:
    return step(Step.TAKE, endpoint + 3 * (packets - 1))


def give(data: bytes, *, control: bool = False) -> bytes:
    return step(Step.GIVE_CONTROL if control else Step.GIVE_DATA) + bytes([len(data)]) + data


def work(amount: int = 31, times: int = 1) -> bytes:
    return step(Step.WORK, amount) * times


def asked(*request: int) -> bytes:
    """A request with data to the host, and its status."""
    return setup(*request) + take(0, 3) + give(b"", control=True)


RESET, ENUMERATE, SUSPEND, RESUME = (step(Step.BUS, amount) for amount in range(4))
HALTED = setup(ENDPOINT, 3, 0, IN | 1) + take(0) + take(1) + setup(ENDPOINT, 1, 0, IN | 1) + take(0)


def _device_seeds() -> dict[str, bytes]:
    """Requests of chapter 9, whole and cut."""
    seeds = {
        "descriptors": b"".join(
            asked(IN, 6, value, 0, 255) for value in (0x100, 0x200, 0x300, 0x301, 0x302, 0x303)
        ),
        "cut": b"".join(asked(IN, 6, 0x200, 0, length) for length in (0, 1, 63, 64, 65, 75, 255)),
        "early_status": setup(IN, 6, CONFIGURATION, 0, 75) + take(0) + give(b"", control=True),
        "replaced": setup(IN, 6, CONFIGURATION, 0, 75) + take(0) + asked(IN, 8, 0, 0, 1),
        "reset_amid": setup(IN, 6, CONFIGURATION, 0, 75) + take(0) + RESET + take(0) + ENUMERATE,
        "unconfigured": setup(0, 9, 0) + take(0) + give(b"data") + work() + setup(0, 9, 1) + take(0),
        "status": asked(IN, 0, 0, 0, 2) + asked(IN | ENDPOINT, 0, 0, IN | 1, 2) + HALTED,
        "interface": asked(IN | INTERFACE, 10, 0, 0, 1) + setup(INTERFACE, 11, 0, 0) + take(0),
        "paused": SUSPEND + work() + RESUME + work(),
    }
    for request in range(13):
        seeds[f"request_{request}"] = setup(0, request) + take(0) + asked(IN, request, 0, 0, 64)
    return seeds


def usb_serial_seeds() -> dict[str, bytes]:
    """Standard requests, and hosts of a serial port."""
    ready, left = (setup(CLASS | INTERFACE, 0x22, state) + take(0) for state in (1, 0))
    coding = struct.pack("<IBBB", 115200, 0, 0, 8)
    return {
        **_device_seeds(),
        "coding": setup(CLASS | INTERFACE, 0x20, 0, 0, 7)
        + give(coding, control=True)
        + take(0)
        + asked(IN | CLASS | INTERFACE, 0x21, 0, 0, 7),
        "wrong_coding": setup(CLASS | INTERFACE, 0x20, 0, 0, 9) + give(coding, control=True) + take(0),
        "much": setup(CLASS | INTERFACE, 0x20, 0, 0, 128) + give(bytes(64), control=True) * 2 + take(0),
        "talk": ready + give(b"$M<\0\1\1") + work(31) + take(1, 9) + left + work(),
        "flood": ready + give(bytes(64)) * 20 + work(30, 60) + give(bytes(64)),
        "unread": ready + work(31, 4) + give(b"x") + left + take(1, 9) + ready + work(31) + take(1, 9),
        "pulled": ready + give(b"half") + work(31) + RESET + work() + ENUMERATE + work(31) + take(1, 9),
    }


def command(operation: int, data: bytes = b"", length: int = 0, *, to_host: bool = True) -> bytes:
    """A wrapper of that SCSI command, and what follows until its status."""
    block = (bytes([operation]) + data).ljust(10, b"\0")[:10]
    sent = step(Step.COMMAND, int(to_host)) + struct.pack("<H", length) + block
    return sent + (work() + take(1, 9)) * (2 + length // 512) + HALTED + work() + take(1)


def usb_disk_seeds() -> dict[str, bytes]:
    """Standard requests, and hosts of a disk."""
    again = setup(CLASS | INTERFACE, 0xFF) + take(0)
    first = command(0x00)
    read = struct.pack(">BIBHB", 0, 3, 0, 2, 0)
    seeds = {
        **_device_seeds(),
        "units": asked(IN | CLASS | INTERFACE, 0xFE, 0, 0, 1),
        "read": first + command(0x28, read, 1024),
        "read_fewer": first + command(0x28, read, 512),
        "read_more": first + command(0x28, read, 4096),
        "read_beyond": first + command(0x28, struct.pack(">BIBHB", 0, 63, 0, 2, 0), 1024),
        "bring": first + command(0x2A, read, 1024, to_host=False),
        "pulled_card": first + command(0x28, read, 1024)[:20] + step(Step.MEDIUM, 0) + work(0, 9) + first,
        "late_and_bad": first
        + step(Step.MEDIUM, 3)
        + command(0x28, read, 1024)
        + step(Step.MEDIUM, 5)
        + work(),
        "nonsense": give(b"nonsense") + take(1) + HALTED + again + HALTED + first,
        "reset_amid": first + command(0x28, read, 1024)[:16] + again + first,
        "eject": command(0x1B, b"\0\0\0\2") + first,
    }
    for operation in (0x03, 0x12, 0x1A, 0x1E, 0x23, 0x25, 0x35, 0x5A, 0xFF):
        for length in (0, 8, 255):
            seeds[f"command_{operation:02x}_{length}"] = first + command(
                operation, b"\0\0\0\xff\0\0\0\xff", length
            )
    return seeds
