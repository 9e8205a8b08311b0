"""What reads and writes flash under the sanitizers: random requests, random flash contents, power cuts."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.link import requests
from neuroflight.flash.link.msp import Direction, Message, Version, encode
from neuroflight.toolchain.contract import (
    FLASH_BASE,
    FLASH_FAULT_RECORD,
    FLASH_POLICY_SLOTS,
    FLASH_SETTINGS,
    SETTINGS,
    Msp,
)
from neuroflight.toolchain.policy.blob import PolicyBlob, pack
from tests.firmware.fuzz.build import sanitized

FEED = Path(__file__).parents[1] / "sanitized" / "store.c"
PIECES = 3000


@pytest.fixture(scope="module")
def feed() -> Path:
    """The feeding program around what stores and the scripted policy."""
    return sanitized().link("store", FEED)


def ask(command: int, payload: bytes = b"") -> bytes:
    return encode(Message(Version.V2, Direction.REQUEST, command, payload))


def request(rng: np.random.Generator, blob: PolicyBlob) -> bytes:
    """A request that means something, now and then with a payload that does not."""
    data = pack(replace(blob, sequence=int(rng.integers(1, 40))))
    index = int(rng.integers(0, len(SETTINGS) + 2))
    choices = [
        ask(Msp.SETTING_INFO, requests.setting_index(index)),
        ask(Msp.SETTING_GET, requests.setting_index(index)),
        ask(Msp.SETTING_SET, requests.setting_index(index) + rng.bytes(4)),
        ask(Msp.SETTING_SET, requests.setting_set(index, int(rng.integers(0, 6)), kind="uint32_t")),
        ask(Msp.EEPROM_WRITE),
        ask(Msp.FAULTS),
        ask(Msp.FAULTS, requests.acknowledge(int(rng.integers(0, 10)))),
        ask(Msp.TASKS),
        ask(Msp.SET_RAW_RC, rng.bytes(int(rng.integers(0, 40)))),
        ask(Msp.SET_MOTOR, rng.bytes(int(rng.integers(0, 20)))),
        ask(Msp.POLICY_INFO),
        ask(Msp.POLICY_SLOT_END),
        ask(Msp.POLICY_SLOT_WRITE, rng.bytes(4) + bytes(8)),
        ask(Msp.POLICY_SLOT_BEGIN, requests.slot_begin(len(data)))
        + ask(Msp.POLICY_SLOT_WRITE, requests.slot_write(0, data[:500]))
        + ask(Msp.POLICY_SLOT_WRITE, requests.slot_write(500, data[500:]))
        + ask(Msp.POLICY_SLOT_END),
        ask(int(rng.choice(list(Msp))), rng.bytes(int(rng.integers(0, 64)))),
    ]
    return choices[rng.integers(len(choices))]


def pieces(seed: int, blob: PolicyBlob) -> tuple[bytes, int]:
    """What to feed, and how many boots it asks for."""
    rng = np.random.default_rng(seed)
    regions = [*FLASH_SETTINGS, FLASH_FAULT_RECORD, *FLASH_POLICY_SLOTS]
    out, boots = b"", 0
    for _ in range(PIECES):
        draw = rng.random()
        if draw < 0.7:
            kind, piece = b"M", request(rng, blob)
        elif draw < 0.8:
            kind, piece, boots = b"F", b"", boots + 1
        elif draw < 0.9:
            kind, piece = b"C", rng.bytes(3)
        else:
            region = regions[rng.integers(len(regions))]
            at = region.address - FLASH_BASE + int(rng.integers(0, 64)) * int(rng.integers(0, 8))
            kind, piece = b"F", at.to_bytes(4, "little") + rng.bytes(int(rng.integers(1, 9)))
        if rng.random() < 0.1 and kind == b"M":
            damaged = bytearray(piece)
            damaged[rng.integers(len(damaged))] ^= 1 << rng.integers(8)
            piece = bytes(damaged)
        out += kind + len(piece).to_bytes(2, "little") + piece
    return out, boots


@pytest.mark.parametrize("seed", range(3))
def test_no_sanitizer_speaks_when_requests_and_flash_are_wild(
    feed: Path, scripted_policy_blob: PolicyBlob, seed: int
) -> None:
    data, boots = pieces(seed, scripted_policy_blob)
    done = subprocess.run([str(feed)], input=data, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    replies, sets, policies = map(int, done.stdout.split())
    assert replies > PIECES / 3
    assert sets > 20, "settings were saved and found again"
    assert 50 < policies < boots, "some boots find a policy, and some slots hold none"
