"""The section about robustness on the page of results."""

from __future__ import annotations

from neuroflight.training.results_page.markdown import table
from neuroflight.training.results_page.rows import controller_label
from neuroflight.training.results_page.stored_results import Stored


def robustness_section(stored: Stored) -> str:
    """Return ratios of the error to the nominal aircraft's beside their bars, a column per controller."""
    controllers = stored.entries("robustness", "controllers")
    bar, usual, high = (stored.number("robustness", "bars", name) for name in ("case", "median", "high"))
    cases = controllers[0].get("cases")
    if not isinstance(cases, dict) or not cases:
        raise controllers[0].error("cases", cases, "an object")
    nominal, *varied = cases
    body = [[f"{nominal}, MAE, deg/s", "", *(_nominal(each, nominal) for each in controllers)]]
    body += [[case, f"{bar:g}", *(_case(each, case, bar) for each in controllers)] for case in varied]
    if all(each.get("joint") is not None for each in controllers):
        percent = f"{100 * stored.number('robustness', 'high_quantile'):.0f}th percentile"
        for label, name, most in (("median", "median", usual), (percent, "high", high)):
            cells = [_joint(each, name, most) for each in controllers]
            body.append([f"all at once, {label}", f"{most:g}", *cells])
        lost = [f"{each.number('joint', 'diverged'):.0f}" for each in controllers]
        body.append(["all at once, diverged", "0", *lost])
    flights = stored.text("robustness", "task") == "flight"
    about = (ABOUT_FLIGHTS if flights else ABOUT).format(
        throttle=f"{stored.number('robustness', 'throttle_max'):g}",
        episodes=f"{stored.number('robustness', 'episodes'):.0f}",
        draws=f"{stored.number('robustness', 'draws'):.0f}",
        each=f"{stored.number('robustness', 'commands_per_draw'):.0f}",
        divergence=stored.text("robustness", "divergence"),
    )
    headings = ("", "at most", *(controller_label(each) for each in controllers))
    return f"## Robustness, {stored.text('aircraft')}\n\n{about}\n\n{table(headings, body)}"


def _nominal(controller: Stored, case: str) -> str:
    value, high = (controller.number("cases", case, "mae", name) for name in ("value", "high"))
    return f"{value:.2f} ± {high - value:.2f}"


def _case(controller: Stored, case: str, bar: float) -> str:
    value, high = (controller.number("cases", case, "ratio", name) for name in ("value", "high"))
    diverged = controller.number("cases", case, "diverged")
    lost = f", {diverged:.0f} diverged" if diverged else ""
    return f"{_marked(value, bar)} ± {high - value:.2f}{lost}"


def _joint(controller: Stored, name: str, bar: float) -> str:
    found = controller.interval("joint", name)
    return f"{_marked(found.value, bar)} ({found.low:.2f} to {found.high:.2f})"


def _marked(value: float, bar: float) -> str:
    """Return the value, bold if it misses its bar."""
    return f"{value:.2f}" if value <= bar else f"**{value:.2f}**"


ABOUT_FLIGHTS = """Flights of five pulses one after another and a hover, each with a throttle drawn from 0 to
{throttle}: {episodes} pulses on the aircraft of the file, the same ones with one parameter at a time at its
extreme, and {draws} aircraft with every parameter drawn between its extremes, {each} pulses each. Numbers
are ratios of MAE to the nominal aircraft's on the same commands with 95 % confidence; bold ones miss their
bar. Divergence: {divergence}."""
ABOUT = """Pulses as above, each with a throttle drawn from 0 to {throttle}: {episodes} on the aircraft
of the file, the same ones with one parameter at a time at its extreme, and {draws} aircraft with every
parameter drawn between its extremes, {each} pulses each. Numbers are ratios of MAE to the nominal aircraft's
on the same commands with 95 % confidence; bold ones miss their bar. Divergence: {divergence}."""
