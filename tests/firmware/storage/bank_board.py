"""A board's flash with two banks and two policy slots: boots as the boot part and the firmware do.

Stands for what runs on the chip: the functions are the core's own, the order of the boot is boot.c's.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from neuroflight.toolchain.contract import FLASH_BANKS, IMAGE_TAIL_BYTES, Refusal, image_header, policy_header
from neuroflight.toolchain.image.bank_state import state
from neuroflight.toolchain.policy.blob import pack
from tests.firmware.conftest import scripted_blob
from tests.firmware.images import IDENTITY, LEAST_BYTES, header_of, make_image
from tests.firmware.storage.test_policy_slots import Slots, like

NAME = b"HOST"
BOARD = NAME.ljust(24, b"\0")
NONE = 2  # as a bank
CHUNK = 256


@dataclass(frozen=True)
class Started:
    """What a boot has started."""

    bank: int
    image: bytes  # as long as the one that was expected to be there
    weights: bytes  # of the policy that flies; empty: none does
    flown: int  # where that came from


@dataclass(frozen=True)
class Held:
    """What a bank holds at the beginning."""

    image: bytes = b""
    marks: bytes = b""


class BankBoard:
    """A chip with a boot part's rules; nothing is kept between power cycles but flash."""

    def __init__(self, chip: Any, held: Sequence[Held]) -> None:
        self.chip, self.core, self.lib = chip, chip.core, chip.core.lib
        self.slots = Slots(chip)
        self.update = self.core.new("struct image_update *")
        self._header = self.core.new("struct nf_image_header *")
        self._offset, self._crc = self.core.new("uint32_t *"), self.core.new("uint32_t *")
        self._why, self._sequence = self.core.new("int8_t *"), self.core.new("uint32_t *")
        self._words = self.core.new("uint32_t[]", 128)
        self._digest = self.core.new("uint8_t[32]")
        self._marks = self.core.new("struct image_bank_marks[2]")
        self._good = self.core.new("bool[2]")
        self.running = 0
        for bank, content in enumerate(held):
            region = FLASH_BANKS[bank]
            tail = region.size - IMAGE_TAIL_BYTES
            chip.fill(
                region.address,
                content.image.ljust(tail, b"\xff") + content.marks.ljust(IMAGE_TAIL_BYTES, b"\xff"),
            )

    # --- The boot ---------------------------------------------------------------------------------
    def choose(self) -> int:
        """boot_choose of boot.c."""
        flash = self.chip.flash
        for bank in (0, 1):
            header = self.lib.image_bank_header(flash, bank)
            self._header[0] = header
            self._marks[bank] = self.lib.image_bank_marks(flash, bank)
            self._good[bank] = self.lib.image_bank_fits(self._header, bank, BOARD)
        while True:
            bank = int(self.lib.image_bank_choose(self._marks, self._good))
            if bank == NONE or self._marks[bank].confirmed or self.lib.image_bank_whole(flash, bank, BOARD):
                return bank
            self._good[bank] = False

    def boot(self) -> Started:
        """Power comes: bank, then policy."""
        self.chip.power_on()
        bank = self.choose()
        assert bank != NONE, "nothing starts: a brick"
        self.running = bank
        self.chip.model.running = bank
        self.lib.image_update_init(self.update, self.chip.flash, bank, NAME)
        size = int(self.lib.image_bank_header(self.chip.flash, bank).image_bytes)
        image = self.chip.region(FLASH_BANKS[bank])[:size]
        header = image_header(image)
        assert header is not None
        asks = {name: getattr(header, name) for name in IDENTITY}
        flown = self.slots.boot(bank=bank, build=header.build, **asks)
        return Started(bank, image, b"" if flown.error else flown.weights, flown.flown)

    def settle(self) -> bool:
        """What boot part and firmware mark of an image that runs well."""
        flash, bank = self.chip.flash, self.running
        if self.lib.image_bank_marks(flash, bank).confirmed:
            return True
        return bool(
            self.lib.image_bank_count_start(flash, bank)
            and self.lib.image_bank_number(flash, bank)
            and self.lib.image_bank_confirm(flash, bank)
        )

    # --- The update -------------------------------------------------------------------------------
    @property
    def why(self) -> int:
        """The detail of the last refusal."""
        return int(self._why[0])

    @property
    def sequence(self) -> int:
        """That the last switch told."""
        return int(self._sequence[0])

    @property
    def crc(self) -> int:
        """That the last end told."""
        return int(self._crc[0])

    def begin(self, header: bytes) -> tuple[int, int]:
        """Refusal, and the offset to go on from."""
        self.core.ffi.memmove(self._header, header, len(header))
        refusal = self.lib.image_update_begin(self.update, self._header, self._offset, self._why)
        return int(refusal), int(self._offset[0])

    def write(self, offset: int, data: bytes) -> int:
        self.core.ffi.memmove(self._words, data, len(data))
        return int(self.lib.image_update_write(self.update, offset, self._words, len(data)))

    def end(self) -> int:
        return int(self.lib.image_update_end(self.update, self._crc, self._why))

    def hash(self, bank: int) -> bytes | int:
        """Digest, or why there is none."""
        error = int(self.lib.image_update_hash(self.update, bank, self._digest))
        return bytes(self._digest) if error == 0 else error

    def switch(self, digest: bytes) -> int:
        slots = self.slots.slots
        return int(self.lib.image_update_switch(self.update, slots, digest, self._sequence, self._why))

    @property
    def holds_slots(self) -> bool:
        """Whether both images need the policies that they have."""
        return bool(self.lib.image_update_holds_slots(self.update))

    def arrive(self, image: bytes, chunk: int = CHUNK) -> int:
        """All up to the switch; the first refusal, if there is one."""
        refusal, at = self.begin(header_of(image))
        while refusal == Refusal.NONE and at < len(image):
            refusal = self.write(at, image[at : at + chunk])
            at += chunk
        return refusal if refusal != Refusal.NONE else self.end()

    def policy_of(self, image: bytes, *weights: float, sequence: int | None = None) -> bytes:
        """A policy that comes with that image, with the number that is due or `sequence`."""
        header = image_header(image)
        assert header is not None
        number = self.slots.next_sequence if sequence is None else sequence
        return pack(like(self.slots.image, number, *weights, build=header.build))

    def install(self, image: bytes, *weights: float) -> int:
        """An image and its policy, and the switch; the first refusal, if there is one."""
        refusal = self.arrive(image)
        if refusal == Refusal.NONE:
            refusal = self.slots.begin(size := len(self.policy_of(image, *weights)))
        if refusal == Refusal.NONE:
            policy = self.policy_of(image, *weights)
            assert len(policy) == size
            refusal = self.slots.write(0, policy)
        if refusal == Refusal.NONE:
            refusal, _ = self.slots.end()
        return refusal if refusal != Refusal.NONE else self.switch(hashlib.sha256(image).digest())


def confirmed(image: bytes, sequence: int, *, written: bool = True) -> Held:
    """An image that has run well."""
    return Held(image, state(sequence=sequence, confirmed=True, written=written))


def small_image(seed: int, bank: int) -> bytes:
    """One of the least size, that flies the scripted policy."""
    return make_image(seed, LEAST_BYTES, bank=bank, policy=policy_header(pack(scripted_blob())))
