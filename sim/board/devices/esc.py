"""DShot as a motor's ESC sees it: pulses on a line, from which frames come or an error that names the motor.

C takes plain frames (native/c/esc.c). `Esc.pulses` decodes the first one, which tells the protocol, and says
what is wrong with pulses that are no frame.

A bit lasts 1.667 us with DShot600 and 3.333 us with DShot300; its pulse is 37.5 % of that for a 0 and 75 %
for a 1. A frame is 16 bits, most significant first: 11 of the value, the telemetry bit, and a checksum, the
exclusive or of the three nibbles before it; between frames the line rests low for 2 us or more.

The protocol states nominal times only. Decoders compare each pulse with half of the frame's mean bit, which
leaves a quarter of a bit to either side; ESCs measure with RC oscillators of some per cent. `TOLERANCE` is
ours: what a good controller keeps to, and an ESC takes however its oscillator stands.

An ESC whose line is silent stops its motor: AM32 half a second after the last frame (Src/main.c, signal
timeout when armed), BLHeli_S and Bluejay 160 ms after it (ten overflows of timer 2 at 16 ms). `SILENT_S` is
the longer: what an aircraft has to live with.

AM32 and Bluejay find the speed out when they start; others are set to one. `Esc.fitted` says which.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NoReturn

from neuroflight.sim.board.core.context import TIME_HZ, Kept

PROTOCOLS = {300: 300_000, 600: 600_000}  # bits a second
TOLERANCE = 0.05  # of a nominal time
GAP_S = 2e-6  # least rest between frames
SILENT_S = 0.5  # without a frame, then the motor stops
FRAME_BITS = 16
NO_FRAME = 0xFFFFFFFF  # of api.h
_HIGH = (0.375, 0.75)  # of a bit, for 0 and 1


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame taken by an ESC."""

    motor: int  # 1..
    cycle: int  # at which the frame's last bit ended
    value: int  # 0..2047
    telemetry: bool
    protocol: int  # 300 or 600


class Esc(Kept):
    """The receiving end of one motor's line. `fail` is called with the error, and must not return."""

    kept = ("_bits", "_length", "_next")

    def __init__(self, in_c: Any, fail: Callable[[str], NoReturn]) -> None:  # noqa: ANN401 - struct esc
        """in_c: its state, which C changes with each plain frame."""
        self._in_c, self._fail = in_c, fail
        self.motor = in_c.motor + 1
        self.fitted: int | None = None  # the protocol that it is set to; None: it takes what comes first
        self.on_frame: Callable[[Frame], None] = lambda frame: None
        self._bits: tuple[int, ...] = ()  # high times [cycles] of a frame that is not complete yet
        self._length = 0  # of its bits [cycles]
        self._next = 0  # cycle at which its next bit has to begin
        self.silence(forget=True)

    @property
    def protocol(self) -> int | None:
        """300 or 600; None: whatever the first bit says."""
        return int(self._in_c.protocol) or None

    @protocol.setter
    def protocol(self, protocol: int | None) -> None:
        """Set the protocol: C takes the frames whose bits have about the right length."""
        bit = TIME_HZ / PROTOCOLS[protocol] if protocol else 0.0
        self._in_c.protocol = protocol or 0
        self._in_c.shortest, self._in_c.longest = math.ceil(bit * (1 - TOLERANCE)), int(bit * (1 + TOLERANCE))

    @property
    def frames(self) -> int:
        return int(self._in_c.frames)

    @property
    def last(self) -> Frame | None:
        """Last frame; None: none since power-up."""
        state = self._in_c
        return None if state.last == NO_FRAME else self.frame(state.last_cycle, state.last)

    def frame(self, cycle: int, data: int) -> Frame:
        assert self.protocol is not None
        return Frame(self.motor, cycle, data >> 1, bool(data & 1), self.protocol)

    def pulses(self, start: int, length: int, highs: Sequence[int]) -> None:
        """Decode periods of `length` cycles from cycle `start` on, high for `highs` cycles each."""
        position, count = 0, len(highs)
        while position < count:
            if not self._bits:
                while position < count and not highs[position]:
                    position += 1
                if position == count:
                    return
                self._open(start + position * length, length)
            elif length != self._length:
                self._fail(
                    f"motor {self.motor}: a bit lasts {_us(length)}, the one before it {_us(self._length)}"
                )
            elif start + position * length != self._next:
                self._fail(f"motor {self.motor}: a frame pauses after {len(self._bits)} bits")
            taken = tuple(highs[position : position + FRAME_BITS - len(self._bits)])
            if 0 in taken:
                missing = len(self._bits) + taken.index(0)
                self._fail(f"motor {self.motor}: a frame ends after {missing} bits, expected {FRAME_BITS}")
            self._bits += taken
            position += len(taken)
            self._next = start + position * length
            if len(self._bits) == FRAME_BITS:
                self._close(start + position * length)

    def accept(self, frame: Frame) -> None:
        """Record a frame that was decoded here."""
        state = self._in_c
        state.rest_since = state.last_cycle = frame.cycle
        state.last = frame.value << 1 | frame.telemetry
        state.frames += 1
        self.on_frame(frame)

    def silence(self, forget: bool) -> None:
        """Let the line fall silent, perhaps within a frame; `forget`: the ESC restarts as well."""
        self._bits = ()
        self._in_c.rest_since = -TIME_HZ
        if forget:
            self.protocol, self._in_c.last = None, NO_FRAME

    def _open(self, cycle: int, length: int) -> None:
        gap = (cycle - self._in_c.rest_since) / TIME_HZ
        if gap < GAP_S:
            self._fail(
                f"motor {self.motor}: {gap * 1e6:.2f} us of rest before a frame, expected {GAP_S * 1e6:g} us "
                f"or more"
            )
        self._length = length
        wanted = [self.protocol] if self.protocol else list(PROTOCOLS)
        for name in wanted:
            if abs(length * PROTOCOLS[name] / TIME_HZ - 1.0) <= TOLERANCE:
                if self.fitted not in (None, name):
                    self._fail(
                        f"motor {self.motor}: DShot{name}, expected DShot{self.fitted}, which its ESC is set "
                        f"to; give both the same (setting motor_protocol)"
                    )
                self.protocol = name
                return
        nominal = " or ".join(f"{1e6 / PROTOCOLS[n]:.3f} us (DShot{n})" for n in wanted)
        self._fail(
            f"motor {self.motor}: a bit lasts {_us(length)}, expected {nominal} within {TOLERANCE:.0%}"
        )

    def _close(self, end: int) -> None:
        assert self.protocol is not None
        bits, self._bits = self._bits, ()
        value, wrong = _decode(bits, self._length)
        if wrong:
            self._fail(f"motor {self.motor}: {wrong}")
        self.accept(Frame(self.motor, end, value >> 1, bool(value & 1), self.protocol))


@lru_cache(maxsize=4096)
def _decode(bits: tuple[int, ...], length: int) -> tuple[int, str]:
    """Decode value with telemetry bit, and describe an error if there is one."""
    frame = 0
    for number, high in enumerate(bits, 1):
        share = high / length
        bit = int(share > sum(_HIGH) / 2)
        if abs(share / _HIGH[bit] - 1.0) > TOLERANCE:
            expected = f"{_us(round(_HIGH[0] * length))} for a 0 or {_us(round(_HIGH[1] * length))} for a 1"
            return 0, f"bit {number} is high for {_us(high)}, expected {expected} within {TOLERANCE:.0%}"
        frame = frame << 1 | bit
    data = frame >> 4
    checksum = (data ^ data >> 4 ^ data >> 8) & 15
    if frame & 15 != checksum:
        return 0, f"frame 0x{frame:04X} has the checksum {frame & 15:X}, expected {checksum:X}"
    return data, ""


def _us(cycles: int) -> str:
    return f"{cycles * 1e6 / TIME_HZ:.3f} us"
