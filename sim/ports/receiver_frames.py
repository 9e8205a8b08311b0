"""Frames as receivers send them to the firmware: SBUS and CRSF, both with 16 channels of 11 bits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from neuroflight.flash.link.msp import crc8_dvb_s2
from neuroflight.sim.board.peripherals.usart import CRSF, SBUS, Format
from neuroflight.toolchain.contract import (
    CHANNEL_COUNT,
    CRSF_SYNC,
    CRSF_TYPE_CHANNELS,
    SBUS_FOOTER,
    SBUS_FRAME_BYTES,
    SBUS_HEADER,
)

_ZERO_US, _BITS = 880, 11
_VALUE_MAX = (1 << _BITS) - 1


def sbus_frame(channels_us: Sequence[int]) -> bytes:
    """Encode the SBUS frame for CHANNEL_COUNT pulse widths [us].

    Those outside 880..2159 are sent as the nearer end; whole microseconds between come out as they went in.
    """
    frame = bytes([SBUS_HEADER]) + _packed(channels_us) + bytes([0, SBUS_FOOTER])
    assert len(frame) == SBUS_FRAME_BYTES
    return frame


def crsf_frame(channels_us: Sequence[int]) -> bytes:
    """Encode the CRSF frame for CHANNEL_COUNT pulse widths [us], which it carries as SBUS does."""
    body = bytes([CRSF_TYPE_CHANNELS]) + _packed(channels_us)
    return bytes([CRSF_SYNC, len(body) + 1]) + body + bytes([crc8_dvb_s2(body)])


def _packed(channels_us: Sequence[int]) -> bytes:
    """Pack channels in 22 bytes, the first channel's lowest bit first."""
    if len(channels_us) != CHANNEL_COUNT:
        raise ValueError(f"{len(channels_us)} channels, expected {CHANNEL_COUNT}")
    bits = 0
    for number, us in enumerate(channels_us):
        bits |= min(max(us - _ZERO_US, 0) * 8 // 5, _VALUE_MAX) << _BITS * number
    return bits.to_bytes(CHANNEL_COUNT * _BITS // 8, "little")


@dataclass(frozen=True)
class Receiver:
    """A receiver protocol on the serial line."""

    frame: Callable[[Sequence[int]], bytes]  # of channels [us]
    format: Format


RECEIVERS = {"sbus": Receiver(sbus_frame, SBUS), "crsf": Receiver(crsf_frame, CRSF)}
