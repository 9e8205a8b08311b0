"""Ports written and sampled by DMA at a timer's beat: motors' frames, and what ESCs answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.devices.esc import AnswerFaults, Frame
from tests.sim.board.peripherals.test_timer import frame_bits

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench

WORDS, SAMPLES = 0x20013000, 0x20003000  # SRAM1, DTCM
SLOT = 120  # a third of a DShot600 bit [cycles]
TO_PORT = 6 << 25 | 2 << 13 | 2 << 11 | 1 << 10 | 1 << 6
FROM_PORT = 6 << 25 | 1 << 13 | 1 << 11 | 1 << 10
STREAMS = ("DMA2_S6", "DMA2_S4", "DMA2_S1")  # of TIM1's compare channels
CHANNELS = (3, 4, 1)
CLEAR = {
    "DMA2_S6": ("DMA2_HIFCR", 0x3D << 16),
    "DMA2_S4": ("DMA2_HIFCR", 0x3D),
    "DMA2_S1": ("DMA2_LIFCR", 0x3D << 6),
}
# GCR of the nibbles (Betaflight's and AM32's tables say the same)
CODES = (25, 27, 18, 19, 29, 21, 22, 23, 26, 9, 10, 11, 30, 13, 14, 15)


class Ports:
    """A driver of up to three ports, each behind a compare channel of TIM1."""

    def __init__(self, bench: Bench, ports: str = "C", *, inverted: bool = False, slot: int = SLOT) -> None:
        self.bench, self.ports, self.inverted = bench, ports, inverted
        bench.set("RCC_AHB1ENR", GPIOEEN=1)
        self.turn(1)
        bench.write("TIM1_ARR", slot - 1)
        for channel in range(1, 5):
            bench.write(f"TIM1_CCR{channel}", 10)
        bench.write("TIM1_EGR", 1)
        bench.write("TIM1_CR1", 1)
        bench.context.run(100)  # the lines rest

    def pins(self, port: str) -> list[int]:
        return [esc.pin.number for esc in self.bench.hardware.escs if esc.pin.port == port]

    def turn(self, mode: int) -> None:
        """Make the pins outputs (1) at rest, or inputs (0) with pull-ups."""
        for port in self.ports:
            for pin in self.pins(port):
                self.bench.write(f"GPIO{port}_BSRR", 1 << pin + (0 if self.inverted else 16))
                self.bench.set(f"GPIO{port}_PUPDR", **{f"PUPDR{pin}": int(self.inverted)})
                self.bench.set(f"GPIO{port}_MODER", **{f"MODER{pin}": mode})

    def words(self, port: str, values: Sequence[int]) -> list[int]:
        """Three words a bit for BSRR: all begin, zeros end, all end."""
        found: list[int] = []
        mine = [
            (esc.pin.number, frame_bits(value))
            for esc, value in zip(self.bench.hardware.escs, values, strict=False)
            if esc.pin.port == port
        ]
        if self.inverted:  # the checksum is the last nibble
            mine = [(pin, [*bits[:12], *(1 - bit for bit in bits[12:])]) for pin, bits in mine]
        begin, end = (16, 0) if self.inverted else (0, 16)
        for i in range(16):
            found.append(sum(1 << pin + begin for pin, _ in mine))
            found.append(sum(1 << pin + end for pin, bits in mine if not bits[i]))
            found.append(sum(1 << pin + end for pin, _ in mine))
        return [*found, 0]

    def start(self, place: int, port: str, register: str, memory: int, count: int, options: int) -> None:
        bench, stream = self.bench, STREAMS[place]
        bench.write(*CLEAR[stream])
        bench.stream(stream, bench.address(f"GPIO{port}_{register}"), memory, count, options)

    def send(self, values: Sequence[int], spoil: dict[int, int] | None = None) -> None:
        self.bench.write("TIM1_DIER", 0)
        for place, port in enumerate(self.ports):
            words = self.words(port, values)
            for i, word in (spoil or {}).items():
                words[i] = word
            at = WORDS + 256 * place
            self.bench.context.set_memory(at, b"".join(word.to_bytes(4, "little") for word in words))
            self.start(place, port, "BSRR", at, len(words), TO_PORT)
        self.ask()

    def ask(self) -> None:
        channels = CHANNELS[: len(self.ports)]
        self.bench.set("TIM1_DIER", **{f"CC{channel}DE": 1 for channel in channels})

    def sample(self, count: int, slot: int = 96) -> None:
        """Take half words of the first port from now on, thrice a bit of the answer."""
        self.bench.write("TIM1_DIER", 0)
        self.turn(0)
        self.bench.write("TIM1_ARR", slot - 1)
        self.start(0, self.ports[0], "IDR", SAMPLES, count, FROM_PORT)
        self.ask()

    def line(self, motor: int, count: int) -> list[int]:
        """What was sampled of a motor's line."""
        data = self.bench.context.memory(SAMPLES, 2 * count)
        pin = self.bench.hardware.escs[motor].pin.number
        return [int.from_bytes(data[2 * i : 2 * i + 2], "little") >> pin & 1 for i in range(count)]


def listen(bench: Bench) -> list[Frame]:
    frames: list[Frame] = []
    bench.hardware.hear_frames(frames.append)
    return frames


def decoded(line: Sequence[int], share: float = 3.0) -> int | None:
    """The word in samples of a line, `share` of them a bit, by the protocol; None: there is none."""
    falls = [i for i in range(1, len(line)) if line[i - 1] and not line[i]]
    if not falls:
        return None
    levels = [line[min(len(line) - 1, falls[0] + int((i + 0.5) * share))] for i in range(21)]
    coded = sum((levels[i] ^ levels[i + 1]) << 19 - i for i in range(20))
    nibbles = [coded >> shift & 31 for shift in (15, 10, 5, 0)]
    if not all(nibble in CODES for nibble in nibbles):
        return None
    a, b, c, checksum = map(CODES.index, nibbles)
    return a << 8 | b << 4 | c if a ^ b ^ c ^ checksum == 15 else None


def test_motors_on_three_ports_get_their_values_when_dma_writes_the_ports(fast: Bench) -> None:
    frames = listen(fast)
    values = (48, 1047, 2047, 0, 99, 1234, 7, 2000)
    driver = Ports(fast, "CBA")
    begin = fast.context.cycle
    driver.send(values)
    fast.context.run(60)
    assert {f.motor: (f.value, f.protocol, f.inverted) for f in frames} == {
        i + 1: (value, 600, False) for i, value in enumerate(values)
    }
    assert {f.cycle for f in frames} == {frames[0].cycle} and frames[0].cycle - begin < 17 * 360
    assert fast.get("DMA2_S6CR", "EN") == fast.get("DMA2_S4CR", "EN") == fast.get("DMA2_S1CR", "EN") == 0


@pytest.mark.parametrize(("slot", "protocol"), [(120, 600), (240, 300), (480, 150)])
@pytest.mark.parametrize("inverted", [False, True])
def test_frames_are_taken_when_ports_are_written_thrice_a_bit(
    fast: Bench, slot: int, protocol: int, inverted: bool
) -> None:
    frames = listen(fast)
    driver = Ports(fast, inverted=inverted, slot=slot)
    for value in range(100, 103):
        driver.send([value + i for i in range(4)])
        fast.context.run(200)
    assert sorted((f.motor, f.value, f.protocol, f.inverted) for f in frames) == [
        (i + 1, value + i, protocol, inverted) for i in range(4) for value in range(100, 103)
    ]


def test_frames_are_the_same_when_somebody_looks_at_every_slot(fast: Bench, make_bench: type[Bench]) -> None:
    other = make_bench()
    other.full_speed()
    seen = []
    for bench, looks in ((fast, 1), (other, 200)):
        frames = listen(bench)
        driver = Ports(bench, "CB")
        begin = bench.context.cycle
        driver.send((48, 1047, 2047, 0, 7, 0, 9))
        for i in range(looks):
            bench.context.run_to(begin + (i + 1) * 12_000 // looks)
            bench.read("GPIOC_IDR")
            bench.read("DMA2_S4NDTR")
        seen.append(sorted((f.motor, f.value, f.cycle - begin) for f in frames))
    assert seen[0] == seen[1] and len(seen[0]) == 6


def test_line_shows_each_word_when_it_is_read_meanwhile(fast: Bench) -> None:
    driver = Ports(fast)
    begin = fast.context.cycle
    driver.send((2047, 0, 0, 0))
    levels = []
    for i in range(6):
        fast.context.run_to(begin + 20 + SLOT * i + SLOT // 2)
        levels.append(fast.read("GPIOC_IDR") >> 6 & 3)
    assert levels == [3, 1, 0, 3, 1, 0]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ({4: 0b1111 << 22}, r"motor 1: frame 0x.* has the checksum"),
        ({9: 0, 10: 0, 11: 0}, "motor 1: a frame breaks off in its bit 3, expected 16 bits"),
        ({5: 0}, "motor 1: a frame breaks off in its bit 2, expected 16 bits"),
        (dict.fromkeys(range(24, 48), 0), "motor 1: a frame breaks off in its bit 8, expected 16 bits"),
    ],
)
def test_frame_is_refused_when_a_word_is_wrong(fast: Bench, spoil: dict[int, int], message: str) -> None:
    driver = Ports(fast)
    driver.send((48, 48, 48, 48))
    fast.context.run(100)
    driver.send((1947, 48, 48, 48), spoil)
    with pytest.raises(BoardError, match=message):
        fast.context.run(10_500)


def test_frame_is_refused_when_the_line_rests_at_another_level_than_before(fast: Bench) -> None:
    Ports(fast).send((48, 48, 48, 48))
    fast.context.run(100)
    driver = Ports(fast, inverted=True)
    driver.send((48, 48, 48, 48))
    with pytest.raises(
        BoardError, match="motor 1: the line rests high before a frame, expected low: its ESC has"
    ):
        fast.context.run(100)


def test_first_word_comes_at_once_when_a_request_was_pending(fast: Bench) -> None:
    """Compares before the stream is enabled leave a request behind."""
    driver = Ports(fast)
    driver.ask()
    fast.context.run(10)
    fast.context.set_memory(WORDS, (1 << 6).to_bytes(4, "little") + (1 << 22).to_bytes(4, "little") * 3)
    driver.start(0, "C", "BSRR", WORDS, 4, TO_PORT)
    assert fast.read("GPIOC_IDR") >> 6 & 1 == 1
    assert fast.read("DMA2_S6NDTR") == 3


def test_requests_come_at_updates_when_ccds_says_so(fast: Bench) -> None:
    driver = Ports(fast)
    fast.write("TIM1_CR2", 8)
    fast.write("TIM1_CNT", 0)
    begin = fast.context.cycle
    fast.context.set_memory(WORDS, (1 << 6).to_bytes(4, "little") * 4)
    driver.start(0, "C", "BSRR", WORDS, 4, TO_PORT)
    driver.ask()
    fast.context.run_to(begin + SLOT - 1)
    assert fast.read("GPIOC_IDR") >> 6 & 1 == 0
    fast.context.run_to(begin + SLOT)
    assert fast.read("GPIOC_IDR") >> 6 & 1 == 1


def test_no_request_comes_when_the_counter_never_gets_there(fast: Bench) -> None:
    driver = Ports(fast)
    fast.write("TIM1_CCR3", SLOT)
    fast.write("TIM1_EGR", 1)
    driver.send((48, 48, 48, 48))
    fast.context.run(100)
    assert fast.read("DMA2_S6NDTR") == 49


def test_stream_is_refused_when_dma1_is_to_reach_a_port(fast: Bench) -> None:
    with pytest.raises(
        BoardError, match="DMA1 reaches peripherals on APB1 only, but its address is GPIOB_BSRR"
    ):
        fast.stream(
            "DMA1_S4", fast.address("GPIOB_BSRR"), WORDS, 4, 5 << 25 | 2 << 13 | 2 << 11 | 1 << 10 | 1 << 6
        )


@pytest.mark.parametrize(
    ("stream", "register", "options", "message"),
    [
        ("DMA2_S5", "BSRR", TO_PORT & ~(7 << 25), "channel 0 is driven by no request"),
        (
            "DMA2_S6",
            "MODER",
            TO_PORT,
            "moves from memory, but its peripheral is GPIOC_MODER, expected BSRR or ODR",
        ),
        (
            "DMA2_S6",
            "BSRR",
            FROM_PORT,
            "moves to memory, but its peripheral is GPIOC_BSRR, expected IDR or ODR",
        ),
    ],
)
def test_stream_is_refused_when_its_request_or_register_is_wrong(
    fast: Bench, stream: str, register: str, options: int, message: str
) -> None:
    with pytest.raises(BoardError, match=message):
        fast.stream(stream, fast.address(f"GPIOC_{register}"), WORDS, 4, options)


def asked(
    bench: Bench, faults: AnswerFaults, words: Sequence[int | None] = (0xABC, 0x001, None, 0xFFF)
) -> Ports:
    """A driver that has sent a bidirectional frame, turned the lines round and sampled them for 80 us."""
    for esc, word in zip(bench.hardware.escs, words, strict=False):
        esc.spoil(faults)
        esc.answer = word
    driver = Ports(bench, inverted=True)
    driver.send((48, 48, 48, 48))
    bench.context.run(27)
    driver.sample(180)
    bench.context.run(80)
    assert bench.get("DMA2_S6CR", "EN") == 0
    return driver


def test_words_are_answered_when_frames_are_bidirectional(fast: Bench) -> None:
    driver = asked(fast, AnswerFaults())
    assert [decoded(driver.line(motor, 180)) for motor in range(4)] == [0xABC, 0x001, None, 0xFFF]
    assert set(driver.line(2, 180)) == {1}
    assert [esc.answers for esc in fast.hardware.escs[:4]] == [1, 1, 0, 1]
    begin = driver.line(0, 180).index(0) * 96 / 216  # after 27 us from the first slot
    assert begin == pytest.approx(30.0, abs=1.0)


def test_no_answer_comes_when_frames_are_normal(fast: Bench) -> None:
    fast.hardware.escs[0].answer = 0x123
    Ports(fast).send((48, 48, 48, 48))
    fast.context.run(200)
    assert fast.hardware.escs[0].frames == 1 and fast.hardware.escs[0].answers == 0


@pytest.mark.parametrize("word", [0, 0x111, 0x249, 0x7FF, 0xE00])
def test_answers_are_read_when_the_escs_clock_is_2_percent_off_and_edges_jitter(
    fast: Bench, word: int
) -> None:
    driver = asked(fast, AnswerFaults(clock=0.02, jitter_s=0.1e-6), [word] * 4)
    assert [decoded(driver.line(motor, 180), 3.06) for motor in range(4)] == [word] * 4
    assert len({tuple(driver.line(motor, 180)) for motor in range(4)}) > 1


def test_answers_are_spoilt_when_told(fast: Bench, make_bench: type[Bench]) -> None:
    late = asked(fast, AnswerFaults(delay_s=35e-6)).line(0, 180).index(0)
    other = make_bench()
    other.full_speed()
    noisy = asked(other, AnswerFaults(noise=0.2)).line(2, 180)
    assert late * 96 / 216 == pytest.approx(35.0, abs=1.0)
    assert 15 < noisy.count(0) < 60


@pytest.mark.parametrize("stuck", [False, True])
def test_line_stays_when_an_esc_holds_it(fast: Bench, stuck: bool) -> None:
    assert set(asked(fast, AnswerFaults(stuck=stuck)).line(0, 180)) == {int(stuck)}


def test_some_frames_are_not_answered_when_told(fast: Bench) -> None:
    esc = fast.hardware.escs[0]
    esc.answer = 5
    esc.spoil(AnswerFaults(silence=0.5))
    driver = Ports(fast, inverted=True)
    for _ in range(40):
        driver.turn(1)
        fast.context.run(30)
        driver.send((48, 48, 48, 48))
        fast.context.run(28)
        driver.turn(0)
        fast.context.run(60)
    assert esc.frames == 40 and 10 < esc.answers < 30


@pytest.mark.parametrize("back_us", [0.0, 40.0])
def test_answer_is_refused_when_the_pin_is_an_output(fast: Bench, back_us: float) -> None:
    fast.hardware.escs[1].answer = 0x5A5
    driver = Ports(fast, inverted=True)
    driver.send((48, 48, 48, 48))
    fast.context.run(27)
    if back_us:
        driver.turn(0)
        fast.context.run(back_us)
        driver.turn(1)
    fast.context.run(100)
    driver.send((48, 48, 48, 48))
    with pytest.raises(
        BoardError, match=r"PC7 is an output while its ESC answers, (30\.0|4\d\.\d) us after the end"
    ):
        fast.context.run(100)
