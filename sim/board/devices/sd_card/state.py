"""The protocol's state of an SD card."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class State:
    """Plain values, by default those after power-up."""

    spi: bool = False  # the first CMD0 has come
    idle: bool = True  # not initialised
    crc: bool = False  # checksums of all commands and of data are checked
    voltage_told: bool = False  # CMD8 has come
    ready_at: int | None = None  # cycle at which the initialisation ends; None: it has not begun
    application: bool = False  # CMD55 came before
    status: int = 0  # second byte of R2, until it is read
    erase_first: int | None = None
    erase_last: int | None = None
    out: bytes = b""  # the answer that the host has not read yet
    busy_until: int = 0  # cycle
    reading: bool = False
    payload: bytes = b""  # of a register that is read instead of blocks
    writing: bool = False
    multiple: bool = False  # several blocks are read or written
    address: int = 0  # of the next block
    data_at: int = 0  # cycle at which it can be read
    wanted: int = 0  # bytes of a block that are still to come
    data: bytes = b""  # those that have come
    well_written: int = 0  # blocks, of the last write command
