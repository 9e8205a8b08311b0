"""The pilot's path of the board's image, executed on an emulated Cortex-M7, gives the host's bits.

test_same_bits.py flies the joined core as it is set by default; here are the other rates and protocols.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    CHANNEL_COUNT,
    DTCM,
    FLASH_BASE,
    FLASH_BYTES,
    ITCM,
    SRAM1,
    SRAM2,
    Region,
)
from neuroflight.toolchain.cortex_m7.emulator import CortexM7, load_program

MEMORY = (ITCM, Region("flash", FLASH_BASE, FLASH_BYTES), DTCM, SRAM1, SRAM2)
STRUCT_BYTES = 512  # struct receiver has some 210, struct rates 64
BYTES_MAX = 256
RATES_STYLES, PROTOCOLS = range(2), range(3)
Encode = Callable[..., bytes]


def changed(core: Any, **changes: float) -> Any:
    """The settings but for `changes`."""
    settings = core.new("struct nf_settings *")
    core.lib.settings_default(settings)
    for name, value in changes.items():
        setattr(settings, name, value)
    return settings


class Board:
    """Memory of the image in which the module under test lies."""

    def __init__(self, image: Path, core: Any, settings: Any) -> None:
        self.cpu = CortexM7(load_program(image), MEMORY)
        self.module, self.out = self.cpu.allocate(STRUCT_BYTES), self.cpu.allocate(64)
        self.settings, self.data = self.cpu.allocate(1024), self.cpu.allocate(BYTES_MAX)
        self.place, self.count = self.cpu.allocate(4), self.cpu.allocate(4)
        self.cpu.write(self.settings, bytes(core.ffi.buffer(settings)))

    def setpoint(self, channels: list[int]) -> bytes:
        self.cpu.write(self.data, np.array(channels, "<u2").tobytes())
        self.cpu.call("rates_setpoint", self.module, self.data, self.out)
        return self.cpu.read(self.out, 12)

    def push(self, data: bytes) -> list[bytes]:
        """The channels after each frame, and after the last byte."""
        self.cpu.write(self.data, data)
        self.cpu.write(self.place, self.data.to_bytes(4, "little"))
        self.cpu.write(self.count, len(data).to_bytes(4, "little"))
        seen = []
        more = True
        while more:
            more = self.cpu.call("receiver_push", self.module, self.place, self.count) & 0xFF != 0
            self.cpu.call("receiver_channels", self.module, self.out)
            seen.append(self.cpu.read(self.out, 2 * CHANNEL_COUNT))
        return seen


@pytest.mark.parametrize("style", RATES_STYLES)
@pytest.mark.parametrize("seed", range(3))
def test_the_boards_setpoints_are_the_hosts_bits_when_rates_are_random(
    board_image: Path, reference_core: Any, style: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    changes: dict[str, float] = {"rates_style": style}
    for axis in ("roll", "pitch", "yaw"):
        changes[f"{axis}_rate"] = rng.uniform(0.01, 3.0 if style else 1000)
        changes[f"{axis}_max"] = rng.uniform(0, 1 if style else 1600)
        changes[f"{axis}_expo"] = rng.uniform(0, 1)
    changes |= {"deadband_us": int(rng.integers(0, 101)), "yaw_deadband_us": int(rng.integers(0, 101))}
    settings = changed(reference_core, **changes)
    board, lib = Board(board_image, reference_core, settings), reference_core.lib
    rates, out = reference_core.new("struct rates *"), reference_core.new("float[3]")
    lib.rates_init(rates, settings)
    board.cpu.call("rates_init", board.module, board.settings)
    for us in range(980, 2021):
        channels = [us, 3000 - us, 1500, us + 1, *[1000] * 12]
        lib.rates_setpoint(rates, channels, out)
        assert board.setpoint(channels) == bytes(reference_core.ffi.buffer(out)), us


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_boards_channels_are_the_hosts_when_frames_are_mixed_with_noise(
    board_image: Path, reference_core: Any, sbus: Encode, crsf: Encode, protocol: int
) -> None:
    rng = np.random.default_rng(protocol)
    settings = changed(reference_core, receiver_protocol=protocol, interpolation=1, map_roll=3, map_yaw=0)
    board, lib = Board(board_image, reference_core, settings), reference_core.lib
    receiver = reference_core.new("struct receiver *")
    lib.receiver_init(receiver, settings, 4000)
    board.cpu.call("receiver_init", board.module, board.settings, 4000)
    channels, flown = reference_core.new("uint16_t[16]"), set()
    for _ in range(400):
        values = rng.integers(0, 2048, CHANNEL_COUNT).tolist()
        frame = sbus(values, failsafe=bool(rng.random() < 0.01), frame_lost=bool(rng.random() < 0.05))
        data = (frame, crsf(0x16, frame[1:23]), frame)[protocol]
        if rng.random() < 0.2:
            data = rng.integers(0, 256, rng.integers(0, 60), np.uint8).tobytes() + data
        if rng.random() < 0.2:
            data += crsf(0x14, bytes([1, 2, 77, *[0] * 7])) + data[: rng.integers(1, 20)]
        buffer = reference_core.new("uint8_t[]", data)
        place, count = (
            reference_core.new("const uint8_t **", buffer),
            reference_core.new("size_t *", len(data)),
        )
        expected, more = [], True
        while more:
            more = lib.receiver_push(receiver, place, count)
            lib.receiver_channels(receiver, channels)
            expected.append(bytes(reference_core.ffi.buffer(channels)))
        assert board.push(data) == expected
        flown.update(expected)
        for _ in range(int(rng.choice([16, 17, 36, 37, 500], p=[0.5, 0.2, 0.2, 0.09, 0.01]))):
            lib.receiver_tick(receiver)
            board.cpu.call("receiver_tick", board.module)
    assert len(flown) > 100 or protocol == 2, "the channels must have moved"
