"""Inputs and answers of a replay as the firmware has them: replay_step, replay_answer."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.replay.inputs import Answers, Flight
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


def packed(flight: Flight, first: int, last: int) -> NDArray[np.void]:
    """Encode the inputs of control steps first to last - 1 as STEP. Raises TraceError."""
    inputs, rows = flight.inputs, slice(first, last)
    depth = inputs.counts.shape[1]
    steps = np.zeros(len(inputs.step[rows]), STEP)
    samples, lost, received = inputs.samples[rows], inputs.lost[rows], inputs.received[rows]
    fits = (
        (samples <= min(depth, REPLAY_SAMPLES_MAX))
        & (received <= LOG_RECEIVER_BYTES)
        & (lost >= 0)
        & (lost < 1 << 16)
    )
    if not fits.all():
        step = int(inputs.step[rows][int((~fits).argmax())])
        raise TraceError(f"{flight.path}: control step {step} was given what no step is; the log is damaged")
    steps["forbidden"], steps["voltage_gain"] = inputs.forbidden[rows], inputs.gain[rows]
    steps["edge_flags"] = inputs.flags[rows] | (inputs.silences[rows] * LogEdge.SILENCE).astype(np.uint32)
    steps["lost"], steps["samples"], steps["receiver_count"] = lost, samples, received
    steps["accel"], steps["receiver_bytes"] = inputs.accel[rows], inputs.receiver[rows]
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
