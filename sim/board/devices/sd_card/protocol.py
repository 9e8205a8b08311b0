"""The protocol of an SD card in SPI mode, after power-up: commands, responses and blocks.

Source: Physical Layer Simplified Specification, 7 (SPI mode) and 4.3 (what the commands do). What the host
does wrong is answered as the specification says, or not at all where it leaves that open.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from neuroflight.sim.board.core.context import Kept
from neuroflight.sim.board.devices.sd_card import registers as sd
from neuroflight.sim.board.devices.sd_card.delays import Delays
from neuroflight.sim.board.devices.sd_card.faults import LineErrors
from neuroflight.sim.board.devices.sd_card.store import Store

COMMAND_BYTES = 6
BLOCK_BYTES = sd.BLOCK + 2  # on the line, with the checksum
_IN_IDLE = {0, 8, 55, 58, 59}  # commands that a card takes before its initialisation (7.2.1, table 7-3)
_IN_TRANSFER = {0, 12, 13}  # and while blocks are read or written
_DURING_ERASE = {13, 32, 33, 38}  # which do not end a sequence of erase commands
_VOLTAGE = 0x1  # of CMD8: 2.7 to 3.6 V


@dataclass
class State:
    """The protocol's state, by default that after power-up."""

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


class Protocol(Kept):
    """The answers to whole commands and blocks. Times are cycles of 216 MHz."""

    kept = ("now", "_stall")

    def __init__(self, store: Store, delays: Delays, line: LineErrors, serial: int) -> None:
        self.now = State()
        # Called with a block to be written: address, data, cycle; returns False if it can no longer be
        # written.
        self.before_write: Callable[[int, bytes, int], bool] = lambda address, data, at: True
        self._store, self._delays, self._line, self._serial = store, delays, line, serial
        self._stall = 0  # by how much the next wait is longer
        self._told = 0  # further bits of the present command's answer
        self._commands: dict[int, Callable[[int, int], None]] = {
            8: self._send_interface,
            9: lambda argument, at: self._read_register(sd.csd(store.image.blocks), at),
            10: lambda argument, at: self._read_register(sd.cid(serial), at),
            12: self._stop,
            13: lambda argument, at: self._send_status(),
            16: lambda argument, at: self._answer(0 if argument <= sd.BLOCK else sd.PARAMETER),
            17: lambda argument, at: self._read(argument, at, multiple=False),
            18: lambda argument, at: self._read(argument, at, multiple=True),
            24: lambda argument, at: self._write(argument, multiple=False),
            25: lambda argument, at: self._write(argument, multiple=True),
            32: lambda argument, at: self._set_erase("erase_first", argument),
            33: lambda argument, at: self._set_erase("erase_last", argument),
            38: self._erase,
            55: self._announce_application,
            58: self._send_ocr,
            59: self._set_crc,
        }
        self._application: dict[int, Callable[[int, int], None]] = {
            13: lambda argument, at: self._read_register(sd.sd_status(), at, self._status()),
            22: lambda argument, at: self._read_register(self.now.well_written.to_bytes(4, "big"), at),
            23: lambda argument, at: self._answer(),
            41: self._initialise,
            51: lambda argument, at: self._read_register(sd.scr(store.erased), at),
        }

    def stall(self, at: int, cycles: int) -> None:
        """Make the present wait, or the next one, longer by `cycles`."""
        state = self.now
        if at < state.busy_until:
            state.busy_until += cycles
            self._store.finish_at(state.busy_until)
        elif state.reading and at < state.data_at:
            state.data_at += cycles
        else:
            self._stall += cycles

    def deselect(self) -> None:
        """Handle an edge of the select line: output is discarded; the next block may be written."""
        state = self.now
        state.out, state.data, state.wanted = b"", b"", 0
        state.reading = state.reading and state.multiple
        state.writing = state.writing and state.multiple

    # ---- commands ----

    def command(self, frame: bytes, at: int) -> None:
        """Handle a command of 6 bytes that came at cycle `at`."""
        state = self.now
        frame = self._line.damaged(frame)
        index, argument = frame[0] & 0x3F, int.from_bytes(frame[1:5], "big")
        right = sd.crc7(frame[:5]) == frame[5]
        if not state.spi:
            if index == 0 and right:
                self._restart()
            return
        if at < state.busy_until and index != 0:
            return
        if not right and (state.crc or index in (0, 8)):
            self._answer(sd.COMMAND_CRC)
            return
        application, state.application = state.application, False
        if index == 0:
            self._restart()
        elif not self._allowed(index, application=application):
            self._answer(sd.ILLEGAL)
        else:
            self._run(index, argument, at, application=application)

    def _allowed(self, index: int, *, application: bool) -> bool:
        """Return True if the card accepts this command in its present state."""
        state = self.now
        if state.idle:
            return index in _IN_IDLE or (application and index == 41)
        return index in _IN_TRANSFER or not (state.reading or state.writing)

    def _run(self, index: int, argument: int, at: int, *, application: bool) -> None:
        state = self.now
        erasing = state.erase_first is not None or state.erase_last is not None
        run = (self._application.get(index) if application else None) or self._commands.get(index)
        if run is None:
            self._answer(sd.ILLEGAL)
            return
        if erasing and index not in _DURING_ERASE:
            state.erase_first = state.erase_last = None
            self._told = sd.ERASE_RESET
        run(argument, at)
        self._told = 0

    def _restart(self) -> None:
        """Handle CMD0: forget everything except stored data."""
        self.now = State(spi=True)
        self._answer()

    def _r1(self, flags: int = 0) -> int:
        return flags | self._told | (sd.IDLE if self.now.idle else 0)

    def _answer(self, flags: int = 0, more: bytes = b"") -> None:
        """Answer R1 with `flags` and `more` after 1 to 3 bytes (N_CR, 7.5.4: 1 to 8)."""
        self.now.out = b"\xff" * (1 + self._delays.choice(3)) + bytes([self._r1(flags)]) + more

    def _status(self) -> bytes:
        """Return and clear the second byte of R2."""
        status, self.now.status = self.now.status, 0
        return bytes([status])

    def _send_status(self) -> None:
        self._answer(0, self._status())

    def _send_interface(self, argument: int, at: int) -> None:
        voltage = argument >> 8 & 0xF
        self.now.voltage_told = self.now.voltage_told or voltage == _VOLTAGE
        self._answer(0, bytes((0, 0, voltage if voltage == _VOLTAGE else 0, argument & 0xFF)))

    def _send_ocr(self, argument: int, at: int) -> None:
        self._answer(0, sd.ocr(not self.now.idle))

    def _set_crc(self, argument: int, at: int) -> None:
        self.now.crc = bool(argument & 1)
        self._answer()

    def _announce_application(self, argument: int, at: int) -> None:
        self.now.application = True
        self._answer()

    def _initialise(self, argument: int, at: int) -> None:
        """Handle ACMD41: a card of high capacity starts only for a host that supports such cards (4.2.3)."""
        state = self.now
        if state.ready_at is None and state.voltage_told and argument & sd.HIGH_CAPACITY:
            state.ready_at = at + self._delays.start()
        if state.ready_at is not None and at >= state.ready_at:
            state.idle = False
        self._answer()

    # ---- reading ----

    def _read(self, address: int, at: int, *, multiple: bool) -> None:
        if address >= self._store.image.blocks:
            self._answer(sd.PARAMETER)
            return
        state = self.now
        state.reading, state.multiple, state.address, state.payload = True, multiple, address, b""
        state.data_at = at + self._delays.read(at, first=True) + self._stalled()
        self._answer()

    def _read_register(self, payload: bytes, at: int, more: bytes = b"") -> None:
        state = self.now
        state.reading, state.multiple, state.payload = True, False, payload
        state.data_at = at + self._delays.register() + self._stalled()
        self._answer(0, more)

    def next_data(self, at: int) -> None:
        """Send the awaited data: a token and a block, or an error."""
        state = self.now
        if state.payload:
            data = state.payload
        elif state.address >= self._store.image.blocks:
            state.out, state.reading = bytes([sd.RANGE_TOKEN]), False
            state.status |= sd.OUT_OF_RANGE
            return
        else:
            data = self._store.image.read(state.address)
            state.address += 1
        state.out = bytes([sd.START]) + self._line.damaged(data + sd.crc16(data))
        state.reading = state.multiple
        if state.multiple:
            state.data_at = at + self._delays.read(at, first=False) + self._stalled()

    def _stop(self, argument: int, at: int) -> None:
        """Handle CMD12: end reading or writing of several blocks."""
        state = self.now
        if not state.reading and not state.writing:
            self._answer(sd.ILLEGAL)
            return
        state.reading = state.writing = False
        self._answer()
        state.out = b"\x7f" + state.out  # a byte of the block that was under way
        state.busy_until = at + self._delays.stop(at) + self._stalled()

    # ---- writing ----

    def _write(self, address: int, *, multiple: bool) -> None:
        if address >= self._store.image.blocks:
            self._answer(sd.PARAMETER)
            return
        state = self.now
        state.writing, state.multiple, state.address = True, multiple, address
        state.wanted, state.data, state.well_written = 0, b"", 0
        self._answer()

    def token(self, byte: int, at: int) -> bool:
        """Handle the first byte of a block, or of the end; return False if it is neither."""
        state = self.now
        if byte == (sd.START_MULTIPLE if state.multiple else sd.START):
            state.wanted, state.data = BLOCK_BYTES, b""
            return True
        if byte == sd.STOP and state.multiple:
            state.writing = False
            state.out = b"\xff"
            state.busy_until = at + self._delays.stop(at) + self._stalled()
            return True
        return False

    def receive(self, part: bytes, at: int) -> None:
        """Receive bytes of a block, the last one of which came at cycle `at`."""
        state = self.now
        state.data += part
        state.wanted -= len(part)
        if state.wanted:
            return
        block = self._line.damaged(state.data)
        state.data, state.writing = b"", state.multiple
        data = block[: sd.BLOCK]
        if state.crc and sd.crc16(data) != block[sd.BLOCK :]:
            state.out = bytes([sd.CRC_ERROR])
        elif state.address >= self._store.image.blocks:
            state.out = bytes([sd.WRITE_ERROR])
            state.status |= sd.OUT_OF_RANGE
        elif self.before_write(state.address, data, at):
            self._program(data, at)

    def _program(self, data: bytes, at: int) -> None:
        state = self.now
        state.busy_until = at + self._delays.write(at) + self._stalled()
        if self._store.write(state.address, data):
            self._store.finish_at(state.busy_until)
            state.out = bytes([sd.ACCEPTED])
            state.well_written += 1
            state.address += 1
        else:
            state.out = bytes([sd.WRITE_ERROR])
            state.status |= sd.ERROR

    def _set_erase(self, which: str, address: int) -> None:
        if address >= self._store.image.blocks:
            self._answer(sd.PARAMETER)
            return
        setattr(self.now, which, address)
        self._answer()

    def _erase(self, argument: int, at: int) -> None:
        state = self.now
        first, last = state.erase_first, state.erase_last
        state.erase_first = state.erase_last = None
        if first is None or last is None:
            self._answer(sd.ERASE_SEQUENCE)
        elif first > last:
            state.status |= sd.ERASE_PARAMETER
            self._answer(sd.PARAMETER)
        else:
            self._store.image.erase(first, last, self._store.erased)
            state.busy_until = at + self._delays.erase(at, last - first + 1) + self._stalled()
            self._answer()

    def _stalled(self) -> int:
        stall, self._stall = self._stall, 0
        return stall
