"""The joined core and the pilot: latency of a frame, protocols, channel map, rates, motor limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
    RECEIVER_RECOVERY_MS,
    ArmingReason,
    FlightState,
)

Make = Callable[..., Any]
Frame = Callable[..., bytes]
SBUS, CRSF = range(2)
STOPPED = [0, 0, 0, 0]


class Pilot:
    """A bench and the transmitter of one protocol."""

    def __init__(
        self, make: Make, frame: Frame, crsf: Frame, protocol: int, gyro_hz: int, **settings: float
    ) -> None:
        self.bench = make(gyro_hz, receiver_protocol=protocol, **settings)
        self.protocol, self._frame, self._crsf = protocol, frame, crsf

    def frame(self, **sticks: int) -> bytes:
        sbus = self._frame(**sticks)
        return sbus if self.protocol == SBUS else self._crsf(0x16, sbus[1:23])

    def flagged(self, **sticks: int) -> bytes:
        """A frame of a receiver that has lost its transmitter and says so."""
        return self._frame(failsafe=True, **sticks) if self.protocol == SBUS else self._uplink(0, **sticks)

    def cleared(self) -> bytes:
        """What a receiver of CRSF says before its channels are the transmitter's again."""
        return b"" if self.protocol == SBUS else self._crsf(0x14, bytes([70, 70, 99, *[0] * 7]))

    def _uplink(self, percent: int, **sticks: int) -> bytes:
        return self._crsf(0x14, bytes([70, 70, percent, *[0] * 7])) + self.frame(**sticks)

    def step(self, data: bytes = b"") -> list[int]:
        """Gyro samples until a control step has taken `data`; the rest of its period follows."""
        self.bench.send(data)
        values: list[int] = self.bench.sample()
        while not self.bench.core.lib.firmware_control_due(self.bench.fw):
            assert self.bench.sample() == values
        return values

    def fly(self, steps: int, every: int = 7, **sticks: int) -> list[int]:
        values: list[int] = []
        for step in range(steps):
            values = self.step(self.frame(**sticks) if step % every == 0 else b"")
        return values

    def arm(self) -> None:
        self.fly(1100)
        assert self.bench.reasons == 0
        self.fly(7, arm=2000)
        assert self.bench.armed


@pytest.fixture(params=[SBUS, CRSF], ids=["sbus", "crsf"])
def pilot(request: pytest.FixtureRequest, bench: Make, frame: Frame, crsf: Frame) -> Callable[..., Pilot]:
    return lambda gyro_hz=1000, **settings: Pilot(bench, frame, crsf, request.param, gyro_hz, **settings)


# --- The last byte ----------------------------------------------------------------------------
@pytest.mark.parametrize("gyro_hz", [1000, 8000])
def test_motors_stop_in_the_step_of_the_last_byte_when_the_second_off_comes_in_pieces(
    pilot: Any, scripted: Any, gyro_hz: int
) -> None:
    rng = np.random.default_rng(gyro_hz)
    p = pilot(gyro_hz)
    p.arm()
    scripted.lib.scripted_action = [0.3] * 4
    for _ in range(20):
        p.fly(int(rng.integers(7, 40)), arm=2000, throttle=1500)
        off = p.frame(arm=1000, throttle=1500)
        cut = int(rng.integers(1, len(off)))
        assert min(p.step(off)) > 48, "one frame may be wrong"
        assert min(p.step()) > 48
        assert min(p.step(off[:cut])) > 48
        assert p.step(off[cut:]) == STOPPED
        assert p.fly(20) == STOPPED
        p.fly(7, arm=2000)
        assert p.bench.armed


@pytest.mark.parametrize("period_ms", [4, 9, 14])
def test_an_off_costs_one_frame_when_frames_come_at_their_rate(pilot: Any, period_ms: int) -> None:
    """The time that the second frame costs: 4 ms of CRSF at 250 Hz, 9 or 14 ms of SBUS."""
    p = pilot()
    p.arm()
    p.fly(10 * period_ms, every=period_ms, arm=2000, throttle=1500)
    off = p.frame(arm=1000, throttle=1500)
    steps = [p.step(off if step % period_ms == 0 else b"") == STOPPED for step in range(3 * period_ms)]
    assert steps.index(True) == period_ms
    assert all(steps[period_ms:])


def test_two_offs_between_two_ons_stop_the_motors_when_all_come_in_one_step(pilot: Any) -> None:
    p = pilot()
    p.arm()
    p.fly(7, arm=2000, throttle=1500)
    on, off = p.frame(arm=2000, throttle=1500), p.frame(arm=1000, throttle=1500)
    assert min(p.step(on + off + on)) >= 48, "one of them may be wrong"
    assert p.step(on + off + off + on) == STOPPED
    assert p.fly(300, arm=2000) == STOPPED


def test_nothing_arms_when_one_off_stands_between_two_ons(pilot: Any) -> None:
    p = pilot()
    p.fly(1100, arm=2000)
    on, off = p.frame(arm=2000), p.frame(arm=1000)
    for _ in range(50):
        assert p.step(on + off + on) == p.step(off) == p.step(on) == STOPPED
    assert p.bench.reasons == 1 << ArmingReason.SWITCH_NOT_CYCLED
    assert p.step(off + off) == STOPPED
    p.step(on)
    assert p.bench.armed


def test_an_off_stops_the_motors_when_noise_stands_before_and_behind_it(pilot: Any) -> None:
    rng = np.random.default_rng(3)
    p = pilot()
    p.arm()
    for _ in range(20):
        noise = rng.integers(0x10, 0xC8, 8, np.uint8).tobytes()  # begins no frame
        assert min(p.step(noise + p.frame(arm=1000) + noise)) >= 48
        assert p.step(noise + p.frame(arm=1000) + noise) == STOPPED
        p.fly(20)
        p.fly(7, arm=2000)
        assert p.bench.armed


# --- Silence and noise ------------------------------------------------------------------------
def test_noise_is_silence_when_it_is_all_that_comes(pilot: Any, scripted: Any) -> None:
    """Random bytes that make no frame: held, then lost, as if nothing had come."""
    rng = np.random.default_rng(4)
    p = pilot()
    p.arm()
    scripted.lib.scripted_action = [0.3] * 4
    p.fly(50, arm=2000, throttle=1500, c0=1525)
    p.step(p.frame(arm=2000, throttle=1500, c0=1525))
    for step in range(1, RECEIVER_LOST_MS + 50):
        noise = rng.integers(0x10, 0xC8, 10, np.uint8).tobytes()
        values = p.step(noise)
        assert (p.bench.trace.setpoint[0] != 0) == (step < RECEIVER_HOLD_MS), step
        assert (values == STOPPED) == (step >= RECEIVER_LOST_MS), step


@pytest.mark.parametrize("delay_ms", [1000, 5000])
def test_a_receiver_in_failsafe_holds_at_once_and_its_taught_channels_are_not_flown(
    pilot: Any, scripted: Any, delay_ms: int
) -> None:
    """Switch off, throttle low, sticks in a corner: what a receiver may have been taught to send then."""
    p = pilot(failsafe_delay_ms=delay_ms)
    taught = {"arm": 1000, "throttle": 1000, "c0": 2000, "c1": 1000, "c3": 2000}

    def seen() -> tuple[FlightState, float, bool]:
        trace = p.bench.trace
        return FlightState(p.bench.status.state), round(trace.throttle, 6), any(trace.setpoint)

    p.arm()
    scripted.lib.scripted_action = [0.3] * 4
    p.fly(50, arm=2000, throttle=1500, c0=1525)
    p.step(p.frame(arm=2000, throttle=1500, c0=1525))
    assert seen() == (FlightState.ARMED, 0.5, True)
    for step in range(1, delay_ms - 1):
        assert min(p.step(p.flagged(**taught) if step % 7 == 1 else b"")) > 48
        assert seen() == (FlightState.FAILSAFE_HOLD, 0.5, False), step
    p.step(p.cleared() + p.frame(arm=2000, throttle=1400, c0=1525))
    assert seen() == (FlightState.ARMED, 0.4, True), "the first good frame flies again"
    for step in range(1, delay_ms + 1):
        values = p.step(p.flagged(**taught) if step % 7 == 1 else b"")
        assert (values == STOPPED) == (step == delay_ms), step
    assert seen() == (FlightState.FAILSAFE_DROP, 0, False)
    p.step(p.cleared())
    assert p.fly(500, arm=2000) == STOPPED, "the switch was never off"
    p.fly(20)
    assert seen()[0] == FlightState.DISARMED
    p.fly(7, arm=2000)
    assert p.bench.armed


def test_a_lost_receiver_must_recover_and_the_switch_be_cycled_when_it_returns(pilot: Any) -> None:
    p = pilot()
    p.arm()
    for _ in range(RECEIVER_LOST_MS + 1):
        p.step()
    assert not p.bench.armed
    p.fly(RECEIVER_RECOVERY_MS, every=5)
    assert p.bench.reasons & 1 << ArmingReason.RECEIVER_LOST
    p.fly(10, every=5)
    assert p.bench.reasons == 0
    p.fly(7, arm=2000)
    assert p.bench.armed


# --- Settings ---------------------------------------------------------------------------------
def test_sticks_and_switch_are_found_when_the_channels_are_mapped(pilot: Any) -> None:
    p = pilot(map_aux1=7, map_aux4=4, map_roll=3, map_yaw=0)
    p.fly(1100, c7=1000)
    p.fly(300, c4=2000, c7=1000)
    assert not p.bench.armed
    p.fly(7, c7=2000, c3=1600)
    assert p.bench.armed
    assert list(p.bench.trace.setpoint) == pytest.approx([math.radians(200), 0, 0])


def test_the_setpoint_follows_the_rates_when_they_are_set(pilot: Any) -> None:
    p = pilot(roll_rate=70.0, roll_max=670.0, roll_expo=0.0, yaw_deadband_us=20)
    p.arm()
    p.fly(7, arm=2000, c0=1750, c3=1515)
    assert list(p.bench.trace.setpoint) == pytest.approx([math.radians(35 + 600 / 4), 0, 0], rel=1e-6)


def test_the_setpoint_ramps_when_interpolation_is_on(pilot: Any) -> None:
    p = pilot(interpolation=1)
    p.arm()
    p.fly(70, arm=2000, c0=1500)
    p.step(p.frame(arm=2000, c0=1850))
    seen = []
    for _ in range(7):
        p.step()
        seen.append(round(math.degrees(p.bench.trace.setpoint[0])))
    assert seen == [100, 200, 300, 400, 500, 600, 700]


@pytest.mark.parametrize("limit", [0.4, 0.75])
def test_no_motor_turns_faster_than_its_limit_when_one_is_set(
    pilot: Any, scripted: Any, limit: float
) -> None:
    p = pilot(motor_limit=limit)
    p.arm()
    scripted.lib.scripted_action = [0.0, 0.5, 1.0, 0.25]
    values = p.fly(20, arm=2000, throttle=2000)
    assert values == [48, *(pytest.approx(48 + 1999 * limit * part, abs=1) for part in (0.5, 1.0, 0.25))]


def test_armed_motors_stand_still_when_motor_stop_is_set_and_the_throttle_low(
    pilot: Any, scripted: Any
) -> None:
    p = pilot(motor_stop=1)
    p.arm()
    scripted.lib.scripted_action = [0.2] * 4
    assert p.fly(20, arm=2000, throttle=1050) == STOPPED
    assert p.bench.armed
    assert min(p.fly(20, arm=2000, throttle=1051)) > 48
