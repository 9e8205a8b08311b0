"""Suite `power`: what controllers draw from the battery, disarmed, armed idling and in flight."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.compare.suite import THROTTLES_MAX, THRUST_MAX, Bar, Idle, On, Seed, Suite, SuiteResult
from neuroflight.cli.report import Table, interval
from neuroflight.cli.requests import Option

if TYPE_CHECKING:
    from neuroflight.sim.analysis.confidence import Mean
    from neuroflight.training.evaluation.power import Draw, Drawn

NOTE = (
    "Disarmed: any controller. Armed: on the ground, throttle closed, with gyro noise. 1 g: at the throttle "
    "that gives a thrust at rest of the aircraft's weight, or (*) the nearest that a controller can; without "
    "commands, and following pulses. Voltage is under load. MAE in deg/s against the true rate; ± is 95 % "
    "confidence of the mean over aircraft."
)


@dataclass(frozen=True, kw_only=True)
class Power(Suite):
    """Power that controllers draw from the battery: disarmed, armed idling, in flight."""

    names = ("power",)

    on: On = None
    thrust: Annotated[
        tuple[float, ...],
        Option(
            "W",
            "thrusts to fly at, of the weight; none: idle only; default: 1, hover",
            low=0.0,
            high=THRUST_MAX,
            number="*",
            most=THROTTLES_MAX,
        ),
    ] = (1.0,)
    seconds: Annotated[float, Option("S", "of idling; default: 5", low=0.1, high=60.0)] = 5.0
    episodes: Annotated[int, Option("N", "aircraft, a command each; default: 10", low=1, high=500)] = 10
    seed: Seed = 0
    idle: Idle = None
    battery: Annotated[
        float, Option("CHARGE", "its charge at the start, 0..1; default: 1", low=0.0, high=1.0)
    ] = 1.0

    def fly(self, bar: Bar, ends: ExitStack) -> SuiteResult:
        """Let all controllers idle and fly."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.toolchain.errors import AircraftError
        from neuroflight.training.evaluation.controllers import Conditions, at_gyro_rate
        from neuroflight.training.evaluation.power import disarmed, power
        from neuroflight.training.evaluation.power_plot import draw_power
        from neuroflight.training.tasks.task import PulseTask

        aircraft = load_aircraft(self.aircraft)
        if (battery := aircraft.battery) is None:
            raise AircraftError(
                f"aircraft {aircraft.name}: no [battery] table; power is drawn from a battery"
            )
        flown = Conditions(aircraft, PulseTask(), self.episodes, self.seed, charge=self.battery)
        controllers = self.opened(aircraft, ends, self.idle)
        flown = at_gyro_rate(flown, controllers, sticks=True)
        drawn = [power(each, flown, self.thrust, self.seconds, bar) for each in controllers]
        still = disarmed(battery, self.battery)
        title = f"{aircraft.name}: power from the battery, {self.episodes} aircraft, seed {self.seed}"
        return SuiteResult(
            request=self,
            aircraft=aircraft,
            document=lambda: {
                "task": flown.task.name,
                "episodes": flown.episodes,
                "seed": flown.seed,
                "gyro_rate_hz": flown.gyro_rate_hz,
                "idling_s": self.seconds,
                "charge": self.battery,
                "electronics_w": battery.electronics_power,
                "disarmed": _draw(still),
                "controllers": [drawn_document(each) for each in drawn],
            },
            tables=lambda: [Table(title, _rows(still, drawn), NOTE)],
            pictures={"plot": lambda: draw_power(still, drawn, title)},
        )


def drawn_document(drawn: Drawn) -> dict[str, Any]:
    """Return the figures of a controller as JSON data."""
    return {
        "controller": drawn.controller.name,
        "label": drawn.controller.label,
        **drawn.controller.facts,
        "idle": drawn.controller.idle,
        "control_rate_hz": drawn.controller.control_rate_hz,
        "armed": _draw(drawn.idling),
        "flights": [
            {
                "thrust": flown.trim.wanted,
                "reached": flown.trim.reached,
                "throttle": flown.trim.rest.throttle,
                "rest": _draw(flown.rest),
                "commands": {"mae": flown.mae.document(), **_draw(flown.commands)},
            }
            for flown in drawn.flown
        ],
    }


def _draw(drawn: Draw) -> dict[str, object]:
    return {name: mean.document() for name, mean in vars(drawn).items()}


def _rows(still: Draw, drawn: Sequence[Drawn]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [("", "V", "A", "W", "MAE"), _row("disarmed", still)]
    for each in drawn:
        rows.append(_row(f"{each.controller.label}, armed", each.idling))
        for flown in each.flown:
            mark = "" if flown.trim.reached else " (*)"
            rows.append(_row(f"  {flown.trim.wanted:g} g{mark}, rest", flown.rest))
            rows.append(_row(f"  {flown.trim.wanted:g} g{mark}, pulses", flown.commands, flown.mae))
    return rows


def _row(name: str, drawn: Draw, mae: Mean | None = None) -> tuple[str, ...]:
    error = "" if mae is None else interval(mae, 3)
    return (name, interval(drawn.volts, 3), interval(drawn.amps, 3), interval(drawn.watts, 2), error)
