"""Flash composed of boot part, images and their marks; images that go wrong, and a board that tries them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from neuroflight.flash.board.info import Info, read_info
from neuroflight.flash.link.client import Client
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.fitted import FULL_VOLTS
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import MSP_UART, LineTransport, UartLine
from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    FLASH_BASE,
    FLASH_BOOT,
    FLASH_BYTES,
    FLASH_POLICY_SLOTS,
    IMAGE_BUILD_BYTES,
    IMAGE_NUMBER_ENTRIES,
    IMAGE_NUMBER_WORDS,
    IMAGE_STARTS_MAX,
    IMAGE_STATE_FORMAT,
    IMAGE_TAIL_BYTES,
    MSP_BAUD_DEFAULT,
    POLICY_BLOB_HEADER_FORMAT,
    bound_policy,
    image_header,
)
from neuroflight.toolchain.image.bank_state import state
from tests.firmware.images import stamped

A, B = range(2)
UNDEFINED, LOOP = bytes.fromhex("00de"), bytes.fromhex("fee7")  # udf #0; b .
ERASED = 0xFFFFFFFF
STEP = TIME_HZ // 1000


@dataclass(frozen=True)
class Build:
    """An image for each bank, of one build, its policy, and the boot part."""

    boot: bytes
    images: tuple[bytes, bytes]
    policy: bytes  # which came with it
    symbols: tuple[dict[str, int], dict[str, int]]
    elf: Path


def read_build(elf: Path) -> Build:
    """The products beside bank A's ELF."""
    both = elf.with_suffix(".nfi").read_bytes()
    told = image_header(both)
    assert told is not None
    size = told.image_bytes
    flash = elf.with_suffix(".bin").read_bytes()
    other = elf.with_name("neuroflight-b.elf")
    images, policy = (both[:size], both[size : 2 * size]), both[2 * size :]
    return Build(flash[: FLASH_BOOT.size], images, policy, (_symbols(elf), _symbols(other)), elf)


def _symbols(elf: Path) -> dict[str, int]:
    with elf.open("rb") as file:
        table = ELFFile(file).get_section_by_name(".symtab")
        assert isinstance(table, SymbolTableSection)
        return {s.name: s["st_value"] for s in table.iter_symbols() if s["st_shndx"] != "SHN_UNDEF"}


def patched(build: Build, bank: int, function: str, code: bytes) -> bytes:
    """Its image with other instructions at the beginning of a function that lies in flash."""
    at = (build.symbols[bank][function] & ~1) - FLASH_BANKS[bank].address
    image = build.images[bank]
    assert 0 <= at < len(image)
    return stamped(image[:at] + code + image[at + len(code) :])


def bad_policy(build: Build, of: bytes) -> bytes:
    """Its policy as that of the build `of`, one bit of a weight another, its checksum right."""
    blob = bytearray(build.policy)
    blob[struct.calcsize(POLICY_BLOB_HEADER_FORMAT) + 2] ^= 0x40
    return bound_policy(blob, of, sequence=1)


def compose(build: Build, *banks: tuple[bytes, bytes] | None, slots: Sequence[bytes] | None = None) -> bytes:
    """Flash with the boot part and, by bank, an image and its marks; None: erased.

    slots: policies; None: the build's, for any image of its architecture.
    """
    flash = bytearray(build.boot.ljust(FLASH_BYTES, b"\xff"))
    held = [bound_policy(build.policy, bytes(IMAGE_BUILD_BYTES))] if slots is None else slots
    for slot, policy in zip(FLASH_POLICY_SLOTS, held, strict=False):
        at = slot.address - FLASH_BASE
        flash[at : at + len(policy)] = policy
    for region, content in zip(FLASH_BANKS, banks, strict=False):
        if content is None:
            continue
        image, marks = content
        at = region.address - FLASH_BASE
        flash[at : at + len(image)] = image
        tail = at + region.size - IMAGE_TAIL_BYTES
        flash[tail : tail + len(marks)] = marks
    return bytes(flash)


RUN_WELL = state(sequence=1, confirmed=True)
NEW = state(sequence=2, confirmed=False, written=True)
INSTALLED = b""


@dataclass(frozen=True)
class Marks:
    """What a bank's marks say."""

    numbers: tuple[int, ...]  # sequences in entries whose check holds
    starts: int
    rejected: bool
    confirmed: bool


class Trial:
    """A board that has got its power; it lies still, but for its gyro's noise."""

    def __init__(self, flash: bytes, elf: Path) -> None:
        self.board = Board(flash, elf=elf, strict=False, watchdog_resets=True, newly_installed=True)
        self.board.hardware.adc.set_battery(FULL_VOLTS, 0.0)
        self._symbols = self.board.symbols
        self._measured = 0

    def close(self) -> None:
        self.board.close()

    def run(self, seconds: float) -> None:
        self.run_to(self.board.cycle + round(seconds * TIME_HZ))

    def run_to(self, cycle: int) -> None:
        while self.board.cycle < cycle:
            self.step(min(STEP, cycle - self.board.cycle))

    def step(self, cycles: int = STEP) -> None:
        """Run for so long, a millisecond at most."""
        self._measured += 1
        self.board.hardware.gyro.measure((0, 0, 2048 + self._measured % 2), 0, (self._measured % 2, 0, 0))
        self.board.run_to(self.board.cycle + cycles)

    def until(self, happened: Callable[[], bool], seconds: float) -> None:
        """Run until it has. AssertionError when it does not."""
        end = self.board.cycle + round(seconds * TIME_HZ)
        while not happened():
            assert self.board.cycle < end, f"not within {seconds} s; resets: {self.board.engine.resets}"
            self.step()

    def await_start(self, seconds: float) -> None:
        """Run until it has been reset."""
        known = self.starts
        self.until(lambda: self.starts > known, seconds)

    @property
    def bank(self) -> int | None:
        """The bank whose image serves its line; None: none does."""
        if not self.board.hardware.usarts[MSP_UART].words["CR1"] & 1 or self.board.hardware.rom.runs:
            return None
        vectors = self.board.engine.memory(self._symbols["fast_vectors"], 8)
        reset = struct.unpack("<2I", vectors)[1]
        return next(i for i, r in enumerate(FLASH_BANKS) if r.address <= reset < r.address + r.size)

    def client(self) -> Client:
        """On the other end of its MSP line."""
        transport = LineTransport(UartLine(self.board, MSP_UART, Format(MSP_BAUD_DEFAULT)), self.run_to)
        return Client(transport, transport.clock)

    def info(self) -> Info:
        """What it says of itself."""
        with self.client() as client:
            return read_info(client)

    @property
    def led_lit(self) -> bool:
        port = self.board.hardware.pins.ports["B"]
        return port.mode(9) == 1 and not port.words["ODR"] >> 9 & 1

    @property
    def starts(self) -> int:
        """From the power on."""
        return len(self.board.engine.resets)

    def marks(self, bank: int) -> Marks:
        region = FLASH_BANKS[bank]
        tail = self.board.engine.memory(region.address + region.size - IMAGE_TAIL_BYTES, IMAGE_TAIL_BYTES)
        _, *words = struct.unpack_from(f"<{struct.calcsize(IMAGE_STATE_FORMAT) // 4}I", tail)
        size = IMAGE_NUMBER_WORDS
        entries = [words[size * i : size * i + size] for i in range(IMAGE_NUMBER_ENTRIES)]
        starts = words[size * IMAGE_NUMBER_ENTRIES :][:IMAGE_STARTS_MAX]
        rejected, confirmed = words[size * IMAGE_NUMBER_ENTRIES + IMAGE_STARTS_MAX :]
        whole = tuple(entry[0] for entry in entries if entry[1] == entry[0] ^ ERASED)
        return Marks(whole, sum(word != ERASED for word in starts), not rejected, not confirmed)
