"""The headers that Python reads, compared with the library that was built."""

from __future__ import annotations

from sim.board.core.engine import Outcome
from sim.board.native.library import native_library


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
