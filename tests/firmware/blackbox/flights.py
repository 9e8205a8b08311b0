"""Short flights of the library on a bench, logged: what went in and came out beside what the log says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.blackbox.log import Log, read_log
from neuroflight.sim.ports.library import Reference
from neuroflight.toolchain.contract import (
    CHANNEL_ARM,
    CHANNEL_COUNT,
    CHANNEL_THROTTLE,
    GYRO_COUNTS,
    GYRO_FULL_SCALE_DEG_S,
)

CONTROL_HZ = 1000
ARMED_S = 4.5  # behind the arming delay
FRAME_HZ = 100  # of the receiver
PER_COUNT = np.radians(GYRO_FULL_SCALE_DEG_S / GYRO_COUNTS)  # rad/s
CHIP = np.array([-1, -1, 1])  # the simulated chip is mounted CW180: its axes from the body's


@dataclass(frozen=True)
class Flown:
    """One row a control step, and the bytes that the firmware logged."""

    data: bytes
    step: NDArray[np.int64]
    gyro: NDArray[np.float32]  # (N, 3) rad/s
    setpoint: NDArray[np.float32]  # (N, 3)
    throttle: NDArray[np.float32]
    dshot: NDArray[np.uint16]  # (N, M)
    counts: NDArray[np.int64]  # (N, d, 3) chip axes, of the samples since the step before
    forces: NDArray[np.int64]  # (N, 3) chip axes, counts

    def log(self, folder: Path) -> Log:
        """As the reader of logs has it."""
        path = folder / "flight.bbl"
        path.write_bytes(self.data)
        return read_log(path)

    def rows(self, log: Log) -> NDArray[np.int64]:
        """The rows of each frame of the log."""
        first = log.headers.integer("nf_first_step", -1) - int(self.step[0])
        return log.columns["loopIteration"] + first


def always(_sample: int) -> bool:
    """The log is taken out behind each sample."""
    return True


def fly(
    library: Path,
    seconds: float = 0.5,
    settings: Mapping[str, float] | None = None,
    gyro_hz: int = 4000,
    drained: Callable[[int], bool] = always,
    prepared: Callable[[Reference], None] = lambda _: None,
) -> Flown:
    """Arm, fly with little sticks, disarm; `drained`: whether the log is taken out behind that sample.

    prepared: what is done to the firmware before its first sample.
    """
    board = Reference(library, gyro_hz, settings or {})
    prepared(board)
    rng = np.random.default_rng(7)
    divider, total = gyro_hz // CONTROL_HZ, int((ARMED_S + seconds + 0.5) * gyro_hz)
    data, rows = [board.blackbox()], []
    counts = rng.integers(-20, 20, (total, 3))
    forces = np.array([0, 0, 2048]) + rng.integers(-9, 9, (total, 3))
    until = 0
    for index in range(total):
        t = index / gyro_hz
        flies = ARMED_S < t < ARMED_S + seconds
        if index % (gyro_hz // FRAME_HZ) == 0:
            sticks = [1500] * 4 + [1000] * (CHANNEL_COUNT - 4)
            sticks[0] += round(20 * np.sin(9 * t))
            sticks[CHANNEL_THROTTLE] = 1250 if flies and t > ARMED_S + 0.1 else 1000
            sticks[CHANNEL_ARM] = 2000 if flies else 1000
            board.receiver(sticks)
        body = CHIP * counts[index]
        board.sample(body * PER_COUNT, CHIP * forces[index] * (16 * 9.80665 / 32768))
        if until == 0:
            seen = board.trace()
            rows.append(
                (seen.step, [*seen.gyro], [*seen.setpoint], seen.throttle, [*seen.dshot[0 : seen.motors]])
            )
        until = (until or divider) - 1
        if drained(index):
            data.append(board.blackbox())
    for _ in range(4):
        data.append(board.blackbox())
    step, gyro, setpoint, throttle, dshot = (list(column) for column in zip(*rows, strict=True))
    samples = np.concatenate([np.zeros((divider - 1, 3), np.int64), counts])[: len(rows) * divider]
    return Flown(
        b"".join(data),
        np.array(step),
        np.array(gyro, np.float32),
        np.array(setpoint, np.float32),
        np.array(throttle, np.float32),
        np.array(dshot, np.uint16),
        samples.reshape(len(rows), divider, 3),
        forces[::divider][: len(rows)],
    )
