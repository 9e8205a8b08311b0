"""Inputs of the receiver's targets that mean something: what receivers send, and what goes wrong then."""

from __future__ import annotations

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import CHANNEL_COUNT

FRAME = 0x80  # the content of a true frame
GAP, LOST, RECOVERED = 14, 0x40 | 0x3F, 0x40 | 0x20  # samples before a piece; times 8 with bit 6
CENTRE, LOW, HIGH = 992, 172, 1811  # of a channel's 11 bits: 1500, 988, 2012 us


def piece(data: bytes, *, after: int = GAP, frame: bool = False) -> bytes:
    """One piece of an input, as receiver.c takes it."""
    return bytes([after | (FRAME if frame else 0), len(data)]) + data


def packed(values: list[int]) -> bytes:
    """16 values of 11 bits: one long little-endian number."""
    return sum(value << 11 * index for index, value in enumerate(values)).to_bytes(22, "little")


def sticks(**channel: int) -> bytes:
    """Centred channels but for those given (c4=HIGH, ...)."""
    values = [CENTRE] * CHANNEL_COUNT
    for name, value in channel.items():
        values[int(name[1:])] = value
    return packed(values)


def sbus(channels: bytes, flags: int = 0, footer: int = contract.SBUS_FOOTER) -> bytes:
    """A whole frame."""
    return bytes([contract.SBUS_HEADER]) + channels + bytes([flags, footer])


def sbus_seeds() -> dict[str, bytes]:
    """Each flag, each footer, the switch, and frames that are none."""
    good, lost, failsafe = sticks(), contract.SBUS_FLAG_FRAME_LOST, contract.SBUS_FLAG_FAILSAFE
    seeds = {
        "centred": piece(sbus(good)),
        "low": piece(sbus(packed([0] * CHANNEL_COUNT))),
        "high": piece(sbus(packed([2047] * CHANNEL_COUNT))),
        "frame_lost": piece(sbus(good)) + piece(sbus(good, lost)) * 3,
        "failsafe_once": piece(sbus(good), after=RECOVERED) + piece(sbus(good, failsafe)) + piece(sbus(good)),
        "failsafe": piece(sbus(good), after=RECOVERED) + piece(sbus(good, failsafe)) * 4,
        "both_flags": piece(sbus(good, lost | failsafe)) * 3,
        "digital_channels": piece(sbus(good, 3)) * 2,
        "recovery": piece(sbus(good)) * 60,
        "silence": piece(sbus(good)) * 60 + piece(sbus(good), after=LOST) * 3,
        "arm_off_on": b"".join(
            piece(sbus(sticks(c4=arm)), frame=False) for arm in [LOW] * 55 + [HIGH] * 3 + [LOW] * 3
        ),
        "two_in_a_piece": piece(sbus(good) * 4),
        "without_gap": piece(sbus(good), after=0) * 8,
        "cut": piece(sbus(good)[:13], after=0) + piece(sbus(good)[13:], after=1),
        "cut_by_a_gap": piece(sbus(good)[:13], after=0) + piece(sbus(good)[13:], after=5),
        "first_byte_missing": piece((sbus(good) * 4)[1:]),
        "headers_only": piece(bytes([contract.SBUS_HEADER]) * 200),
        "header_inside": piece(sbus(packed([0x7F, 0x1E1, *[CENTRE] * 14])) * 3, after=0),
        "unused_flags": piece(sbus(good, 0xF0)) + piece(sbus(good)),
        "content": piece(good, frame=True) * 3,
        "content_flags": piece(good + bytes([failsafe]), frame=True) * 3,
        "nothing": b"",
        "noise": piece(bytes(range(251))),
    }
    for number, footer in enumerate((0x04, 0x08, 0x14, 0x24, 0x34, 0x44)):
        seeds[f"footer{number}"] = piece(sbus(good, footer=footer)) * 2
    return seeds


def crc8(data: bytes) -> int:
    """CRC-8/DVB-S2."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ (contract.CRC8_DVB_S2_POLY if crc & 0x80 else 0)) & 0xFF
    return crc


def crsf(kind: int, payload: bytes) -> bytes:
    """A whole frame."""
    body = bytes([kind]) + payload
    return bytes([contract.CRSF_SYNC, len(body) + 1]) + body + bytes([crc8(body)])


def crsf_seeds() -> dict[str, bytes]:
    """Each type that is used, some that are not, each length, and frames that are none."""
    good, link = contract.CRSF_TYPE_CHANNELS, contract.CRSF_TYPE_LINK
    frame, told = crsf(good, sticks()), crsf(link, bytes([60, 61, 93, 10, 0, 2, 1, 70, 90, 5]))
    seeds = {
        "centred": piece(frame),
        "low": piece(crsf(good, packed([0] * CHANNEL_COUNT))),
        "high": piece(crsf(good, packed([2047] * CHANNEL_COUNT))),
        "link": piece(told) + piece(frame) + piece(told),
        "link_none": piece(crsf(link, bytes(10))) + piece(frame),
        "link_above_100": piece(crsf(link, bytes([255] * 10))) + piece(frame),
        "link_short": piece(crsf(link, bytes(9))),
        "link_long": piece(crsf(link, bytes(20))),
        "recovery": piece(frame, after=4) * 120,
        "silence": piece(frame, after=4) * 120 + piece(frame, after=LOST) * 3,
        "arm_off_on": b"".join(
            piece(crsf(good, sticks(c4=arm))) for arm in [LOW] * 55 + [HIGH] * 3 + [LOW] * 3
        ),
        "two_in_a_piece": piece(frame + told + frame),
        "without_gap": piece(frame, after=0) * 8,
        "cut": piece(frame[:9], after=0) + piece(frame[9:], after=1),
        "cut_by_a_gap": piece(frame[:9], after=0) + piece(frame[9:], after=5),
        "first_byte_missing": piece((frame * 4)[1:]),
        "bad_checksum": piece(frame[:-1] + bytes([frame[-1] ^ 1]), after=0) + piece(frame, after=0),
        "syncs_only": piece(bytes([contract.CRSF_SYNC]) * 200),
        "frames_in_a_frame": piece(bytes([contract.CRSF_SYNC, 62]) + frame * 3, after=0),
        "channels_short": piece(crsf(good, sticks()[:-1])),
        "channels_long": piece(crsf(good, sticks() + b"\0")),
        "longest": piece(crsf(good, bytes(60))) + piece(frame),
        "too_long": piece(bytes([contract.CRSF_SYNC, 63]) + bytes(64)) + piece(frame),
        "too_short": piece(bytes([contract.CRSF_SYNC, 1, 0])) + piece(frame),
        "content": piece(bytes([good]) + sticks(), frame=True) * 3,
        "content_link": piece(bytes([link]) + bytes(10), frame=True) * 3,
        "nothing": b"",
        "noise": piece(bytes(range(251))),
    }
    for kind in (0x02, 0x08, 0x1E, 0x21, 0x28, 0x29, 0x2D, 0x32, 0x7A):  # of the ecosystem, not of ours
        seeds[f"type_{kind:02x}"] = piece(crsf(kind, bytes(range(12)))) + piece(frame)
    return seeds
