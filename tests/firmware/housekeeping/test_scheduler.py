"""scheduler.c: which task runs when, and what is kept of each run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from neuroflight.toolchain.contract import Task

GYRO_HZ = 1000


class Clockwork:
    """A scheduler over tasks that note when they run, on a counter that the test turns."""

    def __init__(self, core: Any, rates: list[int], ids: list[Task]) -> None:
        ffi, lib = core.ffi, core.lib
        self.core, self.cycles, self.took = core, 0, 7
        self.runs: list[int] = []
        self._kept = [
            ffi.callback("void(void *)", lambda _, index=index: self._ran(index))
            for index in range(len(rates))
        ]
        self._counter = ffi.callback("uint32_t(void *)", lambda _: self.cycles & 0xFFFFFFFF)
        rows = [(int(i), rate, call) for i, rate, call in zip(ids, rates, self._kept, strict=True)]
        self._tasks = core.new("struct task[]", rows)
        self.stats = core.new("struct task_stats[]", len(Task))
        self.self = core.new("struct scheduler *")
        lib.scheduler_init(self.self, self._tasks, len(rows), self.stats, GYRO_HZ, self._counter, ffi.NULL)

    def _ran(self, index: int) -> None:
        self.runs.append(index)
        self.cycles += self.took

    def step(self, now: int) -> bool:
        return bool(self.core.lib.scheduler_step(self.self, now & 0xFFFFFFFF, self.core.ffi.NULL))

    def run(self, first: int, last: int, a_sample: int = 4) -> None:
        for now in range(first, last):
            for _ in range(a_sample):
                self.step(now)


@pytest.fixture
def clockwork(scripted: Any) -> Iterator[Clockwork]:
    yield Clockwork(scripted, [100, 50, 10], [Task.BATTERY, Task.ALERT, Task.STORAGE])


def test_tasks_run_at_their_rates_when_there_is_time(clockwork: Clockwork) -> None:
    clockwork.run(0, 1000)
    assert [clockwork.runs.count(index) for index in range(3)] == [100, 50, 10]
    assert [clockwork.stats[task].runs for task in (Task.BATTERY, Task.ALERT, Task.STORAGE)] == [100, 50, 10]
    assert [clockwork.stats[task].misses for task in Task] == [0] * len(Task)
    assert clockwork.stats[Task.ALERT].rate_hz == 50


def test_one_task_runs_a_call_when_all_are_due(clockwork: Clockwork) -> None:
    assert [clockwork.step(0) for _ in range(4)] == [True, True, True, False]
    assert clockwork.runs == [0, 1, 2]


def test_a_run_is_counted_as_missed_and_not_made_up_for_when_a_period_went_by(clockwork: Clockwork) -> None:
    clockwork.run(0, 1)
    clockwork.run(40, 41)
    assert clockwork.stats[Task.BATTERY].misses == 1
    assert clockwork.runs.count(0) == 2
    clockwork.run(41, 50)
    assert clockwork.runs.count(0) == 2, "the next is a period after the late one"
    clockwork.run(50, 51)
    assert clockwork.runs.count(0) == 3


@pytest.mark.parametrize(("late", "misses"), [(0, 0), (9, 0), (10, 1), (11, 1)])
def test_a_run_is_missed_from_a_whole_period_on(clockwork: Clockwork, late: int, misses: int) -> None:
    clockwork.run(0, 1)
    clockwork.run(10 + late, 11 + late)
    assert clockwork.stats[Task.BATTERY].misses == misses


def test_time_goes_on_when_the_sample_index_wraps(clockwork: Clockwork) -> None:
    clockwork.run(0, 1)
    for at in range(10, 2**32 + 1000, 2**30):
        clockwork.run(at, at + 1)
    clockwork.runs.clear()
    last = at + 1
    clockwork.run(last, last + 1000)
    assert [clockwork.runs.count(index) for index in range(3)] == [100, 50, 10]


def test_worst_best_and_mean_are_kept_when_runs_differ(clockwork: Clockwork) -> None:
    lib = clockwork.core.lib
    assert lib.task_stats_mean(clockwork.core.ffi.addressof(clockwork.stats, int(Task.BATTERY))) == 0
    for now, took in ((0, 10), (10, 40), (20, 25)):
        clockwork.took = took
        clockwork.run(now, now + 1)
    kept = clockwork.stats[Task.BATTERY]
    assert (kept.worst, kept.best, kept.sum) == (40, 10, 75)
    assert lib.task_stats_mean(clockwork.core.ffi.addressof(clockwork.stats, int(Task.BATTERY))) == 25


def test_the_mean_is_right_when_the_sum_has_outgrown_32_bits(scripted: Any) -> None:
    stats = scripted.new("struct task_stats *")
    scripted.lib.task_stats_init(stats, 1000)
    for _ in range(5):
        scripted.lib.task_stats_add(stats, 4_000_000_000, True)
    assert scripted.lib.task_stats_mean(stats) == 4_000_000_000
    assert (stats.misses, stats.rate_hz) == (5, 1000)
