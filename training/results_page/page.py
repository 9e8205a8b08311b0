"""The page of results: stored figures beside the dissertation's, rendered to Markdown.

A stored result is the output of `compare`, `policy sweep`, `fly`, `image time` or `aircraft stability` with
--json, or the training.json of a run. Its keys decide its kind, its task and aircraft decide its table; the
file's name only decides the order of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from neuroflight.training.dissertation.quotes import quotes
from neuroflight.training.results_page.dissertation import ControllerRow, printed_drift_mm, printed_rows
from neuroflight.training.results_page.equal_thrust import equal_thrust_section, transparency_section
from neuroflight.training.results_page.manoeuvres import manoeuvre_section
from neuroflight.training.results_page.markdown import axes, number, table
from neuroflight.training.results_page.robustness import robustness_section
from neuroflight.training.results_page.rows import (
    ALL_AXES,
    STEADY,
    SUMS,
    compared_rows,
    digests,
    evaluated_row,
    flown_rows,
)
from neuroflight.training.results_page.stored_results import Stored
from neuroflight.training.results_page.studies import study_section
from neuroflight.training.results_page.timing import timing_section
from neuroflight.training.results_page.training import training_section


def render(results: Sequence[Stored]) -> str:
    """Return the page. Raises ResultsError naming the file and key that cannot be used."""
    tables: dict[tuple[str, str], list[ControllerRow]] = {}
    kinds: dict[str, list[Stored]] = {key: [] for key in KINDS}
    lifted: list[str] = []
    for stored in results:
        if kind := next((key for key in KINDS if stored.has(key)), None):
            kinds[kind].append(stored)
        elif stored.has("equal_thrust"):
            lifted.append(equal_thrust_section(stored))
        elif stored.has("flights"):
            tables.setdefault(("pulse", stored.text("aircraft")), []).extend(flown_rows(stored))
        elif stored.has("task"):
            task = stored.text("task")
            if task not in SECTIONS:
                raise stored.error("task", task, f"one of {', '.join(SECTIONS)}")
            rows = compared_rows(stored) if stored.has("comparison") else [evaluated_row(stored)]
            tables.setdefault((task, stored.text("aircraft")), []).extend(rows)
            if stored.has("transparency"):
                lifted.append(transparency_section(stored))
        else:
            raise stored.error("task", "nothing", "what a command printed with --json, or a training.json")
    blocks = [HEAD]
    for task, section in SECTIONS.items():
        for aircraft, rows in ((which, rows) for (name, which), rows in tables.items() if name == task):
            blocks.append(section(aircraft, [*rows, *printed_rows(task, aircraft)]))
    blocks += lifted
    for key, sections in KINDS.items():
        blocks += sections(kinds[key])
    blocks.append(_sources(results))
    return "\n\n".join(blocks) + "\n"


def _pulse_section(aircraft: str, rows: Sequence[ControllerRow]) -> str:
    errors = [
        (
            row.label,
            str(row.episodes),
            _margins(row),
            f"{_mean_mae(row):.2f}",
            axes(row.tracking["mse"], 0),
            f"{_mean_mse(row):.0f}",
            number(row.output, 2 if row.printed else 3),
            number(row.change, 2 if row.printed else 4),
            "" if row.smoothness is None else f"{1e6 * row.smoothness:.0f}",
        )
        for row in rows
    ]
    sums = [(row.label, *(axes(row.tracking[name], 0) for name in SUMS)) for row in rows]
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
        table(("", "commands", "MAE", "mean", "MSE", "mean", "ū", "abs Δu", "Sm, 1e-6"), errors),
        table(("", "IAE", "ISE", "ITAE", "ITSE"), sums),
    ]
    if answers:
        headings = ("success", "bare", "rise, ms", "peak, %", "in band after 500 ms", "bare")
        parts.append(table(("", *headings), answers))
    columns = (("mae", "MAE", 1, 2), ("mse", "MSE", 1, 1), ("output", "ū", 1, 4), ("change", "abs Δu", 1, 5))
    parts += _differences(rows, (*columns, ("smoothness", "Sm, 1e-6", 1e6, 1)))
    return "\n\n".join(parts)


def _episodic_section(aircraft: str, rows: Sequence[ControllerRow]) -> str:
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
    return f"## Episodic task, {aircraft}\n\n{ABOUT_EPISODIC}\n\n{table(('', *headings), body)}"


def _envelope_section(aircraft: str, rows: Sequence[ControllerRow]) -> str:
    together = [
        (
            row.label,
            str(row.episodes),
            *(number(row.in_band.get(name), 0 if row.printed else 1) for name in (*STEADY, *ALL_AXES)),
        )
        for row in rows
    ]
    apart = [(row.label, *(_figure(row, name, 1) for name in ALL_AXES)) for row in rows if row.response]
    headings = ("after 500 ms", "bare", "after 750 ms", "bare")
    after = {f"{key}_750": quotes().number(f"5/envelope_{key}_750") for key in ("policy", "pid")}
    parts = [f"## Flight envelope, {aircraft}\n\n{ABOUT_ENVELOPE.format(**after)}"]
    strict = ("every sample", "bare")
    parts.append(table(("all axes at once, %", "setpoints", *strict, *headings), together))
    parts.append(table(("each axis, % of the time", *headings), apart))
    parts += _differences(
        rows,
        (("steady", "every sample, %", 100, 1), ("steady_bare", "bare, %", 100, 1), ("mae", "MAE", 1, 2)),
    )
    return "\n\n".join(parts)


def _differences(rows: Sequence[ControllerRow], columns: Sequence[tuple[str, str, float, int]]) -> list[str]:
    """Return a table of paired differences, if any; columns: figure, heading, factor, digits."""
    body = [
        (
            f"{row.label} less {row.against}",
            *(
                row.difference[name].difference(digits, factor) if name in row.difference else ""
                for name, _, factor, digits in columns
            ),
        )
        for row in rows
        if row.difference
    ]
    return [table(("", *(heading for _, heading, _, _ in columns)), body)] if body else []


def _drift_section(stored: Stored) -> str:
    body = []
    for run in stored.entries("runs"):
        formulation, step = run.text("formulation"), run.number("step_ms")
        printed = printed_drift_mm(formulation, step)
        body.append((formulation, f"{step:g}", f"{1e3 * run.number('drift_m'):.2g}", number(printed, 0)))
    headings = ("coordinates", "step, ms", "largest drift, mm", "dissertation, mm")
    about = ABOUT_DRIFT.format(
        combinations=f"{stored.number('combinations'):.0f}", limit=f"{stored.number('rate_limit_deg_s'):.0f}"
    )
    return f"## Stability of the simulation, {stored.text('aircraft')}\n\n{about}\n\n{table(headings, body)}"


def _sources(results: Sequence[Stored]) -> str:
    body = []
    for stored in results:
        body.append((f"`{stored.name}`", f"`{_command(stored)}`", ", ".join(digests(stored))))
    sources = table(("file", "command", "SHA-256"), body, align="---")
    return f"## What made these figures\n\n{ABOUT_SOURCES}\n\n{sources}"


def _command(stored: Stored) -> str:
    """Return the stored command; that of a flight is made from its conditions."""
    if "command" in stored.document or "flights" not in stored.document:
        return stored.text("command")
    words = ("on", "scenario", "aircraft")
    options = " ".join(f"--{word} {stored.text(word)}" for word in words)
    throttle = stored.number("throttle") if "throttle" in stored.document else 0.0  # older ones: closed
    numbers = f"--count {stored.number('episodes'):g} --seed {stored.number('seed'):g}"
    return f"neuroflight fly {options} --throttle {throttle:g} {numbers}"


def _mean_mae(row: ControllerRow) -> float:
    """Return the mean over axes; the dissertation's from its IAE = 1000 MAE, which has more digits."""
    return row.means["iae"] / 1000 if row.printed else sum(row.tracking["mae"]) / 3


def _mean_mse(row: ControllerRow) -> float:
    """Return the mean over axes; the dissertation's as printed, since its axes are cut to whole numbers."""
    return row.means["mse"] if row.printed else sum(row.tracking["mse"]) / 3


def _margins(row: ControllerRow) -> str:
    if row.mae_margin is None:
        return axes(row.tracking["mae"], 0 if row.printed else 2)
    pairs = zip(row.tracking["mae"], row.mae_margin, strict=True)
    return " / ".join(f"{value:.2f} ± {margin:.2f}" for value, margin in pairs)


def _figure(row: ControllerRow, name: str, digits: int) -> str:
    return axes(row.response[name], digits) if name in row.response else ""


HEAD = """# Results

Written by `neuroflight report` from the files in [results/](results/); `neuroflight report --check` tests
whether it is up to date. All figures are of simulated flights: unless a section says otherwise the twin turns
about its centre of mass; errors are against its true rate, in deg/s, roll / pitch / yaw. The dissertation is
W. Koch, *Flight Controller Synthesis via Deep Reinforcement Learning* (2019); its rows were measured in its
own simulator, on other commands of the same distribution, and the NF1's on a rig that holds it at its centre
of thrust: roll has 29 % more inertia there, pitch 21 %. All its experiments, run again, among them those of
chapter 3 on the Iris: [dissertation.md](dissertation.md)."""
ABOUT_PULSES = """Half a second of rest, a command from N(0, 100 deg/s) on all axes held for 2 s, 2 s of
rest. ± is 95 % confidence of the mean over commands. IAE to ITSE are sums over 1 ms samples divided by the
episode's seconds; ū is the mean output of the controller before throttle mix and idle, abs Δu its mean
change in 1 ms, Sm the weight of its fast part: the mean over the components of an episode's spectrum of
amplitude times frequency in parts of half the sampling rate (Mysore et al. 2021). The dissertation prints MAE
without decimals; the mean of its MAE is a thousandth of its IAE's (tables 5.6 and 5.7). Rows of one
comparison flew the same commands: differences are taken command by command, and ≈ marks those whose 95 %
confidence interval includes zero.
Rows without a throttle flew with it closed, and none of this table compares equal thrust: faster rotors make
errors smaller. The dissertation's mean squared error of 117 is of rotors that carried the aircraft without
throttle: its policy's mean output of 0.12 is thrust. Rotors that idle at 5.5 % let the aircraft fall, and
have little to steer with; what they reach in flights stands under equal thrust, as closed."""
ABOUT_EPISODIC = """From rest, a command uniform within ±300 deg/s on all axes, held for 1 s. Success is the
share [%] of commands whose error enters and stays within 10 % of the initial one, or within 5 deg/s where
that is wider; bare is without that floor. Failure is the mean error after 500 ms of the others, rise the
time from 10 to 90 % of the command, peak the largest rate, each without commands below 5 deg/s (- where
none is left); error is the sum of the error over 1 ms samples [rad/s], stability the slope of the rate
after 500 ms [deg/s²]."""
ABOUT_ENVELOPE = """From rest, a setpoint from N(0, 300 deg/s) on all axes, held for 1.5 s. Every sample is
the share of setpoints [%] whose error stays within 10 % of them, or within 5 deg/s where that is wider, on
all axes and at each sample from 0.5 to 1.5 s; bare is without that floor. The other shares are of time. The
dissertation counted how often a controller remained within 10 % of the setpoint after 500 ms, so its shares
stand under every sample; after 750 ms they are {policy_750:.0f} % (policy) and {pid_750:.0f} % (PID). It does
not say whether all axes had to remain, nor for how long."""
ABOUT_DRIFT = """The airframe and each propeller as links of their own, joined by hinges; all {combinations}
combinations of motors on and off from rest, free, up to {limit} deg/s. Drift is how far a propeller's
distance from the airframe changes. The twin itself is one rigid body: nothing in it can drift, and it keeps
its angular momentum to rounding where pybullet's own step gains or loses 0.2 % of a tumbling racer's each
second. The dissertation's simulator had another solver, so the magnitudes differ; in both, reduced
coordinates do not drift and maximal ones do, more at larger steps. It shows reduced ones at 1 ms alone."""
ABOUT_SOURCES = """Each command reproduces its file from the same aircraft file and policy."""


def _each(section: Callable[[Stored], str]) -> Callable[[Sequence[Stored]], list[str]]:
    return lambda results: [section(stored) for stored in results]


# The sections of results of a kind, by the key that tells it: a sweep has runs too. The page has this order.
KINDS: dict[str, Callable[[Sequence[Stored]], list[str]]] = {
    "manoeuvres": _each(manoeuvre_section),
    "robustness": _each(robustness_section),
    "sweep": _each(study_section),
    "config": lambda runs: [training_section(runs)] if runs else [],
    "board_timing": _each(timing_section),
    "runs": _each(_drift_section),
}
SECTIONS: dict[str, Callable[[str, Sequence[ControllerRow]], str]] = {
    "pulse": _pulse_section,
    "episodic": _episodic_section,
    "envelope": _envelope_section,
}
