"""Suite `fleet`: controllers on unseen aircraft of real classes, from whoops to ten inch lifters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.compare.suite import Bar, Seed, Suite, SuiteResult
from neuroflight.cli.report import Table
from neuroflight.cli.requests import Option
from neuroflight.toolchain.workers import Crew, usable_cores

if TYPE_CHECKING:
    from neuroflight.sim.ports.betaflight.build import Betaflight
    from neuroflight.training.evaluation.fleet.arena import Figures, Plan
    from neuroflight.training.evaluation.fleet.contest import Entrant
    from neuroflight.training.evaluation.fleet.unseen import Unseen

COUNT_MAX, PULSES_MAX = 1000, 64
WORST_SHOWN = 8
Flown = dict[str, dict[str, "Figures"]]  # by aircraft and kind of flight
NOTE = (
    "Ratios of the first controller's figures to each rival's, aircraft by aircraft at equal thrust, mean "
    "over those that neither loses; worst: the larger of both errors' ratios on its worst aircraft; ! misses "
    "its bar. Lost, of the first controller and the rival: aircraft on which a flight spins beyond 2000 "
    "deg/s, errs more than one that never turns, or drifts beyond 90 deg in ten seconds of hover. Stands: "
    "|mean rate| after commands, what no integral removes; swing: the deviation from it."
)


@dataclass(frozen=True, kw_only=True)
class Fleet(Suite):
    """Errors on unseen aircraft of real classes, against Betaflight's defaults and a PID scaled for each."""

    names = ("fleet",)

    count: Annotated[int, Option("N", "aircraft", low=1, high=COUNT_MAX)] = 200
    # Aircraft of seed 1 guided the training of `any`: they are not unseen.
    seed: Annotated[int, Option("S", "of the aircraft; another is another fleet", low=0)] = 2
    pulses: Annotated[
        int, Option("N", "on each aircraft, of all thrusts together", low=2, high=PULSES_MAX)
    ] = 8
    long: Annotated[
        int, Option("N", "every Nth aircraft also flies a minute and its own wash; 0: none", low=0)
    ] = 5
    commands: Seed = 0
    keep: Annotated[
        Path | None,
        Option("DIR", "keep figures there; what is there is not flown again", recorded=False),
    ] = None
    files: Annotated[
        Path | None, Option("DIR", "write each aircraft's file there, as it is and as told", recorded=False)
    ] = None
    jobs: Annotated[
        int | None, Option("N", "aircraft at a time; default: the cores", low=1, high=64, recorded=False)
    ] = None

    def fly(self, bar: Bar, ends: ExitStack) -> SuiteResult:
        """Fly each aircraft with everybody, in processes of their own."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.training.evaluation.betaflight import BETAFLIGHT
        from neuroflight.training.evaluation.fleet.answered import answered
        from neuroflight.training.evaluation.fleet.contest import Entrant
        from neuroflight.training.evaluation.fleet.scaled_pid import REFERENCE
        from neuroflight.training.evaluation.fleet.unseen import fleet
        from neuroflight.training.evaluation.fleet_plot import draw_fleet

        self.refuse("aircraft", because="the aircraft are the fleet's; leave it out")
        entrants = [Entrant.of(name) for name in self.controllers]
        aircraft = list(fleet(self.count, self.seed, answered))
        if self.files is not None:
            _write(self.files, aircraft)
        built = None
        if any(entrant.name == BETAFLIGHT for entrant in entrants):
            built = self.built_betaflight(aircraft[0].truth)
        found = self._all(bar, entrants, aircraft, built)
        flown = {
            entrant: {
                one.name: each[entrant.name]
                for one, each in zip(aircraft, found, strict=True)
                if entrant.name in each
            }
            for entrant in entrants
        }
        title = f"Fleet: {self.count} unseen aircraft, seed {self.seed}"
        first, *others = flown
        return SuiteResult(
            request=self,
            aircraft=load_aircraft(REFERENCE),
            document=lambda: {"fleet": _document(flown, aircraft)},
            tables=lambda: list(_tables(title, flown, aircraft)),
            pictures={
                "plot": lambda: draw_fleet(
                    flown[first],
                    {rival.label: flown[rival] for rival in others},
                    aircraft,
                    "pulses",
                    f"{first.label} on {title[7:]}",
                )
            },
        )

    def _all(
        self, bar: Bar, entrants: Sequence[Entrant], aircraft: Sequence[Unseen], built: Betaflight | None
    ) -> list[dict[str, dict[str, Figures]]]:
        """Return the figures of each aircraft, by controller and kind of flight."""
        import neuroflight.sim.physics.twin  # noqa: F401 - once, before the processes are forked
        from neuroflight.training.evaluation.fleet.contest import fly_all

        update, parts = bar("aircraft"), [0.0] * len(aircraft)

        def show(number: int, part: float) -> None:
            parts[number] = part
            update(round(1000 * sum(parts)), 1000 * len(aircraft))

        tasks = [
            partial(fly_all, entrants, one, self._plan(number), built, self.keep)
            for number, one in enumerate(aircraft)
        ]
        with Crew(tasks, usable_cores() if self.jobs is None else self.jobs) as crew:
            return crew.results([partial(show, number) for number in range(len(tasks))])

    def _plan(self, number: int) -> Plan:
        """Return what aircraft `number` flies."""
        from neuroflight.training.evaluation.fleet.arena import KINDS, Plan

        whole = self.long > 0 and number % self.long == 0
        return Plan(self.pulses, self.commands, KINDS if whole else KINDS[:1])


def _write(folder: Path, aircraft: Sequence[Unseen]) -> None:
    """Write NAME.toml, the aircraft as it is, for each."""
    from neuroflight.toolchain.files import write_text

    for one in aircraft:
        write_text(folder / f"{one.name}.toml", one.text)


def _tables(title: str, flown: dict[Entrant, Flown], aircraft: Sequence[Unseen]) -> Iterator[Table]:
    """Yield ratios by class, figures of everybody, and the worst aircraft."""
    from neuroflight.training.evaluation.fleet.arena import KINDS

    first, *rivals = flown
    for kind in KINDS:
        if not any(kind in each for each in flown[first].values()):
            continue
        if rivals:
            rows = list(_ratio_rows(first, rivals, flown, aircraft, kind))
            yield Table(f"{title}, {kind}: {first.label} over", rows, NOTE if kind == KINDS[0] else "")
        yield Table(f"{kind}: everybody", list(_absolute_rows(flown, aircraft, kind)), "")
    yield Table(
        f"where {first.label} is worst, pulses", list(_worst_rows(first, rivals, flown, aircraft)), ""
    )


def _ratio_rows(
    first: Entrant,
    rivals: Sequence[Entrant],
    flown: dict[Entrant, Flown],
    aircraft: Sequence[Unseen],
    kind: str,
) -> Iterator[tuple[str, ...]]:
    from neuroflight.training.evaluation.fleet.builds import kinds
    from neuroflight.training.evaluation.fleet.standings import (
        EVERY,
        MEAN_RATIO_MAX,
        OWN_RATIO_MAX,
        WORST_RATIO_MAX,
        ratios,
    )

    heads = ("MAE", "MSE", "|Δu|", "worst", "lost")
    yield ("", *(f"{rival.label}\n{head}" for rival in rivals for head in heads))
    for of_kind in (EVERY, *kinds()):
        those = [one for one in aircraft if of_kind in (EVERY, one.build.kind)]
        cells: list[str] = []
        for rival in rivals:
            found = ratios(flown[first], flown[rival], those, kind)
            if found is None:
                cells += [""] * len(heads)
                continue
            most = OWN_RATIO_MAX if rival.own else MEAN_RATIO_MAX
            cells += [
                _barred(found.mae, most),
                _barred(found.mse, most),
                _barred(found.change, 1.0),
                _barred(found.worst, OWN_RATIO_MAX if rival.own else WORST_RATIO_MAX),
                f"{'!' if found.lost else ''}{found.lost}/{found.rival_lost} of {found.count}",
            ]
        if any(cells):
            yield (of_kind, *cells)


def _barred(value: float, most: float) -> str:
    return f"{'' if value <= most else '!'}{value:.2f}"


def _absolute_rows(
    flown: dict[Entrant, Flown], aircraft: Sequence[Unseen], kind: str
) -> Iterator[tuple[str, ...]]:
    from neuroflight.training.evaluation.fleet.arena import REACHED
    from neuroflight.training.evaluation.fleet.standings import absolute

    yield (
        "",
        "MAE",
        "MSE",
        "|Δu|",
        "stands",
        "swing",
        "over, %",
        "full, %",
        "drift, °",
        "other thrust",
        "lost",
    )
    for entrant, own in flown.items():
        found = absolute(own, aircraft, kind, REACHED)
        if found is not None:
            yield (
                entrant.label,
                f"{found.mae:.2f}",
                f"{found.mse:.0f}",
                f"{found.change:.4f}",
                f"{found.standing:.2f}",
                f"{found.swing:.2f}",
                f"{100 * found.overshoot:.0f}",
                f"{100 * found.full:.1f}",
                f"{found.drift:.1f}",
                f"{found.other_thrust}",
                f"{found.lost} of {found.count}",
            )


def _worst_rows(
    first: Entrant, rivals: Sequence[Entrant], flown: dict[Entrant, Flown], aircraft: Sequence[Unseen]
) -> Iterator[tuple[str, ...]]:
    from neuroflight.sim.design.figures import aircraft_figures
    from neuroflight.training.evaluation.fleet.scaled_pid import authority, reference_authority
    from neuroflight.training.evaluation.fleet.standings import worst

    yield (
        "",
        "g",
        "T/W",
        "authority",
        "lag, ms",
        "delay",
        "MAE of axes",
        "stands",
        "swing",
        "over",
        "change",
        *(f"MAE {rival.label}" for rival in rivals),
    )
    for one in worst(flown[first], [flown[rival] for rival in rivals], aircraft, "pulses")[:WORST_SHOWN]:
        own = flown[first].get(one.name, {}).get("pulses")
        if own is None:
            continue
        drive, parts = one.truth.propulsion, authority(one.truth) / reference_authority()
        response: Any = drive.response
        others = [flown[rival].get(one.name, {}).get("pulses") for rival in rivals]
        yield (
            f"{one.name}{' LOST' if own.lost else ''}",
            f"{1000 * one.build.weight_kg:.0f}",
            f"{aircraft_figures(one.truth).thrust_to_weight:.1f}",
            "/".join(f"{part:.2g}" for part in parts),
            f"{1e3 * response.time_constant_up:.0f}/{1e3 * response.time_constant_down:.0f}",
            f"{1e3 * drive.delay:.1f}",
            "/".join(f"{axis:.1f}" for axis in own.axes),
            f"{own.standing:.2f}",
            f"{own.swing:.2f}",
            f"{100 * own.overshoot:.0f} %",
            f"{own.change:.4f}",
            *("" if other is None else f"{other.mae:.2f}{' lost' if other.lost else ''}" for other in others),
        )


def _document(flown: dict[Entrant, Flown], aircraft: Sequence[Unseen]) -> dict[str, Any]:
    """Return everything as JSON data."""
    from neuroflight.sim.design.figures import aircraft_figures
    from neuroflight.training.evaluation.fleet.arena import KINDS
    from neuroflight.training.evaluation.fleet.builds import kinds
    from neuroflight.training.evaluation.fleet.scaled_pid import authority, reference_authority
    from neuroflight.training.evaluation.fleet.standings import EVERY, ratios

    first, *rivals = flown
    groups = {of: [one for one in aircraft if of in (EVERY, one.build.kind)] for of in (EVERY, *kinds())}
    return {
        "aircraft": {
            one.name: {
                "kind": one.build.kind,
                "weight_kg": one.build.weight_kg,
                "authority": (authority(one.truth) / reference_authority()).tolist(),
                "told_authority": (authority(one.told) / reference_authority()).tolist(),
                "thrust_to_weight": aircraft_figures(one.truth).thrust_to_weight,
                "motors": list(one.shares),
                "charge": one.charge,
            }
            for one in aircraft
        },
        "ratios": {
            rival.name: {
                kind: {
                    of: compared.document()
                    for of, those in groups.items()
                    if (compared := ratios(flown[first], flown[rival], those, kind)) is not None
                }
                for kind in KINDS
            }
            for rival in rivals
        },
        "controllers": {
            entrant.name: {
                name: {kind: figures.document() for kind, figures in each.items()}
                for name, each in own.items()
            }
            for entrant, own in flown.items()
        },
    }
