"""The receiver of each protocol under the sanitizers: true frames, mutated ones and noise, 10^5 in all."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.toolchain.contract import CHANNEL_COUNT, CRC8_DVB_S2_POLY
from tests.firmware.fuzz.build import sanitized

FEED = Path(__file__).parents[1] / "sanitized" / "feed_receiver.c"
PIECES = 100_000
Bytes = NDArray[np.uint8]


@pytest.fixture(scope="module")
def feed() -> Path:
    """The feeding program."""
    return sanitized().link("feed_receiver", FEED)


def crc(rows: Bytes) -> Bytes:
    """CRC-8/DVB-S2 of each row."""
    value = np.zeros(len(rows), np.uint8)
    for column in rows.T:
        value = value ^ column
        for _ in range(8):
            value = (value << 1) ^ np.where(value & 0x80, np.uint8(CRC8_DVB_S2_POLY), np.uint8(0))
    return value


def sbus_frames(rng: np.random.Generator, count: int) -> Bytes:
    """Any 22 bytes are 16 channels."""
    frames = rng.integers(0, 256, (count, 25), np.uint8)
    frames[:, 0], frames[:, 24] = 0x0F, 0
    frames[:, 23] = rng.choice([0, 4, 8, 3], count, p=[0.9, 0.05, 0.01, 0.04])
    return frames


def crsf_frames(rng: np.random.Generator, count: int, kind: int, payload: int) -> Bytes:
    frames = rng.integers(0, 256, (count, payload + 4), np.uint8)
    frames[:, :3] = (0xC8, payload + 2, kind)
    frames[:, -1] = crc(frames[:, 2:-1])
    return frames


def msp_channels(rng: np.random.Generator, count: int) -> Bytes:
    """16 numbers of 16 bits, most of them pulses."""
    return rng.integers(740, 2252, (count, CHANNEL_COUNT)).astype("<u2").view(np.uint8)


def pieces(seed: int) -> list[bytes]:
    rng = np.random.default_rng(seed)
    kinds = [
        sbus_frames(rng, PIECES),
        crsf_frames(rng, PIECES, 0x16, 22),
        crsf_frames(rng, PIECES, 0x14, 10),
        crsf_frames(rng, PIECES, 0x7A, 60),
        msp_channels(rng, PIECES),
        np.where(rng.random((PIECES, 64)) < 0.3, 0xC8, rng.integers(0, 256, (PIECES, 64), np.uint8)).astype(
            np.uint8
        ),
        np.where(rng.random((PIECES, 64)) < 0.3, 0x0F, rng.integers(0, 128, (PIECES, 64), np.uint8)).astype(
            np.uint8
        ),
    ]
    choice = rng.choice(len(kinds), PIECES, p=[0.3, 0.3, 0.05, 0.05, 0.1, 0.1, 0.1])
    flips, cuts = rng.random(PIECES) < 0.2, rng.random(PIECES) < 0.1
    places = rng.integers(0, 1 << 30, PIECES)
    gaps = rng.choice([0, 1, 2, 7, 120], PIECES, p=[0.3, 0.3, 0.2, 0.195, 0.005])
    out = []
    for index, kind in enumerate(choice.tolist()):
        piece = bytearray(kinds[kind][index].tobytes())
        place = int(places[index])
        if flips[index]:
            piece[place % len(piece)] ^= 1 << (place >> 8) % 8
        if cuts[index]:
            del piece[place % len(piece) :]
        out.append(len(piece).to_bytes(2, "little") + bytes([int(gaps[index])]) + bytes(piece))
    return out


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 11))])
def test_no_sanitizer_speaks_and_all_stays_in_range_when_frames_are_mutated(feed: Path, seed: int) -> None:
    done = subprocess.run([str(feed)], input=b"".join(pieces(seed)), capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    for protocol, line in zip(("sbus", "crsf", "msp"), done.stdout.splitlines(), strict=True):
        given, frames, good = map(int, line.split())
        assert given == PIECES
        assert frames > 1000, f"{protocol}: the true ones must have got through"
        assert good > 1000 or protocol == "msp", f"{protocol}: and the link must have been good"
