"""The gyro's filters that a policy is trained behind, as a configuration and as a policy's metadata say them.

A configuration's text is `none`, `mean`, `rpm` or `rpm,mean`. `rpm` stands for `rpm:HARMONICS:HERTZ:QUALITY`;
what is left out is as in `RpmFilter`. The metadata's list is what the firmware hashes
(firmware/src/sensing/filters.h), hertz and quality times 1000: [["rpm",3,100000,5000],["mean"]].
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from neuroflight.toolchain.contract import (
    FILTER_DELAY_MAX_MS,
    GYRO_RATE_DEFAULT_HZ,
    POLICY_FILTER_MEAN,
    SETTINGS,
)

NONE, RPM = "none", "rpm"
_NUMBER = r"[0-9]{1,6}(?:\.[0-9]{1,3})?"
_TEXT = re.compile(rf"{RPM}(?::([0-9]))?(?::({_NUMBER}))?(?::({_NUMBER}))?")
_LIMITS = {setting.name: setting for setting in SETTINGS}


@dataclass(frozen=True)
class RpmFilter:
    """Notches at each rotor's turns, as its ESC tells them, and at their multiples; settings rpm_filter_*.

    Raises ValueError on a number that those do not allow.
    """

    harmonics: int = 3
    min_hz: float = 100.0  # the lowest centre, where notches have faded
    q: float = 5.0  # quality

    def __post_init__(self) -> None:
        for name, value in self.settings.items():
            low, high = max(1, _LIMITS[name].low), _LIMITS[name].high
            if not low <= value <= high:
                raise ValueError(f"gyro filter {RPM}: {name} is {value:g}, expected {low:g} to {high:g}")

    @property
    def settings(self) -> dict[str, float]:
        """The firmware's settings of this filter."""
        return {f"rpm_filter_{name}": value for name, value in vars(self).items()}


@dataclass(frozen=True)
class GyroFilters:
    """A chain of these: notches at the rotors' turns, then the mean of a control period's samples."""

    rpm: RpmFilter | None = None
    mean: bool = False

    @classmethod
    def parse(cls, text: str) -> GyroFilters:
        """Read a configuration's text. Raises ValueError, one line."""
        if text == NONE:
            return cls()
        first, _, mean = text.rpartition(",") if "," in text else (text, "", POLICY_FILTER_MEAN)
        if text == POLICY_FILTER_MEAN:
            return cls(mean=True)
        found = _TEXT.fullmatch(first)
        if found is None or mean != POLICY_FILTER_MEAN:
            raise ValueError(
                f"gyro filter {text!r}, expected {NONE}, {POLICY_FILTER_MEAN}, {RPM} or "
                f"{RPM},{POLICY_FILTER_MEAN}; {RPM} may have numbers, as in {cls(RpmFilter()).text}"
            )
        names = zip(vars(RpmFilter()), (int, float, float), found.groups(), strict=True)
        numbers = {name: kind(number) for name, kind, number in names if number is not None}
        return cls(RpmFilter(**numbers), mean="," in text)

    @classmethod
    def of(cls, chain: Sequence[object]) -> GyroFilters:
        """Read the list of a policy's metadata. Raises ValueError, one line, on another chain."""
        rest = list(chain)
        mean = rest[-1:] == [[POLICY_FILTER_MEAN]]
        if mean:
            rest.pop()
        match rest:
            case []:
                return cls(mean=mean)
            case [["rpm", int(harmonics), int(min_hz), int(q)]]:
                return cls(RpmFilter(harmonics, min_hz / 1000, q / 1000), mean)
        expected = ", ".join(
            json.dumps(each.chain) for each in (cls(), cls(mean=True), cls(RpmFilter(), mean=True))
        )
        raise ValueError(f"gyro filters {json.dumps(chain)}, expected chains as {expected}")

    @property
    def chain(self) -> list[list[str | int]]:
        """The list of a policy's metadata."""
        chain: list[list[str | int]] = []
        if self.rpm is not None:
            chain.append([RPM, self.rpm.harmonics, round(1000 * self.rpm.min_hz), round(1000 * self.rpm.q)])
        return chain + ([[POLICY_FILTER_MEAN]] if self.mean else [])

    @property
    def text(self) -> str:
        """A configuration's text."""
        parts = [POLICY_FILTER_MEAN] if self.mean else []
        if self.rpm is not None:
            parts.insert(0, ":".join((RPM, *(f"{value:g}" for value in vars(self.rpm).values()))))
        return ",".join(parts) or NONE

    @property
    def every_sample(self) -> bool:
        """True if it takes in every sample of the gyro, not that of a control step alone."""
        return self != UNFILTERED

    def check(self, motors: int, control_rate_hz: int) -> None:
        """Raise ValueError, one line, if the chain is later for slow motion than the settings allow."""
        if self.rpm is None:
            return
        centres = [self.rpm.min_hz * (1 + i) for i in range(self.rpm.harmonics)]
        delay = sum(motors / (2.0 * math.pi * hz * self.rpm.q) for hz in centres)
        delay += 0.5 / control_rate_hz - 0.5 / GYRO_RATE_DEFAULT_HZ  # the mean, which may come with them
        if 1000.0 * delay > FILTER_DELAY_MAX_MS:
            raise ValueError(
                f"gyro filter {self.text} with {motors} motors may be {1000.0 * delay:.2f} ms late, expected "
                f"at most {FILTER_DELAY_MAX_MS:g}; give it fewer harmonics, a higher centre or quality"
            )

    @property
    def settings(self) -> dict[str, float]:
        """The firmware's settings without which it refuses a policy behind this chain."""
        return {} if self.rpm is None else {"motor_telemetry": 1, **self.rpm.settings}


UNFILTERED, MEAN = GyroFilters(), GyroFilters(mean=True)
