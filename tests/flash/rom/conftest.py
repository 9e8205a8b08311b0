"""An emulated chip in its ROM: for a client in lockstep, and for programs behind a pseudo terminal or TCP."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from neuroflight.flash.link.transport import Transport
from neuroflight.flash.rom.client import RomClient
from neuroflight.flash.rom.segments import Segment
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import Bridge, End, LineTransport, UartLine
from neuroflight.sim.board.serial.idle_board import STEP, IdleBoard
from neuroflight.sim.board.usb.usbip import UsbIpServer
from neuroflight.toolchain.contract import FLASH_BANK_A, FLASH_BASE, FLASH_BYTES, FLASH_POLICY_SLOTS

BAUD = 115_200
# Vectors and two instructions, which wait for ever; and what stands for a bank.
BOOT = bytes.fromhex("00000120 41000008") + bytes(56) + bytes.fromhex("30bf fde7")
BANK = bytes(range(1, 252)) + b"in two pieces"
SMALL = (Segment(FLASH_BASE, BOOT), Segment(FLASH_BANK_A.address, BANK))
FULL = bytes(i % 251 + 1 for i in range(FLASH_BYTES))  # a chip in use
SLOT_B = Segment(FLASH_POLICY_SLOTS[1].address, bytes(4))  # which every installation clears


def flash_with(segments: tuple[Segment, ...], under: bytes = b"\xff" * FLASH_BYTES) -> bytes:
    """The whole flash with these in it."""
    flash = bytearray(under)
    for segment in segments:
        flash[segment.address - FLASH_BASE : segment.end - FLASH_BASE] = segment.data
    return bytes(flash)


@dataclass
class Rig:
    """A chip, and clients on its line."""

    idle: IdleBoard
    line: UartLine = field(init=False)

    def __post_init__(self) -> None:
        self.line = UartLine(self.idle.board, "USART1", Format(BAUD, parity="E"))

    def _run_to(self, cycle: int) -> None:
        """A whole slice: the ROM is in no hurry, and erasing takes seconds."""
        self.idle.board.run_to(max(cycle, self.idle.board.cycle + STEP))

    def renew(self, flash: bytes) -> None:
        """The chip after a power cycle, holding `flash`."""
        self.idle.board.engine.set_memory(FLASH_BASE, flash)
        self.idle.board.reset()

    def check_whole(self) -> None:
        """Both parts of the image stand in flash, and what lies between their sectors is as it was."""
        flash = self.idle.flash()
        assert flash[: len(BOOT)] == BOOT
        assert flash[0x20000 : 0x20000 + len(BANK)] == BANK
        assert flash[0x4000:0x20000] == FULL[0x4000:0x20000]

    def client(self, around: Callable[[Transport], Transport] = lambda transport: transport) -> RomClient:
        """A client in lockstep; `around` may spoil its line."""
        transport = LineTransport(self.line, self._run_to)
        return RomClient(around(transport), transport.clock)


@pytest.fixture
def rig() -> Iterator[Callable[..., Rig]]:
    """Powers chips that hold `flash` with their BOOT button held."""
    boards = []

    def make(flash: bytes = b"") -> Rig:
        boards.append(IdleBoard(flash, boot_button=True, newly_installed=True))
        boards[-1].boot()
        return Rig(boards[-1])

    yield make
    for board in boards:
        board.close()


class Served:
    """A chip whose UART1 other programs reach at `end`, or its USB connector; it runs as fast as it can, in a
    thread of its own."""

    def __init__(self, end: End | None, flash: bytes = b"") -> None:
        """end: None: its USB connector, by USB/IP on `usb_port`."""
        self.idle = IdleBoard(flash, boot_button=True, newly_installed=True)
        self.idle.boot()
        self._bridge: Bridge | UsbIpServer
        if end is None:
            self._bridge = UsbIpServer([self.idle.board.hardware.usb_host], 0)
            self.usb_port = self._bridge.port
        else:
            self.end = end
            self._bridge = Bridge(UartLine(self.idle.board, "USART1", Format(BAUD)), end)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def _live(self) -> None:
        while not self._ended.is_set():
            self._bridge.exchange(STEP)
            self.idle.run_to(self.idle.board.cycle + STEP)

    def stop(self) -> None:
        """The chip stands still, to be looked at; may be called twice."""
        self._ended.set()
        self._thread.join()

    def close(self) -> None:
        """Give all back."""
        self.stop()
        self._bridge.close()
        self.idle.close()
