"""The inputs of a flight's control path, step by step, its answers, and both as the firmware's structs."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Array32, Flags
from neuroflight.sim.structs import dtype_of
from neuroflight.toolchain.contract import (
    LOG_RECEIVER_BYTES,
    REPLAY_SAMPLES_MAX,
    STRUCTS,
    LogEdge,
    LogSampleFlag,
)
from neuroflight.toolchain.contract.policy_format import struct_format
from neuroflight.toolchain.errors import TraceError

HEAD = struct.Struct(struct_format(STRUCTS["replay_stream"]))
STEP, ANSWER = dtype_of("replay_step"), dtype_of("replay_answer")

Progress = Callable[[float], None]  # is given what part is done, 0..1


@dataclass(frozen=True, eq=False)
class Inputs:
    """The inputs of each of N control steps. Between two steps lie up to D gyro samples."""

    step: NDArray[np.int64]  # (N,) number of the control step since the log's first
    samples: NDArray[np.int64]  # (N,) gyro samples taken since the step before, this step's included
    counts: NDArray[np.int16]  # (N, D, 3) of the gyro, chip axes, oldest first; behind `samples`: 0
    invalid: Flags  # (N, D) the transfer failed
    repeated: Flags  # (N, D) a good sample that is the good one before it in every word
    accel: NDArray[np.int16]  # (N, 3) of the last good sample, chip axes
    lost: NDArray[np.int64]  # (N,) samples that nobody took since the step before
    silences: NDArray[np.int64]  # (N,) silences of the gyro, of GYRO_BAD_MS each, since the step before
    flags: NDArray[np.uint32]  # (N,) of LogEdge
    forbidden: NDArray[np.uint32]  # (N,) arming reasons of the background
    gain: Array32  # (N,) of the PID for the battery's voltage
    received: NDArray[np.int64]  # (N,) bytes from the receiver
    receiver: NDArray[np.uint8]  # (N, LOG_RECEIVER_BYTES) they
    rotors: NDArray[np.uint16]  # (N, MOTOR_COUNT_MAX) words of the ESCs, by output

    def __len__(self) -> int:
        return len(self.step)


@dataclass(frozen=True, eq=False)
class Answers:
    """The results of each of N control steps."""

    dshot: NDArray[np.uint16]  # (N, M) of each motor
    gyro: Array32 | None = None  # (N, 3) [rad/s] as the controller had it; None: not known
    setpoint: Array32 | None = None  # (N, 3) [rad/s]
    throttle: Array32 | None = None  # (N,) 0..1

    def __len__(self) -> int:
        return len(self.dshot)


@dataclass(frozen=True, eq=False)
class Flight:
    """A log that can be replayed."""

    path: Path
    inputs: Inputs
    answers: Answers  # the log's
    t: Array  # (N,) [s] since the log's first step
    state: bytes  # of struct firmware before the first step
    settings: dict[str, float]  # other than the defaults
    gyro_rate_hz: int
    control_rate_hz: int
    header: dict[str, str]
    layout: int  # what the bytes of the state mean
    incomplete: str  # why it ends before the flight does; "": it does not
    damaged: bool = False  # since a bit of the file is wrong there

    @property
    def motor_count(self) -> int:
        return int(self.answers.dshot.shape[1])

    def __len__(self) -> int:
        return len(self.inputs)

    def boot_settings(self) -> dict[str, float]:
        """Return the settings to boot with; the gyro's rate is an option of its own."""
        given = {name: value for name, value in self.settings.items() if name != "gyro_rate_hz"}
        return {name: int(value) if value == int(value) else value for name, value in given.items()}


def words_of_samples(inputs: Inputs, last: tuple[int, ...]) -> NDArray[np.int16]:
    """Return every word (N, D, 7) that the chip gave: accelerometer, temperature, gyro.

    The log has the accelerometer of each step's last good sample and no temperature. Nothing of the control
    path looks at the others, except whether a sample repeats the one before it: a repetition is one here too,
    and what is none differs in the temperature at least. last: the words of the last good sample before.
    """
    words = np.zeros((*inputs.invalid.shape, 7), np.int16)
    words[:, :, :3] = inputs.accel[:, None, :]
    words[:, :, 4:] = inputs.counts
    before: list[int] = list(last)
    for k, count in enumerate(inputs.samples.tolist()):
        for i in range(count):
            if inputs.invalid[k, i]:
                continue
            if inputs.repeated[k, i]:
                words[k, i, :4] = before[:4]
            else:
                words[k, i, 3] = before[3] ^ 1
            before = words[k, i].tolist()
    return words


def packed(flight: Flight, first: int, last: int) -> NDArray[np.void]:
    """Encode the inputs of control steps first to last - 1 as STEP. Raises TraceError."""
    inputs, rows = flight.inputs, slice(first, last)
    depth = inputs.counts.shape[1]
    steps = np.zeros(len(inputs.step[rows]), STEP)
    samples, lost, received = inputs.samples[rows], inputs.lost[rows], inputs.received[rows]
    fits = (samples <= min(depth, REPLAY_SAMPLES_MAX)) & (received <= LOG_RECEIVER_BYTES)
    fits &= (lost >= 0) & (lost < 1 << 16)
    if not fits.all():
        step = int(inputs.step[rows][int((~fits).argmax())])
        raise TraceError(f"{flight.path}: control step {step} was given what no step is; the log is damaged")
    steps["forbidden"], steps["voltage_gain"] = inputs.forbidden[rows], inputs.gain[rows]
    steps["edge_flags"] = inputs.flags[rows] | (inputs.silences[rows] * LogEdge.SILENCE).astype(np.uint32)
    steps["lost"], steps["samples"], steps["receiver_count"] = lost, samples, received
    steps["accel"], steps["receiver_bytes"] = inputs.accel[rows], inputs.receiver[rows]
    steps["rotors"] = inputs.rotors[rows]
    steps["gyro"]["counts"][:, :depth] = inputs.counts[rows]
    flags = inputs.invalid[rows] * LogSampleFlag.INVALID + inputs.repeated[rows] * LogSampleFlag.REPEATED
    steps["gyro"]["flags"][:, :depth] = flags
    return steps


def unpacked(rows: NDArray[np.void], motors: int) -> Answers:
    """Decode ANSWER (N,) of `motors` motors."""
    return Answers(
        dshot=rows["dshot"][:, :motors].copy(),
        gyro=rows["gyro"].copy(),
        setpoint=rows["setpoint"].copy(),
        throttle=rows["throttle"].copy(),
    )
