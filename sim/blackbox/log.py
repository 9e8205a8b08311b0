"""A log of a flight as columns of numbers, whoever wrote it.

`list_logs` tells what a file holds without decoding it; `read_log` decodes one log. Columns hold the numbers
that the format has; sim.blackbox.units gives them units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.blackbox.decoding import EVENTS_MAX, Event, Progress, decode
from neuroflight.sim.blackbox.encodings import WORD
from neuroflight.sim.blackbox.firmware import Maker, firmware
from neuroflight.sim.blackbox.headers import LOGS_MAX, Extent, Headers, find_logs, read_bytes, read_headers
from neuroflight.sim.blackbox.transfer import text_transfer
from neuroflight.toolchain.contract import LogEvent
from neuroflight.toolchain.errors import TraceError

Integers = NDArray[np.int64]

GLANCE_BYTES = 1 << 16  # some I frames at least
BOXES = 0xFFFF  # of FLIGHT_MODE's flags: those of Betaflight that we have
PIECE_BYTES = 1 << 20  # of a file, that are looked at together


@dataclass(frozen=True)
class Frames:
    """The numbers of a log's frames that were read, damaged or missing."""

    read: int  # of every kind
    corrupt: int  # places at which a frame was expected and none could be read
    unusable: int  # main frames whose prediction was lost, or whose time or step did not follow
    skipped_bytes: int  # that belong to no frame


@dataclass(frozen=True, eq=False)
class Log:
    """A decoded log of N rows, one a main frame."""

    path: Path
    number: int  # in its file, from 1
    size: int  # bytes, headers included
    headers: Headers
    columns: dict[str, Integers]  # by the field's name, each (N,)
    slow: dict[str, Integers]  # of slow frames, each (K,)
    slow_row: Integers  # (K,) the row from which each slow frame holds; N: it came after the last
    gps: dict[str, Integers]  # of GPS frames, each (G,), with a `time` [us] of its own where the log has one
    events: tuple[Event, ...]
    frames: Frames
    ended: bool  # by its own end, not by the file's
    notes: tuple[str, ...]  # what is wrong with the file, a line each

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    @property
    def where(self) -> str:
        """Its file and number, for messages."""
        return f"{self.path}: log {self.number}"

    @property
    def header(self) -> dict[str, str]:
        """Header lines, name to value."""
        return self.headers.values

    @property
    def maker(self) -> Maker:
        """The firmware that wrote it."""
        return firmware(self.header).maker

    @cached_property
    def time_us(self) -> Integers:
        """Time (N,) [us] of the firmware's clock, with its 32-bit wraps undone.

        Without a logged time it is counted in steps of `looptime`, or of 1 ms if that is missing too.
        """
        if (time := self.columns.get("time")) is not None:
            return _spread(time)
        steps = self.columns.get("loopIteration", np.arange(len(self), dtype=np.int64))
        return steps * max(1, self.headers.integer("looptime", 1000))

    @cached_property
    def t(self) -> Array:
        """Time (N,) [s] since the first row."""
        return (self.time_us - self.time_us[:1]) / 1e6

    @property
    def seconds(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.t[-1]) if len(self) else 0.0

    @cached_property
    def row_us(self) -> float:
        """The usual time between two rows [us], 0 where there are none: the median."""
        return float(np.median(np.diff(self.time_us))) if len(self) > 1 else 0.0

    @property
    def rate_hz(self) -> float:
        """Rows a second where none is missing, 0 where there are too few."""
        return 1e6 / self.row_us if self.row_us else 0.0

    @cached_property
    def stride(self) -> int:
        """Control steps from one row to the next, as most rows are apart; 1 where the log does not tell."""
        steps = self.columns.get("loopIteration")
        if steps is None or len(steps) < 2:
            return 1
        values, counts = np.unique(np.diff(steps), return_counts=True)
        return max(1, int(values[counts.argmax()]))

    @cached_property
    def missing(self) -> Integers:
        """Rows that are missing before each row (N,)."""
        steps = self.columns.get("loopIteration")
        if steps is None or not len(steps):
            return np.zeros(len(self), np.int64)
        apart: Integers = np.diff(steps, prepend=steps[:1] - self.stride)
        return np.maximum(-(-apart // self.stride) - 1, 0)

    @property
    def positions(self) -> int:
        """Rows of GPS frames."""
        return len(next(iter(self.gps.values()), ()))

    @property
    def lost(self) -> int:
        """Rows that are missing between the first and the last."""
        return int(self.missing.sum())

    def matrix(self, name: str, count: int | None = None) -> Integers | None:
        """Return columns name[0], name[1] .. as (N, count), None if one is missing. count None: all."""
        if count is None:
            count = 0
            while f"{name}[{count}]" in self.columns:
                count += 1
        names = [f"{name}[{index}]" for index in range(count)]
        if not names or not all(one in self.columns for one in names):
            return None
        return np.stack([self.columns[one] for one in names], axis=1)

    def held(self, name: str) -> Integers | None:
        """Return a slow field's value in each row (N,), the first value before it was logged; or None."""
        values = self.slow.get(name)
        if values is None or not len(values):
            return None
        index = np.searchsorted(self.slow_row, np.arange(len(self)), side="right") - 1
        return values[np.maximum(index, 0)]


def _spread(time: Integers) -> Integers:
    """Return `time` with rows of the same tick of a coarse clock spread evenly up to the next tick."""
    moves = np.flatnonzero(np.diff(time, prepend=time[:1] - 1))
    if len(moves) == len(time) or len(moves) < 2:
        return time
    told, rows = time[moves], [*moves, len(time)]
    usual = np.median(np.diff(told) / np.diff(moves))
    clock = [*told, told[-1] + usual * (len(time) - moves[-1])]
    return np.asarray(np.interp(np.arange(len(time)), rows, clock), np.int64)


def words(column: Integers) -> NDArray[np.uint32]:
    """Return the 32 bits of each number."""
    return (column % WORD).astype(np.uint32)


def floats(column: Integers) -> Array32:
    """Return numbers that hold the bits of a float32 as such; any shape."""
    return words(column).view(np.float32)


@dataclass(frozen=True)
class Listed:
    """A log of a file, not decoded."""

    number: int  # from 1
    extent: Extent
    headers: Headers

    @property
    def size(self) -> int:
        return self.extent.end - self.extent.start


def list_logs(path: Path, data: bytes | None = None) -> list[Listed]:
    """List the logs of a file. Raises TraceError if there is none, or the file is too large."""
    data = read_bytes(path) if data is None else data
    extents = find_logs(data)
    if not extents:
        found = "is empty" if not data.strip(b"\0\xff") else "holds no log"
        raise TraceError(f"{path}: {found}; expected a Betaflight blackbox log (.BBL, .BFL, .TXT)")
    return [Listed(number, one, read_headers(data, one)) for number, one in enumerate(extents, 1)]


def glance(data: bytes, one: Listed) -> float | None:
    """Estimate the length of a log [s] by its first and last readable frames; None without any."""
    names = [field.name for field in one.headers.fields.get("I", ())]
    if "time" not in names:
        return None
    body = data[one.extent.body : one.extent.end]
    if len(body) <= 2 * GLANCE_BYTES:
        time = decode(body, one.headers).main[:, names.index("time")]
        return float(time[-1] - time[0]) / 1e6 if len(time) else None
    first, last = (decode(part, one.headers).main for part in (body[:GLANCE_BYTES], body[-GLANCE_BYTES:]))
    if not len(first) or not len(last):
        return None
    clock = names.index("time")
    passed = int(last[-1, clock] - first[0, clock]) % WORD
    if "loopIteration" in names and len(first) > 1:  # steps show how often the 32-bit clock wrapped
        step = names.index("loopIteration")
        one_us = (first[-1, clock] - first[0, clock]) / max(1, first[-1, step] - first[0, step])
        expected = (last[-1, step] - first[0, step]) * one_us
        passed += max(0, round((expected - passed) / WORD)) * WORD
    return passed / 1e6


def is_blank(path: Path) -> bool:
    """Return True if a file holds nothing: made for a log to come, or of an erased flash chip."""
    with path.open("rb") as file:
        while piece := file.read(PIECE_BYTES):
            if piece.strip(b"\0\xff"):
                return False
    return True


def choose(path: Path, listed: Sequence[Listed], number: int) -> Listed:
    """Return the log `number`, from 1. Raises TraceError if there is none."""
    if not 1 <= number <= len(listed):
        beyond = " (the most that is looked for)" if len(listed) == LOGS_MAX else ""
        raise TraceError(
            f"{path}: --log {number}, but it holds {len(listed)} log{'s' * (len(listed) > 1)}{beyond}"
        )
    return listed[number - 1]


def read_log(
    path: Path,
    number: int | None = None,
    progress: Progress = lambda _: None,
    lines: Mapping[str, str] | None = None,
) -> Log:
    """Decode a log of the file `path`: log `number`, from 1; None: the last with frames that can be read.

    Only the bytes of that log, and of those behind it that have no such frame, are decoded. lines: of the
    header that the user tells, by name, in place of the file's. Damage is told in the log's notes and counts.
    Raises TraceError where there is no log or nothing of it can be read.
    """
    data = read_bytes(path)
    listed = list_logs(path, data)
    if lines:
        listed = [_told(one, lines) for one in listed]
    reason: TraceError | None = None
    hidden = 0  # logs after the one that is read, without readable frames
    for one in reversed(listed) if number is None else [choose(path, listed, number)]:
        try:
            log = decode_log(path, data, one, progress)
        except TraceError as error:
            reason = reason or error
            hidden += 1
            continue
        if len(log):
            if hidden:
                told = f"{hidden} log{'s' * (hidden > 1)} behind this one cannot be read"
                log = replace(log, notes=(*log.notes, told))
            return log
        why = "; ".join(log.notes) or "it ends before its first frame"
        told = f"log {one.number} of {len(listed)} has no frame that can be read ({why})"
        reason = reason or TraceError(f"{path}: {told}")
        hidden += log.frames.corrupt > 0
    assert reason is not None  # a file of logs has one
    raise reason


def _told(one: Listed, lines: Mapping[str, str]) -> Listed:
    """Return the log with these lines in its header, in place of its own of the same names."""
    values = {**one.headers.values, **lines}
    return replace(one, headers=replace(one.headers, values=values, told=frozenset(lines)))


def decode_log(path: Path, data: bytes, one: Listed, progress: Progress = lambda _: None) -> Log:
    """Decode the log `one` of the file's bytes; it may come out without a row."""
    headers = one.headers
    body = data[one.extent.body : one.extent.end]
    notes = [*headers.notes, *([transfer] if (transfer := text_transfer(body)) else [])]
    if "I" not in headers.fields:
        raise TraceError(
            f"{path}: log {one.number} does not say what its frames hold ("
            f"{'; '.join(notes) or 'no line H Field I name'}); nothing of it can be read"
        )
    found = decode(body, headers, progress)
    lost = "; ".join(f"{name}: {follows}" for name, follows in headers.lost().items())
    notes += [*([f"header lines are lost: {lost}"] if lost else []), *found.notes]
    if found.corrupt:
        notes.append(
            f"damaged at {found.corrupt} place{'s' * (found.corrupt > 1)}: {found.skipped_bytes} bytes and "
            f"{found.dropped} main frame{'s' * (found.dropped != 1)} lost"
        )
    elif found.dropped:
        notes.append(f"{found.dropped} main frame{'s' * (found.dropped > 1)} out of order, left out")
    if found.homeless:
        notes.append(f"{found.homeless} GPS frames before a home, or behind damage, left out")
    if not found.ended and not found.notes:
        notes.append("no end of the log: the power was cut, or the file")
    slow = _columns(headers, "S", found.slow.values)
    return Log(
        path=path,
        number=one.number,
        size=one.size,
        headers=headers,
        columns=_columns(headers, "I", found.main),
        slow=slow,
        slow_row=found.slow.row,
        gps=_columns(headers, "G", found.gps.values),
        events=_with_own_flags(found.events, slow, found.slow.row)
        if firmware(headers.values).maker is Maker.NEUROFLIGHT
        else tuple(found.events),
        frames=Frames(found.frames, found.corrupt, found.dropped, found.skipped_bytes),
        ended=found.ended,
        notes=tuple(notes),
    )


def _with_own_flags(
    events: Sequence[Event], slow: Mapping[str, Integers], rows: Integers
) -> tuple[Event, ...]:
    """Return our log's events with nfFlags in the upper half of FLIGHT_MODE's flags.

    Firmwares up to MSP API 1.46 wrote them so. Later ones tell nfFlags in slow frames alone, one of which is
    there wherever a flag changed.
    """
    modes = [event.values for event in events if event.kind == LogEvent.FLIGHT_MODE]
    if any(flag > BOXES for values in modes for flag in values.values()):
        return tuple(events)
    if not {"flightModeFlags", "nfFlags"} <= slow.keys():
        return tuple(events)
    flags = slow["flightModeFlags"] & BOXES | slow["nfFlags"] << BOXES.bit_length()
    changed = 1 + np.flatnonzero(np.diff(flags))[:EVENTS_MAX]
    told = [
        Event(LogEvent.FLIGHT_MODE, "mode", {"new": int(flags[at]), "old": int(flags[at - 1])}, int(rows[at]))
        for at in changed
    ]
    others = [event for event in events if event.kind != LogEvent.FLIGHT_MODE]
    behind = (LogEvent.DISARM, LogEvent.LOG_END)  # of those of a row
    return tuple(sorted([*others, *told], key=lambda event: (event.row, event.kind in behind, event.kind)))


def _columns(headers: Headers, kind: str, values: Integers) -> dict[str, Integers]:
    return {field.name: values[:, at] for at, field in enumerate(headers.fields.get(kind, ()))}
