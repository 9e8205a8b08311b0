"""First installation and rescue through the chip's ROM: a plan, then its execution.

Only the sectors that an image touches are erased, and that of policy slot B, so that no policy which an older
image left there is flown in place of the image's: settings and fault log stay. The boot part is
erased first and written last, so that a board whose flashing was cut short starts nothing; it is then still
in reach of its BOOT button, which no image can take away.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from neuroflight.flash.rom.segments import ERASED, Segment, touched_sectors
from neuroflight.toolchain.contract import FLASH_BANK_B, FLASH_BOOT, FLASH_POLICY_SLOTS, FLASH_SECTORS
from neuroflight.toolchain.errors import LinkError

BITS_PER_BYTE = 11  # on the line: start, 8, parity, stop
OVERHEAD_BYTES = 2 + 1 + 5 + 1 + 2 + 1  # of a write or read beside its data
ERASE_S = {16: 0.4, 64: 1.2, 128: 2.0}  # typical, by sector size [KiB]
PROGRAM_S = 16e-6  # a byte
UART_BLOCK_BYTES = 256  # of a write or read there
USB_BLOCK_BYTES, USB_BLOCK_S = 2048, 0.015  # six control transfers, each of some frames of 1 ms: an estimate
_WORD = 4

Progress = Callable[[str, int, int], None]  # action, done, in all


class Rom(Protocol):
    """A client of the boot loader in the chip's ROM, on a UART or on USB. Methods raise LinkError."""

    data_max: int  # bytes of one read or write

    @property
    def name(self) -> str:
        """The port as the user would write it."""

    def read(self, address: int, size: int) -> bytes:
        """Read at most `data_max` bytes."""

    def write(self, address: int, data: bytes) -> None:
        """Write at most `data_max` bytes to erased flash."""

    def erase(self, sector: int) -> None:
        """Erase a sector, by its number."""

    def go(self, address: int) -> bool:
        """Start the program whose vectors lie at `address`. Returns whether the ROM has agreed."""


@dataclass(frozen=True)
class FlashPlan:
    """The changes of a chip's flash."""

    segments: tuple[Segment, ...]  # ascending
    sectors: tuple[int, ...]  # to be erased, ascending

    @property
    def bytes(self) -> int:
        """Number of bytes to write."""
        return sum(len(segment.data) for segment in self.segments)

    @property
    def kept(self) -> tuple[int, ...]:
        """Sectors that stay unchanged."""
        return tuple(number for number in range(len(FLASH_SECTORS)) if number not in self.sectors)

    def seconds(self, baud: float | None) -> float:
        """Estimate the seconds for erasing, writing and reading back. baud: None: by USB."""
        if baud is None:
            line = -(-self.bytes // USB_BLOCK_BYTES) * USB_BLOCK_S
        else:
            commands = -(-self.bytes // UART_BLOCK_BYTES)
            line = (self.bytes + commands * OVERHEAD_BYTES) * BITS_PER_BYTE / baud
        erasing = sum(ERASE_S[FLASH_SECTORS[number].size >> 10] for number in self.sectors)
        return erasing + 2 * line + self.bytes * PROGRAM_S


def plan_flash(segments: Sequence[Segment], *, erase_bank_b: bool = False) -> FlashPlan:
    """Plan the flashing of `segments`, from `read_segments` and accepted by `check_image`.

    erase_bank_b: erase it, so that no image there can start in place of this one.
    """
    slot_b = FLASH_POLICY_SLOTS[1].address
    cleared = () if any(s.address <= slot_b < s.end for s in segments) else (Segment(slot_b, bytes(_WORD)),)
    padded = _aligned(sorted((*segments, *cleared), key=lambda s: s.address))
    sectors = set(touched_sectors(padded))
    if erase_bank_b:
        sectors.add(FLASH_SECTORS.index(FLASH_BANK_B))
    return FlashPlan(padded, tuple(sorted(sectors)))


def install(client: Rom, plan: FlashPlan, progress: Progress = lambda what, done, total: None) -> None:
    """Erase, write and read back. Raises LinkError of one line that says how far it came.

    The chip must have been found by `client.connect`. Nothing is started.
    """
    erased: list[int] = []
    written = 0
    try:
        for number in plan.sectors:
            progress("erase", len(erased), len(plan.sectors))
            client.erase(number)
            erased.append(number)
        progress("erase", len(erased), len(plan.sectors))
        for segment in reversed(plan.segments):
            for address, data in _pieces(segment, client.data_max):
                progress("write", written, plan.bytes)
                client.write(address, data)
                written += len(data)
        progress("write", written, plan.bytes)
    except LinkError as error:
        raise type(error)(f"{error}; {_state(plan, erased, written)}") from None
    verify(client, plan, progress)


def verify(client: Rom, plan: FlashPlan, progress: Progress = lambda what, done, total: None) -> None:
    """Read back what the plan writes and compare. Raises LinkError with the first difference."""
    compared = different = 0
    first: int | None = None
    for segment in plan.segments:
        for address, data in _pieces(segment, client.data_max):
            progress("verify", compared, plan.bytes)
            try:
                found = client.read(address, len(data))
                if found != data:  # read data have no checksum: the line may have damaged them
                    found = client.read(address, len(data))
            except LinkError as error:
                raise type(error)(
                    f"{error}; {compared} of {plan.bytes} bytes are compared, the others are not"
                ) from None
            wrong = [i for i, (got, wanted) in enumerate(zip(found, data, strict=True)) if got != wanted]
            if wrong and first is None:
                first = address + wrong[0]
            different += len(wrong)
            compared += len(data)
    progress("verify", compared, plan.bytes)
    if first is not None:
        raise LinkError(
            f"{client.name}: {different} of {plan.bytes} bytes in flash differ from the image, the first at "
            f"0x{first:08X}; flash it again, and if that stays, a sector is write-protected or worn"
        )


def start(client: Rom) -> bool:
    """Start the program in flash. Returns False if the ROM did not agree: a power cycle starts it then."""
    return client.go(FLASH_BOOT.address)


def _state(plan: FlashPlan, erased: Sequence[int], written: int) -> str:
    """Describe how far a failed flashing has come."""
    if not erased:
        return "nothing was written"
    numbers = ", ".join(map(str, erased))
    return (
        f"sector {numbers} erased, {written} of {plan.bytes} bytes written, none compared: the board does "
        f"not start before this is done again"
    )


def _aligned(segments: Iterable[Segment]) -> tuple[Segment, ...]:
    """Extend the segments to whole words, as the ROM writes them; added bytes are erased ones."""
    filler = bytes([ERASED])
    aligned: list[Segment] = []
    for segment in segments:
        address = segment.address - segment.address % _WORD
        data = (segment.address - address) * filler + segment.data
        if aligned and address < aligned[-1].end:  # both have bytes in one word
            before = aligned.pop()
            kept = before.data[: segment.address - before.address]
            address, data = before.address, kept + segment.data
        aligned.append(Segment(address, data + -len(data) % _WORD * filler))
    return tuple(aligned)


def _pieces(segment: Segment, size: int) -> list[tuple[int, bytes]]:
    """Return address and bytes of each piece, `size` bytes at most."""
    data, address = segment.data, segment.address
    return [(address + i, data[i : i + size]) for i in range(0, len(data), size)]
