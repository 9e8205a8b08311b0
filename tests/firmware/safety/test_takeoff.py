"""takeoff.c: what is a take-off, and what an aircraft does that stands on the ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pytest

from neuroflight.toolchain.contract import TAKEOFF_FORGETS_MS, TAKEOFF_MS, TAKEOFF_THROTTLE, TAKEOFF_TURN_DEG

ABOVE = TAKEOFF_THROTTLE + 0.001
TURN_DEG_S = 200.0  # an aircraft that tips over


class Watch:
    """A detector of its own, just armed."""

    def __init__(self, core: Any, rate_hz: int = 1000, *, ground: int = 1) -> None:
        settings = core.new("struct nf_settings *")
        core.lib.settings_default(settings)
        assert settings.ground_detection == 1
        settings.ground_detection = ground
        self._core, self._takeoff, self.rate_hz = core, core.new("struct takeoff *"), rate_hz
        core.lib.takeoff_init(self._takeoff, settings, rate_hz)

    def reset(self) -> None:
        self._core.lib.takeoff_reset(self._takeoff)

    def airborne(
        self, ms: float = 0.0, rate_deg_s: Sequence[float] = (0, 0, 0), throttle: float = 0.0
    ) -> bool:
        """Whether it is after so long, at least a step."""
        rate = self._core.new("float[3]", [math.radians(each) for each in rate_deg_s])
        for _ in range(max(1, round(ms * self.rate_hz / 1000))):
            if not self._takeoff.airborne:  # as firmware.c asks it
                self._core.lib.takeoff_step(self._takeoff, rate, throttle)
        return bool(self._takeoff.airborne)


@pytest.mark.parametrize("rate_hz", [1000, 4000])
def test_it_has_taken_off_when_the_throttle_was_raised_for_its_time(scripted: Any, rate_hz: int) -> None:
    watch = Watch(scripted, rate_hz)
    step = 1000 / rate_hz
    assert not watch.airborne(TAKEOFF_MS - step, throttle=ABOVE)
    assert watch.airborne(throttle=ABOVE)
    assert watch.airborne(10_000), "a closed throttle is no landing"


def test_it_stands_when_the_throttle_is_no_higher_than_the_limit_or_only_for_moments(scripted: Any) -> None:
    watch = Watch(scripted)
    assert not watch.airborne(60_000, throttle=0.19)
    for _ in range(20):
        assert not watch.airborne(TAKEOFF_MS - 1, throttle=1.0)
        assert not watch.airborne()


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("rate_hz", [1000, 4000])
def test_it_has_taken_off_when_an_axis_has_turned(scripted: Any, axis: int, sign: int, rate_hz: int) -> None:
    watch = Watch(scripted, rate_hz)
    rate = [0.0] * 3
    rate[axis] = sign * TURN_DEG_S
    # What is forgotten meanwhile makes it a little more than the angle.
    seconds = TAKEOFF_FORGETS_MS / 1000
    needed_ms = -1000 * seconds * math.log1p(-TAKEOFF_TURN_DEG / (TURN_DEG_S * seconds))
    assert not watch.airborne(needed_ms - 1, rate)
    assert watch.airborne(3, rate)


def test_it_stands_when_the_gyro_is_off_or_it_rocks(scripted: Any) -> None:
    watch = Watch(scripted)
    assert not watch.airborne(600_000, (3.0, -3.0, 3.0)), "ten minutes of drift"
    watch.reset()
    for _ in range(50):  # 15 deg to and fro, on its battery
        for rate in (150.0, -150.0):
            assert not watch.airborne(100, (rate, -rate, 0.0))


def test_each_flight_begins_on_the_ground(scripted: Any) -> None:
    watch = Watch(scripted)
    assert watch.airborne(500, throttle=ABOVE)
    watch.reset()
    assert not watch.airborne(TAKEOFF_MS - 1, throttle=ABOVE)
    watch.reset()
    assert not watch.airborne(TAKEOFF_MS - 1, throttle=ABOVE), "nor does half a take-off count in the next"
    watch.reset()
    assert not watch.airborne(100, (TURN_DEG_S, 0, 0))
    watch.reset()
    assert not watch.airborne(100, (TURN_DEG_S, 0, 0))


def test_arming_is_a_take_off_when_nobody_looks_for_the_ground(scripted: Any) -> None:
    watch = Watch(scripted, ground=0)
    assert watch.airborne()
    watch.reset()
    assert watch.airborne()
