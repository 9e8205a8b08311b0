"""A board from what Betaflight's files tell of it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from neuroflight.toolchain.boards.betaflight_facts import PROCESSORS, SHOWN, Facts, read_facts
from neuroflight.toolchain.boards.board_file import AXES, SCALE_MAX, UART_COUNT, WORD, check_maker, check_name
from neuroflight.toolchain.boards.facts import NOT_TURNED, Board, Bus, Chip, GyroPlace, Pin, Turn, Uart
from neuroflight.toolchain.boards.table import DIVIDER_USUAL, alignment_code, boards
from neuroflight.toolchain.contract import (
    BOARD_GYRO_COUNT,
    BOARD_SPI_COUNT,
    MOTOR_COUNT_MAX,
    BoardLog,
    GyroChip,
)
from neuroflight.toolchain.errors import WiringError

AMPS_USUAL = 400  # [0.1 mV/A] of a current sensor that Betaflight's files say nothing about
_Value = TypeVar("_Value")
_LOGS = {"FLASH": BoardLog.FLASH, "SPIFLASH": BoardLog.FLASH, "SDCARD": BoardLog.CARD}


@dataclass(frozen=True)
class Imported:
    """A board that a file tells of."""

    board: Board
    notes: tuple[str, ...]  # what the pilot has to know or do, a line each


def import_board(path: Path, name: str | None = None, gyros: Sequence[str] = ()) -> Imported:
    """Read a board from Betaflight's `dump hardware`, a unified target or a config.h.

    name: its name, where the file tells none or another is wanted. gyros: chips that it carries, which the
    command line does not tell: without, those of the board of that name are taken. Raises WiringError, one
    line that names the line of the file.
    """
    facts = read_facts(path)
    processor = facts.told.get("processor")
    if processor is not None and not processor.text.upper().startswith(PROCESSORS):
        raise facts.error("processor", f"{processor.text[:SHOWN]}, expected an {PROCESSORS[0]}")
    called = name or (_read(facts, "name", check_name) if "name" in facts.told else None)
    if called is None:
        raise WiringError(f"{path}: it does not tell the board's name; give one with --name")
    kinds = tuple(gyros) or tuple(sorted(facts.gyro_kinds & GyroChip.__members__.keys()))
    known = boards().get(called)
    notes = []
    if not kinds and not facts.gyro_kinds and known is not None:
        kinds = known.gyro_kinds
        notes.append(
            f"the file does not tell the gyro's chip; {called} is known to carry {' or '.join(kinds)}"
        )
    if not kinds:
        told = ", ".join(sorted(facts.gyro_kinds)) or "none"
        raise WiringError(
            f"{path}: its gyro is told to be {told[:SHOWN]}, which the firmware does not know; name its chip "
            "with --gyro: the command `status` of Betaflight tells it"
        )
    turn = _turn(facts)
    if not facts.by_maker:
        own = NOT_TURNED if known is None else known.turn_deg
        if turn not in (own, NOT_TURNED):
            notes.append(
                f"{turn_words(turn)} is the pilot's or the maker's, and the file does not tell whose: it is "
                "not taken over; `neuroflight board settings import` brings it"
            )
        turn = own
    elif turn != NOT_TURNED:
        notes.append(
            f"{turn_words(turn)} is its maker's, so that its arrow points forward: board_yaw_deg and its kin "
            "come on top, and stay 0 where you mount it like that"
        )
    return Imported(_board(facts, called, kinds, turn), tuple(notes))


def differences(one: Board, other: Board) -> list[str]:
    """Return the facts in which two boards differ, by name."""
    return [name for name in Board.__dataclass_fields__ if getattr(one, name) != getattr(other, name)]


def turn_words(turn: Turn) -> str:
    """Return the turn of a whole board in words: a turn of the board by roll 180, yaw 90 deg."""
    told = ", ".join(f"{axis} {degrees}" for axis, degrees in zip(AXES, turn, strict=True) if degrees)
    return f"a turn of the board by {told} deg"


def _turn(facts: Facts) -> Turn:
    roll, pitch, yaw = (
        _read(facts, f"board_{axis}", _degrees) if f"board_{axis}" in facts.told else 0 for axis in AXES
    )
    return roll, pitch, yaw


def _degrees(text: str) -> int:
    if re.fullmatch(r"-?[0-9]{1,3}", text) is None or not -180 <= int(text) <= 360:
        raise ValueError(f"got {text[:SHOWN]!r}, expected whole degrees, -180 to 360")
    return int(text) - 360 * (int(text) > 180)


def _board(facts: Facts, name: str, kinds: tuple[str, ...], turn: Turn) -> Board:
    log_kind, log_chip = _log(facts)
    led, beeper = _pin(facts, "LED 1"), _pin(facts, "BEEPER 1")
    numbers = range(1, UART_COUNT + 1)
    uarts = {n: Uart(_pin(facts, f"TX {n}"), _pin(facts, f"RX {n}")) for n in numbers}
    buses = {n: _bus(facts, n) for n in range(1, BOARD_SPI_COUNT + 1)}
    return Board(
        name=name,
        maker=_read(facts, "maker", check_maker) if "maker" in facts.told else "",
        gyro_kinds=kinds,
        gyros=_gyros(facts),
        buses={n: bus for n, bus in buses.items() if bus is not None},
        uarts={n: uart for n, uart in uarts.items() if uart != Uart(None, None)},
        receiver=_read(facts, "receiver", _uart) if "receiver" in facts.told else None,
        motors=_motors(facts),
        log_kind=log_kind,
        log_chip=log_chip,
        flash_kinds=tuple(sorted(k for k in facts.flash_kinds if WORD.fullmatch(k)))
        if log_kind is BoardLog.FLASH
        else (),
        osd=_chip(facts, "osd_spi", "OSD_CS 1"),
        led=led,
        led_high=led is not None and _switched(facts, "led_high"),
        beeper=beeper,
        beeper_high=beeper is not None and _switched(facts, "beeper_high"),
        usb_supply=_pin(facts, "USB_DETECT 1"),
        volts=_pin(facts, "VOLTS 1"),
        amps=_pin(facts, "AMPS 1"),
        volts_scale=_scale(facts, "volts_scale", DIVIDER_USUAL),
        amps_scale=_scale(facts, "amps_scale", AMPS_USUAL),
        turn_deg=turn,
    )


def _read(facts: Facts, key: str, read: Callable[[str], _Value]) -> _Value:
    """Return what `read` makes of a word. Raises WiringError with its line."""
    try:
        return read(facts.told[key].text)
    except ValueError as error:
        raise facts.error(key, str(error)) from error


def _pin(facts: Facts, key: str) -> Pin | None:
    if key not in facts.told or facts.told[key].text.upper() == "NONE":
        return None
    return _read(facts, key, lambda text: Pin.of(text.upper()))


def _motors(facts: Facts) -> tuple[Pin, ...]:
    """Return the pins of the outputs up to the first that is not told."""
    found: list[Pin] = []
    for number in range(1, MOTOR_COUNT_MAX + 1):
        if (pin := _pin(facts, f"MOTOR {number}")) is None:
            break
        found.append(pin)
    return tuple(found)


def _bus(facts: Facts, number: int) -> Bus | None:
    sck, miso, mosi = (_pin(facts, f"{signal} {number}") for signal in ("SCK", "MISO", "MOSI"))
    return None if sck is None or miso is None or mosi is None else Bus(sck, miso, mosi)


def _spi(text: str) -> int | None:
    number = text.upper().removeprefix("SPI")
    if number in ("0", "NONE", "NULL"):
        return None
    if number not in tuple("123"):
        raise ValueError(f"got {text[:SHOWN]!r}, expected SPI1 to SPI{BOARD_SPI_COUNT}")
    return int(number)


def _uart(text: str) -> int:
    number = text.upper().removeprefix("SERIAL_PORT_").removeprefix("USART").removeprefix("UART")
    if number not in tuple("123456"):
        raise ValueError(f"got {text[:SHOWN]!r}, expected UART1 to UART{UART_COUNT}")
    return int(number)


def _chip(facts: Facts, spi: str, select: str) -> Chip | None:
    number = _read(facts, spi, _spi) if spi in facts.told else None
    pin = _pin(facts, select)
    return None if number is None or pin is None else Chip(number, pin)


def _gyros(facts: Facts) -> tuple[GyroPlace, ...]:
    """Return the places of gyros, that first which Betaflight uses."""
    places: list[GyroPlace] = []
    for number in range(1, BOARD_GYRO_COUNT + 1):
        spi, select = f"gyro_spi {number}", _pin(facts, f"GYRO_CS {number}")
        at = _read(facts, spi, _spi) if spi in facts.told else None
        if select is not None and (at is not None or places):  # without an SPI it is held deselected
            align = f"gyro_align {number}"
            turned = _read(facts, align, _alignment) if align in facts.told else 0
            places.append(GyroPlace(at or 0, select, _pin(facts, f"GYRO_EXTI {number}"), turned))
    used = facts.told["gyro_used"].text.upper() if "gyro_used" in facts.told else ""
    second = used in ("SECOND", "2", "GYRO_CONFIG_USE_GYRO_2", "GYRO_MASK(1)")
    return tuple(reversed(places) if second and len(places) > 1 else places)


def _alignment(text: str) -> int:
    word = text.upper().replace("_", "").replace("DEG", "")
    return 0 if word in ("DEFAULT", "ALIGNDEFAULT") else alignment_code(word)


def _log(facts: Facts) -> tuple[BoardLog, Chip | None]:
    """Return what keeps logs: what Betaflight logs to, else a chip that it has a driver for."""
    told = facts.told["log"].text.upper().removeprefix("BLACKBOX_DEVICE_") if "log" in facts.told else ""
    chips = {
        BoardLog.FLASH: _chip(facts, "flash_spi", "FLASH_CS 1"),
        BoardLog.CARD: _chip(facts, "card_spi", "CARD_CS 1"),
    }
    usual = BoardLog.FLASH if facts.flash_kinds else BoardLog.CARD if facts.has_card else BoardLog.NONE
    kind = _LOGS.get(told, usual)
    chip = chips.get(kind)
    return (BoardLog.NONE, None) if chip is None else (kind, chip)


def _switched(facts: Facts, key: str) -> bool:
    """Return whether a switch is on: a name that is defined, ON, or a mask with its first bit."""
    if key not in facts.told:
        return False
    text = facts.told[key].text.upper()
    return text not in ("OFF", "0", "FALSE") and not (text.isdigit() and int(text[:4]) % 2 == 0)


def _scale(facts: Facts, key: str, usual: int) -> int:
    def scale(text: str) -> int:
        if not text.isdigit() or len(text) > 5 or int(text) > SCALE_MAX:
            raise ValueError(f"got {text[:SHOWN]!r}, expected a whole number from 0 to {SCALE_MAX}")
        return int(text)

    return _read(facts, key, scale) if key in facts.told else usual
