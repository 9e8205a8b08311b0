"""Writes the pages of docs/reference that the code knows: `python -m tests.reference`.

Commands come from the parsers of the command line, targets from the Makefile, settings and MSP from the
contract, boards from their table, keys of a training configuration from its dataclasses, whose comments are
the page's words.
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from neuroflight.cli.compare.compare import DEFAULT, SUITES
from neuroflight.cli.tree import COMMANDS, leaf_parser
from neuroflight.toolchain.boards.allocation import Allocation
from neuroflight.toolchain.boards.facts import Board
from neuroflight.toolchain.boards.gyro_kinds import FILES
from neuroflight.toolchain.boards.table import boards
from neuroflight.toolchain.boards.verdict import COMMON, Verdict, judge
from neuroflight.toolchain.files import write_text_if_changed
from neuroflight.toolchain.rendering.msp_page import msp_tables
from neuroflight.toolchain.rendering.settings_page import settings_table
from neuroflight.training.config.algorithms import ALGORITHMS
from neuroflight.training.config.randomization import Randomization
from neuroflight.training.config.selection import SelectionLimits
from neuroflight.training.config.training_config import OutputMap, TrainingConfig, WorldConfig
from neuroflight.training.tasks.registry import TASKS
from neuroflight.training.tasks.reward import REWARDS
from tests.conftest import ROOT

FOLDER = ROOT / "docs" / "reference"
WRITTEN = "This page is written from the code by `python -m tests.reference`."


# --- Commands ---------------------------------------------------------------------------------------
def commands_page() -> str:
    """Return the targets of make, and every command with its options."""
    parts = [
        "# Commands",
        WRITTEN + " `neuroflight` is `.venv/bin/neuroflight`; every command has `--help`.",
        "## make",
        _table("target", "what it does", *(targets())),
    ]
    noun = ""
    for words in COMMANDS:
        if words.split()[0] != noun:
            noun = words.split()[0]
            parts.append(f"## {noun}")
        leaf = leaf_parser(words)
        parts += _command(words, leaf)
        if words == "compare":
            others = [kind.names[0] for kind in dict.fromkeys(SUITES.values()) if DEFAULT not in kind.names]
            for name in others:
                parts += _command(f"{words} --suite {name}", leaf_parser(words, ["--suite", name]))
    return "\n\n".join(parts) + "\n"


def targets() -> list[tuple[str, str]]:
    """Return name and meaning of each target of the Makefile, as `make help` lists them."""
    return [
        (f"`make {name}`", _cell(meaning))
        for name, meaning in re.findall(
            r"^([a-z]+):.*?## (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE
        )
    ]


def _command(words: str, leaf: argparse.ArgumentParser) -> Iterator[str]:
    yield f"### neuroflight {words}" if " " in words else f"`neuroflight {words}`"
    if leaf.description:
        yield _sentence(_cell(leaf.description))
    rows = []
    for group in leaf._action_groups:
        shown = [
            action
            for action in group._group_actions
            if action.help != argparse.SUPPRESS and not isinstance(action, argparse._HelpAction)
        ]
        if shown and group.title not in ("positional arguments", "options"):
            rows.append((f"*{group.title}*", _cell(group.description or "")))
        rows += [_option(leaf, action) for action in shown]
    if rows:
        yield _table("argument", "what it does", *rows)
    if leaf.epilog:
        yield _sentence(_cell(leaf.epilog))


def _option(leaf: argparse.ArgumentParser, action: argparse.Action) -> tuple[str, str]:
    formatter = leaf._get_formatter()
    values = "" if action.nargs == 0 else formatter._format_args(action, _metavar(action))
    name = action.option_strings[-1] if action.option_strings else ""
    said = formatter._expand_help(action) if action.help else ""
    default = action.default
    known = default in (None, False, argparse.SUPPRESS) or isinstance(default, dict | list | tuple)
    if isinstance(default, Path):
        default = default.relative_to(ROOT) if default.is_relative_to(ROOT) else default
    if not known and action.nargs != 0 and "default" not in said:
        said = (
            f"{said}; default: {default:g}" if isinstance(default, float) else f"{said}; default: {default}"
        )
    needed = " (required)" if action.option_strings and action.required else ""
    return f"`{_cell(f'{name} {values}'.strip())}`{needed}", _cell(said.removeprefix("; "))


def _metavar(action: argparse.Action) -> str:
    if action.choices is not None and not isinstance(action.metavar, str):
        return "|".join(str(choice) for choice in action.choices)
    return str(action.metavar or action.dest.upper())


# --- Training ---------------------------------------------------------------------------------------
def training_page() -> str:
    """Return every key of a training configuration with its default."""
    config = (
        ("", TrainingConfig),
        ("output", OutputMap),
        ("world", WorldConfig),
        ("world.randomization", Randomization),
        ("selection", SelectionLimits),
    )
    parts = [
        "# Training configuration",
        f"{WRITTEN} How to use it: [Training](../guides/training.md). A configuration is a TOML file; "
        "`--set KEY=VALUE` sets one key.",
    ]
    for name, kind in config:
        parts += [f"## [{name}]" if name else "## The run", *_keys(f"{name}.".lstrip("."), kind)]
    named = (("task", TASKS), ("reward", REWARDS), ("algorithm", ALGORITHMS))
    for table, registry in named:
        for name, registered in registry.items():
            parts += [f'## {table} "{name}"', *_keys(f"{table}.", registered)]
    return "\n\n".join(parts) + "\n"


def _keys(prefix: str, kind: type) -> Iterator[str]:
    """Yield a class's words and the table of its fields."""
    for paragraph in inspect.cleandoc(kind.__doc__ or "").split("\n\n"):
        yield _sentence(" ".join(paragraph.split()))
    said = comments(kind)
    rows = []
    for field in dataclasses.fields(kind):
        make = field.default_factory
        if not field.init or (make is not dataclasses.MISSING and dataclasses.is_dataclass(make())):
            continue
        default = "required" if field.default is dataclasses.MISSING else _toml(field.default)
        rows.append((f"`{prefix}{field.name}`", default, _cell(said.get(field.name, ""))))
    if rows:
        yield _table("key", "default", "meaning", *rows)


def comments(kind: type) -> dict[str, str]:
    """Return the comment behind or above each field of a dataclass, its bases' too."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):
        if not dataclasses.is_dataclass(base):
            continue
        above: list[str] = []
        for line in inspect.getsource(base).splitlines():
            if comment := re.fullmatch(r" +# (.*)", line):
                above.append(comment[1])
            elif field := re.match(r"    (\w+): .*?(?:  # (.*))?$", line):
                said = field[2] or " ".join(above)
                found[field[1]] = said or found.get(field[1], "")
                above = []
    return found


def _toml(value: object) -> str:
    match value:
        case None:
            return "none"
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case float() | int():
            return f"{value:g}" if isinstance(value, float) else f"{value:,}"
        case tuple():
            return f"[{', '.join(_toml(each) for each in value)}]"
    return str(value)


# --- Pages written by hand around tables from the code ----------------------------------------------
TABLE = re.compile(r"(<!-- (\w+) -->\n\n).*?(\n\n<!-- end -->)", re.DOTALL)


def msp_page() -> str:
    """Return docs/reference/msp.md with its tables as the contract and the firmware have them."""
    return _filled("msp", msp_tables())


def settings_page() -> str:
    """Return docs/reference/settings.md with the table of all settings."""
    return _filled("settings", {"settings": settings_table()})


def _filled(name: str, tables: dict[str, str]) -> str:
    """Return a page with each of the tables in its place, which is marked there by its name."""
    page = (FOLDER / f"{name}.md").read_text()
    assert [found[2] for found in TABLE.finditer(page)] == list(tables), f"{name}.md marks other tables"
    return TABLE.sub(lambda found: found[1] + tables[found[2]] + found[3], page)


# --- Boards -----------------------------------------------------------------------------------------
def boards_page() -> str:
    """Return every board of the table: what it is, whether it is flown, and what it flies without."""
    verdicts = [judge(board) for board in boards().values()]
    flown = [verdict for verdict in verdicts if verdict.allocation is not None]
    missing = {verdict.board.name: _missing(verdict) for verdict in flown}
    rows = [
        (
            *(f"`{verdict.board.name}`", verdict.board.maker, _chips(verdict)),
            *(str(verdict.motors), verdict.log, _uarts(verdict.allocation), _turn(verdict.board)),
            _cell("; ".join(missing[verdict.board.name])),
        )
        for verdict in flown
    ]
    reasons: dict[str, list[str]] = {}
    for verdict in verdicts:
        if verdict.allocation is None:
            reasons.setdefault(verdict.fault, []).append(f"`{verdict.board.name}`")
    parts = [
        "# Boards",
        WRITTEN,
        f"Of the {len(verdicts)} boards with an STM32F722 that public configurations name, "
        f"{len(flown)} can be built for: `make firmware TARGET=NAME`. {sum(not m for m in missing.values())} "
        "of them fly with all that the firmware drives on any board: the last column is empty. No board's "
        f"{COMMON} is used.",
        "The code is the same for all; a description of the board in its image differs. What stands here "
        "follows from the configurations as of August 2026; each board was flown as an emulated one, hardly "
        "any in the air: the first of a kind is [brought up](../guides/board-bring-up.md), the turn of its "
        "gyro checked by hand. A board that is missing or wired otherwise: [Other "
        "boards](../guides/other-boards.md).",
        "## Not flown",
        _table("why", "boards", *((_cell(why), " ".join(names)) for why, names in reasons.items())),
        "## Flown",
        "Gyro chips: those that boards of the name may carry; with one in brackets it is flown if the image "
        "was built with its maker's file (`--gyro-file`: [the gyro "
        "chip](../guides/board-bring-up.md#the-gyro-chip)). Log: "
        "where it is kept. UARTs: of the receiver, of MSP, of the second serial port. Turned: by its maker "
        "(roll, pitch, yaw in degrees), so that the arrow points forward; the firmware knows it. Flies "
        "without: what other boards have and this one, or the firmware on it, has not.",
        _table(*("board", "maker", "gyro chips", "motors", "log", "UARTs", "turned", "flies without"), *rows),
    ]
    return "\n\n".join(parts) + "\n"


def _missing(verdict: Verdict) -> list[str]:
    """Return what a board flies without, but for what other columns say."""
    told = "gyro ", "log: no chip is told"
    return [line for line in verdict.without if not line.startswith(told)]


def _chips(verdict: Verdict) -> str:
    kinds = verdict.board.gyro_kinds
    return " ".join(f"({kind})" if kind in FILES else kind for kind in kinds)


def _turn(board: Board) -> str:
    return ", ".join(map(str, board.turn_deg)) if any(board.turn_deg) else ""


def _uarts(allocation: Allocation | None) -> str:
    assert allocation is not None
    lines = (allocation.receiver, allocation.msp, allocation.second)
    return " ".join("-" if line is None else str(line) for line in lines)


# --- Pages ------------------------------------------------------------------------------------------
PAGES: dict[str, Callable[[], str]] = {
    "boards": boards_page,
    "commands": commands_page,
    "settings": settings_page,
    "msp": msp_page,
    "training": training_page,
}


def _table(*cells: str | tuple[str, ...]) -> str:
    heads = [cell for cell in cells if isinstance(cell, str)]
    rows = [heads, ["---"] * len(heads), *(cell for cell in cells if not isinstance(cell, str))]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _cell(text: str) -> str:
    text = " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")
    return re.sub(r"(?<!\()docs/(\w[\w/-]*\.md)", lambda page: f"[{_title(page[0])}](../{page[1]})", text)


def _title(page: str) -> str:
    return (ROOT / page).read_text().partition("\n")[0].removeprefix("# ")


def _sentence(text: str) -> str:
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", ":")) else f"{text}."


def main() -> None:
    """Write the pages anew."""
    for name, make in PAGES.items():
        write_text_if_changed(FOLDER / f"{name}.md", make())


if __name__ == "__main__":
    main()
