"""The page of a fit: what was held back and its prediction, step responses, the residual, and the verdict."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.fit.estimate import prepare
from neuroflight.sim.identification.fit.flight import Flight
from neuroflight.sim.identification.fit.held import SLOW_S, held_back, predict, quick, straight
from neuroflight.sim.identification.fit.model import shaped
from neuroflight.sim.identification.fit.result import Fit, Parameter, share_words
from neuroflight.sim.physics.rotor import speeds_along, target_speed
from neuroflight.sim.plotting import AXIS_COLOURS, MUTED, dress, legend_above, log_numbers, png, titled_figure
from neuroflight.toolchain.contract import AXES

SHOWN_S = 4.0  # of the held-back stretch that turns most
WELL = 0.8  # share of what the sticks did, from which an axis is predicted well
STEP_S = 0.0005
STYLE = "body{font:15px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em;color:#22272e}"
STYLE += "img{max-width:100%}table{border-collapse:collapse}td,th{padding:.2em .8em;text-align:left}"
STYLE += "tr:nth-child(even){background:#eef1f4}"


def report_page(flights: Sequence[Flight], start: Aircraft, fit: Fit) -> str:
    """Return the page as HTML, pictures included."""
    said, reasons = verdict(fit)
    rows = "".join(_row(one) for one in fit.parameters.values())
    asked = "".join(
        f"<li>{html.escape(words)}: {html.escape(manoeuvre)}</li>" for words, manoeuvre in fit.cannot
    )
    pictures = "".join(
        f'<h2>{html.escape(title)}</h2><img alt="{html.escape(title)}" '
        f'src="data:image/png;base64,{base64.b64encode(png(figure)).decode()}">'
        for title, figure in (
            ("What was held back, and its prediction", _rates(flights, start, fit)),
            ("A rotor's step, and what is left over frequency", _steps(start, fit)),
        )
    )
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in fit.notes)
    return (
        f'<!doctype html><meta charset="utf-8"><title>{html.escape(fit.name)}</title><style>{STYLE}</style>'
        f"<h1>{html.escape(fit.name)}</h1><p><b>{html.escape(said)}</b></p>"
        f"<ul>{''.join(f'<li>{html.escape(reason)}</li>' for reason in reasons)}</ul>"
        f"{pictures}<h2>Parameters</h2><table><tr><th></th><th>start</th><th>fit</th><th>95 % interval</th>"
        f"<th>told by</th></tr>{rows}</table>"
        f"<h2>What the logs cannot tell, and what would</h2><ul>{asked or '<li>nothing is missing</li>'}</ul>"
        f"{f'<h2>Notes</h2><ul>{notes}</ul>' if notes else ''}"
    )


def verdict(fit: Fit) -> tuple[str, list[str]]:
    """Say in a sentence whether a policy trained on this would fly the logged aircraft, and why."""
    needed = [fit.parameters[f"authority.{axis}"] for axis in AXES] + [fit.parameters["delay_s"]]
    needed += [one for key, one in fit.parameters.items() if key.startswith("response.")]
    missing = [one for one in needed if not one.told]
    poor = [axis for axis, share in zip(AXES, fit.explained, strict=True) if not share >= WELL]
    reasons = [
        f"of what the sticks did, the fit predicts: {share_words(fit.explained)}; the start file: "
        f"{share_words(fit.explained_start)} (both on data held back)"
    ]
    reasons += [f"{one.words}: known only as {one.text}" for one in missing]
    if not missing and not poor:
        return "A policy trained on this twin should fly the logged aircraft.", reasons
    if any(one.key in ("authority.roll", "authority.pitch") for one in missing):
        return "Do not rely on a policy trained on this twin yet: fly the manoeuvres below.", reasons
    doubt = ", ".join([*poor, *(one.words for one in missing)])
    return f"A policy trained on this twin will probably fly, with doubts about: {doubt}.", reasons


def _row(one: Parameter) -> str:
    unit = f" [{one.unit}]" if one.unit else ""
    bounds = f"{one.low:.4g} to {one.high:.4g}" if one.high > one.low else ""
    cells = (
        f"{one.words}{unit}",
        f"{one.start:.4g}",
        f"{one.value:.4g}",
        bounds,
        one.data if one.told else "not told",
    )
    return f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in cells)}</tr>"


def _rates(flights: Sequence[Flight], start: Aircraft, fit: Fit) -> Figure:
    """Draw the held-back stretch that turns most: measured, by the fit, by the start file."""
    best: tuple[float, Array, list[Array]] | None = None
    for data in prepare(flights, start, held_back):
        step = data.model.piece.step_s
        width, shown = round(SLOW_S / step) | 1, round(SHOWN_S / step)
        measured, said = predict(data, fit.layout, fit.estimate.theta, fit.wiring)
        _, before = predict(data, fit.layout, fit.layout.start, straight(start))
        if len(measured) <= width + 2:
            continue
        courses = [quick(each, width)[0] for each in (measured, said, before)]
        used = data.used[width // 2 : width // 2 + len(courses[0])]
        size = min(shown, int(used.sum()))
        power = np.convolve(
            np.where(used, (courses[0] ** 2).sum(axis=1), 0.0), np.ones(max(1, size)), "valid"
        )
        at = int(power.argmax()) if len(power) else 0
        if best is None or power[at] > best[0]:
            first = data.model.piece.start_s + (width // 2 + at) * step
            times = np.asarray(first + np.arange(size) * step, np.float64)
            best = float(power[at]), times, [course[at : at + size] for course in courses]
    figure = titled_figure((12, 8), "rates less their mean over 0.4 s")
    if best is None:
        return figure
    panels = figure.subplots(3, 1, sharex=True)
    for axis, panel in enumerate(panels):
        for course, name, colour in zip(
            best[2], ("measured", "fit", "start file"), ("#22272e", AXIS_COLOURS[0], "#e69f00"), strict=True
        ):
            panel.plot(
                best[1][: len(course)],
                np.rad2deg(course[:, axis]),
                color=colour,
                lw=1.1,
                label=name,
                zorder=1 if name == "start file" else 2,
            )
        reach = 2.0 * float(np.abs(np.rad2deg(best[2][0][:, axis])).max()) + 1.0
        panel.set_ylim(-reach, reach)
        dress(panel, AXES[axis], "s" if axis == 2 else "", "deg/s")
    legend_above(panels[0])
    return figure


def _steps(start: Aircraft, fit: Fit) -> Figure:
    """Draw a rotor's step up and down of both files, and the residual's density."""
    figure = titled_figure((12, 4.2), "rotor and residual")
    left, right = figure.subplots(1, 2)
    times = np.arange(0.0, 0.3, STEP_S)
    for values, name, colour in (
        (fit.layout.values(fit.layout.start), "start file", "#e69f00"),
        (fit.theta, "fit", AXIS_COLOURS[0]),
    ):
        propulsion = shaped(start.propulsion, values)
        late = round(values["delay_s"] / STEP_S)
        command = np.where((np.arange(len(times)) >= late) & (np.arange(len(times)) < 300 + late), 0.5, 0.3)
        targets = np.ascontiguousarray(target_speed(command[:, None], propulsion))
        low, high = target_speed(np.array([0.3, 0.5]), propulsion)
        speeds = speeds_along(np.array([low]), targets, STEP_S, propulsion)[:-1, 0]
        left.plot(1e3 * times, (speeds - low) / (high - low), color=colour, label=name)
    left.plot(1e3 * times, np.arange(len(times)) < 300, color=MUTED, lw=0.8, label="command")
    dress(left, "motor 30 % to 50 % and back", "ms", "share of the step")
    legend_above(left)
    band = fit.estimate.frequency > 0.7
    for axis, colour in enumerate(AXIS_COLOURS):
        density = np.rad2deg(np.sqrt(fit.estimate.noise[band, axis]))
        right.loglog(fit.estimate.frequency[band], density, color=colour, label=AXES[axis])
    log_numbers(right.xaxis)
    log_numbers(right.yaxis)
    dress(right, "what the fit leaves", "Hz", "deg/s, as white noise of a sample")
    legend_above(right)
    return figure
