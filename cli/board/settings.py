"""`neuroflight board settings` get, set, diff, dump, restore, save, defaults."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.board.state import OnPort, connect, started_anew
from neuroflight.cli.options import Json
from neuroflight.cli.questions import confirm
from neuroflight.cli.report import Account, print_json, print_table
from neuroflight.cli.requests import Argument, Option
from neuroflight.toolchain.contract import AT_ONCE
from neuroflight.toolchain.errors import LinkError

if TYPE_CHECKING:
    from neuroflight.flash.settings.text import Value
    from neuroflight.flash.settings.values import Stored


Save = Annotated[bool, Option(None, "store them as well")]
Yes = Annotated[bool, Option(None, "do not ask")]


def when_flown(names: Iterable[str], *, saved: bool) -> str:
    """Tell when the firmware flies changes of the named settings, and what becomes of unsaved ones."""
    from neuroflight.flash.settings.text import BY_NAME

    later = "from the next boot on" if saved else "after `save` and a restart"
    at_once = {name in BY_NAME and BY_NAME[name][1].at_once for name in names}
    if at_once == {True}:
        told = "flown at once"
    elif at_once == {True, False}:
        told = f"{AT_ONCE} are flown at once, others {later}"
    else:
        told = f"flown {later}"
    return told if saved else f"{told}; a restart without `save` forgets them"


@dataclass(frozen=True, kw_only=True)
class Get(OnPort):
    """A request for settings with their limits and defaults."""

    names: Annotated[tuple[str, ...], Argument("NAME", "of settings; all without")] = ()
    json: Json = False

    def run(self) -> int:
        """Print settings with their limits and defaults."""
        from neuroflight.flash.settings.text import BY_NAME, value_text
        from neuroflight.flash.settings.values import Settings

        with connect(self.port) as client:
            found = Settings(client).read(dict.fromkeys(self.names))
        if self.json:
            print_json({stored.name: _plain(stored.name, stored.value) for stored in found})
            return 0
        rows = [
            (
                stored.name,
                value_text(stored.name, stored.value),
                value_text(stored.name, stored.default),
                _span(stored),
                stored.info.unit,
                BY_NAME[stored.name][1].meaning if stored.name in BY_NAME else "",
            )
            for stored in found
        ]
        heads = ("setting", "value", "default", "range", "unit", "meaning")
        print_table("", [heads, *rows], numbers=())
        return 0


def _plain(name: str, value: Value) -> str | int | float:
    """Return a value as JSON data: numbers as numbers, choices and mode ranges as their texts."""
    from neuroflight.flash.settings.text import value_text

    if isinstance(value, str):
        return value
    text = value_text(name, value)
    try:
        number = float(text)
    except ValueError:
        return text
    return int(number) if number == int(number) else number


def _span(stored: Stored) -> str:
    from neuroflight.flash.settings.text import BY_NAME, shortest

    info = stored.info
    if stored.name in BY_NAME and (choices := BY_NAME[stored.name][1].choices):
        return ", ".join(choices)
    if info.kind == "mode":
        return "MODE AUX LOW HIGH, or none"
    span = f"{shortest(info.low)} to {shortest(info.high)}"
    return span if info.kind != "text" else f"{span} characters"


@dataclass(frozen=True, kw_only=True)
class Set(OnPort):
    """A request to change settings."""

    changes: Annotated[tuple[str, ...], Argument("NAME=VALUE", 'such as mode1="arm aux1 1700 2100"')]
    save: Save = False
    reboot: Annotated[bool, Option(None, "with --save: start anew, to fly them")] = False
    json: Json = False

    def run(self) -> int:
        """Change settings, all of them or none."""
        from neuroflight.flash.settings.text import STYLE, parse_setting
        from neuroflight.flash.settings.values import Settings

        if self.reboot and not self.save:
            raise LinkError("--reboot without --save forgets what is set; give both")
        changes: dict[str, Value] = {}
        for text in self.changes:
            name, value = parse_setting(text)
            if name in changes:
                raise LinkError(f"setting {name} is given twice, expected once")
            changes[name] = value
        with connect(self.port) as client:
            Settings(client).change(changes, save=self.save)
        told = f"{_count(changes)} set"
        if STYLE in changes:
            told += "; a new style of rates sets the other rates to its defaults"
        told += f"{' and stored' if self.save else ''}; {when_flown(changes, saved=self.save)}"
        if self.reboot:
            told += f"\n{started_anew(self.port)}"
        return Account(self.json).end(changed(changes, stored=self.save) | {"rebooted": self.reboot}, told)


def changed(changes: Mapping[str, Value], *, stored: bool) -> dict[str, Any]:
    """Return changes of settings as JSON data."""
    return {"changed": {name: _plain(name, value) for name, value in changes.items()}, "stored": stored}


def _count(changes: object) -> str:
    count = len(changes) if isinstance(changes, dict | list) else 0
    return "1 setting" if count == 1 else f"{count} settings"


@dataclass(frozen=True, kw_only=True)
class Diff(OnPort):
    """A request for the settings that differ from their defaults."""

    json: Json = False

    def run(self) -> int:
        """Print the settings that differ from their defaults."""
        return _print_lines(self, "diff", lambda stored: stored.changed)


@dataclass(frozen=True, kw_only=True)
class Dump(OnPort):
    """A request for all settings."""

    json: Json = False

    def run(self) -> int:
        """Print all settings."""
        return _print_lines(self, "dump", lambda stored: True)


def _print_lines(asked: Diff | Dump, name: str, wanted: Callable[[Stored], bool]) -> int:
    from neuroflight.flash.board.info import version_of
    from neuroflight.flash.link import messages
    from neuroflight.flash.settings.text import set_line
    from neuroflight.flash.settings.values import Settings, in_order
    from neuroflight.toolchain.contract import Msp

    with connect(asked.port) as client:
        board = messages.board_info(client.request(Msp.BOARD_INFO))
        version = version_of(client)
        found = {stored.name: stored.value for stored in Settings(client).read() if wanted(stored)}
    if asked.json:
        print_json({name: _plain(name, value) for name, value in found.items()})
        return 0
    print(f"# {name} of {board.target} {version}: neuroflight board settings restore FILE")
    for setting, value in in_order(found).items():
        print(set_line(setting, value))
    return 0


@dataclass(frozen=True, kw_only=True)
class Restore(OnPort):
    """A request to set and store the settings of a file."""

    file: Annotated[Path, Argument("FILE", "as printed by dump or diff")]
    keep: Annotated[bool, Option(None, "leave what the file does not name as it is")] = False
    json: Json = False

    def run(self) -> int:
        """Set the settings of a file, check and store them: all or nothing."""
        from neuroflight.flash.settings.files import read_file, restored
        from neuroflight.flash.settings.values import Settings

        lines = read_file(self.file)
        with connect(self.port) as client:
            settings = Settings(client)
            changes = restored(settings, self.file, lines, keep=self.keep)
            settings.change(changes, save=True)
        told = f"{_count(lines)} read, {_count(changes)} changed, all stored"
        document = {"file": str(self.file), "read": len(lines), **changed(changes, stored=True)}
        return Account(self.json).end(document, f"{self.file}: {told}; {when_flown(changes, saved=True)}")


@dataclass(frozen=True, kw_only=True)
class Store(OnPort):
    """A request to store all settings."""

    json: Json = False

    def run(self) -> int:
        """Store all settings."""
        from neuroflight.flash.settings.text import BY_NAME
        from neuroflight.flash.settings.values import Settings

        with connect(self.port) as client:
            Settings(client).save()
        return Account(self.json).end({"stored": True}, f"settings stored; {when_flown(BY_NAME, saved=True)}")


@dataclass(frozen=True, kw_only=True)
class Defaults(OnPort):
    """A request to set every setting to its default."""

    yes: Yes = False
    save: Save = False
    json: Json = False

    def run(self) -> int:
        """Set every setting to its default, if the user is sure."""
        from neuroflight.flash.settings.text import BY_NAME
        from neuroflight.flash.settings.values import Settings

        with connect(self.port) as client:
            confirm(self.yes, f"set every setting of {client.name} to its default", "nothing is changed")
            Settings(client).set_defaults(save=self.save)
        told = f"every setting has its default now{', stored' if self.save else ''}"
        told = f"{told}; {when_flown(BY_NAME, saved=self.save)}"
        return Account(self.json).end({"defaults": True, "stored": self.save}, told)
