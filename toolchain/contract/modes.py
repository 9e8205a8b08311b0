"""Modes: what the pilot switches by ranges of AUX channels."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from neuroflight.toolchain.contract.receiver import CHANNEL_AUX1, CHANNEL_COUNT

AUX_COUNT = CHANNEL_COUNT - CHANNEL_AUX1  # channels behind the four sticks
MODE_SLOT_COUNT = 20  # ranges that can be set, as many as the ecosystem's
MODE_LOW_US, MODE_STEP_US, MODE_STEPS = 900, 25, 48  # a range's ends: 900 us + 25 us x 0..48
# By default AUX 1 to 4 switch a mode each on, from here upwards: the upper position of a switch.
SWITCH_ON_US = 1700
CHANNEL_ARM, CHANNEL_PID, CHANNEL_BEEPER, CHANNEL_TRIAL = range(CHANNEL_AUX1, CHANNEL_AUX1 + 4)


class Mode(IntEnum):
    """Modes by the ecosystem's permanent box numbers; 40 and 41 are those that it leaves to the builder."""

    ARM = 0
    BEEPER = 13
    BLACKBOX = 26  # if it has a range, a log is written only while it is on
    PID = 40  # the PID flies instead of the policy
    TRIAL = 41  # with policy_trial on, the policy flies only while this is on
    CHIRP = 55  # a swept sine is added to the setpoint of one axis


@dataclass(frozen=True)
class ModeRange:
    """A range of an AUX channel that switches a mode on: low_us <= channel < high_us."""

    mode: Mode
    aux: int  # 1..AUX_COUNT
    low_us: int
    high_us: int
    and_others: bool = False  # only while the mode's other ranges of this kind hold as well

    @property
    def packed(self) -> int:
        """The range as a setting's number: box in bits 0-7, aux - 1 in 8-11, low step in 12-17, high step in
        18-23, and_others in 24. 0 is no range, because its ends are equal."""
        low, high = ((us - MODE_LOW_US) // MODE_STEP_US for us in (self.low_us, self.high_us))
        return self.mode | (self.aux - 1) << 8 | low << 12 | high << 18 | self.and_others << 24

    @staticmethod
    def unpack(packed: int) -> ModeRange | None:
        """Return the range in a setting's number, or None. Raises ValueError for an unknown mode."""
        low, high = ((packed >> shift & 0x3F) * MODE_STEP_US + MODE_LOW_US for shift in (12, 18))
        if low == high:
            return None
        return ModeRange(Mode(packed & 0xFF), (packed >> 8 & 0xF) + 1, low, high, bool(packed >> 24 & 1))

    def __str__(self) -> str:
        """Format the range as users write it: `arm aux1 1700 2100`."""
        text = f"{self.mode.name.lower()} aux{self.aux} {self.low_us} {self.high_us}"
        return text + " and" if self.and_others else text
