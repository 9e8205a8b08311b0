"""The engine's C, built on first use with the host's compiler, and its functions by ctypes.

The library lies in a cache folder under a name made of the sources, the compiler and unicorn's version, so
that a new source or a new compiler makes a new one, and two processes never disturb each other.
"""

from __future__ import annotations

import ctypes
import hashlib
import shutil
import subprocess
from collections.abc import Iterator
from ctypes import (
    CFUNCTYPE,
    POINTER,
    c_bool,
    c_char_p,
    c_int,
    c_uint8,
    c_uint16,
    c_uint32,
    c_uint64,
    c_void_p,
)
from functools import cache
from pathlib import Path

import unicorn

from toolchain.errors import BuildError
from toolchain.files import replacing

BOARD = Path(__file__).resolve().parents[1]
SOURCES = tuple(sorted(BOARD.glob("*/c/*.c")))
HEADERS = tuple(sorted(BOARD.glob("*/c/*.h")))
CACHE = BOARD.parents[1] / "build" / "engine"
FLAGS = ("-std=c11", "-O2", "-fno-semantic-interposition", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared")
WHOLE = ("-flto",)  # across files, where the compiler brings all that it takes
COMPILERS = ("cc", "gcc", "clang")

ReadCallback = CFUNCTYPE(c_uint32, c_uint32, c_uint32, c_uint32)
WriteCallback = CFUNCTYPE(None, c_uint32, c_uint32, c_uint32, c_uint32)
AlarmCallback = CFUNCTYPE(None, c_uint32)
FlashCallback = CFUNCTYPE(None, c_uint32, c_uint32, c_uint32)
SleepCallback = CFUNCTYPE(None)


class Task(ctypes.Structure):
    """`struct task` of engine.h; times in 1/65536 cycles."""

    _fields_ = (
        *((name, c_uint64) for name in ("activations", "instructions", "least", "most", "longest")),
        *(("latest", c_uint64), ("latest_at", c_uint64), ("latest_pc", c_uint32)),
    )


class Node(ctypes.Structure):
    """`struct node` of engine.h."""

    _fields_ = (
        *((name, c_uint32) for name in ("function", "parent", "child", "sibling", "return_to")),
        ("instructions", c_uint64),
    )


class Window(ctypes.Structure):
    """`struct window` of engine.h."""

    _fields_ = (("base", c_uint32), ("size", c_uint32), ("reads", c_uint64), ("writes", c_uint64))


_SIGNATURES = {
    "new": (c_void_p, c_uint64, c_bool, c_bool, POINTER(c_uint16)),
    "open": (c_int, c_void_p),
    "free": (None, c_void_p),
    "callbacks": (None, c_void_p, ReadCallback, WriteCallback, AlarmCallback, FlashCallback, SleepCallback),
    "reset": (None, c_void_p, c_uint32),
    "run": (c_int, c_void_p, c_uint64, c_uint64),
    "attach": (c_int, c_void_p, c_uint32, c_uint32),
    "new_alarm": (c_int, c_void_p),
    "set_alarm": (None, c_void_p, c_uint32, c_uint64),
    "due": (c_uint64, c_void_p, c_uint32),
    "cycle": (c_uint64, c_void_p),
    "irq": (None, c_void_p, c_uint32, c_bool),
    "nmi": (None, c_void_p),
    "load": (c_uint32, c_void_p, c_uint32, c_uint32),
    "store": (None, c_void_p, c_uint32, c_uint32, c_uint32),
    "memory": (POINTER(c_uint8), c_void_p, c_uint32, c_uint32),
    "poke": (c_int, c_void_p, c_uint32, c_char_p, c_uint32),
    "core_clock": (None, c_void_p, c_uint64),
    "flash_busy": (None, c_void_p, c_uint64),
    "want_reset": (None, c_void_p),
    "fail": (None, c_void_p),
    "message": (c_char_p, c_void_p),
    "pc": (c_uint32, c_void_p),
    "set_pc": (None, c_void_p, c_uint32),
    "register": (c_uint32, c_void_p, c_int),
    "set_register": (None, c_void_p, c_int, c_uint32),
    "state": (c_void_p, c_void_p),
    "state_bytes": (c_uint32,),
    "restored": (None, c_void_p),
    "instructions": (c_uint64, c_void_p),
    "hash": (c_uint64, c_void_p),
    "cached": (c_bool, c_void_p, c_uint32),
    "bound_entry": (None, c_void_p, c_uint32, c_uint64, c_char_p),
    "depth": (c_uint32, c_void_p),
    "sleeping": (c_bool, c_void_p),
    "clock": (None, c_void_p, c_bool),
    "spent": (POINTER(c_uint64), c_void_p),
    "task": (POINTER(Task), c_void_p, c_uint32),
    "enters": (POINTER(c_uint64), c_void_p),
    "leaves": (POINTER(c_uint64), c_void_p),
    "window": (POINTER(Window), c_void_p, c_uint32),
    "set_breakpoints": (c_int, c_void_p, POINTER(c_uint32), c_uint32),
    "skip_breakpoint": (None, c_void_p),
    "nodes": (POINTER(Node), c_void_p, POINTER(c_uint32)),
}


@cache
def load_library(folder: Path = CACHE) -> ctypes.CDLL:
    """The engine's library, built into `folder` unless it is there. Raises BuildError, one line."""
    library = ctypes.CDLL(str(build_library(folder)))
    for name, (result, *arguments) in _SIGNATURES.items():
        function = getattr(library, f"engine_{name}")
        function.restype, function.argtypes = result, arguments
    return library


def build_library(folder: Path) -> Path:
    """Where the library is, built if need be. Raises BuildError: no compiler, or what it says."""
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        raise BuildError("the emulated board needs a C compiler of this machine, found none; install gcc")
    include, shared = _unicorn()
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout
    flags = FLAGS + WHOLE if "Free Software Foundation" in version else FLAGS
    target = folder / f"engine-{_key(compiler, version, flags, shared)}.so"
    if target.is_file():
        return target
    with replacing(target) as aside:
        command = [compiler, *flags, f"-I{include}", *map(str, SOURCES), str(shared)]
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


def _key(compiler: str, version: str, flags: tuple[str, ...], shared: Path) -> str:
    digest = hashlib.sha256(f"{compiler}\n{version}\n{shared}\n{unicorn.__version__}\n{flags}".encode())
    for source in (*SOURCES, *HEADERS):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]
