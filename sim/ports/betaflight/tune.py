"""A pilot's settings of Betaflight: those lines of a `diff` or of a plain list that decide how it flies.

A file holds lines of Betaflight's command line, as `diff` prints them and as its app takes them in pasted:
what flies here can be pasted there, and the other way round. Of several profiles the last one chosen counts.
Rates, sticks, ports and all else that every controller has in common here, or that no simulator has, is not
taken over, nor are the positions of the app's sliders: what they set stands beside them. Betaflight itself
checks the names and values that are.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from neuroflight.flash.betaflight.diff_file import Line, read_diff
from neuroflight.sim.aircraft.model import aircraft_file
from neuroflight.toolchain.errors import LinkError

TUNED = "tuned"  # the name of the settings that lie beside an aircraft's file
SUFFIX = ".betaflight.txt"
HEADER = "# Betaflight / SITL 4.6.0"  # by which a file tells what its names and defaults mean
RELEASE = (4, 6)
RELEASE_TEXT = "4.6"
# What the names of settings begin with that decide how it flies, in the order of its own list: filters of
# the gyro and loop, then those of a profile.
TAKEN = (
    *("gyro_lpf", "gyro_notch", "pid_process_denom", "motor_idle", "mixer_type"),
    *("dterm_", "pid_at_min_throttle", "anti_gravity_", "acc_limit", "iterm_", "pidsum_limit"),
    *("yaw_lowpass_hz", "throttle_boost", "p_", "i_", "d_", "f_", "abs_control_", "use_integrated_yaw"),
    *("integrated_yaw_relax", "motor_output_limit", "thrust_linear", "feedforward_", "tpa_", "ez_landing_"),
)
# Those that change a flight on a board and do not exist in the simulator's build, or act on nothing in it.
WITHOUT_EFFECT = ("rpm_filter_", "dyn_notch_", "dyn_idle_", "dshot_", "vbat_sag_", "transient_throttle_limit")
VALUE = re.compile(r"[\w.,+-]{1,32}", re.ASCII)
IDLE_UNIT = 1e-4  # of motor_idle, motor fraction
IDLE_MAX = 2000  # of motor_idle, Betaflight's own limit


@dataclass(frozen=True)
class Tune:
    """Settings to be laid over Betaflight's defaults."""

    name: str  # for tables
    settings: tuple[tuple[str, str], ...]  # names and values
    places: tuple[str, ...]  # where each stands, as FILE:LINE
    without_effect: tuple[
        str, ...
    ] = ()  # names in the file that a board would obey, and the simulator cannot

    @property
    def lines(self) -> tuple[str, ...]:
        return tuple(f"set {name} = {value}" for name, value in self.settings)

    @property
    def idle(self) -> float | None:
        """Motor fraction of armed motors at zero thrust; None: the default."""
        value = dict(self.settings).get("motor_idle")
        return None if value is None else int(value) * IDLE_UNIT

    @property
    def sha256(self) -> str:
        return hashlib.sha256("\n".join(self.lines).encode()).hexdigest()


def tune_path(which: str, aircraft: str) -> Path:
    """Return the file of the settings `which`, a path or `tuned`; aircraft: a shipped name or a path."""
    if which != TUNED:
        return Path(which)
    path = aircraft_file(aircraft).with_suffix(SUFFIX)
    if not path.is_file():
        raise LinkError(
            f"betaflight:{TUNED}: {path} does not exist; find it by `neuroflight pid tune --of betaflight "
            f"--aircraft {aircraft} --out {path.name}`"
        )
    return path


def read_tune(path: Path, name: str | None = None) -> Tune:
    """Read a pilot's settings; name: for tables, instead of the file's.

    Raises LinkError, one line, on a file that is not Betaflight's, is of a release before 4.6, or holds no
    setting that decides how it flies.
    """
    diff = read_diff(path, assumed=RELEASE_TEXT)
    if diff.version < RELEASE:
        raise LinkError(
            f"{path}: of Betaflight {diff.release}, expected {RELEASE_TEXT} (2025.12) or later as here: "
            "a diff leaves out its release's defaults, and d_roll is another D since; load it into that "
            "release and take its diff"
        )
    found: dict[str, tuple[str, str]] = {}
    without_effect: dict[str, None] = {}
    for line in _flown(diff.lines):
        if line.assigned is None:
            continue
        setting, value = line.assigned
        if setting.startswith(WITHOUT_EFFECT):
            without_effect[setting] = None
        elif setting.startswith(TAKEN):
            _check(path, line, setting, value)
            found[setting] = (value, f"{path}:{line.number}")
    if not found:
        raise LinkError(
            f"{path}: no line such as `set p_roll = 45` in it that decides how Betaflight flies; expected "
            "its `diff all` or a list of such lines"
        )
    return Tune(
        name or path.name.removesuffix(SUFFIX),
        tuple((setting, value) for setting, (value, _) in found.items()),
        tuple(place for _, place in found.values()),
        tuple(without_effect),
    )


def tune_text(settings: Mapping[str, int | str], comment: Iterable[str]) -> str:
    """Return the content of a file for `read_tune` and Betaflight's app; comment: its first lines."""
    lines = [HEADER, *(f"# {line}" for line in comment)]
    lines += [f"set {name} = {value}" for name, value in settings.items()]
    return "\n".join(lines) + "\n"


def _flown(lines: Iterable[Line]) -> list[Line]:
    """Return the lines outside profiles, then those of the profile that is chosen last."""
    common: list[Line] = []
    profiles: dict[str, list[Line]] = {}
    section, chosen = common, "0"
    for line in lines:
        words = line.words
        if words[0] == "profile" and len(words) == 2:
            chosen = words[1]
            section = profiles.setdefault(chosen, [])
        elif words[0] == "rateprofile":
            section = common
        else:
            section.append(line)
    return common + profiles.get(chosen, [])


def _check(path: Path, line: Line, setting: str, value: str) -> None:
    """Raise LinkError on what is no value, or no idle."""
    if VALUE.fullmatch(value) is None:
        raise LinkError(f"{path}:{line.number}: {line.shown!r}, expected `set NAME = VALUE`")
    if setting == "motor_idle" and not (value.isdecimal() and 0 <= int(value) <= IDLE_MAX):
        raise LinkError(f"{path}:{line.number}: motor_idle {value}, expected 0 to {IDLE_MAX}")
