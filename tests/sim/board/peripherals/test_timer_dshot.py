"""Timers with DMA at their beat, and the frames that ESCs make of the pulses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.devices.esc import Frame

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench


SLOTS = 0x20013000
BIT = 360  # ticks of a 216 MHz timer, DShot600


def frame_bits(value: int, telemetry: bool = False) -> list[int]:
    """A DShot frame as the protocol describes it, most significant bit first."""
    data = value << 1 | telemetry
    frame = data << 4 | (data ^ data >> 4 ^ data >> 8) & 15
    return [frame >> 15 - i & 1 for i in range(16)]


def start_tim8(bench: Bench, bit: int = BIT) -> None:
    bench.write("TIM8_ARR", bit - 1)
    bench.write("TIM8_CCMR1", 0x6868)  # PWM mode 1 with preload
    bench.write("TIM8_CCMR2", 0x6868)
    bench.write("TIM8_DCR", 3 << 8 | 13)
    bench.write("TIM8_EGR", 1)
    bench.write("TIM8_CCER", 0x1111)
    bench.set("TIM8_BDTR", MOE=1)
    bench.write("TIM8_CR1", 0x81)
    for pin in ("PC6", "PC7", "PC8", "PC9"):
        bench.alternate(pin, 3)
    bench.write("DMA2_S1PAR", 0x4001044C)


def send(bench: Bench, values: Sequence[int], bit: int = BIT, tail: int = 2) -> None:
    """As a driver sends a frame to four motors: slots by DMA burst, the counter begun anew."""
    slots = [
        (bit * 3 // 4 if frame_bits(value)[i] else bit * 3 // 8) if i < 16 else 0
        for i in range(16 + tail)
        for value in values
    ]
    bench.context.set_memory(SLOTS, b"".join(s.to_bytes(4, "little") for s in slots))
    bench.set("TIM8_DIER", UDE=0)
    bench.write("TIM8_CNT", 0)
    bench.write("DMA2_LIFCR", 0x3D << 6)
    bench.write("DMA2_S1M0AR", SLOTS)
    bench.write("DMA2_S1NDTR", len(slots))
    bench.write("DMA2_S1CR", 7 << 25 | 3 << 16 | 2 << 13 | 2 << 11 | 1 << 10 | 1 << 6)
    bench.set("DMA2_S1CR", EN=1)
    bench.set("TIM8_DIER", UDE=1)


def listen(bench: Bench) -> list[Frame]:
    frames: list[Frame] = []
    bench.hardware.hear_frames(frames.append)
    return frames


def test_motors_get_their_values_when_a_frame_is_sent(fast: Bench) -> None:
    frames = listen(fast)
    start_tim8(fast)
    begin = fast.context.cycle
    send(fast, (48, 1047, 2047, 0))
    fast.context.run(100)
    assert [(f.motor, f.value, f.telemetry, f.protocol) for f in frames] == [
        (1, 48, False, 600), (2, 1047, False, 600), (3, 2047, False, 600), (4, 0, False, 600),
    ]  # fmt: skip
    # What DMA writes at one update takes effect at the next: the first bit begins after two.
    assert {f.cycle for f in frames} == {begin + (2 + 16) * BIT}
    assert fast.get("DMA2_S1CR", "EN") == 0
    assert fast.get("DMA2_LISR", "TCIF1") == 1


def test_frames_follow_each_other_when_sent_again_and_again(fast: Bench) -> None:
    frames = listen(fast)
    start_tim8(fast)
    for value in range(100, 105):
        send(fast, (value, value + 10, value + 20, value + 30))
        fast.context.run(250)
    assert [f.value for f in frames] == [v + 10 * i for v in range(100, 105) for i in range(4)]


@pytest.mark.parametrize(
    ("bit", "spoil", "message"),
    [
        (396, {}, r"motor 1: a bit lasts 1\.833 us"),
        (BIT, {4 * 10 + 2: 135}, "motor 3: frame 0x.* has the checksum"),
        (BIT, {4 * 7 + 1: 190}, r"motor 2: bit 8 is high for 0\.880 us"),
        (BIT, {4 * 9 + 3: 0}, "motor 4: a frame breaks off in its bit 9, expected 16 bits"),
    ],
)
def test_frame_is_refused_when_only_a_later_one_is_wrong(
    fast: Bench, bit: int, spoil: dict[int, int], message: str
) -> None:
    frames = listen(fast)
    start_tim8(fast)
    for _ in range(3):
        send(fast, (99, 99, 99, 99))
        fast.context.run(250)
    fast.write("TIM8_ARR", bit - 1)
    send(fast, (99, 99, 99, 99), bit)
    for slot, ticks in spoil.items():
        fast.context.set_memory(SLOTS + 4 * slot, ticks.to_bytes(4, "little"))
    with pytest.raises(BoardError, match=message):
        fast.context.run(250)
    assert len(frames) >= 12


def test_frame_is_refused_when_the_main_output_goes_off(fast: Bench) -> None:
    frames = listen(fast)
    start_tim8(fast)
    send(fast, (99, 99, 99, 99))
    fast.context.run(250)
    fast.set("TIM8_BDTR", MOE=0)
    fast.context.run(250)  # nothing to send: nothing wrong
    send(fast, (99, 99, 99, 99))
    with pytest.raises(BoardError, match="TIM8_CH1 makes pulses while TIM8_BDTR MOE is 0, expected 1"):
        fast.context.run(250)
    assert len(frames) == 4


def test_esc_takes_another_protocol_when_the_supply_was_gone(fast: Bench) -> None:
    frames = listen(fast)
    start_tim8(fast)
    send(fast, (99, 99, 99, 99))
    fast.context.run(250)
    fast.reset("power")
    fast.full_speed()
    start_tim8(fast, 2 * BIT)
    send(fast, (99, 99, 99, 99), 2 * BIT)
    fast.context.run(250)
    assert [f.protocol for f in frames] == [600] * 4 + [300] * 4


def test_stream_is_busy_until_the_line_rests_when_asked_meanwhile(fast: Bench) -> None:
    frames = listen(fast)
    start_tim8(fast)
    begin = fast.context.cycle
    send(fast, (100, 100, 100, 100))
    fast.context.run_to(begin + 18 * BIT - 1)
    assert fast.get("DMA2_S1CR", "EN") == 1
    assert fast.read("DMA2_S1NDTR") == 4
    assert frames == []
    fast.context.run_to(begin + 18 * BIT)
    assert fast.get("DMA2_S1CR", "EN") == 0
    assert len(frames) == 4


def test_frames_are_the_same_when_somebody_looks_at_every_bit(fast: Bench, make_bench: type[Bench]) -> None:
    other = make_bench()
    other.full_speed()
    seen = []
    for bench, looks in ((fast, 1), (other, 100)):
        frames = listen(bench)
        start_tim8(bench)
        begin = bench.context.cycle
        send(bench, (48, 1047, 2047, 0))
        for i in range(looks):
            bench.context.run_to(begin + (i + 1) * 20_000 // looks)
            bench.read("DMA2_S1NDTR")
        seen.append([(f.motor, f.value, f.cycle - begin) for f in frames])
    assert seen[0] == seen[1]
    assert len(seen[0]) == 4


@pytest.mark.parametrize(
    ("bit", "message"),
    [
        (396, r"motor 1: a bit lasts 1\.833 us, expected 1\.667 us \(DShot600\) within 5%"),
        (324, r"motor 1: a bit lasts 1\.500 us"),
    ],
)
def test_frame_is_refused_when_its_bits_are_10_percent_off(fast: Bench, bit: int, message: str) -> None:
    fast.hardware.escs[0].protocol = 600
    start_tim8(fast, bit)
    send(fast, (48, 48, 48, 48), bit)
    with pytest.raises(BoardError, match=message):
        fast.context.run(100)


def test_frame_is_refused_when_its_pin_is_not_the_timers(fast: Bench) -> None:
    start_tim8(fast)
    fast.set("GPIOC_MODER", MODER8=1)
    send(fast, (48, 48, 48, 48))
    with pytest.raises(
        BoardError, match="TIM8 makes pulses on channel 3: PC8 is an output, expected alternate"
    ):
        fast.context.run(100)


def test_pulses_without_end_are_refused_when_the_line_never_rests(fast: Bench) -> None:
    start_tim8(fast)
    send(fast, (48, 48, 48, 48), tail=0)
    with pytest.raises(
        BoardError, match=r"motor 1: 0\.000 us of rest before a frame, expected 2 bits or more \(3\.333 us\)"
    ):
        fast.context.run(100)
        fast.read("TIM8_CNT")


def test_frame_shifts_by_a_bit_when_the_request_was_pending(fast: Bench) -> None:
    """Updates before the stream is enabled leave a request behind, served at once."""
    frames = listen(fast)
    start_tim8(fast)
    fast.set("TIM8_DIER", UDE=1)
    fast.context.run(10)
    fast.set("TIM8_DIER", UDE=1)
    begin = fast.context.cycle
    fast.write("TIM8_CNT", 0)
    fast.context.set_memory(SLOTS, b"".join((135 if i < 64 else 0).to_bytes(4, "little") for i in range(72)))
    fast.write("DMA2_S1M0AR", SLOTS)
    fast.write("DMA2_S1NDTR", 72)
    fast.write("DMA2_S1CR", 7 << 25 | 2 << 13 | 2 << 11 | 1 << 10 | 1 << 6)
    fast.set("DMA2_S1CR", EN=1)
    fast.context.run(100)
    assert [f.cycle for f in frames] == [begin + 17 * BIT] * 4


def test_timer1_feeds_its_channel_when_compare_requests_come_at_update(fast: Bench) -> None:
    frames = listen(fast)
    fast.alternate("PA8", 1)
    fast.write("TIM1_ARR", 719)  # DShot300
    fast.write("TIM1_CCMR1", 0x68)
    fast.write("TIM1_CR2", 8)  # CCDS
    fast.write("TIM1_EGR", 1)
    fast.write("TIM1_CCER", 1)
    fast.set("TIM1_BDTR", MOE=1)
    fast.write("TIM1_CR1", 0x81)
    slots = [540 if bit else 270 for bit in frame_bits(1234, True)] + [0, 0]
    fast.context.set_memory(SLOTS, b"".join(s.to_bytes(4, "little") for s in slots))
    fast.stream("DMA2_S6", fast.address("TIM1_CCR1"), SLOTS, 18, 2 << 13 | 2 << 11 | 1 << 10 | 1 << 6)
    fast.set("TIM1_DIER", CC1DE=1)
    fast.context.run(100)
    assert [(f.motor, f.value, f.telemetry, f.protocol) for f in frames] == [(6, 1234, True, 300)]


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


def test_compare_waits_for_the_update_when_preloaded(fast: Bench) -> None:
    seen: list[list[int]] = []
    fast.hardware.native.on_train = lambda motor, edges, rest: seen.append([motor, *edges])
    start_tim8(fast)
    begin = fast.context.cycle
    fast.context.run_to(begin + 1000)
    fast.write("TIM8_CCR1", 100)
    fast.context.run_to(begin + 1300)
    fast.write("TIM8_CCR1", 0)
    fast.context.run_to(begin + 10_000)
    fast.write("TIM8_CCR1", 1)  # a second pulse, that shows the first
    fast.context.run(10)
    fast.read("TIM8_CNT")
    assert seen == [[0, begin + 1080, begin + 1180]]


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
