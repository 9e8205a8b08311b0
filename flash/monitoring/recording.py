"""Files of streamed samples: CSV, a row for each sample, or npz, an array a quantity; whole or none."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.flash.monitoring.stream import Sample
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.files import replacing

SUFFIXES = (".csv", ".npz")


@dataclass(frozen=True)
class Shape:
    """The number of values of each kind in a row; a disarmed firmware's sample has none of a policy."""

    motors: int
    observations: int
    actions: int


def columns(shape: Shape) -> list[str]:
    """Return the column heads of the CSV file."""
    return [
        *("t_s", "sequence", "step", "cycles", "state", "armed", "pid_flies"),
        *(f"{what}_{axis}_rad_s" for what in ("setpoint", "gyro") for axis in AXES),
        "throttle",
        *(f"motor{index}_dshot" for index in range(1, shape.motors + 1)),
        *(f"observation{index}" for index in range(1, shape.observations + 1)),
        *(f"action{index}" for index in range(1, shape.actions + 1)),
    ]


def row(sample: Sample, time_s: float, shape: Shape) -> list[str]:
    """Return a row of CSV: floats with enough digits for the same float32; empty for missing values."""
    return [
        *(f"{time_s:.6f}", str(sample.sequence), str(sample.step), str(sample.cycles), sample.state),
        *(str(int(sample.armed)), str(int(sample.pid_flies))),
        *_cells((*sample.setpoint, *sample.gyro, sample.throttle), 7),
        *_cells(sample.dshot, shape.motors),
        *_cells(sample.observation, shape.observations),
        *_cells(sample.action, shape.actions),
    ]


def _cells(numbers: Sequence[float], count: int) -> list[str]:
    return [f"{number:.9g}" for number in numbers[:count]] + [""] * (count - len(numbers))


def times(samples: Sequence[Sample], control_rate_hz: int) -> NDArray[np.float64]:
    """Return the firmware's time since the first sample [s], shape (N,)."""
    steps = np.array([sample.step for sample in samples], np.uint32)
    since = np.diff(steps, prepend=steps[:1]).astype(np.uint32).astype(np.int64)  # unwraps the step number
    seconds: NDArray[np.float64] = np.cumsum(since) / control_rate_hz
    return seconds


def write_csv(file: IO[str], samples: Sequence[Sample], control_rate_hz: int, shape: Shape) -> None:
    """Write column heads and a row for each sample."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns(shape))
    for sample, time_s in zip(samples, times(samples, control_rate_hz), strict=True):
        writer.writerow(row(sample, float(time_s), shape))


def arrays(samples: Sequence[Sample], control_rate_hz: int, shape: Shape) -> dict[str, Any]:
    """Return the arrays of an npz, shapes (N,) or (N, K), named as in a trace; NaN for missing values."""
    whole = {name: np.array([getattr(sample, name) for sample in samples]) for name in ("sequence", "step")}
    return {
        "t": times(samples, control_rate_hz),
        **whole,
        "cycles": np.array([sample.cycles for sample in samples], np.uint32),
        "state": np.array([sample.state for sample in samples]),
        "armed": np.array([sample.armed for sample in samples]),
        "pid_flies": np.array([sample.pid_flies for sample in samples]),
        "setpoint": _padded([sample.setpoint for sample in samples], 3),
        "gyro": _padded([sample.gyro for sample in samples], 3),
        "throttle": np.array([sample.throttle for sample in samples], np.float32),
        "dshot": np.nan_to_num(_padded([s.dshot for s in samples], shape.motors)).astype(np.uint16),
        "observation": _padded([sample.observation for sample in samples], shape.observations),
        "action": _padded([sample.action for sample in samples], shape.actions),
    }


def _padded(rows: Sequence[Sequence[float]], count: int) -> NDArray[np.float32]:
    """Stack `rows` into shape (N, count), with NaN behind a row's end."""
    padded = np.full((len(rows), count), np.nan, np.float32)
    for target, numbers in zip(padded, rows, strict=True):
        target[: len(numbers)] = numbers[:count]
    return padded


def write_recording(
    path: Path, samples: Sequence[Sample], control_rate_hz: int, shape: Shape, facts: Mapping[str, Any]
) -> None:
    """Write samples to a new file of one of SUFFIXES. facts: scalars for an npz."""
    with replacing(path) as aside:
        if path.suffix == ".csv":
            with aside.open("w", newline="") as file:
                write_csv(file, samples, control_rate_hz, shape)
        else:
            with aside.open("wb") as archive:
                np.savez_compressed(archive, **arrays(samples, control_rate_hz, shape), **facts)
