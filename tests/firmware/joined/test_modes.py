"""The joined core and the ranges of modes: what arms, and everything that must not."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    AUX_COUNT,
    CHANNEL_AUX1,
    CHANNEL_COUNT,
    CHANNEL_THROTTLE,
    CHANNEL_UNTOLD_US,
    MODE_SLOT_COUNT,
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
    RECEIVER_RECOVERY_MS,
    ArmingReason,
    Mode,
    ModeRange,
    StopCause,
)

Make = Callable[..., Any]
Frame = Callable[..., bytes]
SBUS, CRSF, MSP = range(3)
PROTOCOLS = pytest.mark.parametrize("protocol", [SBUS, CRSF, MSP], ids=["sbus", "crsf", "msp"])
WHOLE = (900, 2100)


def slots(*ranges: ModeRange) -> dict[str, int]:
    """Settings with these ranges and no other."""
    packed = [used.packed for used in ranges]
    return {
        f"mode{slot}": packed[slot - 1] if slot <= len(packed) else 0
        for slot in range(1, MODE_SLOT_COUNT + 1)
    }


def arm(aux: int, low: int, high: int, together: bool = False) -> ModeRange:
    return ModeRange(Mode.ARM, aux, low, high, together)


class Pilot:
    """A bench of these ranges behind a receiver of any protocol; its motors turn at 0.3 when armed."""

    def __init__(self, make: Make, frame: Frame, crsf: Frame, protocol: int, *ranges: ModeRange) -> None:
        self.bench = make(receiver_protocol=protocol, **slots(*ranges))
        self.bench.core.lib.scripted_action = [0.3] * 4
        self.protocol, self._frame, self._crsf = protocol, frame, crsf

    def hear(self, aux_us: dict[int, int], failsafe: bool = False, frame_lost: bool = False) -> None:
        """A frame with these AUX channels, all others at 1500 us, and the throttle low."""
        us = {f"c{CHANNEL_AUX1 + aux - 1}": aux_us.get(aux, 1500) for aux in range(1, AUX_COUNT + 1)}
        if self.protocol == MSP:
            channels = [1500] * CHANNEL_COUNT
            channels[CHANNEL_THROTTLE] = 1000
            channels[CHANNEL_AUX1:] = us.values()
            assert self.bench.core.lib.firmware_post(self.bench.fw, channels) == 0
            return
        sbus = self._frame(failsafe=failsafe, frame_lost=frame_lost, **us)
        self.bench.send(sbus if self.protocol == SBUS else self._crsf(0x16, sbus[1:23]))

    def fly(self, ms: int, aux_us: dict[int, int] | None, every_ms: int = 10, **flags: bool) -> None:
        """None: silence."""
        for elapsed in range(ms):
            if aux_us is not None and elapsed % every_ms == 0:
                self.hear(aux_us, **flags)
            turning = self.bench.sample() != [0, 0, 0, 0]
            assert turning == self.bench.armed

    def boot(self, aux_us: dict[int, int]) -> None:
        self.fly(1100, aux_us)
        assert not self.bench.armed

    def never_arms(self, flights: Iterable[tuple[int, dict[int, int] | None]]) -> None:
        for ms, aux_us in flights:
            self.fly(ms, aux_us)
            assert not self.bench.armed, (ms, aux_us)

    @property
    def modes(self) -> int:
        return int(self.bench.status.modes)


@pytest.fixture
def pilot(bench: Make, frame: Frame, crsf: Frame) -> Callable[..., Pilot]:
    return lambda protocol, *ranges: Pilot(bench, frame, crsf, protocol, *ranges)


# --- What arms --------------------------------------------------------------------------------
@PROTOCOLS
@pytest.mark.parametrize("aux", range(1, AUX_COUNT + 1))
def test_any_aux_channel_arms_and_disarms(pilot: Callable[..., Pilot], protocol: int, aux: int) -> None:
    p = pilot(protocol, arm(aux, 1700, 2100))
    p.boot({aux: 1000})
    assert p.bench.reasons == 0
    p.fly(30, {other: 2000 for other in range(1, AUX_COUNT + 1) if other != aux})
    assert not p.bench.armed
    p.fly(30, {aux: 1699})
    assert not p.bench.armed
    p.fly(30, {aux: 1700})
    assert p.bench.armed
    p.fly(30, {aux: 1699})
    assert not p.bench.armed
    assert p.bench.status.stop_cause == StopCause.SWITCH


@PROTOCOLS
@pytest.mark.parametrize(
    ("low", "high", "on", "off"),
    [(900, 1300, (880, 1000, 1299), (1300, 2159)), (1300, 1700, (1300, 1500, 1699), (1299, 1700))],
)
def test_a_range_anywhere_arms_inside_and_disarms_outside(
    pilot: Callable[..., Pilot],
    protocol: int,
    low: int,
    high: int,
    on: tuple[int, ...],
    off: tuple[int, ...],
) -> None:
    p = pilot(protocol, arm(5, low, high))
    p.boot({5: off[0]})
    for inside in on:
        for outside in off:
            p.fly(30, {5: inside})
            assert p.bench.armed, inside
            p.fly(30, {5: outside})
            assert not p.bench.armed, outside


@PROTOCOLS
def test_either_of_two_ranges_arms_and_only_both_off_disarm(
    pilot: Callable[..., Pilot], protocol: int
) -> None:
    p = pilot(protocol, arm(1, 1700, 2100), arm(12, 1700, 2100))
    p.boot({})
    p.fly(30, {12: 2000})
    assert p.bench.armed
    p.fly(30, {1: 2000, 12: 2000})
    p.fly(30, {1: 2000})
    assert p.bench.armed
    p.fly(30, {})
    assert not p.bench.armed


@PROTOCOLS
def test_ranges_that_belong_together_arm_together_and_one_of_them_disarms(
    pilot: Callable[..., Pilot], protocol: int
) -> None:
    p = pilot(protocol, arm(1, 1700, 2100, True), arm(2, 900, 1300, True))
    p.boot({1: 2000})
    p.never_arms([(30, {2: 1000}), (30, {1: 2000})])
    p.fly(30, {1: 2000, 2: 1000})
    assert p.bench.armed
    p.fly(30, {2: 1000})
    assert not p.bench.armed


# --- What never arms --------------------------------------------------------------------------
EVERY_US = [{1: us, 2: 3000 - us} for us in (1000, 1250, 1500, 1699, 1700, 1900, 2000)]


@PROTOCOLS
@pytest.mark.parametrize(
    "ranges",
    [
        (arm(1, *WHOLE),),
        (arm(1, 900, 1500), arm(1, 1500, 2100)),
        (arm(1, *WHOLE, True), arm(2, *WHOLE, True)),
        (arm(1, 1700, 2100), arm(3, *WHOLE)),
    ],
    ids=["one", "two halves", "together", "beside a good one"],
)
def test_ranges_that_are_never_off_never_arm(
    pilot: Callable[..., Pilot], protocol: int, ranges: tuple[ModeRange, ...]
) -> None:
    p = pilot(protocol, *ranges)
    p.never_arms((250, aux_us) for aux_us in [*EVERY_US, *EVERY_US])
    p.never_arms([(RECEIVER_HOLD_MS + 50, None), (300, {1: 1000}), (300, {1: 2000})])
    p.never_arms([(RECEIVER_LOST_MS + 50, None), (RECEIVER_RECOVERY_MS + 300, {1: 1000}), (300, {1: 2000})])
    assert p.bench.reasons == 1 << ArmingReason.SWITCH_NOT_CYCLED


@PROTOCOLS
def test_nothing_arms_when_no_range_does(pilot: Callable[..., Pilot], protocol: int) -> None:
    others = [ModeRange(mode, aux, 1700, 2100) for aux, mode in enumerate(set(Mode) - {Mode.ARM}, start=1)]
    p = pilot(protocol, *others, arm(4, 1500, 1500))
    everything = [dict.fromkeys(range(1, AUX_COUNT + 1), us) for us in (1000, 1500, 2000)]
    p.boot({})
    p.never_arms((300, aux_us) for aux_us in [*everything, *everything])


@PROTOCOLS
def test_a_range_around_what_stands_in_for_a_lost_receiver_arms_by_the_pilot_only(
    pilot: Callable[..., Pilot], protocol: int
) -> None:
    """A lost receiver's channels read 1000 us."""
    p, off, on = pilot(protocol, arm(6, 900, 1100)), {6: 1500}, {6: 1000}
    p.never_arms([(1100, None), (RECEIVER_RECOVERY_MS + 100, off)])
    assert p.modes == 0
    p.never_arms([(RECEIVER_HOLD_MS + 10, None), (50, off), (RECEIVER_LOST_MS + 500, None)])
    assert (p.bench.status.channels_us[CHANNEL_AUX1 + 5], p.modes) == (1000, 0)
    p.never_arms(
        [(RECEIVER_RECOVERY_MS - 20, off), (RECEIVER_LOST_MS, None), (RECEIVER_RECOVERY_MS + 100, on)]
    )
    assert p.bench.reasons == 1 << ArmingReason.SWITCH_NOT_CYCLED, "it was on when the link came back"
    p.never_arms([(50, off)])
    p.fly(30, on)
    assert p.bench.armed


def test_a_range_around_1000_us_does_not_arm_by_frames_in_failsafe_or_repeated_ones(
    pilot: Callable[..., Pilot],
) -> None:
    p, off, on = pilot(SBUS, arm(6, 900, 1100)), {6: 1500}, {6: 1000}
    p.boot(off)
    for flags in ({"failsafe": True}, {"frame_lost": True}, {"failsafe": True, "frame_lost": True}):
        p.fly(RECEIVER_LOST_MS + 500, on, **flags)
        assert not p.bench.armed
        p.fly(RECEIVER_RECOVERY_MS + 50, off)
        assert (p.bench.armed, p.bench.reasons) == (False, 0)
        p.hear(on, **flags)
        p.bench.sample()
        assert not p.bench.armed, "nor by a single one"
        p.fly(50, off)
    p.fly(30, on)
    assert p.bench.armed


def test_a_frame_over_msp_that_ends_early_arms_nothing_by_what_it_does_not_tell(
    pilot: Callable[..., Pilot],
) -> None:
    p, off = pilot(MSP, arm(6, 900, 2100), arm(7, 900, 1100)), {6: CHANNEL_UNTOLD_US, 7: 1500}
    p.boot(off)
    assert p.bench.reasons == 0
    for told in range(CHANNEL_AUX1, CHANNEL_AUX1 + 5):
        short = dict.fromkeys(range(told - CHANNEL_AUX1 + 1, AUX_COUNT + 1), CHANNEL_UNTOLD_US)
        p.never_arms([(100, short), (100, off), (100, short)])
        assert p.modes == 0
    p.fly(30, off | {7: 1000})
    assert p.bench.armed
    p.fly(30, dict.fromkeys(range(1, AUX_COUNT + 1), CHANNEL_UNTOLD_US))
    assert not p.bench.armed, "an arm switch that is not told is off"


@PROTOCOLS
def test_a_silent_receiver_keeps_it_armed_while_held_and_arms_nothing_afterwards(
    pilot: Callable[..., Pilot], protocol: int
) -> None:
    p, off, on = pilot(protocol, arm(6, 900, 1100)), {6: 1500}, {6: 1000}
    p.boot(off)
    p.fly(30, on)
    p.fly(RECEIVER_LOST_MS - 100, None)
    assert (p.bench.armed, p.modes) == (True, 1 << p.bench.core.lib.MODE_ARM)
    p.fly(200, None)
    assert (p.bench.armed, p.modes) == (False, 0)
    p.never_arms([(RECEIVER_RECOVERY_MS + 300, on), (500, None), (300, on)])
    p.never_arms([(50, off)])
    p.fly(30, on)
    assert p.bench.armed


@PROTOCOLS
def test_one_frame_outside_its_range_disarms_nothing_and_cycles_no_switch(
    pilot: Callable[..., Pilot], protocol: int
) -> None:
    p, off, on = pilot(protocol, arm(9, 1300, 1700)), {9: 1000}, {9: 1500}
    p.fly(1100, on)
    for _ in range(20):
        p.hear(off)
        p.fly(10, None)
        p.fly(20, on)
        assert not p.bench.armed, "on since before it was ready"
    p.fly(20, off)
    p.fly(20, on)
    assert p.bench.armed
    for _ in range(20):
        p.hear(off)
        p.fly(10, None)
        assert p.bench.armed
        p.fly(20, on)
    p.fly(20, off)
    assert not p.bench.armed


@pytest.mark.parametrize("seed", range(5))
def test_noise_arms_nothing_when_arming_asks_for_two_ranges_that_exclude_each_other(
    pilot: Callable[..., Pilot], sbus: Frame, seed: int
) -> None:
    """Any frames, bytes and silences: one channel is never in both."""
    rng = np.random.default_rng(seed)
    p = pilot(SBUS, arm(2, 900, 1500, True), arm(2, 1500, 2100, True))
    heard = 0
    for _ in range(1500):
        values = rng.integers(0, 2048, CHANNEL_COUNT).tolist()
        values[CHANNEL_THROTTLE] = 192
        data = sbus(values, failsafe=bool(rng.random() < 0.05), frame_lost=bool(rng.random() < 0.1))
        p.bench.send(data if rng.random() < 0.9 else data[: rng.integers(1, 25)])
        p.fly(int(rng.choice([1, 5, 10, 120], p=[0.3, 0.3, 0.39, 0.01])), None)
        assert not p.bench.armed
        assert p.modes & 1 << p.bench.core.lib.MODE_ARM == 0
        heard += p.bench.status.receiver_good
    assert heard > 500
