"""The control path of the board's image, executed on an emulated Cortex-M7, gives the host's bits.

The image's own functions are called one by one with arguments in RAM; nothing of the chip is emulated.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection
from unicorn import UC_ARCH_ARM, UC_MODE_MCLASS, UC_MODE_THUMB, Uc, UcError
from unicorn.arm_const import (
    UC_ARM_REG_LR,
    UC_ARM_REG_PC,
    UC_ARM_REG_R0,
    UC_ARM_REG_R1,
    UC_ARM_REG_R2,
    UC_ARM_REG_SP,
    UC_CPU_ARM_CORTEX_M7,
)

from toolchain.contract import DTCM, FLASH_BASE, FLASH_BYTES, ITCM, SRAM1, SRAM2

FLASH_ALIAS = 0x00200000  # the same flash on the ITCM bus
RETURN = FLASH_BASE + FLASH_BYTES - 4  # erased flash: where a called function comes back to
TRACE_BYTES = 34 + 2 * 4  # struct control_trace up to the last motor; without pointers, so equal on both
INSTRUCTIONS_MAX = 1_000_000
GYRO_HZ, IDLE, CW180 = 1000, 0.03, 2
BOOT_STEPS, FLIGHT_STEPS = 1010, 400


class Board:
    """The image in the memory of a CPU that only runs what it is told to."""

    def __init__(self, image: Path) -> None:
        self._uc = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self._uc.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M7)
        regions = [(ITCM.address, ITCM.size), (FLASH_ALIAS, FLASH_BYTES), (FLASH_BASE, FLASH_BYTES)]
        for address, size in [*regions, (DTCM.address, DTCM.size + SRAM1.size + SRAM2.size)]:
            self._uc.mem_map(address, size)
        with image.open("rb") as file:
            elf = ELFFile(file)
            for segment in elf.iter_segments("PT_LOAD"):
                self._uc.mem_write(segment["p_vaddr"], segment.data())
            table = elf.get_section_by_name(".symtab")
            assert isinstance(table, SymbolTableSection)
            self._symbols = {symbol.name: symbol["st_value"] for symbol in table.iter_symbols()}
            used = max(
                s["p_vaddr"] + s["p_memsz"] for s in elf.iter_segments() if s["p_vaddr"] >= DTCM.address
            )
        # Above what the image uses: struct firmware, arguments, and the stack from the top down.
        self.firmware = max(SRAM1.address, used + 63 & ~63)
        self._argument = SRAM2.address
        self._stack = SRAM2.address + SRAM2.size
        self.call("firmware_init", self.firmware, self._argument, argument=self._config())

    @staticmethod
    def _config() -> bytes:
        # unsigned, float, enum: AAPCS gives a small enum one byte, the others are its padding.
        return GYRO_HZ.to_bytes(4, "little") + np.float32(IDLE).tobytes() + CW180.to_bytes(4, "little")

    def call(self, function: str, *arguments: int, argument: bytes = b"") -> int:
        """Call a function of the image with up to three words; `argument` lies at self._argument."""
        self._uc.mem_write(self._argument, argument)
        for register, value in zip((UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2), arguments, strict=False):
            self._uc.reg_write(register, value)
        self._uc.reg_write(UC_ARM_REG_SP, self._stack)
        self._uc.reg_write(UC_ARM_REG_LR, RETURN | 1)
        try:
            self._uc.emu_start(self._symbols[function] | 1, RETURN, count=INSTRUCTIONS_MAX)
        except UcError as error:
            pc = self._uc.reg_read(UC_ARM_REG_PC)
            raise AssertionError(f"{function} stopped at 0x{pc:08X}: {error}") from error
        assert self._uc.reg_read(UC_ARM_REG_PC) == RETURN, f"{function} did not come back"
        return int(self._uc.reg_read(UC_ARM_REG_R0))

    def step(self, frame: bytes, counts: tuple[int, int, int]) -> tuple[bytes, bytes]:
        """One control step; returns the DShot values and the trace, as they lie in memory."""
        self.call("firmware_receive", self.firmware, self._argument, len(frame), argument=frame)
        out = self._argument + 16
        self.call(
            "firmware_sample", self.firmware, self._argument, out, argument=np.array(counts, "<i2").tobytes()
        )
        dshot = bytes(self._uc.mem_read(out, 8))
        trace = self.call("firmware_trace", self.firmware)
        return dshot, bytes(self._uc.mem_read(trace, TRACE_BYTES))


class Host:
    """The same calls into the shared library."""

    def __init__(self, core: Any) -> None:
        self._core = core
        self.firmware = core.new("struct firmware *")
        config = core.new("struct firmware_config *", (GYRO_HZ, IDLE, CW180))
        assert core.lib.firmware_init(self.firmware, config) == 0
        self._dshot = core.new("uint16_t[4]")

    def step(self, frame: bytes, counts: tuple[int, int, int]) -> tuple[bytes, bytes]:
        lib, ffi = self._core.lib, self._core.ffi
        lib.firmware_receive(self.firmware, frame, len(frame))
        lib.firmware_sample(self.firmware, counts, self._dshot)
        trace = ffi.buffer(lib.firmware_trace(self.firmware))
        return bytes(ffi.buffer(self._dshot)), bytes(trace[:TRACE_BYTES])


@pytest.fixture(scope="module")
def board(board_image: Path) -> Board:
    return Board(board_image)


@pytest.fixture(scope="module")
def host(reference_core: Any) -> Host:
    return Host(reference_core)


def test_the_boards_control_path_gives_the_hosts_bits_when_armed_and_shaken(
    board: Board,
    host: Host,
    sbus: Any,
) -> None:
    rng = np.random.default_rng(31)
    values: set[bytes] = set()
    for step in range(BOOT_STEPS + FLIGHT_STEPS):
        flying = step >= BOOT_STEPS
        sigma = 10 if not flying else 10 ** rng.uniform(0, 4)
        x, y, z = np.clip(rng.normal(40, sigma, 3).round(), -32768, 32767).astype(int).tolist()
        sticks = rng.integers(172, 1812, 4)
        sticks[2] = 192 if step < BOOT_STEPS + 20 else sticks[2]
        frame = sbus([*sticks.tolist(), 1792 if flying else 192, *[992] * 11]) if step % 7 == 0 else b""
        if flying and step == BOOT_STEPS:
            frame = sbus([992, 992, 192, 992, 1792, *[992] * 11])
        ours, theirs = host.step(frame, (x, y, z)), board.step(frame, (x, y, z))
        assert ours == theirs, f"step {step}"
        values.add(ours[0])
        assert (ours[0] != bytes(8)) == flying, f"armed from step {BOOT_STEPS} on, and only then: {step}"
    assert len(values) > FLIGHT_STEPS / 2, "the outputs must have moved"
