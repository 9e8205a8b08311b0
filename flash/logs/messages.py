"""The messages LOG_INFO, LOG_ENTRY, LOG_READ and LOG_ERASE; states and errors in words."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from neuroflight.flash.link.layouts import read
from neuroflight.flash.link.payload import one_of
from neuroflight.toolchain.contract import (
    LOG_ERASE_MAGIC,
    LOG_INFO_LOGGING,
    LOG_INFO_LOOKING,
    LOG_INFO_LOSSY,
    LogDevice,
    LogError,
    LogState,
    Msp,
)

DEVICES = {
    LogDevice.NONE: "none (blackbox_device=none)",
    LogDevice.SERIAL: "UART3",
    LogDevice.CARD: "the SD card, or the board's flash chip",
}
STATES = {
    LogState.ABSENT: "this board has none, or none that its settings name",
    LogState.STARTING: "being looked at, or erased",
    LogState.READY: "ready for the next flight",
    LogState.LOGGING: "a log is being written",
    LogState.ENDING: "the end of a log is being written",
    LogState.FULL: "full: the next flight is not logged",
    LogState.FAULT: "at fault: the next flight is not logged",
}
ERRORS = {
    LogError.NONE: "none",
    LogError.NO_CARD: "no card answers: put one in, and start the board anew; a flash chip that does not "
    "is broken, or on other pins",
    LogError.CARD: "the card answers what no card should: try another one",
    LogError.FILE_SYSTEM: "the card holds no sound FAT32 file system: format it (`mkfs.vfat -F 32`), then "
    "`neuroflight log card`",
    LogError.NO_FILE: "the card holds no file for logs: `neuroflight log card` makes them",
    LogError.FRAGMENTED: "a file for logs does not lie in one piece: format the card, then "
    "`neuroflight log card`",
    LogError.WRITE: "the card or chip refused a write or took too long: the log ends there; try another card",
    LogError.READ: "the card could not be read: try again, then another card",
    LogError.CHIP: "the flash chip is of a kind that the firmware does not know",
    LogError.FOREIGN: "the flash chip holds what another firmware wrote: fetch that with its tools, then "
    "`neuroflight board logs erase --unfetched`",
}


@dataclass(frozen=True)
class LogInfo:
    """The state of the blackbox."""

    device: LogDevice  # as set
    state: LogState
    error: LogError  # last error, until a log begins without one
    logging: bool
    lossy: bool  # the current or last log lacks control steps
    looking: bool  # still looking for files: there may be more logs
    logs: int  # that can be read
    empty: int  # files that can take a log
    capacity_kib: int  # of all files for logs
    free_kib: int
    frames: int  # this and what follows: of the current or last log
    dropped: int  # control steps
    bytes: int


@dataclass(frozen=True)
class LogEntry:
    """A log that the device keeps."""

    index: int
    name: str  # 8.3
    bytes: int

    @property
    def number(self) -> int:
        """Number as users count, from 1."""
        return self.index + 1


@dataclass(frozen=True)
class Block:
    """Bytes of a log; `data` None: not read yet, ask again."""

    index: int
    offset: int
    data: bytes | None


def log_info(payload: bytes) -> LogInfo:
    """Decode LOG_INFO. Raises LinkError."""
    told = read(Msp.LOG_INFO, payload)
    return LogInfo(
        device=one_of(LogDevice, told["device"], Msp.LOG_INFO),
        state=one_of(LogState, told["state"], Msp.LOG_INFO),
        error=one_of(LogError, told["error"], Msp.LOG_INFO),
        logging=bool(told["flags"] & LOG_INFO_LOGGING),
        lossy=bool(told["flags"] & LOG_INFO_LOSSY),
        looking=bool(told["flags"] & LOG_INFO_LOOKING),
        logs=told["logs"],
        empty=told["empty"],
        capacity_kib=told["capacity"],
        free_kib=told["free"],
        frames=told["frames"],
        dropped=told["dropped"],
        bytes=told["bytes"],
    )


def log_entry(payload: bytes) -> LogEntry | None:
    """Decode LOG_ENTRY; None: ask again. Raises LinkError."""
    told = read(Msp.LOG_ENTRY, payload)
    return None if told["state"] else LogEntry(told["log"], told["name"], told["bytes"])


def entry_request(index: int) -> bytes:
    """Encode LOG_ENTRY."""
    return struct.pack("<H", index)


def read_request(index: int, offset: int, count: int) -> bytes:
    """Encode LOG_READ."""
    return struct.pack("<HIH", index, offset, count)


def log_block(payload: bytes) -> Block:
    """Decode LOG_READ. Raises LinkError."""
    told = read(Msp.LOG_READ, payload)
    return Block(told["log"], told["offset"], None if told["state"] else told["data"])


def erase_request() -> bytes:
    """Encode LOG_ERASE."""
    return struct.pack("<I", LOG_ERASE_MAGIC)


def erased(payload: bytes) -> bool:
    """Decode LOG_ERASE: True once it is done, otherwise ask again. Raises LinkError."""
    return not read(Msp.LOG_ERASE, payload)["state"]
