"""Settings across an update: a file before, a comparison and what is put back after.

Settings lie in flash sectors of their own, which no update touches. A new version may still read them
otherwise, where it has others, or other limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from neuroflight.flash.link.client import Client
from neuroflight.flash.settings.text import Value, same, set_line, value_text
from neuroflight.flash.settings.values import Settings, in_order
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.files import write_text


@dataclass(frozen=True)
class Kept:
    """The changes of settings across an update."""

    restored: dict[str, Value]  # read differently by the new version, and set back
    unknown: dict[str, Value]  # missing in the new version
    refused: dict[str, str]  # refused by the new version, with the reason
    new: tuple[str, ...]  # missing in the old version; at their defaults

    @property
    def lines(self) -> list[str]:
        """Messages for the pilot, a sentence each."""
        told = []
        if self.restored:
            told.append(f"put back as they were: {', '.join(self.restored)}")
        told += [
            f"the new version knows no {name}; it was {value_text(name, value)}"
            for name, value in self.unknown.items()
        ]
        told += [f"{name} has another value now: {why}" for name, why in self.refused.items()]
        if self.new:
            told.append(f"new, at their defaults: {', '.join(self.new)}")
        return told


def read_settings(client: Client) -> dict[str, Value]:
    """Read all settings, as stored or changed since. Raises LinkError."""
    return {stored.name: stored.value for stored in Settings(client).read()}


def write_backup(path: Path, target: str, version: str, values: Mapping[str, Value]) -> None:
    """Write settings in the format of `neuroflight board settings dump`. Raises OSError."""
    head = f"# dump of {target} {version}: neuroflight board settings restore FILE"
    lines = [head, *(set_line(name, value) for name, value in in_order(values).items())]
    write_text(path, "\n".join(lines) + "\n")


def keep_settings(client: Client, before: Mapping[str, Value], now: Mapping[str, Value]) -> Kept:
    """Compare the settings as they are `now` with those `before`, and store again what differs."""
    settings = Settings(client)
    differ = {
        name: value for name, value in before.items() if name in now and not same(name, now[name], value)
    }
    refused: dict[str, str] = {}
    for name, value in in_order(differ).items():
        try:
            settings.check({name: value})
        except LinkError as error:
            refused[name] = str(error)
    restored = {name: value for name, value in differ.items() if name not in refused}
    if restored:
        try:
            settings.change(restored, save=True)
        except LinkError as error:
            refused |= dict.fromkeys(restored, str(error))
            restored = {}
    return Kept(
        restored=restored,
        unknown={name: value for name, value in before.items() if name not in now},
        refused=refused,
        new=tuple(name for name in now if name not in before),
    )
