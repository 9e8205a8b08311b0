"""Streamed samples as files: CSV, a row a sample, or npz, an array a quantity. Written aside, then renamed."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from flash.stream import Sample
from toolchain.contract import AXES
from toolchain.files import replacing

SUFFIXES = (".csv", ".npz")


def columns(first: Sample) -> list[str]:
    """Heads of the columns of CSV, for samples like `first`."""
    return [
        *("t_s", "sequence", "step", "cycles", "state", "armed", "pid_flies"),
        *(f"{what}_{axis}_rad_s" for what in ("setpoint", "gyro") for axis in AXES),
        "throttle",
        *(f"motor{index}_dshot" for index in range(1, len(first.dshot) + 1)),
        *(f"observation{index}" for index in range(1, len(first.observation) + 1)),
        *(f"action{index}" for index in range(1, len(first.action) + 1)),
    ]


def row(sample: Sample, time_s: float) -> list[str]:
    """A row of CSV: floats with the digits that tell one float32 from the next."""
    numbers = [*sample.setpoint, *sample.gyro, sample.throttle]
    return [
        *(f"{time_s:.6f}", str(sample.sequence), str(sample.step), str(sample.cycles), sample.state),
        *(str(int(sample.armed)), str(int(sample.pid_flies))),
        *(f"{number:.9g}" for number in numbers),
        *(str(value) for value in sample.dshot),
        *(f"{number:.9g}" for number in (*sample.observation, *sample.action)),
    ]


def times(samples: Sequence[Sample], control_rate_hz: int) -> NDArray[np.float64]:
    """Seconds of the firmware's time since the first sample, shape (N,)."""
    steps = np.array([sample.step for sample in samples], np.uint32)
    since = np.diff(steps, prepend=steps[:1]).astype(np.uint32).astype(np.int64)  # a wrapped number goes on
    seconds: NDArray[np.float64] = np.cumsum(since) / control_rate_hz
    return seconds


def write_csv(file: IO[str], samples: Sequence[Sample], control_rate_hz: int) -> None:
    """Heads and a row each."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns(samples[0]))
    for sample, time_s in zip(samples, times(samples, control_rate_hz), strict=True):
        writer.writerow(row(sample, float(time_s)))


def arrays(samples: Sequence[Sample], control_rate_hz: int) -> dict[str, NDArray[np.generic]]:
    """What an npz has: arrays of shape (N,) or (N, K), under the names of a flight's trace where it has one."""
    whole = {name: np.array([getattr(sample, name) for sample in samples]) for name in ("sequence", "step")}
    floats = ("setpoint", "gyro", "throttle", "observation", "action")
    return {
        "t": times(samples, control_rate_hz),
        **whole,
        "cycles": np.array([sample.cycles for sample in samples], np.uint32),
        "state": np.array([sample.state for sample in samples]),
        "armed": np.array([sample.armed for sample in samples]),
        "pid_flies": np.array([sample.pid_flies for sample in samples]),
        **{name: np.array([getattr(sample, name) for sample in samples], np.float32) for name in floats},
        "dshot": np.array([sample.dshot for sample in samples], np.uint16),
    }


def write_recording(
    path: Path, samples: Sequence[Sample], control_rate_hz: int, facts: Mapping[str, int | str]
) -> None:
    """Write samples, all of one shape, to a new file of one of SUFFIXES. facts: scalars for an npz."""
    with replacing(path) as aside:
        if path.suffix == ".csv":
            with aside.open("w", newline="") as file:
                write_csv(file, samples, control_rate_hz)
        else:
            with aside.open("wb") as archive:
                np.savez_compressed(
                    archive,
                    **arrays(samples, control_rate_hz),
                    **{name: np.array(value) for name, value in facts.items()},
                )
