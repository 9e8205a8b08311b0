"""An idle board: powered, motionless, full battery; programs talk to its serial ports.

`IdleBoard` is a board whose sensors measure what they do at rest; `configured` stores settings in a board's
flash as a pilot does, over MSP.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from neuroflight.flash.link.client import Client
from neuroflight.flash.settings.values import Settings, as_stored, in_order
from neuroflight.sim.arrays import Array
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.devices.gyro_mount import accel_counts, gyro_counts
from neuroflight.sim.board.devices.log_place import LogChip
from neuroflight.sim.board.fitted import FULL_VOLTS, GYRO, MATEKF722, Gyro, image_lines
from neuroflight.sim.board.peripherals.signals import uart_name
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import MSP_UART, LineTransport, UartLine
from neuroflight.sim.board.serial.usb_peer import UsbPeer, plug
from neuroflight.toolchain.boards import facts
from neuroflight.toolchain.contract import (
    FLASH_BANK_A,
    FLASH_BANK_B,
    FLASH_BASE,
    FLASH_BOOT,
    FLASH_BYTES,
    GRAVITY,
    MSP_BAUD_DEFAULT,
)
from neuroflight.toolchain.cortex_m7.emulator import Program, load_program
from neuroflight.toolchain.errors import LinkError

STEP = TIME_HZ // 1000  # cycles between two measurements, and two exchanges with programs: 1 ms
# At rest: MPU-6500 product specification, 3.1 and 3.2 (0.01 deg/s/rtHz and 300 ug/rtHz over 250 Hz).
GYRO_NOISE, ACCEL_NOISE = np.radians(0.16), 0.005 * GRAVITY  # standard deviations [rad/s], [m/s^2]
TEMPERATURE_DEG_C = 26.0  # of the gyro chip
NOISE_STEPS = 1000  # drawn at once
BOOT_S = 2.0  # within which an image is up, if it ever is
LAG_MAX_S = 0.1  # greatest lag behind real time; a longer one is not caught up
FLASH_REST = TIME_HZ // 10  # cycles without an operation after which flash is worth keeping


class IdleBoard:
    """A board of its own that lies still. Repeatable to the bit while no program talks to it."""

    def __init__(
        self,
        flash: bytes,
        *,
        elf: Path | None = None,
        wiring: facts.Board = MATEKF722,
        volts: float = FULL_VOLTS,
        gyro: Gyro = GYRO,
        card: LogChip | None = None,
        seed: int = 0,
        boot_button: bool = False,
        newly_installed: bool = False,
        watchdog_resets: bool = False,
    ) -> None:
        """flash: its content; elf: the image's, for names and lines. seed: of the sensors' noise.

        boot_button: held at power-up, so that the boot loader in the chip's ROM runs. card, newly_installed,
        watchdog_resets: see Board. Raises BuildError if the engine cannot be built or `elf` is no ELF of an
        image.
        """
        self.board = Board(
            flash,
            elf=elf,
            board=wiring,
            chip=gyro.chip,
            card=card,
            boot_button=boot_button,
            newly_installed=newly_installed,
            watchdog_resets=watchdog_resets,
        )
        self._msp = image_lines(flash, wiring).msp
        self.msp_uart = MSP_UART if self._msp is None else uart_name(self._msp)
        self._alignment, self._temperature = gyro.alignment, gyro.chip.temperature(TEMPERATURE_DEG_C)
        up = np.array((0.0, 0.0, GRAVITY))
        self._gravity = (up if gyro.to_board is None else gyro.to_board @ up).tolist()
        self.board.hardware.adc.set_battery(volts, 0.0)
        self.run_core = self.board.run_to  # to a cycle; a debugger may stand in for it
        self._rng = np.random.default_rng(seed)
        self._noise: Array = np.empty((0, 6))
        self._measured = 0  # cycle of the next measurement

    def run_to(self, cycle: int) -> None:
        """Let the board run until `cycle`. Raises BoardError for what it does not allow."""
        while self.board.cycle < cycle:
            if not 0 < self._measured - self.board.cycle <= STEP:
                self._measure()
                self._measured = self.board.cycle // STEP * STEP + STEP
            self.run_core(min(cycle, self._measured))

    def boot(self) -> None:
        """Run until the image hears its MSP line, or the ROM runs, or for 2 s. Raises BoardError."""
        end = self.board.cycle + round(BOOT_S * TIME_HZ)
        uart, rom = self.board.hardware.usarts[self.msp_uart], self.board.hardware.rom
        while self.board.cycle < end and not (uart.words["CR1"] & 1 or rom.runs):
            self.run_to(self.board.cycle + STEP)

    def client(self, baud: float = MSP_BAUD_DEFAULT, uart: str | None = None) -> Client:
        """Open an MSP client on the other end of `uart`, in lockstep with the board.

        By default the UART that speaks MSP, and USB where none does.
        """
        if uart is None and self._msp is None:
            self.board.hardware.usb_host.unplug()
            return UsbPeer(self, plug(self)).client()
        transport = LineTransport(UartLine(self.board, uart or self.msp_uart, Format(baud)), self.run_to)
        return Client(transport, transport.clock)

    def flash(self) -> bytes:
        return self.board.engine.memory(FLASH_BASE, FLASH_BYTES)

    def close(self) -> None:
        self.board.close()

    def _measure(self) -> None:
        if not len(self._noise):
            scale = [GYRO_NOISE] * 3 + [ACCEL_NOISE] * 3
            self._noise = self._rng.normal(0.0, scale, (NOISE_STEPS, 6))
        (*rate, x, y, z), self._noise = self._noise[0].tolist(), self._noise[1:]
        force = [noise + gravity for noise, gravity in zip((x, y, z), self._gravity, strict=True)]
        self.board.hardware.gyro.measure(
            accel_counts(force, self._alignment),
            self._temperature,
            gyro_counts(rate, self._alignment, self.board.hardware.gyro.kind.gyro_scale),
        )


class Keeper:
    """A watcher of flash that hands on its content once a change is complete."""

    def __init__(self, idle: IdleBoard, keep: Callable[[bytes], None]) -> None:
        self._idle, self._keep = idle, keep
        self._seen = self._kept = idle.board.hardware.flash.operations
        self._since = 0  # cycle at which the last operation was seen

    def note_change(self) -> None:
        """Note that something else than the program changed flash: a debugger."""
        self._kept, self._since = -1, self._idle.board.cycle

    def update(self, *, at_once: bool = False) -> None:
        """Hand on changed content once no flash operation has come for a while, or at once."""
        operations, cycle = self._idle.board.hardware.flash.operations, self._idle.board.cycle
        if operations != self._seen:
            self._seen, self._since = operations, cycle
        if operations != self._kept and (at_once or cycle - self._since >= FLASH_REST):
            self._kept = operations
            self._keep(self._idle.flash())


class Served(Protocol):
    """A way to the board for programs elsewhere: a Bridge, a USB/IP server."""

    def exchange(self, cycles: int) -> None:
        """Carry what has come, either way, before the board runs for `cycles`. Never waits."""


def serve(
    idle: IdleBoard,
    bridges: Sequence[Served],
    *,
    seconds: float | None = None,
    update: Callable[[], None] = lambda: None,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Let the board run and programs talk to it, no faster than real time.

    seconds: of the board's time; None: without end. update: called every millisecond of it.
    Raises BoardError for what the board does not forgive.
    """
    board = idle.board
    end = None if seconds is None else board.cycle + round(seconds * TIME_HZ)
    zero = clock() - board.cycle / TIME_HZ  # time of power-up, if the board had kept up with real time
    while end is None or board.cycle < end:
        for bridge in bridges:
            bridge.exchange(STEP)
        idle.run_to(board.cycle + STEP if end is None else min(end, board.cycle + STEP))
        update()
        ahead = zero + board.cycle / TIME_HZ - clock()
        if ahead > 0:
            sleep(ahead)
        elif ahead < -LAG_MAX_S:
            zero -= ahead + LAG_MAX_S
    for bridge in bridges:
        bridge.exchange(STEP)


def with_image(image: bytes, kept: bytes | None) -> bytes:
    """Return flash that holds `image` in its two sectors, nothing in bank B, and `kept` elsewhere.

    Raises LinkError when `kept` has not the size of the flash.
    """
    if kept is None:
        return image
    if len(kept) != FLASH_BYTES:
        raise LinkError(f"{len(kept)} bytes, expected the {FLASH_BYTES} of a whole flash")
    flash, full = bytearray(kept), image.ljust(FLASH_BYTES, b"\xff")
    for sector in (FLASH_BOOT, FLASH_BANK_A, FLASH_BANK_B):
        span = slice(sector.address - FLASH_BASE, sector.address - FLASH_BASE + sector.size)
        flash[span] = full[span]
    return bytes(flash)


@dataclass(frozen=True)
class _Wired:
    """A board that can be a key."""

    board: facts.Board = field(compare=False)
    told: str  # all that it consists of


def configured(
    image: bytes,
    elf: Path,
    settings: Mapping[str, float],
    gyro: Gyro = GYRO,
    wiring: facts.Board = MATEKF722,
) -> bytes:
    """Return flash with `image` and `settings`, stored by the image itself; elf: for names and lines.

    A board boots, is told each over MSP, stores them, loses power, boots again and is asked for them.
    Returns the whole flash. Raises LinkError for a setting that the image refuses, BoardError.
    An idle board repeats itself to the bit: the same image with the same settings is asked once.
    """
    wired = _Wired(wiring, repr(wiring))
    return _configured(image, load_program(elf), tuple(settings.items()), gyro, wired)


@lru_cache(maxsize=16)
def _configured(
    image: bytes, program: Program, given: tuple[tuple[str, float], ...], gyro: Gyro, wired: _Wired
) -> bytes:
    settings, elf = dict(given), program.path
    idle = IdleBoard(image, elf=elf, wiring=wired.board, gyro=gyro)
    try:
        idle.boot()
        asked = Settings(idle.client())
        for name, value in in_order(settings).items():
            asked.set(name, value)
        asked.save()
        idle.board.reset()
        idle.boot()
        asked = Settings(idle.client(settings.get("msp_baud", MSP_BAUD_DEFAULT)))
        for name, value in settings.items():
            if (got := asked.get(name)) != (wanted := as_stored(name, value)):
                raise LinkError(f"{elf}: setting {name} is {got:g} after a reset, {wanted:g} was stored")
        return idle.flash()
    finally:
        idle.close()
