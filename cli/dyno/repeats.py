"""`neuroflight dyno`: figures of repeated runs, as a table and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from neuroflight.cli.report import print_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from neuroflight.sim.identification.bench.summary import Figure, Peak, Repeats, StepFigures

HEADINGS = ("throttle", "0 to 90 %, ms", "rpm", "thrust, N", "torque, N m")


def repeats_document(repeats: Repeats | None) -> dict[str, Any] | None:
    """Return the figures as JSON data."""
    return None if repeats is None else asdict(repeats)


def print_repeats(title: str, steps: Sequence[StepFigures], top: Peak | None) -> None:
    """Print a row for each level and one of the ramp's top, each figure with half its 95 % interval."""
    rows = [HEADINGS]
    for item in steps:
        rows.append((f"step to {item.level:.1%}", _cell(item.rise_s, 1000, 0), *_largest(item)))
    if top is not None:
        rows.append(("top of the ramp", "", *_largest(top)))
    print_table(title, rows)
    if top is not None:
        print(
            f"at the ramp's top K_T = {_short(top.thrust_coefficient)} N s²/rad², "
            f"K_Q = {_short(top.torque_ratio_m)} m"
        )


def _largest(item: StepFigures | Peak) -> tuple[str, str, str]:
    return _cell(item.rpm, 1, 0), _cell(item.thrust_n, 1, 3), _cell(item.torque_n_m, 1, 5)


def _cell(item: Figure, scale: float, digits: int) -> str:
    return f"{item.mean * scale:,.{digits}f} ± {item.margin * scale:,.{digits}f}"


def _short(item: Figure) -> str:
    return f"{item.mean:.4g} ± {item.margin:.2g}"
