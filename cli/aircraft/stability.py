"""`neuroflight aircraft stability`: drift of an aircraft's links in reduced and in maximal coordinates."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.options import Json, picture
from neuroflight.cli.progress import Update, progress_bars
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Option, Request

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.identification.link_drift import Drift, Onset


@dataclass(frozen=True, kw_only=True)
class Stability(Request):
    """A request for the drift of an aircraft's links."""

    aircraft: Annotated[str, Option("NAME|FILE", "whose links are flown")] = "nf1"
    steps_ms: Annotated[
        tuple[float, ...], Option("MS", "steps of the world", low=0.05, high=20.0, unit="ms")
    ] = (2.0, 1.0, 0.5)
    plot: Annotated[Path | None, picture("draw drift against rate")] = None
    map: Annotated[Path | None, picture("draw roll, pitch and yaw rate, coloured by separation")] = None
    threshold_mm: Annotated[
        float,
        Option(
            "MM",
            "separation from which links count as apart; default: 1",
            above=0.0,
            high=1000.0,
            unit="mm",
            usual=True,
        ),
    ] = 1.0
    json: Json = False

    def run(self) -> int:
        """Fly all combinations of motors at each step, print the largest drifts."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.identification.link_drift import FORMULATIONS, drift
        from neuroflight.sim.identification.link_drift_plot import draw_drift, draw_map
        from neuroflight.sim.plotting import save_png

        aircraft = load_aircraft(self.aircraft)
        flights = 2**aircraft.motor_count
        runs = []
        with progress_bars(self.json) as bar:
            for formulation in FORMULATIONS:
                for step in self.steps_ms:
                    show = _counted(bar(f"{formulation}, {step:g} ms"), flights)
                    runs.append(drift(aircraft, formulation, step / 1e3, show))
        if self.plot:
            save_png(self.plot, draw_drift(runs, f"{aircraft.name}: do its links stay together?"))
        if self.map:
            save_png(
                self.map, draw_map(runs, self.threshold_mm / 1e3, f"{aircraft.name}: separation of its links")
            )
        if self.json:
            print_json(_document(self, aircraft, runs))
        else:
            _print(aircraft, runs, self.threshold_mm / 1e3)
        return 0


def _counted(show: Update, whole: int) -> Callable[[], None]:
    """Return a function that moves a bar by one."""
    done = itertools.count(1)
    return lambda: show(next(done), whole)


def _document(args: Stability, aircraft: Aircraft, runs: list[Drift]) -> dict[str, Any]:
    import numpy as np

    from neuroflight.sim.identification.link_drift import DURATION_S, RATE_MAX, onset

    return {
        "command": args.command,
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "combinations": 2**aircraft.motor_count,
        "duration_s": DURATION_S,
        "rate_limit_deg_s": float(np.rad2deg(RATE_MAX)),
        "threshold_m": args.threshold_mm / 1e3,
        "runs": [
            {
                "formulation": run.formulation,
                "step_ms": round(1e3 * run.step_s, 6),
                "drift_m": run.worst,
                "separation_m": float(run.separation.max()),
                "rate_deg_s": float(np.rad2deg(run.rate.max())),
                "onset": _onset_document(onset(run, args.threshold_mm / 1e3)),
            }
            for run in runs
        ],
    }


def _onset_document(found: Onset | None) -> dict[str, Any] | None:
    import numpy as np

    if found is None:
        return None
    return {
        "rates_deg_s": np.rad2deg(found.rates).tolist(),
        "rate_deg_s": float(np.rad2deg(found.rate)),
        "separation_m": found.separation,
    }


def _print(aircraft: Aircraft, runs: list[Drift], threshold: float) -> None:
    import numpy as np

    from neuroflight.sim.identification.link_drift import onset

    from_rate = f"above {1e3 * threshold:g} mm from, deg/s"
    rows = [("coordinates", "step, ms", "largest drift, mm", "separation, mm", from_rate, "fastest, deg/s")]
    for run in runs:
        found = onset(run, threshold)
        rates = "never" if found is None else " ".join(f"{rate:z.0f}" for rate in np.rad2deg(found.rates))
        rows.append(
            (
                run.formulation,
                f"{1e3 * run.step_s:g}",
                f"{1e3 * run.worst:.2g}",
                f"{1e3 * float(run.separation.max()):.2g}",
                rates,
                f"{np.rad2deg(run.rate.max()):.0f}",
            )
        )
    print_table(
        f"{aircraft.name}: do its links stay together?",
        rows,
        f"All {2**aircraft.motor_count} combinations of motors on and off, from rest, free, without gravity. "
        "Drift: of the propeller that moved most from the airframe; separation: every link from every other, "
        "summed (Koch 2019, algorithm 1), with the lowest rates about roll, pitch and yaw at which it passes "
        "the threshold. The twin itself is one rigid body: it has no links that could drift.",
    )
