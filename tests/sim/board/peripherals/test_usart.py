"""Bytes over the board's lines: timing, formats, DMA, interrupts, mistakes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.peripherals.usart import CRSF, SBUS, Format

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench


RING, REPLY = 0x20004000, 0x20015000
MSP = Format(115_200)
UE, RE, TE, RXNEIE, IDLEIE = 1 << 0, 1 << 2, 1 << 3, 1 << 5, 1 << 4
DMAR, DMAT, OVRDIS = 1 << 6, 1 << 7, 1 << 12


def start_msp(bench: Bench, cr1: int = RE | TE, cr3: int = 0, clock: int = 108_000_000) -> None:
    bench.alternate("PA9", 7)
    bench.alternate("PA10", 7)
    bench.write("USART1_BRR", (clock + 57_600) // 115_200)
    bench.write("USART1_CR3", cr3)
    bench.write("USART1_CR1", cr1 | UE)


def start_sbus(bench: Bench) -> None:
    """As SBUS comes: 100 kbaud, 8E2, inverted, into a ring by DMA1 stream 5."""
    bench.alternate("PA3", 7)
    bench.stream("DMA1_S5", 0x40004424, RING, 64, 4 << 25 | 1 << 10 | 1 << 8)
    bench.write("USART2_BRR", 540)
    bench.write("USART2_CR2", 2 << 12 | 1 << 16)
    bench.write("USART2_CR3", OVRDIS | DMAR)
    bench.write("USART2_CR1", RE | 1 << 12 | 1 << 10)
    bench.set("USART2_CR1", UE=1)


def test_format_is_the_lines_when_set_by_registers(fast: Bench) -> None:
    start_sbus(fast)
    usart = fast.hardware.usarts["USART2"]
    assert usart.format == SBUS
    assert SBUS.byte_cycles == 120 * 216
    assert CRSF.byte_cycles == round(10 / 416_666 * 216e6)


def test_frame_lies_in_the_ring_when_its_time_has_passed(fast: Bench) -> None:
    start_sbus(fast)
    frame = bytes(range(25))
    end = fast.hardware.usarts["USART2"].feed(frame, SBUS)
    assert end == fast.context.cycle + 25 * 120 * 216
    fast.context.run_to(end - 1)
    assert fast.read("DMA1_S5NDTR") == 64 - 24
    fast.context.run_to(end + 1)
    assert fast.read("DMA1_S5NDTR") == 64 - 25
    assert fast.context.memory(RING, 25) == frame
    assert fast.read("USART2_ISR") & 0x3F == 0
    fast.context.run(121)
    assert fast.get("USART2_ISR", "IDLE") == 1
    fast.write("USART2_ICR", 1 << 4)
    fast.context.run(1000)
    assert fast.get("USART2_ISR", "IDLE") == 0


def test_frame_ends_when_it_was_told_to(fast: Bench) -> None:
    start_sbus(fast)
    wanted = fast.context.cycle + 10_000 * 216
    assert fast.hardware.usarts["USART2"].feed(bytes(25), SBUS, end=wanted) == wanted
    fast.context.run_to(wanted - 1)
    assert fast.read("DMA1_S5NDTR") == 64 - 24


@pytest.mark.parametrize(
    "sender", [CRSF, Format(100_000, parity="E", stop_bits=2.0), Format(100_000, inverted=True)]
)
def test_bytes_break_when_the_sender_speaks_another_format(fast: Bench, sender: Format) -> None:
    start_sbus(fast)
    usart = fast.hardware.usarts["USART2"]
    usart.feed(b"\x0f", sender)
    fast.context.run(1000)
    assert usart.mismatches == 1
    assert list(fast.context.notes) == [f"USART2 listens at 100000 baud 8E2 inverted, but is sent {sender}"]
    assert fast.get("USART2_ISR", "FE") == 1
    assert fast.context.memory(RING, 1) == b"\xf0"


def test_parity_error_is_flagged_when_a_byte_is_broken(fast: Bench) -> None:
    start_sbus(fast)
    fast.hardware.usarts["USART2"].feed(b"ab", SBUS, broken=[1])
    fast.context.run(130)
    assert fast.get("USART2_ISR", "PE") == 0
    fast.context.run(130)
    assert fast.get("USART2_ISR", "PE") == 1
    fast.write("USART2_ICR", 1)
    assert fast.get("USART2_ISR", "PE") == 0


def test_interrupt_asks_for_the_byte_when_enabled(fast: Bench) -> None:
    start_msp(fast, RE | RXNEIE)
    fast.hardware.usarts["USART1"].feed(b"$", MSP)
    fast.context.run(86)
    assert not fast.context.asserted("USART1")
    fast.context.run(2)
    assert fast.context.asserted("USART1")
    assert fast.read("USART1_RDR") == ord("$")
    assert not fast.context.asserted("USART1")


def test_interrupt_comes_when_the_line_rests(fast: Bench) -> None:
    start_msp(fast, RE | IDLEIE)
    fast.hardware.usarts["USART1"].feed(b"$M", MSP)
    fast.context.run(2 * 86.8 + 80)
    assert not fast.context.asserted("USART1")
    fast.context.run(10)
    assert fast.context.asserted("USART1")
    assert fast.hardware.usarts["USART1"].lost == 1  # nobody read the first


def test_overrun_is_flagged_when_nobody_reads(fast: Bench) -> None:
    start_msp(fast)
    fast.hardware.usarts["USART1"].feed(b"ab", MSP)
    fast.context.run(200)
    assert fast.get("USART1_ISR", "ORE") == 1
    assert fast.read("USART1_RDR") == ord("a")


def test_reply_leaves_byte_by_byte_when_sent_by_dma(fast: Bench) -> None:
    start_msp(fast, cr3=DMAT)
    sent: list[tuple[int, int]] = []
    fast.hardware.usarts["USART1"].on_sent = lambda byte: sent.append((byte, fast.context.cycle))
    fast.context.set_memory(REPLY, b"$M>\0\x01\x01")
    begin = fast.context.cycle
    fast.stream("DMA2_S7", 0x40011028, REPLY, 6, 4 << 25 | 1 << 10 | 1 << 6)
    assert fast.read("DMA2_S7NDTR") == 4  # one on the wire, one waits
    fast.context.run(1000)
    assert bytes(byte for byte, _ in sent) == b"$M>\0\x01\x01"
    byte_time = fast.hardware.usarts["USART1"].format.byte_cycles
    assert [cycle for _, cycle in sent] == [begin + byte_time * (i + 1) for i in range(6)]
    assert fast.get("USART1_ISR", "TC") == 1


def test_usart_is_refused_when_misused(fast: Bench) -> None:
    start_msp(fast)
    with pytest.raises(BoardError, match="USART1_BRR BRR changes while UE is 1"):
        fast.write("USART1_BRR", 117)
    fast.write("USART1_TDR", 1)
    fast.write("USART1_TDR", 2)
    with pytest.raises(BoardError, match="USART1_TDR is written while ISR TXE is 0"):
        fast.write("USART1_TDR", 3)
    fast.set("GPIOA_MODER", MODER10=0)
    fast.hardware.usarts["USART1"].feed(b"x", MSP)
    with pytest.raises(BoardError, match="USART1 receives: PA10 is an input, expected alternate function 7"):
        fast.context.run(100)


def test_bytes_are_lost_when_the_receiver_is_off(fast: Bench) -> None:
    usart = fast.hardware.usarts["USART1"]
    usart.feed(b"abc", MSP)
    fast.context.run(1000)
    assert usart.lost == 3
