"""Weights that are not what flash has any more: found in flight and on the ground, restored on the ground."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import FLASH_POLICY_SLOTS, FallbackCause, FlightState
from neuroflight.toolchain.policy.blob import PolicyBlob, pack
from tests.firmware.joined.field import Field

SECOND_MS = 1000
GOOD = [1.0, -2.0]
Boards = Callable[..., Field]


@pytest.fixture
def field(scripted: Any, chip: Callable[..., Any]) -> Boards:
    """Boots boards around the scripted policy, whose self-test expects 0."""
    return lambda on=None: Field(scripted, chip() if on is None else on)


def weights_of(f: Field) -> Any:
    return f.core.ffi.cast("float *", f.weights)


def answer(f: Field, *action: float) -> None:
    f.core.lib.scripted_action = list(action) * (4 // len(action))


@pytest.mark.parametrize("which", range(len(GOOD)))
def test_the_pid_takes_over_and_flash_is_restored_when_a_weight_changes_in_flight(
    field: Boards, which: int
) -> None:
    f = field()
    f.boot()
    f.take_off()
    weights_of(f)[which] *= -1
    f.run(SECOND_MS)
    told = f.safety
    assert (told.state, told.pid_flies) == (FlightState.ARMED, True)
    assert (told.fallback_cause, told.policy_good) == (FallbackCause.WEIGHTS, False)
    f.run(3 * SECOND_MS)
    assert weights_of(f)[which] != GOOD[which], "flash is read while nothing can arm"
    answer(f, 0.0)
    f.land()
    f.run(SECOND_MS)
    assert [weights_of(f)[i] for i in range(2)] == GOOD
    assert f.safety.policy_good
    assert f.reasons == {"POLICY_REFUSED"}, "until the pilot knows"
    f.gesture()
    answer(f, 0.3)
    f.take_off()
    assert not f.safety.pid_flies


@pytest.mark.parametrize("which", range(len(GOOD)))
def test_it_is_restored_within_a_second_when_a_weight_changes_on_the_ground(
    field: Boards, which: int
) -> None:
    f = field()
    f.boot()
    answer(f, 0.0)
    for _ in range(3):
        weights_of(f)[which] = 0.5
        f.run(SECOND_MS)
        assert [weights_of(f)[i] for i in range(2)] == GOOD
        assert f.reasons == set()


def test_the_policy_stays_bad_when_what_is_restored_fails_its_self_test(field: Boards) -> None:
    f = field()
    f.boot()
    answer(f, 0.1)
    weights_of(f)[1] = 0.5
    f.run(SECOND_MS)
    assert f.reasons == {"POLICY_BAD"}
    assert f.safety.refused_cause == FallbackCause.NONE, "it did not fly"
    f.pid = 2000
    f.run(50)
    assert f.reasons == set(), "the PID needs none"
    f.take_off()
    assert f.safety.pid_flies


@pytest.mark.parametrize("what", ["weight", "flash"])
def test_a_slots_policy_comes_back_only_when_flash_still_has_it(
    field: Boards, scripted_policy_blob: PolicyBlob, what: str
) -> None:
    f = field()
    slot = FLASH_POLICY_SLOTS[1].address
    blob = pack(replace(scripted_policy_blob, sequence=9, weights=np.array([3.0, 4.0], np.float32)))
    f.chip.fill(slot, blob)
    f = field(on=f.chip)
    f.boot()
    assert [weights_of(f)[i] for i in range(2)] == [3.0, 4.0]
    answer(f, 0.0)
    if what == "weight":
        weights_of(f)[0] = 0.5
    else:
        at = blob.index(np.float32(3.0).tobytes())
        f.chip.fill(slot + at, np.float32(-3.0).tobytes())
    f.run(SECOND_MS)
    assert f.reasons == (set() if what == "weight" else {"POLICY_BAD"})
    if what == "weight":
        assert [weights_of(f)[i] for i in range(2)] == [3.0, 4.0]
