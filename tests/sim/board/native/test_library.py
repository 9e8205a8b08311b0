"""The headers that Python reads, compared with the library that was built."""

from __future__ import annotations

import struct

from neuroflight.sim.board.core.engine import Engine, Outcome
from neuroflight.sim.board.native.library import Native, native_library


def test_every_function_is_there_when_a_header_declares_it() -> None:
    library = native_library()
    missing = [name for name in dir(library.lib) if not hasattr(library.lib, name)]
    assert not missing
    assert {"engine_run", "native_new"} <= set(dir(library.lib))


def test_outcomes_are_the_headers() -> None:
    numbers = native_library().ffi.typeof("enum outcome").relements
    assert {name.removeprefix("RUN_"): number for name, number in numbers.items()} == {
        outcome.name: outcome.value for outcome in Outcome
    }


class Locked:
    """A library in the middle of finding a name: whoever asks for another waits for ever."""

    def __getattr__(self, name: str) -> object:
        raise AssertionError(f"{name}: asked for while the collector runs")


def test_a_collected_board_asks_for_no_name() -> None:
    wait = struct.pack("<IIHH", 0x20010000, 0x00200009, 0xBF30, 0xE7FD)  # vectors; wfi, and again
    engine = Engine(wait, library=native_library())
    native = Native(engine)
    native.library = engine.library = Locked()
    native.__del__()
    engine.close()
    assert native.handle is None
