"""`neuroflight fly --telemetry`: the telemetry of the ESCs in a flight, as a table, a picture and JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from neuroflight.cli.fly.options import FlyOptions

    Topics = dict[str, NDArray[np.float64]]


def asks_telemetry(args: FlyOptions) -> bool:
    """Return True if an output needs the telemetry of the ESCs."""
    return args.telemetry is not None or args.telemetry_plot is not None


def save_telemetry(args: FlyOptions, topics: Topics | None, control_rate_hz: int, title: str) -> None:
    """Write the outputs that the user asked for."""
    if topics is None:
        return
    from neuroflight.sim.analysis.esc_plot import draw_topics
    from neuroflight.sim.flight.esc_record import save_topics
    from neuroflight.sim.plotting import save_png

    rate_hz = control_rate_hz or 1  # of a single row
    if args.telemetry:
        save_topics(args.telemetry, topics, rate_hz)
    if args.telemetry_plot:
        save_png(args.telemetry_plot, draw_topics(topics, rate_hz, f"{title}: ESCs"))


def telemetry_document(topics: Topics | None) -> dict[str, Any]:
    """Return the range of each topic over the flight and all motors; null: not in the aircraft file."""
    if topics is None:
        return {}
    from neuroflight.sim.flight.esc_record import topic_ranges

    ranges = topic_ranges(topics)
    return {"esc": {name: None if each is None else asdict(each) for name, each in ranges.items()}}
