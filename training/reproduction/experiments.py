"""The experiments as data: rows of figures beside the dissertation's, and the commands that measure ours.

`experiments.toml` has both, and patterns of them (see `patterns`). A step is one `neuroflight` command for
each budget; it may use the folders of other steps, which then come first. A row is a table or a figure of the
dissertation, or a part of one: its figures name a quote, and where in a step's output ours stands (see
`lookup`).
"""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.strict_toml import StrictTable
from neuroflight.training.dissertation.quotes import QuoteError
from neuroflight.training.reproduction.patterns import PatternError, expanded
from neuroflight.training.reproduction.quoted import Quoted, quoted

FILE = Path(__file__).with_name("experiments.toml")
Budget = Literal["quick", "full"]
BUDGETS: tuple[Budget, ...] = ("quick", "full")
NOUNS = ("aircraft", "dyno", "image", "log", "policy")  # first words of commands that have two
LEADING = {"--suite": 2, "--one": 1, "--all": 1}  # options that make another command of it, with their values
OUT, PLOT = "out", "plot"  # in braces in a command: the step's own folder, and its picture
FOLDER = re.compile(r"\{([\w.-]+)\}")
POLICIES = re.compile(r"\{([\w.-]+)/\*\}")  # of all seeds that a step trains
BY_BUDGET = re.compile(r"<([^<>|]*)\|([^<>|]*)>")
ROWS_MAX, FIGURES_MAX, STEPS_MAX = 400, 60, 200
AIMS = ("lower", "higher", "near")  # or "to NUMBER"
YES = {"yes": True, "no": False}
OF_A_ROW = ("title", "picture", "input", "unlike", "hardware", "why")  # keys; all others are figures
OF_AN_INTERVAL = ("value", "mean")  # keys that have one beside them
TARGET = re.compile(r"to (-?\d+(?:\.\d+)?)")


def command(words: Sequence[str]) -> tuple[str, Sequence[str]]:
    """Split words into the command, with the options right behind it, and the words behind these."""
    count = 2 if words[0] in NOUNS else 1
    while count < len(words) and words[count] in LEADING:
        count += LEADING[words[count]]
    return " ".join(words[:count]), words[count:]


class ReproduceError(NeuroflightError):
    """A row that is unknown, a step that failed, or stored figures that are damaged."""


@dataclass(frozen=True)
class Step:
    """A command that measures something."""

    name: str
    quick: str  # words after `neuroflight`, without --json
    full: str

    def text(self, budget: Budget) -> str:
        """Return what a user types after `neuroflight`, with folders still in braces."""
        return self.full if budget == "full" else self.quick

    def words(self, budget: Budget) -> list[str]:
        """Return the words of `text`."""
        return shlex.split(self.text(budget))

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of the steps whose folders the command uses."""
        found = [name for text in (self.quick, self.full) for name in FOLDER.findall(text)]
        return tuple(name for name in dict.fromkeys(found) if name not in (OUT, PLOT))

    @property
    def draws(self) -> bool:
        """True if the command draws a picture."""
        return f"{{{PLOT}}}" in self.full


@dataclass(frozen=True)
class Source:
    """The place of one of our figures: a step, and a path in its output."""

    step: str
    path: str  # in the JSON that the step's command prints, see `lookup`

    @property
    def margin(self) -> Source:
        """The place of half the width of its 95 % interval."""
        stem, dot, last = self.path.rpartition(".")
        beside = "margin" if last in OF_AN_INTERVAL else f"margin_95.{last}"
        return Source(self.step, f"{stem}{dot}{beside}")


@dataclass(frozen=True)
class Figure:
    """A figure of the dissertation and ours."""

    what: str
    quote: Quoted | None  # None: the dissertation only draws it, or has what `beside` says
    beside: str  # what it has in place of a figure; empty: a drawing
    ours: Source
    margin: Source | None  # half the width of its 95 % interval
    against: Source | None  # given: ours is the change from that, in %
    times: Source | None  # given: ours is multiplied by that
    per: Source | None  # given: ours is divided by that
    scale: float
    mean: bool  # of its axes
    aim: str  # what is better: one of AIMS, or "to NUMBER": the nearer to it; empty: it has no verdict
    input: bool  # ours was set to the quote
    unlike: str  # why the two cannot be compared
    metric: str  # how ours is measured otherwise

    @property
    def sources(self) -> tuple[Source, ...]:
        """The places of all numbers that it is computed from."""
        return tuple(source for source in (*self.made_of, self.margin) if source is not None)

    @property
    def made_of(self) -> tuple[Source | None, ...]:
        """The places of our value and of those it is compared with, multiplied by and divided by."""
        return self.ours, self.against, self.times, self.per


@dataclass(frozen=True)
class ExperimentRow:
    """A table or figure of the dissertation, or a part of one."""

    name: str
    place: str  # "Table 3.9"
    title: str
    figures: tuple[Figure, ...]
    picture: str | None  # the step that draws it
    hardware: str  # why no simulation can fill it; empty for all others
    why: str  # what keeps ours from reaching it, where it does not

    @property
    def chapter(self) -> int:
        """The chapter of the dissertation."""
        return int(self.name.partition(".")[0])

    @property
    def steps(self) -> tuple[str, ...]:
        """Names of the steps that it needs itself."""
        names = [source.step for figure in self.figures for source in figure.sources]
        names += [self.picture] if self.picture else []
        return tuple(dict.fromkeys(names))


@dataclass(frozen=True)
class Experiments:
    """All rows, and the steps that they need."""

    rows: tuple[ExperimentRow, ...]
    steps: Mapping[str, Step]

    def chosen(self, names: Sequence[str]) -> tuple[ExperimentRow, ...]:
        """Return the rows that are named; "3" or "3.9" stands for all that begin with it. None named: all.

        Raises ReproduceError naming one that is unknown.
        """
        wanted = [name.lower().removeprefix("table ").removeprefix("figure ") for name in names]
        for name in wanted:
            if not any(_begins(row.name, name) for row in self.rows):
                places = ", ".join(dict.fromkeys(row.name.partition("-")[0] for row in self.rows))
                raise ReproduceError(f"row {name[:60]!r}: not there, expected one of: {places}; see --list")
        return tuple(
            row for row in self.rows if not wanted or any(_begins(row.name, name) for name in wanted)
        )

    def plan(self, rows: Iterable[ExperimentRow]) -> tuple[Step, ...]:
        """Return the steps of rows, each after those that it needs."""
        found: dict[str, Step] = {}
        for row in rows:
            for name in row.steps:
                self._add(name, found)
        return tuple(found.values())

    def _add(self, name: str, found: dict[str, Step]) -> None:
        if name not in found:
            for needed in self.steps[name].needs:
                self._add(needed, found)
            found[name] = self.steps[name]


def _begins(name: str, start: str) -> bool:
    return name == start or (name.startswith(start) and name[len(start)] in ".-")


@cache
def experiments() -> Experiments:
    """Return the experiments of `experiments.toml`. Raises ReproduceError naming what is wrong in it."""
    return parse(FILE.read_text(), FILE.name)


def parse(text: str, where: str) -> Experiments:
    """Parse experiments from TOML. Raises ReproduceError if a row names an unknown step or quote."""
    try:
        document = expanded(tomllib.loads(text))
    except PatternError as error:
        raise ReproduceError(f"{where}: {error}") from None
    table = StrictTable(document, where, ReproduceError)
    steps = _steps(table.table("steps"))
    _check_order(steps, where)
    of_rows = table.table("rows")
    if not 1 <= len(of_rows.names()) <= ROWS_MAX:
        raise ReproduceError(f"{where}: {len(of_rows.names())} rows, expected 1 to {ROWS_MAX}")
    rows = tuple(_row(name, of_rows.table(name), steps) for name in of_rows.names())
    table.finish()
    used = {name for row in rows for name in row.steps}
    used |= {needed for step in steps.values() for needed in step.needs}
    for name in steps:
        if name not in used:
            raise ReproduceError(f"{where}: steps.{name}: no row and no other step needs it; leave it out")
    return Experiments(rows, steps)


def _steps(table: StrictTable) -> Mapping[str, Step]:
    names = table.names()
    if not 1 <= len(names) <= STEPS_MAX:
        raise ReproduceError(f"{len(names)} steps, expected 1 to {STEPS_MAX}")
    texts = {name: " ".join(table.lines(name)) for name in names}
    by_budget = [{name: _of_budget(text, i) for name, text in texts.items()} for i in (1, 2)]

    def command(name: str, of: Mapping[str, str]) -> str:
        return POLICIES.sub(lambda found: _policies(found[1], of.get(found[1], "")), of[name])

    table.finish()
    return {name: Step(name, *(command(name, of) for of in by_budget)) for name in names}


def _of_budget(text: str, index: int) -> str:
    """Return a command in one line, with those words of `<quick|full>` that the index chooses."""
    return " ".join(BY_BUDGET.sub(lambda found: found[index], text).split())


def _policies(step: str, text: str) -> str:
    """Return the policies that the training `text` of a step leaves, one for each seed; a single one lies in
    the step's own folder."""
    first, count = (
        int(found[1]) if (found := re.search(rf"--{option} (\d+)", text)) else 1
        for option in ("seed", "seeds")
    )
    places = [""] if count == 1 else [f"seed-{seed}/" for seed in range(first, first + count)]
    return " ".join(f"{{{step}}}/{place}policy.onnx" for place in places)


def _check_order(steps: Mapping[str, Step], where: str) -> None:
    """Raise ReproduceError if a step needs an unknown one, or itself by way of others."""

    def follow(name: str, path: tuple[str, ...]) -> None:
        if name not in steps:
            raise ReproduceError(f"{where}: steps.{path[-1]}: needs {{{name}}}, which is no step")
        if name in path:
            raise ReproduceError(f"{where}: steps.{name}: needs itself: {' -> '.join((*path, name))}")
        for needed in steps[name].needs:
            follow(needed, (*path, name))

    for name in steps:
        follow(name, ())


def _row(name: str, table: StrictTable, steps: Mapping[str, Step]) -> ExperimentRow:
    place, parted, title = table.text("title").partition(": ")
    if not parted:
        raise table.error("title", f"got {place!r}, expected PLACE: TITLE")
    if not re.fullmatch(r"[2-6]\.[\w.]+(-[\w.-]+)?", name):
        raise table.error("", f"got {name!r}, expected such as 3.9 or 3.9-ppo")
    picture = table.text("picture", "") or None
    if picture is not None and (picture not in steps or not steps[picture].draws):
        raise table.error("picture", f"got {picture!r}, expected a step whose command has {{plot}}")
    hardware = table.text("hardware", "")
    why = " ".join(table.lines("why")) if table.has("why") else ""
    return ExperimentRow(name, place, title, tuple(_figures(table, steps)), picture, hardware, why)


def _figures(table: StrictTable, steps: Mapping[str, Step]) -> Iterator[Figure]:
    given, unlike = table.choice("input", YES, "no"), table.text("unlike", "")
    names = [name for name in table.names() if name not in OF_A_ROW]
    fewest = 0 if table.has("picture") or table.has("hardware") else 1
    most = 0 if table.has("hardware") else FIGURES_MAX
    if not fewest <= len(names) <= most:
        raise table.error("title", f"{len(names)} figures below it, expected {fewest} to {most}")
    for name in names:
        entry = table.table(name)
        quote = _quote(entry)
        aim = entry.text("aim", "")
        if aim and aim not in AIMS and not TARGET.fullmatch(aim):
            raise entry.error("aim", f"got {aim!r}, expected one of: {', '.join(AIMS)}, or 'to NUMBER'")
        ours = _source(entry, "ours", steps)
        against, times, per = (
            _source(entry, key, steps) if entry.has(key) else None for key in ("against", "times", "per")
        )
        figure = Figure(
            what=entry.text("what", name),
            quote=quote,
            beside=entry.text("beside", ""),
            ours=ours,
            margin=ours.margin if entry.choice("margin", YES, "no") else None,
            against=against,
            times=times,
            per=per,
            scale=entry.number("scale", -1e12, 1e12, 1.0),
            mean=entry.choice("mean", YES, "no"),
            aim=aim,
            input=given and quote is not None,
            unlike=entry.text("unlike", unlike) if quote is not None and not aim else "",
            metric=entry.text("metric", ""),
        )
        if quote is None and aim:
            raise entry.error("aim", "there is no quote to reach")
        if quote is not None and figure.beside:
            raise entry.error("beside", "there is a quote as well; keep one")
        if quote is not None and [bool(aim), figure.input, bool(figure.unlike)].count(True) != 1:
            raise entry.error("quote", "expected one of: an aim, unlike = 'why', or a row of input = 'yes'")
        entry.finish()
        yield figure


def _quote(entry: StrictTable) -> Quoted | None:
    """Return the dissertation's figure, or the ratio of two that it prints; None if the entry quotes none."""
    if not entry.has("quote"):
        return None
    try:
        quote = quoted(entry.text("quote"))
        other = quoted(entry.text("quote_per")) if entry.has("quote_per") else None
        if entry.choice("mean", YES, "no"):
            quote, other = quote.mean, other.mean if other else None
        return quote.rounded if other is None else quote.over(other).rounded
    except (QuoteError, ValueError) as error:
        raise entry.error("quote", f"{error}") from None


def _source(table: StrictTable, key: str, steps: Mapping[str, Step]) -> Source:
    step, _, path = table.text(key).partition(" ")
    if step not in steps or not path:
        raise table.error(key, f"got {step!r}, expected a step's name and a path in its output")
    return Source(step, path.strip())
