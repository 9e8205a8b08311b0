"""The rate profiles of a file: which was flown, and the same rates in a style of this firmware."""

from __future__ import annotations

from dataclasses import dataclass, field

from neuroflight.flash.betaflight.counterparts import is_on, number
from neuroflight.flash.betaflight.diff_file import Diff, Line
from neuroflight.flash.betaflight.rate_curves import LIMIT_DEG_S, AxisRates, Profile, Style, nearest_style
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import LinkError

KINDS = ("BETAFLIGHT", "RACEFLIGHT", "KISS", "ACTUAL", "QUICK")
FIRST, LAST = (3, 0), (2026, 6)  # versions whose defaults are known
ACTUAL_SINCE = (4, 3)  # by default: commit ad6885e1ee of May 2021
KINDS_SINCE = (3, 3)  # before it there is one kind of rates
NESTED_UNTIL = (3, 1)  # each profile has rate profiles of its own
NOTICED = 0.5  # deg/s: larger differences are reported
_DEFAULTS = {"BETAFLIGHT": (100, 70, 0), "ACTUAL": (7, 67, 0)}
_NAMES: dict[str, tuple[tuple[str, ...], str]] = {  # setting: its axes, and which number of theirs it is
    **{f"{axis}_rc_rate": ((axis,), "rc_rate") for axis in AXES},
    **{f"{axis}_srate": ((axis,), "super_rate") for axis in AXES},
    **{f"{axis}_expo": ((axis,), "expo") for axis in AXES},
    **{f"{axis}_rate_limit": ((axis,), "limit") for axis in AXES},
    "rc_rate": (("roll", "pitch"), "rc_rate"),  # to 3.2
    "rc_rate_yaw": (("yaw",), "rc_rate"),
    "rc_expo": (("roll", "pitch"), "expo"),
    "rc_yaw_expo": (("yaw",), "expo"),  # 3.0, 3.1
    "rc_expo_yaw": (("yaw",), "expo"),  # 3.2
}
_NUMBERS = {
    "rc_rate": "rc_rate",
    "super_rate": "srate",
    "expo": "expo",
}  # of an axis: ours, Betaflight's name
KIND, QUICK_EXPO = "rates_type", "quickrates_rc_expo"
ProfilePlace = tuple[int, int]  # profile (0 where they do not matter) and rate profile


@dataclass
class Selection:
    """The selected profile, followed line by line."""

    told: list[int] = field(default_factory=list)

    def select(self, number: int) -> None:
        """Process a line `profile N` or `rateprofile N`."""
        self.told.append(number)

    @property
    def current(self) -> int:
        """The one that is selected now."""
        return self.told[-1] if self.told else 0

    @property
    def unsure(self) -> bool:
        """True if several profiles are named and none is selected after them, as in `diff all bare`."""
        told = self.told
        return len(set(told)) > 1 and told.count(told[-1]) == 1 and told[-1] == max(told)


@dataclass
class Result:
    """The imported rates, and the lines left out."""

    style: Style | None = None
    lines: list[Line] = field(default_factory=list)  # lines it was read from
    left: list[tuple[Line, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class RateProfiles:
    """The rate profiles that the lines of a file, taken in order, describe."""

    def __init__(self, diff: Diff, wanted: int | None) -> None:
        self._diff = diff
        self._wanted = wanted
        self._nested = diff.version <= NESTED_UNTIL
        self.profile = Selection()
        self._active: dict[int, int] = {}  # by profile
        self._rate = Selection()
        self._lines: dict[ProfilePlace, dict[str, Line]] = {}
        self._again: list[tuple[Line, Line]] = []
        self._structure: list[Line] = []

    def take(self, line: Line) -> bool:
        """Process a line that selects a profile or sets a rate; False for other lines. Raises ValueError."""
        words = line.words
        if words[0] in ("profile", "rateprofile") and len(words) == 2 and words[1].isdecimal():
            self._structure.append(line)
            selected = int(words[1][:9])
            if words[0] == "profile":
                self.profile.select(selected)
            else:
                self._active[self._outer] = selected
                self._rate.select(selected)
            return True
        if line.assigned is None or (name := line.assigned[0]) not in (*_NAMES, KIND, QUICK_EXPO):
            return False
        own = self._lines.setdefault(self._place, {})
        if name in own:
            self._again.append((own[name], line))
        own[name] = line
        return True

    @property
    def _place(self) -> ProfilePlace:
        return self._outer, self._active.get(self._outer, 0)

    @property
    def _outer(self) -> int:
        return self.profile.current if self._nested else 0

    def result(self) -> Result:
        """Return the flown profile's settings in this firmware. Raises LinkError if the file lacks it."""
        found = Result(left=[(line, "of the file or its board, no setting") for line in self._structure])
        found.left += [(old, f"line {new.number} says it again") for old, new in self._again]
        place = self._chosen()
        for other, lines in self._lines.items():
            if other != place:
                found.left += [
                    (line, f"of rate profile {other[1]}, which was not flown") for line in lines.values()
                ]
        lines = self._lines.get(place, {})
        if not lines and not self._rate.told:
            return found
        try:
            if self._wanted is None and self._rate.unsure:
                raise ValueError("which rate profile was flown does not show; give --rate-profile N")
            found.style = nearest_style(self._read(lines))
        except ValueError as error:
            found.left += [(line, str(error)) for line in lines.values()]
            found.notes.append(f"rates stay as they are: {error}")
            return found
        found.lines = list(lines.values())
        if found.style.off > NOTICED:
            found.notes.append(
                f"{self._kind(lines)} rates: the nearest of the style {found.style.name} differ by "
                f"{found.style.off:.0f} deg/s at most ({found.style.axis}, at {found.style.at:.0%} stick)"
            )
        if self._absent(lines):
            found.notes.append(
                f"rates that the file leaves out are the defaults of Betaflight {self._diff.release}: "
                f"{', '.join(self._absent(lines))}"
            )
        return found

    def _chosen(self) -> ProfilePlace:
        if self._wanted is None:
            return self._place
        there = sorted({*self._rate.told, *(place[1] for place in self._lines)})
        if self._wanted not in there:
            told = ", ".join(map(str, there)) or "none"
            raise LinkError(f"--rate-profile got {self._wanted}, expected one of the file's: {told}")
        return self._outer, self._wanted

    @property
    def _default_kind(self) -> str:
        """The default of the version that wrote the file. Raises ValueError if that is unknown."""
        if not FIRST <= self._diff.version <= LAST:
            raise ValueError(
                f"what Betaflight {self._diff.release} has by default is not known here, and the file leaves "
                "out some of the rates; `dump` tells them all"
            )
        return "ACTUAL" if self._diff.version >= ACTUAL_SINCE else "BETAFLIGHT"

    def _kind(self, lines: dict[str, Line]) -> str:
        if KIND not in lines:
            return self._default_kind
        told = _value(lines[KIND]).upper()
        told = KINDS[int(told)] if told.isdecimal() and int(told[:9]) < len(KINDS) else told
        if told not in KINDS:
            raise ValueError(f"rates_type got {told[:30]}, expected one of {', '.join(KINDS)}")
        return told

    def _absent(self, lines: dict[str, Line]) -> list[str]:
        """Return the names of rate settings that the file does not give."""
        told = {(axis, _NAMES[name][1]) for name in lines if name in _NAMES for axis in _NAMES[name][0]}
        names = [
            f"{axis}_{name}" for axis in AXES for what, name in _NUMBERS.items() if (axis, what) not in told
        ]
        return ([] if KIND in lines or self._diff.version < KINDS_SINCE else [KIND]) + names

    def _read(self, lines: dict[str, Line]) -> Profile:
        defaults = _DEFAULTS[self._default_kind] if self._absent(lines) else (0, 0, 0)
        numbers = {axis: dict(zip(_NUMBERS, defaults, strict=True)) for axis in AXES}
        for name, line in lines.items():
            axes, what = _NAMES.get(name, ((), ""))
            for axis in axes:
                numbers[axis][what] = _within(name, number(_value(line)))
        quick = QUICK_EXPO in lines and is_on(_value(lines[QUICK_EXPO]))
        return Profile(self._kind(lines), {axis: AxisRates(**numbers[axis]) for axis in AXES}, quick)


def _value(line: Line) -> str:
    assigned = line.assigned
    assert assigned is not None  # `take` has checked it
    return assigned[1]


def _within(name: str, value: int) -> int:
    top = LIMIT_DEG_S if name.endswith("_limit") else 255
    if not 0 <= value <= top:
        raise ValueError(f"{name} got {value}, expected 0 to {top}")
    return value
