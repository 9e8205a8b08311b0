"""Stored figures of the rows: a small file for each step, with only what the rows read of its output."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from neuroflight.toolchain.files import file_size, replacing, write_text
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
from neuroflight.training.results_page.stored_results import compact

FILE_BYTES_MAX = 1 << 20
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
    """Return the stored figures of `folder`, by step. Raises ReproduceError naming a file that is damaged."""
    return {kept.step: kept for kept in (_read(path) for path in sorted(folder.glob("*.json")))}


def _read(path: Path) -> Kept:
    if file_size(path) > FILE_BYTES_MAX:
        raise ReproduceError(f"{path}: {file_size(path)} bytes, expected at most {FILE_BYTES_MAX}")
    try:
        document = json.loads(path.read_text())
        figures = {str(key): _given(value) for key, value in document["figures"].items()}
        budget = document["budget"]
        if budget not in BUDGETS or document["step"] != path.stem:
            raise ValueError(f"budget {budget!r}, step {document['step']!r}")
        return Kept(path.stem, budget, str(document["command"]), float(document["seconds"]), figures)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ReproduceError(
            f"{path}: not the stored figures of a step ({error}); make it anew with reproduce --store"
        ) from error


def _plain(value: Value) -> float | list[float]:
    """Round to seven digits: more than any row prints, fewer than a command does."""
    if isinstance(value, tuple):
        return [float(f"{each:.7g}") for each in value]
    return float(f"{value:.7g}")


def _given(value: Any) -> Value:  # noqa: ANN401 - any JSON value
    values = value if isinstance(value, list) else [value]
    for each in values:
        if isinstance(each, bool) or not isinstance(each, int | float) or not math.isfinite(each):
            raise ValueError(f"figure {str(value)[:40]}")
    return tuple(float(each) for each in values) if isinstance(value, list) else float(value)
