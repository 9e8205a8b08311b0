"""DShot as a motor's ESC sees it: edges on a pin, from which frames come or an error that names the motor.

C takes plain frames and sends the answers (native/c/esc.c). `Esc.take` decodes the first frame, which tells
the protocol, and says what is wrong with edges that are no frame.

A bit lasts 1.667 us with DShot600, 3.333 us with DShot300 and 6.667 us with DShot150; it begins with a
pulse, short for a 0 and long for a 1. A frame is 16 bits, most significant first: 11 of the value, the
telemetry bit, and a checksum, the exclusive or of the three nibbles before it. Between frames the line rests
low. It rests high, with low pulses and the checksum inverted, where answers are asked for (bidirectional).

What decoders take (their sources, read in 2026):
- AM32 (Src/dshot.c) compares each pulse with 1/32 of the time from the first to the last edge, 0.48 to 0.49
  bits, and refuses frames that are 6 % longer or shorter than those that it began with (Src/signal.c).
- Bluejay (src/Modules/Isrs.asm, Macros.asm, Bluejay.asm) counts each pulse at 24.5 MHz: less than 8 ticks
  with DShot600 are none, 16 ticks (0.653 us, 0.392 bits) are a 1; its oscillator may be 2 % off. A frame ends
  after 64 ticks without a pulse, 1.6 bits. DShot300 has twice as many ticks.
- Controllers send 3/8 and 6/8 of a bit (timers) or 1/3 and 2/3 (ports written thrice a bit).
The limits below are what controllers send, 5 % to either side, and what all of these take: `ZERO` ends at
0.384 for Bluejay's sake. Bits that are not evenly spaced and rests of less than two bits are refused.
DShot150 is BLHeli_S's; AM32 and Bluejay do not know it.

An ESC whose line is silent stops its motor: AM32 half a second after the last frame (Src/main.c, signal
timeout when armed), BLHeli_S and Bluejay 160 ms after it (ten overflows of timer 2 at 16 ms). `SILENT_S` is
the longer: what an aircraft has to live with.

AM32 and Bluejay find speed and rest level out when they start; others are set to one, `Esc.fitted`.

Its answer to a bidirectional frame begins about 30 us after it: 16 bits (12 of the word, 4 of its inverted
checksum), each nibble as five bits (GCR), after a 0 that begins it; a 1 changes the line's level, a bit lasts
4/5 of the frame's. C sends `Esc.answer`; what spoils it can be set beside.

Extended telemetry comes once it was commanded: AM32 (Src/dshot.c, `computeDshotDMA`) and Bluejay
(src/Modules/DShot.asm, `dshot_cmd_check_count`) want command 13 six times in a row while the motor stands,
and answer the next frame with state 0 (0xE00). AM32 then sends each 41st answer a current, about each 200th
a temperature and a voltage; here each 41st is one of what `Esc.tell` was given, in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NoReturn

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.native.library import Native
from neuroflight.toolchain.boards.facts import Pin
from neuroflight.toolchain.contract import EscTold

PROTOCOLS = {150: 150_000, 300: 300_000, 600: 600_000}  # bits a second
TOLERANCE = 0.05  # of a bit's time; of its place among the others
ZERO, ONE = (0.317, 0.384), (0.633, 0.788)  # of a bit, that a pulse may take
GAP_BITS = 2  # least rest between frames
ANSWER_S = 30e-6  # from the end of a frame
SILENT_S = 0.5  # without a frame, then the motor stops
FRAME_BITS = 16
NO_FRAME = 0xFFFFFFFF  # of api.h
NO_ANSWER = 0xFFFF  # of api.h
_BROKEN_OFF = TIME_HZ // 10_000  # a frame that has not gone on for so long [cycles]


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame taken by an ESC."""

    motor: int  # 1..
    cycle: int  # at which the frame's last bit ended
    value: int  # 0..2047
    telemetry: bool
    protocol: int  # 150, 300 or 600
    inverted: bool = False  # bidirectional


@dataclass(frozen=True)
class AnswerFaults:
    """Faults of an ESC's answers, and of the line while they come."""

    delay_s: float = ANSWER_S  # from the frame's end
    clock: float = 0.0  # by which share its bits are too long
    jitter_s: float = 0.0  # of each edge at most, to both sides
    noise: float = 0.0  # share of the program's samples that are wrong
    silence: float = 0.0  # share of frames that it does not answer
    stuck: bool | None = None  # the level that the line has while the program does not drive it


class Esc(Kept):
    """The ESC of one motor. `fail` is called with the error, and must not return."""

    def __init__(self, native: Native, motor: int, pin: Pin, fail: Callable[[str], NoReturn]) -> None:
        """motor: from 0, in order."""
        self._native, self._fail, self.pin = native, fail, pin
        place = ord(pin.port) - ord("A"), pin.number
        self._in_c: Any = native.library.native_esc(native.handle, motor, *place)
        self.motor = motor + 1
        self.fitted: int | None = None  # the protocol that it is set to; None: it takes what comes first
        self.on_frame: Callable[[Frame], None] = lambda frame: None
        self.spoil(AnswerFaults())
        self.silence(forget=True)

    @property
    def protocol(self) -> int | None:
        """150, 300 or 600; None: whatever the first frame says."""
        return int(self._in_c.protocol) or None

    @protocol.setter
    def protocol(self, protocol: int | None) -> None:
        """Set the protocol: C takes the frames whose bits have about the right length."""
        bit = TIME_HZ / PROTOCOLS[protocol] if protocol else 0.0
        self._in_c.protocol = protocol or 0
        self._in_c.shortest, self._in_c.longest = math.ceil(bit * (1 - TOLERANCE)), int(bit * (1 + TOLERANCE))

    @property
    def inverted(self) -> bool:
        """True if its frames are bidirectional ones; False before the first, too."""
        return bool(self._in_c.inverted)

    @property
    def frames(self) -> int:
        return int(self._in_c.frames)

    @property
    def last(self) -> Frame | None:
        """Last frame; None: none since power-up."""
        state = self._in_c
        return None if state.last == NO_FRAME else self.frame(state.last_cycle, state.last)

    @property
    def edges(self) -> tuple[int, ...]:
        """Edges of the last frame that it took [cycle]; empty while another one comes."""
        return () if self._in_c.edge_count else tuple(self._in_c.edges)

    def frame(self, cycle: int, data: int) -> Frame:
        assert self.protocol is not None
        return Frame(self.motor, cycle, data >> 1, bool(data & 1), self.protocol, self.inverted)

    # ---- answers ----

    @property
    def answer(self) -> int | None:
        """Word of 12 bits that answers bidirectional frames from the next one on; None: it stays silent."""
        return None if self._in_c.answer == NO_ANSWER else int(self._in_c.answer)

    @answer.setter
    def answer(self, word: int | None) -> None:
        if word is not None and not 0 <= word < 1 << 12:
            raise ValueError(f"an ESC's answer is {word}, expected 12 bits")
        self._in_c.answer = NO_ANSWER if word is None else word

    @property
    def answers(self) -> int:
        """Answers that it has sent, or begun to."""
        return int(self._in_c.answers)

    @property
    def extended(self) -> bool:
        """True if it was commanded to send extended telemetry."""
        return bool(self._in_c.extended)

    def tell(self, told: Mapping[EscTold, int]) -> None:
        """Let it send these bytes as extended telemetry, once it is commanded to."""
        for kind, byte in told.items():
            if not 0 <= byte < 1 << 8:
                raise ValueError(f"{kind.name}, what an ESC tells, is {byte}, expected 8 bits")
            self._in_c.told[kind] = 2 * (kind + 1) << 8 | byte
        self._in_c.kinds = sum(1 << kind for kind in told)

    def spoil(self, faults: AnswerFaults) -> None:
        """Spoil its answers from the next one on."""
        state, lib = self._in_c, self._native.library
        state.delay, state.jitter = round(faults.delay_s * TIME_HZ), round(faults.jitter_s * TIME_HZ)
        state.bit_factor = 1.0 + faults.clock
        state.noise, state.silence = faults.noise, faults.silence
        state.stuck = {None: lib.STUCK_NOT, False: lib.STUCK_LOW, True: lib.STUCK_HIGH}[faults.stuck]

    # ---- frames ----

    def take(self, edges: Sequence[int], rest: bool) -> None:
        """Decode what C does not: the first frame, or edges of which no frame comes. rest: level before."""
        if len(edges) < 2 * FRAME_BITS:
            self._break_off(len(edges))
        spaces = [after - before for before, after in pairwise(edges[::2])]
        length = sum(spaces) / len(spaces)
        self._validate_rest(edges[0], length, rest)
        protocol = self._find_protocol(length)
        for number, (place, begin) in enumerate(zip(edges[::2], range(FRAME_BITS), strict=True), 1):
            off = place - edges[0] - begin * length
            if abs(off) > TOLERANCE * length:
                self._fail(
                    f"motor {self.motor}: bit {number} begins {_us(abs(off))} too "
                    f"{'late' if off > 0 else 'early'}, expected bits of {_us(length)} each"
                )
        data = self._decode(edges, length, rest)
        self.protocol, self._in_c.inverted = protocol, rest
        self.accept(self.frame(edges[-2] + round(length), data))

    def accept(self, frame: Frame) -> None:
        """Record a frame that was decoded here, and answer it."""
        data = frame.value << 1 | frame.telemetry
        lib, handle = self._native.library, self._native.handle
        lib.native_esc_accept(handle, self.motor - 1, frame.cycle, data)
        self._native.tell_frames()

    def silence(self, forget: bool) -> None:
        """Let the line fall silent, perhaps within a frame; `forget`: the ESC restarts as well."""
        state = self._in_c
        state.edge_count = state.answer_edge_count = 0
        state.rest_since = -TIME_HZ
        if forget:
            self.protocol, state.inverted, state.last = None, False, NO_FRAME
            state.asked, state.extended = 0, False

    def inspect(self, now: int) -> None:
        """Fail if a frame has broken off, which the next edge would show."""
        count = int(self._in_c.edge_count)
        if count > 1 and now - self._in_c.edges[count - 1] > _BROKEN_OFF:
            self._break_off(count)

    def _break_off(self, edges: int) -> NoReturn:
        self._fail(
            f"motor {self.motor}: a frame breaks off in its bit {(edges + 1) // 2}, expected {FRAME_BITS} "
            f"bits"
        )

    def _validate_rest(self, begin: int, length: float, rest: bool) -> None:
        gap, least = begin - self._in_c.rest_since, GAP_BITS * length
        if gap < least:
            self._fail(
                f"motor {self.motor}: {_us(gap)} of rest before a frame, expected {GAP_BITS} bits or more "
                f"({_us(least)})"
            )
        if self.protocol and rest != self.inverted:
            words = ("low", "normal"), ("high", "bidirectional")
            self._fail(
                f"motor {self.motor}: the line rests {words[rest][0]} before a frame, expected "
                f"{words[not rest][0]}: its ESC has begun with {words[not rest][1]} frames"
            )

    def _find_protocol(self, length: float) -> int:
        wanted = [self.protocol] if self.protocol else list(PROTOCOLS)
        for name in wanted:
            if abs(length * PROTOCOLS[name] / TIME_HZ - 1.0) <= TOLERANCE:
                if self.fitted not in (None, name):
                    self._fail(
                        f"motor {self.motor}: DShot{name}, expected DShot{self.fitted}, which its ESC is set "
                        f"to; give both the same (setting motor_protocol)"
                    )
                return name
        nominal = " or ".join(f"{1e6 / PROTOCOLS[n]:.3f} us (DShot{n})" for n in wanted)
        self._fail(
            f"motor {self.motor}: a bit lasts {_us(length)}, expected {nominal} within {TOLERANCE:.0%}"
        )

    def _decode(self, edges: Sequence[int], length: float, inverted: bool) -> int:
        """Return value and telemetry bit."""
        frame = 0
        for number in range(FRAME_BITS):
            width = edges[2 * number + 1] - edges[2 * number]
            bit = width >= ONE[0] * length
            least, most = ONE if bit else ZERO
            if not least * length <= width <= most * length:
                ranges = (f"{_us(low * length)} to {_us(high * length)}" for low, high in (ZERO, ONE))
                self._fail(
                    f"motor {self.motor}: bit {number + 1} is {'low' if inverted else 'high'} for "
                    f"{_us(width)}, expected {' for a 0 or '.join(ranges)} for a 1"
                )
            frame = frame << 1 | bit
        data = frame >> 4
        checksum = (data ^ data >> 4 ^ data >> 8 ^ (15 if inverted else 0)) & 15
        if frame & 15 != checksum:
            kind = "bidirectional frame" if inverted else "frame"
            self._fail(
                f"motor {self.motor}: {kind} 0x{frame:04X} has the checksum {frame & 15:X}, "
                f"expected {checksum:X}"
            )
        return data


def _us(cycles: float) -> str:
    return f"{cycles * 1e6 / TIME_HZ:.3f} us"
