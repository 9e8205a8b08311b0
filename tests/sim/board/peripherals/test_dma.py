"""Streams: what is refused when they are enabled, and counts, flags and interrupts while they run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.peripherals.dma_requests import REQUESTS

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench


USART1_RDR = 0x40011024
DTCM, SRAM1, ITCM = 0x20000100, 0x20010000, 0x00000200
TCIE, CIRC, MINC = 1 << 4, 1 << 8, 1 << 10


def prepare(
    bench: Bench, memory: int = DTCM, count: int = 8, options: int = MINC, peripheral: int = USART1_RDR
) -> None:
    """USART1's receiver on DMA2 stream 5 channel 4."""
    bench.stream("DMA2_S5", peripheral, memory, count, 4 << 25 | options, enable=False)


def give(bench: Bench, *items: int) -> None:
    bench.hardware.dma.requests["USART1_RX"].give(items)


def test_requests_are_where_the_boards_facts_say() -> None:
    # facts of the board: streams that fit together.
    for place, request in (
        ((2, 0, 0), "ADC1"), ((2, 1, 7), "TIM8_UP"), ((2, 2, 3), "SPI1_RX"), ((2, 3, 3), "SPI1_TX"),
        ((2, 5, 4), "USART1_RX"), ((2, 7, 4), "USART1_TX"),
    ):  # fmt: skip
        assert request in REQUESTS[place]


def test_items_reach_memory_and_flags_rise_when_moved(fast: Bench) -> None:
    fast.context.set_memory(DTCM, bytes(16))
    prepare(fast, options=MINC | TCIE)
    fast.set("DMA2_S5CR", EN=1)
    give(fast, 1, 2, 3)
    assert fast.read("DMA2_S5NDTR") == 5
    assert fast.read("DMA2_HISR") == 0
    give(fast, 4)
    assert fast.get("DMA2_HISR", "HTIF5") == 1
    assert not fast.context.asserted("DMA2_STREAM5")
    give(fast, 5, 6, 7, 0x108)
    assert fast.get("DMA2_HISR", "TCIF5") == 1
    assert fast.get("DMA2_S5CR", "EN") == 0
    assert fast.context.asserted("DMA2_STREAM5")
    assert fast.context.memory(DTCM, 9) == bytes([1, 2, 3, 4, 5, 6, 7, 8, 0])
    fast.write("DMA2_HIFCR", 1 << 11)
    assert not fast.context.asserted("DMA2_STREAM5")


def test_stream_begins_anew_when_circular(fast: Bench) -> None:
    prepare(fast, options=MINC | CIRC)
    fast.set("DMA2_S5CR", EN=1)
    give(fast, *range(10))
    assert fast.read("DMA2_S5NDTR") == 6
    assert fast.get("DMA2_S5CR", "EN") == 1
    assert fast.context.memory(DTCM, 8) == bytes([8, 9, 2, 3, 4, 5, 6, 7])


def test_stream_says_it_has_ended_when_stopped(fast: Bench) -> None:
    prepare(fast)
    fast.set("DMA2_S5CR", EN=1)
    give(fast, 1)
    fast.set("DMA2_S5CR", EN=0)
    assert fast.get("DMA2_HISR", "TCIF5") == 1
    assert fast.read("DMA2_S5NDTR") == 7
    assert fast.hardware.dma.requests["USART1_RX"].available == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"memory": ITCM}, "memory 0x00000200 to 0x00000207 is out of the reach of DMA"),
        ({"memory": 0x08000000}, "out of the reach of DMA, expected DTCM, SRAM1 or SRAM2"),
        ({"count": 0}, "enabled with NDTR 0"),
        ({"peripheral": 0x40011028, "options": MINC | 1 << 6}, "USART1_RX moves from the peripheral"),
        ({"peripheral": 0x4001300C}, r"is driven by USART1_RX, but its peripheral address is SPI1_DR"),
        ({"peripheral": 0x40005424}, "is no register that the emulator models"),
        ({"options": MINC | 2 << 6}, "memory to memory is not modelled"),
        ({"memory": DTCM + 1, "options": MINC | 1 << 11 | 1 << 13}, "not aligned to items of 2 bytes"),
    ],
)
def test_stream_is_refused_when_set_up_wrong(fast: Bench, options: dict[str, int], message: str) -> None:
    prepare(fast, **options)
    with pytest.raises(BoardError, match=message):
        fast.set("DMA2_S5CR", EN=1)


def test_stream_is_refused_when_its_buffer_is_cached(fast: Bench) -> None:
    prepare(fast, memory=SRAM1)
    fast.set("DMA2_S5CR", EN=1)
    fast.context.cache = True  # switched on later
    with pytest.raises(
        BoardError, match="DMA2 stream 5: 0x20010000 lies in cached RAM while the data cache is on"
    ):
        give(fast, 1)
    fast.context.cache = False
    fast.set("DMA2_S5CR", EN=0)
    fast.write("DMA2_HIFCR", 0x3D << 6)
    fast.context.cache = True
    with pytest.raises(BoardError, match="lies in cached RAM"):
        fast.set("DMA2_S5CR", EN=1)


def send(bench: Bench, memory: int) -> None:
    """Four bytes out of USART1 by DMA2 stream 7."""
    bench.alternate("PA9", 7)
    bench.write("USART1_BRR", 938)
    bench.write("USART1_CR3", bench.bits("USART1_CR3", "DMAT"))
    bench.write("USART1_CR1", bench.bits("USART1_CR1", "TE", "UE"))
    bench.stream("DMA2_S7", USART1_RDR + 4, memory, 4, 4 << 25 | 1 << 6 | MINC)


def test_stream_is_refused_when_it_reads_dtcm_while_the_core_sleeps(fast: Bench) -> None:
    send(fast, DTCM)
    with pytest.raises(BoardError, match=r"DMA2 stream 7 reads DTCM \(0x20000100\) while the core sleeps"):
        fast.context.sleep()


def test_the_core_may_sleep_when_a_stream_reads_sram_or_writes_dtcm(fast: Bench) -> None:
    send(fast, SRAM1)
    prepare(fast, DTCM)
    fast.set("DMA2_S5CR", EN=1)
    fast.context.sleep()
    assert (fast.get("DMA2_S7CR", "EN"), fast.get("DMA2_S5CR", "EN")) == (1, 1)


def test_stream_is_refused_when_its_flags_are_set(fast: Bench) -> None:
    prepare(fast, count=1)
    fast.set("DMA2_S5CR", EN=1)
    give(fast, 1)
    fast.write("DMA2_S5NDTR", 1)
    with pytest.raises(BoardError, match="DMA2 stream 5 is enabled while HTIF, TCIF is set"):
        fast.set("DMA2_S5CR", EN=1)


def test_stream_is_refused_when_changed_while_enabled(fast: Bench) -> None:
    prepare(fast)
    fast.set("DMA2_S5CR", EN=1)
    with pytest.raises(BoardError, match="M0AR is written while the stream is enabled"):
        fast.write("DMA2_S5M0AR", DTCM)
    with pytest.raises(BoardError, match="its configuration is changed while it is enabled"):
        fast.set("DMA2_S5CR", CIRC=1)


def test_stream_is_refused_when_its_peripheral_has_no_clock(fast: Bench) -> None:
    prepare(fast)
    fast.set("RCC_APB2ENR", USART1EN=0)
    with pytest.raises(BoardError, match="enabled for USART1_RDR, but RCC_APB2ENR USART1EN is 0"):
        fast.set("DMA2_S5CR", EN=1)


def test_dma1_is_refused_when_its_peripheral_is_not_on_apb1(fast: Bench) -> None:
    fast.stream("DMA1_S5", USART1_RDR, DTCM, 1, 4 << 25, enable=False)
    with pytest.raises(
        BoardError, match="DMA1 reaches peripherals on APB1 only, but its address is USART1_RDR"
    ):
        fast.set("DMA1_S5CR", EN=1)


def test_streams_go_on_alike_when_restored(fast: Bench) -> None:
    prepare(fast)
    fast.set("DMA2_S5CR", EN=1)
    give(fast, 1, 2)
    registers = fast.hardware.registers.state()
    give(fast, *range(3, 9))
    fast.hardware.registers.restore(registers)
    assert fast.hardware.dma.requests["USART1_RX"].available == 6
    give(fast, 7)
    assert fast.context.memory(DTCM, 3) == bytes([1, 2, 7])
