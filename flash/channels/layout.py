"""Channels by name, their places on the wire, and which of them arm, as a board's settings say."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from neuroflight.flash.settings.text import Value
from neuroflight.toolchain.contract import (
    AUX_COUNT,
    CHANNEL_AUX1,
    CHANNEL_COUNT,
    CHANNEL_MAPPED_COUNT,
    CHANNEL_MAX_US,
    CHANNEL_MID_US,
    CHANNEL_MIN_US,
    CHANNEL_THROTTLE,
    MODE_LOW_US,
    MODE_SLOT_COUNT,
    MODE_STEP_US,
    MODE_STEPS,
    THROTTLE_LOW_US,
    Mode,
    ModeRange,
)
from neuroflight.toolchain.errors import LinkError

Channels = tuple[int, ...]  # CHANNEL_COUNT pulse widths [us], in the order of NAMES

NAMES = ("roll", "pitch", "throttle", "yaw", *(f"aux{aux}" for aux in range(1, AUX_COUNT + 1)))
MODE_HIGH_US = MODE_LOW_US + MODE_STEPS * MODE_STEP_US
REST: Channels = tuple(  # sticks centred, throttle down, every switch in its low position
    {"throttle": CHANNEL_MIN_US, "roll": CHANNEL_MID_US, "pitch": CHANNEL_MID_US, "yaw": CHANNEL_MID_US}.get(
        name, CHANNEL_MIN_US
    )
    for name in NAMES
)


@dataclass(frozen=True)
class Layout:
    """A board's reading of channels: their order on the wire and the ranges of its arm switch."""

    wire: tuple[int, ...]  # the place on the wire of each of NAMES
    arm: tuple[ModeRange, ...]  # ranges of the mode arm
    disarmed_us: tuple[tuple[int, int], ...]  # channel and width at which no range of `arm` holds

    def on_wire(self, channels: Channels) -> list[int]:
        """Sort `channels` into the order of SET_RAW_RC."""
        sent = [0] * CHANNEL_COUNT
        for place, us in zip(self.wire, channels, strict=True):
            sent[place] = us
        return sent

    def arms(self, channels: Channels) -> bool:
        """Return True if any range of the arm switch holds, even one that arms only together with others."""
        return any(_holds(span, channels[_channel(span)]) for span in self.arm)

    def disarmed(self, channels: Channels) -> Channels:
        """Return `channels` with the arm switch off and the throttle down."""
        changed = list(channels)
        for channel, us in self.disarmed_us:
            changed[channel] = us
        changed[CHANNEL_THROTTLE] = CHANNEL_MIN_US
        return tuple(changed)

    def resting(self) -> Channels:
        """Return channels with centred sticks, throttle down and arm switch off."""
        return self.disarmed(REST)


def throttle_low(channels: Channels) -> bool:
    """Return True if the throttle is low enough to arm."""
    return channels[CHANNEL_THROTTLE] <= THROTTLE_LOW_US


def read_layout(get: Callable[[str], Value]) -> Layout:
    """Read the channel layout from a board's settings; `get` returns a setting's value by name.

    Raises LinkError if every position of the arm switch arms.
    """
    wire = list(range(CHANNEL_COUNT))
    for channel, name in enumerate(NAMES[:CHANNEL_MAPPED_COUNT]):
        wire[channel] = int(get(f"map_{name}"))
    if sorted(wire) != list(range(CHANNEL_COUNT)):
        raise LinkError("the settings map_... name a channel twice, expected each once")
    arm = tuple(_arm_ranges(int(get(f"mode{slot}")) for slot in range(1, MODE_SLOT_COUNT + 1)))
    channels = sorted({_channel(span) for span in arm})
    return Layout(tuple(wire), arm, tuple((channel, _off_us(channel, arm)) for channel in channels))


def _arm_ranges(packed: Iterable[int]) -> Iterator[ModeRange]:
    for value in packed:
        try:
            span = ModeRange.unpack(value)
        except ValueError:  # a mode that this tool does not know
            continue
        if span is not None and span.mode is Mode.ARM:
            yield span


def _channel(span: ModeRange) -> int:
    return CHANNEL_AUX1 + span.aux - 1


def _holds(span: ModeRange, us: int) -> bool:
    """Return True if the range holds at `us`. As in modes.c, a limit at the end of the scale is open."""
    low = 0 if span.low_us <= MODE_LOW_US else span.low_us
    high = 1 << 16 if span.high_us >= MODE_HIGH_US else span.high_us
    return low <= us < high


def _off_us(channel: int, arm: Sequence[ModeRange]) -> int:
    """Return a pulse width [us] of `channel` at which no range of the arm switch holds, low ones first."""
    positions: list[int] = [CHANNEL_MIN_US, CHANNEL_MAX_US]
    positions += range(CHANNEL_MIN_US, CHANNEL_MAX_US, MODE_STEP_US)
    for us in positions:
        if not any(_holds(span, us) for span in arm if _channel(span) == channel):
            return us
    raise LinkError(
        f"the arm switch is on at every position of {NAMES[channel]}, expected one that is off; "
        "set its mode range anew, see docs/reference/settings.md"
    )
