"""The sections about studies on the page of results: sweeps whose policies were flown at equal thrust."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.training.results_page.markdown import number, table
from neuroflight.training.results_page.stored_results import Stored

VARIANT = "variant"
SIZES = "sizes"  # the study that is drawn too
PLOT = "sizes.png"  # its plot, in the folder of results


@dataclass(frozen=True)
class Point:
    """A network of the study."""

    name: str
    instructions: float
    fits: bool
    mae: float  # [deg/s]
    margin: float
    change: float  # |Δu| of the motors in 1 ms
    change_margin: float


def study_section(stored: Stored) -> str:
    """Return a row for each variant: its figures, their differences to the baseline's, and its cost."""
    if stored.get("complete") is not True:
        raise stored.error("complete", stored.get("complete"), "true: a study with all its runs")
    runs = stored.entries("runs")
    baseline = stored.text("baseline")
    first = next((run for run in runs if run.text("varied", VARIANT) == baseline), None)
    if first is None:
        raise stored.error("baseline", baseline, "one of its variants")
    name = stored.text("sweep")
    title, about = TEXTS.get(name, (f"Study {name}", ""))
    parts = [
        f"## {title}, {stored.text('aircraft', 'name')}",
        "\n".join(filter(None, (about, _conditions(stored)))),
        table(("", *HEADINGS), [_row(run, first) for run in runs]),
        table(("MAE / MSE / abs Δu", *_levels(first)), [_thrust_row(run) for run in runs]),
    ]
    if name == SIZES:
        parts.append(f"![error and change of the motors against instructions](results/{PLOT})")
    if large := [f"{run.text('varied', VARIANT)}: {run.text('unfit')}" for run in runs if run.get("unfit")]:
        parts.append(f"Too large for the board: {'; '.join(large)}.")
    return "\n\n".join(parts)


def drawn_points(stored: Stored) -> list[Point]:
    """Return the networks of a study of sizes whose instructions are known, by these; none of others."""
    if not stored.has("sweep") or stored.text("sweep") != SIZES:
        return []
    found = [
        Point(
            name=run.text("varied", VARIANT),
            instructions=run.number("outcome", "instructions"),
            fits=run.get("unfit") is None,
            mae=run.number("outcome", "mae", "mean"),
            margin=run.number("outcome", "mae", "margin"),
            change=run.number("outcome", "change", "mean"),
            change_margin=run.number("outcome", "change", "margin"),
        )
        for run in stored.entries("runs")
        if run.get("outcome", "instructions") is not None
    ]
    return sorted(found, key=lambda point: point.instructions)


def _conditions(stored: Stored) -> str:
    thrusts = ", ".join(f"{value:g}" for value in stored.get("validation", "thrust"))
    board = ""
    if stored.get("board") is not None:
        most, other = (stored.number("board", key) for key in ("control_task_cycles", "other_cycles"))
        board = (
            f"\nThe board's control task may take {most:,.0f} predicted cycles, {other:,.0f} of them beside "
            f"the policy's step."
        )
    return ABOUT.format(
        episodes=f"{stored.number('validation', 'episodes'):.0f}",
        task=stored.text("validation", "task"),
        seed=f"{stored.number('validation', 'seed'):.0f}",
        thrusts=thrusts,
        board=board,
    )


def _row(run: Stored, first: Stored) -> tuple[str, ...]:
    steps = run.number("outcome", "steps")
    return (
        run.text("varied", VARIANT),
        f"{run.number('outcome', 'mae', 'mean'):.2f} ± {run.number('outcome', 'mae', 'margin'):.2f}",
        _more(run, first, "mae"),
        number(run.number("outcome", "mse", "mean"), 1),
        _more(run, first, "mse"),
        number(run.number("outcome", "change", "mean"), 4),
        _count(run, "instructions"),
        _difference(run, first, "instructions"),
        _count(run, "predicted_cycles"),
        _count(run, "weights"),
        f"{steps / 1e6:.1f}",
        f"{run.number('outcome', 'training_seconds'):.0f}",
    )


def _more(run: Stored, first: Stored, name: str) -> str:
    if run.document is first.document:
        return ""
    ratio = run.number("outcome", name, "mean") / first.number("outcome", name, "mean")
    return f"{100 * (ratio - 1):+.1f}"


def _count(run: Stored, name: str) -> str:
    return "" if run.get("outcome", name) is None else number(run.number("outcome", name), 0)


def _difference(run: Stored, first: Stored, name: str) -> str:
    unknown = run.get("outcome", name) is None or first.get("outcome", name) is None
    if unknown or run.document is first.document:
        return ""
    return f"{run.number('outcome', name) - first.number('outcome', name):+,.0f}"


def _levels(run: Stored) -> list[str]:
    levels = run.entries("outcome", "thrusts")
    return ["closed" if each.get("asked") is None else f"{each.number('asked'):g}" for each in levels]


def _thrust_row(run: Stored) -> tuple[str, ...]:
    cells = []
    for each in run.entries("outcome", "thrusts"):
        mae, mse, change = (each.number(name, "mean") for name in ("mae", "mse", "change"))
        thrust, asked = each.number("thrust"), each.get("asked")
        note = "" if asked is not None and abs(thrust - asked) <= REACHED * asked else f" (at {thrust:.2f})"
        cells.append(f"{mae:.2f} / {mse:.0f} / {change:.4f}{note}")
    return (run.text("varied", VARIANT), *cells)


REACHED = 0.05  # deviation of a thrust from the wanted one below which the page does not mention it
HEADINGS = (
    "MAE",
    "more, %",
    "MSE",
    "more, %",
    "abs Δu",
    "instructions",
    "more",
    "cycles",
    "weights",
    "M steps",
    "trained, s",
)
ABOUT = """MAE, MSE and abs Δu are means over thrusts at rest of {thrusts} times the weight, or the least
that a policy can, {episodes} commands of {task} each (seed {seed}) with gyro noise; Δu is that of the motor
values in 1 ms; "more" is against the first row. ± is 95 % confidence over the commands; another seed of the
training moves a figure too. Instructions and predicted cycles are those of the policy's step on the
board.{board}"""
TEXTS = {
    "levers": (
        "Levers",
        "What each part of the recipe brings: the recipe, and the same with one thing taken away or\n"
        "changed. All are short runs of the same number of steps unless the row says another. Where the\n"
        "second table says at which thrust a row flew, the policy cannot give as little as was asked for:\n"
        "it buys its smaller error with thrust.",
    ),
    SIZES: (
        "What a policy costs and gives by size",
        "The recipe with networks of other sizes. All are short runs of the same number of steps.",
    ),
    "seeds": (
        "Seeds",
        "The shipped recipe, whole, with other seeds; the first row is the shipped policy.",
    ),
}
