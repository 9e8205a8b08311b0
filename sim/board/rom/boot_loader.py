"""The boot loader in the chip's ROM, on USART1 and USB: what a program in system memory does.

ST's program is not at hand, so no instruction is executed while the core stands in system memory. This stands
for it: it sets up pins and UART by their registers, measures the length of a bit of the first 0x7F, speaks
AN3155, and is ST's DFU device (`dfu.py`) at the end of a USB cable. Who speaks first is served, and nobody
else until the next reset (AN2606). The real one listens on CAN, I2C, SPI and USART3 as well.
"""

from __future__ import annotations

import struct
from enum import Enum, auto

from neuroflight.sim.board.core.context import Kept
from neuroflight.sim.board.core.engine import POWER_UP, Engine
from neuroflight.sim.board.peripherals.flash import Flash
from neuroflight.sim.board.peripherals.iwdg import Iwdg
from neuroflight.sim.board.peripherals.rcc import Rcc
from neuroflight.sim.board.peripherals.usart import Format, Usart
from neuroflight.sim.board.registers.bus import load_table
from neuroflight.sim.board.rom.dfu import DfuDevice
from neuroflight.sim.board.rom.programmer import Programmer
from neuroflight.sim.board.rom.protocol import (
    ACCEPTED,
    ACK,
    FLASH,
    OWN_RAM_BYTES,
    START,
    SYNC,
    SYSTEM_MEMORY,
    Action,
    Erase,
    Go,
    Read,
    Send,
    State,
    Write,
    feed,
)
from neuroflight.toolchain.contract import DTCM

UART = "USART1"
BAUD_MIN, BAUD_MAX = 1200, 115_200  # AN3155, choosing the baud rate
_BAUD_TOLERANCE = 1.03
STACK, RESET = DTCM.address + 0x3000, SYSTEM_MEMORY.address + 0x201  # where ours are, not where ST's are
VERSION_ADDRESS, VERSION = 0x1FF0EDBE, 0x90  # AN2606: boot loader V9.0
CONTENT = ((SYSTEM_MEMORY.address, struct.pack("<2I", STACK, RESET)), (VERSION_ADDRESS, bytes([VERSION])))
_HSI_HZ = 16_000_000
_SYSTICK_CTRL, _NVIC_ISER0, _NVIC_WORDS = 0xE000E010, 0xE000E100, 4


class Stage(Enum):
    """Stages of the program."""

    OFF = auto()  # the core is not in the ROM
    MEASURING = auto()  # waiting for the first 0x7F, or for a USB host
    SERVING = auto()  # USART1
    DFU = auto()  # USB


class BootLoader(Kept):
    """The program in the ROM. Its state goes into snapshots beside USART1's."""

    kept = ("stage", "_state", "_sending", "_start", "_waits")

    def __init__(self, engine: Engine, rcc: Rcc, flash: Flash, usart: Usart, iwdg: Iwdg) -> None:
        """Set up the program after the devices that it uses, whose alarms then go first."""
        self._engine, self._rcc, self._flash, self._usart, self._iwdg = engine, rcc, flash, usart, iwdg
        self.programmer = Programmer(engine, flash)
        self._next = engine.alarm("rom", self._go_on)
        self.dfu = DfuDevice(
            engine,
            flash,
            self.programmer,
            listens=lambda: self.stage in (Stage.MEASURING, Stage.DFU),
            claim=self._serve_usb,
            start=self._start_program,
        )
        self._leave()
        engine.on_rom = self._enter
        engine.on_system_reset(lambda cause: self._leave())
        usart.on_measured, usart.on_received = self._measure, self._poll
        self.programmer.on_done = self._flash_done
        for address, data in CONTENT:
            engine.set_memory(address, data)

    @property
    def runs(self) -> bool:
        """True if the core is in the ROM."""
        return self.stage is not Stage.OFF

    # ---- in and out of the ROM ----

    def _leave(self) -> None:
        self.stage = Stage.OFF
        self._state: State = START
        self._sending = b""  # what is left to answer
        self.programmer.stop()
        self.dfu.reset()
        self._waits = False  # for the alarm that makes it go on
        self._start: int | None = None  # address to start from when the answer has gone

    def _enter(self) -> None:
        """Start when the core has come to system memory, by reset or by a jump."""
        self._expect_reset_state()
        self._leave()
        self.stage = Stage.MEASURING
        self.dfu.enter()
        self._engine.set_memory(DTCM.address, bytes([POWER_UP ^ 0xFF]) * OWN_RAM_BYTES)
        self._set("RCC", "AHB1ENR", "GPIOAEN", 1)
        self._set("RCC", "APB2ENR", "USART1EN", 1)
        for pin in (9, 10):
            self._set("GPIOA", "AFRH", f"AFRH{pin}", 7)
            self._set("GPIOA", "MODER", f"MODER{pin}", 2)

    def _expect_reset_state(self) -> None:
        """Fail if the chip is not as ST's program needs it (AN2606: as after a reset)."""
        engine, entered = self._engine, "the ROM's boot loader is entered"
        if self._iwdg.running:
            engine.fail(
                f"{entered} while the watchdog runs, expected it off: it would reset the chip amid an "
                f"erasure; restart, and jump before it is started"
            )
        stack, pc = engine.register(13), engine.pc | 1
        if (stack, pc & 0xFFFF) != (STACK, RESET & 0xFFFF):
            engine.fail(
                f"{entered} at 0x{pc:08X} with stack pointer 0x{stack:08X}, expected both from the two words "
                f"at 0x{SYSTEM_MEMORY.address:08X}: 0x{RESET:08X} and 0x{STACK:08X}"
            )
        if self._rcc.clocks.core != _HSI_HZ:
            engine.fail(
                f"{entered} with a core clock of {self._rcc.clocks.core} Hz, expected HSI's {_HSI_HZ}: "
                f"restart before the jump"
            )
        interrupts = any(engine.load(_NVIC_ISER0 + 4 * i, 4) for i in range(_NVIC_WORDS))
        if interrupts or engine.load(_SYSTICK_CTRL, 4) & 1:
            engine.fail(
                f"{entered} with interrupts or SysTick on, expected them off: restart before the jump"
            )

    def _start_program(self, address: int) -> None:
        """Reset the peripherals, then start as the two words at `address` say."""
        stack, reset = struct.unpack("<2I", self._engine.memory(address, 8))
        if not reset & 1:
            self._engine.fail(
                f"the ROM's boot loader is told to start at 0x{address:08X}, where the reset vector is "
                f"0x{reset:08X}, expected an odd address"
            )
        for register, field in (("APB2RSTR", "USART1RST"), ("AHB1RSTR", "GPIOARST")):
            self._set("RCC", register, field, 1)
            self._set("RCC", register, field, 0)
        self._set("RCC", "APB2ENR", "USART1EN", 0)
        self._set("RCC", "AHB1ENR", "GPIOAEN", 0)
        self.programmer.lock()
        self._leave()
        self._engine.set_register(13, stack & ~3)
        self._engine.pc = reset & ~1

    def _set(self, block: str, register: str, field: str, value: int) -> None:
        """Set a field as a program does: read, change, write."""
        found = load_table().blocks[block]
        row = found.registers[register]
        address, bits = found.base + row.offset, row.fields[field]
        word = self._engine.load(address, 4) & ~bits.mask
        self._engine.store(address, 4, word | value << bits.lsb)

    # ---- bytes ----

    def _measure(self, byte: int, sender: Format) -> bool:
        """Measure the speed by a byte: the first 0x7F sets it."""
        if self.stage is not Stage.MEASURING:
            return False
        if byte == SYNC and BAUD_MIN / _BAUD_TOLERANCE <= sender.baud <= BAUD_MAX * _BAUD_TOLERANCE:
            divider = round(self._rcc.kernel_clock(UART) / sender.baud)
            self._set(UART, "BRR", "BRR", divider)
            for field in ("M0", "PCE", "TE", "RE", "UE"):  # 8 bits and even parity
                self._set(UART, "CR1", field, 1)
            self.stage = Stage.SERVING
            self._act(ACCEPTED)
        return True

    def _poll(self) -> None:
        """Process received bytes, unless an operation is pending."""
        while self.stage is Stage.SERVING and not self._busy and self._usart.get("ISR", "RXNE"):
            byte = self._usart.read_rdr() & 0xFF
            self._usart.write_icr(self._usart.mask("ICR", "ORECF", "FECF", "PECF"))
            self._state, action = feed(self._state, byte)
            if action is not None:
                self._act(action)

    @property
    def _busy(self) -> bool:
        return bool(self._waits or self._sending or self.programmer.busy)

    def _act(self, action: Action) -> None:
        match action:
            case Send(data):
                self._sending = data
            case Read(address, size):
                self._sending = bytes([ACK]) + self._engine.memory(address, size)
            case Erase(sectors):
                self.programmer.erase(sectors)
                return
            case Write(address, data):
                if FLASH.address <= address < FLASH.address + FLASH.size:
                    self.programmer.program(address, data)
                    return
                self._engine.set_memory(address, data)
                self._sending = bytes([ACK])
            case Go(address):
                self._sending, self._start = bytes([ACK]), address
        self._go_on()

    def _flash_done(self) -> None:
        """Answer when flash has taken what it was told."""
        if self.stage is Stage.DFU:
            self.dfu.flash_done()
            return
        self._sending = bytes([ACK])
        self._go_on()

    def _serve_usb(self) -> None:
        self.stage = Stage.DFU

    def _go_on(self) -> None:
        """Send the next byte, start what is to start, or process what has come."""
        self._waits = False
        if self._sending:
            self._usart.write_tdr(self._sending[0])
            self._sending = self._sending[1:]
            self._set_alarm(self._engine.cycle + self._usart.format.byte_cycles)
        elif self._start is not None:
            self._start_program(self._start)
        else:
            self._poll()

    def _set_alarm(self, cycle: int) -> None:
        self._waits = True
        self._next.set(cycle)
