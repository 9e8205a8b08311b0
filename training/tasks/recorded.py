"""The recorded task: pieces of a pilot's recorded commands."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from neuroflight.sim.recorded.commands import Commands
from neuroflight.sim.recorded.files import load_commands
from neuroflight.toolchain.errors import ScenarioError, TrainingError
from neuroflight.training.tasks.limits import Checked
from neuroflight.training.tasks.task import Length, Setpoints


@dataclass(frozen=True)
class RecordedTask(Checked):
    """Pieces of a pilot's commands that start at random times of the recording; the aircraft begins at rest.

    file: recorded commands of any kind that `sim.recorded` reads, a trace (.npz) of `neuroflight fly --trace`
    for instance, or a CSV file with the columns t_s, roll_deg_s, pitch_deg_s, yaw_deg_s (body frame: roll
    right, nose down and yaw left are positive). A relative path starts at the working directory. Raises
    TrainingError on a file that is none, or shorter than a piece.
    """

    name: ClassVar[str] = "recorded"
    file: str
    length_s: Length = 4.0  # of a piece
    sha256: str = ""  # of the file; empty: not checked, and set to that of the file
    recording: Commands = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Read the file."""
        super().__post_init__()
        recording, sha256 = _read(Path(self.file))
        if self.sha256 not in ("", sha256):
            raise TrainingError(
                f"task {self.name}: {self.file} has sha256 {sha256}, expected {self.sha256[:64]}: it is "
                f"another recording; give the right one, or leave sha256 out"
            )
        lasts = float(recording.time[-1] - recording.time[0])
        if lasts < self.length_s:
            raise TrainingError(
                f"task {self.name}: {self.file} lasts {lasts:g} s, expected at least the "
                f"{self.length_s:g} s of a piece (length_s)"
            )
        object.__setattr__(self, "recording", recording)
        object.__setattr__(self, "sha256", sha256)

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.length_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        time = self.recording.time
        setpoint = np.deg2rad(self.recording.setpoint).astype(np.float32)
        starts = time[0] + rng.uniform(0.0, float(time[-1] - time[0]) - self.length_s, count)
        now = starts[:, None] + np.arange(round(self.length_s * rate_hz)) / rate_hz
        pieces: Setpoints = setpoint[np.searchsorted(time, now, side="right") - 1]
        return pieces


def _read(path: Path) -> tuple[Commands, str]:
    """Load the recording; return it and its file's SHA-256."""
    try:
        recording = load_commands(path)
        sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    except ScenarioError as error:
        raise TrainingError(str(error)) from error
    except OSError as error:
        raise TrainingError(f"recording {path}: cannot be read: {error}") from error
    return recording, sha256
