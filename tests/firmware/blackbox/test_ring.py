"""The ring between the gyro's interrupt and the background, and the snapshots that a log begins with."""

from __future__ import annotations

from typing import Any

import pytest

from tests.firmware.blackbox.test_replay import Bench

USABLE = 255  # of 256 records: one is always the writer's


def test_a_full_ring_drops_steps_and_counts_them_and_goes_on_when_there_is_room(reference_core: Any) -> None:
    bench = Bench(reference_core, 4000)
    bench.seen = []
    bench.fly(300)
    bench.drain()
    assert [record.trace.step for record in bench.records] == list(range(USABLE))
    bench.fly(10)
    bench.records.clear()
    bench.drain()
    assert [record.trace.step for record in bench.records] == list(range(300, 310))
    assert {record.samples for record in bench.records} == {4}


class State:
    """Something that changes with each sample, four to a control step, and its snapshots."""

    def __init__(self, core: Any) -> None:
        self.core, self.lib = core, core.lib
        self.bytes = core.new("uint64_t[25]")  # 200 bytes: no whole number of blocks
        self.samples, self.window, self.steps = (core.new("uint32_t *") for _ in range(3))
        self.kept = core.new("uint64_t[25]")
        state = (self.bytes, 200, 0, self.samples, self.window, self.steps)
        self.snapshot = core.new("struct log_snapshot *", {"state": state, "bytes": self.kept})

    def step(self, samples: int = 4) -> None:
        """A control step, after the samples that lead to it."""
        self.samples[0] += samples
        self.window[0] = self.samples[0]
        for index in range(25):
            self.bytes[index] = self.samples[0] + index
        self.steps[0] += 1
        self.lib.log_snapshot_renew(self.snapshot)


def test_a_flight_always_finds_a_snapshot_that_is_some_steps_old(reference_core: Any) -> None:
    state = State(reference_core)
    seen = set()
    for _ in range(1000):
        state.step()
        snapshot = state.snapshot
        assert snapshot.taken and state.steps[0] - snapshot.step < 64
        assert [state.kept[index] for index in (0, 24)] == [4 * snapshot.step, 4 * snapshot.step + 24]
        seen.add(snapshot.step)
    assert sorted(seen) == list(range(1, 1001, 64))


def test_a_snapshot_has_zeros_where_the_state_has_pointers(reference_core: Any) -> None:
    state = State(reference_core)
    held = reference_core.new("uint16_t[]", [8 * 3, 8 * 24])
    state.snapshot.state.held, state.snapshot.state.held_count = held, 2
    state.step()
    assert [state.kept[index] for index in range(25)] == [
        0 if index in (3, 24) else 4 + index for index in range(25)
    ]
    assert state.bytes[3] == 4 + 3, "its own stay"


@pytest.mark.parametrize("partial", [1, 2, 3])
def test_none_is_taken_where_samples_of_the_next_step_have_come(reference_core: Any, partial: int) -> None:
    state = State(reference_core)
    state.lib.log_snapshot_renew(state.snapshot)
    assert not state.snapshot.taken, "no control step yet"
    state.samples[0] += partial
    state.lib.log_snapshot_renew(state.snapshot)
    assert not state.snapshot.taken
    state.step(4 - partial)
    assert state.snapshot.taken and state.snapshot.step == 1
    state.steps[0] = 80
    state.samples[0] += partial
    state.lib.log_snapshot_renew(state.snapshot)
    assert state.snapshot.taken and state.snapshot.step == 1, "the old one stays until another one can be had"
