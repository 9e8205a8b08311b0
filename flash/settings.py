"""A firmware's settings over MSP, by name: read, change, store."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from flash import requests
from flash.client import Client
from flash.requests import SettingInfo
from toolchain.contract import SETTING_TEXT_BYTES, SETTINGS, Msp, Setting
from toolchain.errors import LinkError

_STYLE = "rates_style"
VALUE_MAX = 2.0**32  # of any setting: a larger one fits neither of their types
_BY_NAME = {setting.name: (index, setting) for index, setting in enumerate(SETTINGS)}


def parse_change(text: str) -> tuple[str, float]:
    """Read NAME=VALUE, the value a number or, where a setting has a choice, its name: `filter1_kind=notch`.

    Raises LinkError for a setting that is unknown, and for a value that is none of it.
    """
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise LinkError(f"setting {text!r}, expected NAME=VALUE such as gyro_rate_hz=8000")
    setting = _setting(name)
    if value in setting.choices:
        return name, float(setting.choices.index(value))
    try:
        number = float(value)
    except ValueError:
        expected = f"one of {', '.join(setting.choices)}" if setting.choices else "a number"
        raise LinkError(f"setting {name} got {value!r}, expected {expected}") from None
    if not abs(number) <= VALUE_MAX:  # NaN included
        raise LinkError(
            f"setting {name} got {value!r}, expected a number within its limits; see docs/settings.md"
        )
    return name, number


class Settings:
    """The settings of the firmware behind a client."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._known: dict[str, tuple[int, SettingInfo]] = {}

    def info(self, name: str) -> SettingInfo:
        """What the firmware tells about the setting called `name`. Raises LinkError where it has none."""
        return self._find(name)[1]

    def get(self, name: str) -> float | str:
        """Its value, as it is stored or will be. Raises LinkError."""
        index, _ = self._find(name)
        return requests.setting_value(self._client.request(Msp.SETTING_GET, requests.setting_index(index)))

    def set(self, name: str, value: float | str) -> None:
        """Change it until the next boot, or for good once `save` was called.

        Another style of rates sets all rates to the defaults of that style.
        Raises LinkError for a value beyond its limits, and while the motors are armed.
        """
        index, info = self._find(name)
        if info.kind == "text":
            _check_text(name, str(value))
        else:
            _check_number(name, float(value), info)
        self._client.request(Msp.SETTING_SET, requests.setting_set(index, value, info.kind))
        if name == _STYLE:
            self._known.clear()  # rates have other limits now

    def save(self) -> None:
        """Store all as they are now. Raises LinkError when they do not go together or flash fails."""
        self._client.request(Msp.EEPROM_WRITE)

    def _find(self, name: str) -> tuple[int, SettingInfo]:
        if name not in self._known:
            guess = _BY_NAME[name][0] if name in _BY_NAME else 0  # in a firmware of this version
            first = self._query(guess)
            for index in range(first.count):
                if name in self._known:
                    break
                if index != guess:
                    self._query(index)
        if name not in self._known:
            raise LinkError(f"setting {name!r}: the firmware has none of that name; see docs/settings.md")
        return self._known[name]

    def _query(self, index: int) -> SettingInfo:
        told = self._client.request(Msp.SETTING_INFO, requests.setting_index(index))
        info = requests.setting_info(told)
        self._known[info.name] = index, info
        return info


def _check_number(name: str, value: float, info: SettingInfo) -> None:
    if info.low <= value <= info.high and not (info.whole and value != int(value)):
        return
    kind = "a whole number from " if info.whole else ""
    span = f"{kind}{info.low:g} to {info.high:g} {info.unit}".rstrip()
    raise LinkError(f"setting {name} got {value:g}, expected {span}")


def _check_text(name: str, text: str) -> None:
    if len(text) > SETTING_TEXT_BYTES or not all(" " <= c <= "~" for c in text):
        raise LinkError(
            f"setting {name} got {text!r}, expected at most {SETTING_TEXT_BYTES} characters of ASCII"
        )


def in_order(changes: Mapping[str, float]) -> dict[str, float]:
    """`changes` as they have to be set one by one: the style of rates, which sets them all, goes first."""
    return dict(sorted(changes.items(), key=lambda change: change[0] != _STYLE))


def as_stored(name: str, value: float) -> float:
    """`value` as the setting called `name` holds it: rounded to float32 where it is no whole number."""
    if _setting(name).kind != "float":
        return value
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def _setting(name: str) -> Setting:
    if name not in _BY_NAME:
        raise LinkError(f"setting {name!r} is unknown, expected one of docs/settings.md")
    return _BY_NAME[name][1]
