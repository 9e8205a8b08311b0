"""Frames of a log to rows of numbers: each field is read by its encoding, its prediction added.

A damaged file is read as far as possible. Frames have neither length nor checksum, so a frame counts as whole
if the letter of a next frame follows it. A wrong bit inside a value is not detected.

Numbers have 32 bits that wrap, in the firmware as here: a motor at 0 behind the prediction 138 is written as
-138, in an unsigned encoding as 4294967158. The header line `signed` says which fields have a sign.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.blackbox import encodings
from neuroflight.sim.blackbox.encodings import (
    FIELDS,
    NOTHING,
    TAG8_4S16,
    TAG8_8SVB,
    WORD,
    Reader,
    signed_of,
    unsigned,
)
from neuroflight.sim.blackbox.headers import DEFAULTS, FieldDefinition, Headers, intervals
from neuroflight.toolchain.contract import LOG_FRAME_BYTES_MAX, LogEvent

Progress = Callable[[float], None]  # is given what part is done, 0..1
Array = NDArray[np.int64]

VALUES_MAX = 64_000_000  # that are kept of a log, 512 MB: 12 minutes of everything at 1 kHz
FRAMES_MAX = 8_000_000
SLOW_MAX, EVENTS_MAX = 500_000, 100_000
FAILURES_MAX = 100_000  # tries to read a frame where none is, about 20 s
CHUNK = 4096  # rows that become an array at a time
CHAIN = 3  # consecutive frames needed to accept bytes after damage
TIME_JUMP_US = 10_000_000  # forward, between two frames; more is damage
STEP_JUMP = 50_000  # control steps, likewise
_FRAME_BYTES_MAX = 2 * LOG_FRAME_BYTES_MAX  # other firmwares write longer frames than their tools accept
_OWN_ZEROS = 16  # bytes
_LETTERS = re.compile(rb"[EGHIPS]")
_END = b"End of log"
_MAIN_TIME = 10  # a predictor
# Predictions of a field: a constant, the frames before, motor[0] of this one, the count of steps, the home's
# position, the time of the last main frame. The format has several constants.
_CONSTANT, _PREVIOUS, _LINE, _AVERAGE, _MOTOR, _STEPS, _HOME_0, _HOME_1, _TIME = range(9)
_RATES = frozenset(f"setpoint[{axis}]" for axis in range(3))
HALF = 1 << 16  # numbers of 16 bits
_KINDS = {1: _PREVIOUS, 2: _LINE, 3: _AVERAGE, 5: _MOTOR, 6: _STEPS, 7: _HOME_0, _MAIN_TIME: _TIME}

Prediction = tuple[int, int, int, int]  # kind, constant, the least number of the field, and how many it has
FramePlan = tuple[list[tuple[str, Reader, int]], list[Prediction]]  # groups of fields, and each field


@dataclass(frozen=True)
class Event:
    """An event of the log between two rows."""

    kind: int  # see LogEvent; others of other firmwares
    name: str
    values: dict[str, int]  # what it tells: time, reason, step, flags
    row: int  # of the frame behind it


@dataclass
class Aside:
    """Rows of another kind of frame, K of them, that lie between main frames."""

    values: Array  # (K, S)
    row: Array  # (K,) of the main frame behind each


@dataclass
class Decoded:
    """The content of a log's frames; arrays have a row each frame."""

    main: Array  # (N, F)
    slow: Aside
    gps: Aside
    events: list[Event]
    frames: int = 0  # of every kind, that were read
    corrupt: int = 0  # places where a frame was expected and none could be read
    dropped: int = 0  # main frames that could not be used, as frames that predict them were lost
    homeless: int = 0  # GPS frames, likewise
    skipped_bytes: int = 0  # that belong to no frame
    ended: bool = False  # by the event LOG_END
    notes: list[str] = field(default_factory=list)


class _DamageError(Exception):
    """No frame stands here."""


def decode(data: bytes, headers: Headers, progress: Progress = lambda _: None) -> Decoded:
    """Decode the frames in `data`, which follows the header lines. The result reports damage."""
    return _Decoder(data, headers).run(progress)


def field_bytes(data: bytes, headers: Headers) -> dict[str, int]:
    """Return the bytes that each field takes in the frames of `data`; a group counts for its first field."""
    decoder = _Decoder(data, headers)
    decoder.weights = {}
    decoder.run(lambda _: None)
    return decoder.weights


class _Decoder:
    """A decoder of one log from its first byte to its last."""

    def __init__(self, data: bytes, headers: Headers) -> None:
        self.weights: dict[str, int] | None = None  # bytes that each field took; None: not counted
        self._data = data
        self._blank = len(data.rstrip(b"\0\xff"))  # start of the empty rest of a card's file
        self._intra, self._logged, self._of = intervals(headers)
        self._plans = {ord(kind): _plan(fields, headers) for kind, fields in headers.fields.items()}
        names = [one.name for one in headers.fields["I"]]
        self._step = names.index("loopIteration") if "loopIteration" in names else None
        self._time = names.index("time") if "time" in names else None
        self._motor = names.index("motor[0]") if "motor[0]" in names else 0
        self._names = len(names)
        gps = headers.fields.get("G", ())
        self._needs_home = any(one.predictor == 7 for one in gps)
        self._gps_time = next((at for at, one in enumerate(gps) if one.name == "time"), None)
        self._nothing = [0] * max(self._names, *(len(plan[1]) for plan in self._plans.values()))
        self._rows: list[list[int]] = []
        self._chunks: list[Array] = []
        self._count = 0
        self._slow: list[list[int]] = []
        self._slow_rows: list[int] = []
        self._gps: list[list[int]] = []
        self._gps_rows: list[int] = []
        self._home: list[int] | None = None
        self._usable = False  # whether the frames that P frames are predicted from are known
        self._last: list[int] | None = None  # main frame
        self._before: list[int] = self._nothing  # the last and the one before it, of the next frame
        self._skips: dict[int, int] = {}  # unlogged steps after each step, by its place in the interval
        self._rejected: list[int] | None = None  # I frame whose time or step did not follow
        self._jumped = False  # LOGGING_RESUME was told: any later time follows
        none = Aside(np.empty((0, 0), np.int64), np.empty(0, np.int64))
        self._result = Decoded(none.values, none, none, [])
        self._widths = {kind: len(headers.fields.get(kind, ())) for kind in "SG"}

    def run(self, progress: Progress) -> Decoded:
        data, result = self._data, self._result
        size, at, failures, reported = len(data), 0, 0, 0
        synchronous, good = True, 0  # where the last frame that was read ends
        while at < size and not result.ended:
            if result.frames - reported >= CHUNK:
                reported = result.frames
                progress(at / size)
            try:
                if not synchronous and not self._chain(at):
                    raise _DamageError
                at = good = self._take(at)
                synchronous = True
                if reason := self._full():
                    result.notes.append(f"{reason}; what follows byte {at} of {size} is not read")
                    break
                continue
            except _DamageError:
                pass
            if at >= self._blank:
                break
            if synchronous:
                result.corrupt += 1
                synchronous = self._usable = False
            failures += 1
            if failures >= FAILURES_MAX:
                result.notes.append(f"too much damage; what follows byte {at} of {size} is not read")
                break
            found = _LETTERS.search(data, at + 1)
            further = found.start() if found else size
            result.skipped_bytes += further - at
            at = further
        if not synchronous and good and at - good <= _FRAME_BYTES_MAX:  # the last frame is cut off: no damage
            result.corrupt -= 1
            result.skipped_bytes -= at - good
        self._finish()
        progress(1.0)
        return result

    def _full(self) -> str:
        """Return why decoding stops; "" while there is room."""
        if self._count * self._names >= VALUES_MAX:
            return f"{self._count} rows of {self._names} fields are the most that is kept"
        if self._result.frames >= FRAMES_MAX:
            return f"more than {FRAMES_MAX} frames"
        if max(len(self._slow), len(self._gps)) >= SLOW_MAX or len(self._result.events) >= EVENTS_MAX:
            return "more slow frames, GPS frames or events than any flight has"
        return ""

    def _take(self, at: int) -> int:
        """Read the frame at `at` and keep it; returns where the next begins. Raises _DamageError."""
        letter = self._data[at]
        if letter == 0x45:
            event, end = self._event(at)
            if event.kind == LogEvent.LOG_END:
                self._result.ended = True
            self._jumped |= event.kind == LogEvent.LOGGING_RESUME
            self._result.events.append(event)
        else:
            values, end = self._values(at)
            if letter in b"IP":
                self._keep(letter, values)
            elif letter == 0x53:
                self._slow.append(values)
                self._slow_rows.append(self._count)
            elif letter == 0x48:
                self._home = values
            elif (self._home is None and self._needs_home) or (self._last and not self._usable):
                self._result.homeless += 1
            else:
                self._gps.append(values)
                self._gps_rows.append(self._count)
        self._result.frames += 1
        return end

    def _chain(self, at: int) -> bool:
        """Return True if CHAIN frames follow one another from `at` on."""
        for _ in range(CHAIN):
            try:
                _, at = self._event(at) if self._data[at] == 0x45 else self._values(at)
            except _DamageError:
                return False
            if at >= len(self._data):
                break
        return True

    def _values(self, at: int) -> tuple[list[int], int]:
        """Read the values of the frame at `at`, and its end: before a frame's letter or at the data's end."""
        plan = self._plans.get(self._data[at])
        if plan is None:
            raise _DamageError
        data, weights, end = self._data, self.weights, at + 1
        groups, predictions = plan
        last = self._last if self._usable and self._last is not None else self._nothing
        before = self._before if self._usable else self._nothing
        values: list[int] = []
        try:
            for name, read, count in groups:
                start = end
                raws, end = read(data, end, count)
                if weights is not None:
                    weights[name] = weights.get(name, 0) + end - start
                for value in raws:
                    index = len(values)
                    kind, constant, least, size = predictions[index]
                    if kind == _PREVIOUS:
                        value += last[index]
                    elif kind == _CONSTANT:
                        value += constant
                    elif kind == _AVERAGE:
                        both = last[index] + before[index]
                        value += both >> 1 if both >= 0 else -(-both >> 1)  # towards 0, as C divides
                    elif kind == _LINE:
                        value += 2 * last[index] - before[index]
                    else:
                        value += self._prediction(kind, values, last[index])
                    if not 0 <= value - least < size:
                        value = (value - least) % size + least
                    values.append(value)
        except (IndexError, ValueError) as error:
            raise _DamageError from error
        if end - at > _FRAME_BYTES_MAX or len(values) != len(predictions) or not self._ends(end):
            raise _DamageError
        return values, end

    def _prediction(self, kind: int, values: Sequence[int], last: int) -> int:
        """Return a less common prediction of the field that follows `values`; last: its previous value."""
        if kind == _MOTOR:
            return values[self._motor]
        if kind == _STEPS:
            return last + 1 + self._skipped(last)
        if kind == _TIME:
            return 0 if self._last is None or self._time is None else self._last[self._time]
        return 0 if self._home is None else self._home[kind - _HOME_0]

    def _skipped(self, step: int) -> int:
        """Count the steps between `step` and the next one that is logged."""
        if self._last is None or self._of == self._logged:
            return 0
        place = step % self._intra
        if place not in self._skips:
            after = place + 1
            while (after % self._intra + self._logged - 1) % self._of >= self._logged:
                after += 1
            self._skips[place] = after - place - 1
        return self._skips[place]

    def _ends(self, end: int) -> bool:
        """Return True if a frame may end there: before another one, or where the log is cut off."""
        if end < len(self._data) and self._data[end] in b"EGHIPS":
            return True
        # Zeros behind a frame that was cut off would complete it wrongly; a few may be its own.
        return end == self._blank or (end == len(self._data) and end - self._blank < _OWN_ZEROS)

    def _event(self, at: int) -> tuple[Event, int]:
        """Read the event at `at`; return it and its end. Raises _DamageError."""
        try:
            kind = self._data[at + 1]
            if kind == LogEvent.LOG_END:
                end = at + 2 + len(_END)
                if self._data[at + 2 : end] != _END:
                    raise _DamageError
                return Event(kind, "end", {}, self._count), end
            name, values, end = _event_values(kind, self._data, at + 2)
        except (IndexError, ValueError) as error:
            raise _DamageError from error
        if not self._ends(end):
            raise _DamageError
        return Event(kind, name, values, self._count), end

    def _keep(self, letter: int, values: list[int]) -> None:
        """Keep a main frame if what it is predicted from is there and its time and step follow the last."""
        intra = letter == 0x49
        if not intra and not self._usable:
            self._result.dropped += 1
            return
        follows = self._follows(self._last, values)
        if intra and not follows:
            # Two consecutive frames that fit each other are right, so the ones before them were wrong.
            follows = self._rejected is not None and self._follows(self._rejected, values)
            self._rejected = values
        if not follows:
            self._result.dropped += 1
            self._usable = False
            return
        self._rejected = None
        self._jumped = False
        self._usable = True
        self._before = values if intra or self._last is None else self._last
        self._last = values
        self._rows.append(values)
        self._count += 1
        if len(self._rows) == CHUNK:
            self._flush()

    def _follows(self, last: list[int] | None, values: list[int]) -> bool:
        """Return True if time and step of a main frame may come after those of another."""
        if last is None:
            return True
        if self._step is not None:
            steps = values[self._step] - last[self._step]
            if steps <= 0 or (steps > STEP_JUMP and not self._jumped):
                return False
        if self._time is not None:
            elapsed = (values[self._time] - last[self._time]) % WORD
            if self._step is None and elapsed == 0:
                return False
            return elapsed < (WORD // 2 if self._jumped else TIME_JUMP_US)
        return True

    def _flush(self) -> None:
        if self._rows:
            self._chunks.append(_array(self._rows, self._names).T)
            self._rows = []

    def _finish(self) -> None:
        self._flush()
        result = self._result
        # Column by column, so that each of them is a view of this one array.
        result.main = (np.concatenate(self._chunks, axis=1) if self._chunks else _array([], self._names).T).T
        self._chunks = []
        result.slow = Aside(_array(self._slow, self._widths["S"]), np.array(self._slow_rows, np.int64))
        result.gps = Aside(_array(self._gps, self._widths["G"]), np.array(self._gps_rows, np.int64))
        if self._step is not None and len(result.main):
            self._drop_wrong(result.main[:, self._step])
        if self._time is not None and len(result.main):
            self._continue_time(result.main[:, self._time])

    def _continue_time(self, time: Array) -> None:
        """Undo the wraps of the 32-bit clock, every 71.6 minutes, in `time` (N,), events and GPS frames."""
        time[1:] = time[0] + np.cumsum(np.diff(time) % WORD)

        def near(row: int, told: int) -> int:
            base = int(time[min(row, len(time) - 1)])
            return base + (told - base + WORD // 2) % WORD - WORD // 2

        events = self._result.events
        for at, event in enumerate(events):
            if "time" in event.values:
                then = near(event.row, event.values["time"])
                events[at] = replace(event, values={**event.values, "time": then})
        if self._gps_time is not None:
            gps = self._result.gps
            for index, row in enumerate(gps.row.tolist()):
                gps.values[index, self._gps_time] = near(row, int(gps.values[index, self._gps_time]))

    def _drop_wrong(self, steps: Array) -> None:
        """Drop rows whose step a later row does not exceed: they were damaged, and the log went on before."""
        later = np.minimum.accumulate(steps[::-1])[::-1]
        kept = np.append(steps[:-1] < later[1:], True)
        if kept.all():
            return
        result = self._result
        before = np.concatenate(([0], np.cumsum(kept)))  # rows that are kept before each
        result.dropped += int((~kept).sum())
        result.main = result.main[kept]
        for aside in (result.slow, result.gps):
            aside.row = before[aside.row]
        result.events = [replace(event, row=int(before[event.row])) for event in result.events]


def _array(rows: list[list[int]], width: int) -> Array:
    return np.array(rows, np.int64).reshape(len(rows), width)


def _plan(fields: Sequence[FieldDefinition], headers: Headers) -> FramePlan:
    """Return how frames of these fields are read and predicted."""
    groups: list[tuple[str, Reader, int]] = []
    at = 0
    while at < len(fields):
        one = fields[at]
        encoding = NOTHING if one.predictor == 6 else one.encoding  # steps are counted, not stored
        count = min(FIELDS.get(encoding, 1), len(fields) - at)
        if encoding == TAG8_8SVB:  # a group ends where another encoding begins; others have their number
            alike = [other.encoding == encoding for other in fields[at : at + count]]
            count = alike.index(False) if False in alike else count
        read = encodings.READERS[encoding]
        if encoding == TAG8_4S16 and headers.integer("Data version", DEFAULTS["Data version"]) < 2:
            read = encodings.read_tag8_4s16_1
        groups.append((one.name, read, count))
        at += count
    constants = {
        4: headers.integer("minthrottle", DEFAULTS["minthrottle"]),
        8: 1500,
        9: headers.integer("vbatref", DEFAULTS["vbatref"]),
    }
    # Before motorOutput existed, motors were predicted by minthrottle.
    constants[11] = (headers.integers("motorOutput") or [constants[4]])[0]
    predictions: list[Prediction] = []
    for index, one in enumerate(fields):
        kind = _KINDS.get(one.predictor, _CONSTANT)
        if kind == _HOME_0 and index and fields[index - 1].predictor == 7 and predictions[-1][0] == _HOME_0:
            kind = _HOME_1
        # Betaflight's setpoint has 16 bits, so has what is added: a reversal of 3277 deg/s in tenths wraps.
        half = one.encoding == TAG8_4S16 and kind == _PREVIOUS and one.signed and one.name in _RATES
        size = HALF if half else WORD
        least = -(size // 2) if one.signed else 0
        predictions.append((kind, constants.get(one.predictor, 0), least, size))
    return groups, predictions


def _event_values(kind: int, data: bytes, at: int) -> tuple[str, dict[str, int], int]:
    """Read name, content and end of an event `kind`. Raises ValueError for an unknown kind."""
    if kind not in _EVENTS:
        raise ValueError("no such event")
    name, parts = _EVENTS[kind]
    values: dict[str, int] = {}
    if kind == _ADJUSTMENT:
        function = data[at]
        parts = (("float_bits", 4),) if function & 0x80 else (("value", _SIGNED),)
        values["function"], at = function & 0x7F, at + 1
    for part, size in parts:
        if size > 0:
            if at + size > len(data):
                raise IndexError
            values[part], at = int.from_bytes(data[at : at + size], "little"), at + size
        else:
            word, at = unsigned(data, at)
            values[part] = signed_of(word) if size == _SIGNED else word
    return name, values, at


_ADJUSTMENT = 13
_VARIABLE, _SIGNED = 0, -1  # in place of a size in bytes
_EVENTS: dict[int, tuple[str, tuple[tuple[str, int], ...]]] = {
    LogEvent.SYNC_BEEP: ("arming", (("time", _VARIABLE),)),
    # Cleanflight's before 2016, as the Explorer reads them.
    10: ("autotune begins", (("phase", 1), ("cycle", 1), ("p", 1), ("i", 1), ("d", 1))),
    11: ("autotune", (("overshot", 1), ("p", 1), ("i", 1), ("d", 1))),
    12: ("autotune targets", (("angle", 2), ("target", 1), ("peak", 1), ("first", 2), ("second", 2))),
    _ADJUSTMENT: ("adjustment", ()),
    LogEvent.LOGGING_RESUME: ("resumed", (("step", _VARIABLE), ("time", _VARIABLE))),
    LogEvent.DISARM: ("disarming", (("reason", _VARIABLE),)),
    20: ("gtune", (("axis", 1), ("gyro", _SIGNED), ("p", 2))),  # likewise
    LogEvent.FLIGHT_MODE: ("mode", (("new", _VARIABLE), ("old", _VARIABLE))),
    40: ("imu failure", (("code", _VARIABLE),)),  # INAV's
    50: ("governor", (("state", _VARIABLE),)),  # Rotorflight's, with those behind it
    51: ("rescue", (("state", _VARIABLE),)),
    52: ("airborne", (("state", _VARIABLE),)),
}
