"""`neuroflight board`: the image on an idle emulated board, whose serial ports programs talk to."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.image.emulated import (
    UARTS,
    Interrupt,
    add_card_argument,
    add_gyro_argument,
    check_gdb,
    open_end,
    parse_serials,
)
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

BUILD = Path(__file__).resolve().parents[2] / "build" / "MATEKF722"
BAUD_MAX = 10_000_000
VECTORS_BYTES = 8  # stack and reset vector
VOLTS_MAX = 36.0  # what the converter's pin can see


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the image, its serial ports, and the files that keep its memories."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--image", type=Path, metavar="FILE.bin", help="what is flashed")
    what.add_argument("--build", type=Path, metavar="DIR", help="its build; default: build/MATEKF722")
    what.add_argument(
        "--chip",
        type=Path,
        metavar="FILE",
        help="flash nothing: the chip holds what this file holds, and is erased where there is no such file; "
        "what is written to the chip is kept there",
    )
    parser.add_argument(
        "--boot0",
        action="store_true",
        help="the BOOT button is held at power-up: the boot loader in the chip's ROM runs, not the image",
    )
    parser.add_argument(
        "--serial",
        action="append",
        metavar="[uart3=]pty|tcp[:PORT]",
        help="where programs find UART1, which speaks MSP: a pseudo terminal (default), or TCP on this "
        "computer; uart3=...: UART3 too, where the setting uart3_function is msp",
    )
    parser.add_argument(
        "--baud",
        type=int,
        default=MSP_BAUD_DEFAULT,
        metavar="N",
        help=f"speed of that line; default {MSP_BAUD_DEFAULT}, as the setting msp_baud",
    )
    parser.add_argument("--gdb", type=int, metavar="PORT", help="let gdb in there, at any time; 0: any port")
    parser.add_argument(
        "--flash",
        type=Path,
        metavar="FILE",
        help="keep settings, policies and fault log here between two runs; the image is always the one given",
    )
    add_gyro_argument(parser)
    add_card_argument(parser)
    parser.add_argument(
        "--volts",
        type=float,
        default=SIM_BATTERY_MV / 1000,
        metavar="V",
        help=f"of the battery; default {SIM_BATTERY_MV / 1000}",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        metavar="N",
        help="of the board's time, from its boot on; default: until Ctrl-C",
    )


def run(args: argparse.Namespace) -> int:
    """Serve until the end. Returns 0; raises BoardError for errors of the image."""
    serials = {"uart1": ("pty", 0), **parse_serials(args.serial or ())}
    _check(args)
    image = args.chip or args.image or (args.build or BUILD) / "neuroflight.bin"

    from neuroflight.sim.board.debug.gdb import GdbServer
    from neuroflight.sim.board.devices.sd_card import SdCard
    from neuroflight.sim.board.matekf722 import GYROS
    from neuroflight.sim.board.peripherals.usart import Format
    from neuroflight.sim.board.serial.bridge import Bridge, UartLine
    from neuroflight.sim.board.serial.idle_board import IdleBoard, Keeper, serve, with_image
    from neuroflight.toolchain.image.elf import read_flashable

    flashed = b"" if args.chip else read_flashable(image)
    elf = image.with_suffix(".elf")
    option, file = ("--chip", args.chip) if args.chip else ("--flash", args.flash)
    with ExitStack() as ends:
        _claim(option, file, ends)
        kept = _kept(option, file)
        content = (kept or b"") if args.chip else with_image(flashed, kept)
        if not args.boot0:
            _check_bootable(image, content)
        opened = {}
        for name, serial in serials.items():
            opened[name] = open_end(serial)
            ends.callback(opened[name].close)
        card = None if args.card is None else SdCard(args.card)
        if card is not None:
            ends.callback(card.close)
        idle = IdleBoard(
            content,
            elf=elf if elf.is_file() and not args.chip else None,
            volts=args.volts,
            gyro=GYROS[args.gyro],
            card=card,
            boot_button=args.boot0,
            newly_installed=args.chip is not None,
        )
        ends.callback(idle.close)
        keeper = Keeper(idle, lambda content: _keep(option, file, content))
        if file is not None and kept is None:
            _keep(option, file, idle.flash())
        ends.callback(keeper.update, at_once=True)
        idle.boot()  # bytes that arrive during the boot would be lost
        bridges = []
        for name, end in opened.items():
            baud = args.baud if name == "uart1" else _baud(idle)
            bridges.append(Bridge(UartLine(idle.board, UARTS[name], Format(baud)), end))
            ends.callback(bridges[-1].close)
        debugger = None
        if args.gdb is not None:
            debugger = GdbServer(idle.board.engine, args.gdb, on_flashed=keeper.note_change)
            ends.callback(debugger.close)
            idle.run_core = debugger.run_to
        interrupt = ends.enter_context(Interrupt(debugger))
        _tell(image, bridges, debugger, in_rom=idle.board.hardware.rom.runs)
        watch = _SpeedWatch(bridges[0])

        def update() -> None:
            interrupt.check()
            keeper.update()
            watch.update()
            if debugger is not None:
                debugger.poll()

        try:
            serve(idle, bridges, seconds=args.seconds, update=update)
        except KeyboardInterrupt:
            print(flush=True)  # behind the terminal's ^C
        print(_summary(idle), flush=True)
    return 0


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


def _check(args: argparse.Namespace) -> None:
    if args.chip and args.flash:
        raise NeuroflightError("--flash: got it beside --chip, which keeps the whole flash; leave one out")
    if args.boot0 and args.serial and any(text.startswith("uart3") for text in args.serial):
        raise NeuroflightError("--serial uart3: got it with --boot0, whose ROM is emulated on UART1 only")
    if not 1 <= args.baud <= BAUD_MAX:
        raise NeuroflightError(f"--baud: got {args.baud}, expected 1 to {BAUD_MAX}")
    check_gdb(args.gdb)
    if not 0.0 <= args.volts <= VOLTS_MAX:
        raise NeuroflightError(f"--volts: got {args.volts:g}, expected 0 to {VOLTS_MAX:g}")
    if args.seconds is not None and not (math.isfinite(args.seconds) and args.seconds > 0.0):
        raise NeuroflightError(f"--seconds: got {args.seconds:g}, expected a number above 0")


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


def _baud(idle: IdleBoard) -> float:
    """Return the speed of UART3. Raises NeuroflightError where the image has not started it."""
    from neuroflight.sim.board.serial.idle_board import STEP

    idle.run_to(idle.board.cycle + STEP)  # the firmware starts UART3 right after UART1, which is running
    uart = idle.board.hardware.usarts[UARTS["uart3"]]
    if not uart.words["CR1"] & 1:
        raise NeuroflightError(
            "--serial uart3: got a board whose UART3 is off, expected one that is set to MSP; set "
            "uart3_function=msp in a run with --flash FILE, save, and start again with that file"
        )
    return min(MSP_BAUDS, key=lambda baud: abs(baud - uart.format.baud))


def _tell(image: Path, bridges: Sequence[Bridge], debugger: GdbServer | None, *, in_rom: bool) -> None:
    print(f"board  {image}")
    for label, bridge in zip(("ROM" if in_rom else "MSP", "UART3"), bridges, strict=False):
        name = bridge.end.name
        then = "rescue IMAGE" if label == "ROM" else "info"
        print(f"{label:7}{name}, {bridge.line.format.baud:.0f} baud; neuroflight board {then} --port {name}")
    if debugger is not None:
        elf = image.with_suffix(".elf")
        elf = elf if elf.is_file() else BUILD / "neuroflight.elf"
        remote = f"-ex 'target remote :{debugger.port}'"
        print(f"gdb    127.0.0.1:{debugger.port}; gdb-multiarch -d firmware {remote} {elf}")
    print("Ctrl-C ends it", flush=True)


def _summary(idle: IdleBoard) -> str:
    from neuroflight.sim.board.core.context import TIME_HZ

    report = idle.board.report()
    resets = ", ".join(report.resets[1:]) or "none"
    return f"{report.cycles / TIME_HZ:.1f} s on the board, resets: {resets}"
