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
        self.ring = core.new("struct log_ring *")
        self.lib.log_ring_init(self.ring, True)
        self.bytes = core.new("uint64_t[25]")  # 200 bytes: no whole number of blocks
        self.samples, self.window, self.steps = (core.new("uint32_t *") for _ in range(3))
        self._state = core.new("struct log_state *", (self.bytes, 200, self.samples, self.window, self.steps))
        self._memory = core.new("uint64_t[50]")
        self.snapshots = core.new("struct log_snapshots *")
        self.lib.log_snapshots_init(self.snapshots, self._state, self._memory)

    def step(self, samples: int = 4) -> None:
        """A control step, after the samples that lead to it."""
        self.samples[0] += samples
        self.window[0] = self.samples[0]
        for index in range(25):
            self.bytes[index] = self.samples[0] + index
        self.ring.records[self.ring.written % 256].trace.step = self.steps[0]
        self.ring.written += 1
        self.steps[0] += 1
        self.lib.log_snapshots_step(self.snapshots, self.ring)

    def oldest(self) -> Any:
        return self.lib.log_snapshots_oldest(self.snapshots)


def test_a_flight_always_finds_a_snapshot_that_is_some_steps_old_and_all_records_since(
    reference_core: Any,
) -> None:
    state = State(reference_core)
    assert not state.oldest()
    for step in range(1, 1000):
        state.step()
        oldest = state.oldest()
        assert [oldest.bytes[index] for index in (0, 24)] == [4 * oldest.step, 4 * oldest.step + 24]
        assert state.steps[0] - oldest.step <= 128
        assert step < 65 or state.steps[0] - oldest.step >= 64
        first = state.lib.log_ring_next(state.ring)
        assert (first.trace.step if first else state.steps[0]) == oldest.step


@pytest.mark.parametrize("partial", [1, 2, 3])
def test_none_is_taken_where_samples_of_the_next_step_have_come(reference_core: Any, partial: int) -> None:
    state = State(reference_core)
    state.samples[0] += partial
    state.lib.log_snapshots_step(state.snapshots, state.ring)
    assert not state.oldest()
    state.step(4 - partial)
    assert state.oldest().step == 1
