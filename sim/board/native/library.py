"""The busy peripherals' C: one `Native` a board, made with its engine and before its devices.

C moves registers, data and time. A `NativeDevice` is the Python side of one peripheral: C asks it to validate
a set-up that it has not seen yet, and it raises an error for what is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping
from pathlib import Path
from typing import Any, Protocol

from neuroflight.sim.board.core.context import Kept
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.core.library import load_library
from neuroflight.sim.board.registers.bus import Block, Device, Register, Registers, load_table
from neuroflight.sim.compiled import Library

C = Path(__file__).parent / "c"

# What a device answers: an error's message with {name} of the device and {a}, {b} of the query, or a function
# that raises an error for what is wrong.
Query = str | Callable[[int, int], object]


def native_library() -> Library:
    """Load the engine with the busy peripherals. Raises BuildError."""
    return load_library(C)


class Driver(Protocol):
    """A peripheral in Python that moves data by DMA."""

    def sync(self) -> None:
        """Move what has been moved up to now."""

    def dma_changed(self) -> None:
        """Handle that a stream for one of its requests was enabled or disabled."""


class Native(Kept):
    """The C side of one board's peripherals. Devices and what hangs on them set the callbacks."""

    def __init__(self, engine: Engine) -> None:
        """engine: one made with `native_library`."""
        self.engine, self.ffi, self.library = engine, engine.ffi, engine.library
        self.devices: list[NativeDevice] = []
        self.drivers: dict[int, Driver] = {}  # by number of their request
        self.on_reject: Callable[[Device, int, int, int | None], None] = lambda *access: None
        self.on_exchange: Callable[[Any, int, float, int], bytes] = lambda *_: b""
        self.on_card: Callable[[bytes, int, int, float, int], bytes] = lambda sent, *_: b"\xff" * len(sent)
        self.on_errors: Callable[[bytes], bytes] = lambda received: received
        self.on_frame: Callable[[int, int, int], None] = lambda motor, cycle, data: None
        self.on_train: Callable[[int, list[int], bool], None] = lambda motor, edges, rest: None
        self.on_sample: Callable[[int], None] = lambda number: None
        functions: dict[str, Callable[..., object]] = {
            "reject": self._reject,
            "query": self._query,
            "source": self._source,
            "exchange": self._exchange,
            "card": self._card,
            "errors": self._errors,
            "train": self._train,
            "frames": self._frames,
            "pin": lambda device, pin, level: self.devices[device].on_pin(pin, level),
            "sample": lambda number: self.on_sample(number),
        }
        guarded = {name: engine.guarded(f, {"query": True}.get(name)) for name, f in functions.items()}
        self._kept = {name: self.ffi.callback(f"{name}_callback", f) for name, f in guarded.items()}
        callbacks = self.ffi.new("struct native_callbacks *", self._kept)
        # Looked up now: if the garbage collector ran while cffi looks up a name, it would wait for itself.
        self._free = self.library.native_free
        self.handle = self.library.native_new(engine.handle, engine.callbacks, callbacks)

    def __del__(self) -> None:
        if getattr(self, "handle", None):
            self._free(self.handle)
            self.handle = None

    def place(self, registers: Registers) -> None:
        """Tell C where all devices are in the engine's windows."""
        self.on_reject = registers.explain
        for device in self.devices:
            window = self.engine.windows[registers.window_name(device)]
            self.library.native_place(self.handle, device.number, window)

    def hear_frames(self) -> None:
        """Call `on_frame` for every frame that an ESC takes, at the end of a run at the latest."""
        self.library.native_hear_frames(self.handle)
        self.engine.after_run = self.tell_frames

    def tell_frames(self) -> None:
        self.library.native_tell_frames(self.handle)

    def _state(self) -> memoryview:
        library = self.library
        return memoryview(self.ffi.buffer(library.native_state(self.handle), library.native_state_bytes()))

    def state(self) -> bytes:
        return bytes(self._state())

    def restore(self, state: bytes) -> None:
        """Make `state()`'s value the state again."""
        self._state()[:] = state

    # ---- what C calls ----

    def _reject(self, device: int, offset: int, size: int, value: int, write: bool) -> None:
        self.on_reject(self.devices[device], offset, size, value if write else None)

    def _query(self, query: int, device: int, a: int, b: int) -> bool:
        self.devices[device].answer(query, a, b)
        return False

    def _source(self, source: int, sync: bool) -> None:
        driver = self.drivers[source]
        (driver.sync if sync else driver.dma_changed)()

    def _exchange(self, data: Any, count: int, transaction: int, hz: float, mode: int) -> None:  # noqa: ANN401
        self.ffi.memmove(data, self.on_exchange(data[0:count], transaction, hz, mode), count)

    def _card(self, data: Any, count: int, cycle: int, length: int, hz: float, mode: int) -> None:  # noqa: ANN401
        sent = bytes(self.ffi.buffer(data, count))
        self.ffi.memmove(data, self.on_card(sent, cycle, length, hz, mode), count)

    def _errors(self, data: Any, count: int) -> None:  # noqa: ANN401
        self.ffi.memmove(data, self.on_errors(bytes(data[0:count])), count)

    def _train(self, motor: int, count: int, edges: Any, rest: bool) -> None:  # noqa: ANN401
        self.tell_frames()  # which came before
        self.on_train(motor, list(edges[0:count]), rest)

    def _frames(self, frames: Any, count: int) -> None:  # noqa: ANN401
        for i in range(count):
            self.on_frame(frames[i].motor, frames[i].cycle, frames[i].data)


class _Words(MutableMapping[str, int]):
    """A device's registers by name, kept in C."""

    def __init__(self, block: Block, array: Any) -> None:  # noqa: ANN401 - uint32_t *
        self._places = {r.name: r.offset >> 2 for r in block.registers.values() if r.modelled}
        self._array = array

    def __getitem__(self, name: str) -> int:
        return int(self._array[self._places[name]])

    def __setitem__(self, name: str, value: int) -> None:
        self._array[self._places[name]] = value

    def __delitem__(self, name: str) -> None:
        raise TypeError("a register stays")

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


class NativeDevice(Device):
    """A peripheral whose registers and time are C's. `queries` are its answers, by number of enum query."""

    kept: tuple[str, ...] = ()  # `Native` keeps them

    def __init__(
        self,
        native: Native,
        name: str,
        kind: int,
        place: int = 0,
        *,
        alarm: str = "",
        interrupts: tuple[int, ...] = (),
        advanced: bool = False,
    ) -> None:
        """kind: of enum kind, the `place`th of it. alarm: name of the one that C sets for it."""
        self.native = native
        self.queries: dict[int, Query] = {}
        library, handle = native.library, native.handle
        base = load_table().blocks[name].base
        number = native.engine.alarm(alarm, in_c).number if alarm else 0xFFFFFFFF
        self.number = int(library.native_device(handle, kind, place, base, number, advanced))
        super().__init__(native.engine, name)
        for register in self.block.registers.values():
            if register.modelled:
                library.native_rule(handle, self.number, register.offset >> 2, [_rule(register)])
        for i, irq in enumerate(interrupts):
            library.native_irq(handle, self.number, i, irq)
        self.words = _Words(self.block, library.native_words(handle, self.number))  # type: ignore[assignment]
        native.devices.append(self)

    @property
    def clocked(self) -> bool:  # type: ignore[override]
        return bool(self.native.library.native_is_clocked(self.native.handle, self.number))

    @clocked.setter
    def clocked(self, on: bool) -> None:
        self.native.library.native_clock(self.native.handle, self.number, on)

    def answer(self, query: int, a: int, b: int) -> None:
        """Answer a query of C. Raises BoardError for what is wrong."""
        answer = self.queries[query]
        if isinstance(answer, str):
            self.engine.fail(answer.format(name=self.name, a=a, b=b))
        answer(a, b)

    def on_pin(self, pin: int, level: bool) -> None:
        """Handle a new level on a watched pin of a port."""

    def reset(self) -> None:
        self.native.library.native_reset(self.native.handle, self.number)

    def counts(self, register: Register) -> tuple[int, int] | None:
        touched, handle, word = self.native.library.native_touched, self.native.handle, register.offset >> 2
        return int(touched(handle, self.number, word, False)), int(touched(handle, self.number, word, True))


def _rule(register: Register) -> dict[str, int]:
    return {
        "reset": register.reset,
        "fixed": register.reserved | register.unmodelled,
        "writable": register.writable,
        "known": 1,
        "sizes": sum(register.sizes),
        "readable": "r" in register.access,
        "writeable": "w" in register.access,
    }


def in_c() -> None:
    """Fail: this stands for the callback of an alarm that C sets and handles."""
    raise AssertionError("this alarm is C's")
