"""The recorded task: pieces of a pilot's recorded commands."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sim.flight.trace import load_trace
from toolchain.errors import TraceError, TrainingError
from toolchain.files import file_size
from training.tasks.limits import check_limits
from training.tasks.task import FULL_STICK_DEG_S, LENGTH_MAX_S, Setpoints

COLUMNS = ("t_s", "roll_deg_s", "pitch_deg_s", "yaw_deg_s")
CSV_BYTES_MAX = 64 << 20  # an hour of commands at 250 Hz, several times over
TRACE_BYTES_MAX = 256 << 20
FULL_STICK = np.nextafter(np.float32(math.radians(FULL_STICK_DEG_S)), np.float32(np.inf))  # [rad/s]


@dataclass(frozen=True, eq=False)
class PilotRecording:
    """Commands of a flight; each holds from its time to the next."""

    time: NDArray[np.float64]  # (N,) [s], rising
    setpoint: NDArray[np.float32]  # (N, 3) [rad/s], body frame, within full stick

    @property
    def length_s(self) -> float:
        """From the first command to the last [s]."""
        return float(self.time[-1] - self.time[0])


@dataclass(frozen=True)
class RecordedTask:
    """Pieces of a pilot's commands that start at random times of the recording; the aircraft begins at rest.

    file: a trace (.npz) of `neuroflight fly --trace`, or a CSV file with the columns t_s, roll_deg_s,
    pitch_deg_s, yaw_deg_s (body frame: roll right, nose down and yaw left are positive). A relative path
    starts at the working directory. Raises TrainingError on a file that is neither, or shorter than a piece.
    """

    name: ClassVar[str] = "recorded"
    file: str
    length_s: float = 4.0  # of a piece
    sha256: str = ""  # of the file; empty: not checked, and set to that of the file
    recording: PilotRecording = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Read the file."""
        check_limits(f"task {self.name}", self, length_s=(0.0, LENGTH_MAX_S))
        recording, sha256 = _read(Path(self.file))
        if self.sha256 not in ("", sha256):
            raise TrainingError(
                f"task {self.name}: {self.file} has sha256 {sha256}, expected {self.sha256[:64]}: it is "
                f"another recording; give the right one, or leave sha256 out"
            )
        if recording.length_s < self.length_s:
            raise TrainingError(
                f"task {self.name}: {self.file} lasts {recording.length_s:g} s, expected at least the "
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
        time, setpoint = self.recording.time, self.recording.setpoint
        starts = time[0] + rng.uniform(0.0, self.recording.length_s - self.length_s, count)
        now = starts[:, None] + np.arange(round(self.length_s * rate_hz)) / rate_hz
        pieces: Setpoints = setpoint[np.searchsorted(time, now, side="right") - 1]
        return pieces


def _read(path: Path) -> tuple[PilotRecording, str]:
    """The recording and its file's SHA-256."""
    limits = {".npz": TRACE_BYTES_MAX, ".csv": CSV_BYTES_MAX}
    try:
        if not path.is_file():
            raise TrainingError(
                f"recording {path}: no such file; give the path of a .npz trace or a .csv file"
            )
        if path.suffix not in limits:
            raise TrainingError(f"recording {path}: expected a trace (.npz) or a table (.csv)")
        if (size := file_size(path)) > limits[path.suffix]:
            raise TrainingError(
                f"recording {path}: {size} bytes, expected at most {limits[path.suffix]}; cut it"
            )
        data = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise TrainingError(f"recording {path}: cannot be read: {error}") from error
    if path.suffix == ".csv":
        recording = _from_csv(data, f"recording {path}")
    else:
        try:
            trace = load_trace(path)
        except TraceError as error:
            raise TrainingError(str(error)) from error
        recording = PilotRecording(trace.t, trace.setpoint)
    if not (np.abs(recording.setpoint) <= FULL_STICK).all():
        most = math.degrees(float(np.abs(recording.setpoint).max()))
        raise TrainingError(
            f"recording {path}: commands reach {most:g} deg/s, full stick is {FULL_STICK_DEG_S:g}; "
            f"is it in another unit?"
        )
    return recording, hashlib.sha256(data).hexdigest()


def _from_csv(data: bytes, where: str) -> PilotRecording:
    try:
        rows = csv.reader(io.StringIO(data.decode("utf-8-sig")), strict=True)
        heading = [cell.strip() for cell in next(rows, [])]
        missing = [name for name in COLUMNS if heading.count(name) != 1]
        if missing:
            raise TrainingError(
                f"{where}: column {missing[0]} stands {heading.count(missing[0])} times in the heading line, "
                f"expected each of {', '.join(COLUMNS)} once"
            )
        order = [heading.index(name) for name in COLUMNS]
        values = np.array([_numbers(row, order, f"{where}: line {rows.line_num}") for row in rows if row])
    except (csv.Error, UnicodeDecodeError) as error:
        raise TrainingError(f"{where}: no table of text and commas: {error}") from error
    if len(values) < 2:
        raise TrainingError(f"{where}: {len(values)} rows of commands, expected at least 2")
    back = np.flatnonzero(~(np.diff(values[:, 0]) > 0))
    if len(back):
        at = int(back[0])
        raise TrainingError(
            f"{where}: t_s is {values[at + 1, 0]:g} after {values[at, 0]:g}, expected it to rise"
        )
    return PilotRecording(values[:, 0], np.deg2rad(values[:, 1:]).astype(np.float32))


def _numbers(row: list[str], order: list[int], where: str) -> list[float]:
    """The cells of COLUMNS as finite numbers."""
    numbers = []
    for name, index in zip(COLUMNS, order, strict=True):
        cell = row[index].strip() if index < len(row) else ""
        try:
            number = float(cell)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise TrainingError(f"{where}: {name} is {cell[:40]!r}, expected a number")
        numbers.append(number)
    return numbers
