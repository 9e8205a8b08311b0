"""The page of results: stored figures beside the dissertation's, rendered to Markdown.

A stored result is what `evaluate --json`, `fly --json` or `stability --json` printed. What kind it is follows
from its keys, what table it belongs to from its task and aircraft; nothing depends on a file's name but the
order of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from training.dissertation import PRINTED, PRINTED_AIRCRAFT, PRINTED_DRIFT_MM, Known, Row
from training.stored import Stored

SUMS = ("iae", "ise", "itae", "itse")
RESPONSES = (  # of a row: figure, factor to what is printed
    ("success", 100.0),
    ("success_bare", 100.0),
    ("failure", 1.0),
    ("rise_ms", 1.0),
    ("peak", 1.0),
    ("error", 1.0),
    ("stability", 1.0),
    ("in_band_500", 100.0),
    ("in_band_750", 100.0),
    ("in_band_500_bare", 100.0),
    ("in_band_750_bare", 100.0),
)
ALL_AXES = ("in_band_500", "in_band_500_bare", "in_band_750", "in_band_750_bare")
SHIPPED = "training/policies/"


def render(results: Sequence[Stored]) -> str:
    """The page. Raises ResultsError naming the file and key that cannot be used."""
    tables: dict[tuple[str, str], list[Row]] = {}
    drifts = []
    for stored in results:
        if "runs" in stored.document:
            drifts.append(stored)
        elif "flights" in stored.document:
            tables.setdefault(("pulse", stored.text("aircraft")), []).extend(_flown_rows(stored))
        elif "task" in stored.document:
            task = stored.text("task")
            if task not in SECTIONS:
                raise stored.error("task", task, f"one of {', '.join(SECTIONS)}")
            tables.setdefault((task, stored.text("aircraft")), []).append(_evaluated_row(stored))
        else:
            raise stored.error("task", "nothing", "what evaluate, fly or stability printed with --json")
    blocks = [HEAD]
    for task, section in SECTIONS.items():
        for aircraft, rows in ((which, rows) for (name, which), rows in tables.items() if name == task):
            printed = PRINTED[task] if aircraft == PRINTED_AIRCRAFT[task] else ()
            blocks.append(section(aircraft, [*rows, *printed]))
    blocks += [_drift_section(stored) for stored in drifts]
    blocks.append(_sources(results))
    return "\n\n".join(blocks) + "\n"


def _evaluated_row(stored: Stored) -> Row:
    name = stored.text("controller")
    label = f"PID `{stored.text('pid')}`" if "pid" in stored.document else _policy_label(name)
    conditions = []
    if not stored.get("noise"):
        conditions.append("no noise")
    if "--delay" in stored.text("command"):
        conditions.append(f"delay {1e3 * stored.number('delay_s'):g} ms")
    if stored.text("mount") != "centre":
        conditions.append(f"mount {stored.text('mount')}")
    if stored.number("throttle"):
        conditions.append(f"throttle {stored.number('throttle'):g}")
    return Row(
        label=", ".join([label, *conditions]),
        episodes=int(stored.number("episodes")),
        tracking={name: stored.axes(name) for name in ("mae", "mse", *SUMS)},
        mae_margin=stored.axes("margin_95", "mae"),
        output=stored.number("output"),
        change=stored.number("change"),
        response=_response(stored, "response"),
        in_band=_all_axes(stored, "response"),
    )


def _policy_label(path: str) -> str:
    return f"shipped policy ({Path(path).parent.name})" if path.startswith(SHIPPED) else f"policy `{path}`"


def _flown_rows(stored: Stored) -> list[Row]:
    if stored.text("scenario") != "pulses":
        raise stored.error(
            "scenario", stored.text("scenario"), "pulses, the only flight the page has a table for"
        )
    on = stored.text("on")
    firmware = "Betaflight, default PID (SITL)" if on == "betaflight" else f"policy in the firmware ({on})"
    flights = stored.get("flights")
    if not isinstance(flights, dict):
        raise stored.error("flights", flights, "an object")
    return [
        Row(
            label=firmware if name == "firmware" else f"{name}, same gyro rate and commands as the row above",
            episodes=int(stored.number("episodes")),
            tracking={key: stored.axes("flights", name, "tracking", key) for key in ("mae", "mse", *SUMS)},
            output=stored.number("flights", name, "effort", "output"),
            change=stored.number("flights", name, "effort", "change"),
            response=_response(stored, "flights", name, "response"),
            in_band=_all_axes(stored, "flights", name, "response"),
        )
        for name in flights
    ]


def _response(stored: Stored, *path: str) -> dict[str, Known]:
    if stored.get(*path) is None:
        return {}
    found: dict[str, Known] = {}
    for name, factor in RESPONSES:
        values, counts = stored.axes(*path, name, "value"), stored.axes(*path, name, "count")
        roll, pitch, yaw = (factor * v if count else None for v, count in zip(values, counts, strict=True))
        found[name] = (roll, pitch, yaw)
    return found


def _all_axes(stored: Stored, *path: str) -> dict[str, float]:
    """Share of the time [%] in which all axes are in the band."""
    if stored.get(*path) is None:
        return {}
    return {name: 100 * stored.number(*path, f"all_{name}", "value") for name in ALL_AXES}


def _pulse_section(aircraft: str, rows: Sequence[Row]) -> str:
    errors = [
        (
            row.label,
            str(row.episodes),
            _margins(row),
            f"{_mean_mae(row):.2f}",
            _axes(row.tracking["mse"], 0),
            f"{sum(row.tracking['mse']) / 3:.0f}",
            _number(row.output, 2 if row.printed else 3),
            _number(row.change, 2 if row.printed else 4),
        )
        for row in rows
    ]
    sums = [(row.label, *(_axes(row.tracking[name], 0) for name in SUMS)) for row in rows]
    answers = [
        (
            row.label,
            *(_figure(row, name, digits) for name, digits in (("success", 1), ("success_bare", 1))),
            *(_figure(row, name, digits) for name, digits in (("rise_ms", 1), ("peak", 0))),
            *(_figure(row, name, 1) for name in ("in_band_500", "in_band_500_bare")),
        )
        for row in rows
        if row.response
    ]
    parts = [
        f"## Pulses, {aircraft}\n\n{ABOUT_PULSES}",
        _table(("", "commands", "MAE", "mean", "MSE", "mean", "ū", "abs Δu"), errors),
        _table(("", "IAE", "ISE", "ITAE", "ITSE"), sums),
    ]
    if answers:
        headings = ("success", "bare", "rise, ms", "peak, %", "in band after 500 ms", "bare")
        parts.append(_table(("", *headings), answers))
    return "\n\n".join(parts)


def _episodic_section(aircraft: str, rows: Sequence[Row]) -> str:
    columns = (
        ("success", 1),
        ("success_bare", 1),
        ("failure", 1),
        ("rise_ms", 1),
        ("peak", 1),
        ("error", 1),
        ("stability", 2),
    )
    headings = ("commands", "success", "bare", "failure, %", "rise, ms", "peak, %", "error", "stability")
    body = [(row.label, str(row.episodes), *(_figure(row, *column) for column in columns)) for row in rows]
    return f"## Episodic task, {aircraft}\n\n{ABOUT_EPISODIC}\n\n{_table(('', *headings), body)}"


def _envelope_section(aircraft: str, rows: Sequence[Row]) -> str:
    together = [
        (
            row.label,
            str(row.episodes),
            *(_number(row.in_band.get(name), 0 if row.printed else 1) for name in ALL_AXES),
        )
        for row in rows
    ]
    apart = [(row.label, *(_figure(row, name, 1) for name in ALL_AXES)) for row in rows if row.response]
    headings = ("after 500 ms", "bare", "after 750 ms", "bare")
    parts = [f"## Flight envelope, {aircraft}\n\n{ABOUT_ENVELOPE}"]
    parts.append(_table(("all axes at once, % of the time", "setpoints", *headings), together))
    parts.append(_table(("each axis, % of the time", *headings), apart))
    return "\n\n".join(parts)


def _drift_section(stored: Stored) -> str:
    runs = stored.get("runs")
    if not isinstance(runs, list) or not runs or not all(isinstance(run, dict) for run in runs):
        raise stored.error("runs", runs, "a list of runs")
    body = []
    for number, entry in enumerate(runs):
        run = Stored(f"{stored.name}: runs[{number}]", entry)
        formulation, step = run.text("formulation"), run.number("step_ms")
        printed = PRINTED_DRIFT_MM.get(step) if formulation == "maximal" else 0.0
        body.append((formulation, f"{step:g}", f"{1e3 * run.number('drift_m'):.2g}", _number(printed, 0)))
    headings = ("coordinates", "step, ms", "largest drift, mm", "dissertation, mm")
    about = ABOUT_DRIFT.format(
        combinations=f"{stored.number('combinations'):.0f}", limit=f"{stored.number('rate_limit_deg_s'):.0f}"
    )
    return f"## Stability of the simulation, {stored.text('aircraft')}\n\n{about}\n\n{_table(headings, body)}"


def _sources(results: Sequence[Stored]) -> str:
    body = []
    for stored in results:
        digests = [f"{stored.text('aircraft')} `{stored.text('aircraft_sha256')[:12]}`"]
        if "policy_sha256" in stored.document:
            digests.append(f"policy `{stored.text('policy_sha256')[:12]}`")
        body.append((f"`{stored.name}`", f"`{_command(stored)}`", ", ".join(digests)))
    table = _table(("file", "command", "SHA-256"), body, align="---")
    return f"## What made these figures\n\n{ABOUT_SOURCES}\n\n{table}"


def _command(stored: Stored) -> str:
    """The stored command; that of a flight follows from what it says of itself."""
    if "command" in stored.document or "flights" not in stored.document:
        return stored.text("command")
    words = ("on", "scenario", "aircraft")
    options = " ".join(f"--{word} {stored.text(word)}" for word in words)
    return f"neuroflight fly {options} --count {stored.number('episodes'):g} --seed {stored.number('seed'):g}"


def _mean_mae(row: Row) -> float:
    """Of the dissertation's rows by its sums, which have more digits: IAE = 1000 MAE."""
    return sum(row.tracking["iae"]) / 3000 if row.printed else sum(row.tracking["mae"]) / 3


def _margins(row: Row) -> str:
    if row.mae_margin is None:
        return _axes(row.tracking["mae"], 0 if row.printed else 2)
    pairs = zip(row.tracking["mae"], row.mae_margin, strict=True)
    return " / ".join(f"{value:.2f} ± {margin:.2f}" for value, margin in pairs)


def _figure(row: Row, name: str, digits: int) -> str:
    return _axes(row.response[name], digits) if name in row.response else ""


def _axes(values: Known, digits: int) -> str:
    return " / ".join("-" if value is None else _number(value, digits) for value in values)


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:,.{digits}f}"


def _table(heading: Sequence[str], rows: Iterable[Sequence[str]], align: str = "---:") -> str:
    lines = [heading, ["---", *[align] * (len(heading) - 1)], *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)


HEAD = """# Results

Written by `neuroflight results` from the files in [results/](results/); `neuroflight results --check` says
whether it still is what they give. All figures are of simulated flights: the twin turns about its centre of
mass, errors are against its true rate, in deg/s, roll / pitch / yaw. The dissertation is W. Koch, *Flight
Controller Synthesis via Deep Reinforcement Learning* (2019); its rows were measured in its own simulator,
on other commands drawn alike."""
ABOUT_PULSES = """Half a second of rest, a command from N(0, 100 deg/s) on all axes held for 2 s, 2 s of
rest. ± is 95 % confidence of the mean over commands. IAE to ITSE are sums over 1 ms samples divided by the
episode's seconds; ū is the mean output of the controller before throttle mix and idle, abs Δu its mean
change in 1 ms. The dissertation prints MAE without decimals; its means here are those of its IAE."""
ABOUT_EPISODIC = """From rest, a command uniform within ±300 deg/s on all axes, held for 1 s. Success is the
share [%] of commands whose error comes to stay within 10 % of the initial one, or within 5 deg/s where that
is wider; bare is without that floor. Failure is the mean error after 500 ms of those that do not, rise the
time from 10 to 90 % of the command, peak the largest rate, each without commands below 5 deg/s (- where
none is left); error is the sum of the error over 1 ms samples [rad/s], stability the slope of the rate
after 500 ms [deg/s²]."""
ABOUT_ENVELOPE = """From rest, a setpoint from N(0, 300 deg/s) on all axes, held for 1 s: the share of time
[%] within 10 % of it, or within 5 deg/s where that is wider; bare is without that floor. The dissertation
does not say whether its share is of each axis or of all at once; the stricter reading stands beside it."""
ABOUT_DRIFT = """The airframe and each propeller as links of their own, joined by hinges; all {combinations}
combinations of motors on and off from rest, free, up to {limit} deg/s. Drift is how far a propeller's
distance from the airframe changes. The twin itself is one rigid body: nothing in it can drift, and it keeps
its angular momentum to rounding where pybullet's own step gains or loses 0.2 % of a tumbling racer's each
second. The dissertation's simulator had another solver: what compares is that reduced coordinates do not
drift and maximal ones do, more at larger steps."""
ABOUT_SOURCES = """Each command repeats its file, given the same aircraft file and policy."""
SECTIONS: dict[str, Callable[[str, Sequence[Row]], str]] = {
    "pulse": _pulse_section,
    "episodic": _episodic_section,
    "envelope": _envelope_section,
}
