"""Frames of a log to rows of numbers, by orangebox's decoders and predictors.

orangebox knows how each field is encoded and predicted. How frames are found is done here, since a file may
be damaged: orangebox's own loop ends in exceptions, goes on with predictions from a frame that was lost, and
never ends on some headers. Two of its habits are met here: it takes the count of the last group of fields
in a frame, of encoding TAG8_8SVB, one too low, unless another field follows (`_Context`); and it does not
know every event. The format has no checksum: a wrong bit inside a value shows nowhere.
"""

from __future__ import annotations

import operator
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.blackbox.headers import INTERVAL_MAX, Headers
from toolchain.contract import LOG_FRAME_BYTES_MAX, LogEvent

Progress = Callable[[float], None]  # is given what part is done, 0..1
Array = NDArray[np.int64]

VALUES_MAX = 64_000_000  # that are kept of a log, 512 MB: 12 minutes of everything at 1 kHz
FRAMES_MAX = 8_000_000
SLOW_MAX, EVENTS_MAX = 500_000, 100_000
FAILURES_MAX = 100_000  # tries to read a frame where none is, about 20 s
CHUNK = 4096  # rows that become an array at a time
CHAIN = 3  # frames one behind the other, from which on bytes are believed after damage
TIME_JUMP_US = 10_000_000  # forward, between two frames; more is damage
STEP_JUMP = 50_000  # control steps, likewise
WORD = 1 << 32
_FRAME_BYTES_MAX = 2 * LOG_FRAME_BYTES_MAX  # others write longer ones than their tools take
_OWN_ZEROS = 16  # bytes
_LETTERS = re.compile(rb"[EGHIPS]")
_END = b"End of log"
_DAMAGE = (IndexError, KeyError, ValueError, TypeError, OverflowError, struct.error, StopIteration)


@dataclass(frozen=True)
class Event:
    """Something that happened, told between two rows."""

    kind: int  # see LogEvent; others of other firmwares
    name: str
    values: dict[str, int]  # what it tells: time, reason, step, flags
    row: int  # of the frame behind it


@dataclass
class Decoded:
    """What the frames of a log hold; arrays have a row each frame."""

    main: Array  # (N, F)
    slow: Array  # (K, S)
    slow_row: Array  # (K,) the row that each slow frame belongs to
    events: list[Event]
    frames: int = 0  # of every kind, that were read
    corrupt: int = 0  # places where a frame was expected and none could be read
    dropped: int = 0  # main frames that could not be used: what they are predicted from was lost
    skipped_bytes: int = 0  # that belong to no frame
    ended: bool = False  # by the event LOG_END
    notes: list[str] = field(default_factory=list)


class _DamageError(Exception):
    """No frame stands here."""


def decode(data: bytes, headers: Headers, progress: Progress = lambda _: None) -> Decoded:
    """Decode the frames in `data`, what follows the header lines. Damage is told in the result, not raised.

    Raises ModuleNotFoundError where orangebox is not installed.
    """
    return _Decoder(data, headers).run(progress)


class _Decoder:
    """Reads one log from its first byte to its last."""

    def __init__(self, data: bytes, headers: Headers) -> None:
        from orangebox.types import Frame, FrameType

        self._data = data
        self._bytes: Iterator[int] = iter(data)
        self._blank = len(data.rstrip(b"\0\xff"))  # from here on it is the empty rest of a card's file
        self._frame_type, self._frame = FrameType, Frame
        self._context, self._definitions = _context(headers)
        names = [definition.name for definition in headers.fields["I"]]
        self._step = names.index("loopIteration") if "loopIteration" in names else None
        self._time = names.index("time") if "time" in names else None
        self._names = len(names)
        self._slow_names = len(headers.fields.get("S", ()))
        self._rows: list[list[int]] = []
        self._chunks: list[Array] = []
        self._count = 0
        self._slow: list[list[int]] = []
        self._slow_rows: list[int] = []
        self._usable = False  # whether what P frames are predicted from is there
        self._last: list[int] | None = None  # main frame
        self._rejected: list[int] | None = None  # I frame whose time or step did not follow
        self._jumped = False  # LOGGING_RESUME was told: any later time follows
        self._result = Decoded(
            np.empty((0, 0), np.int64), np.empty((0, 0), np.int64), np.empty(0, np.int64), []
        )

    def run(self, progress: Progress) -> Decoded:
        data, result = self._data, self._result
        size, at, failures, reported = len(data), 0, 0, 0
        synchronous = True
        while at < size and not result.ended:
            if result.frames - reported >= CHUNK:
                reported = result.frames
                progress(at / size)
            try:
                if not synchronous and not self._chain(at):
                    raise _DamageError
                at = self._take(at)
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
        self._finish()
        progress(1.0)
        return result

    def _full(self) -> str:
        """Why no more is read; "" while there is room."""
        if self._count * self._names >= VALUES_MAX:
            return f"{self._count} rows of {self._names} fields are the most that is kept"
        if self._result.frames >= FRAMES_MAX:
            return f"more than {FRAMES_MAX} frames"
        if len(self._slow) >= SLOW_MAX or len(self._result.events) >= EVENTS_MAX:
            return "more slow frames or events than any flight has"
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
                self._context.add_frame(self._frame(self._frame_type.GPS_HOME, values))
            else:
                self._context.add_frame(self._frame(self._frame_type.GPS, values))
        self._result.frames += 1
        return end

    def _chain(self, at: int) -> bool:
        """Whether CHAIN frames stand one behind the other from `at` on."""
        for _ in range(CHAIN):
            try:
                _, at = self._event(at) if self._data[at] == 0x45 else self._values(at)
            except _DamageError:
                return False
            if at >= len(self._data):
                break
        return True

    def _values(self, at: int) -> tuple[list[int], int]:
        """Values of the frame at `at`, and where it ends: before a frame's letter or the end of the data."""
        fields = self._definitions.get(self._data[at])
        if fields is None:
            raise _DamageError
        context, data, source = self._context, self._data, self._bytes
        kind, definitions, count = fields
        source.__setstate__(at + 1)  # type: ignore[attr-defined]
        context.frame_type = kind
        context.field_index = 0
        values: list[int] = []
        context.current_frame = values
        try:
            while context.field_index < count:
                definition = definitions[context.field_index]
                raw = definition.decoderfun(source, context)
                if isinstance(raw, tuple):
                    if not raw:
                        raise _DamageError
                    for one in raw:
                        values.append(definitions[context.field_index].predictorfun(one, context))
                        context.field_index += 1
                else:
                    values.append(definition.predictorfun(raw, context))
                    context.field_index += 1
        except _DAMAGE as error:
            self._bytes = iter(data)  # one that has ended stays so
            raise _DamageError from error
        end = len(data) - operator.length_hint(source)
        if end - at > _FRAME_BYTES_MAX or len(values) != count:
            raise _DamageError
        if not self._ends(end):
            raise _DamageError
        return values, end

    def _ends(self, end: int) -> bool:
        """Whether a frame may end there: before another one, or where the log is cut off."""
        if end < len(self._data) and self._data[end] in b"EGHIPS":
            return True
        # Zeros behind a frame that was cut off would complete it wrongly; a few may be its own.
        return end == self._blank or (end == len(self._data) and end - self._blank < _OWN_ZEROS)

    def _event(self, at: int) -> tuple[Event, int]:
        """The event at `at`, and where it ends. Raises _DamageError."""
        source = self._bytes
        source.__setstate__(at + 1)  # type: ignore[attr-defined]
        data = self._data
        try:
            kind = next(source)
            name, values = _event_values(kind, source)
            if kind == LogEvent.LOG_END:
                if data[at + 2 : at + 2 + len(_END)] != _END:
                    raise _DamageError
                return Event(kind, name, {}, self._count), at + 2 + len(_END)
        except StopIteration as error:
            self._bytes = iter(data)
            raise _DamageError from error
        end = len(data) - operator.length_hint(source)
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
            # Two that follow each other are right, and what was before them wrong.
            follows = self._rejected is not None and self._follows(self._rejected, values)
            self._rejected = values
        if not follows:
            self._result.dropped += 1
            self._usable = False
            return
        self._rejected = None
        self._jumped = False
        self._usable = True
        self._last = values
        context = self._context
        kind = self._frame_type.INTRA if intra else self._frame_type.INTER
        context.add_frame(self._frame(kind, values))
        if self._step is not None:
            context.last_iter = values[self._step]
        self._rows.append(values)
        self._count += 1
        if len(self._rows) == CHUNK:
            self._flush()

    def _follows(self, last: list[int] | None, values: list[int]) -> bool:
        """Whether time and step of a main frame may come after those of another."""
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
        result.slow = _array(self._slow, self._slow_names)
        result.slow_row = np.array(self._slow_rows, np.int64)
        if self._step is not None and len(result.main):
            self._drop_wrong(result.main[:, self._step])
        if self._time is not None and len(result.main):
            self._continue_time(result.main[:, self._time])

    def _continue_time(self, time: Array) -> None:
        """Continue the clock's 32 bits, which begin anew every 71.6 minutes, in `time` (N,) and in events.

        Inter frames run on beyond 2^32 us, since they are predicted; the next intra frame has 32 bits again.
        """
        time %= WORD
        time[1:] = time[0] + np.cumsum(np.diff(time) % WORD)
        events = self._result.events
        for at, event in enumerate(events):
            if "time" in event.values:
                near = int(time[min(event.row, len(time) - 1)])
                away = (event.values["time"] - near + WORD // 2) % WORD - WORD // 2
                events[at] = replace(event, values={**event.values, "time": near + away})

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
        result.slow_row = before[result.slow_row]
        result.events = [replace(event, row=int(before[event.row])) for event in result.events]


def _array(rows: list[list[int]], width: int) -> Array:
    """Rows as an array (N, width); numbers beyond 64 bits, which only damage has, keep their low 32."""
    try:
        return np.array(rows, np.int64).reshape(len(rows), width)
    except OverflowError:
        return np.array([[value % WORD for value in row] for row in rows], np.int64).reshape(-1, width)


def _context(headers: Headers) -> tuple[Any, dict[int, tuple[Any, list[Any], int]]]:
    """orangebox's context, and by a frame's letter its kind, its fields and their number."""
    from orangebox.context import Context
    from orangebox.decoders import decoder_map
    from orangebox.predictors import predictor_map
    from orangebox.types import FieldDef, FrameType

    version = headers.integer("Data version", 2)
    known: dict[Any, list[Any]] = {}
    for letter, fields in headers.fields.items():
        kind = FrameType(letter)
        known[kind] = []
        for one in fields:
            predictor = 256 if one.name == "GPS_coord[1]" and one.predictor == 7 else one.predictor
            decoder = decoder_map[one.encoding]
            if one.encoding == 8:  # this one has two versions, and is asked for the right one
                decoder = decoder(max(version, 2))
            known[kind].append(
                FieldDef(kind, one.name, 0, one.predictor, one.encoding, decoder, predictor_map[predictor])
            )
    context = Context(_numbers(headers, version), known)
    definitions = {}
    for kind, described in known.items():
        count = len(described)
        definitions[ord(kind.value)] = (kind, described, count)
        # Its group decoder asks for the encoding of the next eight fields, and takes the last group's count
        # one too low when there is none behind it.
        context.field_defs[kind] = described + [FieldDef(kind, None, 0, 0, -1)] * 8
        context.field_def_counts[kind] = count + 8
    return context, definitions


def _numbers(headers: Headers, version: int) -> dict[str, Any]:
    """The headers that predictors use, as numbers within limits: with others they would never end."""
    intra = headers.integer("I interval", 1)
    parts = re.fullmatch(r"\s*(?:([0-9]{1,6})\s*/)?\s*([0-9]{1,6})\s*", headers.values.get("P interval", "1"))
    numerator, denominator = (int(parts[1] or 1), int(parts[2])) if parts else (1, 1)
    if not 1 <= numerator <= denominator <= INTERVAL_MAX:
        numerator = denominator = 1
    output = headers.integers("motorOutput") or [0]
    return {
        "Data version": version,
        "I interval": intra if 1 <= intra <= INTERVAL_MAX else 1,
        "P interval": f"{numerator}/{denominator}",
        "minthrottle": headers.integer("minthrottle", 0),
        "vbatref": headers.integer("vbatref", 0),
        "motorOutput": output,
    }


def _event_values(kind: int, source: Iterator[int]) -> tuple[str, dict[str, int]]:
    """Name and content of an event of number `kind`. Raises _DamageError for one that is not known."""
    if kind not in _EVENTS:
        raise _DamageError
    name, names = _EVENTS[kind]
    if kind == _ADJUSTMENT:
        function = next(source)
        if function & 0x80:
            word = bytes(next(source) for _ in range(4))
            return name, {"function": function & 0x7F, "float_bits": int.from_bytes(word, "little")}
        value = _unsigned(source)
        return name, {"function": function, "value": (value >> 1) ^ -(value & 1)}
    return name, {one: _unsigned(source) for one in names}


def _unsigned(source: Iterator[int]) -> int:
    """An integer of up to five bytes, 7 bits each, the lowest first."""
    result = 0
    for shift in range(0, 35, 7):
        byte = next(source)
        result |= (byte & 0x7F) << shift
        if byte < 0x80:
            return result % WORD
    raise _DamageError


_ADJUSTMENT = 13
_EVENTS: dict[int, tuple[str, tuple[str, ...]]] = {
    LogEvent.SYNC_BEEP: ("arming", ("time",)),
    _ADJUSTMENT: ("adjustment", ()),
    LogEvent.LOGGING_RESUME: ("resumed", ("step", "time")),
    LogEvent.DISARM: ("disarming", ("reason",)),
    LogEvent.FLIGHT_MODE: ("mode", ("new", "old")),
    40: ("imu failure", ("code",)),  # INAV's
    LogEvent.LOG_END: ("end", ()),
}


def field_bytes(data: bytes, headers: Headers) -> dict[str, int]:
    """Bytes that each field takes in the frames of `data`, by name; those of a group are its first's."""
    decoder = _Decoder(data, headers)
    found: dict[str, int] = {}
    for _, definitions, _ in decoder._definitions.values():
        for one in definitions:
            one.decoderfun = _weighed(one.name, one.decoderfun, found)
    decoder.run(lambda _: None)
    return found


def _weighed(name: str, decode: Callable[..., Any], found: dict[str, int]) -> Callable[..., Any]:
    """`decode`, which adds to `found` the bytes that it takes."""

    def weigh(source: Iterator[int], context: Any) -> Any:  # noqa: ANN401 - orangebox's
        before = operator.length_hint(source)
        value = decode(source, context)
        found[name] = found.get(name, 0) + before - operator.length_hint(source)
        return value

    return weigh
