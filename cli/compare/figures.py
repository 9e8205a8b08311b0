"""Figures of controllers on the same commands: side by side, alone by axis, averaged; tables and JSON."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from neuroflight.cli.compare.commanded import flight_note
from neuroflight.cli.output import plain
from neuroflight.cli.report import Table, difference, interval, with_margin
from neuroflight.toolchain.contract import AXES

if TYPE_CHECKING:
    from neuroflight.sim.analysis.confidence import Mean
    from neuroflight.training.evaluation.comparison import Entry
    from neuroflight.training.evaluation.controllers import Conditions
    from neuroflight.training.evaluation.envelope import Envelope
    from neuroflight.training.evaluation.evaluation import Evaluation

BY_AXIS = ("mae", "mse", "rest_early", "rest_late", "drift")  # figures that have a row an axis, too
MEAN_ROWS = (  # heading, figure, factor, digits
    ("MAE mean", "mae", 1, 2),
    ("MSE mean", "mse", 1, 1),
    ("rest early mean", "rest_early", 1, 2),
    ("rest late mean", "rest_late", 1, 2),
    ("hover mean", "hover", 1, 2),
    ("drift, ° mean", "drift", 1, 1),
    ("MAE, least possible", "mae_least", 1, 2),
    ("  above it", "mae_above", 1, 2),
    ("MSE, least possible", "mse_least", 1, 1),
    ("  above it", "mse_above", 1, 1),
    ("IAE", "iae", 1, 0),
    ("ISE", "ise", 1, 0),
    ("ITAE", "itae", 1, 0),
    ("ITSE", "itse", 1, 0),
    ("mean output ū", "output", 1, 4),
    ("mean |Δu| in 1 ms", "change", 1, 5),
    ("motors, mean |Δ| in 1 ms", "motor_change", 1, 5),
    ("Sm, 1e-6", "smoothness", 1e6, 1),
    ("success, %", "success", 100, 1),
    ("  bare 10 % band", "success_bare", 100, 1),
    ("error, rad/s", "error", 1, 1),
    ("rise, ms", "rise_ms", 1, 1),
    ("peak, %", "peak", 1, 1),
    ("in band, 500 ms+, %", "all_in_band_500", 100, 1),
    ("  bare", "all_in_band_500_bare", 100, 1),
    ("in band, 750 ms+, %", "all_in_band_750", 100, 1),
    ("  bare", "all_in_band_750_bare", 100, 1),
    ("every sample, %", "steady", 100, 1),
    ("  bare", "steady_bare", 100, 1),
    ("  from 750 ms, %", "steady_750", 100, 1),
    ("  bare", "steady_750_bare", 100, 1),
)
RESPONSE_ROWS = (  # heading, figure, factor, digits: of an axis
    ("success, %", "success", 100, 1),
    ("  bare 10 % band", "success_bare", 100, 1),
    ("settling, ms", "settling_ms", 1, 1),
    ("failure, %", "failure", 1, 1),
    ("  bare 10 % band", "failure_bare", 1, 1),
    ("rise, ms", "rise_ms", 1, 1),
    ("peak, %", "peak", 1, 1),
    ("error, rad/s", "error", 1, 1),
    ("stability, deg/s²", "stability", 1, 2),
    ("  slope, rad/s²", "slope", 1, 4),
    ("in band, 500 ms+, %", "in_band_500", 100, 1),
    ("in band, 750 ms+, %", "in_band_750", 100, 1),
    ("  bare, 500 ms+, %", "in_band_500_bare", 100, 1),
    ("  bare, 750 ms+, %", "in_band_750_bare", 100, 1),
)
SHARE_ROWS = (  # heading, figure: of all axes at once
    ("all axes, 500 ms+, %", "all_in_band_500"),
    ("all axes, 750 ms+, %", "all_in_band_750"),
    ("  bare, 500 ms+, %", "all_in_band_500_bare"),
    ("  bare, 750 ms+, %", "all_in_band_750_bare"),
    ("all axes, every sample, %", "steady"),
    ("  bare, every sample, %", "steady_bare"),
)
HEADLINE = {"mae", "rest_late", "drift", "change", "motor_change", "success", "rise_ms", "peak"}
MORE = " --all prints every figure."
ONE_EPISODE = " A single flight gives no confidence, so no ± is told."
LEAST_NOTE = (
    "Least possible: by any motors' values, each figure by its own, from the command's step on, from the "
    "thrust at rest of that controller, without noise."
)
BAND_NOTE = (
    " The band is 10 % of the command or 5 deg/s, whichever is wider, on all axes at once; every sample: "
    f"from 500 to 1500 ms after the command. {LEAST_NOTE}"
)
NOTE = (
    "Errors in deg/s against the true rate; ± is 95 % confidence. Differences are paired, command by "
    "command; ≈ marks those that such confidence does not tell from none."
)


def entry_tables(
    titles: Sequence[str],
    rounds: Sequence[Sequence[Entry]],
    averages: Sequence[Mapping[str, Any]],
    flown: Conditions,
    *,
    everything: bool,
) -> list[Table]:
    """Return the figures of each throttle side by side, the differences to the first, and the averages."""
    found = [
        table
        for title, entries in zip(titles, rounds, strict=True)
        for table in side_by_side(title, entries, (), everything)
    ]
    found += [_average_table(each) for each in averages]
    more = BAND_NOTE if everything else MORE
    note = f"{NOTE}{more}{flight_note(flown)}{ONE_EPISODE if flown.episodes == 1 else ''}"
    found[-1] = replace(found[-1], note=found[-1].note + note)
    return found


def side_by_side(
    title: str, entries: Sequence[Entry], first_rows: Iterable[tuple[str, ...]], everything: bool
) -> list[Table]:
    """Return a table with a column for each controller, and one of the differences to the first."""
    from neuroflight.training.evaluation.comparison import by_axis, differences, means

    first, *others = entries
    rows = [
        ("", *(f"{each.controller.label}\nidle {each.controller.idle:g}" for each in entries)),
        *first_rows,
    ]
    averages, axes = ([of(entry.scores) for entry in entries] for of in (means, by_axis))
    shown = [
        row
        for row in MEAN_ROWS
        if all(row[1] in each for each in averages) and (everything or row[1] in HEADLINE)
    ]
    for heading, name, factor, digits in shown:
        for axis, word in enumerate(AXES if name in BY_AXIS and (everything or name == "mae") else ()):
            cells = (interval(each[name], digits, factor, axis) for each in axes)
            rows.append((f"{heading.removesuffix(' mean')} {word}", *cells))
        rows.append((heading, *(interval(each[name], digits, factor) for each in averages)))
    if not others:
        return [Table(title, rows)]
    less = [differences(first.scores, each.scores) for each in others]
    told = [("", *(each.controller.label for each in others))]
    for heading, name, factor, digits in shown:
        told.append((heading, *(difference(each[name], digits, factor) for each in less)))
    return [Table(title, rows), Table(f"less {first.controller.label}", told)]


def _average_table(found: Mapping[str, Any]) -> Table:
    """Return the average of policies: a row for each figure of their responses, a column for each axis."""
    policies, response = found["controllers"], found["response"]
    rows: list[tuple[str, ...]] = [("", *AXES)]
    for heading, name, factor, digits in RESPONSE_ROWS if response else ():
        rows.append((heading, *(_axis_cells(response[name], factor, digits))))
    sums = ", ".join(f"{value:,.1f}" for value in found["sum_of_errors"])
    title = f"average of {len(policies)} policies, {found['episodes']:,} episodes"
    return Table(
        title, rows, f"best of {len(policies)}: {found['best']}; errors summed over the axes: {sums}\n"
    )


def _axis_cells(mean: Mapping[str, Any], factor: float, digits: int) -> list[str]:
    """Return the cells of a mean of three axes, as JSON has it."""
    parts = (mean[key] for key in ("value", "low", "high", "count"))
    return [
        with_margin(factor * value, factor * (high - low) / 2, digits) if count else "none"
        for value, low, high, count in zip(*parts, strict=True)
    ]


def entry_documents(entries: Sequence[Entry]) -> list[dict[str, object]]:
    """Return the figures of all controllers as JSON data, beside the differences to the first."""
    from neuroflight.training.evaluation.envelope import envelope

    envelopes = [envelope(entry) for entry in entries]
    return [
        {
            **flight_document(entry),
            **means_document(entry, entries[0]),
            **({"envelope": envelope_document(found, envelopes[0])} if found and envelopes[0] else {}),
        }
        for entry, found in zip(entries, envelopes, strict=True)
    ]


def means_document(entry: Entry, first: Entry) -> dict[str, object]:
    """Return the means, and their differences to the first controller, as JSON data."""
    from neuroflight.training.evaluation.comparison import differences, means, percent, times_faster

    found: dict[str, object] = {
        "means": {name: mean.document() for name, mean in means(entry.scores).items()}
    }
    if entry is first:
        return found
    less, more = differences(first.scores, entry.scores), percent(first.scores, entry.scores)
    return found | {
        "difference": {k: {**mean.document(), "significant": mean.significant} for k, mean in less.items()},
        "percent": {name: mean.document() for name, mean in more.items() if mean.count},
        "times_faster": times_faster(first.evaluation, entry.evaluation),
    }


def envelope_document(found: Envelope, first: Envelope) -> dict[str, object]:
    """Return a flight envelope as JSON data, its error beside that of `first`."""
    from neuroflight.training.evaluation.envelope import EDGES_DEG_S, by_magnitude

    mae, reference = float(found.mae.mean()), float(first.mae.mean())
    count, error, held = (column.tolist() for column in by_magnitude(found))
    reach, bare = (found.magnitude[which].tolist() for which in (found.held, found.held_bare))
    return {
        "mae": mae,
        "mae_ratio_to_first": mae / reference if reference > 0.0 else None,
        "held_to_deg_s": max(reach, default=None),
        "held_to_bare_deg_s": max(bare, default=None),
        "largest_command_deg_s": float(found.magnitude.max()),
        "magnitude_edges_deg_s": EDGES_DEG_S,
        "magnitude_commands": count,
        "magnitude_mae": [value if value == value else None for value in error],
        "magnitude_held": [value if value == value else None for value in held],
    }


def flight_document(entry: Entry) -> dict[str, Any]:
    """Return a controller and its figures as JSON data; throttle None: as recorded."""
    controller, result = entry.controller, entry.evaluation
    margins = {
        **asdict(result.tracking_margin),
        **asdict(result.effort_margin),
        "smoothness": result.smoothness_margin,
    }
    if result.motor_change is not None:
        margins["motor_change"] = float(result.motor_change.high - result.motor_change.value)
    return {
        "controller": controller.name,
        **controller.facts,
        "throttle": "recorded" if entry.throttle is None else entry.throttle,
        "idle": controller.idle,
        "control_rate_hz": controller.control_rate_hz,
        **{name: values.tolist() for name, values in asdict(result.tracking).items()},
        "worst_mae": result.worst_mae,
        "mae_least": result.mae_least,
        "mse_least": result.mse_least,
        "output": result.effort.output,
        "change": result.effort.change,
        "motor_change": None if result.motor_change is None else float(result.motor_change.value),
        "smoothness": result.smoothness,
        "margin_95": {name: plain(values) for name, values in margins.items()},
        "response": plain(asdict(result.response)) if result.response else None,
        **({"holding": plain(asdict(result.holding))} if result.holding else {}),
        "spectrum": result.spectrum.document(),
    }


def alone_tables(title: str, result: Evaluation, flown: Conditions, *, everything: bool) -> list[Table]:
    """Return the figures of one controller, a column for each axis and one of their mean."""
    rows = [("", *AXES, "mean"), *_alone_rows(result, everything)]
    return [Table(title, rows, "\n".join(_alone_lines(result)) + _alone_note(result, flown, everything))]


def _alone_rows(result: Evaluation, everything: bool) -> Iterator[tuple[str, ...]]:
    margins = asdict(result.tracking_margin)
    for name, values in asdict(result.tracking).items():
        if everything or name in HEADLINE:
            digits = 2 if name == "mae" else 0
            cells = [
                _number(value, digits) + (f" ± {_number(margin, digits)}" if margin > 0.0 else "")
                for value, margin in zip(values, margins[name], strict=True)
            ]
            yield (name.upper(), *cells, _number(values.mean(), digits))
    if (holding := result.holding) is not None:
        fifths = range(len(holding.rest.value))
        for n in fifths if everything else fifths[-1:]:
            yield (f"rest, fifth {n + 1}", *_by_axis(holding.rest, 2, at=n))
        yield ("hover", *_by_axis(holding.hover, 2))
        yield ("drift, °", *_by_axis(holding.drift, 1))
    if (response := result.response) is None:
        return
    for heading, name, factor, digits in RESPONSE_ROWS:
        if everything or name in HEADLINE:
            yield (heading, *_by_axis(getattr(response, name), digits, factor, some=True))
    for heading, name in SHARE_ROWS if everything else ():
        yield (heading, "", "", "", f"{100 * getattr(response, name).value:.1f}")


def _by_axis(
    mean: Mean, digits: int, factor: float = 1.0, *, at: int | tuple[()] = (), some: bool = False
) -> list[str]:
    """Return a cell for each axis and their mean; some: of the axes that have one, else of all or none."""
    value, low, high, count = (part[at] for part in (mean.value, mean.low, mean.high, mean.count))
    cells = [
        with_margin(factor * value[axis], factor * (high - low)[axis] / 2, digits) if count[axis] else "none"
        for axis in range(len(AXES))
    ]
    known = value[count > 0]
    told = len(known) == len(AXES) or (some and len(known) > 0)
    return [*cells, f"{factor * known.mean():.{digits}f}" if told else "none"]


def _alone_lines(result: Evaluation) -> Iterator[str]:
    """Yield the figures that have no axes."""
    if result.holding is not None:
        ages = result.holding.mae.value
        aged = ", ".join(f"{value:.2f}" for value in ages)
        yield f"MAE by age, of {len(ages)} equal parts before the hover: {aged}"
    effort, margin, motors = result.effort, result.effort_margin, ""
    if (change := result.motor_change) is not None:
        motors = f"of motors {with_margin(float(change.value), float(change.high - change.value), 5)}, "
    yield (
        f"mean output ū {with_margin(effort.output, margin.output, 4)}, "
        f"mean |Δu| in 1 ms {with_margin(effort.change, margin.change, 5)}, {motors}"
        f"Sm {with_margin(1e6 * result.smoothness, 1e6 * result.smoothness_margin, 1)} x 1e-6, "
        f"worst MAE of a command and axis {result.worst_mae:.1f} deg/s"
    )
    if result.mae_least and result.mse_least:
        mae, mse = (float(values.mean()) for values in (result.tracking.mae, result.tracking.mse))
        yield (
            f"least that any motors could leave: MAE {result.mae_least:.2f}, this is "
            f"{100 * (mae / result.mae_least - 1):.0f} % above it; MSE {result.mse_least:.1f}, "
            f"{100 * (mse / result.mse_least - 1):.0f} % above it"
        )


def _alone_note(result: Evaluation, flown: Conditions, everything: bool) -> str:
    note = "\nErrors in deg/s against the true rate; ± is 95 % confidence of the mean."
    if result.response:
        floor = f"{result.response.floor_deg_s:g} deg/s"
        note += (
            f" The band is 10 % of the initial error or {floor}, whichever is wider; rise, peak and failure "
            f"leave out initial errors below {floor}."
        )
        if everything:
            note += " Every sample: from 500 to 1500 ms after the command, or to its end."
    one = ONE_EPISODE if result.episodes == 1 else ""
    return f"{note}{'' if everything else MORE}{flight_note(flown)}{one}"


def _number(value: float, digits: int) -> str:
    """Return a number; large sums with an exponent, in at most seven characters."""
    if value < 1e5:
        return f"{value:,.{digits}f}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"
