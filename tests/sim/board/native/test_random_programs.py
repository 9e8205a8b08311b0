"""Random programs see the same data whether peripherals catch up at every step or as late as they can."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from tests.sampling import examples

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench

BUFFER = 0x20011000
SPI1_DR, SPI3_DR = 0x4001300C, 0x40003C0C
GPIOC_IDR, GPIOC_ODR, GPIOC_BSRR = 0x40020810, 0x40020814, 0x40020818

# Values that make something happen, by register; a stream's CR without EN comes before one with it.
WRITES: dict[str, tuple[int, ...]] = {
    "TIM1_CR1": (0x81, 0x81, 0x01, 0x80, 0x89, 0x85, 0x83),
    "TIM1_ARR": (119, 119, 95, 479),
    "TIM1_PSC": (0, 0, 0, 1, 6),
    "TIM1_CCR1": (0, 100, 135),
    "TIM1_CCR3": (0, 10, 400),
    "TIM1_CCMR1": (0x6868, 0x6060, 0x6868),
    "TIM1_CCMR2": (0x6868,),
    "TIM1_DIER": (0x800, 0x800, 0x801, 0x900, 0),
    "TIM1_CR2": (0, 8),
    "TIM1_EGR": (1, 1, 2),
    "TIM1_CNT": (0, 5, 300),
    "TIM1_SR": (0, 0x1E),
    "TIM3_CR1": (1, 0x81, 0),
    "TIM3_ARR": (999, 49),
    "TIM3_DIER": (0, 1),
    "TIM3_EGR": (1,),
    "TIM3_SR": (0,),
    "DMA2_S6NDTR": (72, 18, 4, 7),
    "DMA2_S6PAR": (GPIOC_BSRR, GPIOC_BSRR, GPIOC_ODR, GPIOC_IDR),
    "DMA2_S6M0AR": (BUFFER, BUFFER + 64),
    "DMA2_S6CR": (0xC005440, 0xC005450, 0xC005441, 0xC005451, 0xC002C00, 0xC002C11, 0xC005541, 0xC005440),
    "DMA2_S2NDTR": (15, 3, 8),
    "DMA2_S2PAR": (SPI1_DR,),
    "DMA2_S2M0AR": (BUFFER + 512,),
    "DMA2_S2CR": (0x6000400, 0x6000410, 0x6000411, 0x6000401, 0x6000500, 0x6000501, 0x6000408),
    "DMA2_S3NDTR": (15, 4, 1),
    "DMA2_S3PAR": (SPI1_DR,),
    "DMA2_S3M0AR": (BUFFER + 1024,),
    "DMA2_S3CR": (0x6000440, 0x6000450, 0x6000441, 0x6000451, 0x6000541),
    "DMA2_LIFCR": (0x0F7D0F7D, 0x0F7D0F7D, 0x00200000, 0x800),
    "DMA2_HIFCR": (0x0F7D0F7D, 0x0F7D0F7D, 0x00200000, 0x800),
    "SPI1_CR1": (0x347, 0x357, 0x307, 0x317, 0x347),
    "SPI1_CR2": (0x1703, 0x1701, 0x1702, 0x1700, 0x1743, 0x1780),
    "GPIOC_BSRR": (1 << 2, 1 << 18, 1 << 18),
    "GPIOC_MODER": (0x55010, 0x55010, 0x05010, 0x00010),
    "EXTI_IMR": (8, 0, 0xFFFF),
    "EXTI_RTSR": (8, 0),
    "EXTI_FTSR": (8, 0),
    "EXTI_PR": (8, 0xFFFF),
    "EXTI_SWIER": (8, 0x60),
    "SYSCFG_EXTICR1": (0x2000, 0),
}
READS = (*(n for n in WRITES if n not in ("TIM1_EGR", "TIM3_EGR", "DMA2_LIFCR", "DMA2_HIFCR", "GPIOC_BSRR")),
         "DMA2_LISR", "DMA2_HISR", "SPI1_SR", "GPIOC_IDR", "GPIOC_ODR", "TIM3_CNT", "TIM1_CCR2")  # fmt: skip
STREAMS = ("DMA2_S6", "DMA2_S2", "DMA2_S3", "DMA1_S0", "DMA1_S5")
SYNCING = (
    *(f"{stream}NDTR" for stream in STREAMS),
    "TIM1_CNT",
    "TIM3_CNT",
)  # bring all up to now
LINES = ("TIM1_UP_TIM10", "TIM3", "DMA2_STREAM6",
         "DMA2_STREAM2", "DMA2_STREAM3", "SPI1", "EXTI3", "EXTI9_5",
         "SPI3", "DMA1_STREAM0", "DMA1_STREAM5")  # fmt: skip


def program(seed: int, steps: int) -> list[tuple[str, str, int]]:
    """Steps as kind, register and value."""
    rng = random.Random(seed)
    names = list(WRITES)
    # A set-up from which things move, then anything.
    done = [("write", name, WRITES[name][0]) for name in names if not name.startswith(("EXTI", "SYSCFG"))]
    for _ in range(steps):
        kind = rng.choices(("write", "byte", "run", "read", "pin"), (8, 2, 6, 6, 1))[0]
        if kind == "write":
            name = rng.choice(names)
            done.append((kind, name, rng.choice(WRITES[name])))
        elif kind == "byte":
            done.append((rng.choice(("byte", "take")), "SPI1_DR", rng.randrange(256)))
        elif kind == "run":
            done.append((kind, "", rng.choice((3, 17, 61, 211, 1013, 4001))))
        elif kind == "read":
            done.append((kind, rng.choice(READS), 0))
        else:
            done.append((kind, "PC3", rng.randrange(2)))
    return done


SPI3 = {"SPI1": "SPI3", "DMA2_S2": "DMA1_S0", "DMA2_S3": "DMA1_S5", "DMA2_LI": "DMA1_LI"}  # for SPI1's
CHANNEL = 3 << 25


def on_spi3(steps: list[tuple[str, str, int]]) -> list[tuple[str, str, int]]:
    """The same program, with SPI3 and its streams in place of SPI1 and its own."""
    done = []
    for kind, name, value in steps:
        old = next((old for old in SPI3 if name.startswith(old)), None)
        other = name if old is None else SPI3[old] + name.removeprefix(old)
        if other.startswith("DMA1_S"):
            value = value & ~CHANNEL if other.endswith("CR") else SPI3_DR if value == SPI1_DR else value
        done.append((kind, other, value))
        if (kind, other) == ("write", "DMA1_LIFCR"):
            done.append((kind, "DMA1_HIFCR", value))
    return done


def execute(bench: Bench, steps: list[tuple[str, str, int]], pieces: int) -> list[object]:
    """What a program sees, up to the first refusal.

    pieces: that time passes in; after each but the only one, reads synchronize the peripherals.
    """
    bench.full_speed()
    for pin, function in (("PA5", 5), ("PA6", 5), ("PA7", 5), ("PB3", 6), ("PB4", 6), ("PB5", 6)):
        bench.alternate(pin, function)
    bench.context.set_memory(BUFFER, bytes(range(256)) * 8)
    bench.hardware.native.on_exchange = lambda sent, *_: bytes(byte ^ 0x5A for byte in sent)
    native = bench.hardware.native
    native.on_card = lambda sent, *_: bytes(byte ^ 0xA5 for byte in sent)
    native.library.native_card(native.handle)  # from now on that answers
    trains: list[tuple[int, list[int], bool]] = []
    native.on_train = lambda *train: trains.append(train)
    seen: list[object] = []
    try:
        for kind, name, value in steps:
            if kind == "write":
                bench.write(name, value)
            elif kind == "byte":
                bench.write(name, value, 1)
            elif kind == "take":
                seen.append(bench.read(name, 1))
            elif kind == "read":
                seen.append((name, bench.read(name)))
            elif kind == "pin":
                bench.hardware.pins.drive(name, bool(value))
            else:
                begin = bench.context.cycle
                for piece in range(1, pieces + 1):
                    bench.context.run_to(begin + value * piece // pieces)
                    for register in SYNCING if pieces > 1 else ():
                        bench.read(register)
        # What ends in this very cycle shows when somebody looks.
        seen += [bench.read(register) for register in SYNCING]
        seen += [bench.context.asserted(line) for line in LINES]
        seen.append(bytes(bench.context.memory(BUFFER, 2048)))
    except BoardError as error:
        seen.append(str(error).split("; pc")[0])
    seen.append([[train for train in trains if train[0] == motor] for motor in range(4)])
    return seen


@pytest.mark.parametrize("seed", range(examples(160)))
def test_random_program_sees_the_same_when_registers_are_read_meanwhile(
    make_bench: type[Bench], seed: int
) -> None:
    steps = program(seed, 12)
    assert execute(make_bench(), steps, 1) == execute(make_bench(), steps, 7)


@pytest.mark.parametrize("seed", range(100, 100 + examples(80)))
def test_random_program_on_spi3_sees_the_same_when_registers_are_read_meanwhile(
    make_bench: type[Bench], seed: int
) -> None:
    steps = on_spi3(program(seed, 12))
    assert execute(make_bench(), steps, 1) == execute(make_bench(), steps, 7)


def test_most_random_programs_get_through(make_bench: type[Bench]) -> None:
    seeds = range(examples(160))
    refused = [isinstance(execute(make_bench(), program(seed, 12), 1)[-2], str) for seed in seeds]
    assert sum(refused) < len(seeds) // 4
