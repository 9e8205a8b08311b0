"""The policies of a board: content of each slot, the one flown, and the one after the next start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from neuroflight.flash.link import messages
from neuroflight.flash.link.client import Client, patiently
from neuroflight.flash.link.layouts import read
from neuroflight.flash.link.messages import PolicyInfo, PolicySource
from neuroflight.toolchain.contract import FirmwareError, Msp

PLACES = (PolicySource.SLOT_A, PolicySource.SLOT_B)
NAMES = {
    PolicySource.SLOT_A: "slot A",
    PolicySource.SLOT_B: "slot B",
    PolicySource.NONE: "none",
}
# No error; no blob begins there; it came with another image.
GOOD, EMPTY, OTHER_IMAGE = FirmwareError.OK, FirmwareError.ERR_BLOB_MAGIC, FirmwareError.ERR_BLOB_BUILD
PATIENCE_S = 15.0  # for a line that stalls to carry an answer
SEQUENCE_SPAN = 1 << 32
SHA_SHOWN = 12  # digits of a SHA-256 that are shown


@dataclass(frozen=True)
class Slot:
    """A policy slot; without a whole policy in it, the fields after `flown` are 0."""

    source: PolicySource
    found: int  # GOOD, else a FirmwareError: why it could not be flown now
    flown: bool  # by this start of the firmware
    sequence: int  # 0: as built
    architecture_hash: int
    filters_hash: int
    control_rate_hz: int
    idle: float  # motor fraction at zero thrust
    aircraft: str  # that it was trained for
    sha256: str  # of its ONNX file, 64 hexadecimal digits
    build: str  # of the image that it came with, in hexadecimal digits; zeros: for any of its architecture

    @property
    def name(self) -> str:
        """Name for messages."""
        return NAMES[self.source]

    @property
    def good(self) -> bool:
        """True if its policy may be flown."""
        return self.found == GOOD

    @property
    def text(self) -> str:
        """Its policy and slot, for messages."""
        return _text(self.source, self.sequence, self.aircraft, self.sha256)


@dataclass(frozen=True)
class Policies:
    """All policies of a firmware, as of one moment."""

    info: PolicyInfo  # of the flown one
    slots: tuple[Slot, ...]  # in the order of PLACES

    @property
    def flown(self) -> Slot | None:
        """The slot that is flown, or None if no policy is good."""
        return next((slot for slot in self.slots if slot.flown), None)

    @property
    def flown_text(self) -> str:
        """The flown policy, for messages; known also after its slot was given up."""
        info = self.info
        if info.source is PolicySource.NONE:
            return "no policy"
        return _text(info.source, info.sequence, info.name, info.sha256)

    @property
    def given_up(self) -> bool:
        """True if the flown slot was made invalid and the firmware has not started since."""
        return self.flown is not None and self.flown.found == EMPTY

    def after_start(self, without: Slot | None = None) -> Slot | None:
        """Return the slot flown from the next start on, if it passes its self-test; None: none is good.

        without: a slot that will be empty. The firmware's rule: `policy_slots_best`.
        """
        good = [slot for slot in self.slots if slot.good and slot is not without]
        if len(good) == 2 and newer(good[1].sequence, good[0].sequence):
            return good[1]
        return next(iter(good), None)

    def holding(self, sha256: str, sequence: int) -> Slot | None:
        """Return the slot that holds the policy with that hash and sequence number, or None."""
        found = (slot for slot in self.slots if (slot.sha256, slot.sequence) == (sha256, sequence))
        return next(found, None)


def _text(source: PolicySource, sequence: int, aircraft: str, sha256: str) -> str:
    told = f"aircraft {aircraft}, sha256 {sha256[:SHA_SHOWN]}"
    return f"the policy in {NAMES[source]} (number {sequence}, {told})"


def newer(a: int, b: int) -> bool:
    """Return True if sequence number `a` comes after `b`; numbers wrap (RFC 1982)."""
    return 0 < (a - b) % SEQUENCE_SPAN < SEQUENCE_SPAN // 2


def slot_of(source: PolicySource, payload: bytes) -> Slot:
    """Decode POLICY_SLOT_INFO of that slot. Raises LinkError."""
    told = read(Msp.POLICY_SLOT_INFO, payload)
    return Slot(
        source=source,
        found=told["found"],
        flown=bool(told["flown"]),
        sequence=told["sequence"],
        architecture_hash=told["architecture_hash"],
        filters_hash=told["filters_hash"],
        control_rate_hz=told["control_rate"],
        idle=told["idle"],
        aircraft=told["aircraft"],
        sha256=told["policy_sha256"].hex(),
        build=told["build"].hex(),
    )


def read_policies(client: Client) -> Policies:
    """Read all slots of a firmware. Raises LinkError."""
    info = messages.policy_info(client.request(Msp.POLICY_INFO))
    slots = []
    for source in PLACES:
        client.settle()  # replies do not name their slot
        slots.append(slot_of(source, client.request(Msp.POLICY_SLOT_INFO, bytes([source]))))
    return Policies(info, tuple(slots))


def read_patiently(client: Client, clock: Callable[[], float]) -> Policies:
    """Read all slots, repeating the request while nobody answers: it changes nothing. Raises LinkError."""
    return patiently(client, lambda: read_policies(client), clock, PATIENCE_S)
