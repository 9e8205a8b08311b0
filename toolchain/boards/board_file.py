"""A board as a TOML file: a target for whoever has a board that the table lacks, or one wired otherwise.

    name = "MYBOARD"
    gyro_kinds = ["ICM42688P"]
    motors = ["PB4", "PB5", "PB0", "PB1"]

    [[gyro]]
    spi = 1
    select = "PB2"
    ready = "PC4"
    alignment = "CW180_DEG_FLIP"

    [turn] # of the whole board, so that its arrow points forward; board_yaw_deg and its kin come on top
    yaw_deg = -45

    [spi.1]
    sck = "PA5"
    ...

`board_text` writes all that there is; what is left out, the board does not have.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeVar

from neuroflight.toolchain.boards.facts import NOT_TURNED, Board, Bus, Chip, GyroPlace, Pin, Turn, Uart
from neuroflight.toolchain.boards.table import DIVIDER_USUAL, find_board
from neuroflight.toolchain.contract import (
    BOARD_GYRO_COUNT,
    BOARD_MAKER_BYTES,
    BOARD_NAME_BYTES,
    BOARD_SPI_COUNT,
    MOTOR_COUNT_MAX,
    BoardLog,
)
from neuroflight.toolchain.errors import WiringError
from neuroflight.toolchain.files import read_limited
from neuroflight.toolchain.strict_toml import StrictTable, parse_toml

SUFFIX = ".toml"
BESIDE = "board.toml"  # that a build writes beside its image
FILE_BYTES_MAX = 64 << 10
SCALE_MAX = 0xFFFF
UART_COUNT = 6
AXES = ("roll", "pitch", "yaw")
NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9_-]{{0,{BOARD_NAME_BYTES - 2}}}")
WORD = re.compile(r"[A-Z0-9]{1,20}")  # that names a chip
WORDS_MAX = 20
_Value = TypeVar("_Value")
_ALIGNMENTS = {
    f"CW{90 * turns}_DEG{'_FLIP' * flipped}": turns + 4 * flipped for flipped in (0, 1) for turns in range(4)
}
_LEVELS = {"low": False, "high": True}
_LOGS = {kind.name.lower(): kind for kind in (BoardLog.CARD, BoardLog.FLASH)}


def read_board(path: Path) -> Board:
    """Read a board from its file. Raises WiringError, one line."""
    data = read_limited(path, str(path), FILE_BYTES_MAX, WiringError, "; it is no description of a board")
    return StrictTable(parse_toml(data, str(path), WiringError), str(path), WiringError).whole(_board)


def named_board(name: str) -> Board:
    """Return the board of the table with that name, or of the file NAME.toml. Raises WiringError."""
    return read_board(Path(name)) if name.endswith(SUFFIX) else find_board(name)


def board_beside(image: Path, name: str) -> Board:
    """Return the board that a build described beside its image, else the table's of that name.

    Raises WiringError, one line: neither knows it.
    """
    path = image.with_name(BESIDE)
    if path.is_file() and (board := read_board(path)).name == name:
        return board
    return find_board(name)


def board_text(board: Board, because: Iterable[str] = ()) -> str:
    """Return the file of a board, which `read_board` reads as the same. because: comments above it."""
    return "\n".join([*(f"# {line}".rstrip() for line in because), *_lines(board)]) + "\n"


def alignment_name(alignment: int) -> str:
    """Return an alignment in the ecosystem's words: CW90_DEG_FLIP."""
    return next(name for name, code in _ALIGNMENTS.items() if code == alignment)


def check_name(name: str) -> str:
    """Return a board's name if it can be one: a folder's, too. Raises ValueError, one line."""
    if NAME.fullmatch(name) is None or name == "HOST":
        raise ValueError(
            f"name {name[:60]!r}, expected 1 to {BOARD_NAME_BYTES - 1} letters, digits, _ or -, and not HOST"
        )
    return name


def check_maker(maker: str) -> str:
    """Return the letters of a maker. Raises ValueError, one line."""
    if maker and (len(maker) >= BOARD_MAKER_BYTES or not maker.isascii() or not maker.isalnum()):
        raise ValueError(f"maker {maker[:60]!r}, expected up to {BOARD_MAKER_BYTES - 1} letters or digits")
    return maker


# --- Reading ------------------------------------------------------------------------------------------
def _board(table: StrictTable) -> Board:
    log = table.optional_part("log", _log)
    led = table.optional_part("led", _signal)
    beeper = table.optional_part("beeper", _signal)
    battery = table.optional_part("battery", _battery) or (None, None, DIVIDER_USUAL, 0)
    return Board(
        name=_checked(table, "name", check_name, None),
        maker=_checked(table, "maker", check_maker, ""),
        gyro_kinds=_words(table, "gyro_kinds"),
        gyros=table.parts("gyro", 1, BOARD_GYRO_COUNT, _gyro),
        buses=_numbered(table, "spi", BOARD_SPI_COUNT, _bus),
        uarts=_numbered(table, "uart", UART_COUNT, _uart),
        receiver=table.integer("receiver", 1, UART_COUNT) if table.has("receiver") else None,
        motors=_pins(table, "motors"),
        log_kind=log[0] if log else BoardLog.NONE,
        log_chip=log[1] if log else None,
        flash_kinds=log[2] if log else (),
        osd=table.optional_part("osd", _chip),
        led=led[0] if led else None,
        led_high=led is not None and led[1],
        beeper=beeper[0] if beeper else None,
        beeper_high=beeper is not None and beeper[1],
        usb_supply=_pin_or_none(table, "usb_supply"),
        volts=battery[0],
        amps=battery[1],
        volts_scale=battery[2],
        amps_scale=battery[3],
        turn_deg=table.optional_part("turn", _turn) or NOT_TURNED,
    )


def _checked(table: StrictTable, key: str, check: Callable[[str], str], default: str | None) -> str:
    try:
        return check(table.text(key, default))
    except ValueError as error:
        raise table.error(key, f"got {error}") from error


def _pin(table: StrictTable, key: str) -> Pin:
    return _pin_of(table, key, table.text(key))


def _pin_of(table: StrictTable, key: str, text: str) -> Pin:
    try:
        return Pin.of(text)
    except ValueError as error:
        raise table.error(key, f"got {error}") from error


def _pin_or_none(table: StrictTable, key: str) -> Pin | None:
    return _pin(table, key) if table.has(key) else None


def _pins(table: StrictTable, key: str) -> tuple[Pin, ...]:
    return tuple(_pin_of(table, key, text) for text in table.texts(key, 1, MOTOR_COUNT_MAX))


def _words(table: StrictTable, key: str) -> tuple[str, ...]:
    words = table.texts(key, 0, WORDS_MAX)
    for word in words:
        if WORD.fullmatch(word) is None:
            raise table.error(key, f"got {word[:60]!r}, expected a chip's name as MPU6000")
    return words


def _numbered(
    table: StrictTable, key: str, most: int, read: Callable[[StrictTable], _Value]
) -> dict[int, _Value]:
    """Return what `read` makes of the tables [key.1] to [key.`most`] that the file has, by number."""

    def parts(within: StrictTable) -> dict[int, _Value]:
        numbers = [number for number in range(1, most + 1) if within.has(str(number))]
        return {number: within.part(str(number), read) for number in numbers}

    return table.optional_part(key, parts) or {}


def _turn(table: StrictTable) -> Turn:
    roll, pitch, yaw = (table.integer(f"{axis}_deg", -180, 180, 0) for axis in AXES)
    return roll, pitch, yaw


def _spi(table: StrictTable) -> int:
    return table.integer("spi", 1, BOARD_SPI_COUNT)


def _gyro(table: StrictTable) -> GyroPlace:
    alignment = table.choice("alignment", _ALIGNMENTS, "CW0_DEG")
    spi = table.integer("spi", 0, BOARD_SPI_COUNT)
    return GyroPlace(spi, _pin(table, "select"), _pin_or_none(table, "ready"), alignment)


def _chip(table: StrictTable) -> Chip:
    return Chip(_spi(table), _pin(table, "select"))


def _log(table: StrictTable) -> tuple[BoardLog, Chip, tuple[str, ...]]:
    kind = table.choice("kind", _LOGS)
    return kind, _chip(table), _words(table, "chips") if table.has("chips") else ()


def _bus(table: StrictTable) -> Bus:
    return Bus(_pin(table, "sck"), _pin(table, "miso"), _pin(table, "mosi"))


def _uart(table: StrictTable) -> Uart:
    return Uart(_pin_or_none(table, "tx"), _pin_or_none(table, "rx"))


def _signal(table: StrictTable) -> tuple[Pin, bool]:
    return _pin(table, "pin"), table.choice("on", _LEVELS)


def _battery(table: StrictTable) -> tuple[Pin | None, Pin | None, int, int]:
    return (
        _pin_or_none(table, "volts"),
        _pin_or_none(table, "amps"),
        table.integer("volts_scale", 0, SCALE_MAX, DIVIDER_USUAL),
        table.integer("amps_scale", 0, SCALE_MAX, 0),
    )


# --- Writing ------------------------------------------------------------------------------------------
def _lines(board: Board) -> Iterator[str]:
    yield f'name = "{board.name}"'
    yield f'maker = "{board.maker}"'
    yield f"gyro_kinds = {_list(board.gyro_kinds)}"
    yield f"motors = {_list(board.motors)}"
    if board.receiver is not None:
        yield f"receiver = {board.receiver} # its UART"
    if board.usb_supply is not None:
        yield f'usb_supply = "{board.usb_supply}"'
    for gyro in board.gyros:
        ready = {"ready": gyro.ready} if gyro.ready else {}
        alignment = alignment_name(gyro.alignment)
        yield from _table(
            "[gyro]", {"spi": gyro.spi, "select": gyro.select} | ready | {"alignment": alignment}
        )
    if board.turn_deg != NOT_TURNED:
        turned = zip(AXES, board.turn_deg, strict=True)
        yield from _table("turn", {f"{axis}_deg": degrees for axis, degrees in turned if degrees})
    for number, bus in board.buses.items():
        yield from _table(f"spi.{number}", {"sck": bus.sck, "miso": bus.miso, "mosi": bus.mosi})
    for number, uart in board.uarts.items():
        yield from _table(f"uart.{number}", {"tx": uart.tx, "rx": uart.rx})
    if board.log_kind is not BoardLog.NONE and board.log_chip is not None:
        chip = {"spi": board.log_chip.spi, "select": board.log_chip.select}
        yield from _table("log", {"kind": board.log_kind.name.lower()} | chip)
        if board.flash_kinds:
            yield f"chips = {_list(board.flash_kinds)}"
    if board.osd is not None:
        yield from _table("osd", {"spi": board.osd.spi, "select": board.osd.select})
    for name, pin, high in (
        ("led", board.led, board.led_high),
        ("beeper", board.beeper, board.beeper_high),
    ):
        if pin is not None:
            yield from _table(name, {"pin": pin, "on": "high" if high else "low"})
    pins = {"volts": board.volts, "amps": board.amps}
    yield from _table("battery", pins | {"volts_scale": board.volts_scale, "amps_scale": board.amps_scale})


def _list(values: Iterable[object]) -> str:
    return "[" + ", ".join(f'"{value}"' for value in values) + "]"


def _table(name: str, values: Mapping[str, object]) -> Iterator[str]:
    """Yield a table's lines; a value that is None is left out."""
    yield ""
    yield f"[{name}]"
    for key, value in values.items():
        if value is not None:
            yield f"{key} = {value}" if isinstance(value, int) else f'{key} = "{value}"'
