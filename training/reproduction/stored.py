"""Stored figures of the rows: a small file for each step, with only what the rows read of its output."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from neuroflight.toolchain.files import replacing, write_text
from neuroflight.training.reproduction.experiments import (
    BUDGETS,
    Budget,
    ExperimentRow,
    Figure,
    ReproduceError,
    Source,
)
from neuroflight.training.reproduction.lookup import Value, find, ours, scaled
from neuroflight.training.reproduction.steps import Done
from neuroflight.training.reproduction.verdict import Judged, Verdict, judge
from neuroflight.training.results_page.stored_results import Stored, compact, read_results

WORST_FIRST = (Verdict.NOT_REACHED, Verdict.REACHED, Verdict.SURPASSED, Verdict.UNLIKE, Verdict.INPUT)
WIDTH_MAX, COLOURS = 1200, 200  # pixels and colours of a stored picture


@dataclass(frozen=True)
class Kept:
    """The figures of a step that rows read, by their paths in its output."""

    step: str
    budget: Budget
    command: str
    seconds: float
    figures: Mapping[str, Value]


@dataclass(frozen=True)
class Result:
    """A figure of a row with ours."""

    figure: Figure
    value: Value | None  # None: not measured yet
    margin: Value | None  # half the width of its 95 % interval, where that is told
    judged: Judged | None
    budget: Budget | None  # of the steps that it is from: the smaller, if they differ


@dataclass(frozen=True)
class RowResult:
    """A row with our figures."""

    row: ExperimentRow
    results: tuple[Result, ...]
    budgets: tuple[Budget, ...]  # of the steps that its figures are from
    commands: tuple[str, ...]
    seconds: float

    @property
    def verdict(self) -> Verdict | None:
        """The worst verdict of its figures that have a bar, else what they are; None if one is not
        measured."""
        found = {result.judged.verdict for result in self.results if result.judged}
        if not self.measured:
            return None
        return next((verdict for verdict in WORST_FIRST if verdict in found), Verdict.TOLD)

    @property
    def measured(self) -> bool:
        """True if every figure is measured."""
        return all(result.value is not None for result in self.results)


def keep(done: Done, rows: Iterable[ExperimentRow]) -> Kept:
    """Return the stored part of a step that has run. Raises ReproduceError if its output lacks a figure."""
    paths = {source.path for row in rows for source in sources(row) if source.step == done.step.name}
    try:
        figures = {path: find(done.output, path) for path in sorted(paths)}
    except ReproduceError as error:
        raise ReproduceError(f"{done.step.name}: {error}") from error
    return Kept(done.step.name, done.budget, done.command, done.seconds, figures)


def sources(row: ExperimentRow) -> tuple[Source, ...]:
    """Return the places of the figures of a row."""
    return tuple(source for figure in row.figures for source in figure.sources)


def row_result(row: ExperimentRow, kept: Mapping[str, Kept]) -> RowResult:
    """Return a row with the figures of the steps that are `kept`."""
    used = [kept[name] for name in row.steps if name in kept]
    return RowResult(
        row,
        tuple(_result(figure, kept) for figure in row.figures),
        tuple(budget for budget in BUDGETS if any(each.budget == budget for each in used)),
        tuple(each.command for each in used),
        sum(each.seconds for each in used),
    )


def _result(figure: Figure, kept: Mapping[str, Kept]) -> Result:
    values = [None if source is None else _value(source, kept) for source in figure.made_of]
    found = values[0]
    if found is None or any(
        source and value is None for source, value in zip(figure.made_of, values, strict=True)
    ):
        return Result(figure, None, None, None, None)
    value = ours(figure, found, *values[1:])
    width = None if figure.margin is None else _value(figure.margin, kept)
    margin = None if width is None else scaled(width, abs(figure.scale))
    if figure.mean and isinstance(margin, tuple):
        margin = sum(margin) / len(margin)  # of axes that may err together
    quick = any(kept[source.step].budget == "quick" for source in figure.sources if source.step in kept)
    return Result(figure, value, margin, judge(figure, value, margin), "quick" if quick else "full")


def _value(source: Source, kept: Mapping[str, Kept]) -> Value | None:
    step = kept.get(source.step)
    return step.figures.get(source.path) if step else None


def store(kept: Kept, folder: Path, picture: Path | None, pictures: Path) -> None:
    """Write the stored part of a step into `folder`, and its picture into `pictures`."""
    document = {
        "step": kept.step,
        "budget": kept.budget,
        "command": kept.command,
        "seconds": round(kept.seconds, 1),
        "figures": {path: _plain(value) for path, value in kept.figures.items()},
    }
    write_text(folder / f"{kept.step}.json", compact(document) + "\n")
    if picture is not None:
        pictures.mkdir(parents=True, exist_ok=True)
        with replacing(pictures / f"{kept.step}.png") as aside:
            _small(picture).save(aside, "PNG", optimize=True)


def _small(picture: Path) -> Image.Image:
    """Return a picture for a page: at most WIDTH_MAX wide, in COLOURS colours, a quarter of the bytes."""
    with Image.open(picture) as drawn:
        image = drawn.convert("RGB")
    if image.width > WIDTH_MAX:
        image = image.resize(
            (WIDTH_MAX, round(image.height * WIDTH_MAX / image.width)), Image.Resampling.LANCZOS
        )
    return image.quantize(COLOURS)


def read_stored(folder: Path) -> dict[str, Kept]:
    """Return the stored figures of `folder`, by step. Raises ResultsError naming a file that is damaged."""
    return {kept.step: kept for kept in map(_kept, read_results(folder, 0))}


def _kept(stored: Stored) -> Kept:
    budget, name = stored.text("budget"), stored.text("step")
    if budget not in BUDGETS or f"{name}.json" != stored.name:
        raise stored.error("budget, step", f"{budget}, {name}", "a budget, and the file's name")
    figures = stored.get("figures")
    if not isinstance(figures, dict):
        raise stored.error("figures", figures, "an object")
    found: dict[str, Value] = {}
    for path, value in figures.items():
        many = isinstance(value, list)
        found[path] = tuple(stored.numbers("figures", path)) if many else stored.number("figures", path)
    return Kept(name, budget, stored.text("command"), stored.number("seconds"), found)


def _plain(value: Value) -> float | list[float]:
    """Round to seven digits: more than any row prints, fewer than a command does."""
    if isinstance(value, tuple):
        return [float(f"{each:.7g}") for each in value]
    return float(f"{value:.7g}")
