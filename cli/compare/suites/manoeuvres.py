"""Suite `manoeuvres`: six manoeuvres and a descent in free flight, at equal thrust."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, TypeVar

from neuroflight.cli.compare.controllers import betaflight_tune, is_betaflight, say_foreign
from neuroflight.cli.compare.suite import Bar, Suite, SuiteResult
from neuroflight.cli.report import Table, interval
from neuroflight.cli.requests import Option
from neuroflight.toolchain.workers import Crew, Show, usable_cores

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.analysis.manoeuvre import ManoeuvreFigures
    from neuroflight.training.evaluation.manoeuvres import Flown, Pilot, PortController

T = TypeVar("T")
SEEDS_MAX, DESCENTS = 100, 3
GUST_MAX = 50.0  # [m/s]
DRAWN = ("roll", "split-s")
COLUMNS = (  # heading, figure, digits
    ("MAE", "mae", 2),
    ("MSE", "mse", 0),
    ("over, %", "overshoot", 0),
    ("stray", "stray", 1),
    ("its peak", "stray_peak", 0),
    ("thrust", "thrust", 2),
    ("|Δu|", "change", 4),
    ("20-80 Hz", "shake", 1),
    ("hover", "rest", 2),
    ("drift, °", "drift", 1),
)
NOTE = (
    "MAE and MSE: mean of the axes against the true rate, deg/s; ± is 95 % confidence over seeds. * the "
    "lowest of the manoeuvre, ** told from every other with 95 % confidence, seed by seed. Overshoot: the "
    "most past a command, in % of its jump. Stray: |rate| of axes that are not commanded. Thrust: of all "
    "rotors over the weight, flown; |Δu| of the motors in 1 ms. 20-80 Hz: root mean square of the errors in "
    "that band, what a pilot sees of prop wash. Hover: |rate| with the sticks centred behind "
    "the manoeuvre, and how far the aircraft drifts in it about its worst axis. Each throttle is the one "
    "whose thrust at rest is the same for all, or the nearest that the controller gives."
)


@dataclass(frozen=True, kw_only=True)
class Manoeuvres(Suite):
    """Roll, flip, Split-S, punch-out, dive and prop wash flown freely, with drag, battery and gusts."""

    names = ("manoeuvres",)

    seeds: Annotated[int, Option("N", "flights of each manoeuvre; default: 5", low=1, high=SEEDS_MAX)] = 5
    seed: Annotated[
        int, Option("S", "the first; each draws noise, bias and gusts; default: 1", low=0, high=2**31)
    ] = 1
    battery: Annotated[float, Option("CHARGE", "at power-on, 0..1; default: 0.9", low=0.0, high=1.0)] = 0.9
    gust: Annotated[
        float,
        Option("SPEED", "wind [m/s] whose turbulence is flown; default: 7.7, light", low=0.0, high=GUST_MAX),
    ] = 7.7
    jobs: Annotated[
        int | None, Option("N", "flights at a time; default: the cores", low=1, high=1024, recorded=False)
    ] = None

    def fly(self, bar: Bar, ends: ExitStack) -> SuiteResult:
        """Fly the curves of all, then all flights, in processes of their own."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.flight.manoeuvres import MANOEUVRES, SETTLE_S
        from neuroflight.training.evaluation.manoeuvres import Air, Flown, Pilot

        aircraft = load_aircraft(self.aircraft)
        air = Air(self.battery, self.gust)
        pilots = [Pilot(one, aircraft, air) for one in self._ports(aircraft)]
        seeds = range(self.seed, self.seed + self.seeds)
        sunk = seeds[:DESCENTS]
        curves = self._all(bar, "thrust at rest", [partial(one.curve, self.seed) for one in pilots])
        pairs = list(zip(pilots, curves, strict=True))
        tasks = [
            partial(one.manoeuvre, each, curve, seed)
            for one, curve in pairs
            for each in MANOEUVRES
            for seed in seeds
        ]
        flights = self._all(bar, "manoeuvres", tasks)
        falls = [partial(one.descent, curve, seed) for one, curve in pairs for seed in sunk]
        descents = self._all(bar, "descents", falls)
        flight, descent = iter(flights), iter(descents)
        flown = [
            Flown(
                one.controller,
                curve,
                {each.name: tuple(next(flight) for _ in seeds) for each in MANOEUVRES},
                tuple(next(descent) for _ in sunk),
            )
            for one, curve in pairs
        ]
        title = (
            f"{aircraft.name}: {self.seeds} flights each from seed {self.seed}, free, battery charged to "
            f"{100 * self.battery:g} %, gusts of a wind of {self.gust:g} m/s"
        )
        closed = "Level, the throttle closed for ten seconds from the hover."
        return SuiteResult(
            request=self,
            aircraft=aircraft,
            document=lambda: {
                "manoeuvres": {
                    "seeds": self.seeds,
                    "seed": self.seed,
                    "descents": len(sunk),
                    "battery": self.battery,
                    "gust_m_s": self.gust,
                    "settle_s": SETTLE_S,
                    "contenders": [_document(flown, index) for index in range(len(flown))],
                }
            },
            tables=lambda: [Table(title, _rows(flown), NOTE), Table("", _descent_rows(flown), closed)],
            pictures={"plot": lambda: self._drawn(pilots, flown, bar)},
        )

    def _ports(self, aircraft: Aircraft) -> list[PortController]:
        """Return a port for each controller."""
        from neuroflight.training.evaluation.manoeuvres import betaflight_controller, port_controller

        found = [
            betaflight_controller(
                name, aircraft, self.built_betaflight(aircraft), betaflight_tune(name, self.aircraft)
            )
            if is_betaflight(name)
            else port_controller(name, aircraft)
            for name in self.controllers
        ]
        say_foreign(found)
        return found

    def _drawn(self, pilots: Sequence[Pilot], flown: Sequence[Flown], bar: Bar) -> Figure:
        """Fly the first seed of some manoeuvres again, and draw it as it was flown."""
        import numpy as np

        from neuroflight.sim.flight.manoeuvres import MANOEUVRES
        from neuroflight.training.evaluation.manoeuvres_plot import Shown, draw

        pairs = [
            (each, pilot, one)
            for each in MANOEUVRES
            if each.name in DRAWN
            for pilot, one in zip(pilots, flown, strict=True)
        ]
        tasks = [partial(pilot.trace, each, one.curve, self.seed) for each, pilot, one in pairs]
        shown = [
            Shown(
                each.name,
                one.controller.label,
                trace.t,
                np.rad2deg(trace.setpoint.astype(np.float64)),
                np.rad2deg(trace.rate.astype(np.float64)),
            )
            for (each, _, one), trace in zip(pairs, self._all(bar, "pictures", tasks), strict=True)
        ]
        return draw(shown, f"{pilots[0].aircraft.name}: manoeuvres at equal thrust, seed {self.seed}")

    def _all(self, bar: Bar, title: str, tasks: Sequence[Callable[[Show], T]]) -> list[T]:
        """Return the results of all tasks, in their order."""
        import neuroflight.sim.physics.twin  # noqa: F401 - once, before the processes are forked

        update, parts = bar(title), [0.0] * len(tasks)

        def show(number: int, part: float) -> None:
            parts[number] = part
            update(round(1000 * sum(parts)), 1000 * len(tasks))

        with Crew(tasks, usable_cores() if self.jobs is None else self.jobs) as crew:
            return crew.results([partial(show, number) for number in range(len(tasks))])


def _document(flown: Sequence[Flown], index: int) -> dict[str, object]:
    """Return a controller and its figures as JSON data; differences are to the first, seed by seed."""
    from neuroflight.training.evaluation.manoeuvres import COMPARED, less, means, significant, winner

    one, found = flown[index], {}
    for name, flights in one.manoeuvres.items():
        wins = [key for key in COMPARED if len(flown) > 1 and winner(flown, name, key) == index]
        away = {key: less(flown[0], one, name, key) for key in COMPARED if index}
        found[name] = {
            **{key: mean.document() for key, mean in means(flights).items()},
            **(
                {"difference": {k: {**m.document(), "significant": m.significant} for k, m in away.items()}}
                if index
                else {}
            ),
            "wins": wins,
            "clear_wins": [key for key in wins if significant(flown, name, key, index)],
        }
    return {
        "controller": one.controller.name,
        **one.controller.facts,
        "idle": one.controller.idle,
        "throttle": list(one.curve.throttle),
        "thrust_at_rest": list(one.curve.thrust),
        "figures": found,
        "descent": {key: mean.document() for key, mean in means(one.descents).items()},
    }


def _rows(flown: Sequence[Flown]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [("", *(heading for heading, _, _ in COLUMNS))]
    for name in flown[0].manoeuvres:
        rows.append((name, *("" for _ in COLUMNS)))
        for index, one in enumerate(flown):
            rows.append((f"  {one.controller.label}", *_cells(flown, index, name, one.manoeuvres[name])))
    return rows


def _cells(flown: Sequence[Flown], index: int, name: str, flights: Sequence[ManoeuvreFigures]) -> list[str]:
    from neuroflight.training.evaluation.manoeuvres import COMPARED, means, significant, winner

    found, cells = means(flights), []
    for _, figure, digits in COLUMNS:
        mark, mean = "", found[figure]
        if figure in COMPARED and len(flown) > 1 and winner(flown, name, figure) == index:
            mark = "** " if significant(flown, name, figure, index) else "* "
        cells.append(
            mark + (interval(mean, digits) if figure in COMPARED else f"{float(mean.value):,.{digits}f}")
        )
    return cells


def _descent_rows(flown: Sequence[Flown]) -> list[tuple[str, ...]]:
    from neuroflight.training.evaluation.manoeuvres import means

    rows: list[tuple[str, ...]] = [("", "thrust, throttle closed", "throttle of the hover", "sinks, m/s")]
    for one in flown:
        sink = interval(means(one.descents)["sink_m_s"], 1)
        hover = f"{one.curve.throttle_of(1.0):.3f}"
        rows.append((one.controller.label, f"{one.curve.thrust[0]:.2f}", hover, sink))
    return rows
