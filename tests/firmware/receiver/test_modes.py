"""modes.c: which modes the AUX channels switch on."""

from __future__ import annotations

from typing import Any

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
# Half of the pulses lie where a range may end, or a microsecond below.
ENDS = st.builds(int.__add__, STEPS, st.integers(-1, 0))
PULSES = st.integers(CHANNEL_VALID_MIN_US, CHANNEL_VALID_MAX_US) | ENDS
MODES = st.sampled_from(Mode)
AUXES = st.integers(1, AUX_COUNT)


class Modes:
    """Modes of these ranges, in the last slots."""

    def __init__(self, core: Any, *ranges: ModeRange) -> None:
        self.lib, self.self = core.lib, core.new("struct modes *")
        values = core.new("struct nf_settings *")
        core.lib.settings_default(values)
        for slot in range(1, MODE_SLOT_COUNT + 1):
            setattr(values, f"mode{slot}", 0)
        for slot, used in enumerate(ranges, start=MODE_SLOT_COUNT + 1 - len(ranges)):
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


def test_modes_lie_side_by_side_when_they_are_bits(scripted: Any) -> None:
    lib = scripted.lib
    assert [getattr(lib, f"MODE_{mode.name}") for mode in Mode] == list(range(lib.MODE_COUNT))
    assert [lib.mode_range_mode(index) for index in range(lib.MODE_COUNT)] == list(Mode)
    assert [lib.mode_range_index(mode) for mode in Mode] == list(range(lib.MODE_COUNT))
    assert {lib.mode_range_index(box) for box in set(range(256)) - set(Mode)} == {lib.MODE_COUNT}


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


@settings(max_examples=examples(2400), deadline=None)
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
