"""docs/dissertation.md: every experiment of the dissertation beside ours, from stored figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import groupby

from training.reproduction.experiments import Experiments, Figure, Row
from training.reproduction.lookup import Value
from training.reproduction.stored import Kept, Result, RowResult, row_result
from training.reproduction.verdict import Verdict
from training.results_page.markdown import table

CHAPTERS = {
    2: "Background",
    3: "Learning attitude control of the Iris (GymFC)",
    4: "A firmware with a neural network (Neuroflight)",
    5: "The aircraft's own digital twin (GymFC v2)",
    6: "Future work",
}
HEADINGS = ("", "dissertation", "ours", "")


def render(experiments: Experiments, kept: Mapping[str, Kept], pictures: str) -> str:
    """The page; pictures: the folder of pictures, as a link from the page finds it."""
    results = [row_result(row, kept) for row in experiments.rows]
    parts = [HEAD, _summary(results)]
    for chapter, rows in groupby(results, lambda result: result.row.chapter):
        parts.append(f"## Chapter {chapter}: {CHAPTERS[chapter]}" if chapter < 6 else f"## {CHAPTERS[6]}")
        filled = [each for each in rows if not each.row.hardware]
        for place, group in groupby(filled, lambda result: result.row.place):
            parts += _place(place, list(group), experiments, pictures)
    parts.append(_hardware(experiments.rows))
    return "\n\n".join(parts) + "\n"


def shown(value: Value | None, figure: Figure | None = None) -> str:
    """A value with as many digits as the dissertation prints of it, or three that count."""
    if value is None:
        return "not run"
    digits = figure.quote.digits if figure is not None and figure.quote is not None else None
    values = value if isinstance(value, tuple) else (value,)
    if digits is not None and any(values) and all(abs(each) < 10.0**-digits for each in values):
        digits = None  # nothing of them would be seen
    return " / ".join(_digits(each, digits) for each in values)


def quoted(figure: Figure) -> str:
    """The dissertation's figure as it prints it, with its confidence."""
    quote = figure.quote
    if quote is None:
        return figure.beside or "drawn"
    text = shown(quote.value, figure)
    return text if quote.margin is None else f"{text} ± {shown(quote.margin, figure)}"


def measured(result: Result) -> str:
    """Our figure, with its confidence where that is told."""
    text = shown(result.value, result.figure)
    return text if result.margin is None else f"{text} ± {shown(result.margin, result.figure)}"


def _digits(value: float, digits: int | None) -> str:
    if digits is not None:
        return f"{round(value, digits) + 0.0:,.{digits}f}"
    if value != 0.0 and (abs(value) < 1e-3 or abs(value) >= 1e7):
        return f"{value:.2e}"
    return f"{float(f'{value:.3g}'):,.12g}"


def _summary(results: Sequence[RowResult]) -> str:
    counted = Counter(result.verdict for result in results if result.row.figures)
    names = (
        (Verdict.SURPASSED, "surpassed"),
        (Verdict.REACHED, "reached"),
        (Verdict.NOT_REACHED, "not reached"),
    )
    told = [f"{counted[verdict]} {name}" for verdict, name in names]
    other = [result for result in results if not result.row.figures and not result.row.hardware]
    plain = counted[Verdict.TOLD] + len(other)
    hardware = sum(bool(result.row.hardware) for result in results)
    return (
        f"{len(results)} rows: {', '.join(told)}; {plain} pictures and figures without a better or worse, "
        f"{hardware} that no run fills. A row counts as the worst of its figures."
    )


def _place(place: str, group: Sequence[RowResult], experiments: Experiments, pictures: str) -> list[str]:
    titles = dict.fromkeys(result.row.title for result in group)
    title = titles.popitem()[0] if len(titles) == 1 else _common(list(titles))
    parts = [f"### {place}: {title}" if title else f"### {place}"]
    body = []
    for result in group:
        many = len(group) > 1 and len(result.row.figures) > 0
        for each in result.results:
            group_name = result.row.title.rpartition(": ")[2]
            told = many and not each.figure.what.startswith(group_name)
            name = f"{group_name}, {each.figure.what}" if told else each.figure.what
            budget = " (quick)" if each.budget == "quick" else ""
            judged = "" if each.judged is None else str(each.judged)
            body.append((name, quoted(each.figure), measured(each) + budget, judged))
    if body:
        parts.append(table(HEADINGS, body))
    for result in group:
        if result.row.why:
            head = f"{result.row.title.rpartition(': ')[2]}: " if len(group) > 1 else ""
            parts.append(f"{head}{result.row.why}")
    for name in dict.fromkeys(result.row.picture for result in group if result.row.picture):
        parts.append(f"![{place}]({pictures}/{name}.png)")
    names = " ".join(_names([result.row for result in group], experiments))
    parts.append(f"`neuroflight reproduce {names} --budget full`")
    return parts


def _common(titles: Sequence[str]) -> str:
    """What titles such as "rise time: PPO", "rise time: TRPO" begin with."""
    starts = {title.rpartition(": ")[0] for title in titles}
    return starts.pop() if len(starts) == 1 else "; ".join(titles)


def _names(rows: Sequence[Row], experiments: Experiments) -> Sequence[str]:
    """What stands for these rows on the command line: a beginning that no other row has, or their names."""
    parts = rows[0].name.split("-")
    for count in range(1, len(parts) + 1):
        start = "-".join(parts[:count])
        if set(experiments.chosen([start])) == set(rows):
            return [start]
    return [row.name for row in rows]


def _hardware(rows: Sequence[Row]) -> str:
    body = [(row.place, row.title, row.hardware) for row in rows if row.hardware]
    return f"## What no run fills\n\n{table(('', '', 'why'), body, align='---')}"


HEAD = """# The dissertation's experiments, run again

Written by `neuroflight reproduce --store` from the files in [results/dissertation/](results/dissertation/);
`neuroflight reproduce --check` tests whether it is up to date. Beside each figure that W. Koch printed
(*Flight Controller Synthesis via Deep Reinforcement Learning*, 2019) stands ours from the same experiment in
this project's simulator, host program or emulated board: other physics engine, other learner's code, other
random commands of the same distribution. Rates are in deg/s, roll / pitch / yaw. Tables and figures are
numbered by their order in the source.

*Surpassed*: better on every axis. *Reached*: no worse than the printed confidence or rounding allows; of an
effect, the same sign and at least half its size. *Not reached*: worse on the axes named; the reason stands
below. (quick) marks figures of the quick budget, a twentieth to a five-hundredth of the dissertation's
steps: their verdicts say little. What a row runs: `neuroflight reproduce --list ROW`.

The aircraft of chapters 3 and 4 are [iris-3.toml](../training/reproduction/iris-3.toml) and
[iris-4.toml](../training/reproduction/iris-4.toml), with their simulator's motors, which no such aircraft
has. Chapter 5's is the [NF1](../sim/aircraft/nf1.toml)."""
