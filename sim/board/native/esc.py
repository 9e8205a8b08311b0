"""An ESC whose frames C takes (`callbacks.py`). What it knows is in C, where the next frame is judged."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import c_int64, c_uint32, c_uint64
from typing import NoReturn

from sim.board.devices.esc import Esc, Frame

_NONE = 0xFFFFFFFF


class _State(ctypes.Structure):
    """`struct esc` of native.h."""

    _fields_ = (
        ("rest_since", c_int64),
        *((name, c_uint64) for name in ("frames", "last_cycle")),
        *((name, c_uint32) for name in ("last", "shortest", "longest")),
    )


class HotEsc(Esc):
    """The receiving end of one motor's line, for C and Python."""

    def __init__(self, motor: int, fail: Callable[[str], NoReturn], protocol: int | None = None) -> None:
        self._in_c = _State(last=_NONE)
        self._protocol: int | None = None
        self._hears: Callable[[Frame], None] = lambda frame: None
        self._on_listener: Callable[[], None] = lambda: None
        super().__init__(motor, fail, protocol)

    def adopt(self, place: int, on_listener: Callable[[], None]) -> None:
        """From now on the state is at `place`; `on_listener` runs when somebody wants to hear of frames."""
        ctypes.memmove(place, ctypes.addressof(self._in_c), ctypes.sizeof(_State))
        self._in_c = _State.from_address(place)
        self._on_listener = on_listener

    @property
    def on_frame(self) -> Callable[[Frame], None]:  # type: ignore[override]
        """Hears of every frame."""
        return self._hears

    @on_frame.setter
    def on_frame(self, callback: Callable[[Frame], None]) -> None:
        self._hears = callback
        self._on_listener()

    @property
    def protocol(self) -> int | None:  # type: ignore[override]
        """300 or 600; None: whatever the first bit says."""
        return self._protocol

    @protocol.setter
    def protocol(self, protocol: int | None) -> None:
        self._protocol = protocol
        self._in_c.shortest, self._in_c.longest = self.bit_cycles

    @property
    def frames(self) -> int:  # type: ignore[override]
        """How many there were."""
        return int(self._in_c.frames)

    @frames.setter
    def frames(self, count: int) -> None:
        self._in_c.frames = count

    @property
    def last(self) -> Frame | None:  # type: ignore[override]
        """The last one; None: there was none since power-up."""
        state = self._in_c
        if state.last == _NONE:
            return None
        assert self._protocol is not None
        return Frame(self.motor, state.last_cycle, state.last >> 1, bool(state.last & 1), self._protocol)

    @last.setter
    def last(self, frame: Frame | None) -> None:
        state = self._in_c
        if frame is None:
            state.last = _NONE
        else:
            state.last, state.last_cycle = frame.value << 1 | frame.telemetry, frame.cycle

    @property
    def _rest_since(self) -> int:  # type: ignore[override]
        return int(self._in_c.rest_since)

    @_rest_since.setter
    def _rest_since(self, cycle: int) -> None:
        self._in_c.rest_since = cycle
