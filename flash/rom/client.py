"""A client of the boot loader in an STM32's ROM, on a UART: ST's AN3155, as far as flashing needs it.

Each command is acknowledged byte for byte; what is lost or refused is tried again after both ends agree where
a command begins. What a board has done with a write whose answer was lost is not known, but writing the same
bytes twice is writing them once.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import xor

from neuroflight.flash.link.transport import Transport
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES, FLASH_SECTORS
from neuroflight.toolchain.errors import LinkError

SYNC, ACK, NACK = 0x7F, 0x79, 0x1F
GET, GET_ID, READ, GO, WRITE, ERASE = 0x00, 0x02, 0x11, 0x21, 0x31, 0x44
NEEDED = (GET, GET_ID, READ, GO, WRITE, ERASE)
PRODUCT_ID = 0x452  # STM32F72x and F73x (AN2606)
DATA_MAX = 256  # bytes of one read or write
TIMEOUT_S = 1.0  # for an acknowledgement; the program answers at once, USB adapters within tens of ms
# Longest erasures by bytes (data sheet DS11853, flash memory programming), with half as much again.
ERASE_TIMEOUT_S = {16: 2.4, 64: 3.6, 128: 6.0}  # by sector size [KiB]
SILENCE_S = 0.1  # after which the line counts as silent
TRIES = 3  # of a command
SYNC_TRIES, SYNC_BURST = 7, 48  # more bytes than the longest command that may have been cut short
DRAIN_BYTES_MAX = 1 << 16


class NoBootLoaderError(LinkError):
    """No boot loader answers by AN3155 on the line."""


class RefusedError(LinkError):
    """The boot loader answered NACK to every try."""


@dataclass(frozen=True)
class Chip:
    """The chip that answers."""

    product_id: int
    version: int  # of the protocol: 0x31 is 3.1; 0 on USB, which does not tell it

    def __str__(self) -> str:
        return f"0x{self.product_id:03X}"


class _LineError(Exception):
    """A failed try; another may succeed."""

    def __init__(self, why: str, *, refused: bool = False) -> None:
        super().__init__(why)
        self.refused = refused


class RomClient:
    """A client of the ROM over an open transport, which it owns: use it in a `with`, or close it."""

    data_max = DATA_MAX

    def __init__(self, transport: Transport, clock: Callable[[], float] = time.monotonic) -> None:
        """clock: monotonic [s]."""
        self._transport, self._clock = transport, clock
        self._pending = bytearray()  # received, not consumed
        self.repeated = 0  # tries beyond the first, so far

    def __enter__(self) -> RomClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the line."""
        self._transport.close()

    @property
    def name(self) -> str:
        """The port as the user would write it."""
        return self._transport.name

    def connect(self) -> Chip:
        """Find the boot loader. Raises NoBootLoaderError for silence, another device or another chip."""
        try:
            return self._introduce()
        except LinkError as error:
            raise NoBootLoaderError(f"{error}; nothing was written") from None

    def _introduce(self) -> Chip:
        heard = self._synchronise()
        if heard is not None:
            raise NoBootLoaderError(
                f"{self.name}: {_describe(heard)}, expected the boot loader of the chip's ROM: is the board "
                f"in it? Hold BOOT while it gets power; check TX, RX and ground"
            )
        version, *commands = self._ask("tell its commands", GET, lambda answer: not _missing(answer[1:]))
        if missing := _missing(bytes(commands)):
            raise NoBootLoaderError(
                f"{self.name}: a boot loader without the command {missing}, expected that of an STM32F722; "
                f"it is another board"
            )
        raw = self._ask("tell its chip", GET_ID, lambda answer: answer == PRODUCT_ID.to_bytes(2, "big"))
        product = int.from_bytes(raw, "big")
        if product != PRODUCT_ID:
            raise NoBootLoaderError(
                f"{self.name}: the boot loader of chip 0x{product:03X}, expected 0x{PRODUCT_ID:03X}, an "
                f"STM32F72x; it is another board"
            )
        return Chip(product, version)

    def read(self, address: int, size: int) -> bytes:
        """Read at most 256 bytes from `address` on. Raises RefusedError for a protected chip, LinkError."""
        return self._try(f"read {size} bytes at 0x{address:08X}", self._read, address, size)

    def write(self, address: int, data: bytes) -> None:
        """Write at most 256 bytes to erased flash. To be certain, read them back.

        Raises ValueError outside flash: the ROM would also write option bytes, and a read protection set
        there is \\ permanent.
        """
        if not FLASH_BASE <= address <= FLASH_BASE + FLASH_BYTES - len(data):
            raise ValueError(f"{len(data)} bytes at 0x{address:08X}, expected flash")
        self._try(f"write {len(data)} bytes at 0x{address:08X}", self._write, address, data)

    def erase(self, sector: int) -> None:
        """Erase one sector, by its number; in a list, the checksum would not detect every change."""
        self._try(f"erase sector {sector}", self._erase, sector)

    def go(self, address: int) -> bool:
        """Start the program whose vectors lie at `address`; the boot loader ends.

        Returns whether it has agreed. It is not asked twice: the program that has started would be.
        """
        try:
            self._command(GO)
            self._send(_checked(address.to_bytes(4, "big")))
        except _LineError:
            return False
        return True

    # ---- one try of a command ----

    def _commands(self, command: int) -> bytes:
        """Return the answer of GET or GET ID, without its acknowledgements."""
        self._command(command)
        count = self._take(1, TIMEOUT_S)[0] + 1
        data = self._take(count, TIMEOUT_S)
        self._acknowledged(TIMEOUT_S)
        return data

    def _read(self, address: int, size: int) -> bytes:
        self._command(READ)
        self._send(_checked(address.to_bytes(4, "big")))
        self._send(_with_complement(size - 1))
        return self._take(size, TIMEOUT_S)

    def _write(self, address: int, data: bytes) -> bytes:
        self._command(WRITE)
        self._send(_checked(address.to_bytes(4, "big")))
        self._send(_checked(bytes([len(data) - 1]) + data))
        return b""

    def _erase(self, sector: int) -> bytes:
        self._command(ERASE)
        timeout = ERASE_TIMEOUT_S[FLASH_SECTORS[sector].size >> 10]
        self._send(_checked(bytes([0, 0]) + sector.to_bytes(2, "big")), timeout)
        return b""

    def _command(self, command: int) -> None:
        self._send(_with_complement(command))

    def _send(self, data: bytes, timeout: float = TIMEOUT_S) -> None:
        self._transport.write(data)
        self._acknowledged(timeout)

    def _acknowledged(self, timeout: float) -> None:
        answer = self._take(1, timeout)[0]
        if answer == NACK:
            raise _LineError("it refuses", refused=True)
        if answer != ACK:
            raise _LineError(f"it answers 0x{answer:02X}, which is neither yes nor no")

    def _take(self, size: int, timeout: float) -> bytes:
        """Read the next `size` bytes; each piece must arrive within `timeout` [s]."""
        while len(self._pending) < size:
            more = self._transport.read(timeout)
            if not more:
                raise _LineError(f"{len(self._pending)} of {size} bytes came within {timeout:g} s")
            self._pending += more
        data = bytes(self._pending[:size])
        del self._pending[:size]
        return data

    # ---- several ----

    def _ask(self, what: str, command: int, is_right: Callable[[bytes], bool]) -> bytes:
        """Return the answer of `command`, which has no checksum: a wrong answer is asked for once more."""
        answer = self._try(what, self._commands, command)
        return answer if is_right(answer) else self._try(what, self._commands, command)

    def _try(self, what: str, command: Callable[..., bytes], *arguments: object) -> bytes:
        """Repeat `command` until it succeeds, TRIES times at most. Raises LinkError: `what` was not done."""
        failure = _LineError("")
        for tried in range(TRIES):
            self.repeated += tried > 0
            try:
                return command(*arguments)
            except _LineError as error:
                failure = error
            if self._synchronise() is not None:
                failure = _LineError("and then nothing but silence")
                break
        if failure.refused:
            raise RefusedError(
                f"{self.name}: the boot loader refuses to {what}; the chip may be read-protected, which only "
                f"a mass erase with ST's own tools lifts"
            )
        raise LinkError(
            f"{self.name}: the boot loader did not {what} ({failure}), expected it to; check cable and power"
        )

    def _synchronise(self) -> bytes | None:
        """Synchronise, so that a command begins with the next byte. Returns None, or the bytes received
        instead of an answer.

        The first 0x7F after power-up is acknowledged. Later ones complete whatever was cut short, and a pair
        of them is no command: that is refused, which proves that both ends agree.
        """
        heard = self._drain()
        for _ in range(SYNC_TRIES):
            for _ in range(2):
                self._transport.write(bytes([SYNC]))
                answer = self._drain()
                if answer and answer[-1] in (ACK, NACK):
                    return None
                heard += answer
            self._transport.write(bytes([SYNC]) * SYNC_BURST)
            heard += self._drain()
        return heard

    def _drain(self) -> bytes:
        """Read until the line is silent, or for three seconds."""
        heard, end = bytes(self._pending), self._clock() + 3.0
        self._pending.clear()
        while more := self._transport.read(SILENCE_S):
            heard += more
            if len(heard) > DRAIN_BYTES_MAX or self._clock() > end:
                break
        return heard


def _missing(commands: bytes) -> str:
    """List the needed commands that are not among `commands`; "" if all are."""
    return ", ".join(f"0x{code:02X}" for code in NEEDED if code not in commands)


def _with_complement(value: int) -> bytes:
    return bytes([value, value ^ 0xFF])


def _checked(data: bytes) -> bytes:
    return data + bytes([reduce(xor, data, 0)])


def _describe(heard: bytes) -> str:
    """Describe the bytes that came in place of an answer."""
    if not heard:
        return "nobody answers"
    if set(heard) == {SYNC}:
        return "the line echoes what is sent"
    return f"{len(heard)} bytes came that are no answer, such as {heard[:8].hex(' ')}"
