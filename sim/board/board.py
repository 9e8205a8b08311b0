"""An emulated board with an STM32F722 put together: the processor's peripherals, gyro chip, ESCs and battery.

It is wired by the facts of the board (`toolchain.boards.facts.Board`), never by what an image says of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.core.engine import CPI, Engine, Note
from neuroflight.sim.board.devices.esc import SILENT_S, Esc, Frame
from neuroflight.sim.board.devices.gyro_chip import GyroChip, GyroKind
from neuroflight.sim.board.devices.gyro_mpu import ICM20602
from neuroflight.sim.board.devices.log_place import LogChip, LogPlace
from neuroflight.sim.board.fitted import MATEKF722
from neuroflight.sim.board.inspection import Inspection
from neuroflight.sim.board.native.library import Native, NativeDevice, native_library
from neuroflight.sim.board.peripherals.adc import Adc, AdcCommon
from neuroflight.sim.board.peripherals.dma import DmaSystem
from neuroflight.sim.board.peripherals.flash import Flash
from neuroflight.sim.board.peripherals.gpio import Pins, place
from neuroflight.sim.board.peripherals.iwdg import Iwdg
from neuroflight.sim.board.peripherals.option_bytes import OptionBytes, signature
from neuroflight.sim.board.peripherals.pwr import Pwr
from neuroflight.sim.board.peripherals.rcc import MICROSECOND, Clocks, Rcc
from neuroflight.sim.board.peripherals.signals import board_signals, uart_name
from neuroflight.sim.board.peripherals.spi import SPIS, GyroSpi, Spi
from neuroflight.sim.board.peripherals.timer import TIMERS, Timer
from neuroflight.sim.board.peripherals.usart import Usart
from neuroflight.sim.board.registers.bus import Device, Registers, Touch, load_table
from neuroflight.sim.board.rom.boot_loader import BootLoader
from neuroflight.sim.board.usb.cable import Connector
from neuroflight.sim.board.usb.host import Host
from neuroflight.sim.board.usb.otg import POLLED, Otg
from neuroflight.toolchain.boards import facts
from neuroflight.toolchain.contract import DSHOT_MIN
from neuroflight.toolchain.image.bank_state import proven

# In C's order; lines share some of them (RM0431, vector table).
EXTI_INTERRUPTS = (*(f"EXTI{i}" for i in range(5)), "EXTI9_5", "EXTI15_10", "PVD")
USARTS = tuple(uart_name(number) for number in range(1, 7))
ENTRY_BOUND = 5 * MICROSECOND  # from the gyro's edge to its handler [cycles]
SILENT = round(SILENT_S * TIME_HZ)  # of an ESC [cycles]
UNFLOWN = TIME_HZ // 10  # a motor whose ESC gets no frame for this time counts as not flown [cycles]


def exti_interrupt(line: int) -> str:
    """Return the name of the interrupt of EXTI line 0 to 15."""
    return EXTI_INTERRUPTS[line] if line < 5 else EXTI_INTERRUPTS[5 if line < 10 else 6]


class Hardware:
    """Everything around the core, wired as on the board."""

    def __init__(
        self,
        engine: Engine,
        chip: GyroKind = ICM20602,
        board: facts.Board = MATEKF722,
        *,
        gyro_place: int = 0,
        options: OptionBytes | None = None,
        card: LogChip | None = None,
        seed: int = 0,
        watchdog_resets: bool = False,
    ) -> None:
        """board: what is wired to what. chip: in its gyro place number `gyro_place`; others are empty.

        card: the SD card or flash chip that is fitted.

        watchdog_resets: a missed watchdog resets the chip, as on the board; otherwise it is an error.
        """
        self.engine, self.board = engine, board
        self.native = native = Native(engine)
        self.rcc, self.pwr = Rcc(engine), Pwr(engine)
        self.flash = Flash(engine, options, seed)
        self.pins = Pins(native, board_signals(board))
        lib, interrupt = native.library, load_table().interrupt
        self.syscfg = NativeDevice(native, "SYSCFG", lib.SYSCFG)
        self.exti = NativeDevice(native, "EXTI", lib.EXTI, interrupts=tuple(map(interrupt, EXTI_INTERRUPTS)))
        self.dma = DmaSystem(native)
        where = board.gyros[gyro_place]
        self.gyro = GyroChip(native, self.pins, where, chip)
        self.spi = GyroSpi(native, SPIS[where.spi - 1], self.pins, seed)
        self.spis = {
            name: self.spi if name == self.spi.name else Spi(native, name, self.pins) for name in SPIS
        }
        self.log_place = LogPlace(native, self.pins, board, card)
        self._leave_empty(gyro_place)
        self.timers = {name: Timer(native, name, self.dma) for name in TIMERS}
        self.usarts = {
            name: Usart(engine, name, self.dma, self.pins, self.rcc.kernel_clock) for name in USARTS
        }
        self.adc_common = AdcCommon(engine)
        self.adc = Adc(engine, self.adc_common, self.dma, self.pins, board)
        self.iwdg = Iwdg(native)
        self.otg = Otg(engine, self.pins, self.rcc, board.usb_supply)
        self.usb = Connector(self.otg)
        self.usb_host = Host(engine, self.usb)
        self.rom = BootLoader(engine, self.rcc, self.flash, self.usarts["USART1"], self.iwdg)
        self.usb.devices.append(self.rom.dfu)
        self.escs = tuple(Esc(native, motor, pin, engine.fail) for motor, pin in enumerate(board.motors))
        native.on_train = lambda motor, edges, rest: self.escs[motor].take(edges, rest)
        self.gyro_line = line = None if where.ready is None else where.ready.number  # of EXTI
        self.inspection = Inspection(engine, self.dma, self.exti, line, self.escs)
        self._heard: Any = None  # uint16_t[]: what `_obeyed` was made of
        self._obeyed: NDArray[np.uint16] = np.empty(0, np.uint16)
        self.registers = Registers(engine)
        for device in self._devices():
            self.registers.add(device)
        companions: tuple[Kept, ...] = (self.gyro, self.inspection, native)
        for companion in companions:
            self.registers.accompany(self.spi, companion)
        self.registers.accompany(self.spi, self.log_place)
        for part in (self.rom, self.rom.programmer, self.rom.dfu, self.rom.dfu.pipe):
            self.registers.accompany(self.usarts["USART1"], part)
        for companion in (self.otg, self.usb, self.usb_host):
            self.registers.accompany(self.otg.core, companion)
        self.registers.attach(engine)
        for name, polled in {**POLLED, "FLASH": ("SR",)}.items():
            self.registers.keep_answers(self.registers.devices[name], *polled)
        if line is not None:
            name = f"the gyro's data-ready edge (EXTI{line})"
            engine.bound_entry(interrupt(exti_interrupt(line)), ENTRY_BOUND, name, urgent=True)
        for name, timer in self.timers.items():
            beat = f"the beat that begins the gyro's reads ({name})"
            engine.bound_entry(timer.interrupt, ENTRY_BOUND, beat, urgent=True)
        native.place(self.registers)
        self.iwdg.place(engine.windows[self.registers.window_name(self.iwdg)])
        self._wire(watchdog_resets)
        for address, data in signature():
            self.engine.set_memory(address, data)

    @property
    def gyro_timer(self) -> Timer | None:
        """The timer whose beat begins the image's reads of the gyro; None: no timer interrupts."""
        return next((timer for timer in self.timers.values() if timer.rings is not None), None)

    @property
    def hears_gyro(self) -> bool:
        """True if the image has opened the gyro's data-ready line."""
        return self.gyro_line is not None and bool(self.exti.words["IMR"] >> self.gyro_line & 1)

    @property
    def gyro_interrupt(self) -> int | None:
        """The interrupt that begins the image's reads of the gyro; None: none is enabled."""
        if self.hears_gyro:
            assert self.gyro_line is not None
            return load_table().interrupt(exti_interrupt(self.gyro_line))
        timer = self.gyro_timer
        return None if timer is None else timer.interrupt

    def touched(self) -> tuple[Touch, ...]:
        """Return every register that the image touched, with counts."""
        return self.registers.touched()

    def _devices(self) -> tuple[Device, ...]:
        return (
            self.rcc,
            self.pwr,
            self.flash,
            *self.pins.ports.values(),
            self.syscfg,
            self.exti,
            *self.dma.controllers.values(),
            *self.spis.values(),
            *self.timers.values(),
            *self.usarts.values(),
            self.adc_common,
            self.adc,
            self.iwdg,
            *self.otg.devices,
            Device(self.engine, "DBGMCU"),
        )

    def _wire(self, watchdog_resets: bool) -> None:
        rcc, pwr = self.rcc, self.pwr
        rcc.govern(self.registers.devices)
        rcc.latency, rcc.scale = self.flash.latency, lambda: pwr.scale
        rcc.detects_brown_out = lambda: self.flash.options.detects_brown_out
        self.flash.on_latency = pwr.on_change = rcc.check
        self.flash.on_begin = self._reject_in_flight
        pwr.pll = lambda: (bool(rcc.get("CR", "PLLON")), rcc.get("CFGR", "SWS") == 2)
        rcc.on_clocks += [self._set_clock, self.adc.set_clock]
        rcc.after_reset.append(self.gyro.processor_reset)
        for listener in rcc.on_clocks:
            listener(rcc.clocks)
        self.dma.devices = self.registers.devices
        self.gyro.rest()
        self.engine.on_system_reset(self._on_reset)
        self.iwdg.by_hardware = lambda: self.flash.options.hardware_watchdog
        self.iwdg.reset()
        if not watchdog_resets:
            self.iwdg.on_timeout = lambda: self.engine.fail(
                f"the watchdog was not fed for {self.iwdg.timeout_s * 1e3:.0f} ms: it would reset the chip"
            )

    def hear_frames(self, callback: Callable[[Frame], None]) -> None:
        """Call `callback` for every frame that an ESC takes from now on."""
        for esc in self.escs:
            esc.on_frame = callback
        self.native.on_frame = lambda motor, *taken: callback(self.escs[motor].frame(*taken))
        self.native.hear_frames()

    def obeyed(self, count: int) -> NDArray[np.uint16]:
        """Return the DShot values that the ESCs of the first `count` motors obey now; 0 after a silence.

        The array is read-only; the same one is returned as long as the values stay the same.
        """
        if len(self._obeyed) != count:
            self._heard = self.native.ffi.new("uint16_t[]", count)
            self._obeyed = np.frombuffer(bytes(2 * count), np.uint16)
        if self.native.library.native_obeyed(self.native.handle, count, SILENT, self._heard):
            self._obeyed = np.frombuffer(bytes(self.native.ffi.buffer(self._heard)), np.uint16)
        return self._obeyed

    def _leave_empty(self, gyro_place: int) -> None:
        """Watch the selects of chips that are not fitted, and of the OSD."""
        absent: list[facts.Chip | facts.GyroPlace] = [
            place for i, place in enumerate(self.board.gyros) if i != gyro_place
        ]
        absent += [chip for chip in (self.board.osd,) if chip is not None]
        for chip in absent:
            self.pins.drive(str(chip.select), True)
            lib = self.native.library
            if chip.spi != 0:  # of others nobody tells on which bus they are
                lib.native_chip(self.native.handle, lib.CHIP_ABSENT, chip.spi - 1, *place(chip.select))

    def _set_clock(self, clocks: Clocks) -> None:
        self.native.library.native_clocks(
            self.native.handle, clocks.apb1, clocks.apb2, clocks.timer1, clocks.timer2
        )

    def _on_reset(self, cause: str) -> None:
        if cause == "power":
            self.gyro.power_on()
            self.log_place.power_on()
        self.inspection.restart()
        for esc in self.escs:
            esc.silence(cause == "power")

    def _reject_in_flight(self, what: str) -> None:
        """Fail if erasing or programming starts in flight: it delays code and samples that cannot wait."""
        for esc in self.escs:
            last = esc.last
            if last is None or last.value < DSHOT_MIN or self.engine.cycle - last.cycle > UNFLOWN:
                continue
            self.engine.fail(
                f"{what} while motor {esc.motor} turns (DShot value {last.value}), expected motors at rest"
            )


@dataclass(frozen=True)
class Report:
    """The effects of an image on the board."""

    cycles: int  # of 216 MHz, since power-up
    instructions: int
    registers: tuple[Touch, ...]  # every one that was touched, in order of address
    frames: tuple[int, ...]  # DShot frames by motor
    samples: int  # of the gyro chip
    resets: tuple[str, ...]  # their causes, the first one power
    flash_operations: int
    watchdog_margin_s: float | None  # the least time that was left when it was fed
    notes: tuple[Note, ...]

    def __str__(self) -> str:
        lines = [
            f"{self.cycles / TIME_HZ:.3f} s, {self.instructions:,} instructions, "
            f"{self.samples:,} gyro samples",
            f"DShot frames by motor: {', '.join(f'{n:,}' for n in self.frames)}",
            f"resets: {', '.join(self.resets)}; flash operations: {self.flash_operations}",
        ]
        lines += [f"note, {n.times} times, first at {n.place}: {n.message}" for n in self.notes]
        lines += [f"{t.register:24}{t.reads:12,} reads{t.writes:12,} writes" for t in self.registers]
        return "\n".join(lines)


class Board:
    """A board with an image in its flash, powered and about to execute its first instruction."""

    def __init__(
        self,
        image: bytes,
        *,
        elf: Path | None = None,
        board: facts.Board = MATEKF722,
        chip: GyroKind = ICM20602,
        gyro_place: int = 0,
        cpi: Fraction = CPI,
        strict: bool = True,
        profile: bool = False,
        options: OptionBytes | None = None,
        card: LogChip | None = None,
        seed: int = 0,
        watchdog_resets: bool = False,
        dshot: int | None = None,
        newly_installed: bool = False,
        boot_button: bool = False,
    ) -> None:
        """image: content of flash, from 0x08000000 on. elf: for names and lines only.

        board, chip, gyro_place: see Hardware.
        strict: a fault of the core is an error of the image instead of a case for its handler.
        watchdog_resets: a missed watchdog resets the chip, as on the board, instead of being an error.
        card: the SD card or flash chip that is fitted; none by default; `close` closes it.
        boot_button: held at power-up, so that the boot loader in the ROM runs instead of the image.
        dshot: the speed that the ESCs are set to, 150, 300 or 600; None: that of the first frame.
        newly_installed: the image has never run, so that it is on trial; otherwise it has run well before.
        Raises BuildError if the engine cannot be built or `elf` is no ELF of an image.
        """
        flash = image if newly_installed else proven(image)
        self.engine = Engine(
            flash, elf=elf, cpi=cpi, strict=strict, profile=profile, library=native_library()
        )
        self.hardware = Hardware(
            self.engine,
            chip,
            board,
            gyro_place=gyro_place,
            options=options,
            card=card,
            seed=seed,
            watchdog_resets=watchdog_resets,
        )
        for esc in self.hardware.escs:
            esc.fitted = dshot
        self.hold_boot_button(boot_button)
        self.engine.power_cycle()
        self.engine.resets.clear()
        self.engine.resets.append("power")

    @property
    def cycle(self) -> int:
        """The time now, in cycles of 216 MHz."""
        return self.engine.cycle

    @property
    def symbols(self) -> dict[str, int]:
        """Address of every name of the image; empty without an ELF."""
        return self.engine.symbols

    def hold_boot_button(self, held: bool) -> None:
        """Hold or release the BOOT button: from the next reset on the ROM runs, or the image."""
        options = self.hardware.flash.options
        self.engine.vectors = options.button_address if held else options.boot_address

    def reset(self) -> None:
        """Switch the supply off and on: everything restarts except flash, option bytes and the time."""
        self.engine.power_cycle()

    def brown_out(self) -> None:
        """Let the supply dip: the processor resets with the next instruction, other chips at once."""
        self.hardware.gyro.power_on()
        self.hardware.log_place.power_on()
        self.engine.system_reset("brown-out")

    def run_to(self, cycle: int) -> None:
        """Run until `cycle`. Raises BoardError for what the board does not allow."""
        self.engine.run_to(cycle)

    def run(self, seconds: float) -> None:
        self.run_to(self.cycle + round(seconds * TIME_HZ))

    def report(self) -> Report:
        """Report what the image has done so far."""
        hardware = self.hardware
        closest = hardware.iwdg.closest
        return Report(
            cycles=self.cycle,
            instructions=self.engine.instructions,
            registers=hardware.touched(),
            frames=tuple(esc.frames for esc in hardware.escs),
            samples=hardware.gyro.samples,
            resets=tuple(self.engine.resets),
            flash_operations=hardware.flash.operations,
            watchdog_margin_s=None if closest is None else closest / TIME_HZ,
            notes=tuple(self.engine.notes.values()),
        )

    def close(self) -> None:
        self.hardware.log_place.close()
        self.engine.close()
