"""A log on the firmware's C core as a library: its state into the firmware's memory, then step by step.

The state of a log goes into memory as it is; one that no firmware can have may end the process. So the
library runs in a process of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.ports.library import Reference
from neuroflight.sim.replay.inputs import ANSWER, STEP, Answers, Flight, Progress, packed, unpacked
from neuroflight.sim.structs import dtype_of
from neuroflight.toolchain.errors import TraceError
from neuroflight.toolchain.workers import Worker

TRACE = dtype_of("reference_trace")
CHUNK = 2048  # control steps between two words of progress


def replay_on_library(library: Path, flight: Flight, progress: Progress = lambda _: None) -> Answers:
    """Replay each control step of `flight` in the library and return the answers.

    Raises LinkError where the library is missing or none, TraceError for a log that does not fit it.
    """
    return in_process(lambda: _boot(library, flight), flight, progress)


def in_process(
    boot: Callable[[], ReplayLibrary], flight: Flight, progress: Progress = lambda _: None
) -> Answers:
    """Replay each control step in the library that `boot` prepares, in a process of its own.

    Raises TraceError if that crashes, and the errors of `boot` and the replay.
    """
    found: list[NDArray[np.void]] = [np.empty(0, ANSWER)]
    worker = Worker(_run, boot, flight, name=f"{flight.path}: its replay", method="fork")
    try:
        while (told := worker.hear()) is not None:
            found.append(np.frombuffer(told, ANSWER))
            progress(sum(map(len, found)) / max(len(flight), 1))
        return unpacked(np.concatenate(found), flight.motor_count)
    except EOFError:
        worker.process.join()
        raise TraceError(
            f"{flight.path}: the firmware crashed on it (exit code {worker.process.exitcode}): the state in "
            "its header is none that a firmware has; take another copy of the file"
        ) from None
    finally:
        worker.end(kill=True)


def _run(link: Connection, boot: Callable[[], ReplayLibrary], flight: Flight) -> None:
    """Replay, in the process of its own: send answers piecewise, then None."""
    firmware = boot()
    for first in range(0, len(flight), CHUNK):
        link.send(firmware.replay(packed(flight, first, first + CHUNK), flight, first).tobytes())
    link.send(None)


class ReplayLibrary(Reference):
    """The library, which goes on from a state and takes the inputs of control steps."""

    def __init__(self, library: Path, flight: Flight) -> None:
        """Boot with the settings of the log. Raises LinkError as Reference does."""
        super().__init__(library, flight.gyro_rate_hz, flight.boot_settings())
        self.path = library

    @property
    def layout(self) -> int:
        """Version of a state's layout."""
        return int(self._library.reference_layout())

    @property
    def state_bytes(self) -> int:
        return int(self._library.reference_state_size())

    def memory(self, count: int) -> bytes:
        """Return the present state, the first `count` bytes of the instance."""
        return self._memory.tobytes()[:count]

    def restore(self, state: bytes) -> bool:
        """Go on from `state`, of this layout; False: it has another size."""
        return bool(self._library.reference_restore(self._self, state, len(state), self.layout))

    def replay(self, steps: NDArray[np.void], flight: Flight, first: int) -> NDArray[np.void]:
        """Replay STEP (N,), control steps of `flight` from `first` on, to ANSWER (N,)."""
        steps = np.ascontiguousarray(steps, STEP)
        answers = np.zeros(len(steps), ANSWER)
        first_step = self._ffi.cast("uint8_t *", steps.ctypes.data)
        for row in range(len(steps)):
            step_at = self._ffi.cast("struct replay_step *", first_step + row * STEP.itemsize)
            result = self._library.reference_replay(self._self, step_at, self._outputs)
            if result:
                step = int(flight.inputs.step[first + row])
                raise TraceError(
                    f"{flight.path}: control step {step} does not follow from those before it ({result}); "
                    "the log is damaged there"
                )
            (told,) = np.frombuffer(self.trace_bytes(), TRACE)
            for name in ANSWER.fields or ():
                answers[row][name] = told[name]
        return answers


def _boot(library: Path, flight: Flight) -> ReplayLibrary:
    """Prepare the library in the state of the log. Raises TraceError if that is of another firmware."""
    firmware = ReplayLibrary(library, flight)
    check_layout(flight, library, firmware.layout, firmware.state_bytes)
    firmware.restore(flight.state)
    return firmware


def check_layout(flight: Flight, program: Path, layout: int, state_bytes: int) -> None:
    """Raise TraceError unless the log's state is one of `program`, whose own has this layout and size."""
    if (flight.layout, len(flight.state)) != (layout, state_bytes):
        raise TraceError(
            f"{flight.path}: its state has {len(flight.state)} bytes of layout {flight.layout:08x}, "
            f"{program} expects {state_bytes} of {layout:08x}: another source or policy flew; build that one"
        )
