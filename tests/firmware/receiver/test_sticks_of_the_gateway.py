"""flash/mavlink/sticks.py is the way back through rates.c and modes.c: compared with the C."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest

from neuroflight.flash.mavlink.sticks import HALF_STICK_US, Sticks, nearest, sticks_of
from neuroflight.sim.ports.port import FLIGHT_RATES
from neuroflight.toolchain.contract import (
    CHANNEL_COUNT,
    CHANNEL_MAPPED_COUNT,
    CHANNEL_MID_US,
    CHANNEL_THROTTLE,
    SETTINGS,
    Mode,
    ModeRange,
)
from tests.firmware.receiver.test_modes import Modes
from tests.firmware.receiver.test_rates import ACTUAL, BETAFLIGHT, Rates

DEFAULTS = {setting.name: setting.default for setting in SETTINGS}
STYLES: dict[str, dict[str, float]] = {
    "default": {},
    "actual": {"roll_rate": 70, "roll_max": 670, "roll_expo": 0.54, "pitch_rate": 200, "pitch_max": 0.0},
    "dead bands": {"deadband_us": 40, "yaw_deadband_us": 100, "yaw_expo": 1.0, "yaw_rate": 10},
    "linear": FLIGHT_RATES,
    "as fast as it goes": {"roll_max": 1600.0, "pitch_rate": 1000.0, "pitch_max": 1600.0, "pitch_expo": 1.0},
    "betaflight": {
        **{f"{axis}_rate": rate for axis, rate in (("roll", 1.0), ("pitch", 2.55), ("yaw", 0.01))},
        **{f"{axis}_max": rate for axis, rate in (("roll", 0.7), ("pitch", 1.0), ("yaw", 0.0))},
        **{f"{axis}_expo": rate for axis, rate in (("roll", 0.0), ("pitch", 1.0), ("yaw", 0.3))},
        "rates_style": BETAFLIGHT,
    },
}


def sticks(**changed: float) -> Sticks:
    return sticks_of(DEFAULTS | changed)


def flown(rates: Rates, channels: dict[int, int]) -> list[float]:
    """What rates.c makes of the channels."""
    wire = [CHANNEL_MID_US] * CHANNEL_COUNT
    for channel, us in channels.items():
        wire[channel] = us
    return rates.setpoint(wire)


@pytest.mark.parametrize("style", STYLES)
def test_the_curve_is_that_of_the_firmware_at_every_microsecond(scripted: Any, style: str) -> None:
    settings = {"rates_style": ACTUAL, **STYLES[style]}
    rates, ours = Rates(scripted, **settings), sticks(**settings)
    for offset in range(HALF_STICK_US + 1):
        told = rates.at(CHANNEL_MID_US + offset)
        assert told == pytest.approx([curve[offset] for curve in ours.curves], rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("style", STYLES)
def test_no_other_channel_gives_a_rate_nearer_to_what_was_asked(scripted: Any, style: str) -> None:
    settings = {"rates_style": ACTUAL, **STYLES[style]}
    rates, ours, chance = Rates(scripted, **settings), sticks(**settings), random.Random(19)
    possible = [rates.setpoint([us] * CHANNEL_COUNT) for us in range(1000, 2001)]
    for _ in range(40):
        asked = tuple(chance.uniform(-limit, limit) for limit in ours.limits)
        channels, beyond = ours.rate_channels((asked[0], asked[1], asked[2]))
        got = flown(rates, channels)
        assert not beyond
        assert ours.setpoint(channels) == pytest.approx(got, rel=1e-6, abs=1e-6)
        for axis in range(3):
            best = min(abs(one[axis] - asked[axis]) for one in possible)
            assert abs(got[axis] - asked[axis]) <= best + 1e-5


def test_rates_have_the_signs_of_the_houses_axes(scripted: Any) -> None:
    channels, _ = sticks().rate_channels((1.0, 2.0, 3.0))
    assert flown(Rates(scripted), channels) == pytest.approx([1.0, 2.0, 3.0], abs=math.radians(1.01))
    assert [us > CHANNEL_MID_US for us in channels.values()] == [True, True, False]


def test_a_rate_beyond_full_stick_is_its_end_and_told_so(scripted: Any) -> None:
    ours = sticks(roll_rate=200.0, roll_max=200.0)
    for sign in (1, -1):
        channels, beyond = ours.rate_channels((sign * math.radians(201), 0.0, 0.0))
        assert beyond
        rates = Rates(scripted, roll_rate=200.0, roll_max=200.0)
        assert flown(rates, channels)[0] == pytest.approx(sign * math.radians(200))
    _, beyond = ours.rate_channels((math.radians(200), math.radians(670), math.radians(-670)))
    assert not beyond


def test_nothing_asked_is_the_very_centre() -> None:
    for style in STYLES.values():
        channels, _ = sticks(**style).rate_channels((0.0, -0.0, 0.0))
        assert set(channels.values()) == {CHANNEL_MID_US}


def test_the_nearest_of_equal_rates_is_that_next_to_the_centre() -> None:
    assert nearest((0.0, 0.0, 1.0, 2.0, 2.0, 2.0), 0.4) == 0
    assert nearest((0.0, 0.0, 1.0, 2.0, 2.0, 2.0), 0.6) == 2
    assert nearest((0.0, 0.0, 1.0, 2.0, 2.0, 2.0), 9.0) == 3


def test_channels_go_to_the_places_that_the_map_says() -> None:
    names = ("roll", "pitch", "throttle", "yaw", "aux1", "aux2", "aux3", "aux4")
    places = dict(zip(names, (7, 6, 5, 4, 3, 2, 1, 0), strict=True))
    ours = sticks(**{f"map_{name}": place for name, place in places.items()})
    frame = ours.frame({channel: 1001 + channel for channel in range(CHANNEL_COUNT)}, armed=True)
    expected = [1001 + channel for channel in range(CHANNEL_COUNT)]
    expected[4] = 1900  # the arm switch, in the middle of 1700 to 2100
    assert list(frame[:CHANNEL_MAPPED_COUNT]) == expected[7::-1]
    assert list(frame[CHANNEL_MAPPED_COUNT:]) == expected[8:]


ARM = Mode.ARM
RANGES = {
    "default": [ModeRange(ARM, 1, 1700, 2100)],
    "low": [ModeRange(ARM, 7, 900, 1000)],
    "several": [ModeRange(ARM, 2, 1700, 2100), ModeRange(ARM, 3, 900, 1100)],
    "together": [ModeRange(ARM, 2, 1700, 2100, True), ModeRange(ARM, 12, 900, 1100, True)],
    "both": [ModeRange(ARM, 4, 1700, 2100, True), ModeRange(ARM, 5, 1200, 1300)],
    "the same channel twice": [ModeRange(ARM, 2, 1200, 1800, True), ModeRange(ARM, 2, 900, 1400, True)],
    "another mode": [ModeRange(Mode.PID, 1, 900, 2100), ModeRange(ARM, 6, 1700, 2100)],
}


def with_ranges(ranges: list[ModeRange]) -> Sticks:
    slots = {f"mode{slot}": 0.0 for slot in range(1, 21)}
    used = {f"mode{slot}": float(one.packed) for slot, one in enumerate(ranges, start=3)}
    return sticks(**slots | used)


def is_armed(scripted: Any, ranges: list[ModeRange], frame: tuple[int, ...]) -> bool:
    modes = Modes(scripted, *ranges)
    return ARM in modes.on(**{f"aux{aux}": frame[aux + 3] for aux in range(1, 13)})


@pytest.mark.parametrize("name", RANGES)
def test_only_the_arm_switch_arms_whatever_the_channels_say(scripted: Any, name: str) -> None:
    ranges, chance = RANGES[name], random.Random(19)
    ours = with_ranges(ranges)
    assert is_armed(scripted, ranges, ours.frame({}, armed=True))
    assert not is_armed(scripted, ranges, ours.frame({}, armed=False))
    for _ in range(50):
        channels = {channel: chance.randrange(750, 2251) for channel in range(CHANNEL_COUNT)}
        assert not is_armed(scripted, ranges, ours.frame(channels, armed=False))
        assert is_armed(scripted, ranges, ours.frame(channels, armed=True))


@pytest.mark.parametrize(
    "ranges", [[], [ModeRange(ARM, 2, 1200, 1300, True), ModeRange(ARM, 2, 1400, 1500, True)]]
)
def test_there_is_no_arm_switch_when_no_range_can_hold(ranges: list[ModeRange]) -> None:
    assert with_ranges(ranges).arm == {}


def test_a_frame_without_other_channels_leaves_them_out() -> None:
    frame = sticks().frame({CHANNEL_THROTTLE: 1000}, armed=False)
    assert [us for us in frame if us] == [1000]
