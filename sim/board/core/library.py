"""The emulated board's C library, around the installed unicorn."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import unicorn

from neuroflight.sim import compiled
from neuroflight.sim.compiled import CACHE, Library
from neuroflight.toolchain.errors import BuildError

CORE = Path(__file__).parent / "c"
BASE = CORE / "base"  # what all others include, and what Python calls


@cache
def load_library(*parts: Path, folder: Path = CACHE) -> Library:
    """Load the library of the core and of further parts, each a folder of C sources with an api.h.

    Built into `folder` unless it is there. Raises BuildError, one line.
    """
    return compiled.load(_source((BASE, *parts)), folder)


def _source(parts: tuple[Path, ...]) -> compiled.Source:
    """Return the sources of `parts`. Raises BuildError if unicorn's headers or library are missing."""
    package = Path(unicorn.__file__).parent
    shared = next(_shared(package / "lib"), None)
    header = package / "include" / "unicorn" / "unicorn.h"
    if shared is None or not header.is_file():
        raise BuildError(f"the unicorn package at {package} has no headers or library; install unicorn 2.1")
    return compiled.Source(
        name="engine",
        what="the emulated board's engine",
        parts=parts,
        files=tuple(sorted(file for file in CORE.glob("*/*.[ch]") if file.parent != BASE)),
        includes=(header.parents[1],),
        linked=(shared,),
        versions=(unicorn.__version__,),
    )


def _shared(folder: Path) -> Iterator[Path]:
    yield from sorted(folder.glob("libunicorn.so*"))
    yield from sorted(folder.glob("libunicorn*.dylib"))
