"""A firmware's settings over MSP, by name: read, change, store; several together or none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from neuroflight.flash.link import requests
from neuroflight.flash.link.client import Client, NoAnswerError, RefusedError
from neuroflight.flash.link.requests import SettingInfo
from neuroflight.flash.settings.rules import broken_rules
from neuroflight.flash.settings.text import (
    BY_NAME,
    RATES,
    STYLE,
    Value,
    as_float32,
    as_stored,
    beside_style,
    check_text,
    default_of,
    known_setting,
    parse_change,
    same,
    shortest,
    value_text,
)
from neuroflight.toolchain.contract import SETTINGS, Msp, Setting
from neuroflight.toolchain.errors import LinkError

__all__ = ["Settings", "as_stored", "in_order", "parse_change"]

Kept = TypeVar("Kept", bound=Value)


@dataclass(frozen=True)
class Stored:
    """A setting of a firmware and its value."""

    name: str
    value: Value
    info: SettingInfo

    @property
    def default(self) -> Value:
        """Its default value."""
        return "" if self.info.kind == "text" else self.info.default

    @property
    def changed(self) -> bool:
        """True if it differs from its default."""
        return not same(self.name, self.value, self.default)


class Settings:
    """The settings of the firmware behind a client."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._known: dict[str, tuple[int, SettingInfo]] = {}

    def info(self, name: str) -> SettingInfo:
        """Return the firmware's description of a setting. Raises LinkError if it does not exist."""
        return self._find(name)[1]

    def names(self) -> tuple[str, ...]:
        """List the names of all settings, in the firmware's order."""
        count = self._query(0).count
        by_index = {index: name for name, (index, _) in self._known.items()}
        return tuple(by_index.get(index) or self._query(index).name for index in range(count))

    def get(self, name: str) -> Value:
        """Read a setting's value, as stored or changed since. Raises LinkError."""
        index, _ = self._find(name)
        return requests.setting_value(self._client.request(Msp.SETTING_GET, requests.setting_index(index)))

    def read(self, names: Iterable[str] = ()) -> list[Stored]:
        """Read those settings, or all, with their values. Raises LinkError."""
        return [Stored(name, self.get(name), self.info(name)) for name in tuple(names) or self.names()]

    def set(self, name: str, value: Value) -> None:
        """Change it until the next boot, or for good once `save` was called.

        Another style of rates sets all rates to the defaults of that style.
        Raises LinkError for a value beyond its limits, and while the motors are armed.
        """
        index, info = self._find(name)
        check_value(name, value, info)
        self._client.request(Msp.SETTING_SET, requests.setting_set(index, value, info.kind))
        if name == STYLE:
            for rate in RATES:
                self._known.pop(rate, None)  # they have other limits now

    def save(self) -> None:
        """Store all settings. Raises LinkError if they contradict each other or flash fails."""
        self._client.request(Msp.EEPROM_WRITE)

    def check(self, changes: Mapping[str, Value]) -> None:
        """Raise LinkError for a change that the firmware would refuse; changes nothing."""
        for name in in_order(changes):
            info = self.info(name)
            if STYLE in changes and name in RATES and name in BY_NAME:
                info = _as_told(beside_style(known_setting(name), float(changes[STYLE])))
            check_value(name, changes[name], info)

    def check_together(self, changes: Mapping[str, Value]) -> None:
        """Raise LinkError for changes known to contradict each other or other settings."""

        def read(name: str) -> Value:
            style = changes.get(STYLE)
            if name in RATES and isinstance(style, float | int) and style != self.get(STYLE):
                return default_of(beside_style(known_setting(name), style))
            return self.get(name)

        for broken in broken_rules(changes, read):
            raise LinkError(broken)

    def change(self, changes: Mapping[str, Value], *, save: bool = False) -> None:
        """Set them all, read them back and, with `save`, store them: all of them or none.

        When anything fails, those that were set get their values back. Raises LinkError.
        """
        self.check(changes)
        self.check_together(changes)
        affected = {*changes, *(RATES if STYLE in changes else ())}
        before = {name: self.get(name) for name in affected}
        try:
            for name, value in in_order(changes).items():
                self.set(name, value)
            self._verify(changes)
            if save:
                self._save_verified()
        except LinkError as error:
            raise LinkError(f"{error}; {self._put_back(before)}") from None
        except KeyboardInterrupt:
            self._put_back(before)
            raise

    def set_defaults(self, *, save: bool = False) -> None:
        """Set every setting to its default, at once, read all back and, with `save`, store them.

        When anything fails, all get their values back. Raises LinkError.
        """
        before = {stored.name: stored.value for stored in self.read()}
        try:
            self._reset()
            if save:
                self._save_verified()
        except LinkError as error:
            raise LinkError(f"{error}; {self._put_back(before)}") from None
        except KeyboardInterrupt:
            self._put_back(before)
            raise

    def _reset(self) -> None:
        self._client.request(Msp.SETTINGS_DEFAULT)
        self._known.clear()  # the rates have the limits of the default style
        for stored in self.read():
            if stored.changed:
                raise LinkError(
                    f"setting {stored.name} reads {value_text(stored.name, stored.value)} after all were set "
                    "to their defaults; check that nobody else changes settings meanwhile"
                )

    def _save_verified(self) -> None:
        try:
            self.save()
        except NoAnswerError as error:
            raise NoAnswerError(f"{error}; whether they are stored shows after a restart") from None

    def _verify(self, changes: Mapping[str, Value]) -> None:
        for name, value in changes.items():
            got = self.get(name)
            if not same(name, got, value):
                raise LinkError(
                    f"setting {name} reads {value_text(name, got)} after it was set, expected "
                    f"{value_text(name, value)}; check that nobody else changes settings meanwhile"
                )

    def _put_back(self, before: Mapping[str, Value]) -> str:
        """Restore all values; return a sentence about the result."""
        try:
            for name, value in in_order(before).items():
                self.set(name, value)
            self._verify(before)
        except LinkError:
            return "what was set before that stays until the next boot, nothing is stored"
        return "all settings are as they were"

    def _find(self, name: str) -> tuple[int, SettingInfo]:
        if name not in self._known:
            guess = BY_NAME[name][0] if name in BY_NAME else 0  # in a firmware of this version
            try:
                first = self._query(guess)
            except RefusedError:  # another version, with fewer settings
                guess, first = 0, self._query(0)
            for index in range(first.count):
                if name in self._known:
                    break
                if index != guess:
                    self._query(index)
        if name not in self._known:
            raise LinkError(f"setting {name!r}: the firmware has none of that name; `get` lists them")
        return self._known[name]

    def _query(self, index: int) -> SettingInfo:
        told = self._client.request(Msp.SETTING_INFO, requests.setting_index(index))
        info = requests.setting_info(told)
        self._known[info.name] = index, info
        return info


def _as_told(setting: Setting) -> SettingInfo:
    """Return the contract's `setting` as a firmware of this version describes it."""
    low, high = (as_stored(setting.name, limit) for limit in (setting.low, setting.high))
    return SettingInfo(len(SETTINGS), setting.name, setting.unit, low, high, setting.default, setting.kind)


def check_known(changes: Mapping[str, Value]) -> None:
    """Raise LinkError for changes of the defaults that a firmware of this version refuses."""
    style = float(changes.get(STYLE, known_setting(STYLE).default))
    for name, value in changes.items():
        check_value(name, value, _as_told(beside_style(known_setting(name), style)))
    for broken in broken_rules(changes, lambda name: default_of(beside_style(known_setting(name), style))):
        raise LinkError(broken)


def check_value(name: str, value: Value, info: SettingInfo) -> None:
    """Raise LinkError for a value outside the firmware's limits."""
    if info.kind == "text":
        check_text(name, str(value))
        return
    number = as_float32(float(value)) if info.kind == "float" else float(value)
    if info.low <= number <= info.high and not (info.whole and number != int(number)):
        return
    kind = "a whole number from " if info.whole else ""
    unit = "" if info.unit == "1" else f" {info.unit}"  # a ratio has none
    span = f"{kind}{shortest(info.low)} to {shortest(info.high)}{unit}".rstrip()
    raise LinkError(f"setting {name} got {number:g}, expected {span}")


def in_order(changes: Mapping[str, Kept]) -> dict[str, Kept]:
    """Sort `changes` into the order of setting them: the style of rates first, because it sets all rates."""
    return dict(sorted(changes.items(), key=lambda change: change[0] != STYLE))
