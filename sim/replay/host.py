"""A log on the host program: its option --replay, with the flight as a file and the answers on its stdout."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import numpy as np

from neuroflight.sim.ports.port import setting_changes
from neuroflight.sim.replay.inputs import ANSWER, HEAD, Answers, Flight, Progress, packed, unpacked
from neuroflight.toolchain.contract import REPLAY_STREAM_MAGIC
from neuroflight.toolchain.errors import LinkError

WORDS_MAX = 1000  # of its stderr that are told
STEPS_AT_ONCE = 4096


def replay_on_host(program: Path, flight: Flight, progress: Progress = lambda _: None) -> Answers:
    """Replay each control step of `flight` on the host program and return the answers.

    Raises LinkError where the program is missing or refuses the flight, TraceError for a damaged one.
    """
    if not program.is_file():
        raise LinkError(f"{program}: not built yet; build it with `make host`")
    size = len(flight) * ANSWER.itemsize
    with tempfile.NamedTemporaryFile() as file, tempfile.TemporaryFile() as errors:
        file.write(HEAD.pack(REPLAY_STREAM_MAGIC, len(flight.state), flight.layout) + flight.state)
        for first in range(0, len(flight), STEPS_AT_ONCE):
            file.write(packed(flight, first, first + STEPS_AT_ONCE).tobytes())
        file.flush()
        options = [f"--gyro-hz={flight.gyro_rate_hz}", f"--replay={file.name}"]
        options += [f"--set={change}" for change in setting_changes(flight.boot_settings())]
        try:
            process = subprocess.Popen(
                [program.resolve(), *options], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors
            )
        except OSError as error:
            raise LinkError(
                f"{program}: cannot be started ({error.strerror}); build it with `make host`"
            ) from error
        found = bytearray()
        with process:
            assert process.stdout is not None
            try:
                while data := process.stdout.read(STEPS_AT_ONCE * ANSWER.itemsize):
                    found += data
                    progress(len(found) / max(1, size))
            except BaseException:
                process.kill()
                raise
        errors.seek(0)
        words = " ".join(errors.read(WORDS_MAX).decode(errors="replace").split())
    if process.returncode or len(found) != size:
        told = words or f"it answered {len(found) // ANSWER.itemsize} of {len(flight)} control steps"
        raise LinkError(f"{program}: does not replay {flight.path}: {told} (exit code {process.returncode})")
    return unpacked(np.frombuffer(bytes(found), ANSWER), flight.motor_count)
