"""Plot of `neuroflight aircraft propeller`: measured coefficients over J, and the curves fitted to them."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from neuroflight.sim.identification.propeller import Curve, PropellerFit
from neuroflight.sim.plotting import AXIS_COLOURS, INK, dress, titled_figure


def draw_coefficients(fit: PropellerFit, title: str) -> Figure:
    """Draw C_T and C_Q; beyond the largest J measured the curves are dashed."""
    figure = titled_figure((11, 4.2), title)
    last = float(fit.used.ratio.max())
    ratios = np.linspace(0.0, max(1.05 * fit.advance.ratio_max, last), 400)
    factors = fit.advance.factors(ratios)
    curves: tuple[tuple[str, Curve], ...] = (("C_T", fit.thrust), ("C_Q", fit.torque))
    measured = fit.used.thrust, fit.used.torque
    for place, panel in enumerate(figure.subplots(1, 2)):
        name, curve = curves[place]
        values, inside = curve.static * factors[place], ratios <= last
        panel.plot(fit.used.ratio, measured[place], ".", ms=5, color=AXIS_COLOURS[place], label="measured")
        panel.plot(ratios[inside], values[inside], color=INK, lw=1.0, label="fit")
        panel.plot(
            ratios[~inside], values[~inside], "--", color=INK, lw=1.0, label="beyond what was measured"
        )
        terms = "".join(
            f" {'-' if term < 0.0 else '+'} {abs(term):.4g} {power}"
            for term, power in zip(curve.terms, ("J", "J²"), strict=True)
            if term
        )
        dress(panel, f"{name} = {curve.static:.4g} (1{terms})")
        panel.set_xlabel("advance ratio J", color=INK, fontsize=9)
        panel.set_ylim(bottom=0.0)
        panel.legend(frameon=False, fontsize=8, labelcolor=INK, loc="lower left")
    return figure
