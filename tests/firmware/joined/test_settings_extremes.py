"""No legal settings make a healthy aircraft tumble, stop or fall back: flown in the loop with the twin.

Each setting alone at either end of its range, and random sets of many. A flight hovers with the sticks a hair
off their centres, answers a command on all axes, then full stick on each axis, and comes to rest after each.

An aircraft tumbles if it turns more than TUMBLE_DEG otherwise than it was asked to while the sticks hardly
move; if it still turns by more than REST_DEG_S a second after the sticks were centred; or if an axis with
full stick does not turn the way of the stick. How fast it must turn then is not asked: physics may allow
less than the stick wants.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from neuroflight.flash.link import records
from neuroflight.flash.link.client import Client
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.toolchain.contract import (
    AUX_COUNT,
    AXES,
    CHANNEL_ARM,
    CHANNEL_AUX1,
    CHANNEL_COUNT,
    CHANNEL_MAPPED_COUNT,
    CHANNEL_MIN_US,
    CHANNEL_PID,
    GYRO_RATES_HZ,
    LOG_BAUDS,
    LOG_DIVIDERS,
    MODE_LOW_US,
    MODE_SLOT_COUNT,
    MODE_STEP_US,
    MODE_STEPS,
    MOTOR_COUNT_MAX,
    RATE_FULL_STICK_DEG_S,
    SETTINGS,
    SWITCH_ON_US,
    FallbackCause,
    Mode,
    ModeRange,
    Msp,
    Setting,
    StopCause,
)
from neuroflight.toolchain.errors import LinkError
from tests.flights.wiring import on_turned_board, reversed_aircraft
from tests.sampling import sampled

TUMBLE_DEG = 60.0
REST_DEG_S = 60.0
HAIR_DEG_S = 30.0  # what sticks may ask for that stand a hair off their centres; less is no turn
HOVER_S, PULSE_S, HELD_S, REST_S, END_S = 0.4, 0.5, 0.7, 1.0, 0.2
HAIR = 2 / 500  # two microseconds
THROTTLE = 0.3
FULL = RATE_FULL_STICK_DEG_S

# How the aircraft is wired, not how it flies: another value is another aircraft, or refused alone. And
# when it may arm at the earliest; and what only MSP and the beeper look at.
WIRED = frozenset(
    {
        *("gyro_alignment", "receiver_protocol", "battery_scale", "current_scale", "arming_delay_ms"),
        *("msp_baud", "msp_variant", "uart3_function", "uart3_baud", "battery_capacity_mah"),
        *(setting.name for setting in SETTINGS if setting.kind in ("text", "mode")),
        *(setting.name for setting in SETTINGS if setting.name.startswith("beep_")),
        *(f"motor{motor}_output" for motor in range(1, MOTOR_COUNT_MAX + 1)),
    }
)
MAP = [setting.name for setting in SETTINGS if setting.name.startswith("map_")]  # in the channels' order
LISTED = {"blackbox_baud": LOG_BAUDS, "blackbox_divider": LOG_DIVIDERS}  # the only values that are legal
MODES = [setting.name for setting in SETTINGS if setting.kind == "mode"]
MODE_HIGH_US = MODE_LOW_US + MODE_STEPS * MODE_STEP_US
OUTPUTS = [f"motor{motor}_output" for motor in range(1, 5)]  # of the NF1
BETAFLIGHT = 1  # of rates_style
Settings = dict[str, float]


def ranges_of(changed: Mapping[str, float]) -> dict[Mode, list[ModeRange]]:
    """The ranges of each mode under these settings."""
    slots = (ModeRange.unpack(int(changed.get(name, DEFAULTS[name]))) for name in MODES)
    ranges: dict[Mode, list[ModeRange]] = {mode: [] for mode in Mode}
    for used in filter(None, slots):
        ranges[used.mode].append(used)
    return ranges


def position_us(used: ModeRange, *, on: bool) -> int:
    """Where a channel stands inside or outside a range that leaves room for both."""
    if on:
        return (used.low_us + used.high_us) // 2
    return used.low_us - MODE_STEP_US // 2 if used.low_us > MODE_LOW_US else used.high_us + MODE_STEP_US // 2


class MappedPort(ReferencePort):
    """The library behind a transmitter that is set up for these settings, a trial's switch held."""

    def __init__(self, library: Path, changed: Mapping[str, float]) -> None:
        rate = int(changed.get("gyro_rate_hz", 1000))
        super().__init__(library, rate, {name: v for name, v in changed.items() if name != "gyro_rate_hz"})
        mapped = [int(changed.get(name, channel)) for channel, name in enumerate(MAP)]
        self._places = [*mapped, *range(len(mapped), CHANNEL_COUNT)]
        self._ranges = ranges_of(changed)

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """See FirmwarePort."""
        if channels_us is None:
            return super().exchange(sample, None)
        arm, pid = (channels_us[channel] >= SWITCH_ON_US for channel in (CHANNEL_ARM, CHANNEL_PID))
        wanted = dict.fromkeys(Mode, False) | {Mode.ARM: arm, Mode.PID: pid, Mode.TRIAL: True}
        flown = [*channels_us[:CHANNEL_AUX1], *[CHANNEL_MIN_US] * AUX_COUNT]
        for mode, ranges in self._ranges.items():
            for used in ranges:
                flown[CHANNEL_AUX1 + used.aux - 1] = position_us(used, on=wanted[mode])
        wire = [0] * CHANNEL_COUNT
        for place, us in zip(self._places, flown, strict=True):
            wire[place] = us
        return super().exchange(sample, wire)


def manoeuvres(*, pid: bool) -> Scenario:
    """Hover, pulse, full stick on each axis."""
    still = (0.0, 0.0, 0.0)
    segments = [
        Segment(HOVER_S, (HAIR * FULL, -HAIR * FULL, HAIR * FULL), THROTTLE, pid=pid),
        Segment(PULSE_S, (0.2 * FULL, -0.2 * FULL, 0.2 * FULL), THROTTLE, pid=pid),
        Segment(REST_S, still, THROTTLE, pid=pid),
    ]
    for axis in range(3):
        rates = [0.0, 0.0, 0.0]
        rates[axis] = FULL if axis != 1 else -FULL
        segments.append(Segment(HELD_S, (rates[0], rates[1], rates[2]), THROTTLE, pid=pid))
        segments.append(Segment(REST_S, still, THROTTLE, pid=pid))
    return Scenario("extremes", tuple(segments))


class RefusedError(Exception):
    """The firmware does not start, or does not arm; the message says why."""


def built(changed: Settings) -> Aircraft:
    """The NF1 with its motors turning as the settings say."""
    if not changed.get("motors_reversed"):
        return load_aircraft("nf1")
    with TemporaryDirectory() as folder:
        return reversed_aircraft("nf1", Path(folder))


def flown(library: Path, changed: Settings, *, pid: bool) -> tuple[Trace, records.Safety]:
    """The manoeuvres under these settings. Raises RefusedError, LinkError when it stops in flight."""
    try:
        port = MappedPort(library, changed)
    except LinkError as error:
        raise RefusedError(str(error)) from error
    on_turned_board(port, [changed.get(f"board_{axis}_deg", 0.0) for axis in AXES])
    twin = Twin(built(changed), rate_hz=port.gyro_rate_hz, rng=np.random.default_rng(11))
    outputs = [changed.get(name, number) for number, name in enumerate(OUTPUTS, start=1)]
    with closing(port), closing(twin):
        try:
            trace = fly(twin, port, manoeuvres(pid=pid), motor_order=np.argsort(outputs).tolist())
        except LinkError as error:
            if "did not arm" in str(error):
                raise RefusedError(str(error).partition(": ")[2]) from error
            raise
        return trace, records.safety(Client(port.reference).request(Msp.SAFETY))


def stopped(trace: Trace) -> list[str]:
    """When the motors stood still with the switch on and the throttle not low, which motor_stop may use."""
    rows = np.flatnonzero((trace.dshot == 0).all(axis=1) & (trace.throttle > 0.1))
    return [f"motors stop at {trace.t[rows[0]]:.3f} s"] if len(rows) else []


def while_hovering(setpoint: NDArray[np.float64], turned: NDArray[np.float64]) -> list[str]:
    """setpoint: (N, 3) [deg/s] of the hover; turned: (3,) [deg], off what was asked for."""
    found = [
        f"{axis} stick {1000 * HAIR / 2:.0f} us off its centre asks for {wanted:.0f} deg/s"
        for axis, wanted in zip(AXES, np.abs(setpoint).max(axis=0), strict=True)
        if wanted > HAIR_DEG_S
    ]
    return found + [
        f"{axis} turned by {angle:.0f} deg in a hover"
        for axis, angle in zip(AXES, turned, strict=True)
        if abs(angle) > TUMBLE_DEG
    ]


def tumbles(trace: Trace) -> list[str]:
    """What a healthy aircraft must not do in the manoeuvres."""
    step_s = float(trace.t[1] - trace.t[0])
    setpoint, rate = (np.rad2deg(array.astype(np.float64)) for array in (trace.setpoint, trace.rate))
    ends = np.rint(np.cumsum([segment.duration_s for segment in manoeuvres(pid=False).segments]) / step_s)
    last = round(END_S / step_s)
    hover = slice(0, int(ends[0]))
    found = while_hovering(setpoint[hover], (rate - setpoint)[hover].sum(axis=0) * step_s)
    for end, segment in zip(ends.astype(int)[1:], manoeuvres(pid=False).segments[1:], strict=True):
        tail = rate[end - last : end]
        asked = np.array(segment.setpoint_deg_s)
        if not asked.any():
            found += [
                f"{axis} turns by {worst:.0f} deg/s {REST_S:g} s after the sticks were centred at "
                f"{end * step_s - REST_S:.1f} s"
                for axis, worst in zip(AXES, np.abs(tail).max(axis=0), strict=True)
                if worst > REST_DEG_S
            ]
        elif np.abs(asked).max() == FULL:
            axis = int(np.abs(asked).argmax())
            wanted, got = setpoint[end - 1, axis], float(tail[:, axis].mean())
            if abs(wanted) > HAIR_DEG_S and got * np.sign(wanted) < min(0.2 * abs(wanted), 100.0):
                found.append(f"{AXES[axis]} turns by {got:.0f} deg/s where full stick asks for {wanted:.0f}")
    return found


def faults(library: Path, changed: Settings) -> tuple[list[str], int]:
    """What is wrong with flights under these settings, and how many were flown.

    The policy flies, unless it is refused behind filters that it was not trained with, and the PID. Nothing
    is wrong where the firmware refuses by name.
    """
    found, flights = [], 0
    for pid in (False, True):
        try:
            trace, safety = flown(library, changed, pid=pid)
        except RefusedError as refusal:
            assert_named(str(refusal))
            continue
        except LinkError as error:
            found.append(str(error))
            continue
        flights += 1
        wrong = stopped(trace) + tumbles(trace)
        if safety.stop_cause != StopCause.SWITCH:
            wrong.append(f"stopped by {safety.stop_cause.name}")
        if safety.fallback_cause != (FallbackCause.SWITCH if pid else FallbackCause.NONE):
            wrong.append(f"fell back: {safety.fallback_cause.name}")
        found += [f"{'PID' if pid else 'policy'}: {text}" for text in wrong]
    return found, flights


# Why settings may keep a healthy aircraft from arming: other filters than the policy's, a tilt limit below
# the accelerometer's noise, more cells than the pack has.
EXPLAINED = {"POLICY_BAD", "NOT_LEVEL", "BATTERY_UNKNOWN", "SWITCH_NOT_CYCLED"}


def assert_named(refusal: str) -> None:
    """A refusal at boot names the settings, one at arming its reason."""
    if "refuses the settings" not in refusal and "refuses a gyro rate" not in refusal:
        assert set(refusal.split(", ")) <= EXPLAINED, refusal


def ends_of(setting: Setting) -> list[float]:
    """The least and the greatest value, each choice where there are few."""
    if setting.name == "gyro_rate_hz":
        return list(GYRO_RATES_HZ)
    if setting.choices:
        return list(range(len(setting.choices)))
    whole = setting.kind == "uint32_t"
    return [int(v) if whole else v for v in (setting.low, setting.high)]


def of_style(setting: Setting, style: int) -> Setting:
    """The setting with the limits that it has in a style of rates."""
    span = setting.betaflight
    if style != BETAFLIGHT or span is None:
        return setting
    return replace(setting, low=span.low, high=span.high, default=span.default)


ALONE: list[Settings] = [
    {setting.name: value}
    for setting in SETTINGS
    if setting.name not in WIRED
    for value in ends_of(setting)
    if value != setting.default
]
ALONE += [dict(zip(OUTPUTS, order, strict=True)) for order in ((4, 3, 2, 1), (2, 3, 4, 1))]
ALONE += [
    {"rates_style": BETAFLIGHT, setting.name: value}
    for setting in (of_style(setting, BETAFLIGHT) for setting in SETTINGS if setting.betaflight is not None)
    for value in ends_of(setting)
    if value != setting.default
]


@pytest.mark.parametrize(
    "changed",
    sampled(ALONE, *ALONE[::12]),
    ids=lambda changed: ",".join(f"{k}={v:g}" for k, v in changed.items()),
)
def test_nothing_tumbles_or_stops_when_one_setting_is_at_its_end(
    reference_library: Path, changed: Settings
) -> None:
    found, _ = faults(reference_library, changed)
    assert found == []


def values_of(setting: Setting) -> st.SearchStrategy[float]:
    """Legal values, the ends among them; frequencies by their logarithm."""
    if setting.name in LISTED:
        return st.sampled_from(LISTED[setting.name])
    ends = st.sampled_from(ends_of(setting))
    if setting.choices or setting.name == "gyro_rate_hz":
        return ends
    if setting.kind == "uint32_t":
        return ends | st.integers(int(setting.low), int(setting.high))
    if setting.low > 0.0 and setting.high / setting.low >= 10.0:
        decades = st.floats(np.log10(setting.low), np.log10(setting.high))
        drawn = decades.map(lambda power: float(np.clip(10.0**power, setting.low, setting.high)))
    else:
        drawn = st.floats(setting.low, setting.high)
    return ends | drawn.map(lambda value: float(f"{value:.4g}"))


FREE = {s.name: s for s in SETTINGS if s.name not in WIRED and s.name not in MAP}
DEFAULTS = {setting.name: setting.default for setting in SETTINGS}
STEPS = st.integers(0, MODE_STEPS)
SEVERAL = st.lists(st.sampled_from(sorted(FREE)), min_size=1, max_size=12, unique=True)


@st.composite
def mode_sets(draw: st.DrawFn) -> Settings:
    """All slots: each mode has one range or two of a kind, on AUX channels of its own, with room beside."""
    auxes = iter(draw(st.permutations(range(1, AUX_COUNT + 1))))
    ranges = []
    for mode in Mode:
        kinds = draw(st.sampled_from(([False], [True], [False, False], [True, True])))
        for together in kinds:
            low, high = sorted(draw(st.lists(STEPS, min_size=2, max_size=2, unique=True)))
            if (low, high) == (0, MODE_STEPS):
                low = 1  # a mode that is never off never arms
            low_us, high_us = (MODE_LOW_US + MODE_STEP_US * step for step in (low, high))
            ranges.append(ModeRange(mode, next(auxes), low_us, high_us, together).packed)
    packed = [*ranges, *[0] * (MODE_SLOT_COUNT - len(ranges))]
    return dict(zip(MODES, draw(st.permutations(packed)), strict=True))


@st.composite
def settings_sets(draw: st.DrawFn) -> Settings:
    """Some settings at legal values; one set in four with the receiver's channels and modes elsewhere."""
    names = draw(SEVERAL)
    changed: Settings = {}
    if "rates_style" in names:  # before the rates, which it sets to its defaults
        changed["rates_style"] = draw(values_of(FREE["rates_style"]))
    style = int(changed.get("rates_style", 0))
    changed |= {name: draw(values_of(of_style(FREE[name], style))) for name in names if name != "rates_style"}
    for low, high in (("dynamic_notch_low_hz", "dynamic_notch_high_hz"), ("battery_low_v", "battery_warn_v")):
        if not changed.get(low, DEFAULTS[low]) < changed.get(high, DEFAULTS[high]):
            changed.pop(low, None)  # refused for sure: too many would be
            changed.pop(high, None)
    if draw(st.integers(0, 3)) == 0:
        changed |= dict(zip(OUTPUTS, draw(st.permutations(range(1, 5))), strict=True))
    if draw(st.integers(0, 3)) == 0:
        changed |= dict(zip(MAP, draw(st.permutations(range(CHANNEL_MAPPED_COUNT))), strict=True))
        changed |= draw(mode_sets())
    return changed


def fly_sets(library: Path, count: int) -> None:
    """Fly `count` random legal sets, the same ones each time; most must take off."""
    sets = refused = 0

    @settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(settings_sets())
    def run(changed: Settings) -> None:
        nonlocal sets, refused
        found, flights = faults(library, changed)
        sets, refused = sets + 1, refused + (flights == 0)
        assert found == []

    run()
    assert refused < sets / 2, f"{refused} of {sets} sets were refused"


def test_nothing_tumbles_or_stops_under_random_legal_settings(reference_library: Path) -> None:
    fly_sets(reference_library, 8)


@pytest.mark.slow
def test_nothing_tumbles_or_stops_under_three_hundred_random_legal_settings(reference_library: Path) -> None:
    fly_sets(reference_library, 300)
