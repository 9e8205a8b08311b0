"""control.c: which controller flies, and how the outputs blend at a change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import DEADLINE_MISSES_MAX, HANDOVER_MS, ArmingReason, FallbackCause

STILL = (0.0, 0.0, 0.0)
BAD = [math.nan, math.inf, -math.inf, -1e-6, 1.0000001]


def gains(core: Any, *, motors: int = 4, idle: float = 0.2, p: float = 0.01) -> Any:
    """A PID that only has a share of the roll error: motors 1 and 2 against 3 and 4."""
    made = core.new("struct pid_gains *")
    made.motor_count, made.idle = motors, idle
    made.p = [p, 0.0, 0.0]
    made.period_s, made.smoothing = 1e-3, 1.0
    made.mixer = [[1.0, 0.0, 0.0]] * 2 + [[-1.0, 0.0, 0.0]] * 2
    return made


class Flight:
    """A control of its own, stepped."""

    def __init__(
        self, core: Any, *, pid: Any = None, policy_good: bool = True, idle: float = 0.1, **settings: float
    ) -> None:
        self.core, self.lib = core, core.lib
        self._settings = core.new("struct nf_settings *")
        core.lib.settings_default(self._settings)
        for name, value in settings.items():
            setattr(self._settings, name, value)
        self._header = core.new("struct nf_policy_blob_header *", {"idle": idle})
        self._pid = pid if pid is not None else core.new("struct pid_gains *")
        self.self = core.new("struct control *")
        config = core.new(
            "struct control_config *",
            (self._settings, core.lib.policy_weights, self._header, policy_good, self._pid),
        )
        self.error = core.lib.control_init(self.self, config)
        self._out = core.new("float[4]")

    def step(
        self,
        *,
        pid: bool = False,
        setpoint: Sequence[float] = STILL,
        rate: Sequence[float] = STILL,
        throttle: float = 0.0,
    ) -> list[float] | None:
        """Outputs, None if they are refused."""
        kept = self.core.new("float[3]", setpoint), self.core.new("float[3]", rate)
        given = self.core.new("struct control_input *", (*kept, throttle))
        given.pid_wanted = pid
        return list(self._out) if self.lib.control_step(self.self, given, self._out) else None

    @property
    def pid_flies(self) -> bool:
        return bool(self.self.flying == self.lib.CONTROLLER_PID)

    def reasons(self, pid: bool) -> int:
        return int(self.lib.control_reasons(self.self, pid))


@pytest.fixture
def pull(scripted: Any) -> Any:
    """Pulls the policy's strings."""

    def to(*action: float) -> None:
        scripted.lib.scripted_action = list(action)

    to(0.0, 0.0, 0.0, 0.0)
    return to


def test_the_policy_flies_with_its_idle_and_the_pid_with_its_own_when_the_pilot_chooses(
    scripted: Any, pull: Any
) -> None:
    flight = Flight(scripted, pid=gains(scripted), idle=0.1)
    assert flight.step() == pytest.approx([0.1] * 4)
    assert not flight.pid_flies
    for _ in range(HANDOVER_MS):
        values = flight.step(pid=True)
    assert flight.pid_flies
    assert values == pytest.approx([0.2] * 4)
    assert flight.self.fallback == FallbackCause.SWITCH
    flight.step()
    assert not flight.pid_flies
    assert flight.self.fallback == FallbackCause.NONE


def test_arming_is_forbidden_when_the_chosen_controller_is_not_there(scripted: Any, pull: Any) -> None:
    bad, missing = 1 << ArmingReason.POLICY_BAD, 1 << ArmingReason.PID_MISSING
    for policy_good in (False, True):
        for pid in (None, gains(scripted), gains(scripted, motors=6)):
            flight = Flight(scripted, pid=pid, policy_good=policy_good)
            assert flight.reasons(pid=False) == (0 if policy_good else bad)
            there = pid is not None and pid.motor_count == 4
            assert flight.reasons(pid=True) == (0 if there else missing)


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("motor", range(4))
def test_the_pid_answers_in_the_same_step_and_to_the_end_when_the_policy_answers_nonsense(
    scripted: Any, pull: Any, bad: float, motor: int
) -> None:
    flight = Flight(scripted, pid=gains(scripted))
    flight.step()
    pull(*(bad if index == motor else 0.3 for index in range(4)))
    values = flight.step(setpoint=(10.0, 0.0, 0.0))
    assert values is not None
    assert np.isfinite(values).all()
    assert flight.pid_flies
    assert list(flight.self.action) == pytest.approx([0.2, 0.2, 0.0, 0.0]), "the PID's own answer"
    assert flight.self.fallback == FallbackCause.POLICY_OUTPUT
    pull(0.3, 0.3, 0.3, 0.3)
    for pid in (False, True, False):
        flight.step(pid=pid)
        assert flight.pid_flies
    assert flight.self.fallback == FallbackCause.POLICY_OUTPUT
    scripted.lib.control_acknowledge(flight.self)
    scripted.lib.control_reset(flight.self)
    flight.step()
    assert not flight.pid_flies, "the pilot gives it a new chance"
    assert flight.self.fallback == FallbackCause.NONE


def fallen_back(scripted: Any, pull: Any, cause: FallbackCause) -> Flight:
    """A flight in which the PID took over for that cause."""
    flight = Flight(scripted, pid=gains(scripted))
    flight.step()
    if cause == FallbackCause.POLICY_OUTPUT:
        pull(math.nan, 0.3, 0.3, 0.3)
        flight.step()
        pull(0.3, 0.3, 0.3, 0.3)
    else:
        for _ in range(DEADLINE_MISSES_MAX):
            scripted.lib.control_deadline(flight.self, True)
            flight.step()
    assert flight.pid_flies
    return flight


@pytest.mark.parametrize("cause", [FallbackCause.POLICY_OUTPUT, FallbackCause.DEADLINE])
def test_a_policy_that_fell_back_is_refused_through_flights_until_it_is_acknowledged(
    scripted: Any, pull: Any, cause: FallbackCause
) -> None:
    flight = fallen_back(scripted, pull, cause)
    for _ in range(3):
        assert flight.reasons(pid=False) == 1 << ArmingReason.POLICY_REFUSED
        assert flight.reasons(pid=True) == 0, "the PID may be armed"
        scripted.lib.control_reset(flight.self)
        for pid in (True, False, True, False):
            flight.step(pid=pid)
            assert flight.pid_flies, "the switch does not put a refused policy in command"
        assert (flight.self.refused, flight.self.fallback) == (cause, cause)
    scripted.lib.control_acknowledge(flight.self)
    assert flight.reasons(pid=False) == 0
    scripted.lib.control_reset(flight.self)
    flight.step()
    assert not flight.pid_flies


def test_the_policy_is_not_refused_when_the_pilot_chose_the_pid(scripted: Any, pull: Any) -> None:
    flight = Flight(scripted, pid=gains(scripted))
    flight.step()
    for _ in range(DEADLINE_MISSES_MAX):
        flight.step(pid=True)
        scripted.lib.control_deadline(flight.self, True)
    assert flight.self.refused == FallbackCause.NONE
    assert flight.reasons(pid=False) == 0


@pytest.mark.parametrize("bad", BAD)
def test_nothing_is_flown_and_the_policy_stays_bad_when_there_is_no_pid(
    scripted: Any, pull: Any, bad: float
) -> None:
    flight = Flight(scripted)
    flight.step()
    pull(0.3, bad, 0.3, 0.3)
    assert flight.step() is None
    assert flight.reasons(pid=False) == 1 << ArmingReason.POLICY_BAD
    scripted.lib.control_reset(flight.self)
    assert flight.reasons(pid=False) == 1 << ArmingReason.POLICY_BAD


@pytest.mark.parametrize("misses", [DEADLINE_MISSES_MAX - 1, DEADLINE_MISSES_MAX])
def test_the_pid_flies_when_so_many_deadlines_in_a_row_are_missed(
    scripted: Any, pull: Any, misses: int
) -> None:
    flight = Flight(scripted, pid=gains(scripted))
    for missed in ([True] * (DEADLINE_MISSES_MAX - 1) + [False]) * 5 + [True] * misses:
        flight.step()
        assert not flight.pid_flies
        scripted.lib.control_deadline(flight.self, missed)
    flight.step()
    assert flight.pid_flies == (misses == DEADLINE_MISSES_MAX)
    assert flight.self.fallback == (FallbackCause.DEADLINE if flight.pid_flies else FallbackCause.NONE)
    for _ in range(100):
        flight.step()
        scripted.lib.control_deadline(flight.self, False)
    assert flight.pid_flies == (misses == DEADLINE_MISSES_MAX), "until the next reset"


def test_the_policy_flies_on_when_deadlines_are_missed_and_there_is_no_pid(scripted: Any, pull: Any) -> None:
    flight = Flight(scripted)
    for _ in range(20):
        assert flight.step() is not None
        scripted.lib.control_deadline(flight.self, True)
    assert flight.self.fallback == FallbackCause.NONE


def test_the_pilots_choice_stays_the_cause_when_deadlines_are_missed_under_the_pid(
    scripted: Any, pull: Any
) -> None:
    flight = Flight(scripted, pid=gains(scripted))
    for _ in range(20):
        flight.step(pid=True)
        scripted.lib.control_deadline(flight.self, True)
    assert flight.self.fallback == FallbackCause.SWITCH
    flight.step()
    assert not flight.pid_flies


def test_the_one_that_can_flies_when_the_other_is_wanted(scripted: Any, pull: Any) -> None:
    with_pid = Flight(scripted, pid=gains(scripted), policy_good=False)
    with_pid.step()
    assert with_pid.pid_flies
    without = Flight(scripted)
    without.step(pid=True)
    assert not without.pid_flies


def test_outputs_pass_over_without_a_jump_when_the_controller_changes(scripted: Any, pull: Any) -> None:
    flight = Flight(scripted, pid=gains(scripted, idle=0.0), idle=0.0)
    pull(0.9, 0.1, 0.5, 0.0)
    rows = [flight.step(throttle=0.3)]
    rows += [flight.step(pid=True, throttle=0.3) for _ in range(HANDOVER_MS + 20)]
    rows += [flight.step(throttle=0.3) for _ in range(HANDOVER_MS + 20)]
    moves = np.abs(np.diff(np.array(rows), axis=0))
    gap = max(abs(value - 0.3) for value in (0.9 + 0.03, 0.1 + 0.03, 0.5 + 0.03, 0.03))
    assert moves.max() <= 1.01 * gap / HANDOVER_MS
    assert rows[HANDOVER_MS + 20] == pytest.approx([0.3] * 4)
    assert rows[-1] == rows[0]


def test_not_one_bit_changes_when_the_controller_does_not(scripted: Any, pull: Any) -> None:
    rng = np.random.default_rng(1)
    flight, twin = Flight(scripted, pid=gains(scripted)), Flight(scripted)
    for _ in range(300):
        pull(*rng.random(4).tolist())
        throttle = float(rng.random())
        assert flight.step(throttle=throttle) == twin.step(throttle=throttle)


def test_a_hand_over_keeps_to_the_motor_limit_when_one_is_set(scripted: Any, pull: Any) -> None:
    flight = Flight(scripted, pid=gains(scripted, idle=0.3, p=1.0), idle=0.1, motor_limit=0.6)
    pull(1.0, 1.0, 0.0, 0.0)
    flight.step()
    for _ in range(HANDOVER_MS):
        values = flight.step(pid=True, setpoint=(9.0, 0.0, 0.0))
        assert values is not None
        assert min(values) >= 0.0 and max(values) <= np.float32(0.6)


def test_the_policy_knows_nothing_of_before_when_it_takes_over_again(scripted: Any, pull: Any) -> None:
    flight = Flight(scripted, pid=gains(scripted))
    pull(0.1, 0.2, 0.3, 0.4)
    for _ in range(5):
        flight.step(setpoint=(1.0, 2.0, 3.0))
    for _ in range(5):
        flight.step(pid=True, setpoint=(1.0, 2.0, 3.0))
    inits = scripted.lib.scripted_inits
    flight.step(setpoint=(5.0, 6.0, 7.0))
    seen = np.array(list(scripted.lib.scripted_observation))
    assert scripted.lib.scripted_inits == inits + 1
    assert seen[6:9].tolist() == [0, 0, 0]
    np.testing.assert_allclose(seen[9:12], np.array([5, 6, 7]) / 1000, rtol=1e-6)
    assert seen[12:16].tolist() == [0, 0, 0, 0]


def test_the_spread_is_that_of_the_answer_when_asked(scripted: Any, pull: Any) -> None:
    flight = Flight(scripted)
    for action in ((0.1, 0.7, 0.3, 0.4), (0.7, 0.3, 0.1, 0.4), (0.4, 0.3, 0.7, 0.1)):
        pull(*action)
        flight.step(throttle=1.0)
        assert scripted.lib.control_spread(flight.self) == pytest.approx(0.6)


@pytest.mark.parametrize("idle", [-0.1, 1.0, math.nan])
def test_init_refuses_when_an_idle_is_none(scripted: Any, pull: Any, idle: float) -> None:
    assert Flight(scripted, idle=idle).error == scripted.lib.NF_ERR_IDLE
    assert Flight(scripted, pid=gains(scripted, idle=idle)).error == scripted.lib.NF_ERR_IDLE


def test_misses_of_a_flight_do_not_count_in_the_next(scripted: Any, pull: Any) -> None:
    flight = Flight(scripted, pid=gains(scripted))
    for _ in range(5):
        for _ in range(DEADLINE_MISSES_MAX - 1):
            flight.step()
            scripted.lib.control_deadline(flight.self, True)
        scripted.lib.control_reset(flight.self)
    flight.step()
    assert not flight.pid_flies


def test_nothing_is_blended_in_when_a_flight_begins_with_another_controller(scripted: Any, pull: Any) -> None:
    flight = Flight(scripted, pid=gains(scripted, idle=0.0), idle=0.0)
    pull(0.9, 0.1, 0.5, 0.0)
    flight.step()
    scripted.lib.control_reset(flight.self)
    assert flight.step(pid=True, throttle=0.3) == pytest.approx([0.3] * 4)


def test_nothing_of_its_outputs_is_kept_when_a_policy_is_distrusted(scripted: Any, pull: Any) -> None:
    flight = Flight(scripted, pid=gains(scripted, idle=0.0), idle=0.0)
    pull(0.9, 0.1, 0.5, 0.0)
    flight.step()
    assert scripted.lib.control_distrust(flight.self, FallbackCause.WRONG_WAY)
    assert flight.step(throttle=0.3) == pytest.approx([0.3] * 4)
    scripted.lib.control_acknowledge(flight.self)
    scripted.lib.control_reset(flight.self)
    before = flight.step()
    after = flight.step(pid=True)
    assert before is not None and after is not None
    assert np.abs(np.subtract(after, before)).max() < 0.1, "later changes are blended again"


def test_a_demand_is_the_sum_of_all_motors_shares_in_its_axis(scripted: Any, pull: Any) -> None:
    pid = gains(scripted)
    mixer = np.array([[1.0, -0.5, 0.25], [-1.0, 0.75, 0.5], [0.5, 1.0, -1.0], [-0.25, -1.0, 1.0]])
    pid.mixer = mixer.tolist()
    flight = Flight(scripted, pid=pid)
    action = [0.1, 0.2, 0.4, 0.8]
    pull(*action)
    flight.step()
    demand = scripted.new("float[3]")
    assert scripted.lib.control_demand(flight.self, demand)
    assert list(demand) == pytest.approx((action @ mixer).tolist())
    assert not scripted.lib.control_demand(Flight(scripted).self, demand), "no mixer is built in"


@pytest.mark.parametrize("motor", range(4))
def test_the_spread_is_that_of_all_motors(scripted: Any, pull: Any, motor: int) -> None:
    flight = Flight(scripted, pid=gains(scripted))
    for lone, rest in ((0.9, 0.5), (0.1, 0.5)):
        pull(*(lone if index == motor else rest for index in range(4)))
        flight.step()
        assert scripted.lib.control_spread(flight.self) == pytest.approx(0.4)


def test_yaw_has_the_other_sign_for_both_controllers_when_the_motors_turn_the_other_way(
    scripted: Any, pull: Any
) -> None:
    """The same motors answer; what they ask of the aircraft is told as it is."""
    pid = gains(scripted, p=0.05)
    pid.p = [0.05, 0.03, 0.02]
    pid.mixer = [[-1.0, 1.0, 1.0], [-1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0]]
    usual, other = (Flight(scripted, pid=pid, motors_reversed=value) for value in (0, 1))
    demands = [scripted.new("float[3]") for _ in range(2)]
    rng = np.random.default_rng(1)
    for step in range(200):
        setpoint, rate = rng.normal(0.0, 3.0, (2, 3)).astype(np.float32).tolist()
        mirrored = [[*vector[:2], -vector[2]] for vector in (setpoint, rate)]
        pull(*rng.uniform(0.0, 0.5, 4).tolist())
        by_pid = step // 50 % 2 == 1
        expected = usual.step(pid=by_pid, setpoint=mirrored[0], rate=mirrored[1], throttle=0.3)
        seen = list(scripted.lib.scripted_observation)
        assert other.step(pid=by_pid, setpoint=setpoint, rate=rate, throttle=0.3) == expected
        assert list(scripted.lib.scripted_observation) == seen
        for flight, demand in zip((usual, other), demands, strict=True):
            assert scripted.lib.control_demand(flight.self, demand)
        roll, pitch, yaw = demands[0]
        assert list(demands[1]) == [roll, pitch, -yaw]
        assert yaw != 0.0
