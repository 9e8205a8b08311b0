"""`neuroflight board target ...`: boards that images can be built for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.options import Json
from neuroflight.cli.report import Account, print_facts, print_json, print_table
from neuroflight.cli.requests import Argument, Option, Request

if TYPE_CHECKING:
    from neuroflight.toolchain.boards.facts import GyroPlace
    from neuroflight.toolchain.boards.verdict import Verdict


@dataclass(frozen=True, kw_only=True)
class List(Request):
    """A request for the boards that images can be built for."""

    name: Annotated[
        str | None, Argument("NAME|FILE", "one board, with what serves what on it; default: a line for each")
    ] = None
    json: Json = False

    def run(self) -> int:
        """Print them. Returns 0, or 1 if the one that was named cannot be flown."""
        from neuroflight.toolchain.boards.board_file import named_board
        from neuroflight.toolchain.boards.table import boards
        from neuroflight.toolchain.boards.verdict import COMMON, judge

        if self.name is not None:
            verdict = judge(named_board(self.name))
            if self.json:
                print_json(document(verdict))
            else:
                print_facts(facts(verdict))
            return int(verdict.allocation is None)
        verdicts = [judge(board) for board in boards().values()]
        if self.json:
            print_json([document(verdict) for verdict in verdicts])
            return 0
        heads = ("board", "maker", "gyro", "motors", "log", "flies")
        works = sum(verdict.allocation is not None for verdict in verdicts)
        note = f"{works} of {len(verdicts)} boards can be built for. No board's {COMMON} is used."
        print_table("", [heads, *map(_row, verdicts)], note, numbers=("motors",))
        return 0


@dataclass(frozen=True, kw_only=True)
class Import(Request):
    """A request for a target from a board's own configuration."""

    file: Annotated[
        Path,
        Argument("FILE", "what Betaflight's `dump hardware` or `diff hardware` printed, or a config.h"),
    ]
    out: Annotated[
        Path | None, Option("FILE.toml", "write the target there, for `image build --target`", suffix=".toml")
    ] = None
    name: Annotated[str | None, Option("NAME", "of the board, instead of what the file tells")] = None
    gyro: Annotated[
        tuple[str, ...] | None,
        Option("CHIP", "that the board carries, as MPU6000, instead of what the file tells"),
    ] = None
    json: Json = False

    def run(self) -> int:
        """Read the board, check it, print what serves what, and write its file. Raises WiringError."""
        from neuroflight.toolchain.boards.allocation import allocate
        from neuroflight.toolchain.boards.board_file import board_text, check_name
        from neuroflight.toolchain.boards.gyro_kinds import check_kinds
        from neuroflight.toolchain.boards.import_board import differences, import_board
        from neuroflight.toolchain.boards.table import boards
        from neuroflight.toolchain.boards.verdict import judge
        from neuroflight.toolchain.errors import WiringError
        from neuroflight.toolchain.files import write_text

        try:
            name = None if self.name is None else check_name(self.name)
            gyros = check_kinds(self.gyro or ())
        except ValueError as error:
            raise WiringError(f"--name or --gyro: got {error}") from error
        imported = import_board(self.file, name, gyros)
        board, told = imported.board, Account(self.json)
        try:
            allocate(board)
        except WiringError as error:
            raise WiringError(f"{self.file}: {error}; nothing was written") from error
        verdict, known = judge(board), boards().get(board.name)
        notes = list(imported.notes)
        if known is not None:
            unlike = differences(board, known)
            notes.append(f"{', '.join(unlike) or 'nothing'} other than in the table's {board.name}")
        if not self.json:
            print_facts([*facts(verdict), *(("note", note) for note in notes)])
        if self.out is not None:
            write_text(self.out, board_text(board, (f"From {self.file.name}.", *imported.notes)))
        end = (
            f"written: neuroflight image build --target {self.out}"
            if self.out
            else "nothing was written: --out"
        )
        return told.end(document(verdict) | {"notes": notes, "out": str(self.out) if self.out else None}, end)


def _row(verdict: Verdict) -> tuple[str, ...]:
    board = verdict.board
    flies = verdict.fault or "; ".join(("with --gyro-file" if verdict.file else "yes", *verdict.without))
    return board.name, board.maker, " ".join(board.gyro_kinds), str(verdict.motors), verdict.log, flies


def facts(verdict: Verdict) -> list[tuple[str, str]]:
    """Return the verdict on one board as labels and texts."""
    from neuroflight.toolchain.boards.board_file import AXES

    board, served = verdict.board, verdict.allocation
    places = board.gyros if served is None else [place for place in served.gyros if place.spi != 0]
    turn = ", ".join(f"{axis} {turn}" for axis, turn in zip(AXES, board.turn_deg, strict=True) if turn)
    rows = [
        ("board", f"{board.name}, maker {board.maker or 'not told'}"),
        ("gyro", " ".join(verdict.gyros or board.gyro_kinds) or "not told"),
        *zip(("its place", "second gyro"), map(_place, places), strict=False),
        *([("turned", f"{turn} deg by its maker, so that its arrow points forward")] if turn else []),
        ("motors", " ".join(map(str, board.motors if served is None else served.motors))),
        ("log", verdict.log),
    ]
    if verdict.file:
        rows.append(("asks for", f"--gyro-file, {verdict.file}"))
    if served is None:
        return [*rows, ("flies", f"no: {verdict.fault}")]
    lines = (("receiver", served.receiver), ("MSP", served.msp), ("second serial port", served.second))
    rows += [(what, f"UART{number}") for what, number in lines if number is not None]
    rows.append(("DMA", ", ".join(f"{request} {stream}" for request, stream in served.streams.items())))
    return [*rows, *(("without", line) for line in verdict.without)]


def _place(place: GyroPlace) -> str:
    from neuroflight.toolchain.boards.board_file import alignment_name

    ready = f"data-ready line {place.ready}" if place.ready else "no data-ready line told"
    return f"SPI{place.spi}, chip select {place.select}, {ready}, {alignment_name(place.alignment)}"


def document(verdict: Verdict) -> dict[str, Any]:
    """Return the verdict on one board as JSON data."""
    board, served = verdict.board, verdict.allocation
    return {
        "name": board.name,
        "maker": board.maker,
        "gyros": list(verdict.gyros),
        "gyros_told": list(board.gyro_kinds),
        "gyro_file": verdict.file or None,
        "turn_deg": list(board.turn_deg),
        "motors": [str(pin) for pin in (board.motors if served is None else served.motors)],
        "log": verdict.log,
        "flies": served is not None,
        "fault": verdict.fault or None,
        "without": list(verdict.without),
        "uarts": None
        if served is None
        else {"receiver": served.receiver, "msp": served.msp, "second": served.second},
        "dma": None if served is None else {name: str(stream) for name, stream in served.streams.items()},
    }
