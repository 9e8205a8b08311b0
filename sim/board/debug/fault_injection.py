"""Faults for a flight on the emulated board: kind, value and time.

A fault is written NAME[=VALUE]@SECONDS, seconds of the flight from its first armed control step on, or
NAME[=VALUE]@boot, at power-up. What the firmware makes of each: docs/explanation/emulated-board.md.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.core.engine import CPI
from neuroflight.sim.board.devices.esc import AnswerFaults
from neuroflight.sim.board.devices.sd_card import CardFault
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.registers.bus import load_table
from neuroflight.toolchain.errors import ScenarioError

BOOT = "boot"
SECONDS_MAX = 3600.0
NOWHERE = 0x60000000  # external memory, which this board has none of


@dataclass(frozen=True)
class Value:
    """The limits of a fault's VALUE, and what it is where none is given."""

    default: float
    low: float
    high: float
    whole: bool = False


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault."""

    value: Value | None = None  # None: there is none
    begin: Callable[[Board, float], None] = lambda board, value: None
    end: Callable[[Board], None] | None = None  # after VALUE seconds, where it is a time
    of_card: bool = False  # of the SD card, which the firmware flies on without


def _cut(board: Board, number: float) -> None:
    flash = board.hardware.flash
    flash.cut_at = flash.operations + int(number) - 1


def _overload(board: Board, seconds: float) -> None:
    """Redirect the program's call of `trace_write`, one a control step, through a loop behind its code in
    ITCM.

    The table of such calls lies in RAM, so that a reset ends it.
    """
    symbols, engine = board.symbols, board.engine
    table, function, stub = symbols["functions"], symbols["hal_trace_write"] | 1, symbols["itcm_end"] + 3 & ~3
    calls = list(struct.unpack("<16I", engine.memory(table, 64)))
    if function not in calls:
        return  # the loop is there already
    rounds = round(seconds * TIME_HZ / (2 * CPI))
    loop = (0x4A02, 0x3A01, 0xD1FD, 0x4A02, 0x4710, 0xBF00)  # ldr r2; subs r2, #1; bne; ldr r2; bx r2; nop
    engine.set_memory(stub, struct.pack("<6H2I", *loop, rounds, function))
    engine.set_memory(table + 4 * calls.index(function), struct.pack("<I", stub | 1))


def _stop_timer(board: Board, _: float) -> None:
    """Stop TIM1: it sends DMA no more requests, so that no stream of the motors ever ends."""
    block = load_table().blocks["TIM1"]
    address = block.base + block.registers["CR1"].offset
    board.engine.store(address, 4, board.engine.load(address, 4) & ~1)  # CEN


def _silence(board: Board, motor: float) -> None:
    """Let the ESC of that motor obey frames, and answer none."""
    if motor > len(board.hardware.escs):
        raise ScenarioError(f"esc-silent={motor:g}: the board has motors 1 to {len(board.hardware.escs)}")
    board.hardware.escs[int(motor) - 1].spoil(AnswerFaults(silence=1.0))


def _disturb(board: Board, share: float) -> None:
    for esc in board.hardware.escs:
        esc.spoil(AnswerFaults(noise=share))


def _card(fault: CardFault) -> Callable[[Board, float], None]:
    return lambda board, value: board.hardware.log_place.strike(fault, value)


def _hang(board: Board, _: float) -> None:
    """Let the core loop with interrupts masked, behind the code in ITCM."""
    stub = board.symbols["itcm_end"] + 3 & ~3
    board.engine.set_memory(stub, struct.pack("<2H", 0xB672, 0xE7FE))  # cpsid i; b .
    board.engine.pc = stub


_SECONDS = Value(math.inf, 0.0001, SECONDS_MAX)  # by default for good
FAULTS = {
    "gyro-silent": FaultKind(
        _SECONDS,
        lambda board, value: setattr(board.hardware.gyro, "silent", True),
        lambda board: setattr(board.hardware.gyro, "silent", False),
    ),
    "spi-bit-errors": FaultKind(  # share of the bits
        Value(0.001, 1e-9, 1.0), lambda board, rate: setattr(board.hardware.spi, "bit_error_rate", rate)
    ),
    "gyro-line": FaultKind(  # level that it is stuck at
        Value(1, 0, 1, whole=True), lambda board, level: setattr(board.hardware.spi, "stuck", int(level))
    ),
    "brown-out": FaultKind(begin=lambda board, _: board.brown_out()),
    "reset": FaultKind(begin=lambda board, _: board.engine.system_reset("pin")),
    "flash-cut": FaultKind(Value(1, 1, 1_000_000, whole=True), _cut),  # number of the operation from then on
    "crystal": FaultKind(begin=lambda board, _: board.hardware.rcc.fail_crystal()),
    "hang": FaultKind(begin=_hang),
    "processor-fault": FaultKind(begin=lambda board, _: setattr(board.engine, "pc", NOWHERE)),
    "motors-stuck": FaultKind(begin=_stop_timer),
    "esc-silent": FaultKind(Value(1, 1, 8, whole=True), _silence),  # number of the motor
    "esc-noise": FaultKind(Value(0.01, 1e-9, 1.0), _disturb),  # share of the samples of all lines
    "overload": FaultKind(Value(0.0006, 1e-6, 0.1), _overload),  # seconds
    "card-stall": FaultKind(Value(0.5, 0.0001, SECONDS_MAX), _card(CardFault.STALL), of_card=True),
    "card-removed": FaultKind(
        _SECONDS,
        _card(CardFault.REMOVED),
        lambda board: board.hardware.log_place.strike(CardFault.INSERTED),
        of_card=True,
    ),
    "card-errors": FaultKind(Value(0.01, 1e-9, 1.0), _card(CardFault.ERRORS), of_card=True),  # share
    "card-worn": FaultKind(Value(0, 0, 1e9, whole=True), _card(CardFault.WORN), of_card=True),  # writes
    "card-slow": FaultKind(Value(10.0, 0.1, 1000.0), _card(CardFault.SLOW), of_card=True),  # times as long
    # The receiver is not the board's: `FaultPlan.damaged` takes its frames.
    "receiver-broken": FaultKind(Value(1.0, 1e-9, 1.0)),  # share of the frames
}


@dataclass(frozen=True)
class Fault:
    """One fault of a flight."""

    name: str  # of FAULTS
    value: float
    at_s: float | None  # after the first armed control step; None: when the board gets its power

    @property
    def kind(self) -> FaultKind:
        return FAULTS[self.name]

    def __str__(self) -> str:
        value = self.kind.value
        given = f"={self.value:g}" if value is not None and self.value != value.default else ""
        return f"{self.name}{given}@{BOOT if self.at_s is None else f'{self.at_s:g}'}"


def parse_fault(text: str) -> Fault:
    """Read NAME[=VALUE]@SECONDS or NAME[=VALUE]@boot. Raises ScenarioError on anything else."""
    what, at, when = text.partition("@")
    name, equals, given = what.partition("=")
    if not at:
        raise ScenarioError(f"fault {text!r}, expected NAME[=VALUE]@SECONDS or NAME[=VALUE]@{BOOT}")
    if name not in FAULTS:
        raise ScenarioError(f"fault {name!r} is unknown, expected one of {', '.join(FAULTS)}")
    taken = FAULTS[name].value
    if equals and taken is None:
        raise ScenarioError(f"fault {name}: got the value {given!r}, expected none")
    value = 0.0 if taken is None else _number(given, f"fault {name}", taken) if equals else taken.default
    at_s = None if when == BOOT else _number(when, f"fault {name}: its time", _TIME)
    return Fault(name, value, at_s)


class FaultPlan:
    """The begins and ends of a flight's faults, in gyro samples from the first one on. Snapshots copy it."""

    def __init__(self, faults: Sequence[Fault], rate_hz: int) -> None:
        """rate_hz: of the gyro samples. Faults of the boot are due at once."""
        self.begun = False  # a fault has come after which lockstep is not guaranteed
        self._rate_hz = rate_hz
        # What is to come: sample, fault, whether it ends then.
        self.due = [(0, fault, False) for fault in faults if fault.at_s is None]
        self._later = [fault for fault in faults if fault.at_s is not None]
        self._broken = 0.0  # share of receiver frames
        self._random = random.Random(1)

    @property
    def waiting(self) -> tuple[Fault, ...]:
        """Faults whose time has not come."""
        return (*(fault for _, fault, ends in self.due if not ends), *self._later)

    def start(self, sample: int) -> None:
        """Start the flight with gyro sample number `sample`."""
        for fault in self._later:
            assert fault.at_s is not None
            self._add(sample + max(1, round(fault.at_s * self._rate_hz)), fault, ends=False)
        self._later = []

    def inject(self, board: Board, sample: int) -> list[str]:
        """Inject into `board` the faults due before `sample`; return them in words."""
        words = []
        while self.due and self.due[0][0] <= sample:
            _, fault, ends = self.due.pop(0)
            words.append(f"fault {fault}{' ends' if ends else ''}")
            kind = fault.kind
            self.begun = self.begun or not kind.of_card
            if ends and kind.end is not None:
                kind.end(board)
                continue
            kind.begin(board, fault.value)
            if fault.name == "receiver-broken":
                self._broken = fault.value
            if kind.end is not None and math.isfinite(fault.value):
                self._add(sample + max(1, round(fault.value * self._rate_hz)), fault, ends=True)
        return words

    def damaged(self, frame: bytes, sent: Format) -> tuple[bytes, tuple[int, ...]]:
        """Return a receiver frame as it arrives, and the indices of its bytes with a wrong parity bit."""
        if not self._broken or self._random.random() >= self._broken:
            return frame, ()
        place, bit = self._random.randrange(len(frame)), self._random.randrange(8)
        arrives = frame[:place] + bytes([frame[place] ^ 1 << bit]) + frame[place + 1 :]
        return arrives, () if sent.parity == "N" else (place,)

    def _add(self, sample: int, fault: Fault, *, ends: bool) -> None:
        self.due.append((sample, fault, ends))
        self.due.sort(key=lambda item: item[0])


_TIME = Value(0.0, 0.0, SECONDS_MAX)


def _number(text: str, where: str, taken: Value) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not taken.low <= value <= taken.high or (taken.whole and value != int(value)):
        kind = "a whole number from " if taken.whole else ""
        raise ScenarioError(f"{where}: got {text!r}, expected {kind}{taken.low:g} to {taken.high:g}")
    return value
