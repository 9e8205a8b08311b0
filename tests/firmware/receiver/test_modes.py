"""modes.c: which modes the AUX channels switch on."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neuroflight.toolchain.contract import (
    AUX_COUNT,
    CHANNEL_AUX1,
    CHANNEL_COUNT,
    CHANNEL_VALID_MAX_US,
    CHANNEL_VALID_MIN_US,
    MODE_LOW_US,
    MODE_SLOT_COUNT,
    MODE_STEP_US,
    MODE_STEPS,
    Mode,
    ModeRange,
)
from tests.sampling import examples

STEPS = st.integers(0, MODE_STEPS).map(lambda step: MODE_LOW_US + MODE_STEP_US * step)
PULSES = st.integers(CHANNEL_VALID_MIN_US, CHANNEL_VALID_MAX_US)
MODES = st.sampled_from(Mode)
AUXES = st.integers(1, AUX_COUNT)


class Modes:
    """Modes of these ranges, in the first slots unless told otherwise."""

    def __init__(self, core: Any, *ranges: ModeRange, first_slot: int = 1) -> None:
        self.lib, self.self = core.lib, core.new("struct modes *")
        values = core.new("struct nf_settings *")
        core.lib.settings_default(values)
        for slot in range(1, MODE_SLOT_COUNT + 1):
            setattr(values, f"mode{slot}", 0)
        for slot, used in enumerate(ranges, start=first_slot):
            setattr(values, f"mode{slot}", used.packed)
        core.lib.modes_init(self.self, values)

    def on(self, **aux_us: int) -> set[Mode]:
        """What is on with the AUX channels there (aux1=..., aux2=...), all others at 1500 us."""
        channels = [1500] * CHANNEL_COUNT
        for name, us in aux_us.items():
            channels[CHANNEL_AUX1 + int(name.removeprefix("aux")) - 1] = us
        bits = self.lib.modes_on(self.self, channels)
        assert bits >> self.lib.MODE_COUNT == 0
        return {mode for mode in Mode if bits >> getattr(self.lib, f"MODE_{mode.name}") & 1}


ARM, PID = Mode.ARM, Mode.PID


def test_modes_lie_side_by_side_when_they_are_bits(scripted: Any) -> None:
    lib = scripted.lib
    assert [getattr(lib, f"MODE_{mode.name}") for mode in Mode] == list(range(lib.MODE_COUNT))
    assert [lib.mode_range_mode(index) for index in range(lib.MODE_COUNT)] == list(Mode)
    assert [lib.mode_range_index(mode) for mode in Mode] == list(range(lib.MODE_COUNT))
    assert {lib.mode_range_index(box) for box in set(range(256)) - set(Mode)} == {lib.MODE_COUNT}


@pytest.mark.parametrize(
    ("low", "high", "inside", "outside"),
    [
        (1700, 2100, (1700, 2099, 2100, 2159, 2250), (750, 900, 1000, 1500, 1699)),
        (1300, 1700, (1300, 1500, 1699), (750, 1299, 1700, 2250)),
        (900, 1300, (750, 880, 899, 900, 1299), (1300, 2099, 2250)),
        (925, 2075, (925, 2074), (750, 900, 924, 2075, 2099, 2100, 2250)),
        (900, 2100, (750, 899, 900, 1500, 2099, 2100, 2250), ()),
        (2075, 2100, (2075, 2099, 2100, 2250), (750, 2074)),
        (900, 925, (750, 900, 924), (925, 2250)),
    ],
)
def test_a_mode_is_on_from_the_low_end_to_below_the_high_end(
    scripted: Any, low: int, high: int, inside: tuple[int, ...], outside: tuple[int, ...]
) -> None:
    modes = Modes(scripted, ModeRange(PID, 3, low, high))
    assert [modes.on(aux3=us) for us in inside] == [{PID}] * len(inside)
    assert [modes.on(aux3=us) for us in outside] == [set()] * len(outside)


@pytest.mark.parametrize("aux", range(1, AUX_COUNT + 1))
@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("slot", [1, MODE_SLOT_COUNT])
def test_any_aux_channel_switches_any_mode_in_any_slot(
    scripted: Any, mode: Mode, aux: int, slot: int
) -> None:
    modes = Modes(scripted, ModeRange(mode, aux, 1700, 2100), first_slot=slot)
    assert modes.on(**{f"aux{aux}": 1700}) == {mode}
    others = {f"aux{other}": 2000 for other in range(1, AUX_COUNT + 1) if other != aux}
    assert modes.on(**others, **{f"aux{aux}": 1699}) == set()


def test_a_mode_is_on_in_any_of_its_ranges_when_it_has_several(scripted: Any) -> None:
    modes = Modes(
        scripted, ModeRange(ARM, 1, 900, 1100), ModeRange(ARM, 1, 1900, 2100), ModeRange(ARM, 2, 1900, 2100)
    )
    assert [modes.on(aux1=us) for us in (1000, 1500, 2000)] == [{ARM}, set(), {ARM}]
    assert modes.on(aux2=2000) == {ARM}


def test_a_mode_is_on_only_with_all_ranges_when_they_belong_together(scripted: Any) -> None:
    both = (ModeRange(ARM, 1, 1700, 2100, True), ModeRange(ARM, 2, 1700, 2100, True))
    modes = Modes(scripted, *both, ModeRange(PID, 2, 1700, 2100))
    assert modes.on(aux1=2000) == set()
    assert modes.on(aux2=2000) == {PID}
    assert modes.on(aux1=2000, aux2=2000) == {ARM, PID}
    plain = Modes(scripted, *both, ModeRange(ARM, 3, 1700, 2100))
    assert plain.on(aux3=2000) == plain.on(aux1=2000, aux2=2000) == {ARM}
    assert plain.on(aux2=2000) == set()


def test_a_single_range_of_that_kind_switches_its_mode_when_there_is_no_other(scripted: Any) -> None:
    modes = Modes(scripted, ModeRange(ARM, 1, 1700, 2100, True))
    assert [modes.on(aux1=us) for us in (1699, 1700)] == [set(), {ARM}]


def test_an_unused_slot_is_never_on_and_asks_for_nothing(scripted: Any) -> None:
    unused = ModeRange(ARM, 2, 1500, 1500, True)
    assert unused.packed != 0
    assert Modes(scripted, unused).on() == set()
    assert Modes(scripted, unused, ModeRange(ARM, 1, 1700, 2100, True)).on(aux1=2000) == {ARM}
    assert Modes(scripted).on(**{f"aux{aux}": 2000 for aux in range(1, AUX_COUNT + 1)}) == set()


def test_the_defaults_are_the_upper_positions_of_the_first_four_channels(scripted: Any) -> None:
    modes, values = scripted.new("struct modes *"), scripted.new("struct nf_settings *")
    scripted.lib.settings_default(values)
    scripted.lib.modes_init(modes, values)
    for channel, mode in enumerate((Mode.ARM, Mode.PID, Mode.BEEPER, Mode.TRIAL), start=CHANNEL_AUX1):
        for us in (1699, 1700, 2159):
            channels = [1000] * CHANNEL_COUNT
            channels[channel] = us
            bit = 1 << getattr(scripted.lib, f"MODE_{mode.name}")
            assert scripted.lib.modes_on(modes, channels) == (bit if us >= 1700 else 0)


@settings(max_examples=examples(300), deadline=None)
@given(
    ranges=st.lists(st.tuples(MODES, AUXES, STEPS, STEPS, st.booleans()), max_size=MODE_SLOT_COUNT),
    channels=st.lists(PULSES, min_size=AUX_COUNT, max_size=AUX_COUNT),
)
def test_modes_are_as_the_settings_say_when_ranges_and_channels_are_random(
    scripted: Any, ranges: list[tuple[Mode, int, int, int, bool]], channels: list[int]
) -> None:
    used = [ModeRange(mode, aux, min(a, b), max(a, b), together) for mode, aux, a, b, together in ranges]
    holds: dict[tuple[Mode, bool], list[bool]] = {}
    for each in used:
        if each.low_us < each.high_us:
            us = min(max(channels[each.aux - 1], 900), 2099)
            holds.setdefault((each.mode, each.and_others), []).append(each.low_us <= us < each.high_us)
    expected = {
        mode for mode in Mode if any(holds.get((mode, False), [])) or all(holds.get((mode, True), [False]))
    }
    aux_us = {f"aux{aux}": us for aux, us in enumerate(channels, start=1)}
    assert Modes(scripted, *used).on(**aux_us) == expected
