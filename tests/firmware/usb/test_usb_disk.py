"""The disk (Bulk-Only Transport, SCSI): what hosts ask, and all that they may disagree about."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import pytest

from tests.firmware.usb.conftest import DiskDevice, Medium
from tests.firmware.usb.scripted_bus import CLASS, CLEAR_FEATURE, ENDPOINT, IN, INTERFACE, SET_FEATURE, Answer

DATA = 1
PASSED, FAILED, PHASE = range(3)
NOT_READY, MEDIUM_ERROR, ILLEGAL, ATTENTION, PROTECT = 2, 3, 5, 6, 7
TAG = 0x12345678
READY, SENSE, INQUIRY, MODE_6, START_STOP, PREVENT = 0x00, 0x03, 0x12, 0x1A, 0x1B, 0x1E
FORMATS, CAPACITY, READ, WRITE, SYNCHRONIZE, MODE_10 = 0x23, 0x25, 0x28, 0x2A, 0x35, 0x5A


@dataclass
class Done:
    """A command that is over."""

    data: bytes
    status: int
    residue: int
    stalled: bool  # its data, or what should have been some


def wrapper(command: bytes, length: int, *, to_host: bool = True, unit: int = 0, tag: int = TAG) -> bytes:
    """A command block wrapper."""
    flags = IN if to_host else 0
    return struct.pack("<4sIIBBB16s", b"USBC", tag, length, flags, unit, len(command), command)


def clear(disk: DiskDevice, endpoint: int) -> None:
    assert disk.bus.ask(ENDPOINT, CLEAR_FEATURE, 0, endpoint) == b""


def carry_out(disk: DiskDevice, command: bytes, length: int = 0, *, to_host: bool = True) -> Done:
    """A command as hosts do it: data if any are told of, a STALL cleared, the status."""
    assert disk.bus.give(DATA, wrapper(command, length, to_host=to_host)) is None
    data, stalled = b"", False
    if length and not to_host:
        disk.step()
        assert disk.bus.give(DATA, bytes(64)) is Answer.STALL
        clear(disk, DATA)
        stalled = True
    for _ in range(20 * (length // 64 + 20)):
        disk.step()
        packet = disk.bus.take(DATA)
        if packet is Answer.STALL:
            assert not stalled
            clear(disk, IN | DATA)
            stalled = True
        elif isinstance(packet, bytes) and len(packet) == 13 and packet[:4] == b"USBS":
            tag, residue, status = struct.unpack("<IIB", packet[4:])
            assert tag == TAG
            disk.step()
            assert disk.bus.take(DATA) is Answer.NAK, "nothing follows a status"
            return Done(data, status, residue, stalled)
        elif isinstance(packet, bytes):
            data += packet
    raise AssertionError("no status")


def reason(disk: DiskDevice) -> tuple[int, int]:
    """Sense key and code of what failed last, which are then forgotten."""
    told = carry_out(disk, bytes((SENSE, 0, 0, 0, 18, 0)), 18)
    assert (told.status, len(told.data), told.data[0]) == (PASSED, 18, 0x70)
    return told.data[2], told.data[12]


@pytest.fixture
def ready(disk: DiskDevice) -> DiskDevice:
    """A disk that the host knows to be there."""
    assert carry_out(disk, bytes(6)).status == FAILED
    assert reason(disk) == (ATTENTION, 0x28)
    assert carry_out(disk, bytes(6)).status == PASSED
    assert reason(disk) == (0, 0)
    return disk


def read(disk: DiskDevice, block: int, blocks: int, length: int | None = None) -> Done:
    command = struct.pack(">BBIBHB", READ, 0, block, 0, blocks, 0)
    return carry_out(disk, command, 512 * blocks if length is None else length)


def test_it_says_what_hosts_ask_of_a_disk(ready: DiskDevice) -> None:
    told = carry_out(ready, bytes((INQUIRY, 0, 0, 0, 36, 0)), 36)
    assert (told.status, told.residue, len(told.data)) == (PASSED, 0, 36)
    assert told.data[:2] == b"\0\x80" and told.data[8:16] == b"Neurofli"
    assert carry_out(ready, bytes((CAPACITY,)) + bytes(9), 8).data == struct.pack(">II", 999, 512)
    formats = carry_out(ready, bytes((FORMATS,)) + bytes(6) + b"\0\xff\0", 255)
    assert formats.data == struct.pack(">II", 8, 1000) + b"\2\0\2\0" and formats.residue == 243
    for command, place in (
        (bytes((MODE_6, 0, 0x3F, 0, 192, 0)), 2),
        (bytes((MODE_10,)) + b"\0\x3f\0\0\0\0\0\xc0\0", 3),
    ):
        mode = carry_out(ready, command, 192)
        assert mode.status == PASSED and mode.data[place] == 0x80, "nothing can be written"
    for silent in ((PREVENT, 0, 0, 0, 1, 0), (SYNCHRONIZE, *[0] * 9), (START_STOP, 0, 0, 0, 1, 0)):
        assert carry_out(ready, bytes(silent)).status == PASSED
    assert ready.bus.ask(IN | CLASS | INTERFACE, 0xFE, 0, 0, 1) == b"\0"


@pytest.mark.parametrize("late", [0, 3])
def test_blocks_are_the_mediums_when_read(ready: DiskDevice, late: int) -> None:
    ready.medium.late = late
    for block, blocks in ((0, 1), (7, 3), (990, 10), (999, 1), (5, 0), (1000, 0)):
        got = read(ready, block, blocks)
        assert got.data == b"".join(map(Medium.block, range(block, block + blocks)))
        assert (got.status, got.residue, got.stalled) == (PASSED, 0, False)


@pytest.mark.parametrize(
    ("block", "blocks"), [(1000, 1), (999, 2), (0xFFFFFFFF, 1), (0xFFFFFFFF, 2), (0, 1001)]
)
def test_blocks_beyond_the_end_are_refused(ready: DiskDevice, block: int, blocks: int) -> None:
    got = read(ready, block, blocks)
    assert (got.data, got.status, got.residue, got.stalled) == (b"", FAILED, 512 * blocks, True)
    assert reason(ready) == (ILLEGAL, 0x21) and ready.medium.asked == []


def test_a_block_that_cannot_be_read_ends_the_command(ready: DiskDevice) -> None:
    ready.medium.bad = {12}
    got = read(ready, 10, 4)
    assert got.data == Medium.block(10) + Medium.block(11)
    assert (got.status, got.residue, got.stalled) == (FAILED, 1024, True)
    assert reason(ready) == (MEDIUM_ERROR, 0x11)
    assert read(ready, 10, 1).status == PASSED


def test_it_tells_once_that_a_medium_is_new_and_refuses_while_there_is_none(ready: DiskDevice) -> None:
    ready.medium.blocks = 0
    for command, length in (
        (bytes(6), 0),
        (bytes((CAPACITY,)) + bytes(9), 8),
        (bytes((READ,)) + bytes(7) + b"\1\0", 512),
    ):
        assert carry_out(ready, command, length).status == FAILED
        assert reason(ready) == (NOT_READY, 0x3A)
    ready.medium.blocks = 5
    assert carry_out(ready, bytes(6)).status == FAILED and reason(ready) == (ATTENTION, 0x28)
    assert carry_out(ready, bytes((CAPACITY,)) + bytes(9), 8).data == struct.pack(">II", 4, 512)


def test_it_is_away_once_ejected(ready: DiskDevice) -> None:
    assert carry_out(ready, bytes((START_STOP, 0, 0, 0, 0, 0))).status == PASSED
    assert not ready.disk.ejected, "that was only a stop"
    assert carry_out(ready, bytes((START_STOP, 0, 0, 0, 2, 0))).status == PASSED
    assert ready.disk.ejected and carry_out(ready, bytes(6)).status == FAILED
    assert reason(ready) == (NOT_READY, 0x3A)


def test_nothing_is_written_and_the_host_knows_why(ready: DiskDevice) -> None:
    told = carry_out(ready, struct.pack(">BBIBHB", WRITE, 0, 3, 0, 1, 0), 512, to_host=False)
    assert (told.status, told.residue) == (FAILED, 512)
    assert reason(ready) == (PROTECT, 0x27) and ready.medium.asked == []


KNOWN = {
    READY,
    SENSE,
    INQUIRY,
    MODE_6,
    START_STOP,
    PREVENT,
    FORMATS,
    CAPACITY,
    READ,
    WRITE,
    SYNCHRONIZE,
    MODE_10,
}


def test_an_unknown_command_fails_and_the_next_one_is_heard(ready: DiskDevice) -> None:
    for operation in sorted(set(range(256)) - KNOWN):
        for length, to_host in ((0, True), (64, True), (64, False)):
            told = carry_out(ready, bytes((operation,)) + bytes(9), length, to_host=to_host)
            assert (told.data, told.status, told.residue, told.stalled) == (b"", FAILED, length, length > 0)
            assert reason(ready) == (ILLEGAL, 0x20)


# The host's expectation against the device's (Bulk-Only Transport, 6.7): (command, length told, to the host)
# -> bytes of data, status, residue, STALL.
INQUIRE = bytes((INQUIRY, 0, 0, 0, 36, 0))
ONE = struct.pack(">BBIBHB", READ, 0, 0, 0, 1, 0)
NONE = struct.pack(">BBIBHB", READ, 0, 0, 0, 0, 0)
CASES = {
    "1: nothing, nothing": (bytes(6), 0, True, (0, PASSED, 0, False)),
    "2: nothing, data": (ONE, 0, True, (0, PHASE, 0, False)),
    "4: data, nothing": (bytes(6), 64, True, (0, PASSED, 64, True)),
    "4: data, no block": (NONE, 512, True, (0, PASSED, 512, True)),
    "5: more than there are": (ONE, 1024, True, (512, PASSED, 512, True)),
    "5: more, a short packet tells": (INQUIRE, 255, True, (36, PASSED, 219, False)),
    "6: as many": (ONE, 512, True, (512, PASSED, 0, False)),
    "7: fewer": (ONE, 511, True, (0, PHASE, 511, True)),
    "7: fewer of a reply": (INQUIRE, 20, True, (20, PASSED, 0, False)),
    "9: brings some, none wanted": (bytes(6), 64, False, (0, PASSED, 64, True)),
    "10: brings some, has some": (ONE, 512, False, (0, PHASE, 512, True)),
    "10: brings some, a reply": (INQUIRE, 36, False, (0, PHASE, 36, True)),
}


@pytest.mark.parametrize("case", CASES)
def test_both_sides_agree_afterwards_when_they_did_not(ready: DiskDevice, case: str) -> None:
    command, length, to_host, (count, status, residue, stalled) = CASES[case]
    told = carry_out(ready, command, length, to_host=to_host)
    assert (len(told.data), told.status, told.residue, told.stalled) == (count, status, residue, stalled)
    assert read(ready, 3, 1).data == Medium.block(3)


@pytest.mark.parametrize(
    "wrong",
    [
        b"",
        wrapper(bytes(6), 0)[:30],
        wrapper(bytes(6), 0) + b"\0",
        b"USBX" + wrapper(bytes(6), 0)[4:],
        wrapper(bytes(6), 0, unit=1),
        wrapper(b"", 0),
        wrapper(bytes(6), 0)[:14] + b"\x11" + bytes(16),
        bytes(64),
    ],
    ids=["empty", "short", "long", "signature", "unit", "no command", "17 bytes", "zeros"],
)
def test_only_a_reset_helps_when_what_came_is_no_command(ready: DiskDevice, wrong: bytes) -> None:
    bus = ready.bus
    assert bus.give(DATA, wrong) is None
    for _ in range(2):
        ready.step(3)
        assert bus.take(DATA) is Answer.STALL and bus.give(DATA, wrapper(bytes(6), 0)) is Answer.STALL
        clear(ready, DATA)
        clear(ready, DATA | IN)  # in vain
    assert bus.ask(CLASS | INTERFACE, 0xFF, 0, 0) == b""
    assert bus.take(DATA) is Answer.STALL
    clear(ready, DATA)
    clear(ready, DATA | IN)
    assert carry_out(ready, bytes(6)).status == PASSED


def test_a_reset_of_the_class_ends_a_command_wherever_it_stands(ready: DiskDevice) -> None:
    for taken in range(12):
        ready.bus.give(DATA, wrapper(ONE, 512))
        for _ in range(taken):
            ready.step()
            ready.bus.take(DATA)
        assert ready.bus.ask(CLASS | INTERFACE, 0xFF, 0, 0) == b""
        assert ready.bus.take(DATA) is Answer.NAK
        assert read(ready, taken, 1).data == Medium.block(taken)


def test_a_reset_of_the_bus_ends_a_command_wherever_it_stands(ready: DiskDevice) -> None:
    for taken in range(12):
        ready.bus.give(DATA, wrapper(ONE, 512))
        for _ in range(taken):
            ready.step()
            ready.bus.take(DATA)
        ready.bus.enumerate()
        assert ready.bus.take(DATA) is Answer.NAK
        assert carry_out(ready, bytes(6)).status == FAILED and reason(ready) == (ATTENTION, 0x28)
        assert read(ready, taken, 1).data == Medium.block(taken)


def test_a_halt_by_the_host_delays_a_status_alone(ready: DiskDevice) -> None:
    assert ready.bus.ask(ENDPOINT, SET_FEATURE, 0, DATA | IN) == b""
    ready.bus.give(DATA, wrapper(bytes(6), 0))
    ready.step(3)
    assert ready.bus.take(DATA) is Answer.STALL
    clear(ready, DATA | IN)
    packet = ready.bus.take(DATA)
    assert isinstance(packet, bytes) and packet[:4] == b"USBS"


@pytest.mark.parametrize(
    "request_",
    [
        (IN | CLASS | INTERFACE, 0xFE, 0, 0, 0),
        (IN | CLASS | INTERFACE, 0xFE, 0, 0, 2),
        (IN | CLASS | INTERFACE, 0xFE, 1, 0, 1),
        (IN | CLASS | INTERFACE, 0xFE, 0, 1, 1),
        (IN | CLASS | INTERFACE, 0xFF, 0, 0, 1),
        (CLASS | INTERFACE, 0xFE, 0, 0, 0),
        (CLASS | INTERFACE, 0xFF, 1, 0, 0),
        (CLASS | INTERFACE, 0xFD, 0, 0, 0),
    ],
    ids=str,
)
def test_a_request_of_the_class_is_refused_when_asked_wrongly(
    ready: DiskDevice, request_: tuple[int, int, int, int, int]
) -> None:
    assert ready.bus.ask(*request_) is Answer.STALL
    assert ready.bus.tell(CLASS | INTERFACE, 0xFF, 0, 0, b"\0") is Answer.STALL
    assert read(ready, 1, 1).data == Medium.block(1)
