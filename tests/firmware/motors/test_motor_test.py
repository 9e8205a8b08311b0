"""motor_test.c: motors turn on the bench, and the interlock always stops them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    MOTOR_BENCH_MAGIC,
    MOTOR_TEST_MAGIC,
    MOTOR_TEST_MAX,
    MOTOR_TEST_SUM_MAX,
    MOTOR_TEST_TIMEOUT_MS,
    Refusal,
)

LOST, HOLD, GOOD = range(3)
UNTOUCHED = [99] * 4  # what the core would have sent
STOPPED = [0] * 4
QUARTER = 48 + round(1999 * 0.25)


@dataclass
class View:
    stopped: bool = True
    switch_on: bool = False
    link: int = LOST


class Test:
    """A motor test at 1 kHz."""

    __test__ = False  # for pytest

    def __init__(self, core: Any, motors: int = 4, rate_hz: int = 1000) -> None:
        self.core, self.lib, self.motors = core, core.lib, motors
        self.self, self.out = core.new("struct motor_test *"), core.new("uint16_t[8]")
        self.lib.motor_test_init(self.self, rate_hz, motors)
        self.view = View()

    def _view(self) -> Any:
        view = self.view
        return self.core.new("struct motor_test_view *", (view.stopped, view.switch_on, view.link))

    def ask(self, magic: int = MOTOR_TEST_MAGIC, stopped: bool = True) -> Refusal:
        return Refusal(self.lib.motor_test_ask(self.self, magic, stopped))

    def give(self, *fractions: float) -> Refusal:
        return Refusal(self.lib.motor_test_give(self.self, list(fractions), len(fractions)))

    def look(self, **view: Any) -> None:
        """A receiver frame that says so; the next step sees the view as it was."""
        before, self.view = self.view, View(**{**vars(self.view), **view})
        self.lib.motor_test_update(self.self, self._view())
        self.view = before

    def step(self) -> list[int]:
        for motor in range(8):
            self.out[motor] = 99
        open_ = self.lib.motor_test_step(self.self, self._view(), self.out)
        values = list(self.out)[: self.motors]
        assert open_ == (values != [99] * self.motors)
        assert set(list(self.out)[self.motors :]) <= {99}
        return values

    def run(self, steps: int) -> list[int]:
        values: list[int] = []
        for _ in range(steps):
            values = self.step()
        return values

    def forbids(self) -> bool:
        return bool(self.lib.motor_test_forbids(self.self))

    def turning(self) -> None:
        """Open, all motors at a quarter."""
        assert self.ask() == Refusal.NONE
        assert self.give(0.25, 0.25, 0.25, 0.25) == Refusal.NONE
        assert self.step() == [QUARTER] * 4


@pytest.fixture
def bench(scripted: Any) -> Test:
    return Test(scripted)


# --- As it should go --------------------------------------------------------------------------
def test_motors_turn_as_told_when_the_test_is_open(bench: Test) -> None:
    assert not bench.forbids()
    assert bench.ask() == Refusal.NONE
    assert bench.forbids()
    assert bench.step() == STOPPED
    assert bench.give(0.0, 0.5, 0.0, 0.001) == Refusal.NONE
    assert bench.step() == [0, 48 + 1000, 0, 50]
    assert bench.run(100) == [0, 48 + 1000, 0, 50]
    assert bench.give(0.1) == Refusal.NONE, "motors that are not told stop"
    assert bench.step() == [48 + 200, 0, 0, 0]


@pytest.mark.parametrize("link", [LOST, GOOD])
def test_a_test_goes_on_as_long_as_values_come_when_nothing_forbids_it(bench: Test, link: int) -> None:
    bench.view.link = link
    bench.turning()
    for _ in range(10):
        assert bench.run(MOTOR_TEST_TIMEOUT_MS - 1) == [QUARTER] * 4
        assert bench.give(0.25, 0.25, 0.25, 0.25) == Refusal.NONE


def test_all_eight_motors_turn_when_there_are_eight(scripted: Any) -> None:
    bench = Test(scripted, motors=8)
    bench.ask()
    assert bench.give(*[0.125] * 8) == Refusal.NONE
    assert bench.step() == [48 + 250] * 8


@pytest.mark.parametrize("rate_hz", [1000, 4000])
def test_motors_stop_when_no_values_come_for_as_long_as_is_set(scripted: Any, rate_hz: int) -> None:
    bench = Test(scripted, rate_hz=rate_hz)
    bench.turning()
    timeout = MOTOR_TEST_TIMEOUT_MS * rate_hz // 1000
    assert bench.run(timeout - 1) == [QUARTER] * 4
    assert bench.step() == UNTOUCHED
    assert bench.give(0.25) == Refusal.ORDER, "after the time-out it must be opened again"
    assert bench.run(10) == UNTOUCHED
    assert bench.forbids()
    bench.run(timeout - 11)
    assert bench.forbids()
    bench.run(1)
    assert not bench.forbids()


def test_an_open_test_ends_when_nothing_is_ever_told(bench: Test) -> None:
    bench.ask()
    assert bench.run(MOTOR_TEST_TIMEOUT_MS - 1) == STOPPED
    assert bench.step() == UNTOUCHED


def test_motors_stop_when_the_test_is_closed(bench: Test) -> None:
    bench.turning()
    assert bench.ask(0) == Refusal.NONE
    assert bench.forbids()
    assert bench.give(0.25) == Refusal.ORDER
    assert bench.step() == UNTOUCHED
    assert bench.forbids()
    bench.run(MOTOR_TEST_TIMEOUT_MS)
    assert not bench.forbids()


def test_old_values_are_forgotten_when_the_test_is_opened_again(bench: Test) -> None:
    bench.turning()
    bench.ask(0)
    bench.step()
    bench.ask()
    assert bench.run(20) == STOPPED
    bench.give(0.25)
    bench.ask()
    assert bench.run(20) == STOPPED, "also when it was not closed in between"


def test_one_motor_reaches_its_full_speed_when_it_stands_on_a_dynamometer(bench: Test) -> None:
    assert bench.ask(MOTOR_BENCH_MAGIC) == Refusal.NONE
    assert bench.step() == STOPPED
    assert bench.give(0.0, 1.0) == Refusal.NONE
    assert bench.run(MOTOR_TEST_TIMEOUT_MS) == [0, 2047, 0, 0]
    assert bench.step() == UNTOUCHED


# --- Attempts to defeat it --------------------------------------------------------------------
@pytest.mark.parametrize("wrong", [[1.0, 0.001], [0.6, 0.41], [1.0001], [0.0, math.nan], [0.0, -0.1]])
def test_a_dynamometer_turns_no_second_motor_and_none_faster_when_it_is_asked_to(
    bench: Test, wrong: list[float]
) -> None:
    bench.ask(MOTOR_BENCH_MAGIC)
    assert bench.give(*wrong) == Refusal.RANGE
    assert bench.step() == STOPPED


@pytest.mark.parametrize("between", [[], [0], [7]])
def test_the_limit_is_the_usual_one_when_a_test_follows_a_dynamometer(
    bench: Test, between: list[int]
) -> None:
    bench.ask(MOTOR_BENCH_MAGIC)
    bench.give(1.0)
    bench.step()
    for magic in between:
        bench.ask(magic)
    assert bench.ask() == Refusal.NONE
    assert bench.give(MOTOR_TEST_MAX + 1e-6) == Refusal.RANGE
    assert bench.step() == STOPPED


@pytest.mark.parametrize("view", [{"stopped": False}, {"switch_on": True}, {"link": GOOD}])
def test_a_dynamometer_stops_at_once_when_what_ends_a_test_happens(bench: Test, view: dict[str, Any]) -> None:
    assert bench.ask(MOTOR_BENCH_MAGIC, stopped=False) == Refusal.ARMED
    bench.ask(MOTOR_BENCH_MAGIC)
    bench.give(1.0)
    bench.step()
    bench.view = View(**view)
    assert bench.forbids()
    assert bench.step() == UNTOUCHED
    assert bench.give(1.0) == Refusal.ORDER


@pytest.mark.parametrize("magic", [1, MOTOR_TEST_MAGIC ^ 1, MOTOR_TEST_MAGIC ^ 1 << 31, 0xFFFFFFFF])
def test_nothing_opens_when_the_magic_is_wrong(bench: Test, magic: int) -> None:
    assert bench.ask(magic) == Refusal.PAYLOAD
    assert bench.give(0.25) == Refusal.ORDER
    assert bench.step() == UNTOUCHED
    assert not bench.forbids()


def test_an_open_test_closes_when_a_wrong_magic_comes(bench: Test) -> None:
    bench.turning()
    assert bench.ask(12345) == Refusal.PAYLOAD
    assert bench.step() == UNTOUCHED


def test_values_are_refused_when_the_test_was_never_opened(bench: Test) -> None:
    assert bench.give(0.1, 0.1, 0.1, 0.1) == Refusal.ORDER
    assert bench.step() == UNTOUCHED
    bench.ask()
    assert bench.step() == STOPPED


def test_nothing_opens_when_the_asker_knows_it_is_armed(bench: Test) -> None:
    assert bench.ask(stopped=False) == Refusal.ARMED
    assert bench.step() == UNTOUCHED
    assert not bench.forbids()


@pytest.mark.parametrize("view", [{"stopped": False}, {"switch_on": True}])
def test_nothing_turns_when_the_interrupt_knows_better_than_the_asker(
    bench: Test, view: dict[str, bool]
) -> None:
    bench.view = View(**view)
    assert bench.ask() == Refusal.NONE
    assert bench.give(0.25) == Refusal.NONE
    assert bench.run(10) == UNTOUCHED
    bench.view = View()
    assert bench.run(10) == UNTOUCHED, "the wish is gone"
    assert bench.give(0.25) == Refusal.ORDER


@pytest.mark.parametrize(
    "view",
    [{"stopped": False}, {"switch_on": True}, {"link": HOLD}, {"link": GOOD}, {"switch_on": True, "link": 2}],
)
@pytest.mark.parametrize("how", ["step", "frame"])
def test_motors_stop_at_once_when_something_happens(bench: Test, view: dict[str, Any], how: str) -> None:
    bench.turning()
    if how == "frame":
        bench.look(**view)  # and gone again before the step
    else:
        bench.view = View(**view)
    assert bench.forbids()
    assert bench.step() == UNTOUCHED
    bench.view = View()
    assert bench.run(10) == UNTOUCHED
    assert bench.give(0.25) == Refusal.ORDER


@pytest.mark.parametrize(("link", "then"), [(GOOD, HOLD), (GOOD, LOST), (HOLD, GOOD), (HOLD, LOST)])
def test_motors_stop_when_the_link_changes_either_way(bench: Test, link: int, then: int) -> None:
    bench.view.link = link
    bench.turning()
    bench.view.link = then
    assert bench.step() == UNTOUCHED


def test_arming_stays_forbidden_while_motors_spin_down_when_the_switch_ended_the_test(bench: Test) -> None:
    """The frame that ends the test must not be the one that arms, in whatever order the two look."""
    bench.turning()
    assert bench.forbids()
    bench.look(switch_on=True)
    assert bench.forbids()
    bench.view.switch_on = True
    for _ in range(MOTOR_TEST_TIMEOUT_MS - 1):
        assert bench.step() == UNTOUCHED
        assert bench.forbids()
    bench.step()
    assert not bench.forbids()


@pytest.mark.parametrize("before", [1, 2, MOTOR_TEST_TIMEOUT_MS - 1])
def test_arming_stays_forbidden_when_the_switch_comes_just_before_the_time_out(
    bench: Test, before: int
) -> None:
    bench.turning()
    bench.run(MOTOR_TEST_TIMEOUT_MS - before)
    bench.look(switch_on=True)
    assert bench.forbids()
    bench.run(MOTOR_TEST_TIMEOUT_MS - 1)
    assert bench.forbids()


def test_nothing_turns_when_the_interrupt_ended_the_test(bench: Test) -> None:
    bench.turning()
    bench.lib.motor_test_end(bench.self)
    assert bench.forbids()
    assert bench.give(0.25) == Refusal.ORDER
    assert bench.run(10) == UNTOUCHED
    bench.run(MOTOR_TEST_TIMEOUT_MS)
    bench.lib.motor_test_end(bench.self)
    assert not bench.forbids(), "the end of nothing is nothing"


@pytest.mark.parametrize(
    "wrong", [math.nan, math.inf, -math.inf, -0.001, MOTOR_TEST_MAX + 1e-6, 1.0, 1e9, -math.nan]
)
@pytest.mark.parametrize("motor", range(4))
def test_no_value_is_taken_when_one_is_out_of_range(bench: Test, wrong: float, motor: int) -> None:
    bench.turning()
    fractions = [0.1] * 4
    fractions[motor] = wrong
    assert bench.give(*fractions) == Refusal.RANGE
    assert bench.step() == [QUARTER] * 4


def test_refused_values_do_not_keep_the_test_open_when_they_come(bench: Test) -> None:
    bench.turning()
    for _ in range(MOTOR_TEST_TIMEOUT_MS - 1):
        bench.give(math.nan)
        assert bench.step() == [QUARTER] * 4
    assert bench.step() == UNTOUCHED


def test_the_motors_together_cannot_lift_when_each_is_within_its_range(bench: Test) -> None:
    bench.ask()
    assert bench.give(*[MOTOR_TEST_SUM_MAX / 4] * 4) == Refusal.NONE
    assert bench.give(*[MOTOR_TEST_SUM_MAX / 4 + 1e-4] * 4) == Refusal.RANGE
    assert bench.give(0.5, 0.5, 0.001) == Refusal.RANGE


@pytest.mark.parametrize("count", [5, 8])
def test_no_value_is_taken_when_there_are_fewer_motors(bench: Test, count: int) -> None:
    bench.ask()
    assert bench.give(*[0.0] * count) == Refusal.INDEX
    assert bench.step() == STOPPED


def test_zero_stops_a_motor_when_it_is_told(bench: Test) -> None:
    bench.turning()
    assert bench.give(0.0, -0.0, 1e-30, 0.25) == Refusal.NONE
    assert bench.step() == [0, 0, 48, QUARTER]


# --- Everything at once -----------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(5))
def test_motors_turn_only_in_a_test_that_was_opened_and_kept_when_everything_is_random(
    bench: Test, seed: int
) -> None:
    """An observer of requests and views knows when motors may turn at all."""
    rng = np.random.default_rng(seed)
    wished, link, refreshed, turned, ended = False, LOST, 0, 0, -10_000
    for step in range(9000):
        if rng.random() < 0.01:
            magic = int(rng.choice([MOTOR_TEST_MAGIC, MOTOR_TEST_MAGIC, 0, 7]))
            if bench.ask(magic) == Refusal.NONE and magic:
                wished, link, refreshed = True, -1, step  # the link is that of the next step
            else:
                wished = False
        if rng.random() < 0.01:
            fractions = rng.choice([0.0, 0.2, 0.25, 0.6, math.nan], 4, p=[0.3, 0.3, 0.36, 0.02, 0.02])
            if bench.give(*fractions) == Refusal.NONE:
                assert wished and fractions.max() <= MOTOR_TEST_MAX
                refreshed = step
        if rng.random() < 0.003:
            bench.view.link = int(rng.integers(3))
        if rng.random() < 0.01:
            bench.view.switch_on = bool(rng.random() < 0.2)
        if rng.random() < 0.01:
            bench.view.stopped = bool(rng.random() < 0.8)
        if link == -1:
            link = bench.view.link
        if rng.random() < 0.003:
            bench.look(switch_on=True)
            wished = False
        if not bench.view.stopped or bench.view.switch_on or bench.view.link != link:
            wished = False
        if step - refreshed >= MOTOR_TEST_TIMEOUT_MS:
            wished = False
        values = bench.step()
        if values != UNTOUCHED:
            assert wished, step
            assert bench.forbids()
            turned += any(values)
            ended = step
        if step - ended < MOTOR_TEST_TIMEOUT_MS:
            assert bench.forbids(), step
    assert turned > 300, "the test must have turned motors to mean anything"
