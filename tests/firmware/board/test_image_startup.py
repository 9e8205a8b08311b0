"""The image's first steps, executed: reset, boot part, bank A, clock, set-up, background."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from elftools.elf.elffile import ELFFile
from unicorn.arm_const import UC_ARM_REG_CONTROL, UC_ARM_REG_R0, UC_ARM_REG_SP

from neuroflight.sim.board.registers.core_registers import Register
from neuroflight.toolchain.boards.description import BOARD_BYTES, unpack
from neuroflight.toolchain.contract import DTCM, FLASH_BANK_A, SRAM2

MakeSketch = Callable[..., Any]
GPIOB_MODER = 0x40020400
DELAY_BYTES = 64  # time_delay_ms is shorter
STEPS_TO_STOP = 200_000  # start-up and the longest time-out take a third of it


@pytest.fixture
def sketch(make_sketch: MakeSketch) -> Any:
    return make_sketch()


def test_the_program_starts_in_place_when_reset(sketch: Any, elf: ELFFile, symbols: dict[str, int]) -> None:
    sketch.run(symbols["main"])
    assert symbols["boot_reset"] & ~1 in sketch.seen
    assert sketch.peek(0xE000ED08) == symbols["fast_vectors"]  # VTOR
    assert sketch.field("SCB_CPACR", "CP10") == sketch.field("SCB_CPACR", "CP11") == 3
    for name in (".itcm", ".data"):
        section = elf.get_section_by_name(name)
        assert section is not None
        assert bytes(sketch.uc.mem_read(section["sh_addr"], section["sh_size"])) == section.data()
    table = elf.get_section_by_name(".vectors")
    assert table is not None
    assert bytes(sketch.uc.mem_read(symbols["fast_vectors"], table["sh_size"])) == table.data()
    for part in ("bss", "sram_bss", "uncached_bss"):
        size = symbols[f"{part}_end"] - symbols[f"{part}_start"]
        assert bytes(sketch.uc.mem_read(symbols[f"{part}_start"], size)) == bytes(size)
    assert sketch.uc.reg_read(UC_ARM_REG_SP) > DTCM.address
    assert sketch.uc.reg_read(UC_ARM_REG_CONTROL) & 4 == 0  # no floating-point instruction so far
    assert sketch.sins == []


def test_the_core_switches_to_216_mhz_only_when_flash_and_regulator_are_ready(
    sketch: Any, symbols: dict[str, int]
) -> None:
    switched = []

    def on_write(register: Register, value: int) -> None:
        if register.name == "RCC_CFGR" and value & 3 == 2:
            switched.append(
                {
                    "wait states": sketch.field("FLASH_ACR", "LATENCY"),
                    "over-drive": sketch.field("PWR_CSR1", "ODSWRDY"),
                    "PLL locked": sketch.field("RCC_CR", "PLLRDY"),
                    "APB1, APB2": (value >> 10 & 7, value >> 13 & 7),
                }
            )

    sketch.on_write = on_write
    sketch.run(symbols["clock_peripherals"])
    # 7 wait states at 216 MHz; 101 and 100 divide by 4 and 2 (RM0431, RCC_CFGR).
    assert switched == [{"wait states": 7, "over-drive": 1, "PLL locked": 1, "APB1, APB2": (5, 4)}]
    pll = {name: sketch.field("RCC_PLLCFGR", name) for name in ("PLLM", "PLLN", "PLLP", "PLLQ", "PLLSRC")}
    vco_hz = 8_000_000 * pll["PLLN"] / pll["PLLM"]
    assert pll["PLLSRC"] == 1
    assert 1e6 <= 8_000_000 / pll["PLLM"] <= 2e6 and 100e6 <= vco_hz <= 432e6
    assert vco_hz / (2 * pll["PLLP"] + 2) == 216e6
    assert vco_hz / pll["PLLQ"] == 48e6
    assert sketch.field("SCB_CCR", "IC") == sketch.field("SCB_CCR", "DC") == 1
    assert sketch.field("MPU_CTRL", "ENABLE") == 1
    assert sketch.sins == []


def test_the_core_goes_to_216_mhz_from_the_internal_oscillator_when_the_crystal_does_not_start(
    make_sketch: MakeSketch, symbols: dict[str, int]
) -> None:
    sketch = make_sketch(dead=frozenset({"HSERDY"}))
    sketch.run(symbols["clock_peripherals"])
    pll = {name: sketch.field("RCC_PLLCFGR", name) for name in ("PLLM", "PLLN", "PLLP", "PLLSRC")}
    assert pll["PLLSRC"] == 0
    assert 16_000_000 / pll["PLLM"] == 2e6
    assert 16_000_000 * pll["PLLN"] / pll["PLLM"] / (2 * pll["PLLP"] + 2) == 216e6
    assert (sketch.field("RCC_CR", "HSEON"), sketch.field("RCC_CR", "CSSON")) == (0, 0)
    assert sketch.field("RCC_CFGR", "SWS") == 2
    assert not sketch.call_with(symbols["clock_is_exact"]) & 0xFF
    assert sketch.sins == []


def test_the_board_serves_without_a_gyro_when_nothing_answers(sketch: Any, symbols: dict[str, int]) -> None:
    sketch.run(symbols["msp_lines_serve"])
    assert sketch.sins == []
    assert sketch.field("EXTI_IMR", "IM3") == 0
    # Motors: PC6..PC9 are outputs, the timer runs and asks for nothing, no frame.
    assert sketch.peek(0x40020800) >> 12 & 0xFF == 0b01010101
    assert sketch.field("TIM_CR1", "CEN", "TIM1") == 1 and sketch.peek(0x4001000C) == 0
    assert sketch.peek(0x400264A0) & 1 == 0
    # Baud rates: APB2 / 938 = 115139, APB1 / 540 = 100000.
    assert (sketch.peek(0x4001100C), sketch.peek(0x4000440C)) == (938, 540)


def test_a_deadline_is_missed_when_a_control_step_takes_longer_than_its_period(
    make_booted: Callable[[], Any], symbols: dict[str, int]
) -> None:
    board = make_booted()
    millisecond = 216_000  # cycles: the period of a policy at 1 kHz
    assert not board.call_with(symbols["hal_deadline_missed"], 0, millisecond) & 0xFF
    assert board.call_with(symbols["hal_deadline_missed"], 0, millisecond + 1) & 0xFF


def test_memory_is_closed_or_uncached_where_it_must_be_when_started(
    sketch: Any, symbols: dict[str, int]
) -> None:
    regions: dict[int, dict[str, int]] = {}
    number = 0

    def on_write(register: Register, value: int) -> None:
        nonlocal number
        if register.name == "MPU_RNR":
            number = value
        elif register.name in ("MPU_RBAR", "MPU_RASR"):
            regions.setdefault(number, {})[register.name] = value

    sketch.on_write = on_write
    sketch.run(symbols["clock_peripherals"])
    found = {region["MPU_RBAR"]: region["MPU_RASR"] for region in regions.values()}
    assert len(found) == len(regions)
    sizes = {address: 2 << (bits >> 1 & 31) for address, bits in found.items()}
    assert sizes == {0: 512, 0x60000000: 1 << 29, 0x80000000: 1 << 29, SRAM2.address: SRAM2.size}
    assert symbols["fast_vectors"] >= sizes[0]
    for address, bits in found.items():
        assert bits & 1 and bits >> 28 & 1  # enabled, nothing is executed there
        access, kind, cacheable, bufferable = bits >> 24 & 7, bits >> 19 & 7, bits >> 17 & 1, bits >> 16 & 1
        expected = (3, 1, 0, 0) if address == SRAM2.address else (0, 0, 0, 0)
        assert (access, kind, cacheable, bufferable) == expected, hex(address)


def test_the_board_is_ready_within_a_second_when_switched_on(
    make_sketch: MakeSketch, make_chip: Callable[..., Any], symbols: dict[str, int]
) -> None:
    """Without the gyro's calibration: the waits for its chip, and ten cycles for each other instruction."""
    sketch = make_sketch(cycles_a_read=20000)
    make_chip(sketch, 0x70)
    delay = symbols["time_delay_ms"] & ~1
    waits_ms: list[int] = []
    executed = 0

    def on_code(address: int) -> None:
        nonlocal executed
        executed += not delay <= address < delay + DELAY_BYTES
        if address == delay:
            waits_ms.append(sketch.uc.reg_read(UC_ARM_REG_R0))

    sketch.on_code = on_code
    sketch.run(symbols["msp_lines_serve"])
    assert waits_ms == [100, 100, 100]
    assert executed > 10_000
    print(f"{executed:,} instructions beside {sum(waits_ms)} ms of waiting")
    assert sum(waits_ms) / 1000 + 10 * executed / 216e6 < 1.0


@pytest.mark.parametrize("dead", ["PLLRDY", "ODRDY", "ODSWRDY", "SWS"])
def test_the_motors_are_held_low_when_the_clock_does_not_come_up(
    dead: str, make_sketch: MakeSketch, symbols: dict[str, int]
) -> None:
    sketch = make_sketch(dead=frozenset({dead}))
    sketch.run_for(STEPS_TO_STOP)
    assert symbols["stop"] & ~1 in sketch.seen
    assert symbols["clock_peripherals"] & ~1 not in sketch.seen
    assert symbols["gyro_start"] & ~1 not in sketch.seen
    assert sketch.peek(0x40020800) >> 12 & 0xFF == 0b01010101  # PC6..PC9 outputs
    assert sketch.sins == []


def test_the_boot_part_enters_the_rom_when_the_bank_is_erased(sketch: Any, symbols: dict[str, int]) -> None:
    sketch.uc.mem_write(FLASH_BANK_A.address, b"\xff" * FLASH_BANK_A.size)
    sketch.run(symbols["boot_enter_rom"])
    assert symbols["reset_handler"] & ~1 not in sketch.seen


def written(sketch: Any) -> list[str]:
    """Registers that are written from now on."""
    names: list[str] = []
    sketch.on_write = lambda register, value: names.append(register.name)
    return names


@pytest.mark.parametrize("section", [".board", ".boot_board"])
@pytest.mark.parametrize(
    "spoilt", [b"\xff" * BOARD_BYTES, bytes(BOARD_BYTES), b"NFBD\xff"], ids=["erased", "zeros", "layout"]
)
def test_nothing_is_started_when_the_board_is_not_described(
    section: str, spoilt: bytes, sketch: Any, elf: ELFFile, symbols: dict[str, int]
) -> None:
    found = elf.get_section_by_name(section)
    assert found is not None
    sketch.uc.mem_write(found["sh_addr"], spoilt)
    names = written(sketch)
    sketch.run(symbols["boot_enter_rom"])
    assert symbols["reset_handler"] & ~1 not in sketch.seen
    # Without an image the way into the ROM is open; its line is a pin of a board that is known.
    assert bool([name for name in names if name.startswith("GPIO")]) is (section == ".board")


@pytest.mark.parametrize("described", [True, False])
def test_the_boot_part_lights_the_led_alone_and_only_where_it_knows_the_board(
    described: bool, sketch: Any, elf: ELFFile, symbols: dict[str, int]
) -> None:
    if not described:
        found = elf.get_section_by_name(".boot_board")
        assert found is not None
        sketch.uc.mem_write(found["sh_addr"], b"\xff" * BOARD_BYTES)
    names = written(sketch)
    sketch.uc.reg_write(UC_ARM_REG_SP, symbols["stack_top"])
    sketch.uc.emu_start(symbols["boot_fault"] | 1, 0xFFFFFFFF, count=300)
    assert bool(names) is described
    assert sketch.sins == []
    if described:
        assert sketch.peek(GPIOB_MODER) == 0x280 | 1 << 18  # as after reset, but that PB9 is an output


def test_no_motor_turns_when_the_board_has_too_few(
    sketch: Any, elf: ELFFile, symbols: dict[str, int]
) -> None:
    found = elf.get_section_by_name(".board")
    assert found is not None
    told = unpack(found.data()[:BOARD_BYTES])
    at = found.data().index(bytes(told["motor_pins"])) + len(told["motor_pins"])
    sketch.uc.mem_write(found["sh_addr"] + at, bytes([2]))
    sketch.run_for(STEPS_TO_STOP)
    assert symbols["stop"] & ~1 in sketch.seen
    assert symbols["gyro_start"] & ~1 not in sketch.seen
    assert sketch.sins == []
