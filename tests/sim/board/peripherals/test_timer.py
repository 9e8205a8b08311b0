"""Timers that count, and the frames that ESCs make of edges."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.devices.esc import Frame

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench


BIT = 360  # ticks of a 216 MHz timer, DShot600


def frame_bits(value: int, telemetry: bool = False) -> list[int]:
    """A DShot frame as the protocol describes it, most significant bit first."""
    data = value << 1 | telemetry
    frame = data << 4 | (data ^ data >> 4 ^ data >> 8) & 15
    return [frame >> 15 - i & 1 for i in range(16)]


def test_counter_counts_when_the_prescaler_divides(fast: Bench) -> None:
    fast.write("TIM3_PSC", 107)  # 1 MHz of 108
    fast.write("TIM3_ARR", 999)
    fast.write("TIM3_EGR", 1)
    fast.write("TIM3_SR", 0)
    fast.write("TIM3_CR1", 1)
    fast.context.run(250)
    assert fast.read("TIM3_CNT") == 250
    assert fast.get("TIM3_SR", "UIF") == 0
    fast.context.run(800)
    assert fast.read("TIM3_CNT") == 50
    assert fast.get("TIM3_SR", "UIF") == 1


def test_interrupt_comes_at_every_update_when_enabled(fast: Bench) -> None:
    fast.write("TIM3_ARR", 1079)  # 10 us
    fast.write("TIM3_EGR", 1)
    fast.write("TIM3_SR", 0)
    fast.write("TIM3_DIER", 1)
    fast.write("TIM3_CR1", 1)
    fast.context.run(0.1)
    for _ in range(3):
        fast.context.run(9.8)
        assert not fast.context.asserted("TIM3")
        fast.context.run(0.2)
        assert fast.context.asserted("TIM3")
        fast.write("TIM3_SR", 0)
        assert not fast.context.asserted("TIM3")


@pytest.mark.parametrize(
    ("register", "message"),
    [
        ("TIM8_CCER", "TIM8_CCER enables outputs, which the emulator does not model"),
        ("TIM8_DMAR", "TIM8_DMAR is written: the emulator does not model bursts"),
    ],
)
def test_what_timers_do_not_do_here_is_refused(fast: Bench, register: str, message: str) -> None:
    fast.write(register, 0)
    with pytest.raises(BoardError, match=message):
        fast.write(register, 1)


def test_stream_is_refused_when_it_feeds_the_timers_own_registers(fast: Bench) -> None:
    with pytest.raises(BoardError, match="is driven by TIM8_UP, but its peripheral address is TIM8_CCR1"):
        fast.stream("DMA2_S1", fast.address("TIM8_CCR1"), 0x20013000, 4, 7 << 25 | 2 << 13 | 2 << 11 | 1 << 6)


# The decoder alone


def edges(bits: Sequence[int], begin: int = 100_000, bit: int = BIT) -> list[int]:
    """Edges on a line that rests low."""
    return [
        begin + i * bit + part
        for i, one in enumerate(bits)
        for part in (0, bit * 3 // 4 if one else bit * 3 // 8)
    ]


@pytest.mark.parametrize("value", [0, 1, 47, 48, 1047, 2047])
@pytest.mark.parametrize("protocol", [150, 300, 600])
def test_every_value_is_decoded_when_it_is_the_first(bench: Bench, value: int, protocol: int) -> None:
    frames: list[Frame] = []
    bench.hardware.hear_frames(frames.append)
    bit = BIT * 600 // protocol
    bench.hardware.escs[0].take(edges(frame_bits(value, value % 2 == 1), bit=bit), rest=False)
    bench.hardware.native.tell_frames()
    assert frames == [Frame(1, 100_000 + 16 * bit, value, value % 2 == 1, protocol)]


@pytest.mark.parametrize(
    ("bits", "spoil", "message"),
    [
        (frame_bits(48)[:15], {}, "motor 3: a frame breaks off in its bit 15, expected 16 bits"),
        ([*frame_bits(48)[:15], 1 - frame_bits(48)[15]], {}, "motor 3: frame 0x.* has the checksum"),
        (
            frame_bits(0),
            {1: 45},
            r"bit 1 is high for 0\.833 us, expected 0\.528 us to 0\.640 us for a 0 or 1\.055 us to 1\.313 us",
        ),
        (
            frame_bits(0),
            {10: 20, 11: 20},
            r"bit 6 begins 0\.093 us too late, expected bits of 1\.667 us each",
        ),
    ],
)
def test_frame_is_refused_when_an_esc_would_not_take_it(
    bench: Bench, bits: list[int], spoil: dict[int, int], message: str
) -> None:
    late = [cycle + spoil.get(i, 0) for i, cycle in enumerate(edges(bits))]
    with pytest.raises(BoardError, match=message):
        bench.hardware.escs[2].take(late, rest=False)
