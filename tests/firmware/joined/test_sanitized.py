"""The core under the address and undefined-behaviour sanitizers, fed with arbitrary bytes."""

from __future__ import annotations

import subprocess
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuroflight.toolchain import contract
from neuroflight.toolchain.policy.blob import PolicyBlob, blob_terms, pack
from tests.firmware.fuzz.build import sanitized

FEED = Path(__file__).parents[1] / "sanitized" / "feed.c"
MSP_REQUESTS = (b"$M<\x00\x01\x01", b"$M<\x00\x04\x04", b"$M<\x00\x96\x96", b"$X<\x00\x01\x4e\x00\x00\xcf")


@pytest.fixture(scope="module")
def feed() -> Path:
    """The feeding program around the core and the scripted policy."""
    return sanitized().link("feed", FEED)


SMALLEST_BLOB = PolicyBlob(
    sequence=1,
    architecture_hash=1,
    filters_hash=contract.POLICY_FILTERS_NONE,
    control_rate_hz=1000,
    terms=blob_terms(contract.observation_blocks("throttle"), 1000),
    aircraft="nf1",
    aircraft_sha256="0" * 64,
    policy_sha256="0" * 64,
    idle=0.0,
    weights=np.ones(1, np.float32),
    selftest_observation=np.zeros((1, 1), np.float32),
    selftest_action=np.zeros((1, 1), np.float32),
    selftest_steps=1,
)


def pieces(seed: int, sbus: Callable[..., bytes]) -> list[bytes]:
    """Noise, true frames and requests, and the same with a few bits flipped."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(4000):
        kind = rng.integers(4)
        if kind == 0:
            piece = rng.integers(0, 256, rng.integers(0, 200), np.uint8).tobytes()
        elif kind == 1:
            piece = sbus(rng.integers(0, 2048, 16).tolist(), failsafe=bool(rng.random() < 0.05))
        elif kind == 2:
            piece = MSP_REQUESTS[rng.integers(len(MSP_REQUESTS))] * int(rng.integers(1, 5))
        else:
            piece = b"$X<\x00" + rng.integers(0, 256, 4, np.uint8).tobytes() + b"$M<\xff\x01"
        damaged = bytearray(piece)
        if damaged and rng.random() < 0.3:
            damaged[rng.integers(len(damaged))] ^= 1 << rng.integers(8)
        out.append(bytes(damaged))
    return out


@pytest.mark.parametrize("seed", range(3))
def test_no_sanitizer_speaks_when_bytes_are_wild(feed: Path, sbus: Callable[..., bytes], seed: int) -> None:
    given = pieces(seed, sbus)
    stream = b"".join(len(piece).to_bytes(2, "little") + piece for piece in given)
    done = subprocess.run([str(feed)], input=stream, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    samples, replies, _ = map(int, done.stdout.split())
    assert samples == len(given)
    assert replies > 100, "some of the requests must have got through"


def resealed(data: bytes) -> bytes:
    """`data` with the CRC that belongs to it."""
    return data[:-4] + zlib.crc32(data[:-4]).to_bytes(4, "little")


def test_no_sanitizer_speaks_when_blobs_are_cut_damaged_or_lie(feed: Path) -> None:
    good = pack(SMALLEST_BLOB)
    rng = np.random.default_rng(4)
    given = [good, good + b"slot"] + [good[:length] for length in range(len(good))]
    for index in range(len(good)):
        for value in (0x00, 0xFF, int(rng.integers(256))):
            damaged = good[:index] + bytes([value]) + good[index + 1 :]
            given += [damaged, resealed(damaged)]
    for _ in range(2000):
        noise = bytearray(good[:6] + rng.integers(0, 256, len(good) - 6, np.uint8).tobytes())
        for offset in range(6, 52):  # most sizes as they should be, so that the others are reached
            if rng.random() < 0.95:
                noise[offset] = good[offset]
        given.append(resealed(bytes(noise)))
    stream = b"".join(len(piece).to_bytes(2, "little") + piece for piece in given)
    done = subprocess.run([str(feed)], input=stream, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    samples, _, blobs = map(int, done.stdout.split())
    assert samples == len(given)
    assert 100 < blobs < len(given) / 2, "good ones are taken, and what does not change their figures"
