"""chirp.c alone: the sweep against its formula, and one axis after the other."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.toolchain.contract import (
    CHIRP_ERROR_FACTOR,
    CHIRP_FADE_MS,
    CHIRP_LAG_HZ,
    CHIRP_LEAD_HZ,
    CHIRP_RATE_PART,
    RATE_MAX_DEG_S,
)

Array = NDArray[np.float64]
IDLE, RUNNING, SPENT = range(3)


class Sweep:
    """A chirp of its own, in deg/s and Hz."""

    def __init__(
        self, core: Any, rate_hz: int = 1000, amplitude: float = 100.0, start: float = 1.0, end: float = 100.0
    ) -> None:
        self._core = core
        values = core.new("struct nf_settings *")
        core.lib.settings_default(values)
        values.chirp_amplitude, values.chirp_start_hz, values.chirp_end_hz = amplitude, start, end
        values.chirp_s = 2.0
        self.state = core.new("struct chirp *")
        core.lib.chirp_init(self.state, values, rate_hz)
        self._input = core.new("struct chirp_input *", (True, True, 0))
        self._setpoint = core.new("float[3]")

    def step(
        self, *, on: bool = True, allowed: bool = True, controller: int = 0, asked: float = 0.0
    ) -> list[float]:
        """One control step; returns the setpoint, which was `asked` on all axes."""
        self._input.on, self._input.allowed, self._input.controller = on, allowed, controller
        self._setpoint[0:3] = [math.radians(asked)] * 3
        self._core.lib.chirp_step(self.state, self._input, self._setpoint)
        return [math.degrees(value) for value in self._setpoint]

    @property
    def axis(self) -> int:
        return int(self._core.lib.chirp_axis(self.state))


@pytest.mark.parametrize(
    ("rate_hz", "start", "end"), [(1000, 1.0, 100.0), (1000, 40.0, 5.0), (2000, 0.2, 250.0), (500, 7.0, 7.0)]
)
def test_the_sweep_is_the_formulas_when_it_runs(
    scripted: Any, rate_hz: int, start: float, end: float
) -> None:
    sweep, steps = Sweep(scripted, rate_hz, start=start, end=end), 2 * rate_hz
    end = min(end, CHIRP_RATE_PART * rate_hz)
    t = np.arange(steps) / rate_hz
    growth = math.log(end / start) / 2.0  # 1/s
    frequency = start * np.exp(growth * t)
    turns = np.cumsum(np.append(0.0, frequency[:-1])) / rate_hz
    share = CHIRP_LAG_HZ / CHIRP_LEAD_HZ
    gain = 1 - math.exp(-math.tau * CHIRP_LAG_HZ / rate_hz)
    sine, low = np.sin(math.tau * turns), 0.0
    for step in range(steps):
        setpoint = sweep.step(asked=20.0)
        assert sweep.axis == 0
        assert sweep.state.sweep.frequency_hz == pytest.approx(frequency[step], rel=1e-3)
        assert math.remainder(sweep.state.sweep.phase - turns[step], 1.0) == pytest.approx(0.0, abs=5e-3)
        assert 0.0 <= sweep.state.sweep.phase < 1.0
        assert sweep.state.sweep.sine == pytest.approx(math.sin(math.tau * sweep.state.sweep.phase), abs=1e-6)
        low += gain * (sine[step] - low)
        added = 100.0 * (share * sine[step] + (1 - share) * low)
        assert setpoint == pytest.approx([20.0 + added, 20.0, 20.0], abs=1.0)
        assert math.degrees(sweep.state.sweep.added) == pytest.approx(setpoint[0] - 20.0, abs=1e-3)
    assert sweep.step(asked=20.0) == pytest.approx([20.0] * 3)
    spent = sweep.state.sweep
    assert (sweep.axis, spent.frequency_hz, spent.phase, spent.added) == (-1, 0, 0, 0)
    assert list(sweep.state.room) == [0, 0, 0]


def test_each_sweep_excites_the_next_axis_when_the_mode_was_off_between(scripted: Any) -> None:
    sweep, axes = Sweep(scripted), []
    for _ in range(5):
        for _ in range(30):
            sweep.step()
        axes.append(sweep.axis)
        sweep.step(on=False)
        assert sweep.axis == -1
    assert axes == [0, 1, 2, 0, 1]


@pytest.mark.parametrize("why", [{"on": False}, {"allowed": False}, {"controller": 1}])
def test_it_ends_at_once_and_begins_anew_only_after_the_mode_was_off(
    scripted: Any, why: dict[str, Any]
) -> None:
    sweep = Sweep(scripted)
    for _ in range(100):
        sweep.step()
    assert sweep.step(asked=0.0)[0] != 0.0
    assert sweep.step(**why, asked=0.0) == [0.0] * 3
    assert sweep.axis == -1
    if why.get("on", True):
        assert {tuple(sweep.step(asked=0.0)) for _ in range(100)} == {(0.0, 0.0, 0.0)}
        sweep.step(on=False)
    assert sweep.state.sweep.state == IDLE
    sweep.step()
    assert (sweep.axis, sweep.state.sweep.phase, sweep.state.sweep.frequency_hz) == (1, 0.0, 1.0)


def test_it_does_not_begin_when_the_mode_came_on_where_it_is_not_allowed(scripted: Any) -> None:
    sweep = Sweep(scripted)
    sweep.step(allowed=False)
    assert sweep.state.sweep.state == SPENT
    for _ in range(50):
        assert sweep.step(asked=5.0) == pytest.approx([5.0] * 3)
    sweep.step(on=False)
    sweep.step()
    assert (sweep.state.sweep.state, sweep.axis) == (RUNNING, 0), "no axis was passed over"


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_setpoint_stays_within_what_the_gyro_can_say(scripted: Any, sign: int) -> None:
    sweep = Sweep(scripted, amplitude=300.0)
    seen = [sign * sweep.step(asked=sign * (RATE_MAX_DEG_S - 10.0))[0] for _ in range(1000)]
    assert max(seen) == pytest.approx(RATE_MAX_DEG_S)
    assert min(seen) < RATE_MAX_DEG_S - 200.0


def test_room_for_errors_follows_what_excites_the_axis_and_fades(scripted: Any) -> None:
    sweep, most = Sweep(scripted, end=1.0), 0.0
    for _ in range(400):
        sweep.step()
        most = max(most * math.exp(-1 / CHIRP_FADE_MS), abs(sweep.state.sweep.added))
        assert sweep.state.room[0] == pytest.approx(CHIRP_ERROR_FACTOR * most, rel=1e-3)
        assert list(sweep.state.room)[1:] == [0.0, 0.0]
    assert most > math.radians(50.0)
