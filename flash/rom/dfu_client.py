"""A client of the boot loader in an STM32's ROM on USB: DFU 1.1 with ST's commands (AN3156).

The same calls as those of the client on a UART (`client.py`). Each block is written and read behind
an address pointer of its own, so that nothing depends on how a device counts blocks. USB corrects errors of
the line itself; what fails here has been refused, or the device is gone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import IntEnum

from neuroflight.flash.rom.client import PRODUCT_ID, Chip, NoBootLoaderError, RefusedError
from neuroflight.flash.usb.control import ControlLine, StalledError
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES, FLASH_SECTORS
from neuroflight.toolchain.errors import LinkError

DATA_MAX = 2048  # bytes of a block: the ROM's wTransferSize
DNLOAD, UPLOAD, GETSTATUS, CLRSTATUS, ABORT = 1, 2, 3, 4, 6  # requests, DFU 1.1 table 3.2
SET_ADDRESS, ERASE = 0x21, 0x41  # ST's commands, in block 0
BLOCK = 2  # the first one with data, which lies at the address pointer
TIMEOUT_S = 2.0  # for an answer
BUSY_TIMEOUT_S = 12.0  # an erasure may take three times as long as told
WAIT_MAX_S = 10.0  # what a device may ask us to wait at a time
STATUS_BYTES = 6
TRIES = 4  # to bring a device that somebody else has left into its idle state
BUSY_ASKS = 100  # times to ask a device that goes on being busy
# The memories of an STM32F72x or F73x as its ROM names them: nothing else of it tells the chip. An F411 has
# the same sectors, and its option bytes elsewhere.
FLASH_NAME, OPTIONS_NAME = "@Internal Flash", "@Option Bytes"
OPTIONS_ADDRESS = 0x1FFF0000


class State(IntEnum):
    """States, DFU 1.1 chapter 6.1.2."""

    IDLE = 2
    DNLOAD_SYNC = 3
    DNBUSY = 4
    DNLOAD_IDLE = 5
    MANIFEST_SYNC = 6
    MANIFEST = 7
    UPLOAD_IDLE = 9
    ERROR = 10


PROTECTED, WRONG_ADDRESS = 0x0B, 0x01  # status errVENDOR and errTARGET, AN3156's meaning


class DfuClient:
    """A client of the ROM over a claimed interface, which it owns: use it in a `with`, or close it."""

    data_max = DATA_MAX

    def __init__(self, line: ControlLine, sleep: Callable[[float], None] = time.sleep) -> None:
        """sleep: waits [s]."""
        self._line, self._sleep = line, sleep
        self.repeated = 0  # tries beyond the first: there are none

    def __enter__(self) -> DfuClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the device back."""
        self._line.close()

    @property
    def name(self) -> str:
        """The device as the user would write it."""
        return self._line.name

    def connect(self) -> Chip:
        """Check that it is the ROM of the right chip, by its memories, and make it ready.

        Raises NoBootLoaderError for another one.
        """
        names = self._line.alternates
        flash = next((name for name in names if name.startswith(FLASH_NAME)), "")
        options = next((name for name in names if name.startswith(OPTIONS_NAME)), "")
        sectors = memory_sectors(flash)
        wanted = [(sector.address, sector.size) for sector in FLASH_SECTORS]
        if sectors != wanted or [address for address, _ in memory_sectors(options)] != [OPTIONS_ADDRESS]:
            shown = ", ".join(repr(name) for name in (flash, options) if name) or "no memory of ST's"
            raise NoBootLoaderError(
                f"{self.name}: a boot loader with {shown}, expected the memories of an STM32F722; it is "
                f"another board; nothing was written"
            )
        self._become_idle()
        return Chip(PRODUCT_ID, 0)

    def read(self, address: int, size: int) -> bytes:
        """Read at most 2048 bytes from `address` on. Raises RefusedError for a protected chip, LinkError."""
        what = f"read {size} bytes at 0x{address:08X}"
        self._point(address, what)
        self._abort()  # an upload begins in the idle state alone
        try:
            data = self._line.read(UPLOAD, BLOCK, size, TIMEOUT_S)
        except StalledError:
            raise self._failure(what, self._status()[0]) from None
        if len(data) != size:
            raise LinkError(f"{self.name}: {len(data)} of {size} bytes came from 0x{address:08X}; try again")
        self._abort()
        return data

    def write(self, address: int, data: bytes) -> None:
        """Write at most 2048 bytes to erased flash. To be certain, read them back.

        Raises ValueError outside flash: the ROM would also write option bytes, and a read protection set
        there is permanent.
        """
        if not FLASH_BASE <= address <= FLASH_BASE + FLASH_BYTES - len(data):
            raise ValueError(f"{len(data)} bytes at 0x{address:08X}, expected flash")
        what = f"write {len(data)} bytes at 0x{address:08X}"
        self._point(address, what)
        self._order(BLOCK, data, what)

    def erase(self, sector: int) -> None:
        """Erase one sector, by its number."""
        address = FLASH_SECTORS[sector].address
        self._order(0, bytes([ERASE]) + address.to_bytes(4, "little"), f"erase sector {sector}")

    def go(self, address: int) -> bool:
        """Start the program whose vectors lie at `address`; the boot loader leaves the bus.

        Returns whether it has agreed.
        """
        try:
            self._point(address, "start the image")
            self._line.write(DNLOAD, 0, b"", TIMEOUT_S)
        except LinkError:
            return False
        try:
            return self._status()[2] is State.MANIFEST
        except LinkError:
            return True  # gone before it could answer

    # ---- orders ----

    def _point(self, address: int, what: str) -> None:
        """Set the address pointer."""
        self._order(0, bytes([SET_ADDRESS]) + address.to_bytes(4, "little"), what)

    def _order(self, block: int, data: bytes, what: str) -> None:
        """Send an order and wait for its end. Raises LinkError: `what` was not done."""
        try:
            self._line.write(DNLOAD, block, data, TIMEOUT_S)
        except StalledError:
            raise self._failure(what, self._status()[0]) from None
        status, state = 0, State.DNBUSY
        for _ in range(BUSY_ASKS):
            status, wait, state = self._status()
            if state is not State.DNBUSY:
                break
            self._sleep(min(wait, WAIT_MAX_S))
        if state is not State.DNLOAD_IDLE:
            raise self._failure(what, status)

    def _failure(self, what: str, status: int) -> LinkError:
        """Return the error of an order that ended with `status`, after making the device ready again."""
        self._become_idle()
        if status == PROTECTED:
            return RefusedError(
                f"{self.name}: the boot loader refuses to {what}; the chip is read-protected, which only "
                f"a mass erase with ST's own tools lifts"
            )
        why = "not an address of its flash" if status == WRONG_ADDRESS else f"status {status}"
        return LinkError(f"{self.name}: the boot loader did not {what} ({why}), expected it to; try again")

    def _abort(self) -> None:
        self._line.write(ABORT, 0, b"", TIMEOUT_S)

    def _become_idle(self) -> None:
        """Bring the device into its idle state from wherever it is. Raises LinkError."""
        for _ in range(TRIES):
            _, wait, state = self._status()
            if state is State.IDLE:
                return
            if state is State.ERROR:
                self._line.write(CLRSTATUS, 0, b"", TIMEOUT_S)
            elif state is State.DNBUSY:
                self._sleep(min(wait, WAIT_MAX_S))
            elif state is State.MANIFEST:
                break
            else:
                self._abort()
        raise LinkError(
            f"{self.name}: the boot loader does not become ready, expected it to; plug the board out, and in "
            f"again with BOOT held"
        )

    def _status(self) -> tuple[int, float, State]:
        """Read status, the time to wait [s] and state."""
        answer = self._line.read(GETSTATUS, 0, STATUS_BYTES, BUSY_TIMEOUT_S)
        try:
            return answer[0], int.from_bytes(answer[1:4], "little") / 1000, State(answer[4])
        except (IndexError, ValueError):
            raise LinkError(
                f"{self.name}: the answer {answer.hex(' ') or 'nothing'} to GETSTATUS, expected six bytes "
                f"with a state; is it the boot loader of the chip's ROM?"
            ) from None


def memory_sectors(name: str) -> list[tuple[int, int]]:
    """Return address and bytes of each sector that an interface's name lists (UM0424, chapter 10); none where
    it cannot be read.

    "@Internal Flash  /0x08000000/04*016Kg,01*64Kg": four of 16 KiB from 0x08000000 on, and one of 64.
    """
    units = {"K": 1 << 10, "M": 1 << 20}
    try:
        _, start, layout = name.split("/")
        address, found = int(start, 16), []
        for part in layout.split(","):
            count, _, size = part.strip().partition("*")
            digits = size.rstrip("abcdefgKM ")
            unit = units.get(size[len(digits) : len(digits) + 1], 1)
            for _ in range(min(int(count), 1 + len(FLASH_SECTORS))):
                found.append((address, int(digits) * unit))
                address += int(digits) * unit
    except ValueError:
        return []
    return found
