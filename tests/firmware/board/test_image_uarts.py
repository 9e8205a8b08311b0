"""The image's UARTs: reading the ring that circular DMA fills, and dropping broken frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

RECEIVER_STREAM = "5"  # of DMA1, for what USART2 receives (RM0431, table 24)
RING_BYTES = 256
MSP_RING_BYTES, MSP_SEND_BYTES = 4096, 1024
SCRATCH = 0x2000F000  # DTCM that the image does not use
USART1_ISR, USART2_ISR = 0x4001101C, 0x4000441C
CRSF, MSP = 1, 2  # the setting receiver_protocol
PARITY, FRAMING, IDLE = 1 << 0, 1 << 1, 1 << 4
DMA1_S5NDTR, DMA2_S5NDTR = 0x4002608C, 0x4002648C
DMA2_HISR = 0x40026404
HALF, FULL = 1 << 10, 1 << 11  # of stream 5
DMA2_S7CR, DMA2_S7NDTR, DMA2_S7M0AR = 0x400264B8, 0x400264BC, 0x400264C4


class Line:
    """The far end of a UART: puts bytes into its ring as DMA would."""

    def __init__(self, sketch: Any, ring: int, remaining: int, size: int = RING_BYTES) -> None:
        self.sketch, self.ring, self.remaining, self.size, self.head = sketch, ring, remaining, size, 0

    def send(self, data: bytes) -> None:
        for byte in data:
            self.sketch.uc.mem_write(self.ring + self.head, bytes([byte]))
            self.head = (self.head + 1) % self.size
        self.sketch.poke(self.remaining, self.size - self.head)


@pytest.fixture
def board(make_booted: Callable[[], Any]) -> Any:
    return make_booted()


@pytest.fixture
def sbus(board: Any, symbols: dict[str, int]) -> Line:
    return Line(board, symbols["receiver_ring_bytes"], DMA1_S5NDTR)


@pytest.fixture
def read(board: Any, symbols: dict[str, int]) -> Callable[..., bytes]:
    """Calls receiver_line_read."""

    def take(capacity: int = RING_BYTES) -> bytes:
        count = board.call_with(symbols["receiver_line_read"], 0, SCRATCH, capacity)
        return bytes(board.uc.mem_read(SCRATCH, count))

    return take


def test_the_receiver_line_is_inverted_8e2_when_set_up(board: Any) -> None:
    for name in ("M0", "PCE", "RE", "UE"):
        assert board.field("USART_CR1", name, "USART2") == 1
    assert board.field("USART_CR1", "PS", "USART2") == 0  # even
    assert board.field("USART_CR2", "STOP", "USART2") == 2  # two stop bits
    assert board.field("USART_CR2", "RXINV", "USART2") == 1
    assert board.field("DMA_SCR", "CIRC", "DMA1", RECEIVER_STREAM) == 1
    assert board.peek(0x4002000C) >> 6 & 3 == 2  # PA3 pulled down, where an inverted line rests


def test_the_line_is_plain_and_fast_when_the_receiver_speaks_crsf(
    board: Any, symbols: dict[str, int]
) -> None:
    board.call_with(symbols["receiver_line_start"], CRSF)
    for name in ("M0", "PCE", "TE"):
        assert board.field("USART_CR1", name, "USART2") == 0
    assert board.field("USART_CR1", "RE", "USART2") == board.field("USART_CR1", "UE", "USART2") == 1
    assert board.field("USART_CR2", "STOP", "USART2") == board.field("USART_CR2", "RXINV", "USART2") == 0
    listens = 54e6 / board.field("USART_BRR", "BRR", "USART2")
    assert listens == pytest.approx(416_666, rel=0.005)  # Crossfire
    assert listens == pytest.approx(420_000, rel=0.015)  # ExpressLRS; a USART takes 3.3 % and more (RM0431)
    assert board.peek(0x4002000C) >> 6 & 3 == 1  # PA3 pulled up: the line rests high
    assert board.sins == []


def test_no_byte_is_lost_when_crsf_breaks_one(
    board: Any, sbus: Line, read: Callable[..., bytes], symbols: dict[str, int]
) -> None:
    """Its frames have a checksum, which knows better which one is broken."""
    board.call_with(symbols["receiver_line_start"], CRSF)
    board.poke(USART2_ISR, FRAMING)
    sbus.send(b"frame")
    assert read() == b"frame"


def test_the_line_rests_when_the_receiver_speaks_msp(
    make_sketch: Callable[..., Any], symbols: dict[str, int]
) -> None:
    board = make_sketch()
    board.run(symbols["receiver_line_start"])
    assert board.call_with(symbols["receiver_line_start"], MSP) is not None
    assert board.field("USART_CR1", "UE", "USART2") == 0
    Line(board, symbols["receiver_ring_bytes"], DMA1_S5NDTR).send(b"noise")
    assert board.call_with(symbols["receiver_line_read"], 0, SCRATCH, RING_BYTES) == 0


def test_bytes_come_once_and_in_order_when_the_ring_wraps(sbus: Line, read: Callable[..., bytes]) -> None:
    assert read() == b""
    for start in range(0, 1000, 100):
        sent = bytes(i % 251 for i in range(start, start + 100))
        sbus.send(sent)
        assert read(60) + read() == sent
        assert read() == b""


@pytest.mark.parametrize("error", [PARITY, FRAMING])
def test_the_rest_of_a_frame_is_dropped_when_a_byte_is_broken(
    error: int, board: Any, sbus: Line, read: Callable[..., bytes]
) -> None:
    sbus.send(b"good")
    assert read() == b"good"
    board.poke(USART2_ISR, error)
    sbus.send(b"broken")
    assert read() == b""
    board.poke(USART2_ISR, 0)
    sbus.send(b"rest of it")
    assert read() == b""
    board.poke(USART2_ISR, IDLE)
    sbus.send(b"end")
    assert read() == b""
    sbus.send(b"next frame")
    assert read() == b"next frame"


def test_requests_are_taken_while_the_last_reply_is_sent_when_they_came_in(
    board: Any, symbols: dict[str, int]
) -> None:
    host = Line(board, symbols["msp_rings"], DMA2_S5NDTR, MSP_RING_BYTES)
    host.send(b"$M<\x00\x01\x01")  # API_VERSION
    handlers = next(symbols[name] for name in symbols if name.split(".")[0] == "handlers")  # main's static
    board.call_with(symbols["msp_lines_serve"], handlers)
    length, place = board.peek(DMA2_S7NDTR), board.peek(DMA2_S7M0AR)
    assert place == symbols["msp_buffers"]
    assert board.peek(DMA2_S7CR) & 1
    reply = bytes(board.uc.mem_read(place, length))
    assert reply[:5] == b"$M>\x03\x01"
    board.uc.mem_write(place, b"?")
    for _ in range(2):
        host.send(b"$M<\x00\x01\x01")
        board.call_with(symbols["msp_lines_serve"], handlers)
    assert board.uc.mem_read(place, 1) == b"?"  # the reply on the wire is not overwritten
    assert board.peek(DMA2_S7M0AR) == place
    board.poke(DMA2_S7CR, board.peek(DMA2_S7CR) & ~1)
    board.call_with(symbols["msp_lines_serve"], handlers)
    assert board.peek(DMA2_S7M0AR) == place + MSP_SEND_BYTES
    assert bytes(board.uc.mem_read(place + MSP_SEND_BYTES, board.peek(DMA2_S7NDTR))) == 2 * reply
    assert board.sins == []


def test_a_lost_request_is_void_when_dma_has_gone_round_since_the_last_look(
    board: Any, symbols: dict[str, int]
) -> None:
    """Both flags are up, which the model does not raise by itself: nobody knows how many bytes came."""
    host = Line(board, symbols["msp_rings"], DMA2_S5NDTR, MSP_RING_BYTES)
    handlers = next(symbols[name] for name in symbols if name.split(".")[0] == "handlers")
    lost = symbols["runtime_link_lost"] & ~1
    cleared: list[int] = []
    board.on_write = lambda register, value: cleared.append(value) if register.name == "DMA_HIFCR" else None
    for flags, told in ((HALF, False), (FULL, False), (HALF | FULL, True)):
        board.seen.clear()
        cleared.clear()
        board.poke(DMA2_HISR, flags)
        host.send(b"$M<\x00\x01\x01")
        board.call_with(symbols["msp_lines_serve"], handlers)
        assert (lost in board.seen) is told
        assert cleared[0] == flags  # taken, so that the next ones show
        answered = board.peek(DMA2_S7CR) & 1
        assert bool(answered) is not told
        board.poke(DMA2_S7CR, board.peek(DMA2_S7CR) & ~1)
        board.poke(DMA2_HISR, 0)
    assert board.sins == []
