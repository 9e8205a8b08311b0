"""The section about manoeuvres on the page of results."""

from __future__ import annotations

from collections.abc import Sequence

from neuroflight.training.results_page.markdown import table
from neuroflight.training.results_page.rows import controller_label
from neuroflight.training.results_page.stored_results import Stored

TITLES = {
    "roll": "roll",
    "flip": "flip",
    "split-s": "Split-S",
    "punch-out": "punch-out with a roll",
    "dive-recovery": "dive recovery",
    "wash": "prop wash",
}
COMPARED = (("mae", 2), ("mse", 0))  # figures that are won: name, digits
OTHERS = (("overshoot", 0), ("stray", 1), ("stray_peak", 0), ("thrust", 2), ("change", 4))
HOVER = (("rest", 2), ("drift", 1))  # of the hover behind, where it was flown
THROTTLES = (0.0, 0.15, 0.3, 0.6)  # of the table of thrust at rest


def manoeuvre_section(stored: Stored) -> str:
    """Return the section: errors and stray axes of each controller in each manoeuvre, thrust, descents."""
    controllers = stored.entries("manoeuvres", "contenders")
    figures = controllers[0].get("figures")
    if not isinstance(figures, dict) or not figures:
        raise controllers[0].error("figures", figures, "an object")
    hover = HOVER if all(isinstance(each, dict) and "rest" in each for each in figures.values()) else ()
    shown = (*OTHERS, *hover)
    body = [
        _row(each, name, shown, first=not index) for name in figures for index, each in enumerate(controllers)
    ]
    about = ABOUT.format(
        seeds=f"{stored.number('manoeuvres', 'seeds'):.0f}",
        charge=f"{100 * stored.number('manoeuvres', 'battery'):g}",
        gust=f"{stored.number('manoeuvres', 'gust_m_s'):g}",
        settle=f"{stored.number('manoeuvres', 'settle_s'):g}",
    )
    headings = ["", "", "MAE", "MSE", "overshoot, %", "stray", "peak", "thrust", "abs Δu"]
    if hover:
        headings += ["hover", "drift, °"]
        about += ABOUT_HOVER
    parts = [f"## Manoeuvres, {stored.text('aircraft')}\n\n{about}", table(headings, body, align="---:")]
    if len(controllers) > 1:
        parts.append(_wins(controllers, len(figures)))
    closed = ABOUT_DESCENT.format(flights=f"{stored.number('manoeuvres', 'descents'):.0f}")
    thrusts = [*(f"thrust at {throttle:g}" for throttle in THROTTLES), "sinks, m/s"]
    parts += [closed, table(("", *thrusts), [_descent(each) for each in controllers])]
    return "\n\n".join(parts)


def _row(controller: Stored, name: str, shown: Sequence[tuple[str, int]], first: bool) -> tuple[str, ...]:
    """Return the row of a controller in a manoeuvre; shown: figures that are told but not won."""
    cells = []
    for figure, digits in COMPARED:
        value, high = (controller.number("figures", name, figure, part) for part in ("value", "high"))
        text = f"{value:,.{digits}f} ± {high - value:,.{digits}f}"
        if figure in controller.get("figures", name, "wins"):
            told = figure in controller.get("figures", name, "clear_wins")
            text = f"{'' if told else '≈ '}**{text}**"
        cells.append(text)
    cells += [
        f"{controller.number('figures', name, figure, 'value'):,.{digits}f}" for figure, digits in shown
    ]
    return (TITLES.get(name, name) if first else "", controller_label(controller), *cells)


def _wins(controllers: Sequence[Stored], count: int) -> str:
    """Return a sentence: the number of manoeuvres that each controller wins."""
    words = []
    for each in controllers:
        won = [each.get("figures", name, "wins") for name in each.get("figures")]
        mae, mse = (sum(figure in names for names in won) for figure in ("mae", "mse"))
        words.append(f"{controller_label(each)}: {mae} in MAE, {mse} in MSE")
    return f"Won of {count}: {'; '.join(words)}."


def _descent(controller: Stored) -> tuple[str, ...]:
    throttles, thrusts = controller.get("throttle"), controller.get("thrust_at_rest")
    if not isinstance(throttles, list) or not isinstance(thrusts, list) or len(throttles) != len(thrusts):
        raise controller.error("thrust_at_rest", thrusts, "a number for each throttle")
    at_rest = dict(zip(throttles, thrusts, strict=True))
    missing = [throttle for throttle in THROTTLES if throttle not in at_rest]
    if missing:
        raise controller.error("throttle", throttles, f"{missing[0]:g} among them")
    sink, high = (controller.number("descent", "sink_m_s", part) for part in ("value", "high"))
    cells = [f"{at_rest[throttle]:.2f}" for throttle in THROTTLES]
    return (controller_label(controller), *cells, f"{sink:.1f} ± {high - sink:.1f}")


ABOUT = """Free flight with drag, on the aircraft's battery charged to {charge} %, in the gusts of a wind of
{gust} m/s; {seeds} flights of each, whose seeds draw noise, bias and gusts, the same for all. Errors are
means of the axes behind {settle} s of hover, ± is 95 % confidence over seeds; the lowest of a manoeuvre is
bold, ≈ where such confidence, seed by seed, does not tell it from every other. Overshoot is the most that a
commanded axis goes past its command, in % of the command's jump; stray the mean and the largest rate
of the axes that are never commanded [deg/s]; thrust that of all rotors over the weight as flown; abs Δu the
mean change of the motors' fractions in 1 ms. A manoeuvre says thrust: each controller's throttle is the one
whose thrust at rest is that, or the nearest that it gives, by its curve flown before at zero command."""
ABOUT_HOVER = """ Hover is the mean rate of the axes [deg/s] with the sticks centred behind the manoeuvre,
drift how far the aircraft turns in it about its worst axis: what a memory that wound up leaves."""
ABOUT_DESCENT = """Thrust at rest over weight against throttle, on that battery; and how fast the aircraft
comes down, level, ten seconds after the throttle was closed in the hover, mean of {flights} flights: below
zero it climbs."""
