"""The boards with an STM32F722 that public configurations name: boards.csv, a row for each.

Its wiring is that of the configurations which makers have published for Betaflight, as of August 2026
(github.com/betaflight/config, commit 5af0c8b0). All have a crystal of 8 MHz. `import_board` reads 177 of
those files as the rows that stand here; the others: MATEKF722's gyros are those whose turn no source
disputes, CYCLONEF722_PRO's third flash chip stands behind a condition, and NUCLEOF722, a board of the
processor's maker, has a gyro on I2C alone.

gyro_used is 2 where Betaflight uses the second gyro unless told otherwise. turn_deg is what a configuration
presets as align_board_roll, _pitch and _yaw; FLYCOLORF7_AIO_HD and SUB250REDFOXF722AIO say it by a word that
Betaflight does not read, and their older configurations (github.com/betaflight/unified-targets) agree.
"""

from __future__ import annotations

import csv
import difflib
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TypeVar

from neuroflight.toolchain.boards.facts import NOT_TURNED, Board, Bus, Chip, GyroPlace, Pin, Turn, Uart
from neuroflight.toolchain.contract import BoardLog
from neuroflight.toolchain.errors import WiringError

TABLE = Path(__file__).with_name("boards.csv")
NEAR = 3  # names that an unknown one is answered with
DIVIDER_USUAL = 110  # [0.1] of the battery's voltage, where a configuration says nothing
_LOGS = {"": (BoardLog.NONE, ""), "sdcard": (BoardLog.CARD, "sd"), "flash": (BoardLog.FLASH, "flash")}
_SERIAL = ("SERIAL_PORT_USART", "SERIAL_PORT_UART")
_T = TypeVar("_T")


@cache
def boards() -> Mapping[str, Board]:
    """Return the boards of the table by name, in its order."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        return {row["board"]: _board(row) for row in csv.DictReader(file)}


def find_board(name: str) -> Board:
    """Return the board of that name. Raises WiringError, one line with names alike."""
    known = boards()
    if name not in known:
        near = difflib.get_close_matches(name[:60].upper(), known, NEAR, cutoff=0.5)
        alike = f", did you mean {' or '.join(near)}?" if near else ";"
        raise WiringError(
            f"unknown board {name[:60]!r}{alike} `neuroflight board target list` names all {len(known)}; "
            "`neuroflight board target import` makes a target of a board's own configuration"
        )
    return known[name]


def alignment_code(text: str) -> int:
    """Return the number of CW90FLIP or CW90_DEG_FLIP: quarter turns clockwise, and 4 for FLIP.

    Raises ValueError.
    """
    flip = text.endswith("FLIP")
    degrees = text.removeprefix("CW").removesuffix("FLIP").removesuffix("_").removesuffix("_DEG")
    if not text.startswith("CW") or degrees not in ("0", "90", "180", "270"):
        raise ValueError(
            f"alignment {text[:60]!r}, expected CW0_DEG, CW90_DEG, CW180_DEG, CW270_DEG or with _FLIP"
        )
    return int(degrees) // 90 + 4 * flip


def _board(row: Mapping[str, str]) -> Board:
    gyro_spi, select = _given(row["gyro_spi"], _spi), _given(row["gyro_cs"], Pin.of)
    gyros: tuple[GyroPlace, ...] = ()
    if gyro_spi is not None and select is not None:
        ready = _given(row["gyro_exti"], Pin.of)
        gyros = (GyroPlace(gyro_spi, select, ready, alignment_code(row["gyro_align"] or "CW0_DEG")),)
        if row["gyro2_cs"]:
            spi, ready = _given(row["gyro2_spi"], _spi), _given(row["gyro2_exti"], Pin.of)
            turned = alignment_code(row["gyro2_align"] or "CW0_DEG")
            gyros += (GyroPlace(spi or 0, Pin.of(row["gyro2_cs"]), ready, turned),)
        if row["gyro_used"] == "2":
            gyros = gyros[::-1]
    kind, _, flash = row["blackbox"].partition(":")
    log_kind, place = _LOGS[kind]
    log_chip = _chip(row, place) if place else None
    return Board(
        name=row["board"],
        maker=row["maker"],
        gyro_kinds=tuple(row["gyros"].split("/")) if row["gyros"] else (),
        gyros=gyros,
        buses={number: Bus(*map(Pin.of, pins)) for number, pins in _numbered(row["spi"]).items()},
        uarts={
            number: Uart(*(None if pin == "-" else Pin.of(pin) for pin in pins))
            for number, pins in _numbered(row["uarts"]).items()
        },
        receiver=_given(row["serial_rx"], _serial),
        motors=tuple(Pin.of(row[f"motor{i}"]) for i in range(1, 9) if row[f"motor{i}"]),
        log_kind=log_kind if log_chip else BoardLog.NONE,
        log_chip=log_chip,
        flash_kinds=tuple(flash.split("/")) if flash and log_chip else (),
        osd=_chip(row, "osd"),
        led=_given(row["led0"], Pin.of),
        led_high=row["led_inverted"] == "yes",  # inverted against Betaflight's usual one, which low lights
        beeper=_given(row["beeper"], Pin.of),
        beeper_high=bool(row["beeper"]) and row["beeper_inverted"] == "yes",
        usb_supply=_given(row["usb_detect"], Pin.of),
        volts=_given(row["vbat"], Pin.of),
        amps=_given(row["current"], Pin.of),
        volts_scale=int(row["vbat_scale"] or DIVIDER_USUAL),
        amps_scale=int(row["current_scale"] or 0),
        turn_deg=_turn(row["turn_deg"]),
    )


def _given(text: str, read: Callable[[str], _T]) -> _T | None:
    return read(text) if text else None


def _turn(text: str) -> Turn:
    roll, pitch, yaw = map(int, text.split("/")) if text else NOT_TURNED
    return roll, pitch, yaw


def _spi(text: str) -> int:
    return int(text.removeprefix("SPI"))


def _serial(text: str) -> int:
    for prefix in _SERIAL:
        text = text.removeprefix(prefix)
    return int(text)


def _numbered(text: str) -> dict[int, list[str]]:
    """Return the pins of 1:PA5/PA6/PA7;2:PB13/PB14/PB15 by number."""
    parts = (part.partition(":") for part in text.split(";") if part)
    return {int(number): pins.split("/") for number, _, pins in parts}


def _chip(row: Mapping[str, str], place: str) -> Chip | None:
    spi, select = row[f"{place}_spi"], row[f"{place}_cs"]
    return Chip(_spi(spi), Pin.of(select)) if spi and select else None
