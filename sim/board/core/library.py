"""The emulated board's C library: built on first use with the host's compiler, called through cffi.

The library lies in a cache folder under a name made of the sources, the compiler and unicorn's version, so
that a new source or a new compiler makes a new one, and two processes never disturb each other. What Python
may call is declared once, in each part's `api.h`.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import unicorn
from cffi import FFI

from toolchain.errors import BuildError
from toolchain.files import replacing

CORE = Path(__file__).parent / "c"
CACHE = CORE.parents[3] / "build" / "engine"
FLAGS = ("-std=c11", "-O2", "-fno-semantic-interposition", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared")
WHOLE = ("-flto",)  # across files, where the compiler brings all that it takes
COMPILERS = ("cc", "gcc", "clang")


@dataclass(frozen=True)
class Library:
    """A loaded library: `lib` has the functions and constants, `ffi` makes callbacks, structs and arrays."""

    ffi: FFI
    lib: Any
    path: Path


@cache
def load_library(*parts: Path, folder: Path = CACHE) -> Library:
    """The library of the core and of further parts, each a folder of C sources with an api.h.

    Built into `folder` unless it is there. Raises BuildError, one line.
    """
    every = (CORE, *parts)
    ffi = FFI()
    ffi.cdef("".join(declarations(part / "api.h") for part in every))
    path = build_library(every, folder)
    return Library(ffi, ffi.dlopen(str(path)), path)


def declarations(header: Path) -> str:
    """What `header` declares, without the preprocessor's lines."""
    return "".join(line for line in header.read_text().splitlines(True) if not line.startswith("#"))


def build_library(parts: tuple[Path, ...], folder: Path) -> Path:
    """Where the library is, built if need be. Raises BuildError: no compiler, or what it says."""
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        raise BuildError("the emulated board needs a C compiler of this machine, found none; install gcc")
    include, shared = _unicorn()
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout
    flags = FLAGS + WHOLE if "Free Software Foundation" in version else FLAGS
    sources = [source for part in parts for source in sorted(part.glob("*.[ch]"))]
    target = folder / f"engine-{_key(compiler, version, flags, shared, sources)}.so"
    if target.is_file():
        return target
    with replacing(target) as aside:
        code = [str(source) for source in sources if source.suffix == ".c"]
        command = [compiler, *flags, f"-I{include}", *code, str(shared)]
        command += [f"-Wl,-rpath,{shared.parent}", "-o", str(aside)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            first = next(iter(done.stderr.strip().splitlines()), "no message")
            raise BuildError(f"the emulated board's engine does not build with {compiler}: {first}")
    return target


def _unicorn() -> tuple[Path, Path]:
    """Headers and library of the installed unicorn package."""
    package = Path(unicorn.__file__).parent
    shared = next(_shared(package / "lib"), None)
    header = package / "include" / "unicorn" / "unicorn.h"
    if shared is None or not header.is_file():
        raise BuildError(f"the unicorn package at {package} has no headers or library; install unicorn 2.1")
    return header.parents[1], shared


def _shared(folder: Path) -> Iterator[Path]:
    yield from sorted(folder.glob("libunicorn.so*"))
    yield from sorted(folder.glob("libunicorn*.dylib"))


def _key(compiler: str, version: str, flags: tuple[str, ...], shared: Path, sources: list[Path]) -> str:
    digest = hashlib.sha256(f"{compiler}\n{version}\n{shared}\n{unicorn.__version__}\n{flags}".encode())
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]
