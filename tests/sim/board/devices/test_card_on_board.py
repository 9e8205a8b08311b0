"""The SD card behind SPI3 of the emulated board: registers, DMA1, time, faults, snapshots."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.debug.snapshot import restore_snapshot, take_snapshot
from neuroflight.sim.board.devices.sd_card import CardFault, CardTiming, Cut, SdCard
from tests.sim.board.devices.host import blank, blocks_of, crc7, crc16, pattern
from tests.sim.board.test_board import build

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench

TX, RX = 0x2003C000, 0x2003D000  # in SRAM2
SPI3_DR = 0x40003C0C
SLOW, FAST, TOO_FAST = 7, 1, 0  # BR: 0.211, 13.5 and 27 MHz
QUICK = CardTiming(
    start=(1e-3, 1e-3), write=(0.5e-3, 0.5e-3), pause_share=0.0, wake=(0.0, 0.0), read=(1e-4, 1e-4)
)


class Driver:
    """What a program does with the registers of SPI3 and DMA1."""

    def __init__(self, bench: Bench, speed: int = SLOW) -> None:
        self.bench = bench
        for pin in ("PB3", "PB4", "PB5"):
            bench.alternate(pin, 6)
        bench.write("GPIOC_BSRR", 1 << 1)
        bench.set("GPIOC_MODER", MODER1=1)
        bench.write("SPI3_CR2", 7 << 8 | 1 << 12)
        self.speed(speed)

    def speed(self, speed: int) -> None:
        self.bench.write("SPI3_CR1", 0x304 | speed << 3)
        self.bench.set("SPI3_CR1", SPE=1)

    def select(self, on: bool) -> None:
        self.bench.write("GPIOC_BSRR", 1 << (17 if on else 1))

    def poll(self, sent: bytes) -> bytes:
        got = []
        for byte in sent:
            self.bench.write("SPI3_DR", byte, 1)
            while not self.bench.get("SPI3_SR", "RXNE"):
                self.bench.context.run(0.5)
            got.append(self.bench.read("SPI3_DR", 1))
        return bytes(got)

    def move(self, sent: bytes, rx: int = 0, tx: int = 5, *, wait: bool = True, into: int = RX) -> bytes:
        """By DMA, both ways; what comes goes to `into`."""
        bench = self.bench
        bench.context.set_memory(TX, sent)
        bench.set("SPI3_CR2", RXDMAEN=1)
        for stream, memory, direction in ((rx, into, 0), (tx, TX, 1)):
            bench.write("DMA1_LIFCR" if stream < 4 else "DMA1_HIFCR", 0x3D << (0, 6, 16, 22)[stream % 4])
            bench.stream(
                f"DMA1_S{stream}",
                SPI3_DR,
                memory,
                len(sent),
                1 << 10 | direction << 6 | (1 << 4 if stream == rx else 0),
            )
        bench.set("SPI3_CR2", TXDMAEN=1)
        if not wait:
            return b""
        while bench.get(f"DMA1_S{rx}CR", "EN"):
            bench.context.run(5)
        bench.set("SPI3_CR2", TXDMAEN=0, RXDMAEN=0)
        return bytes(bench.context.memory(into, len(sent)))

    def command(self, index: int, argument: int = 0, more: int = 0) -> bytes:
        frame = bytes([0x40 | index]) + argument.to_bytes(4, "big")
        self.poll(frame + bytes([crc7(frame)]))
        for _ in range(10):
            first = self.poll(b"\xff")
            if first != b"\xff":
                return first + self.poll(b"\xff" * more)
        return b""

    def start(self) -> None:
        self.bench.context.run(1000)
        self.select(False)
        self.poll(b"\xff" * 10)
        self.select(True)
        assert self.command(0) == b"\x01"
        assert self.command(8, 0x1AA, 4)[4] == 0xAA
        for _ in range(100):
            self.command(55)
            if self.command(41, 1 << 30) == b"\x00":
                break
        assert self.command(59, 1) == b"\x00"
        self.speed(FAST)

    def wait(self, byte: bytes) -> None:
        """Until the card says `byte`."""
        for _ in range(1000):
            if self.poll(b"\xff") == byte:
                return
            self.bench.context.run(20)
        raise AssertionError(f"the card has not said {byte.hex()} within 20 ms")

    def write(self, block: int, data: bytes, *streams: int) -> int:
        assert self.command(24, block) == b"\x00"
        self.move(b"\xff\xfe" + data + crc16(data), *streams)
        response = self.poll(b"\xff")[0] & 0x1F
        self.wait(b"\xff")
        return response

    def read(self, block: int, *streams: int) -> bytes:
        assert self.command(17, block) == b"\x00"
        self.wait(b"\xfe")
        got = self.move(b"\xff" * 514, *streams)
        assert crc16(got[:512]) == got[512:]
        return got[:512]


@pytest.fixture
def image(tmp_path: Path) -> Path:
    return blank(tmp_path / "card.img")


def fitted(make_bench: type[Bench], image: Path, **options: Any) -> tuple[Bench, Driver]:
    """A board at full speed with a card, and its program."""
    bench = make_bench(card=SdCard(image, timing=QUICK, **options))
    bench.full_speed()
    return bench, Driver(bench)


@pytest.fixture
def driver(make_bench: type[Bench], image: Path) -> Driver:
    """The program of a board whose card is initialised."""
    driver = fitted(make_bench, image)[1]
    driver.start()
    return driver


@pytest.mark.parametrize("streams", [(0, 5), (2, 7)])
def test_a_block_goes_to_the_card_and_back_by_dma(
    driver: Driver, image: Path, streams: tuple[int, int]
) -> None:
    assert driver.write(7, pattern(3), *streams) == 5
    assert blocks_of(image, 7) == pattern(3)
    assert driver.read(7, *streams) == pattern(3)


def test_what_comes_may_take_the_place_of_what_is_sent(driver: Driver, image: Path) -> None:
    assert driver.command(24, 4) == b"\x00"
    sent = b"\xff\xfe" + pattern(4) + crc16(pattern(4)) + b"\xff" * 4
    got = driver.move(sent, into=TX)
    assert got[:516] == b"\xff" * 516
    assert got[516] & 0x1F == 5
    assert blocks_of(image, 4) == pattern(4)


def test_bytes_take_their_time_when_dma_moves_them(driver: Driver) -> None:
    bench = driver.bench
    driver.select(False)
    driver.move(b"\xff" * 512, wait=False)
    bench.context.run(512 * 8 / 13.5 - 0.1)
    assert bench.read("DMA1_S0NDTR") == 1
    assert not bench.context.asserted("DMA1_STREAM0")
    bench.context.run(0.2)
    assert bench.context.asserted("DMA1_STREAM0")
    assert bench.get("DMA1_LISR", "TCIF0") == 1


def test_a_transmitting_stream_interrupts_at_its_end_when_nothing_is_received(fast: Bench) -> None:
    Driver(fast, FAST)
    fast.stream("DMA1_S5", SPI3_DR, TX, 100, 1 << 10 | 1 << 6 | 1 << 4)
    fast.set("SPI3_CR2", TXDMAEN=1)
    byte = 8 / 13.5
    fast.context.run(95 * byte - 0.1)  # the last one goes into the FIFO when the 95th byte has left
    assert not fast.context.asserted("DMA1_STREAM5")
    fast.context.run(0.2)
    assert fast.context.asserted("DMA1_STREAM5")
    assert fast.get("SPI3_SR", "BSY") == 1
    fast.context.run(5 * byte)
    assert fast.get("SPI3_SR", "BSY") == 0


def test_all_ones_are_read_when_no_card_is_fitted(fast: Bench) -> None:
    driver = Driver(fast)
    driver.select(True)
    assert driver.command(0) == b""
    assert driver.move(bytes(20)) == b"\xff" * 20


@pytest.mark.parametrize(
    ("speed", "started", "message"),
    [
        (6, False, r"the SD card is clocked at 0.421875 MHz before it is initialised, expected 0.4 MHz"),
        (TOO_FAST, True, r"the SD card is clocked at 27 MHz after its initialisation, expected 25 MHz"),
    ],
)
def test_the_board_fails_when_the_card_is_clocked_too_fast(
    make_bench: type[Bench], image: Path, speed: int, started: bool, message: str
) -> None:
    _, driver = fitted(make_bench, image)
    if started:
        driver.start()
    driver.speed(speed)
    driver.select(True)
    with pytest.raises(BoardError, match=message):
        driver.command(0)


@pytest.mark.parametrize(
    ("register", "field", "value", "message"),
    [
        ("GPIOB_AFRL", "AFRL4", 5, r"SPI3 sends: PB4 is alternate function 5, expected alternate function 6"),
        ("SPI3_CR1", "CPOL", 1, "SPI mode 2, expected 0 or 3"),
        ("SPI3_CR1", "MSTR", 0, "SPI3 sends with CR1 MSTR 0"),
        ("RCC_APB1ENR", "SPI3EN", 0, "SPI3_DR is written without its clock: RCC_APB1ENR SPI3EN is 0"),
    ],
)
def test_spi3_is_refused_when_it_is_set_up_wrong(
    make_bench: type[Bench], image: Path, register: str, field: str, value: int, message: str
) -> None:
    bench, driver = fitted(make_bench, image)
    bench.set("SPI3_CR1", SPE=0)
    bench.set(register, **{field: value})
    with pytest.raises(BoardError, match=message):
        if register != "RCC_APB1ENR":
            bench.set("SPI3_CR1", SPE=1)
        driver.poll(b"\xff")


def test_a_wrong_channel_is_refused(fast: Bench) -> None:
    fast.stream("DMA1_S0", SPI3_DR, RX, 1, 2 << 25, enable=False)
    with pytest.raises(
        BoardError, match=r"its peripheral address is SPI3_DR; expected channel 0 \(SPI3_RX\)"
    ):
        fast.set("DMA1_S0CR", EN=1)


def test_a_card_that_is_busy_costs_python_one_call_when_it_is_polled(driver: Driver) -> None:
    bench = driver.bench
    assert driver.command(24, 1) == b"\x00"
    driver.move(b"\xff\xfe" + bytes(512) + crc16(bytes(512)))
    card, calls = bench.hardware.log_place.chip, 0
    assert card is not None
    exchange = card.exchange

    def counted(*arguments: Any, **named: Any) -> bytes:
        nonlocal calls
        calls += 1
        return exchange(*arguments, **named)

    card.exchange = counted  # type: ignore[method-assign]
    assert driver.poll(b"\xff")[0] & 0x1F == 5
    zeros = 0
    while zeros < 5000 and driver.poll(b"\xff") == b"\x00":
        zeros += 1
    assert 300 < zeros < 5000  # half a millisecond at 13.5 MHz, with the program's own time between
    assert calls <= 3


def test_a_card_that_is_struck_stops_answering_and_comes_back_anew(driver: Driver) -> None:
    bench = driver.bench
    driver.write(1, pattern(1))
    bench.hardware.log_place.strike(CardFault.REMOVED)
    assert driver.command(13) == b""
    bench.hardware.log_place.strike(CardFault.INSERTED)
    assert driver.command(13) == b""  # too fast, and not initialised
    driver.speed(SLOW)
    driver.start()
    assert driver.read(1) == pattern(1)


def test_a_byte_that_has_passed_counts_when_the_card_is_let_go_behind_it(driver: Driver, image: Path) -> None:
    bench = driver.bench
    assert driver.command(24, 6) == b"\x00"
    *most, last = b"\xff\xfe" + pattern(6) + crc16(pattern(6))
    driver.move(bytes(most))
    bench.write("SPI3_DR", last, 1)
    bench.context.run(5)
    driver.select(False)  # nothing was read that could have shown the byte
    assert bench.read("SPI3_DR", 1) == 0xFF
    assert blocks_of(image, 6) == pattern(6)


def test_a_card_that_is_pulled_while_it_is_busy_lets_go_of_the_line(driver: Driver) -> None:
    bench = driver.bench
    assert driver.command(24, 6) == b"\x00"
    driver.move(b"\xff\xfe" + bytes(512) + crc16(bytes(512)) + b"\xff\xff")
    assert driver.poll(b"\xff") == b"\x00"
    bench.hardware.log_place.strike(CardFault.REMOVED)
    assert driver.poll(b"\xff") == b"\xff"


def test_board_and_card_go_on_alike_when_restored(driver: Driver, image: Path) -> None:
    bench = driver.bench
    driver.write(1, pattern(1))
    engine = bench.hardware.engine
    snapshot = take_snapshot(engine)
    runs = []
    for _ in range(2):
        responses = [driver.write(block, pattern(block)) for block in (1, 2, 3)]
        runs.append((responses, engine.cycle, blocks_of(image, 0, 10)))
        restore_snapshot(engine, snapshot)
        assert blocks_of(image, 0, 10) == bytes(512) + pattern(1) + bytes(8 * 512)
    assert runs[0] == runs[1]


def test_a_board_without_a_card_refuses_the_snapshot_of_one_with(
    make_bench: type[Bench], image: Path
) -> None:
    bench, _ = fitted(make_bench, image)
    other = make_bench()
    with pytest.raises(BoardError, match="a board with a card into one without"):
        restore_snapshot(other.hardware.engine, take_snapshot(bench.hardware.engine))


def variable(board: Board, name: str) -> int:
    return int.from_bytes(board.engine.memory(board.symbols[name], 4), "little")


def test_a_program_that_knows_the_manuals_only_stores_a_block(tmp_path: Path, image: Path) -> None:
    program, elf = build(tmp_path, (Path(__file__).parent / "card.c").read_text())
    board = Board(program, elf=elf, card=SdCard(image, timing=QUICK))
    board.run(0.04)
    expected = bytes((i * 7 + i // 256) & 0xFF for i in range(512))
    assert [variable(board, name) for name in ("stage", "response", "equal")] == [5, 5, 512]
    assert blocks_of(image, 5) == expected
    assert variable(board, "wakes") == 2  # it slept through both transfers
    # Half a millisecond of 1 us bytes, and of the program's own time between them.
    assert 50 < variable(board, "busy_polls") < 500
    assert board.report().resets == ("power",)
    board.close()
    SdCard(image).close()


def test_the_board_boots_again_when_the_power_goes_with_a_block(tmp_path: Path, image: Path) -> None:
    program, elf = build(tmp_path, (Path(__file__).parent / "card.c").read_text())
    card = SdCard(image, timing=QUICK)
    card.schedule(CardFault.POWER_CUT, write=1, cut=Cut.TORN, kept_bytes=10)
    board = Board(program, elf=elf, card=card)
    while len(board.engine.resets) == 1:
        board.run(0.001)
    assert blocks_of(image, 5) == bytes((i * 7) & 0xFF for i in range(10)) + bytes(502)
    board.run(0.04)
    assert board.report().resets == ("power", "power")
    assert variable(board, "stage") == 5
    assert card.writes == 2
