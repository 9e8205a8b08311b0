"""The page docs/dissertation.md: every experiment of the dissertation beside ours, from stored figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import groupby

from neuroflight.training.dissertation.conditions import conditions
from neuroflight.training.reproduction.conditions import COLUMNS, differences
from neuroflight.training.reproduction.experiments import ExperimentRow, Experiments, Figure
from neuroflight.training.reproduction.lookup import Value
from neuroflight.training.reproduction.stored import Kept, Result, RowResult, row_result
from neuroflight.training.reproduction.verdict import Judged, Verdict, bar
from neuroflight.training.results_page.markdown import table

CHAPTERS = {
    2: "Background",
    3: "Learning attitude control of the Iris (GymFC)",
    4: "A firmware with a neural network (Neuroflight)",
    5: "The aircraft's own digital twin (GymFC v2)",
    6: "Future work",
}
HEADINGS = ("", "dissertation", "bar", "ours", "verdict", "differs")
VERDICTS = (Verdict.SURPASSED, Verdict.REACHED, Verdict.NOT_REACHED)
SMALL_DECIMALS = 6  # numbers with more are written with a power of ten


def render(experiments: Experiments, kept: Mapping[str, Kept], pictures: str) -> str:
    """Return the page; pictures: the folder of pictures, as a link from the page finds it."""
    results = [row_result(row, kept) for row in experiments.rows]
    parts = [HEAD, _summary(results)]
    for chapter, rows in groupby(results, lambda result: result.row.chapter):
        parts.append(f"## Chapter {chapter}: {CHAPTERS[chapter]}" if chapter < 6 else f"## {CHAPTERS[6]}")
        filled = [each for each in rows if not each.row.hardware]
        for place in dict.fromkeys(result.row.place for result in filled):
            group = [result for result in filled if result.row.place == place]
            parts += _place(place, group, experiments, pictures)
    parts += [_alike(results, experiments), _hardware(experiments.rows)]
    return "\n\n".join(parts) + "\n"


def shown(value: Value | None, figure: Figure) -> str:
    """Return our value with the digits that it is judged by, or else three significant ones."""
    if value is None:
        return "not run"
    values = value if isinstance(value, tuple) else (value,)
    digits = None
    if figure.quote is not None:
        digits = figure.quote.decimals if figure.aim else figure.quote.digits
        if not figure.aim and any(values) and all(abs(each) < 10.0**-digits for each in values):
            digits = None  # the value would be rounded to 0
    return " / ".join(_digits(each, digits) for each in values)


def quoted(figure: Figure) -> str:
    """Return the dissertation's figure as it is printed there, with its confidence."""
    return figure.beside or "drawn" if figure.quote is None else figure.quote.text


def measured(result: Result) -> str:
    """Return our figure, with its confidence where there is one."""
    text = shown(result.value, result.figure)
    return text if result.margin is None else f"{text} ± {shown(result.margin, result.figure)}"


def barred(result: Result) -> str:
    """Return the bar that our figure is compared with; empty if there is none."""
    held = bar(result.figure, result.margin)
    return "" if held is None else str(held)


def judged(result: Result) -> str:
    """Return the verdict as it is printed."""
    told = Verdict.INPUT if result.figure.input else Verdict.UNLIKE if result.figure.unlike else None
    if result.judged is None:  # not measured: some are known all the same
        return "" if told is None else str(Judged(told, why=result.figure.unlike))
    return str(result.judged)


def differing(result: Result, row: ExperimentRow, experiments: Experiments) -> str:
    """Return the differences of our conditions from the dissertation's, if the figure has a bar."""
    if bar(result.figure) is None:
        return ""
    told = [str(each) for each in differences(row.name, result.figure, experiments, result.budget or "full")]
    if result.figure.metric:
        told.append(f"metric: {result.figure.metric}")
    return "; ".join(told)


def _digits(value: float, digits: int | None) -> str:
    if digits is not None and digits <= SMALL_DECIMALS:
        return f"{round(value, digits) + 0.0:,.{digits}f}"
    if value != 0.0 and (abs(value) < 1e-3 or abs(value) >= 1e7):
        return f"{value:.2e}"
    return f"{float(f'{value:.3g}'):,.12g}"


def _summary(results: Sequence[RowResult]) -> str:
    counted = Counter(result.verdict for result in results if result.row.figures)
    told = [f"{counted[verdict]} {verdict.value}" for verdict in VERDICTS]
    told += [f"{counted[None]} not run"] if counted[None] else []
    figures = Counter(
        each.judged.verdict for result in results for each in result.results if each.judged is not None
    )
    of_figures = ", ".join(f"{figures[verdict]} {verdict.value}" for verdict in VERDICTS)
    pictures = sum(not result.row.figures and not result.row.hardware for result in results)
    hardware = sum(bool(result.row.hardware) for result in results)
    return (
        f"{len(results)} rows: {', '.join(told)}; {counted[Verdict.UNLIKE]} not comparable, "
        f"{counted[Verdict.INPUT]} inputs, {counted[Verdict.TOLD] + pictures} pictures and figures without a "
        f"printed one, {hardware} that no run fills. A row counts as the worst of its figures. Of "
        f"{sum(figures[verdict] for verdict in VERDICTS)} figures with a verdict {of_figures}."
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
            differs = differing(each, result.row, experiments)
            ours = measured(each) + budget
            body.append((name, quoted(each.figure), barred(each), ours, judged(each), differs))
    if body:
        parts.append(table(*used_columns(HEADINGS, body)))
    for result in group:
        if result.row.why:
            head = f"{result.row.title.rpartition(': ')[2]}: " if len(group) > 1 else ""
            parts.append(f"{head}{result.row.why}")
    for name in dict.fromkeys(result.row.picture for result in group if result.row.picture):
        parts.append(f"![{place}]({pictures}/{name}.png)")
    names = " ".join(_names([result.row for result in group], experiments))
    parts.append(f"`neuroflight reproduce {names} --budget full`")
    return parts


def used_columns(headings: Sequence[str], body: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
    """Return a table without its empty columns."""
    kept = [i for i in range(len(headings)) if i == 0 or any(row[i] for row in body)]
    return [headings[i] for i in kept], [[row[i] for i in kept] for row in body]


def _common(titles: Sequence[str]) -> str:
    """Return what titles such as "rise time: PPO", "rise time: TRPO" begin with."""
    starts = {title.rpartition(": ")[0] for title in titles}
    return starts.pop() if len(starts) == 1 else "; ".join(titles)


def _names(rows: Sequence[ExperimentRow], experiments: Experiments) -> Sequence[str]:
    """Return the names of these rows on the command line: a beginning that no other has, or all."""
    parts = rows[0].name.split("-")
    for count in range(1, len(parts) + 1):
        start = "-".join(parts[:count])
        if set(experiments.chosen([start])) == set(rows):
            return [start]
    return [row.name for row in rows]


def _alike(results: Sequence[RowResult], experiments: Experiments) -> str:
    """Return a table of all rows with a verdict: the conditions that agree with the dissertation's."""
    body = []
    for result in results:
        held = [each for each in result.results if bar(each.figure) is not None]
        if not held:
            continue
        found = [
            differences(result.row.name, each.figure, experiments, each.budget or "full") for each in held
        ]
        cells = []
        for terms in COLUMNS.values():
            told = dict.fromkeys(str(each) for some in found for each in some if each.term in terms)
            cells.append("; ".join(told) or "yes")
        metrics = "; ".join(dict.fromkeys(each.figure.metric for each in held if each.figure.metric))
        verdict = "not run" if result.verdict is None else result.verdict.value
        body.append((result.row.name, *cells[:3], metrics or "yes", *cells[3:], verdict))
    headings = ("row", *list(COLUMNS)[:3], "metric", *list(COLUMNS)[3:], "verdict")
    known = conditions()
    stand_ins = [
        f"- {name}, in place of {each.of}: {each.differs}."
        for name, each in known.aircraft.items()
        if each.differs
    ]
    stand_ins += [f"- recipe {name}: {each.differs}." for name, each in known.recipes.items()]
    return "\n\n".join([ALIKE, "\n".join(stand_ins), table(headings, body, align="---")])


def _hardware(rows: Sequence[ExperimentRow]) -> str:
    body = [(row.place, row.title, row.hardware) for row in rows if row.hardware]
    return f"## What no run fills\n\n{table(('', '', 'why'), body, align='---')}"


ALIKE = """## Same conditions?

Rows with a verdict: what is not the same as in the dissertation's experiment, ours first. "yes": the same, or
not printed, or it does not apply. Aircraft and recipes that are not quite the dissertation's:"""

HEAD = """# The dissertation's experiments, run again

Written by `neuroflight reproduce --store` from the files in [results/dissertation/](results/dissertation/);
`neuroflight reproduce --check` tests whether it is up to date. Beside each figure that W. Koch printed
(*Flight Controller Synthesis via Deep Reinforcement Learning*, 2019) stands ours from the same experiment
in this project's simulator, host program or emulated board: other physics engine, other learner's code,
other random commands of the same distribution, as far as that is printed. Rates are in deg/s, roll / pitch
/ yaw; errors of ours are of the true rate. Tables and figures are numbered by their order in the source.

One rule for all figures. The margin is the printed confidence, or half of the last printed digit, whichever
is more, and with ours where that is told (the root of both squares); where none is printed, as much is
taken for it as for ours, of as many commands. *Reached*: worse than printed by no more than the margin on
any axis; this limit is the *bar*. *Surpassed*: better than printed by more than the margin on every axis; a
difference within it is a tie, and no win. *Not reached*: beyond the bar on the axes named; the reason
stands below. Where neither more nor less is better, the bar is the margin to both sides, and nothing is
surpassed. Ours is compared as it is shown, rounded to the decimals of the bar. *Input*: we set it to what
is printed, or fitted it to that. *Not comparable*: two things that are not the same. A ratio stands beside
the same ratio of printed figures, with the margin that follows from both. *Differs* tells in what ours was
made otherwise, first ours, then in brackets the dissertation's, as far as both are known (aircraft and
recipes: [below](#same-conditions)); where it is empty, nothing that is printed differs. (quick) marks
figures of the quick budget, a twentieth to a five-hundredth of the dissertation's steps: their verdicts say
little. What a row runs: `neuroflight reproduce --list ROW`.

The aircraft of chapters 3 and 4 are [iris-3.toml](../training/reproduction/iris-3.toml) and
[iris-4.toml](../training/reproduction/iris-4.toml), with their simulator's motors, which no such aircraft
has, held at the centre of mass. Chapter 5's is the [NF1](../sim/aircraft/nf1.toml), hung at its centre of
thrust."""
