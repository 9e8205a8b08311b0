"""Inputs and answers of a replay as firmware/hal/host/replay.h and replay_stream.h have them."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.replay.inputs import Answers, Flight
from neuroflight.toolchain.contract import LOG_RECEIVER_BYTES, MOTOR_COUNT_MAX
from neuroflight.toolchain.errors import TraceError

SAMPLES_MAX = 64
MAGIC = 0x5052464E
HEAD = struct.Struct("<3I")  # magic, bytes of the state, its layout

SAMPLE = np.dtype([("counts", "<i2", (3,)), ("flags", "<u2")])
STEP = np.dtype(
    [
        ("forbidden", "<u4"),
        ("voltage_gain", "<f4"),
        ("edge_flags", "<u4"),
        ("lost", "<u4"),
        ("samples", "<u2"),
        ("receiver_count", "<u2"),
        ("accel", "<i2", (3,)),
        ("reserved", "<u2"),
        ("gyro", SAMPLE, (SAMPLES_MAX,)),
        ("receiver_bytes", "u1", (LOG_RECEIVER_BYTES,)),
    ]
)
ANSWER = np.dtype(
    [
        ("step", "<u4"),
        ("setpoint", "<f4", (3,)),
        ("gyro", "<f4", (3,)),
        ("throttle", "<f4"),
        ("dshot", "<u2", (MOTOR_COUNT_MAX,)),
    ]
)
_SILENCES = 16  # the first bit of edge_flags that counts them
_INVALID, _REPEATED = 1, 2  # bits of a sample's flags


def packed(flight: Flight, first: int, last: int) -> NDArray[np.void]:
    """Encode the inputs of control steps first to last - 1 as STEP. Raises TraceError."""
    inputs, rows = flight.inputs, slice(first, last)
    depth = inputs.counts.shape[1]
    steps = np.zeros(len(inputs.step[rows]), STEP)
    samples, lost, received = inputs.samples[rows], inputs.lost[rows], inputs.received[rows]
    fits = (
        (samples <= min(depth, SAMPLES_MAX))
        & (received <= LOG_RECEIVER_BYTES)
        & (lost >= 0)
        & (lost < 1 << 16)
    )
    if not fits.all():
        step = int(inputs.step[rows][int((~fits).argmax())])
        raise TraceError(f"{flight.path}: control step {step} was given what no step is; the log is damaged")
    steps["forbidden"], steps["voltage_gain"] = inputs.forbidden[rows], inputs.gain[rows]
    steps["edge_flags"] = inputs.flags[rows] | (inputs.silences[rows] << _SILENCES).astype(np.uint32)
    steps["lost"], steps["samples"], steps["receiver_count"] = lost, samples, received
    steps["accel"], steps["receiver_bytes"] = inputs.accel[rows], inputs.receiver[rows]
    steps["gyro"]["counts"][:, :depth] = inputs.counts[rows]
    flags = inputs.invalid[rows] * _INVALID + inputs.repeated[rows] * _REPEATED
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
