"""The protocol of ST's boot loader on a UART (AN3155): bytes in, actions out.

No line, no clock, no memory: `feed` takes a state and a byte, and returns the state behind it and, where a
command is complete or has to be answered, an action. Whoever carries it out sends ACK behind a Write or an
Erase.

Not here, and refused: write and read protection, and the special commands. Their real counterparts erase the
chip or lock it, which nobody should try out unknowingly.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from functools import reduce
from operator import xor

from neuroflight.toolchain.contract import DTCM, FLASH_BASE, FLASH_BYTES, FLASH_SECTORS, ITCM, Region

SYNC, ACK, NACK = 0x7F, 0x79, 0x1F
GET, GET_VERSION, GET_ID, READ, GO, WRITE, ERASE = 0x00, 0x01, 0x02, 0x11, 0x21, 0x31, 0x44
PROTECTION = (0x63, 0x73, 0x82, 0x92)  # write protect, unprotect, readout protect, unprotect
COMMANDS = (GET, GET_VERSION, GET_ID, READ, GO, WRITE, ERASE, *PROTECTION)
PROTOCOL_VERSION = 0x31  # 3.1 (AN2606, STM32F72xxx/73xxx)
PRODUCT_ID = 0x452
MASS_ERASE, SPECIAL = 0xFFFF, 0xFFF0  # in place of a number of sectors; from SPECIAL on
DATA_MAX = 256  # bytes of one read or write

FLASH = Region("flash", FLASH_BASE, FLASH_BYTES)
OWN_RAM_BYTES = 0x4000  # from the start of DTCM: the ROM's program keeps its variables there (AN2606)
FREE_RAM = Region("RAM", DTCM.address + OWN_RAM_BYTES, 256 * 1024 - OWN_RAM_BYTES)
SYSTEM_MEMORY = Region("system memory", 0x1FF00000, 0xEDC0)
READABLE = (FLASH, Region("RAM", DTCM.address, 256 * 1024), ITCM, SYSTEM_MEMORY)
WRITABLE = (FLASH, FREE_RAM)


class Step(Enum):
    """Meanings of the next bytes."""

    COMMAND = auto()
    ADDRESS = auto()
    READ_COUNT = auto()
    WRITE_DATA = auto()
    ERASE_COUNT = auto()
    ERASE_SECTORS = auto()


@dataclass(frozen=True)
class State:
    """The protocol's state between two bytes."""

    step: Step = Step.COMMAND
    command: int = 0
    address: int = 0
    count: int = 0  # of sectors that follow; a special number
    taken: bytes = b""  # of this step


@dataclass(frozen=True)
class Send:
    """Answer with `data`."""

    data: bytes


@dataclass(frozen=True)
class Read:
    """Answer with ACK and `size` bytes from `address` on."""

    address: int
    size: int


@dataclass(frozen=True)
class Write:
    """Write `data` to flash or RAM, then answer."""

    address: int
    data: bytes


@dataclass(frozen=True)
class Erase:
    """Erase sectors one after another, or the whole flash (None), then answer."""

    sectors: tuple[int, ...] | None


@dataclass(frozen=True)
class Go:
    """Answer with ACK, then start the program whose vectors lie at `address`."""

    address: int


Action = Send | Read | Write | Erase | Go

START = State()
ACCEPTED, REFUSED = Send(bytes([ACK])), Send(bytes([NACK]))


def feed(state: State, byte: int) -> tuple[State, Action | None]:
    """Return the state behind `byte`, and the action that is due now, if any."""
    state = State(state.step, state.command, state.address, state.count, state.taken + bytes([byte]))
    if len(state.taken) < _wanted(state):
        return state, None
    return _COMPLETE[state.step](state)


def _wanted(state: State) -> int:
    """Return the number of bytes of the step, checksum included, as far as they are known."""
    match state.step:
        case Step.COMMAND | Step.READ_COUNT | Step.ERASE_COUNT:
            return 2
        case Step.ADDRESS:
            return 5
        case Step.WRITE_DATA:
            return 1 + state.taken[0] + 1 + 1
        case Step.ERASE_SECTORS:
            return 1 if state.count >= SPECIAL else 2 * (state.count + 1) + 1


def _checksum(data: bytes) -> int:
    return reduce(xor, data, 0)


def _command(state: State) -> tuple[State, Action]:
    command, complement = state.taken
    if command ^ complement != 0xFF or command not in COMMANDS or command in PROTECTION:
        return START, REFUSED
    if command == GET:
        return START, Send(bytes([ACK, len(COMMANDS), PROTOCOL_VERSION, *COMMANDS, ACK]))
    if command == GET_VERSION:
        return START, Send(bytes([ACK, PROTOCOL_VERSION, 0, 0, ACK]))
    if command == GET_ID:
        return START, Send(bytes([ACK, 1, PRODUCT_ID >> 8, PRODUCT_ID & 0xFF, ACK]))
    step = Step.ERASE_COUNT if command == ERASE else Step.ADDRESS
    return State(step, command), ACCEPTED


def _address(state: State) -> tuple[State, Action]:
    address = int.from_bytes(state.taken[:4], "big")
    places = READABLE if state.command == READ else WRITABLE
    if _checksum(state.taken) or not lies_in(places, address, 1):
        return START, REFUSED
    if state.command == GO:
        return START, Go(address)
    step = Step.READ_COUNT if state.command == READ else Step.WRITE_DATA
    return State(step, state.command, address), ACCEPTED


def _read_count(state: State) -> tuple[State, Action]:
    count, complement = state.taken
    if count ^ complement != 0xFF or not lies_in(READABLE, state.address, count + 1):
        return START, REFUSED
    return START, Read(state.address, count + 1)


def _write_data(state: State) -> tuple[State, Action]:
    data = state.taken[1:-1]
    if _checksum(state.taken) or not lies_in(WRITABLE, state.address, len(data)):
        return START, REFUSED
    return START, Write(state.address, data)


def _erase_count(state: State) -> tuple[State, Action | None]:
    count = int.from_bytes(state.taken, "big")
    if len(FLASH_SECTORS) <= count < SPECIAL or SPECIAL <= count < MASS_ERASE:
        return START, REFUSED
    return State(Step.ERASE_SECTORS, ERASE, 0, count), None


def _erase_sectors(state: State) -> tuple[State, Action]:
    if _checksum(state.count.to_bytes(2, "big") + state.taken):
        return START, REFUSED
    if state.count == MASS_ERASE:
        return START, Erase(None)
    numbers = state.taken[:-1]
    sectors = tuple(int.from_bytes(numbers[i : i + 2], "big") for i in range(0, len(numbers), 2))
    if any(sector >= len(FLASH_SECTORS) for sector in sectors):
        return START, REFUSED
    return START, Erase(sectors)


def lies_in(places: tuple[Region, ...], address: int, size: int) -> bool:
    """Return whether `size` bytes from `address` on lie in one of the places."""
    return any(p.address <= address and address + size <= p.address + p.size for p in places)


_COMPLETE = {
    Step.COMMAND: _command,
    Step.ADDRESS: _address,
    Step.READ_COUNT: _read_count,
    Step.WRITE_DATA: _write_data,
    Step.ERASE_COUNT: _erase_count,
    Step.ERASE_SECTORS: _erase_sectors,
}
