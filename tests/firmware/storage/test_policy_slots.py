"""policy_slots.c: which policy a boot flies, and slot updates with power cuts at any operation."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import FLASH_POLICY_SLOTS, Refusal
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.policy.blob import PolicyBlob, pack, parse

MakeChip = Callable[..., Any]
SLOT_A, SLOT_B, NONE = range(3)
POLICY, MAGIC, CRC, RATE, FILTERS, ARCHITECTURE, BUILD = -5, -7, -10, -11, -12, -13, -27
KINDS = range(5)  # of cuts: enum flash_cut
CHUNK = 256


@dataclass(frozen=True)
class Boot:
    """What a boot chose."""

    error: int
    flown: int
    sequence: int
    idle: float
    found: tuple[int, ...]
    weights: bytes


class Slots:
    """The slots of a chip, of an image that was built around the policy of `core`."""

    def __init__(self, chip: Any) -> None:
        self.chip, self.core = chip, chip.core
        ffi, lib = self.core.ffi, self.core.lib
        self.image = parse(bytes(ffi.buffer(ffi.addressof(lib, "policy_blob"))))
        self.running = {
            "architecture_hash": self.image.architecture_hash,
            "filters_hash": self.image.filters_hash,
            "control_rate_hz": self.image.control_rate_hz,
            "weight_count": self.image.weights.size,
            "observation_count": self.image.observation_count,
            "action_count": self.image.action_count,
        }
        self.slots = self.core.new("struct policy_slots *")
        self.policy = self.core.new("struct policy *")
        self.weights = self.core.new("uint64_t[]", self.image.weights.size // 2 + 1)

    def boot(self, *, bank: int = 0, **running: int | bytes) -> Boot:
        """bank: that it runs from; running: what of the image is another than told by its policy."""
        ffi, lib = self.core.ffi, self.core.lib
        known = self.core.new("struct policy_blob_identity *", self.running | running)
        weights = ffi.cast("float *", self.weights)
        ffi.memmove(self.weights, bytes(len(ffi.buffer(self.weights))), len(ffi.buffer(self.weights)))
        error = lib.policy_slots_choose(self.slots, self.chip.flash, known, bank, self.policy, weights)
        s, count = self.slots, 4 * self.image.weights.size
        return Boot(error, s.flown, s.sequence, s.idle, tuple(s.found), bytes(ffi.buffer(weights, count)))

    def begin(self, total: int) -> int:
        return int(self.core.lib.policy_slots_begin(self.slots, total))

    def write(self, offset: int, data: bytes) -> int:
        words = self.core.new("uint32_t[]", len(data) // 4 + 1)
        self.core.ffi.memmove(words, data, len(data))
        return int(self.core.lib.policy_slots_write(self.slots, offset, words, len(data)))

    def end(self) -> tuple[int, int]:
        why = self.core.new("int8_t *")
        return int(self.core.lib.policy_slots_end(self.slots, why)), int(why[0])

    def update(self, data: bytes, chunk: int = CHUNK) -> int:
        """The whole of it, up to the first refusal."""
        refusal = self.begin(len(data))
        for offset in range(0, len(data), chunk):
            if refusal == Refusal.NONE:
                refusal = self.write(offset, data[offset : offset + chunk])
        return refusal if refusal != Refusal.NONE else self.end()[0]

    @property
    def next_sequence(self) -> int:
        return int(self.core.lib.policy_slots_next_sequence(self.slots))

    def put(self, slot: int, blob: PolicyBlob | bytes) -> None:
        """Into a slot past all rules."""
        data = blob if isinstance(blob, bytes) else pack(blob)
        self.chip.fill(FLASH_POLICY_SLOTS[slot].address, data)


@pytest.fixture
def slots(chip: MakeChip) -> Slots:
    """Empty slots; the scripted policy answers 0, as in its self-test."""
    made = Slots(chip())
    made.core.lib.scripted_action = [0.0] * 4
    return made


def like(blob: PolicyBlob, sequence: int, *weights: float, **changes: Any) -> PolicyBlob:
    """A policy for the same image."""
    if weights:
        changes["weights"] = np.array(weights, np.float32)
    return replace(blob, sequence=sequence, **changes)


def floats(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


# --- Which one is flown -------------------------------------------------------------------------
def test_no_policy_is_flown_when_slots_are_empty(slots: Slots) -> None:
    assert slots.boot() == Boot(POLICY, NONE, 0, 0.0, (MAGIC, MAGIC), floats(0, 0))
    assert slots.next_sequence == 1
    assert slots.core.lib.policy_slots_revert(slots.slots) == Refusal.ORDER
    slots.put(SLOT_B, slots.image)
    assert slots.boot() == Boot(0, SLOT_B, 0, 0.0, (MAGIC, 0), floats(1, -2))
    assert slots.policy.weights == slots.core.ffi.cast("float *", slots.weights)
    assert slots.next_sequence == 1


@pytest.mark.parametrize(
    ("a", "b", "flown"), [(1, 2, SLOT_B), (2, 1, SLOT_A), (7, 7, SLOT_A), (2**31, 1, SLOT_A)]
)
def test_the_highest_sequence_is_flown_when_slots_are_good(slots: Slots, a: int, b: int, flown: int) -> None:
    slots.put(SLOT_A, like(slots.image, a, 3, 4, idle=0.125))
    slots.put(SLOT_B, like(slots.image, b, 5, 6, idle=0.25))
    booted = slots.boot()
    assert booted.found == (0, 0)
    assert (booted.flown, booted.sequence) == (flown, max(a, b))
    assert (booted.idle, booted.weights) == ((0.25, floats(5, 6)) if flown else (0.125, floats(3, 4)))


def test_the_header_of_the_flown_policy_is_told_when_asked(slots: Slots) -> None:
    slots.put(SLOT_B, like(slots.image, 9, aircraft="other", policy_sha256="ab" * 32))
    header = slots.core.new("struct nf_policy_blob_header *")
    slots.boot()
    assert slots.core.lib.policy_slots_header(slots.slots, header)
    assert (header.sequence, slots.core.ffi.string(header.aircraft)) == (9, b"other")
    assert bytes(header.policy_sha256).hex() == "ab" * 32


def test_the_next_best_is_flown_when_a_policy_fails_its_selftest(slots: Slots) -> None:
    wrong = np.full((3, 4), 0.5, np.float32)
    slots.put(SLOT_A, like(slots.image, 8, 3, 4))
    slots.put(SLOT_B, like(slots.image, 9, 5, 6, selftest_action=wrong))
    booted = slots.boot()
    assert (booted.flown, booted.found, booted.weights) == (SLOT_A, (0, POLICY), floats(3, 4))
    slots.put(SLOT_A, like(slots.image, 8, 3, 4, selftest_action=wrong))
    booted = slots.boot()
    assert (booted.error, booted.flown, booted.found) == (POLICY, NONE, (POLICY, POLICY))
    assert slots.next_sequence == 10, "one that failed still counts, or the new one would not be tried first"


def test_each_vector_of_the_selftest_counts_when_replayed(slots: Slots) -> None:
    for row in range(3):
        for motor in range(4):
            actions = np.zeros((3, 4), np.float32)
            actions[row, motor] = 1e-45
            slots.put(SLOT_A, like(slots.image, 8, selftest_action=actions))
            assert slots.boot().found == (POLICY, MAGIC)


def test_the_selftest_begins_anew_when_its_steps_are_over(slots: Slots) -> None:
    row = slots.image.selftest_observation[:1]
    for rows, steps in ((6, 2), (6, 6), (4, 1)):
        blob = like(
            slots.image,
            5,
            selftest_observation=np.repeat(row, rows, axis=0) + np.arange(rows, dtype=np.float32)[:, None],
            selftest_action=np.zeros((rows, 4), np.float32),
            selftest_steps=steps,
        )
        slots.put(SLOT_A, blob)
        before = slots.core.lib.scripted_inits, slots.core.lib.scripted_steps
        assert slots.boot().flown == SLOT_A
        inits, ran = slots.core.lib.scripted_inits - before[0], slots.core.lib.scripted_steps - before[1]
        assert (inits, ran) == (rows // steps + 1, rows)
        assert list(slots.core.lib.scripted_observation) == [rows - 1.0] * 17


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"control_rate_hz": 2000}, RATE),
        ({"filters_hash": 5}, FILTERS),
        ({"architecture_hash": 5}, ARCHITECTURE),
        ({"weights": np.ones(3, np.float32)}, ARCHITECTURE),
        ({"build": b"another1"}, BUILD),
    ],
)
def test_a_slot_is_passed_over_when_it_is_for_another_image(
    slots: Slots, changes: dict[str, Any], error: int
) -> None:
    slots.put(SLOT_A, like(slots.image, 8, **changes))
    assert slots.boot().found == (error, MAGIC)
    assert slots.slots.flown == NONE
    slots.put(SLOT_B, like(slots.image, 7, 3, 4))
    assert slots.boot().flown == SLOT_B, "however old"


def test_no_policy_is_flown_when_none_is_good(slots: Slots) -> None:
    slots.put(SLOT_B, like(slots.image, 8, 3, 4))
    booted = slots.boot(filters_hash=1)
    assert (booted.error, booted.flown, booted.found) == (POLICY, NONE, (MAGIC, FILTERS))
    header = slots.core.new("struct nf_policy_blob_header *")
    assert not slots.core.lib.policy_slots_header(slots.slots, header)


@pytest.mark.parametrize("build", [bytes(8), b"ownbuild", b"ownbuil\0", b"\0wnbuild"])
def test_a_policy_is_flown_by_the_build_that_it_came_with_and_no_other(slots: Slots, build: bytes) -> None:
    slots.put(SLOT_A, like(slots.image, 1, 3, 4))
    slots.put(SLOT_B, like(slots.image, 2, 5, 6, build=build))
    flown = SLOT_B if build in (bytes(8), b"ownbuild") else SLOT_A
    assert slots.boot(build=b"ownbuild").flown == flown
    assert slots.boot(build=bytes(8)).flown == (SLOT_B if build == bytes(8) else SLOT_A)
    assert slots.next_sequence == 3, "for whichever image it is"


# --- Writing a slot -----------------------------------------------------------------------------
def test_the_slot_that_is_not_flown_is_written_when_updated(slots: Slots) -> None:
    flown = []
    for sequence in range(1, 6):
        slots.boot()
        assert slots.next_sequence == sequence
        assert slots.update(pack(like(slots.image, sequence, sequence, 0))) == Refusal.NONE
        booted = slots.boot()
        flown.append(booted.flown)
        assert booted.weights == floats(sequence, 0)
    assert flown == [SLOT_A, SLOT_B, SLOT_A, SLOT_B, SLOT_A]


def test_the_newest_stays_when_slots_are_written_again_without_a_boot(slots: Slots) -> None:
    slots.boot()
    for sequence in range(1, 6):
        assert slots.update(pack(like(slots.image, sequence, sequence, 0))) == Refusal.NONE
        assert slots.begin(1000) == Refusal.NONE, "another one begun, and power goes"
        other = Slots(slots.chip)
        assert other.boot().weights == floats(sequence, 0)


def test_a_slot_that_failed_its_selftest_is_the_one_to_be_written_when_updated(slots: Slots) -> None:
    slots.put(SLOT_A, like(slots.image, 8, 3, 4))
    slots.put(SLOT_B, like(slots.image, 3, 5, 6))
    slots.core.lib.scripted_action = [0.25] * 4
    assert slots.boot().found == (POLICY, POLICY)
    good = like(slots.image, 9, 7, 8, selftest_action=np.full((3, 4), 0.25, np.float32))
    assert slots.update(pack(good)) == Refusal.NONE
    assert slots.begin(1000) == Refusal.NONE
    assert slots.boot().weights == floats(7, 8), "the one just written was not the one to be erased"


@pytest.mark.parametrize("chunk", [4, 8, 60, 344, 508, 608])
def test_a_policy_arrives_when_written_in_pieces_of_any_size(slots: Slots, chunk: int) -> None:
    slots.boot()
    data = pack(like(slots.image, 1, 3, 4))
    assert slots.update(data, chunk) == Refusal.NONE
    assert slots.chip.region(FLASH_POLICY_SLOTS[0])[: len(data)] == data
    assert slots.chip.operations == 1 + len(data) // 4


def test_no_slot_is_valid_before_it_is_ended_when_all_is_written(slots: Slots) -> None:
    slots.boot()
    data = pack(like(slots.image, 1, 3, 4))
    assert slots.begin(len(data)) == Refusal.NONE
    assert slots.write(0, data) == Refusal.NONE
    assert Slots(slots.chip).boot().flown == NONE
    assert slots.end() == (Refusal.NONE, 0)
    assert Slots(slots.chip).boot().flown == SLOT_A


@pytest.mark.parametrize("total", [0, 340, 346, 0x10004, 0xFFFFFFFC])
def test_an_update_is_not_begun_when_no_blob_has_that_size(slots: Slots, total: int) -> None:
    slots.boot()
    assert slots.begin(total) == Refusal.PAYLOAD
    assert slots.chip.operations == 0
    assert slots.write(0, bytes(4)) == Refusal.ORDER


def test_pieces_are_refused_when_they_are_not_what_comes_next(slots: Slots) -> None:
    slots.boot()
    data = pack(like(slots.image, 1, 3, 4))
    assert slots.write(0, data[:8]) == slots.end()[0] == Refusal.ORDER, "nothing was begun"
    assert slots.begin(len(data)) == Refusal.NONE
    assert slots.end()[0] == Refusal.ORDER, "nothing was written"
    assert slots.write(4, data[4:8]) == Refusal.ORDER, "not at its beginning"
    assert slots.write(0, data[:100]) == Refusal.NONE
    for offset in (0, 96, 104, 200, len(data) - 4):
        assert slots.write(offset, data[offset : offset + 4]) == (
            Refusal.NONE if offset == 96 else Refusal.ORDER
        ), offset
    for offset, piece in ((100, b""), (100, bytes(6)), (102, bytes(4)), (len(data) - 4, bytes(8))):
        assert slots.write(offset, piece) in (Refusal.PAYLOAD, Refusal.ORDER)
    assert slots.write(100, bytes(len(data) - 96)) == Refusal.PAYLOAD, "past the end"
    assert slots.write(0, bytes(len(data) + 4)) == Refusal.PAYLOAD, "more than all of it"
    assert slots.write(0xFFFFFFFC, bytes(8)) == Refusal.PAYLOAD
    assert slots.write(100, data[100:]) == Refusal.NONE
    assert slots.end() == (Refusal.NONE, 0)
    assert slots.write(0, data[:4]) == Refusal.ORDER, "it is over"


def test_the_end_may_come_twice_when_a_reply_was_lost(slots: Slots) -> None:
    slots.boot()
    data = pack(like(slots.image, 1, 3, 4))
    assert slots.update(data) == Refusal.NONE
    operations = slots.chip.operations
    assert slots.end() == (Refusal.NONE, 0)
    assert slots.chip.operations == operations
    assert slots.begin(len(data)) == Refusal.NONE
    assert slots.end()[0] == Refusal.ORDER, "another one has begun"
    slots.boot()
    assert slots.end()[0] == Refusal.ORDER, "it was before this boot"


def test_the_last_piece_may_come_twice_when_a_reply_was_lost(slots: Slots) -> None:
    slots.boot()
    data = pack(like(slots.image, 1, 3, 4))
    slots.begin(len(data))
    for offset in range(0, len(data), 100):
        piece = data[offset : offset + 100]
        assert slots.write(offset, piece) == Refusal.NONE
        operations = slots.chip.operations
        assert slots.write(offset, piece) == Refusal.NONE
        for at in (0, len(piece) - 1):
            other = bytearray(piece)
            other[at] ^= 1
            assert slots.write(offset, bytes(other)) == Refusal.ORDER
        assert slots.chip.operations == operations
    assert slots.end() == (Refusal.NONE, 0)
    assert slots.boot().flown == SLOT_A


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda blob: pack(replace(blob, architecture_hash=1)), ARCHITECTURE),
        (lambda blob: pack(replace(blob, control_rate_hz=2000)), RATE),
        (lambda blob: b"NFPX" + pack(blob)[4:], MAGIC),
        (lambda blob: pack(blob)[:400] + b"\xee" + pack(blob)[401:], CRC),
        (lambda blob: pack(blob)[:-4] + bytes(4), CRC),
    ],
)
def test_a_policy_is_refused_when_it_is_none_for_this_image(
    slots: Slots, change: Callable[[PolicyBlob], bytes], why: int
) -> None:
    slots.boot()
    data = change(like(slots.image, 1, 3, 4))
    slots.begin(len(data))
    slots.write(0, data)
    assert slots.end() == (Refusal.BLOB, why)
    assert slots.boot().flown == NONE
    assert slots.update(pack(like(slots.image, 1, 3, 4))) == Refusal.NONE


TOP, HALF = 2**32 - 1, 2**31  # sequences are compared as numbers that wrap


@pytest.mark.parametrize(
    ("there", "sequence", "refusal"),
    [
        *((7, 0, 9), (7, 6, 9), (7, 7, 9), (7, 8, 0), (7, 7 + HALF - 1, 0), (7, 7 + HALF, 9), (7, TOP, 9)),
        *((TOP, TOP, 9), (TOP, TOP - 1, 9), (TOP, 0, 0), (TOP, 1, 0), (TOP, HALF - 2, 0), (TOP, HALF - 1, 9)),
        *((0, 0, 9), (0, 1, 0), (0, HALF - 1, 0), (0, HALF, 9), (0, TOP, 9)),
    ],
)
@pytest.mark.parametrize("slot", [SLOT_A, SLOT_B])
def test_a_policy_is_refused_when_its_sequence_is_not_newer_than_the_one_that_stays(
    slots: Slots, slot: int, there: int, sequence: int, refusal: int
) -> None:
    slots.put(slot, like(slots.image, there, 3, 4))
    slots.boot()
    assert slots.next_sequence == (there + 1) % 2**32
    assert slots.update(pack(like(slots.image, sequence, 5, 6))) == refusal
    assert slots.boot().weights == (floats(3, 4) if refusal else floats(5, 6))


@pytest.mark.parametrize("there", [0, 1, HALF - 1, HALF, TOP - 1, TOP])
@pytest.mark.parametrize("slot", [SLOT_A, SLOT_B])
def test_another_policy_can_follow_when_any_number_is_there(slots: Slots, slot: int, there: int) -> None:
    slots.put(slot, like(slots.image, there, 3, 4))
    for further in range(1, 4):
        slots.boot()
        sequence = slots.next_sequence
        assert sequence == (there + further) % 2**32
        assert slots.update(pack(like(slots.image, sequence, sequence, 6))) == Refusal.NONE
        booted = slots.boot()
        assert (booted.sequence, booted.weights) == (sequence, floats(sequence, 6))


@pytest.mark.parametrize("sent", [HALF - 1, HALF, TOP])
def test_the_slots_are_not_locked_when_an_absurd_number_was_sent(slots: Slots, sent: int) -> None:
    slots.boot()
    assert slots.update(pack(like(slots.image, sent, 3, 4))) == (
        Refusal.NONE if sent < HALF else Refusal.SEQUENCE
    )
    for _ in range(3):
        slots.boot()
        assert slots.update(pack(like(slots.image, slots.next_sequence, 5, 6))) == Refusal.NONE
        assert slots.boot().weights == floats(5, 6)


def test_the_newest_stays_when_numbers_wrap_and_slots_are_written_without_a_boot(slots: Slots) -> None:
    slots.boot()
    for sequence in (HALF - 1, 2 * HALF - 2, 2 * HALF - 1, 0, 1):
        assert slots.update(pack(like(slots.image, sequence, sequence, 0))) == Refusal.NONE, sequence
        assert slots.begin(1000) == Refusal.NONE, "another one begun, and power goes"
        assert Slots(slots.chip).boot().weights == floats(sequence, 0)


# --- Power goes -----------------------------------------------------------------------------------
def cuts_everywhere(operations: int) -> Iterator[tuple[int, int, int]]:
    """(operation, kind, seed): every operation with every kind of cut."""
    for at in range(operations):
        for kind in KINDS:
            yield at, kind, 5 * at + kind


def power_goes(s: Slots, new: bytes, cuts: Iterable[tuple[int, int, int]]) -> int:
    """Each cut strikes an update with `new`. Returns how often the new policy was there afterwards."""
    before = s.chip.content
    old = s.boot()
    fresh = floats(*parse(new).weights.tolist())
    arrived = 0
    for at, kind, seed in cuts:
        s.chip.content = before
        s.boot()
        s.chip.cut(at, kind, seed)
        assert s.update(new) == Refusal.FLASH, (at, kind)
        s.chip.power_on()
        booted = s.boot()
        if booted.weights == old.weights:
            assert replace(booted, found=()) == replace(old, found=()), (at, kind, seed)
        else:
            assert (booted.weights, booted.sequence) == (fresh, parse(new).sequence), (at, kind, seed)
            arrived += 1
    if s.boot().weights != fresh:
        assert s.update(new) == Refusal.NONE
    assert s.boot().weights == fresh, "a second try succeeds"
    return arrived


# What the slots hold before: their sequences, 0: empty.
@pytest.mark.parametrize("held", [(0, 0), (4, 0), (0, 4), (3, 4), (4, 3)])
def test_the_old_or_the_new_policy_is_flown_when_power_goes_at_any_operation(
    slots: Slots, held: tuple[int, int]
) -> None:
    for slot, sequence in enumerate(held):
        if sequence:
            slots.put(slot, like(slots.image, sequence, sequence, 0.5, idle=0.25))
    new = pack(like(slots.image, 5, 9, 9, idle=0.5))
    operations = 1 + len(new) // 4
    arrived = power_goes(slots, new, cuts_everywhere(operations))
    assert 1 <= arrived <= 3, "only the last word can make the new one valid"


def shipped_update(core: Any, chip: Any) -> tuple[Slots, bytes]:
    """Slots around the shipped policy, and another policy of its architecture with a self-test that holds."""
    s = Slots(chip)
    image = s.image
    s.put(SLOT_A, image)
    weights: Float32 = (image.weights * np.float32(0.999)).astype(np.float32)
    table = core.new("uint64_t[]", weights.size // 2 + 1)
    core.ffi.memmove(table, weights.tobytes(), weights.nbytes)
    out = core.new(f"float[{image.action_count}]")
    actions = []
    for index, row in enumerate(image.selftest_observation):
        if index % image.selftest_steps == 0:
            core.lib.policy_init(s.policy, core.ffi.cast("float *", table))
        core.lib.policy_step(s.policy, row.tolist(), out)
        actions.append(list(out))
    new = replace(image, sequence=1, weights=weights, selftest_action=np.array(actions, np.float32))
    return s, pack(new)


def test_the_shipped_policy_survives_when_power_goes_at_a_sample_of_operations(
    reference_core: Any, chip: MakeChip
) -> None:
    s, new = shipped_update(reference_core, chip(reference_core))
    operations = 1 + len(new) // 4
    rng = np.random.default_rng(2)
    chosen = {*range(50), *range(operations - 50, operations)}
    chosen |= set(rng.choice(np.arange(50, operations - 50), 200, replace=False).tolist())
    assert len(chosen) == 300
    cuts = [(at, int(kind), at) for at, kind in zip(sorted(chosen), rng.integers(0, 5, 300), strict=True)]
    cuts += [(operations - 1, kind, 7) for kind in KINDS]
    assert power_goes(s, new, cuts) >= 1


@pytest.mark.slow
def test_the_shipped_policy_survives_when_power_goes_at_every_operation(
    reference_core: Any, chip: MakeChip
) -> None:
    s, new = shipped_update(reference_core, chip(reference_core))
    assert power_goes(s, new, cuts_everywhere(1 + len(new) // 4)) >= 1
