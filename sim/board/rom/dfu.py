"""The boot loader in the chip's ROM on USB: ST's DfuSe device (AN3156), at the end of the cable.

DFU 1.1 with ST's commands: DNLOAD of block 0 sets the address pointer (0x21), erases (0x41) or lifts the read
protection (0x92); DNLOAD and UPLOAD of block n >= 2 write and read (n - 2) * 2048 bytes behind the pointer.
An order is carried out behind the GETSTATUS that follows it, and whatever the host asks meanwhile waits for
its end. What went wrong stands in the GETSTATUS after that.

AN3156's text of 2010 (as AN2662, chapter 4.5) and what `dfu-util -l` shows of an F722 are all that was at
hand. Not here: the option bytes and the OTP area, which the descriptors name and any order refuses as a wrong
address; what the ROM does with clocks and the OTG's registers, which nobody sees from outside.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.peripherals.flash import Flash
from neuroflight.sim.board.rom.control_pipe import ControlPipe, Setup
from neuroflight.sim.board.rom.dfu_descriptors import ALTERNATES, TRANSFER_BYTES, descriptor
from neuroflight.sim.board.rom.programmer import Programmer, erase_cycles, program_cycles
from neuroflight.sim.board.rom.protocol import FLASH, READABLE, WRITABLE, lies_in
from neuroflight.sim.board.usb.cable import Answer, Handshake
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_SECTORS

GET, SET_ADDRESS, ERASE, READ_UNPROTECT = 0x00, 0x21, 0x41, 0x92  # ST's commands in block 0
COMMANDS = bytes([GET, SET_ADDRESS, ERASE, READ_UNPROTECT])
_COME_MS = 50  # from the ROM's start on: it measures the crystal first; its time is not known
_LEAVE_MS = 10  # until the device is gone, behind the status stage; the ROM's is not known
_MOMENT_MS = 1  # of the orders that take no time
_MILLISECOND = TIME_HZ // 1000
_UNPROTECTED = 0xAA  # RDP
_POINTER_BYTES = 5  # of a command with an address
_CLASS_IN, _CLASS_OUT = 0xA1, 0x21  # requests of the DFU class, to the interface
_DEVICE_IN, _DEVICE_OUT, _INTERFACE_IN, _INTERFACE_OUT = 0x80, 0x00, 0x81, 0x01


class Request(IntEnum):
    """Requests of DFU 1.1, table 3.2."""

    DETACH = 0
    DNLOAD = 1
    UPLOAD = 2
    GETSTATUS = 3
    CLRSTATUS = 4
    GETSTATE = 5
    ABORT = 6


class Standard(IntEnum):
    """Requests of USB 2.0, table 9-4, that it knows."""

    GET_STATUS = 0
    CLEAR_FEATURE = 1
    SET_ADDRESS = 5
    GET_DESCRIPTOR = 6
    GET_CONFIGURATION = 8
    SET_CONFIGURATION = 9
    GET_INTERFACE = 10
    SET_INTERFACE = 11


class State(IntEnum):
    """States of DFU 1.1, chapter 6.1.2."""

    IDLE = 2
    DNLOAD_SYNC = 3
    DNBUSY = 4
    DNLOAD_IDLE = 5
    MANIFEST_SYNC = 6
    MANIFEST = 7
    UPLOAD_IDLE = 9
    ERROR = 10


class Status(IntEnum):
    """Those of DFU 1.1's that AN3156 has."""

    OK = 0
    TARGET = 1  # not an address that it writes
    VENDOR = 11  # read protection
    STALLED = 15  # a request that it does not know


class DfuDevice(Kept):
    """A `cable.Device` while the core is in the ROM and USART1 was not first."""

    kept = (
        *("_powered", "_comes", "phase", "status", "_configuration", "_alternate"),
        *("_pointer", "_order", "_leaves", "_unprotects"),
    )

    def __init__(
        self,
        engine: Engine,
        flash: Flash,
        programmer: Programmer,
        *,
        listens: Callable[[], bool],
        claim: Callable[[], None],
        start: Callable[[int], None],
    ) -> None:
        """Set up the device after `programmer`.

        listens: whether the ROM serves USB, or nobody yet. claim: from now on it serves USB alone. start:
        starts the program whose vectors lie at the address.
        """
        self._engine, self._flash, self._programmer = engine, flash, programmer
        self._listens, self._claim, self._start = listens, claim, start
        self.pipe = ControlPipe(self._answer, self._accept, self._done)
        self._leaving = engine.alarm("rom.dfu", self._leave)
        self._powered = False  # by the cable
        self._comes = 0  # the cycle from which on it holds D+ high
        self.reset()

    def reset(self) -> None:
        """Forget all but the cable, as when the ROM is entered or left."""
        self._pointer = FLASH_BASE
        self._leaves: int | None = None  # the address to start from
        self._unprotects = False  # when the chip is erased
        self._leaving.cancel()
        self.bus_reset()

    def enter(self) -> None:
        """Begin anew with the ROM's program: after a while it is there."""
        self.reset()
        self._comes = self._engine.cycle + _COME_MS * _MILLISECOND

    # ---- the cable ----

    @property
    def attached(self) -> bool:
        """See cable.Device. The ROM does not look at VBUS; without a cable it is all the same."""
        return self._powered and self._listens() and self._engine.cycle >= self._comes

    @property
    def wakes(self) -> bool:
        """See cable.Device: never."""
        return False

    def vbus(self, present: bool) -> None:
        """See cable.Device."""
        self._powered = present
        self.bus_reset()

    def bus_reset(self) -> None:
        """See cable.Device. An erasure that is under way goes on."""
        self.pipe.reset()
        self.phase, self.status = State.IDLE, Status.OK
        self._configuration = self._alternate = 0
        self._order: tuple[int, bytes] | None = None  # block and data of DNLOAD, not yet carried out

    def suspend(self) -> None:
        """See cable.Device."""

    def resume(self) -> None:
        """See cable.Device."""

    def start_of_frame(self, number: int) -> None:
        """See cable.Device."""

    def setup(self, address: int, endpoint: int, data: bytes) -> Handshake:
        """See cable.Device. The first one that it hears makes the ROM serve USB alone."""
        if not self.attached:
            return Handshake.SILENT
        answer = self.pipe.setup(address, endpoint, data)
        if answer is Handshake.ACK:
            self._claim()
        return answer

    def out(self, address: int, endpoint: int, toggle: int, data: bytes) -> Handshake:
        """See cable.Device."""
        return self.pipe.out(address, endpoint, toggle, data) if self.attached else Handshake.SILENT

    def take(self, address: int, endpoint: int) -> Answer:
        """See cable.Device."""
        return self.pipe.take(address, endpoint) if self.attached else Handshake.SILENT

    # ---- requests ----

    def _answer(self, setup: Setup) -> bytes | Handshake:
        """Return what a request reads; NAK while an order is carried out."""
        if self._programmer.busy:
            return Handshake.NAK
        reads: dict[tuple[int, int], Callable[[], bytes | None]] = {
            (_CLASS_IN, Request.GETSTATUS): lambda: self._tell_status(),
            (_CLASS_IN, Request.GETSTATE): lambda: bytes([self.phase]),
            (_CLASS_IN, Request.UPLOAD): lambda: self._upload(setup.value, setup.length),
            (_DEVICE_IN, Standard.GET_DESCRIPTOR): lambda: descriptor(setup.value),
            (_INTERFACE_IN, Standard.GET_DESCRIPTOR): lambda: descriptor(setup.value),
            (_DEVICE_IN, Standard.GET_STATUS): lambda: b"\1\0",  # self-powered, as it says
            (_INTERFACE_IN, Standard.GET_STATUS): lambda: b"\0\0",
            (_DEVICE_IN, Standard.GET_CONFIGURATION): lambda: bytes([self._configuration]),
            (_INTERFACE_IN, Standard.GET_INTERFACE): lambda: bytes([self._alternate]),
        }
        read = reads.get((setup.kind, setup.number))
        answer = None if read is None else read()
        return self._refused(setup, _CLASS_IN) if answer is None else answer

    def _accept(self, setup: Setup, data: bytes) -> Handshake:
        """Take a request that writes; NAK while an order is carried out."""
        if self._programmer.busy:
            return Handshake.NAK
        writes: dict[tuple[int, int], Callable[[], bool]] = {
            (_CLASS_OUT, Request.DNLOAD): lambda: self._download(setup.value, data),
            (_CLASS_OUT, Request.CLRSTATUS): lambda: self._idle((State.ERROR,)),
            (_CLASS_OUT, Request.ABORT): lambda: self._idle(_IDLE),
            (_DEVICE_OUT, Standard.SET_ADDRESS): lambda: True,  # the pipe takes it
            (_DEVICE_OUT, Standard.SET_CONFIGURATION): lambda: self._configure(setup.value),
            (_INTERFACE_OUT, Standard.SET_INTERFACE): lambda: self._select(setup.value),
        }
        write = writes.get((setup.kind, setup.number))
        taken = write is not None and write()
        return Handshake.ACK if taken else self._refused(setup, _CLASS_OUT)

    def _refused(self, setup: Setup, kind: int) -> Handshake:
        """Refuse a request. One of the class is an error until CLRSTATUS (DFU 1.1, chapter 6.1.2)."""
        if setup.kind == kind and self.phase is not State.ERROR:
            self.phase, self.status = State.ERROR, Status.STALLED
        return Handshake.STALL

    def _idle(self, states: tuple[State, ...]) -> bool:
        if self.phase not in states:
            return False
        self.phase, self.status, self._order = State.IDLE, Status.OK, None
        return True

    def _configure(self, value: int) -> bool:
        if value > 1:
            return False
        self._configuration, self._alternate = value, 0
        return True

    def _select(self, alternate: int) -> bool:
        if not self._configuration or alternate >= ALTERNATES:
            return False
        self._alternate = alternate
        return True

    def _done(self, setup: Setup) -> None:
        """Carry out what GETSTATUS has announced."""
        if (setup.kind, setup.number) != (_CLASS_IN, Request.GETSTATUS):
            return
        if self.phase is State.DNBUSY and self._order is not None:
            (block, data), self._order = self._order, None
            self._perform(block, data)
        elif self.phase is State.MANIFEST and self._leaves is None:
            self._leaves = self._pointer
            self._leaving.set(self._engine.cycle + _LEAVE_MS * _MILLISECOND)

    def _tell_status(self) -> bytes:
        wait = 0
        if self.phase is State.DNLOAD_SYNC:
            assert self._order is not None
            self.phase, wait = State.DNBUSY, self._milliseconds(*self._order)
        elif self.phase is State.MANIFEST_SYNC:
            self.phase, wait = State.MANIFEST, _LEAVE_MS
        return bytes([self.status]) + wait.to_bytes(3, "little") + bytes([self.phase, 0])

    def _upload(self, block: int, length: int) -> bytes | None:
        if self.phase not in (State.IDLE, State.UPLOAD_IDLE) or block == 1 or length > TRANSFER_BYTES:
            return None
        if block == 0:
            return COMMANDS
        address = self._address(block)
        if self._protected or not lies_in(READABLE, address, length):
            self.phase = State.ERROR
            self.status = Status.VENDOR if self._protected else Status.TARGET
            return None
        self.phase = State.UPLOAD_IDLE
        return self._engine.memory(address, length)

    def _download(self, block: int, data: bytes) -> bool:
        """Take an order, or the wish to leave: DNLOAD without data."""
        if self.phase not in (State.IDLE, State.DNLOAD_IDLE) or block == 1 or len(data) > TRANSFER_BYTES:
            return False
        if data:
            self.phase, self._order = State.DNLOAD_SYNC, (block, data)
        else:
            self.phase = State.MANIFEST_SYNC
        return True

    # ---- orders ----

    @property
    def _protected(self) -> bool:
        """True if RDP allows neither reading nor writing from the ROM."""
        return self._flash.options.optcr >> 8 & 0xFF != _UNPROTECTED

    def _address(self, block: int) -> int:
        """Return the address of a block. AN3156 calls the factor the length of the data as well as
        wTransferSize; here it is the latter, 2048, for a shorter block, too."""
        return self._pointer + (block - 2) * TRANSFER_BYTES

    def _milliseconds(self, block: int, data: bytes) -> int:
        """Estimate an order's time, bwPollTimeout, by the typical times of flash."""
        cycles = 0
        if block:
            cycles = program_cycles(len(data))
        elif data[0] == READ_UNPROTECT or data == bytes([ERASE]):
            cycles = erase_cycles(None)
        elif data[0] == ERASE and (sector := _sector(data)) is not None:
            cycles = erase_cycles((sector,))
        return max(_MOMENT_MS, -(-cycles // _MILLISECOND))

    def _perform(self, block: int, data: bytes) -> None:
        """Begin with an order, or refuse it: the next GETSTATUS tells."""
        status = self._begin(block, data)
        if status is not Status.OK:
            self.phase, self.status = State.ERROR, status
        elif not self._programmer.busy:
            self.phase = State.DNLOAD_IDLE

    def _begin(self, block: int, data: bytes) -> Status:
        command = data[0]
        if self._protected and (block or command != READ_UNPROTECT):
            return Status.VENDOR
        if block:
            return self._write(self._address(block), data)
        if data == bytes([READ_UNPROTECT]):
            return self._unprotect()
        if data == bytes([ERASE]):
            self._programmer.erase(None)
            return Status.OK
        if len(data) != _POINTER_BYTES or command not in (SET_ADDRESS, ERASE):
            return Status.STALLED
        address = int.from_bytes(data[1:], "little")
        if command == SET_ADDRESS and lies_in(READABLE, address, 1):
            self._pointer = address
            return Status.OK
        if command == ERASE and (sector := _sector(data)) is not None:
            self._programmer.erase((sector,))
            return Status.OK
        return Status.TARGET

    def _write(self, address: int, data: bytes) -> Status:
        if not lies_in(WRITABLE, address, len(data)):
            return Status.TARGET
        if lies_in((FLASH,), address, len(data)):
            self._programmer.program(address, data)
        else:
            self._engine.set_memory(address, data)
        return Status.OK

    def _unprotect(self) -> Status:
        """Erase the chip; `flash_done` then lifts the protection and resets it."""
        self._unprotects = True
        self._programmer.erase(None)
        return Status.OK

    def flash_done(self) -> None:
        """Take the end of erasing or programming."""
        if self._unprotects:
            self._unprotects = False
            options = self._flash.options
            optcr = options.optcr & ~0xFF00 | _UNPROTECTED << 8
            self._flash.options = options.with_registers(optcr, options.optcr1, options.optcr2)
            self._engine.system_reset("pin")
        elif self.phase is State.DNBUSY:
            self.phase = State.DNLOAD_IDLE

    def _leave(self) -> None:
        """Disconnect and start what the address pointer points to."""
        assert self._leaves is not None
        self._start(self._leaves)


_IDLE = (State.IDLE, State.DNLOAD_SYNC, State.DNLOAD_IDLE, State.MANIFEST_SYNC, State.UPLOAD_IDLE)


def _sector(command: bytes) -> int | None:
    """Return the number of the sector that a command's address lies in; None: in no flash."""
    address = int.from_bytes(command[1:], "little")
    found = (n for n, s in enumerate(FLASH_SECTORS) if s.address <= address < s.address + s.size)
    return next(found, None) if len(command) == _POINTER_BYTES else None
