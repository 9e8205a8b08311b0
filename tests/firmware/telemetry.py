"""Frames of the telemetry stream, read by other means than those that write them."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterable
from dataclasses import dataclass

from neuroflight.flash.link.msp import Decoder, Direction, Message, Version
from neuroflight.toolchain.contract import FlightState, Msp

_HEAD = struct.Struct("<HIIBB3f3ff")
STREAM_HZ = struct.Struct("<H")


@dataclass(frozen=True)
class Sample:
    """One record."""

    sequence: int
    step: int
    cycles: int
    state: FlightState
    armed: bool
    pid_flies: bool
    setpoint: tuple[float, ...]
    gyro: tuple[float, ...]
    throttle: float
    dshot: tuple[int, ...]
    observation: tuple[float, ...]
    action: tuple[float, ...]


def sample(payload: bytes) -> Sample:
    """Raises struct.error or AssertionError for what is none."""
    sequence, step, cycles, state, flags, *rest = _HEAD.unpack_from(payload)
    assert flags & ~3 == 0
    at, parts = _HEAD.size, []
    for kind in "Hff":
        count = payload[at]
        layout = struct.Struct(f"<{count}{kind}")
        parts.append(layout.unpack_from(payload, at + 1))
        at += 1 + layout.size
    assert at == len(payload)
    dshot, observation, action = parts
    return Sample(
        *(sequence, step, cycles, FlightState(state), bool(flags & 1), bool(flags & 2)),
        *(tuple(rest[:3]), tuple(rest[3:6]), rest[6], dshot, observation, action),
    )


def samples(data: bytes | Iterable[object]) -> list[Sample]:
    """Those among the frames of `data`, or of what a decoder found, which must all be whole."""
    found = Decoder().feed(data) if isinstance(data, bytes) else list(data)
    read = []
    for message in found:
        assert isinstance(message, Message), message
        if message.command == Msp.STREAM_SAMPLE:
            assert (message.version, message.direction) == (Version.V2, Direction.REPLY)
            read.append(sample(message.payload))
    return read


def gaps(found: list[Sample]) -> int:
    """Records that were due between the first and the last of `found`, and did not come."""
    return sum((after.sequence - before.sequence - 1) % 65536 for before, after in itertools.pairwise(found))
