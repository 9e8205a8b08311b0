"""Streamed telemetry: asks a firmware for records of control steps, takes them, counts the lost ones."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from neuroflight.flash.link.client import Client
from neuroflight.flash.link.payload import Reader
from neuroflight.toolchain.contract import (
    MSP_STREAM_ARMED,
    MSP_STREAM_PID,
    MSP_STREAM_RATE_MAX_HZ,
    FlightState,
    Msp,
    MspField,
    layout_of,
)
from neuroflight.toolchain.contract.msp_fields import NUMBERS, flat
from neuroflight.toolchain.errors import LinkError

SILENCE_S = 2.0  # without a sample: the stream has ended
_SEQUENCES, _STEPS = 1 << 16, 1 << 32  # counts at which they wrap
_LAYOUT = layout_of(Msp.STREAM_SAMPLE)
_FIXED = [field for field in _LAYOUT.fields if isinstance(field, MspField)]  # the lists come behind them
HEAD = struct.Struct("<" + "".join(f"{field.count}{NUMBERS[field.kind]}" for field in _FIXED))
_STEP = struct.Struct("<HI")


@dataclass(frozen=True)
class Sample:
    """One record of a control step; axes roll, pitch, yaw."""

    sequence: int  # counts the samples that were due, sent or not
    step: int
    cycles: int  # of the processor, that the control step took
    state: str
    armed: bool
    pid_flies: bool
    setpoint: tuple[float, ...]  # [rad/s]
    gyro: tuple[float, ...]  # [rad/s]
    throttle: float
    dshot: tuple[int, ...]  # values sent to the motors
    observation: tuple[float, ...]  # what the policy got
    action: tuple[float, ...]  # what it answered


def decode_sample(payload: bytes) -> Sample:
    """Decode STREAM_SAMPLE. Raises LinkError for another layout."""
    try:
        sequence, step, cycles, state, flags, *rates, throttle = HEAD.unpack_from(payload)
        at, lists = HEAD.size, []
        for group in _LAYOUT.fields[len(_FIXED) :]:  # each behind its count
            layout = struct.Struct(f"<{payload[at]}{''.join(NUMBERS[one.kind] for one in flat((group,)))}")
            lists.append(layout.unpack_from(payload, at + 1))
            at += 1 + layout.size
    except (struct.error, IndexError):
        raise LinkError(
            f"a streamed sample has {len(payload)} bytes and another layout; "
            "bring the firmware and this tool to the same version"
        ) from None
    return Sample(
        sequence=sequence,
        step=step,
        cycles=cycles,
        state=FlightState(state).name if state in set(FlightState) else str(state),
        armed=bool(flags & MSP_STREAM_ARMED),
        pid_flies=bool(flags & MSP_STREAM_PID),
        setpoint=tuple(rates[:3]),
        gyro=tuple(rates[3:]),
        throttle=throttle,
        dshot=lists[0],
        observation=lists[1],
        action=lists[2],
    )


class Stream:
    """A stream of samples over a client, until `stop`."""

    def __init__(self, client: Client, rate_hz: int, control_rate_hz: int) -> None:
        """rate_hz: as asked for; the granted rate is known after `begin`. Raises LinkError."""
        if not 1 <= rate_hz <= MSP_STREAM_RATE_MAX_HZ:
            raise LinkError(f"--rate got {rate_hz}, expected 1 to {MSP_STREAM_RATE_MAX_HZ} Hz")
        self._client, self._control_rate_hz = client, control_rate_hz
        self.rate_hz = rate_hz
        self.received = self.lost = 0
        self.flown_s = 0.0  # of the firmware's time, from the first sample on
        self._last: tuple[int, int] | None = None  # sequence and control step of the last sample

    def begin(self) -> None:
        """Start the stream. Raises LinkError if the firmware has no stream, or not at that rate."""
        reply = self._client.request(Msp.STREAM, struct.pack("<H", self.rate_hz))
        (self.rate_hz,) = Reader(Msp.STREAM, reply).fields("H")

    def payloads(self, seconds: float | None = None, silence_s: float | None = None) -> Iterator[bytes]:
        """Yield the payload of each sample for `seconds` of the firmware's time; None: until the caller
        stops.

        Raises LinkError when none comes for `silence_s`, SILENCE_S unless given.
        """
        silent = SILENCE_S if silence_s is None else silence_s
        while seconds is None or self.flown_s < seconds:
            payload = self._client.receive(Msp.STREAM_SAMPLE, silent)
            if payload is None:
                raise LinkError(
                    f"{self._client.name}: no sample came for {silent:g} s, expected "
                    f"{self.rate_hz} a second; check that the firmware gets gyro samples (a host program "
                    "gets them from a simulator) and that nobody restarted it"
                )
            self._count(payload)
            yield payload

    def rest(self) -> Iterator[bytes]:
        """Yield the payloads of samples that came after `stop`, before it took effect."""
        while (payload := self._client.receive(Msp.STREAM_SAMPLE, 0.0)) is not None:
            self._count(payload)
            yield payload

    def stop(self) -> None:
        """Stop the stream, if the line still works."""
        with contextlib.suppress(LinkError):
            for _ in range(2):  # the first reply may be that to `begin`, which Ctrl-C cut short
                if self._client.request(Msp.STREAM, bytes(2)) == bytes(2):
                    break

    def _count(self, payload: bytes) -> None:
        if len(payload) < HEAD.size:
            decode_sample(payload)  # raises
        sequence, step = _STEP.unpack_from(payload)
        self.received += 1
        if self._last is not None:
            self.lost += (sequence - self._last[0] - 1) % _SEQUENCES
            self.flown_s += (step - self._last[1]) % _STEPS / self._control_rate_hz
        self._last = sequence, step
