"""`neuroflight dyno fit`: figures of a fit to steady points, as a table and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.cli.report import print_table

if TYPE_CHECKING:
    from neuroflight.sim.identification.dyno.fit import Fit
    from neuroflight.sim.identification.dyno.points import PointsFit
    from neuroflight.sim.identification.dyno.robust_fit import Estimate


def estimate(item: Estimate | None, scale: float = 1.0) -> dict[str, float | None] | None:
    """Return a fitted number in the form for JSON."""
    if item is None:
        return None
    error = item.error * scale
    return {"value": item.value * scale, "standard_error": error if math.isfinite(error) else None}


def static_parameters(fit: Fit | PointsFit) -> list[tuple[str, Estimate, float, str]]:
    """Return label, estimate, scale and unit of each fitted term of the speed curve and the coefficients."""
    from neuroflight.sim.aircraft.model import RPM

    rows = [
        (f"H(u) {power}", term, 1 / RPM, "rpm")
        for power, term in zip(("u²", "u", "1"), fit.speed_curve or (), strict=False)
    ]
    for name, terms, unit in (("K_T", fit.thrust_coefficient, "N s²/rad²"), ("K_Q", fit.torque_ratio, "m")):
        for power, term in enumerate(terms):
            suffix = ("", " ω", " ω²", " ω³")[power]
            rows.append((f"{name}{suffix}", term, 1.0, unit + (f" (s/rad)^{power}" if power else "")))
    return rows


def points_document(data: Sequence[Path], fit: PointsFit, written: Path | None) -> dict[str, Any]:
    """Return the fit under the names that `dyno fit` gives it for a recording; null: not shown by points."""
    from neuroflight.sim.aircraft.model import RPM

    return {
        "data": [str(path) for path in data],
        "rows": len(fit.speed),
        "slips": fit.slips,
        "speed_max_rpm": fit.speed_max / RPM,
        "speed_curve_rpm": None
        if fit.speed_curve is None
        else [estimate(t, 1 / RPM) for t in fit.speed_curve],
        "thrust_coefficient": [estimate(term) for term in fit.thrust_coefficient],
        "torque_ratio_m": [estimate(term) for term in fit.torque_ratio] or None,
        "response": None,
        "reason": fit.reason,
        "thrust_left_percent": 100 * fit.thrust_left,
        "torque_left_percent": 100 * fit.torque_left if fit.torque_ratio else None,
        "warnings": list(fit.doubts),
        "notes": list(fit.notes),
        "written": None if written is None else str(written),
    }


def print_points(title: str, fit: PointsFit, written: Path | None) -> None:
    """Print a table with a row for each number, then how the log's columns were read."""
    from neuroflight.sim.aircraft.model import RPM

    print_parameters(f"{title}: {len(fit.speed)} points", static_parameters(fit))
    torque = f", {100 * fit.torque_left:.1f} % of the greatest torque" if fit.torque_ratio else ""
    lines = [
        f"up to {fit.speed_max / RPM:,.0f} rpm; the fit leaves {100 * fit.thrust_left:.1f} % of the greatest "
        f"thrust{torque} (rms)",
        fit.reason,
        *(f"warning: {doubt}" for doubt in fit.doubts),
        *(f"note: {note}" for note in fit.notes),
    ]
    if written is not None:
        kept = "the response" if fit.speed_curve is not None else "speed curve and response"
        lines.append(f"wrote {written}; {kept} stayed as they were")
    print(*lines, sep="\n")


def print_parameters(title: str, rows: Iterable[tuple[str, Estimate, float, str]]) -> None:
    """Print a row for each number: label, estimate, scale and unit."""
    table = [("", "fitted", "± standard error", " ")]
    for label, item, scale, unit in rows:
        error = f"{item.error * scale:.2g}" if math.isfinite(item.error) else "at least"
        table.append((label, f"{item.value * scale:.5g}", error, unit))
    print_table(title, table, numbers=table[0][1:3])
