"""The linked image: right processor, right places, nothing that the board cannot have."""

from __future__ import annotations

import re
import struct
import subprocess
from pathlib import Path

import pytest
from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import ARMAttributesSection, SymbolTableSection

from neuroflight.sim.board.registers.bus import load_table
from neuroflight.toolchain.contract import (
    DTCM,
    FLASH_BANK_A,
    FLASH_BASE,
    FLASH_BOOT,
    FLASH_POLICY_SLOTS,
    IMAGE_TAIL_BYTES,
    ITCM,
    POLICY_MEMORY_COUNT_MAX,
    POLICY_WEIGHT_COUNT_MAX,
    SRAM1,
    SRAM2,
    Region,
)
from neuroflight.toolchain.cortex_m7.arm_policy import state_bytes

KIB = 1024
NULL_PAGE = 512  # bytes at the start of ITCM that the MPU closes
POLICY_POINTERS = 16  # bytes of struct policy beside its floats, at most
SYSTEM_VECTORS = 16
LATER_VECTOR, TICK_VECTOR = 14, 15
# DMA streams by which an SPI's receiver may come, but for those that the motors' ports need (RM0431 8.3.3).
GYRO_READS = ("DMA1_STREAM0", "DMA1_STREAM2", "DMA1_STREAM3", "DMA2_STREAM0", "DMA2_STREAM2")
HOT = (
    *(
        "gyro_edge_handler",
        "gyro_sample_handler",
        "spi_start",
        "spi_finish",
        "runtime_sample",
        "tick_handler",
    ),
    *(
        "uart_ring_read",
        "firmware_receive",
        "receiver_channels",
        "receiver_tick",
        "firmware_log",
        "firmware_sample",
        "gyro_step",
        "observation_step",
    ),
    *("policy_step", "mixer_mix", "dshot_value", "dshot_frames", "motors_write", "memcpy", "gyro_tick"),
    *("receiver_line_read", "hal_deadline_missed"),
)
WHILE_FLASH_IS_BUSY = ("flash_memory_erase_sector", "flash_memory_program_words", "core_clean_caches")
DMA_BUFFERS = ("gyro_response", "receiver_ring_bytes")
# What DMA reads, which must not be DTCM while the core sleeps, and the background's.
SLOW_DMA_BUFFERS = (
    *("motor_words", "motor_samples", "gyro_request", "msp_rings", "msp_buffers", "power_conversions"),
)
# Functions of libm, and what they call themselves.
LIBM = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "exp2", "expm1"),
    *("log", "log2", "log10", "log1p", "pow", "sqrt", "cbrt", "hypot", "fmod", "fma", "fmin", "fmax"),
    *("fabs", "floor", "ceil", "round", "lround", "rint", "lrint", "trunc", "scalbn", "ldexp", "frexp"),
)
# libgcc's names for arithmetic on double, ARM's (RTABI 4.1) and the generic ones.
DOUBLE_HELPER = re.compile(r"__aeabi_(c?d.*|\w+2d|l2d)|__\w+df\w*")


def within(address: int, size: int, region: Region) -> bool:
    return region.address <= address and address + size <= region.address + region.size


def allocated(elf: ELFFile, flag: int = SH_FLAGS.SHF_ALLOC) -> dict[str, Region]:
    """Sections that occupy memory and have `flag`."""
    return {
        s.name: Region(s.name, s["sh_addr"], s["sh_size"])
        for s in elf.iter_sections()
        if s["sh_flags"] & SH_FLAGS.SHF_ALLOC and s["sh_flags"] & flag and s["sh_size"]
    }


def words(elf: ELFFile, section: str) -> tuple[int, ...]:
    found = elf.get_section_by_name(section)
    assert found is not None
    data = found.data()
    return struct.unpack(f"<{len(data) // 4}I", data[: len(data) // 4 * 4])


def sizes(elf: ELFFile) -> dict[str, int]:
    """Bytes of each object by its name."""
    table = elf.get_section_by_name(".symtab")
    assert isinstance(table, SymbolTableSection)
    return {s.name: s["st_size"] for s in table.iter_symbols() if s["st_info"]["type"] == "STT_OBJECT"}


def flash_contents(elf: ELFFile) -> dict[int, bytes]:
    """Load address -> bytes, of what must be in flash before reset."""
    return {s["p_paddr"]: s.data() for s in elf.iter_segments("PT_LOAD") if s["p_filesz"]}


def test_the_image_is_for_a_cortex_m7_with_hard_float_when_linked(elf: ELFFile) -> None:
    section = elf.get_section_by_name(".ARM.attributes")
    assert isinstance(section, ARMAttributesSection)
    attributes = {
        attribute.tag: attribute.value
        for part in section.iter_subsections()
        for group in part.iter_subsubsections()
        for attribute in group.iter_attributes()
    }
    assert elf["e_machine"] == "EM_ARM"
    assert elf["e_flags"] & 0xFF000000 == 0x05000000  # EABI version 5
    assert elf["e_flags"] & 0x400  # EF_ARM_ABI_FLOAT_HARD
    assert attributes["TAG_CPU_ARCH"] == 13  # v7E-M
    assert attributes["TAG_CPU_ARCH_PROFILE"] == ord("M")
    assert attributes["TAG_FP_ARCH"] == 8  # FPv5, 16 registers: the M7's, not the M4's FPv4
    assert attributes["TAG_ABI_HARDFP_USE"] == 1  # single precision alone
    assert attributes["TAG_ABI_VFP_ARGS"] == 1


def test_the_boot_part_can_start_alone_when_reset(elf: ELFFile, symbols: dict[str, int]) -> None:
    stack, reset, *faults = words(elf, ".boot")[:7]
    boot = allocated(elf)[".boot"]
    assert boot.address == FLASH_BOOT.address and boot.size <= FLASH_BOOT.size
    assert stack == symbols["stack_top"]
    assert reset == symbols["boot_reset"] == elf["e_entry"]
    assert set(faults) == {symbols["boot_fault"]}
    for handler in (reset, *faults):
        assert handler & 1 and within(handler & ~1, 2, boot)


def test_every_vector_points_at_code_when_the_bank_starts(elf: ELFFile, symbols: dict[str, int]) -> None:
    interrupts = load_table().interrupts
    table = SYSTEM_VECTORS + max(interrupts.values()) + 1
    stack, *handlers = words(elf, ".vectors")
    code = allocated(elf, SH_FLAGS.SHF_EXECINSTR).values()
    own = {
        1: "reset_handler",
        LATER_VECTOR: "motors_answers_handler",
        TICK_VECTOR: "tick_handler",
        **{
            SYSTEM_VECTORS + n: "gyro_edge_handler"
            for name, n in interrupts.items()
            if name.startswith("EXTI") or name == "TIM5"
        },
        **{SYSTEM_VECTORS + interrupts[name]: "gyro_sample_handler" for name in GYRO_READS},
        **{SYSTEM_VECTORS + interrupts[f"DMA2_STREAM{n}"]: "motors_moved_handler" for n in (1, 3, 4, 6)},
    }
    assert allocated(elf)[".vectors"].address == FLASH_BANK_A.address
    assert symbols["fast_vectors"] % 512 == 0  # of 120 vectors (ARMv7-M B3.2.5)
    assert symbols["fast_vectors"] >= ITCM.address + NULL_PAGE
    assert symbols["fast_vectors_end"] - symbols["fast_vectors"] == 4 * table
    assert stack == symbols["stack_top"]
    assert len(handlers) == table - 1
    for vector, handler in enumerate(handlers, start=1):
        assert handler == symbols[own.get(vector, "fault_handler")], vector
        assert handler & 1 and any(within(handler & ~1, 2, section) for section in code), vector


def test_nothing_asks_for_a_heap_or_for_doubles_when_linked(symbols: dict[str, int]) -> None:
    heap = {"malloc", "_malloc_r", "free", "realloc", "calloc", "_sbrk", "sbrk", "end", "_end", "__end__"}
    assert not heap & symbols.keys()
    assert not [name for name in symbols if "heap" in name.lower()]
    assert not [name for name in symbols if DOUBLE_HELPER.fullmatch(name)]
    assert not [name for name in symbols if "unwind" in name or "exidx" in name]


def test_nothing_of_libm_is_there_when_linked(symbols: dict[str, int]) -> None:
    taken = {
        name for name in symbols if re.fullmatch(rf"(__ieee754_|__kernel_)?({'|'.join(LIBM)})f?l?", name)
    }
    assert not taken


@pytest.mark.parametrize("name", ["__aeabi_dadd", "__aeabi_f2d", "__aeabi_cdcmple", "__adddf3", "__muldf3"])
def test_double_helpers_are_recognized_when_named(name: str) -> None:
    assert DOUBLE_HELPER.fullmatch(name)


def test_the_control_path_runs_from_itcm_when_linked(elf: ELFFile, symbols: dict[str, int]) -> None:
    itcm = allocated(elf)[".itcm"]
    assert within(itcm.address, itcm.size, ITCM)
    assert itcm.address >= ITCM.address + NULL_PAGE
    for name in (*HOT, *WHILE_FLASH_IS_BUSY):
        assert within(symbols[name] & ~1, 2, itcm), name


def test_all_variables_and_the_stack_lie_in_dtcm_but_the_backgrounds_when_linked(
    elf: ELFFile, symbols: dict[str, int]
) -> None:
    sections = allocated(elf, SH_FLAGS.SHF_WRITE)
    homes = {".sram_bss": SRAM1, ".sram_noinit": SRAM1, ".uncached_bss": SRAM2, ".fast_vectors": ITCM}
    for section in sections.values():
        home = homes.get(section.name, DTCM)
        assert within(section.address, section.size, home), section.name
    assert sections[".stack"].address == DTCM.address
    assert symbols["stack_top"] == DTCM.address + sections[".stack"].size
    assert symbols["stack_top"] % 8 == 0
    for name in DMA_BUFFERS:
        assert within(symbols[name], 4, sections[".bss"]), name
        assert symbols[name] % 4 == 0, name
    for name in SLOW_DMA_BUFFERS:
        assert within(symbols[name], 4, sections[".uncached_bss"]), name
    for name, where in (("firmware", ".bss"), ("weights", ".weights")):
        assert within(symbols[name], sizes(elf)[name], sections[where]), name


def test_the_largest_policy_would_fit_dtcm_when_its_room_is_added(elf: ELFFile, image_folder: Path) -> None:
    used = sum(s.size for s in allocated(elf).values() if within(s.address, s.size, DTCM))
    used -= sizes(elf)["weights"] + state_bytes(image_folder / "neuroflight.elf")
    largest = 4 * POLICY_WEIGHT_COUNT_MAX + 4 * POLICY_MEMORY_COUNT_MAX + POLICY_POINTERS
    print(f"DTCM with the largest policy: {used + largest:,} of {DTCM.size:,} bytes")
    assert used + largest <= DTCM.size


def test_flash_gets_boot_part_slots_and_image_alone_when_programmed(elf: ELFFile) -> None:
    image = Region("image", FLASH_BANK_A.address, FLASH_BANK_A.size - IMAGE_TAIL_BYTES)  # then its marks
    for address, data in flash_contents(elf).items():
        assert any(within(address, len(data), home) for home in (FLASH_BOOT, *FLASH_POLICY_SLOTS, image))


def test_the_binary_is_boot_part_policy_and_bank_with_erased_flash_between_when_copied(
    elf: ELFFile, image_folder: Path
) -> None:
    slot_b = FLASH_POLICY_SLOTS[1].address
    parts = {address: data for address, data in flash_contents(elf).items() if address != slot_b}
    end = max(address + len(data) for address, data in parts.items())
    expected = bytearray(b"\xff" * (end - FLASH_BOOT.address))
    for address, data in parts.items():
        expected[address - FLASH_BOOT.address : address - FLASH_BOOT.address + len(data)] = data
    assert (image_folder / "neuroflight.bin").read_bytes() == expected


def test_the_hex_file_holds_the_same_bytes_and_clears_slot_b_when_read_by_another_tool(
    image_folder: Path, tmp_path: Path
) -> None:
    again = tmp_path / "again.bin"
    command = ["arm-none-eabi-objcopy", "-I", "ihex", "-O", "binary", "--gap-fill", "0xFF"]
    subprocess.run([*command, image_folder / "neuroflight.hex", again], check=True)
    whole, binary = again.read_bytes(), (image_folder / "neuroflight.bin").read_bytes()
    slot_b = FLASH_POLICY_SLOTS[1].address - FLASH_BASE
    assert whole[: len(binary)] == binary
    assert whole[len(binary) : slot_b] == b"\xff" * (slot_b - len(binary))
    assert whole[slot_b:] == bytes(4)  # no blob begins so
    lines = (image_folder / "neuroflight.hex").read_text().splitlines()
    assert sum(int(line[1:3], 16) for line in lines) < 160 * KIB  # the gap itself is not in it
