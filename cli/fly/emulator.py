"""`neuroflight fly --on board`: its options, and its report."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.cli.fly.blackbox import FlightLog, blackbox_baud
from neuroflight.cli.fly.options import ESCS, STOPPED, OnBoard
from neuroflight.cli.image.emulated import (
    SETTINGS,
    Interrupt,
    Serials,
    check_gdb,
    on_board,
    open_end,
    parse_serials,
)
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.cli.fly.options import FlyOptions
    from neuroflight.sim.board.board import Board
    from neuroflight.sim.board.fitted import Lines
    from neuroflight.sim.ports.emulator import EmulatedPort
    from neuroflight.sim.ports.emulator_report import EmulatedReport

SLICE = 216_000  # cycles between two checks of serial line and Ctrl-C, at most: 1 ms


def check_emulator(args: FlyOptions) -> None:
    """Refuse impossible options before anything is opened."""
    if args.on != "board":
        names = (field.name for field in fields(OnBoard))
        args.refuse(*names, because="only on the emulated board; add --on board")
        return
    parse_serials(args.serial)
    if args.card is None and (of_card := [text for text in args.fault if text.startswith("card-")]):
        raise NeuroflightError(f"--fault {of_card[0]}: got no card that it could happen to; add --card IMG")
    check_gdb(args.gdb)
    if args.profile is not None and args.profile.exists() and not args.profile.is_dir():
        raise NeuroflightError(f"--profile: {args.profile} is a file, expected a directory")


def open_image(
    args: FlyOptions, image: Path, settings: Mapping[str, float], ends: ExitStack, log: FlightLog | None
) -> EmulatedPort:
    """Return the image on a board of its own, to be closed by `ends`. log: of UART3, if any."""
    from neuroflight.sim.board.debug.fault_injection import parse_fault
    from neuroflight.sim.board.fitted import fitted_gyro, image_lines, image_wiring
    from neuroflight.sim.ports.emulator import EmulatedPort
    from neuroflight.toolchain.image.elf import read_flashable

    faults = [parse_fault(text) for text in args.fault]
    flashed = read_flashable(image)
    wiring = image_wiring(image, flashed)
    lines = image_lines(flashed, wiring)
    serials = on_board(parse_serials(args.serial), lines, wiring.name)
    if "second" in serials and "uart3_function=msp" not in args.set:
        raise NeuroflightError(
            f"--serial uart{lines.second}: got a board whose UART{lines.second} is off, expected MSP there; "
            "add --set uart3_function=msp"
        )
    if log is not None and log.path is not None and lines.second is None:
        raise NeuroflightError(
            f"--blackbox: {wiring.name} has no second serial port; take --card FILE instead"
        )
    return EmulatedPort(
        image,
        args.gyro_hz,
        settings,
        wiring=wiring,
        gyro=fitted_gyro(wiring, kind=args.gyro),
        card=args.card,
        dshot=None if args.esc is None else ESCS[args.esc],
        faults=faults,
        profile=args.profile is not None,
        attach=lambda board: attached(args, board, image, ends, lines, serials, log),
        on_failure=lambda board: keep_profile(args, board),
    )


def attached(
    args: FlyOptions,
    board: Board,
    image: Path,
    ends: ExitStack,
    lines: Lines,
    serials: Serials,
    log: FlightLog | None = None,
) -> Callable[[int], None]:
    """Return a function that runs `board` with the debugger and the serial lines asked for; wait for gdb."""
    from neuroflight.flash.settings.values import parse_change
    from neuroflight.sim.board.debug.gdb import GdbServer
    from neuroflight.sim.board.peripherals.signals import uart_name
    from neuroflight.sim.board.peripherals.usart import Format
    from neuroflight.sim.board.serial.bridge import Bridge, UartLine
    from neuroflight.toolchain.contract import MSP_BAUD_DEFAULT

    uarts = {"msp": lines.msp, "second": lines.second}
    if log is not None and log.path is not None:
        log.source = UartLine(board, uart_name(lines.second or 0), Format(blackbox_baud(args))).take
    run_to: Callable[[int], None] = board.run_to
    server = None
    if args.gdb is not None:
        server = GdbServer(board.engine, args.gdb)
        ends.callback(server.close)
        elf = image.with_suffix(".elf")
        say(f"waiting for gdb: gdb-multiarch -d firmware -ex 'target remote :{server.port}' {elf}")
        server.wait()
        run_to = server.run_to
    interrupt = ends.enter_context(Interrupt(server))
    bridges = []
    for purpose, serial in serials.items():
        end, name = open_end(serial), uart_name(uarts[purpose] or 0)
        baud = dict(parse_change(text) for text in args.set).get(SETTINGS[purpose], MSP_BAUD_DEFAULT)
        bridges.append(Bridge(UartLine(board, name, Format(baud)), end))
        ends.callback(bridges[-1].close)
        say(f"{name} at {end.name}, {baud:.0f} baud")

    def run(cycle: int) -> None:
        while board.cycle < cycle:
            until = min(cycle, board.cycle + SLICE)
            for bridge in bridges:
                bridge.exchange(until - board.cycle)
            run_to(until)
            interrupt.check()
            if server is not None:
                server.poll()

    return run


def emulator_document(report: EmulatedReport) -> dict[str, Any]:
    """Return the report as JSON data."""
    return {**asdict(report), "outcome": report.outcome}


def exit_code(args: FlyOptions, report: EmulatedReport | None) -> int:
    """Return STOPPED after faults that stopped the motors, else 0."""
    return STOPPED if args.fault and report is not None and report.stopped_s is not None else 0


def emulator_words(report: EmulatedReport | None) -> str:
    """Return the report in words, for the line below a page's title."""
    return "" if report is None else f"; {report.outcome}; image sha256 {report.sha256}"


def emulator_rows(report: EmulatedReport) -> list[tuple[str, str]]:
    """Return label and text of each line."""
    waited = f"; {report.gyro_wait_place}" if report.gyro_wait_place else ""
    margin = report.watchdog_margin_s
    told = [
        ("image", report.image),
        ("sha256", report.sha256),
        ("flight", report.outcome),
        (
            "board",
            f"{report.board_s:.3f} s of its time, {report.real_time:.2f} of real time; "
            f"{report.instructions:,} instructions",
        ),
        ("gyro edge", f"waited {report.gyro_wait_us:.2f} us at most for its handler{waited}"),
        *([] if report.card_writes is None else [("card", f"{report.card_writes:,} blocks written")]),
        ("watchdog", "never fed" if margin is None else f"{1e3 * margin:.0f} ms left at least"),
    ]
    told += [(f"{event.at_s:.4f} s", event.what) for event in report.events]
    if not report.running:
        told.append(("at the end", "the firmware has not come back from its last reset"))
    if report.arming_reasons:
        told.append(("held by", ", ".join(report.arming_reasons)))
    told += [("never came", fault) for fault in report.waiting]
    told += [("note", f"{note.message} ({note.times} times, first at {note.place})") for note in report.notes]
    return told


EMULATOR_HEADINGS = ("flight", "real time", "edge waits", "feed left")


def emulator_cells(report: EmulatedReport) -> tuple[str, ...]:
    """Return the cells under EMULATOR_HEADINGS."""
    margin = report.watchdog_margin_s
    return (
        report.outcome,
        f"{report.real_time:.2f}",
        f"{report.gyro_wait_us:.2f} us",
        "never fed" if margin is None else f"{1e3 * margin:.0f} ms",
    )


def save_profile(directory: Path, board: Board) -> None:
    """Write the profile and say where."""
    from neuroflight.sim.board.debug.profile_write import write_profile

    names = write_profile(directory, board)
    print(f"{directory}: {', '.join(names)}", file=sys.stderr)


def keep_profile(args: FlyOptions, board: Board) -> None:
    """Write the profile of a flight that ends in an error, if one was asked for."""
    if (folder := args.profile) is not None:
        keep("profile", lambda: save_profile(folder, board))


def keep(what: str, write: Callable[[], None]) -> None:
    """Write the outputs of a flight that ends in an error; the user is told that error."""
    try:
        write()
    except (NeuroflightError, OSError) as error:
        say(f"the {what} of the flight up to its end is not kept: {error}")


def say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)
