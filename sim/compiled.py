"""C that Python calls: built on first use with the host's compiler, loaded through cffi.

A library lies in a cache folder under a name made of its sources, the compiler, the flags and what it is
linked with, so that a new source or a new compiler makes a new one, and two processes never disturb each
other. What Python may call is declared once, in the `api.h` of each folder of sources.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cffi import FFI

from neuroflight.toolchain import contract
from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.files import replacing

CACHE = Path(__file__).resolve().parents[1] / "build" / "engine"
# Products are fused with sums only where the source says so, which gives the same bits on every processor.
FLAGS = (
    *("-std=c11", "-O2", "-ffp-contract=off", "-fno-semantic-interposition", "-fPIC", "-shared"),
    *("-Wall", "-Wextra", "-Werror"),
)
WHOLE = ("-flto",)  # optimization across files, if the compiler has all that it needs
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
COMPILERS = ("cc", "gcc", "clang")


@dataclass(frozen=True)
class Library:
    """A loaded library: `lib` has the functions and constants, `ffi` makes callbacks, structs and arrays."""

    ffi: FFI
    lib: Any
    path: Path


@dataclass(frozen=True)
class Source:
    """The sources of a library."""

    name: str  # of its files
    what: str  # it is, as an error names it
    parts: tuple[Path, ...]  # folders of C sources, each with an api.h
    files: tuple[Path, ...] = ()  # more sources, of another room: C, and the headers that they include
    declares: str = ""  # what Python may use of those, as cffi reads it
    flags: tuple[str, ...] = ()
    includes: tuple[Path, ...] = ()  # folders
    linked: tuple[Path, ...] = ()  # libraries of Python packages
    versions: tuple[str, ...] = ()  # of those packages


def load(source: Source, folder: Path = CACHE) -> Library:
    """Load the library of `source`, built into `folder` if it is missing. Raises BuildError, one line."""
    ffi = FFI()
    ffi.cdef(source.declares + "".join(declarations(part / "api.h") for part in source.parts))
    path = build(source, folder)
    return Library(ffi, ffi.dlopen(str(path)), path)


def declarations(header: Path) -> str:
    """Return the declarations of `header`, without the preprocessor's lines."""
    return "".join(line for line in header.read_text().splitlines(True) if not line.startswith("#"))


def contract_declarations(header: Path) -> str:
    """Return the declarations of a header of the firmware, the contract's constants as numbers."""

    def number(match: re.Match[str]) -> str:
        return str(getattr(contract, match[1]))

    return re.sub(r"\bNF_([A-Z0-9_]+)\b(?!_H\b)", number, _COMMENT.sub("", declarations(header)))


def build(source: Source, folder: Path) -> Path:
    """Build the library if it is missing; return its path. Raises BuildError."""
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        raise BuildError(f"{source.what} needs a C compiler of this machine, found none; install gcc")
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout
    flags = (*FLAGS, *source.flags, *(WHOLE if "Free Software Foundation" in version else ()))
    files = [*(file for part in source.parts for file in sorted(part.glob("*.[ch]"))), *source.files]
    target = folder / f"{source.name}-{_key((compiler, version, *flags), source, files)}.so"
    if target.is_file():
        return target
    with replacing(target) as aside:
        command = [compiler, *flags, *(f"-I{include}" for include in source.includes)]
        command += [str(file) for file in files if file.suffix == ".c"]
        for linked in source.linked:
            command += (
                [str(linked)] if linked.suffix == ".a" else [str(linked), f"-Wl,-rpath,{linked.parent}"]
            )
        done = subprocess.run([*command, "-lm", "-ldl", "-o", str(aside)], capture_output=True, text=True)
        if done.returncode != 0:
            lines = done.stderr.strip().splitlines() or ["no message"]
            said = next((line for line in lines if "error" in line), lines[0])
            raise BuildError(f"{source.what} does not build with {compiler}: {said}")
    return target


def _key(how: Sequence[str], source: Source, files: Sequence[Path]) -> str:
    digest = hashlib.sha256("\n".join((*how, *map(str, source.linked), *source.versions)).encode())
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
