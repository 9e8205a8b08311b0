"""The image's motor outputs: frames as DMA will find them, word by word, and what paces them; answers."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.toolchain.contract import ESC_DAMAGED, ESC_SILENT, MOTOR_COUNT_MAX
from tests.firmware.fuzz.esc_answers_seeds import answer, checked

SCRATCH = 0x2000F000  # DTCM that the image does not use
DSHOT300, DSHOT600, DSHOT150 = 0, 1, 2  # the setting motor_protocol
BITS, REST, ANSWERED_REST = 16, 6, 2  # of a frame; words behind it
TIM1, DMA2 = 0x40010000, 0x40026400
ICSR, PENDSVSET = 0xE000ED04, 1 << 28
CR1, DIER, ARR = 0x00, 0x0C, 0x2C
MODER, IDR, BSRR, PUPDR, OSPEEDR = 0x00, 0x10, 0x18, 0x0C, 0x08
IN_SRAM2 = range(0x2003C000, 0x20040000)

PORTS = {
    "C": (0x40020800, 6),
    "B": (0x40020400, 4),
    "A": (0x40020000, 1),
}  # and the DMA2 stream that writes it
PINS = (("C", 6), ("C", 7), ("C", 8), ("C", 9), ("B", 1), ("A", 8))
REQUESTS = 1 << 11 | 1 << 12 | 1 << 9  # CC3DE, CC4DE, CC1DE


class Motors:
    """The driver in a booted image, set up anew."""

    def __init__(
        self, sketch: Any, symbols: dict[str, int], protocol: int, telemetry: bool, count: int
    ) -> None:
        self.sketch, self.symbols = sketch, symbols
        for port, _ in PORTS.values():
            sketch.poke(port + IDR, 0)
        sketch.call_with(symbols["motor_pins_start"])
        sketch.call_with(symbols["motors_run"], protocol, telemetry, count)

    def write(self, *values: int, telemetry: bool = False) -> bool:
        self.sketch.uc.mem_write(SCRATCH, struct.pack(f"<{len(values)}H", *values))
        return bool(self.sketch.call_with(self.symbols["motors_write"], 0, SCRATCH, len(values), telemetry))

    def read(self) -> list[int]:
        """What the ESCs have answered."""
        self.sketch.call_with(self.symbols["motors_read"], 0, SCRATCH)
        return list(
            struct.unpack(f"<{MOTOR_COUNT_MAX}H", self.sketch.uc.mem_read(SCRATCH, 2 * MOTOR_COUNT_MAX))
        )

    def stream(self, port: str, offset: int) -> int:
        """A register of the stream of a port: 0 CR, 4 NDTR, 8 PAR, 12 M0AR."""
        return int(self.sketch.peek(DMA2 + 0x10 + 0x18 * PORTS[port][1] + offset))

    def moving(self) -> list[bool]:
        return [bool(self.stream(port, 0) & 1) for port in PORTS]

    def finish(self, *ports: str) -> None:
        """DMA has moved all, of these ports or all of them."""
        for port in ports or PORTS:
            address = DMA2 + 0x10 + 0x18 * PORTS[port][1]
            self.sketch.poke(address, self.sketch.peek(address) & ~1)

    def sent(self) -> None:
        """A frame that is answered has ended."""
        self.finish()
        self.moved()

    def moved(self) -> None:
        """A stream tells that it has moved all; what it then has done later, is."""
        self.sketch.poke(ICSR, 0)
        self.sketch.call(self.symbols["motors_moved_handler"])
        if self.sketch.peek(ICSR) == PENDSVSET:
            self.sketch.call(self.symbols["motors_answers_handler"])

    def answered(self, words: dict[int, int]) -> None:
        """The lines of these motors have been sampled, each with these 16 bits; the others rested."""
        for port in PORTS:
            count = self.stream(port, 4)
            samples = [0xFFFF] * count
            for motor, sent in words.items():
                if PINS[motor][0] == port:
                    level = answer(sent)
                    samples = [
                        sample & ~((~level >> i & 1) << PINS[motor][1]) for i, sample in enumerate(samples)
                    ]
            self.sketch.uc.mem_write(self.stream(port, 12), struct.pack(f"<{count}H", *samples))
        self.finish()
        self.moved()

    def pulses(self, motor: int, rest: bool = False) -> list[int]:
        """How many thirds of a bit the line will be away from its rest level, bit by bit."""
        port, pin = PINS[motor]
        count = self.stream(port, 4)
        data = self.sketch.uc.mem_read(self.stream(port, 12), 4 * count)
        level, thirds = rest, []
        for word in struct.unpack(f"<{count}I", data):
            assert not word >> pin & word >> pin + 16 & 1, "a pin set and cleared at once"
            level = (level or bool(word >> pin & 1)) and not word >> pin + 16 & 1
            thirds.append(level != rest)
        assert not any(thirds[3 * BITS :]), "the line rests behind a frame"
        bits = [thirds[3 * bit : 3 * bit + 3] for bit in range(BITS)]
        assert all(first and not last for first, _, last in bits)
        return [1 + middle for _, middle, _ in bits]

    def modes(self) -> list[int]:
        """Of each motor's pin: 0 input, 1 output, 2 alternate function."""
        return [self.field(MODER, motor) for motor in range(len(PINS))]

    def field(self, register: int, motor: int) -> int:
        port, pin = PINS[motor]
        return int(self.sketch.peek(PORTS[port][0] + register) >> 2 * pin & 3)

    def timer(self, register: int) -> int:
        return int(self.sketch.peek(TIM1 + register))


def frame_of(value: int, telemetry: bool = False, answered: bool = False) -> list[int]:
    """The pulses of a DShot frame, first sent first, in thirds of a bit."""
    data = value << 1 | telemetry
    frame = data << 4 | (data ^ data >> 4 ^ data >> 8 ^ (15 if answered else 0)) & 15
    return [1 + (frame >> bit & 1) for bit in reversed(range(BITS))]


@pytest.fixture
def motors(make_booted: Callable[[], Any], symbols: dict[str, int]) -> Callable[..., Motors]:
    def make(protocol: int = DSHOT600, count: int = 4, telemetry: bool = False) -> Motors:
        return Motors(make_booted(), symbols, protocol, telemetry, count)

    return make


@pytest.mark.parametrize(("protocol", "ticks"), [(DSHOT600, 120), (DSHOT300, 240), (DSHOT150, 480)])
def test_a_frame_carries_value_and_checksum_bit_by_bit_when_six_motors_are_written(
    protocol: int, ticks: int, motors: Callable[..., Motors]
) -> None:
    board = motors(protocol, 6)
    values = (48, 1046, 2047, 0, 1000, 47)
    for values in ((48, 1046, 2047, 0, 1000, 47), (2047, 0, 1, 1365, 682, 2046)):
        assert board.write(*values)
        assert board.moving() == [True] * 3
        assert [board.pulses(motor) for motor in range(6)] == [frame_of(value) for value in values]
        for port, (address, _) in PORTS.items():
            assert board.stream(port, 8) == address + BSRR and board.stream(port, 4) == 3 * BITS + REST
            assert board.stream(port, 12) in IN_SRAM2
            assert board.stream(port, 0) >> 4 & 1 == 0, "nobody waits for its end"
            channel, memory, peripheral = (
                board.stream(port, 0) >> lsb & mask for lsb, mask in ((25, 7), (13, 3), (11, 3))
            )
            assert (channel, memory, peripheral) == (6, 2, 2), "TIM1's requests, words"
        board.finish()
    assert board.timer(ARR) == ticks - 1 and board.timer(DIER) == REQUESTS and board.timer(CR1) == 1
    assert board.sketch.field("TIM_CR2", "CCDS", "TIM1") == 1, "all ask at the update"
    assert board.modes() == [1] * 6 and board.sketch.sins == []


@pytest.mark.parametrize("answered", [False, True])
def test_a_port_carries_the_frames_of_motors_of_both_fours(
    answered: bool, make_booted: Callable[[], Any], symbols: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Motor 5 on PC10, beside motors 1 to 4."""
    board = make_booted()
    table = bytes(board.uc.mem_read(symbols["board"], 156))
    at = table.index(bytes((ord(port) - ord("A")) << 4 | pin for port, pin in PINS))
    board.uc.mem_write(symbols["board"] + at + 4, bytes([0x2A]))
    monkeypatch.setitem(globals(), "PINS", (*PINS[:4], ("C", 10), PINS[5]))
    motors = Motors(board, symbols, DSHOT600, answered, 6)
    for values in ((48, 1046, 2047, 0, 1000, 47), (2047, 0, 1, 1365, 682, 2046)):
        assert motors.write(*values)
        told = [motors.pulses(motor, rest=answered) for motor in range(6)]
        assert told == [frame_of(value, answered=answered) for value in values]
        motors.finish()
        if answered:
            motors.sent()
            motors.finish()


def test_all_ports_begin_at_the_same_update(motors: Callable[..., Motors]) -> None:
    board = motors(DSHOT600, 6)
    written: list[str] = []
    board.sketch.on_write = lambda register, value: written.append(register.name)
    board.write(0, 0, 0, 0, 0, 0)
    assert written[0] == "TIM_DIER" and written[-2:] == ["TIM_CNT", "TIM_DIER"]
    assert written.count("TIM_DIER") == 2


def test_lines_without_a_motor_are_held_low_when_four_are_in_use(motors: Callable[..., Motors]) -> None:
    board = motors(DSHOT600, 4)
    board.write(48, 48, 48, 48)
    assert board.modes() == [1] * 6
    assert board.moving() == [True, False, False] and board.timer(DIER) == 1 << 11


def test_the_telemetry_bit_is_in_every_frame_when_asked_for(motors: Callable[..., Motors]) -> None:
    board = motors()
    board.write(5, 5, 5, 5, telemetry=True)
    assert [board.pulses(motor) for motor in range(4)] == [frame_of(5, telemetry=True)] * 4


def test_a_motor_is_stopped_when_its_value_is_missing(motors: Callable[..., Motors]) -> None:
    board = motors()
    board.write(2047, 2047)
    assert board.pulses(1) == frame_of(2047) and board.pulses(2) == frame_of(0)


def test_a_new_frame_is_dropped_when_the_last_is_on_the_wire(motors: Callable[..., Motors]) -> None:
    board = motors()
    board.write(2047, 2047, 0, 0)
    first = [board.pulses(motor) for motor in range(4)]
    assert not board.write(0, 0, 0, 0)
    assert [board.pulses(motor) for motor in range(4)] == first
    board.finish()
    assert board.write(0, 0, 0, 0)
    assert [board.pulses(motor) for motor in range(4)] == [frame_of(0)] * 4


def test_an_output_that_is_stuck_is_set_up_anew_and_gets_a_whole_frame_at_the_next_write(
    motors: Callable[..., Motors],
) -> None:
    board = motors(DSHOT600, 6)
    board.write(*[2047] * 6)
    board.finish("C", "A")  # the frames of two ports have ended, that of the third does not
    sketch = board.sketch
    sketch.poke(TIM1 + CR1, 0)  # the timer stands
    for _ in range(3):
        assert not board.write(*[0] * 6)
        assert board.moving() == [False, True, False] and board.timer(CR1) == 0
    written: list[tuple[str, int]] = []
    sketch.on_write = lambda register, value: written.append((f"{register.name} {register.instance}", value))
    assert not board.write(*[0] * 6)
    sketch.on_write = lambda register, value: None
    low = [("GPIO_BSRR GPIOC", 0x3C0 << 16), ("GPIO_BSRR GPIOB", 2 << 16), ("GPIO_BSRR GPIOA", 0x100 << 16)]
    assert [write for write in written if "BSRR" in write[0]] == low
    assert board.moving() == [False] * 3, "the lines rest until the next write"
    assert board.timer(CR1) == 1 and board.timer(DIER) == 0
    assert sketch.call_with(board.symbols["motors_restarts"], 0) == 1
    assert board.write(*[0] * 6)
    assert board.moving() == [True] * 3 and board.timer(DIER) == REQUESTS
    assert board.pulses(4) == frame_of(0)
    assert board.sketch.sins == []


@pytest.mark.parametrize("telemetry", [False, True])
def test_every_line_is_driven_low_and_no_word_follows_when_forced(
    telemetry: bool, motors: Callable[..., Motors]
) -> None:
    board = motors(DSHOT600, 6, telemetry)
    board.write(*[0] * 6)
    if telemetry:
        board.sent()
    written: list[tuple[str, int]] = []
    board.sketch.on_write = lambda register, value: written.append(
        (f"{register.name} {register.instance}", value)
    )
    board.sketch.call_with(board.symbols["motor_pins_force_low"])
    assert board.modes() == [1] * 6 and board.timer(DIER) == 0
    low = [("GPIO_BSRR GPIOC", 1 << 16 + pin) for pin in (6, 7, 8, 9)]
    low += [("GPIO_BSRR GPIOB", 1 << 17), ("GPIO_BSRR GPIOA", 1 << 24)]
    low += [("GPIO_BSRR GPIOB", 1 << 24), ("GPIO_BSRR GPIOA", 1 << 18)]  # motors 7 and 8
    assert [write for write in written if "BSRR" in write[0]] == low
    assert written.index(("TIM_DIER TIM1", 0)) < written.index(low[0])


# --- Bidirectional ----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("protocol", "ticks", "samples"), [(DSHOT600, 96, 160), (DSHOT300, 192, 118), (DSHOT150, 384, 96)]
)
def test_after_a_frame_the_pins_listen_for_as_long_as_an_answer_takes(
    protocol: int, ticks: int, samples: int, motors: Callable[..., Motors]
) -> None:
    board = motors(protocol, 6, telemetry=True)
    assert [board.field(PUPDR, motor) for motor in range(6)] == [1] * 6, "pulled up"
    assert board.write(2047, 0, 48, 1000, 1, 2)
    for motor, value in enumerate((2047, 0, 48, 1000, 1, 2)):
        assert board.pulses(motor, rest=True) == frame_of(value, answered=True)
    assert board.stream("C", 0) >> 4 & 1 == 1, "its end is told"
    assert board.stream("C", 4) == 3 * BITS + ANSWERED_REST
    board.sent()
    assert board.modes() == [0] * 6 and board.moving() == [True] * 3
    assert board.stream("C", 0) >> 4 & 1 == 1, "so is theirs"
    assert board.timer(ARR) == ticks - 1 and board.timer(DIER) == REQUESTS
    for port, (address, _) in PORTS.items():
        assert board.stream(port, 8) == address + IDR and board.stream(port, 4) == samples
        assert board.stream(port, 12) in IN_SRAM2
        direction, memory, peripheral = (board.stream(port, 0) >> lsb & 3 for lsb in (6, 13, 11))
        assert (direction, memory, peripheral) == (0, 1, 1), "half words to memory"
    board.finish()
    assert board.write(*[0] * 6)
    assert board.modes() == [1] * 6 and board.timer(ARR) == ticks * 5 // 4 - 1
    assert board.sketch.sins == []


def test_answers_are_told_by_output_when_they_are_over(motors: Callable[..., Motors]) -> None:
    board = motors(DSHOT600, 6, telemetry=True)
    assert board.read() == [ESC_SILENT] * 8
    board.write(*[0] * 6)
    board.sent()
    assert board.read() == [ESC_SILENT] * 8, "they are on the wire"
    board.answered({0: checked(0x123), 2: checked(0xFFF), 3: 0x1234, 5: checked(0x0AB)})
    told = [0x123, ESC_SILENT, 0xFFF, ESC_DAMAGED, ESC_SILENT, 0x0AB, ESC_SILENT, ESC_SILENT]
    assert board.read() == told
    assert board.read() == told, "until the next ones are there"
    assert board.write(*[0] * 6)
    board.sent()
    assert board.read() == told
    board.answered({1: checked(0x456)})
    assert board.write(*[0] * 6), "asked for or not, they hold up no frame"
    board.sent()
    board.answered({})
    assert board.read() == [ESC_SILENT] * 8


def test_a_frame_whose_end_or_answers_never_come_is_followed_by_others(motors: Callable[..., Motors]) -> None:
    board = motors(DSHOT600, 6, telemetry=True)
    board.write(*[0] * 6)
    board.sent()
    board.answered({0: checked(0x123)})
    assert board.read()[0] == 0x123
    for listens in (False, True):
        assert board.write(*[0] * 6)
        if listens:
            board.sent()
        else:
            board.finish()  # but no interrupt comes
        assert [board.write(*[0] * 6) for _ in range(4)] == [False] * 4
        assert board.read() == [ESC_SILENT] * 8, "what was known of the rotors is old"
        board.moved()  # of the stream that was ended
        board.sketch.call(board.symbols["motors_answers_handler"])  # which may have waited since before
        assert board.read() == [ESC_SILENT] * 8
        assert board.moving() == [False] * 3
    assert board.sketch.call_with(board.symbols["motors_restarts"], 0) == 2
    assert board.write(*[0] * 6) and board.moving() == [True] * 3


def test_nobody_listens_while_another_port_still_sends(motors: Callable[..., Motors]) -> None:
    board = motors(DSHOT600, 6, telemetry=True)
    board.write(*[0] * 6)
    board.finish("C", "A")
    board.moved()
    assert board.modes() == [1] * 6 and board.stream("C", 8) == PORTS["C"][0] + BSRR
