"""Settings as people write them: values from text and back, `NAME=VALUE` and lines `set NAME = VALUE`.

The firmware's command line writes and takes the same text: numbers as the shortest decimals that are the
stored ones, choices by name, mode ranges as `arm aux1 1700 2100`, `none` for an unused one; texts as they
are, `-` for an empty one, in quotes where they would read as another otherwise.
"""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from decimal import Decimal

from neuroflight.toolchain.contract import (
    AUX_COUNT,
    MODE_LOW_US,
    MODE_STEP_US,
    MODE_STEPS,
    SETTING_LEAST,
    SETTING_TEXT_BYTES,
    SETTINGS,
    Mode,
    ModeRange,
    Setting,
)
from neuroflight.toolchain.errors import LinkError

Value = float | str  # a text for a setting of kind text; a mode range packed

STYLE = "rates_style"
STYLE_BETAFLIGHT = 1
UNUSED = "none"  # a mode range that is not set
NO_TEXT, QUOTE = "-", '"'
AND = "and"  # behind a mode range that holds only together with the mode's others
VALUE_MAX = 2.0**32  # of any setting: a larger one fits neither of their types
MODE_HIGH_US = MODE_LOW_US + MODE_STEPS * MODE_STEP_US
BY_NAME = {setting.name: (index, setting) for index, setting in enumerate(SETTINGS)}
RATES = frozenset(setting.name for setting in SETTINGS if setting.betaflight is not None)
_MODES = {mode.name.lower(): mode for mode in Mode}


def known_setting(name: str) -> Setting:
    """Return the contract's setting of that name. Raises LinkError."""
    if name not in BY_NAME:
        raise LinkError(f"setting {name!r} is unknown, expected one of docs/reference/settings.md")
    return BY_NAME[name][1]


def beside_style(setting: Setting, style: float) -> Setting:
    """Return `setting` with its limits and default under the rates style `style`."""
    other = setting.betaflight
    if other is None or style != STYLE_BETAFLIGHT:
        return setting
    return replace(setting, low=other.low, high=other.high, default=other.default, unit=other.unit)


def default_of(setting: Setting) -> Value:
    """Return the default as `value_text` and a firmware have it."""
    return "" if setting.kind == "text" else as_stored(setting.name, setting.default)


def as_stored(name: str, value: float) -> float:
    """Return `value` as the setting `name` stores it: rounded to float32 unless it is a whole number."""
    if known_setting(name).kind != "float":
        return value
    return as_float32(value)


def as_float32(value: float) -> float:
    """Return the float32 nearest to `value`, within float32's range; 0 if a setting would store 0."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0]) if abs(value) >= SETTING_LEAST else 0.0


# --- Text to value ---------------------------------------------------------------------------------
def parse_change(text: str) -> tuple[str, float]:
    """Read NAME=VALUE of a numeric setting for a flight; texts are refused. Raises LinkError."""
    name, value = parse_setting(text)
    if isinstance(value, str):
        raise LinkError(f"setting {name} is a text, expected one that changes a flight")
    return name, value


def parse_setting(text: str) -> tuple[str, Value]:
    """Read NAME=VALUE. Raises LinkError for an unknown setting or an impossible value."""
    name, equals, value = text.partition("=")
    name = name.strip()
    if not equals:
        raise LinkError(f"setting {text!r}, expected NAME=VALUE such as gyro_rate_hz=8000")
    return name, parse_value(name, value)


def parse_value(name: str, text: str) -> Value:
    """Parse a value of the setting `name`; its limits are not checked. Raises LinkError."""
    setting = known_setting(name)
    text = text.strip()
    if setting.kind == "text":
        text = _unquoted(text)
        check_text(name, text)
        return text
    if setting.kind == "mode":
        return parse_mode(name, text)
    if text.lower() in setting.choices:
        return float(setting.choices.index(text.lower()))
    if _is_percent(setting, text):
        raise LinkError(
            f"setting {name} got '1', expected 1.0 for all of it, or 0.01 for a percent: a 1 of Betaflight's "
            "means that, and `neuroflight board settings import` takes its diff"
        )
    try:
        number = float(text)
    except ValueError:
        expected = f"one of {', '.join(setting.choices)}" if setting.choices else "a number"
        raise LinkError(f"setting {name} got {text!r}, expected {expected}") from None
    if not abs(number) <= VALUE_MAX:  # NaN included
        raise LinkError(
            f"setting {name} got {text!r}, expected a number within its limits: docs/reference/settings.md"
        )
    return number


def _is_percent(setting: Setting, text: str) -> bool:
    """Return True for a bare 1 of a setting from 0 to 1: in Betaflight's units it may be 1 percent."""
    return setting.kind == "float" and (setting.low, setting.high) == (0.0, 1.0) and text == "1"


def _unquoted(text: str) -> str:
    """Remove quotes around a text; `-` is the empty one."""
    if text == NO_TEXT:
        return ""
    if len(text) >= 2 and text[0] == text[-1] == QUOTE:
        return text[1:-1]
    return text


def check_text(name: str, text: str) -> None:
    """Raise LinkError if no setting can hold the text."""
    if len(text) > SETTING_TEXT_BYTES or not all(" " <= c <= "~" for c in text):
        raise LinkError(
            f"setting {name} got {text!r}, expected at most {SETTING_TEXT_BYTES} characters of ASCII"
        )


def parse_mode(name: str, text: str) -> float:
    """Parse a mode range and pack it: `MODE AUX LOW HIGH`, optionally `and`, or `none`. Raises LinkError."""
    words = text.lower().split()
    if words == [UNUSED]:
        return 0.0
    also = words[-1:] == [AND]
    if len(words) != 4 + also or words[0] not in _MODES:
        modes = ", ".join(_MODES)
        raise LinkError(
            f"setting {name} got {text!r}, expected MODE AUX LOW HIGH such as 'arm aux1 1700 2100', "
            f"MODE one of {modes}, or none"
        )
    numbers = [_whole(word) for word in (words[1].removeprefix("aux"), words[2], words[3])]
    aux, low_us, high_us = numbers
    if not 1 <= aux <= AUX_COUNT:
        raise LinkError(f"setting {name} got {words[1]!r}, expected aux1 to aux{AUX_COUNT}")
    for us, word in ((low_us, words[2]), (high_us, words[3])):
        if not MODE_LOW_US <= us <= MODE_HIGH_US or (us - MODE_LOW_US) % MODE_STEP_US:
            raise LinkError(
                f"setting {name} got {word!r}, expected {MODE_LOW_US} to {MODE_HIGH_US} us "
                f"in steps of {MODE_STEP_US}"
            )
    if low_us > high_us:
        raise LinkError(f"setting {name} got {low_us} to {high_us} us, expected the lower end first")
    return float(ModeRange(_MODES[words[0]], aux, low_us, high_us, and_others=also).packed)


def _whole(word: str) -> int:
    return int(word) if word.isascii() and word.isdecimal() and len(word) <= 9 else -1


# --- Value to text ---------------------------------------------------------------------------------
def value_text(name: str, value: Value) -> str:
    """Return `value` as `parse_value` reads it; for an unknown setting, the number."""
    if isinstance(value, str):
        quoted = value == NO_TEXT or value[:1] in (" ", QUOTE) or value.endswith(" ")
        return f"{QUOTE}{value}{QUOTE}" if value and quoted else value or NO_TEXT
    setting = BY_NAME[name][1] if name in BY_NAME else None
    if setting is not None and setting.kind == "mode":
        return _mode_text(int(value))
    if setting is not None and value in range(len(setting.choices)):
        return setting.choices[int(value)]
    if setting is not None and setting.kind == "float" and value == 1.0:
        return "1.0"  # with a point, so that a ratio of 1 is not read as one percent
    return shortest(value)


def shortest(value: float) -> str:
    """Return the shortest decimal of `value` as a float32, as the firmware writes it: without an exponent."""
    if value == int(value):
        return str(int(value))
    wanted = struct.pack("<f", value)
    for digits in range(1, 10):
        text = f"{value:.{digits}g}"
        if struct.pack("<f", float(text)) == wanted:
            break
    return format(Decimal(text), "f")


def _mode_text(packed: int) -> str:
    if packed == 0:
        return UNUSED
    try:
        mode = Mode(packed & 0xFF)
    except ValueError:
        return str(packed)  # a mode that this tool does not know
    low_us, high_us = ((packed >> shift & 0x3F) * MODE_STEP_US + MODE_LOW_US for shift in (12, 18))
    return str(ModeRange(mode, (packed >> 8 & 0xF) + 1, low_us, high_us, bool(packed >> 24 & 1)))


def set_line(name: str, value: Value) -> str:
    """Return the line that `restore` and the firmware's command line take."""
    return f"set {name} = {value_text(name, value)}"


def same(name: str, one: Value, other: Value) -> bool:
    """Return True if both are the same stored value."""
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    if name in BY_NAME:
        one, other = as_stored(name, one), as_stored(name, other)
    return one == other or (math.isnan(one) and math.isnan(other))
