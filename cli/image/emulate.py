"""`neuroflight image emulate`: the image on an idle emulated board, whose serial ports programs talk to."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.board.built import built_last
from neuroflight.cli.image.emulated import (
    PORT_MAX,
    Card,
    Gyro,
    Interrupt,
    on_board,
    open_end,
    parse_serials,
    parse_usb,
)
from neuroflight.cli.requests import Either, Option, Request
from neuroflight.toolchain.contract import (
    FLASH_BASE,
    FLASH_BYTES,
    FLASH_SECTORS,
    MSP_BAUD_DEFAULT,
    MSP_BAUDS,
    SIM_BATTERY_MV,
)
from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.files import claimed_file, file_size

if TYPE_CHECKING:
    from neuroflight.sim.board.debug.gdb import GdbServer
    from neuroflight.sim.board.serial.bridge import Bridge
    from neuroflight.sim.board.serial.idle_board import IdleBoard
    from neuroflight.sim.board.usb.usbip import UsbIpServer
    from neuroflight.toolchain.boards.facts import Board

ROM_UART = 1  # where the boot loader in the ROM is emulated
BAUD_MAX = 10_000_000
USB_PORT = 3240  # USB/IP's own
VECTORS_BYTES = 8  # stack and reset vector
VOLTS_MAX = 36.0  # what the converter's pin can see


WHAT = Either()


@dataclass(frozen=True, kw_only=True)
class Emulate(Request):
    """A request for an idle emulated board, its serial ports, and the files that keep its memories."""

    image: Annotated[Path | None, Option("FILE.bin", "what is flashed", either=WHAT)] = None
    build: Annotated[
        Path | None, Option("DIR", "its build; default: that of the board built for last", either=WHAT)
    ] = None
    chip: Annotated[
        Path | None,
        Option(
            "FILE",
            "flash nothing: the chip holds what this file holds, and is erased where there is no such file; "
            "what is written to the chip is kept there",
            either=WHAT,
        ),
    ] = None
    board: Annotated[
        str | None,
        Option(
            "NAME|FILE.toml",
            "what is wired to what; default: as on the image's board, for an erased chip as on a MATEKF722",
        ),
    ] = None
    boot0: Annotated[
        bool,
        Option(
            None, "the BOOT button is held at power-up: the boot loader in the chip's ROM runs, not the image"
        ),
    ] = False
    serial: Annotated[
        tuple[str, ...],
        Option(
            "[uartN=]pty|tcp[:PORT]",
            "where programs find the UART that speaks MSP: a pseudo terminal (default), or TCP on this "
            "computer; uartN=...: the board's second serial port too, as uart3, where the setting "
            "uart3_function is msp",
            once=True,
        ),
    ] = ()
    baud: Annotated[
        int,
        Option(
            "N",
            f"speed of that line; default {MSP_BAUD_DEFAULT}, as the setting msp_baud",
            low=1,
            high=BAUD_MAX,
        ),
    ] = MSP_BAUD_DEFAULT
    usb: Annotated[
        str | None,
        Option(
            "[HOST:]PORT",
            "plug a cable into its USB connector; at the other end is a USB/IP server on this computer, "
            f"where programs attach the board; default: port {USB_PORT}; 0: any port",
            number="?",
            bare=str(USB_PORT),
        ),
    ] = None
    gdb: Annotated[
        int | None, Option("PORT", "let gdb in there, at any time; 0: any port", low=0, high=PORT_MAX)
    ] = None
    flash: Annotated[
        Path | None,
        Option(
            "FILE",
            "keep settings, policies and fault log here between two runs; the image is always the one given",
        ),
    ] = None
    gyro: Gyro = None
    card: Card = None
    volts: Annotated[
        float,
        Option(
            "V",
            f"of the battery; default {SIM_BATTERY_MV / 1000}",
            low=0.0,
            high=VOLTS_MAX,
            unit="V",
        ),
    ] = SIM_BATTERY_MV / 1000
    seconds: Annotated[
        float | None, Option("S", "of the board's time, from its boot on; default: until Ctrl-C")
    ] = None
    json: Annotated[
        bool, Option(None, "print a line of JSON when its ports are there, and one at the end")
    ] = False

    def run(self) -> int:
        """Serve until the end. Returns 0; raises BoardError for errors of the image."""
        asked = parse_serials(self.serial)
        usb_port = None if self.usb is None else parse_usb(self.usb)
        self._check()
        image = self.chip or self.image or (self.build or built_last()) / "neuroflight.bin"

        from neuroflight.sim.board.debug.gdb import GdbServer
        from neuroflight.sim.board.devices.log_place import open_log_chip
        from neuroflight.sim.board.fitted import Lines, fitted_gyro, image_lines
        from neuroflight.sim.board.peripherals.signals import uart_name
        from neuroflight.sim.board.peripherals.usart import Format
        from neuroflight.sim.board.serial.bridge import Bridge, UartLine
        from neuroflight.sim.board.serial.idle_board import IdleBoard, Keeper, serve, with_image
        from neuroflight.sim.board.usb.usbip import UsbIpServer
        from neuroflight.toolchain.image.elf import read_flashable

        flashed = b"" if self.chip else read_flashable(image)
        elf = image.with_suffix(".elf")
        option, file = ("--chip", self.chip) if self.chip else ("--flash", self.flash)
        with ExitStack() as ends:
            _claim(option, file, ends)
            kept = _kept(option, file)
            content = (kept or b"") if self.chip else with_image(flashed, kept)
            if not self.boot0:
                _check_bootable(image, content)
            wiring = self._wiring(image, content)
            lines = Lines(0, ROM_UART, None) if self.boot0 else image_lines(content, wiring)
            if lines.msp is not None and not {"msp", f"uart{lines.msp}"} & asked.keys():
                asked = {"msp": ("pty", 0), **asked}
            if not asked and usb_port is None:
                raise NeuroflightError(f"{wiring.name} has no UART for MSP, only USB; add --usb")
            opened = {}
            for purpose, serial in on_board(asked, lines, wiring.name).items():
                opened[purpose] = open_end(serial)
                ends.callback(opened[purpose].close)
            card = None if self.card is None else open_log_chip(wiring, self.card)
            if card is not None:
                ends.callback(card.close)
            idle = IdleBoard(
                content,
                elf=elf if elf.is_file() and not self.chip else None,
                wiring=wiring,
                volts=self.volts,
                gyro=fitted_gyro(wiring, kind=self.gyro),
                card=card,
                boot_button=self.boot0,
                newly_installed=self.chip is not None,
            )
            ends.callback(idle.close)
            keeper = Keeper(idle, lambda content: _keep(option, file, content))
            if file is not None and kept is None:
                _keep(option, file, idle.flash())
            ends.callback(keeper.update, at_once=True)
            idle.boot()  # bytes that arrive during the boot would be lost
            bridges = []
            for purpose, end in opened.items():
                name = uart_name((lines.msp if purpose == "msp" else lines.second) or 0)
                baud = self.baud if purpose == "msp" else _baud(idle, name)
                bridges.append(Bridge(UartLine(idle.board, name, Format(baud)), end))
                ends.callback(bridges[-1].close)
            usb = None if usb_port is None else UsbIpServer([idle.board.hardware.usb_host], usb_port)
            if usb is not None:
                ends.callback(usb.close)
            debugger = None
            if self.gdb is not None:
                debugger = GdbServer(idle.board.engine, self.gdb, on_flashed=keeper.note_change)
                ends.callback(debugger.close)
                idle.run_core = debugger.run_to
            interrupt = ends.enter_context(Interrupt(debugger))
            labels = ["ROM" if idle.board.hardware.rom.runs else "MSP"] if "msp" in opened else []
            labels += [f"UART{lines.second}"] if "second" in opened else []
            self._tell(image, dict(zip(labels, bridges, strict=True)), usb, debugger)
            watch = _SpeedWatch(bridges[0]) if "msp" in opened else None

            def update() -> None:
                interrupt.check()
                keeper.update()
                if watch is not None:
                    watch.update()
                if debugger is not None:
                    debugger.poll()

            try:
                serve(idle, [*bridges, *([] if usb is None else [usb])], seconds=self.seconds, update=update)
            except KeyboardInterrupt:
                print(end="" if self.json else "\n", flush=True)  # behind the terminal's ^C
            self._end(idle)
        return 0

    def _wiring(self, image: Path, content: bytes) -> Board:
        """Return the board that the chip sits on: as asked for, as its image says, or the usual one."""
        from neuroflight.sim.board.fitted import MATEKF722, image_wiring
        from neuroflight.toolchain.boards.board_file import named_board
        from neuroflight.toolchain.contract import FLASH_BANKS, FLASH_BASE, image_header

        if self.board is not None:
            return named_board(self.board)
        blank = all(image_header(content[bank.address - FLASH_BASE :]) is None for bank in FLASH_BANKS)
        return MATEKF722 if blank else image_wiring(image, content)

    def _check(self) -> None:
        if self.chip and self.flash:
            raise NeuroflightError(
                "--flash: got it beside --chip, which keeps the whole flash; leave one out"
            )
        if self.boot0 and any(name not in ("msp", "uart1") for name in parse_serials(self.serial)):
            raise NeuroflightError(
                "--serial: got another UART with --boot0, whose ROM is emulated on UART1 only"
            )
        if self.seconds is not None and not (math.isfinite(self.seconds) and self.seconds > 0.0):
            raise NeuroflightError(f"--seconds {self.seconds:g}, expected a number above 0")

    def _tell(
        self,
        image: Path,
        bridges: Mapping[str, Bridge],
        usb: UsbIpServer | None,
        debugger: GdbServer | None,
    ) -> None:
        """Print where programs find the board. bridges: by label."""
        if self.json:
            ports = {
                label.lower(): {"port": bridge.end.name, "baud": bridge.line.format.baud}
                for label, bridge in bridges.items()
            }
            gdb = None if debugger is None else debugger.port
            where = {"ports": ports, "usb": None if usb is None else usb.port, "gdb": gdb}
            print(json.dumps({"image": str(image), **where}), flush=True)
            return
        print(f"board  {image}")
        for label, bridge in bridges.items():
            name = bridge.end.name
            then = "rescue IMAGE" if label == "ROM" else "info"
            print(
                f"{label:7}{name}, {bridge.line.format.baud:.0f} baud; neuroflight board {then} --port {name}"
            )
        if usb is not None:
            print(f"USB    {usb.name}, USB/IP; usbip --tcp-port {usb.port} attach -r 127.0.0.1 -b 1-1")
        if debugger is not None:
            elf = image.with_suffix(".elf")
            elf = elf if elf.is_file() else built_last() / "neuroflight.elf"
            remote = f"-ex 'target remote :{debugger.port}'"
            print(f"gdb    127.0.0.1:{debugger.port}; gdb-multiarch -d firmware {remote} {elf}")
        print("Ctrl-C ends it", flush=True)

    def _end(self, idle: IdleBoard) -> None:
        """Print how long the board ran, and its resets."""
        from neuroflight.sim.board.core.context import TIME_HZ

        report = idle.board.report()
        seconds, resets = report.cycles / TIME_HZ, report.resets[1:]
        if self.json:
            print(json.dumps({"seconds": seconds, "resets": list(resets)}), flush=True)
        else:
            print(f"{seconds:.1f} s on the board, resets: {', '.join(resets) or 'none'}", flush=True)


class _SpeedWatch:
    """A watch over the speeds of both ends of the line, which says once that they differ."""

    def __init__(self, bridge: Bridge) -> None:
        self._line = bridge.line
        self._said = False

    def update(self) -> None:
        line = self._line
        if not self._said and line.refused + line.framing_errors:
            self._said = True
            print(
                f"the board's line runs at {line.board_format.baud:.0f} baud, this end at "
                f"{line.format.baud:.0f}: nobody understands anything; end this and give --baud as "
                f"the setting msp_baud",
                file=sys.stderr,
                flush=True,
            )


def _check_bootable(path: Path, content: bytes) -> None:
    """Refuse a chip without an image: a real one stands still without a word."""
    if content[:VECTORS_BYTES].strip(b"\xff") == b"":
        raise NeuroflightError(
            f"{path}: the chip is erased where its boot part should be, expected an image; start it with "
            f"--boot0 and write one with `neuroflight board rescue`"
        )


def _claim(option: str, path: Path | None, ends: ExitStack) -> None:
    """Keep the file for this board until the end. Raises NeuroflightError where another one has it."""
    if path is None or not path.parent.is_dir():
        return
    try:
        ends.enter_context(claimed_file(path, "board"))
    except OSError as error:
        raise NeuroflightError(
            f"{option} {path}: {error.strerror}; name a file that can be written"
        ) from None


def _kept(option: str, path: Path | None) -> bytes | None:
    """Return the bytes of the file; None: there is none yet."""
    if path is None or not path.exists():
        return None
    try:
        size = file_size(path)
        data = path.read_bytes() if size == FLASH_BYTES else b""
    except OSError as error:
        raise NeuroflightError(f"{option} {path}: {error.strerror}; name a file that can be read") from None
    if len(data) != FLASH_BYTES:
        raise NeuroflightError(
            f"{option} {path}: {size} bytes, expected the {FLASH_BYTES} of a flash that this command has "
            f"kept; it is left alone, name another one"
        )
    for sector in FLASH_SECTORS:
        start = sector.address - FLASH_BASE
        if not any(data[start : start + sector.size]):
            raise NeuroflightError(
                f"{option} {path}: {sector.name} is all zeros, which flash never is: it was not written "
                f"whole; remove it or name another one"
            )
    return data


def _keep(option: str, path: Path | None, content: bytes) -> None:
    from neuroflight.toolchain.files import write_bytes

    if path is None:
        return
    try:
        write_bytes(path, content)
    except OSError as error:
        raise NeuroflightError(
            f"{option} {path}: {error.strerror}; name a file that can be written"
        ) from None


def _baud(idle: IdleBoard, uart_name: str) -> float:
    """Return the speed of the second port. Raises NeuroflightError where the image has not started it."""
    from neuroflight.sim.board.serial.idle_board import STEP

    idle.run_to(idle.board.cycle + STEP)  # the firmware starts it right after the first, which is running
    uart = idle.board.hardware.usarts[uart_name]
    if not uart.words["CR1"] & 1:
        name = f"UART{uart_name[-1]}"
        raise NeuroflightError(
            f"--serial {name.lower()}: got a board whose {name} is off, expected one that is set to MSP; set "
            "uart3_function=msp in a run with --flash FILE, save, and start again with that file"
        )
    return min(MSP_BAUDS, key=lambda baud: abs(baud - uart.format.baud))
