"""The fuzz targets as programs: with clang's libFuzzer, or with gcc and a main that replays files.

Both are the core's own objects, compiled by its makefile around the scripted policy, under the sanitizers.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.files import locked
from tests.conftest import BUILD
from tests.firmware.conftest import FIRMWARE, write_scripted

FOLDER = Path(__file__).parent
CHECKS = "address,undefined,float-cast-overflow,float-divide-by-zero"
# -w: the sanitizers' own code draws warnings that no other build has.
COMMON = f"-O1 -g -w -fno-omit-frame-pointer -fno-sanitize-recover=all -fsanitize={CHECKS}"
# To gcc the last array of a struct may be longer than it says, but for this; to clang it is not.
GCC_ONLY = "-fsanitize=bounds-strict"
# clang takes no floating-point number in these; every other build checks them.
LIBFUZZER = "-fsanitize=fuzzer-no-link '-D_Static_assert(...)='"
HOST_OBJECTS = ("board", "convert", "receiver_line", "flash_model")


@dataclass(frozen=True)
class Target:
    """A program that reads inputs: its sources and what is defined for it."""

    sources: tuple[str, ...]
    define: str = ""


TARGETS = {
    "sbus": Target(("receiver.c",), "PROTOCOL=NF_RECEIVER_PROTOCOL_SBUS"),
    "crsf": Target(("receiver.c",), "PROTOCOL=NF_RECEIVER_PROTOCOL_CRSF"),
    "msp": Target(("msp.c", "world.c")),
    "command_line": Target(("msp.c", "world.c")),
    "usb_serial": Target(("usb.c",), "DISK=0"),
    "usb_disk": Target(("usb.c",), "DISK=1"),
    "esc_answers": Target(("esc_answers.c",)),
}


@dataclass(frozen=True)
class Workbench:
    """Where programs of one compiler are built, what has changed of them."""

    folder: Path
    compiler: str  # "clang" or "gcc"

    @property
    def fuzzes(self) -> bool:
        """Does the compiler bring libFuzzer?"""
        return self.compiler == "clang"

    def make(self) -> None:
        """Compile the core. Raises BuildError when the compiler is missing or does not like it."""
        if shutil.which(self.compiler) is None:
            raise BuildError(f"{self.compiler} is missing; install it from the system's packages")
        watched = f"{COMMON} {LIBFUZZER if self.fuzzes else GCC_ONLY}"
        named = {
            "TARGET": "HOST",
            "CC": self.compiler,
            "INSTRUMENT": watched,
            "GENERATED": os.path.relpath(self.folder / "generated", FIRMWARE),
            "BUILD": os.path.relpath(self.folder / "build", FIRMWARE),
        }
        library = f"{named['BUILD']}/libneuroflight.so"
        with locked(self.folder):
            write_scripted(self.folder / "generated", motors=4)
            run(["make", "-s", "-C", str(FIRMWARE), *(f"{k}={v}" for k, v in named.items()), library])

    def program(self, name: str) -> Path:
        """The program of a target; `make` has been called. Raises BuildError."""
        target = TARGETS[name]
        names = (*target.sources, *(() if self.fuzzes else ("replay.c",)))
        more = [
            *(["-fsanitize=fuzzer"] if self.fuzzes else []),
            *([f"-D{target.define}"] if target.define else []),
        ]
        return self.link(name, *(FOLDER / part for part in names), more=more)

    def link(self, name: str, *sources: Path, more: Sequence[str] = ()) -> Path:
        """Link `sources` with the core into a program; `make` has been called. Raises BuildError."""
        search = (FIRMWARE, FIRMWARE / "src", FIRMWARE / "targets" / "HOST", self.folder / "generated")
        warned = [
            "-std=c11",
            "-fshort-enums",
            "-Wall",
            "-Wextra",
            "-Wno-unused-parameter",
            "-Werror",
            *COMMON.replace("-w ", "").split(),
        ]
        command = [self.compiler, *warned, *more, *(f"-I{path}" for path in search)]
        with locked(self.folder):
            run([*command, "-o", str(self.folder / name), *map(str, sources), *map(str, self.objects())])
        return self.folder / name

    def objects(self) -> list[Path]:
        """The core and the simulated board, without a main."""
        objects = self.folder / "build" / "obj"
        sources = [path.relative_to(FIRMWARE) for path in sorted((FIRMWARE / "src").rglob("*.c"))]
        core = [objects / path.with_suffix(".o") for path in sources if path.name != "main.c"]
        board = [objects / "hal" / "host" / f"{name}.o" for name in HOST_OBJECTS]
        return [*core, objects / "policy.o", objects / "pid_table.o", *board]


def sanitized() -> Workbench:
    """The core under gcc's sanitizers, kept from run to run. Raises BuildError."""
    bench = Workbench(BUILD / "sanitized", "gcc")
    bench.make()
    return bench


def run(command: list[str]) -> None:
    """Run a compiler. Raises BuildError with its words."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise BuildError(done.stderr)
