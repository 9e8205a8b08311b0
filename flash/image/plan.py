"""A plan of what installing an image does to a board: target bank, policy slot, duration."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

from neuroflight.flash.image.board import Board
from neuroflight.flash.image.files import Image, ImageFile, Policy, image_for
from neuroflight.flash.image.messages import DATA_BYTES_MAX, OFFSET_BYTES, Bank
from neuroflight.flash.link.messages import PolicySource
from neuroflight.flash.link.msp import FRAME_OVERHEAD_MAX
from neuroflight.flash.link.requests import WORD_BYTES
from neuroflight.flash.policy import swap
from neuroflight.toolchain.contract import FLASH_BANKS, FLASH_SECTORS, MSP_PAYLOAD_MAX
from neuroflight.toolchain.errors import ImageError

# Of the chip, typical, 32 bits at once: DS11853, flash memory programming; and of the board's line.
ERASE_S = 1.0  # a sector of 128 KB
WORD_S = 16e-6
FRAME_S = 0.003  # from a frame's last byte to the first of the next: the board's reply, a USB adapter's delay
START_S = 4.0  # boot, and 2 s in which the image proves itself
BITS_PER_BYTE = 10  # 8N1


@dataclass(frozen=True)
class InstallPlan:
    """An image that goes to a board's spare bank, and its policy to the slot that is not flown."""

    board: Board
    image: Image
    policy: Policy | None  # None: keep the board's policy
    same_build: bool  # the board runs it already
    failed_before: bool  # the board tried this very build and went back

    @property
    def bank(self) -> int:
        """The bank that is written."""
        return self.image.bank

    @property
    def sectors(self) -> tuple[int, ...]:
        """Numbers of the flash sectors that are erased."""
        region = FLASH_BANKS[self.bank]
        return tuple(
            number
            for number, sector in enumerate(FLASH_SECTORS)
            if sector.address < region.address + region.size and region.address < sector.address + sector.size
        )

    @property
    def slot(self) -> PolicySource:
        """The slot that the policy is written to."""
        return swap.target(self.board.policies)

    @property
    def bytes(self) -> int:
        """Size of the image."""
        return len(self.image.data)

    @property
    def frames(self) -> int:
        """Requests that carry them."""
        return ceil(self.bytes / DATA_BYTES_MAX)

    def seconds(self, baud: int | None) -> float:
        """Estimate the seconds for erasing, writing and starting the image. baud: None if not serial."""
        line_bytes = self.bytes + self.frames * (2 * FRAME_OVERHEAD_MAX + OFFSET_BYTES)
        line_s = 0.0 if baud is None else line_bytes * BITS_PER_BYTE / baud
        write_s = self.bytes / WORD_BYTES * WORD_S + self.frames * FRAME_S
        policy_s = swap.seconds(self.policy.size, self.slot, baud, start=False) if self.policy else 0.0
        return ERASE_S * len(self.sectors) + line_s + write_s + policy_s + START_S


def plan_install(board: Board, file: ImageFile, *, keep_policy: bool = False) -> InstallPlan:
    """Plan the installation of a file's image on a board. keep_policy: fly the board's present policy.

    Raises ImageError for another board's image, an unusable image, or a policy that cannot be kept.
    """
    if file.header.board != board.target:
        raise ImageError(
            f"{file.path}: it is built for the board {file.header.board or 'without a name'}, and "
            f"{board.port} is a {board.target}; build it with `make firmware TARGET={board.target}`"
        )
    image, policy = image_for(file, board.banks.spare)
    if keep_policy:
        _check_keeps(board, image)
    spare = board.banks.banks[board.banks.spare]
    now = board.banks.now
    return InstallPlan(
        board=board,
        image=image,
        policy=None if keep_policy else policy,
        same_build=now.fits and now.build == file.build,
        failed_before=_failed(spare) and spare.build == file.build,
    )


def _check_keeps(board: Board, image: Image) -> None:
    """Raise ImageError unless the image can fly the policy that the board flies."""
    flown, header = board.policies.flown, image.header
    if flown is None or not flown.good:
        why = "the board flies no policy"
    elif flown.build.strip("0"):
        why = f"{flown.text} came with the image that runs and is for that alone"
    elif (flown.architecture_hash, flown.filters_hash, flown.control_rate_hz) != (
        header.architecture_hash,
        header.filters_hash,
        header.control_rate_hz,
    ):
        why = f"{flown.text} is of another architecture than the new image's"
    else:
        return
    raise ImageError(f"{board.port}: --keep-policy: {why}; leave it out: the new image brings its own policy")


def _failed(bank: Bank) -> bool:
    return bank.fits and not bank.confirmed and (bank.rejected or bank.starts > 0)


assert DATA_BYTES_MAX + OFFSET_BYTES == MSP_PAYLOAD_MAX
