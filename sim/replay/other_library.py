"""The firmware around another policy, put into the state of a flight.

All of the flight's state is taken over, but what belongs to the policy: what it remembers, its observation,
its idle. The other policy begins with these as after a reset. Where both lie is read from the debug
information of both programs, so that their layouts may differ.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.identity import shipped_as
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.debug.variables import pointers_in, read_variables
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.replay.inputs import Answers, Flight, Progress
from neuroflight.sim.replay.library import ReplayLibrary, check_layout, in_process
from neuroflight.toolchain.errors import TraceError
from neuroflight.toolchain.image.build import build
from neuroflight.toolchain.policy.model import read_file, read_policy

FIRMWARE = "firmware"
# What the other policy begins with as after a reset; `mixers` has its idle, `good` whether it may fly.
OWN = ("control.policy", "control.observation", "control.seen", "control.mixers", "control.good")

Leaf = tuple[str, int, Any]  # name, place, kind of a number, or of an array of them


def answers_of(folder: Path, other: Path, flight: Flight, progress: Progress = lambda _: None) -> Answers:
    """Return the answers of the firmware in `other` on the inputs of `flight`, which the one in `folder` can
    replay.

    folder, other: of builds for HOST. Raises LinkError where one of them cannot replay, TraceError where the
    log or the other policy does not fit, BuildError where a program is none of ours.
    """
    program, library = folder / "neuroflight", folder / "libneuroflight.so"
    known = ReplayLibrary(library, flight)
    check_layout(flight, library, known.layout, known.state_bytes)
    theirs, ours = (_places(path) for path in (program, other / "neuroflight"))

    def boot() -> ReplayLibrary:
        firmware = ReplayLibrary(other / "libneuroflight.so", flight)
        state = bytearray(firmware.memory(firmware.state_bytes))
        _check_motors(flight, state[ours["status.trace.motor_count"][0]])
        for name, (at, size) in ours.items():
            if name in theirs and theirs[name][1] == size and not name.startswith(OWN):
                begin = theirs[name][0]
                state[at : at + size] = flight.state[begin : begin + size]
        firmware.restore(bytes(state))
        return firmware

    return in_process(boot, flight, progress)


def _check_motors(flight: Flight, motors: int) -> None:
    if motors != flight.motor_count:
        raise TraceError(
            f"{flight.path}: {flight.motor_count} motors flew, the other policy drives {motors}; "
            "give one for this aircraft"
        )


def _places(program: Path) -> dict[str, tuple[int, int]]:
    """Return place and size [bytes] in struct firmware of each number and array of numbers, no pointers."""
    (variable,) = read_variables(program, FIRMWARE)
    pointers = pointers_in(program, FIRMWARE)
    return {
        name: (at, kind.itemsize)
        for name, at, kind in _leaves(variable.dtype, 0, "")
        if not any(place.start <= at < place.stop for place in pointers)
    }


def _leaves(kind: np.dtype[Any], at: int, name: str) -> Iterator[Leaf]:
    if kind.fields is None:
        yield name, at, kind
        return
    for field, (inner, offset, *_) in kind.fields.items():
        yield from _leaves(inner, at + offset, f"{name}.{field}" if name else field)


def build_around(policy: Path, root: Path) -> Path:
    """Build the host program around `policy`, in a folder of its own; that of the outputs.

    The PID is that of the policy's aircraft where that is a shipped one. Raises PolicyError, BuildError.
    """
    digest = hashlib.sha256(read_file(policy)).hexdigest()[:16]
    folder = root / "build" / "replay" / digest
    name = shipped_as(read_policy(policy).aircraft_sha256)
    build("HOST", policy, root, folder, None if name is None else pid_table(load_aircraft(name)))
    return folder / "HOST"
