"""The tool foretells what the firmware does with its slots: which is flown next, which one is erased."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.policy.slots import PLACES, Policies, Slot, newer
from neuroflight.flash.policy.swap import target
from neuroflight.toolchain.contract import FLASH_POLICY_SLOTS
from neuroflight.toolchain.policy.blob import pack
from tests.firmware.storage.test_policy_slots import NONE, Slots, like

TOP, HALF = 2**32 - 1, 2**31
SELFTEST = -5
NUMBERS = (0, 1, 2, 7, HALF - 1, HALF, HALF + 1, TOP - 1, TOP)


@pytest.fixture
def slots(chip: Callable[..., Any]) -> Callable[[], Slots]:
    """Makes empty slots; the scripted policy answers 0, as in its self-test."""

    def make() -> Slots:
        made = Slots(chip())
        made.core.lib.scripted_action = [0.0] * 4
        return made

    return make


def told(s: Slots) -> Policies:
    """What the firmware says of its places."""
    rows = []
    for source in PLACES:
        header = s.core.new("struct nf_policy_blob_header *")
        found = int(s.core.lib.policy_slots_info(s.slots, int(source), header))
        flown = int(source) == s.slots.flown
        rows.append(Slot(source, found, flown, int(header.sequence), 0, 0, 1000, 0.0, "", "", "00" * 8))
    info: Any = None
    return Policies(info, tuple(rows))


def random_slot(s: Slots, rng: np.random.Generator) -> bytes:
    """What a slot may hold: nothing, a policy, one that fails its self-test, of another image, or damaged."""
    kind, sequence = rng.integers(6), int(rng.choice(NUMBERS))
    blob = like(s.image, sequence, float(rng.random()), 1.0)
    if kind == 0:
        return b"\xff" * 700
    if kind == 1:
        blob = replace(blob, selftest_action=np.full((3, 4), 0.5, np.float32))
    if kind == 2:
        blob = replace(blob, architecture_hash=5)
    data = pack(blob)
    return data[:-4] + bytes(4) if kind == 3 else data


def test_the_next_one_and_the_erased_one_are_foretold_whatever_the_slots_hold(
    slots: Callable[[], Slots],
) -> None:
    rng, seen = np.random.default_rng(11), set()
    for _ in range(120):
        s = slots()
        for slot in range(2):
            s.put(slot, random_slot(s, rng))
        s.boot()
        before = told(s)
        after = before.after_start()
        assert (NONE if after is None else after.source) == s.slots.flown
        assert (before.flown is None) == (s.slots.flown == NONE)
        erased = target(before)
        others = {slot: s.chip.region(FLASH_POLICY_SLOTS[slot]) for slot in range(2)}
        assert s.begin(1000) == 0
        assert s.slots.update.target == erased
        assert s.chip.region(FLASH_POLICY_SLOTS[1 - erased]) == others[1 - erased]
        seen.add((s.slots.flown, int(erased)))
    assert seen >= {(0, 1), (1, 0), (NONE, 0)}


def test_the_one_before_is_foretold_when_the_flown_one_is_given_up(slots: Callable[[], Slots]) -> None:
    rng, seen = np.random.default_rng(12), set()
    for _ in range(80):
        s = slots()
        for slot in range(2):
            s.put(slot, random_slot(s, rng))
        s.boot()
        policies = told(s)
        if policies.flown is None or policies.after_start(without=policies.flown) is None:
            assert s.core.lib.policy_slots_revert(s.slots) != 0
            continue
        expected = policies.after_start(without=policies.flown)
        assert s.core.lib.policy_slots_revert(s.slots) == 0
        assert told(s).given_up
        assert expected is not None
        booted = s.boot()
        if booted.found[expected.source] == SELFTEST:  # it was never tried before
            assert booted.flown == NONE
            continue
        assert booted.flown == expected.source
        seen.add(int(expected.source))
    assert seen == {0, 1}


@pytest.mark.parametrize("a", NUMBERS)
def test_numbers_are_compared_as_the_firmware_does_when_they_wrap(slots: Callable[[], Slots], a: int) -> None:
    for b in NUMBERS:
        s = slots()
        s.put(0, like(s.image, b, 1.0, 2.0))
        s.put(1, like(s.image, a, 3.0, 4.0))
        assert (s.boot().flown == 1) == newer(a, b), (a, b)
