"""The image's devices for logs: UART3 by DMA, SPI3 for the card."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.toolchain.contract import LOG_BAUDS, SRAM2

APB1_HZ = 54_000_000
SEND_BYTES = 1024  # of each of the line's two buffers
SCRATCH = 0x2000E000  # DTCM that the image does not use
DMA1_S3CR, DMA1_S3NDTR, DMA1_S3M0AR = 0x40026058, 0x4002605C, 0x40026064
DMA1_S0CR, DMA1_S7CR, DMA1_S0M0AR, DMA1_S7M0AR = 0x40026010, 0x400260B8, 0x4002601C, 0x400260C4
DMA1_S0NDTR = 0x40026014
USART3_ISR, SPI3_CR1 = 0x4000481C, 0x40003C00
GPIOB_AFRL = 0x40020420
DONE, LATER = 0, 1  # enum log_answer
ENABLED, TC = 1, 1 << 6


class LogLine:
    """The image's log on UART3."""

    def __init__(self, board: Any, symbols: dict[str, int]) -> None:
        self.board, self.symbols = board, symbols

    def write(self, data: bytes) -> int:
        self.board.uc.mem_write(SCRATCH, data)
        return int(self.board.call_with(self.symbols["log_uart_write"], 0, SCRATCH, len(data)))

    def sent(self) -> bytes:
        """What DMA has been given; it has moved it then."""
        if not self.board.peek(DMA1_S3CR) & ENABLED:
            return b""
        place, count = self.board.peek(DMA1_S3M0AR), self.board.peek(DMA1_S3NDTR)
        assert SRAM2.address <= place and place + count <= SRAM2.address + SRAM2.size
        self.board.poke(DMA1_S3CR, self.board.peek(DMA1_S3CR) & ~ENABLED)
        return bytes(self.board.uc.mem_read(place, count))

    def call(self, name: str) -> int:
        return int(self.board.call_with(self.symbols[f"log_uart_{name}"], 0))


@pytest.fixture
def line(make_booted: Callable[[], Any], symbols: dict[str, int]) -> LogLine:
    board = make_booted()
    board.call_with(symbols["log_uart_start"], 2_000_000)
    return LogLine(board, symbols)


def test_two_million_baud_are_exact_and_others_within_one_percent(
    make_booted: Callable[[], Any], symbols: dict[str, int]
) -> None:
    board = make_booted()
    for baud in LOG_BAUDS:
        board.call_with(symbols["log_uart_start"], baud)
        real = APB1_HZ / board.peek(0x4000480C)
        assert real == pytest.approx(baud, rel=0.01)
    assert real == 2_000_000
    assert board.sins == []


def test_bytes_are_sent_in_order_and_refused_when_both_buffers_are_full(line: LogLine) -> None:
    data = bytes(i * 7 % 251 for i in range(3000))
    assert line.call("begin") == DONE
    assert line.write(data[:100]) == 100
    assert line.write(data[100:]) == SEND_BYTES
    assert line.write(data[1124:]) == 0, "DMA still has the first ones"
    assert line.sent() == data[:100]
    assert line.write(data[1124:]) == SEND_BYTES
    line_bytes = line.sent()
    line.call("step")
    assert line_bytes + line.sent() == data[100:2148]
    assert line.board.sins == []


def test_a_log_has_ended_when_its_last_bit_is_on_the_line(line: LogLine) -> None:
    line.board.poke(USART3_ISR, TC)
    assert line.call("begin") == DONE
    line.write(b"the end")
    line.board.poke(USART3_ISR, 0)
    assert line.call("end") == LATER
    assert line.sent() == b"the end"
    assert line.call("end") == LATER
    line.board.poke(USART3_ISR, TC)
    assert line.call("end") == DONE


def test_the_card_is_spoken_to_slowly_then_quickly(
    make_booted: Callable[[], Any], symbols: dict[str, int]
) -> None:
    board = make_booted()
    board.call_with(symbols["log_spi_start"])
    divider = 2 << (board.peek(SPI3_CR1) >> 3 & 7)
    assert APB1_HZ / divider <= 400e3
    board.call_with(symbols["log_spi_speed"], 0, 1)
    assert 10e6 < APB1_HZ / (2 << (board.peek(SPI3_CR1) >> 3 & 7)) <= 25e6
    assert board.peek(GPIOB_AFRL) >> 12 & 0xFFF == 0x666, "PB3, PB4, PB5: SPI3"
    assert board.sins == []


def test_one_buffer_out_of_sight_of_the_cache_goes_out_and_in(
    make_booted: Callable[[], Any], symbols: dict[str, int]
) -> None:
    board = make_booted()
    board.call_with(symbols["log_spi_start"])
    board.call_with(symbols["log_spi_move"], 0, 520)
    place = symbols["spi_bytes"]
    assert SRAM2.address <= place and place + 520 <= SRAM2.address + SRAM2.size
    assert board.peek(DMA1_S0M0AR) == board.peek(DMA1_S7M0AR) == place
    assert board.peek(DMA1_S0NDTR) == 520
    assert board.peek(DMA1_S0CR) & board.peek(DMA1_S7CR) & ENABLED
    assert not board.call_with(symbols["log_spi_moved"], 0) & 0xFF
    board.poke(DMA1_S0CR, board.peek(DMA1_S0CR) & ~ENABLED)
    assert board.call_with(symbols["log_spi_moved"], 0) & 0xFF
    assert not board.peek(DMA1_S7CR) & ENABLED
    assert board.sins == []
