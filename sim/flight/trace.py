"""The record of a flight, one row a control step, and its .npz file."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Array32
from neuroflight.toolchain.contract import DSHOT_MAX, MOTOR_COUNT_MAX
from neuroflight.toolchain.errors import TraceError
from neuroflight.toolchain.files import replacing

BYTES_MAX = 1 << 30  # of a file's arrays: about three hours at 1 kHz
EVEN = 1e-6  # relative spread of even time steps that is due to rounding
_MEMBER = ".npy"


@dataclass(frozen=True, eq=False)
class Trace:
    """A flight of N control steps with M motors; row 0 is the first armed step."""

    t: Array  # (N,) [s]
    setpoint: Array32  # (N, 3) [rad/s], as the firmware computed it
    rate: Array  # (N, 3) [rad/s], true body rate
    gyro: Array32  # (N, 3) [rad/s], what the controller used
    motors: Array  # (N, M) fractions 0..1 as an ESC decodes them
    dshot: NDArray[np.uint16]  # (N, M) 11-bit values, 0 while disarmed
    throttle: Array32  # (N,) pilot's thrust, 0..1

    def __post_init__(self) -> None:
        """Raise TraceError naming the array whose type, shape or content does not fit."""
        steps, motors = len(self.t) if self.t.ndim else 0, self.dshot.shape[-1] if self.dshot.ndim else 0
        if steps < 1:
            raise TraceError("trace: t is empty, expected at least one control step")
        if not 1 <= motors <= MOTOR_COUNT_MAX:
            raise TraceError(f"trace: dshot has {motors} motors, expected 1 to {MOTOR_COUNT_MAX}")
        for name, (dtype, width) in COLUMNS.items():
            array: NDArray[np.generic] = getattr(self, name)
            shape = (steps,) if width == 0 else (steps, motors if width < 0 else width)
            if array.dtype != dtype or array.shape != shape:
                raise TraceError(
                    f"trace: {name} is {array.dtype} {array.shape}, expected {np.dtype(dtype)} {shape}"
                )
            if not np.isfinite(array).all():
                raise TraceError(f"trace: {name} has a value that is not finite")
        if self.dshot.max() > DSHOT_MAX:
            raise TraceError(f"trace: dshot has {self.dshot.max()}, expected at most {DSHOT_MAX}")
        if not (np.diff(self.t) > 0).all():
            raise TraceError("trace: t does not rise")

    @property
    def control_rate_hz(self) -> int:
        """Control steps a second; 0 for a single step."""
        return round((len(self.t) - 1) / float(self.t[-1] - self.t[0])) if len(self.t) > 1 else 0

    @property
    def step_s(self) -> float:
        """The usual time from row to row [s]: the median where a clock is uneven; 0 for a single row."""
        if len(self.t) < 2:
            return 0.0
        first, usual = float(self.t[1] - self.t[0]), float(np.median(np.diff(self.t)))
        # Differences of even times vary in the last bit, and results with them: return one exact value.
        return first if abs(first - usual) < EVEN * usual else usual

    def first(self, rows: int) -> Trace:
        """Return the first `rows` of the flight."""
        return Trace(**{name: getattr(self, name)[:rows] for name in COLUMNS})

    def by_gyro(self) -> Trace:
        """Return the flight as a log has it: the gyro in place of the true rate."""
        return replace(self, rate=self.gyro.astype(np.float64))

    def same(self, other: Trace) -> bool:
        """Return True if every array holds the same bits."""
        return all(
            getattr(self, name).shape == getattr(other, name).shape
            and getattr(self, name).tobytes() == getattr(other, name).tobytes()
            for name in COLUMNS
        )


# Type of each array and its width: 0 a scalar, -1 one value a motor.
COLUMNS: dict[str, tuple[type[np.generic], int]] = {
    "t": (np.float64, 0),
    "setpoint": (np.float32, 3),
    "rate": (np.float64, 3),
    "gyro": (np.float32, 3),
    "motors": (np.float64, -1),
    "dshot": (np.uint16, -1),
    "throttle": (np.float32, 0),
}
assert tuple(COLUMNS) == tuple(field.name for field in fields(Trace))


def save_trace(path: Path, trace: Trace) -> None:
    """Write `trace` to `path` in one step. Equal traces give equal bytes: numpy dates members 1980."""
    with replacing(path) as aside, aside.open("wb") as file:
        np.savez(file, **{name: getattr(trace, name) for name in COLUMNS})


def load_trace(path: Path) -> Trace:
    """Read a trace. Raises TraceError on a file that is missing, damaged, too large or not a trace."""
    if not path.is_file():
        raise TraceError(f"trace {path}: no such file; `neuroflight fly --trace {path}` records one")
    try:
        _check_members(path)
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in COLUMNS}
    except (
        OSError,
        ValueError,
        EOFError,
        zipfile.BadZipFile,
        zipfile.LargeZipFile,
        NotImplementedError,
    ) as error:
        reason = " ".join(str(error).split())
        raise TraceError(f"trace {path}: damaged or no .npz file ({reason}); record it anew") from error
    try:
        return Trace(**arrays)
    except TraceError as error:
        raise TraceError(f"{path}: {error}") from error


def _check_members(path: Path) -> None:
    """Refuse an archive with other arrays than a trace's, or with too much in it, before reading any."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
    names = {member.filename for member in members}
    expected = {name + _MEMBER for name in COLUMNS}
    if names != expected or len(members) != len(expected):
        wrong = ", ".join(sorted(names ^ expected)) or "an array twice"
        raise TraceError(f"trace {path}: not the arrays of a trace ({wrong}); expected {', '.join(COLUMNS)}")
    size = sum(member.file_size for member in members)
    if size > BYTES_MAX:
        raise TraceError(f"trace {path}: {size} bytes of arrays, expected at most {BYTES_MAX}")
