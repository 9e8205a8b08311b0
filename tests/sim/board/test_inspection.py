"""Streams that never move and edges mistaken, although every single access is right."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench

BUFFER = 0x20011000
GPIOC_BSRR = 0x40020818
EN, TO_PERIPHERAL, MINC, CIRC, WORDS = 1, 1 << 6, 1 << 10, 1 << 8, 2 << 11 | 2 << 13
ARPE_CEN = 1 << 7 | 1


@pytest.fixture
def motors(fast: Bench) -> Bench:
    """TIM8 counting bits, its update's stream ready, as the motors' driver sets it up."""
    fast.reset("software")
    fast.full_speed()
    for register, value in (("ARR", 719), ("EGR", 1), ("CR1", ARPE_CEN)):
        fast.write(f"TIM8_{register}", value)
    fast.write("DMA2_S1PAR", GPIOC_BSRR)
    fast.write("DMA2_S1M0AR", BUFFER)
    return fast


def start_stream(bench: Bench, items: int = 72, options: int = 0) -> None:
    bench.write("DMA2_LIFCR", 0x3D << 6)
    bench.write("DMA2_S1NDTR", items)
    bench.write("DMA2_S1CR", 7 << 25 | WORDS | MINC | TO_PERIPHERAL | options)
    bench.set("DMA2_S1CR", EN=1)


@pytest.mark.parametrize("forgotten", ["request", "timer"])
def test_stream_is_refused_when_nothing_makes_its_requests(motors: Bench, forgotten: str) -> None:
    if forgotten == "timer":
        motors.set("TIM8_CR1", CEN=0)
        motors.set("TIM8_DIER", UDE=1)
    start_stream(motors)
    with pytest.raises(BoardError, match=r"DMA2 stream 1 has waited .* to move 72 items to 0x40020818"):
        motors.context.run(25_000)


def test_streams_are_at_work_when_frames_follow_each_other(motors: Bench) -> None:
    motors.set("TIM8_DIER", UDE=1)
    for _ in range(240):  # 60 ms, six looks, a frame under way at every one
        start_stream(motors)
        motors.context.run(250)
    assert motors.get("DMA2_S1CR", "EN") == 0


def test_stream_is_at_work_when_it_never_ends(motors: Bench) -> None:
    motors.set("TIM8_DIER", UDE=1)
    start_stream(motors, 4000, CIRC)
    motors.context.run(40_000)
    assert motors.get("DMA2_S1CR", "EN") == 1


@pytest.mark.parametrize(("rises", "falls"), [(1, 0), (1, 1), (0, 1)])
def test_gyro_line_is_refused_when_only_its_fall_is_taken(motors: Bench, rises: int, falls: int) -> None:
    motors.set("EXTI_RTSR", TR3=rises)
    motors.set("EXTI_FTSR", TR3=falls)
    motors.context.run(11_000)
    motors.set("EXTI_IMR", IM3=1)
    if rises:
        motors.context.run(11_000)
    else:
        with pytest.raises(BoardError, match="EXTI line 3 takes the falling edge"):
            motors.context.run(11_000)
