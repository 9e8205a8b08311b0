"""Suites of flights, pulses, an envelope and the like: controllers on the same commands."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from neuroflight.cli.compare.commanded import (
    Commanded,
    Number,
    commands_flown,
    default_throttle,
    drawn_as_flown,
    flown_words,
    task_document,
    task_name,
)
from neuroflight.cli.compare.controllers import is_betaflight, is_policy
from neuroflight.cli.compare.suite import (
    THROTTLES_MAX,
    THRUST_MAX,
    Bar,
    Idle,
    Mounted,
    NoNoise,
    On,
    Seed,
    SuiteResult,
)
from neuroflight.cli.options import picture
from neuroflight.cli.output import plain
from neuroflight.cli.requests import Option
from neuroflight.toolchain.errors import TrainingError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from neuroflight.training.evaluation.comparison import Entry
    from neuroflight.training.evaluation.controllers import AnyController, Conditions
    from neuroflight.training.evaluation.thrust import Transparency


class Flight(NamedTuple):
    """Everything that is flown."""

    request: Tracking
    flown: Conditions
    controllers: Sequence[AnyController]
    throttles: Sequence[Number]
    bar: Bar


@dataclass(frozen=True, kw_only=True)
class Tracking(Commanded):
    """Errors and responses on the same unseen commands."""

    seed: Seed = 0
    mount: Mounted = None
    throttle: Annotated[
        tuple[float, ...] | None,
        Option(
            "T",
            "pilot's thrust, a comparison each; default: 0.3 in flights, as recorded with --commands, else 0",
            low=0.0,
            high=1.0,
            most=THROTTLES_MAX,
        ),
    ] = None
    no_noise: NoNoise = False
    delay: Annotated[
        Number, Option("S", "from command to rotor, not the aircraft's", low=0.0, high=0.1, unit="s")
    ] = None
    idle: Idle = None
    battery: Annotated[
        Number,
        Option(
            "CHARGE",
            "fly on the aircraft's battery, charged so far (1); default: the bench supply",
            low=0.0,
            high=1.0,
            number="?",
            bare=1.0,
        ),
    ] = None
    on: On = None
    thrust: Annotated[
        tuple[float, ...] | None,
        Option(
            "W",
            "fly each at the throttle that gives this thrust at rest, of the weight, or the nearest",
            low=0.0,
            high=THRUST_MAX,
            most=THROTTLES_MAX,
        ),
    ] = None
    transparency: Annotated[
        bool,
        Option(None, "thrust and motors at rest against the throttle, beside a transparent controller's"),
    ] = False
    average: Annotated[
        bool, Option(None, "also the average of all policies, as agents of several seeds, and the best")
    ] = False
    envelope: Annotated[Path | None, picture("draw errors over the commands of --suite envelope")] = None

    def fly(self, bar: Bar, ends: ExitStack) -> SuiteResult:
        """Fly all controllers at each throttle, or at each thrust."""
        self._check()
        given = self._conditions()
        throttles = self.throttle or (default_throttle(given),)
        controllers = self.opened(given.aircraft, ends, self.idle)
        flown = self._at_gyro_rate(given, controllers)
        told = None if self.thrust is not None else tuple(each for each in throttles if each is not None)
        request = replace(
            self,
            suite=None,
            task=None if self.commands else task_name(flown.task),
            episodes=None if self.commands else commands_flown(flown),
            mount=None if self.mount == "centre" else self.mount,
            throttle=None if told == (0.0,) == (default_throttle(flown),) else told or None,
        )
        fly = self._at_thrusts if self.thrust is not None else self._alone if self.one else self._at_throttles
        return fly(Flight(request, flown, controllers, throttles, bar))

    def _check(self) -> None:
        """Raise NeuroflightError where options exclude each other, or one has no effect."""
        if self.one and (len(self.everybody) != 1 or len(self.throttle or ()) > 1 or self.transparency):
            raise TrainingError(
                "--one: expected one controller (a policy, pid, pid:NAME, or betaflight) at one throttle, "
                "without --transparency"
            )
        if self.thrust is not None:
            own = "--thrust finds each controller's throttle; leave one of them out"
            self.refuse("throttle", "average", because=own)
        if self.average and (count := sum(map(is_policy, self.controllers))) < 2:
            raise TrainingError(f"--average: {count} policies, expected at least 2")
        envelope = "envelope" in (self.task, self.suite) and not self.one
        if not envelope or self.thrust is not None:
            self.refuse("envelope", because="draws --task envelope, without --thrust; use --plot for others")

    def _conditions(self) -> Conditions:
        """Return the conditions that are the same for all."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.physics.world import Mount
        from neuroflight.training.evaluation.controllers import Conditions

        task, episodes = self.commanded()
        aircraft = load_aircraft(self.aircraft)
        if self.delay is not None:
            aircraft = replace(aircraft, propulsion=replace(aircraft.propulsion, delay=self.delay))
        mount, noise = Mount(self.mount or "centre"), not self.no_noise
        return Conditions(aircraft, task, episodes, self.seed, mount=mount, noise=noise, charge=self.battery)

    def _at_gyro_rate(self, given: Conditions, controllers: Sequence[AnyController]) -> Conditions:
        """Return the conditions at the common gyro rate, with commands that sticks can express.

        Commands are rounded beside Betaflight, and where thrusts are compared.
        """
        from neuroflight.training.evaluation.controllers import at_gyro_rate

        thrusts = self.thrust is not None or self.transparency
        return at_gyro_rate(given, controllers, sticks=thrusts or any(map(is_betaflight, self.everybody)))

    def _document(self, flown: Conditions) -> dict[str, Any]:
        """Return the conditions that are the same for all, as JSON data."""
        return {
            **task_document(flown),
            "episodes": commands_flown(flown),
            "seed": flown.seed,
            "mount": flown.mount.value,
            "noise": flown.noise,
            "delay_s": flown.aircraft.propulsion.delay,
            "gyro_rate_hz": flown.gyro_rate_hz,
            "sticks": flown.sticks,
        }

    def _at_throttles(self, flight: Flight) -> SuiteResult:
        from neuroflight.cli.compare.figures import entry_documents, entry_tables
        from neuroflight.cli.compare.thrust import rest_documents, transparency_table
        from neuroflight.training.evaluation.comparison import average, enter
        from neuroflight.training.evaluation.envelope_plot import draw_envelope
        from neuroflight.training.evaluation.equal_thrust import all_transparency

        request, flown, controllers, throttles, bar = flight
        rounds: list[list[Entry]] = []
        for throttle in throttles:
            words = _throttle_words(throttle)
            rounds.append([enter(each, flown, throttle, bar(each.label + words)) for each in controllers])
        rests = all_transparency(controllers, flown, bar) if self.transparency else ()
        title = f"{flown.aircraft.name}: {flown_words(flown)}"
        titles = [title + _throttle_words(throttle) for throttle in throttles]
        averages: list[dict[str, Any]] = []
        for throttle, entries in zip(throttles, rounds, strict=True) if self.average else ():
            found = average([entry for entry in entries if is_policy(entry.controller.name)])
            averages.append(
                {"throttle": _told(throttle), **{name: plain(each) for name, each in found.items()}}
            )
        return SuiteResult(
            request=request,
            aircraft=flown.aircraft,
            document=lambda: {
                **self._document(flown),
                "comparison": [each for entries in rounds for each in entry_documents(entries)],
                **({"average": averages} if averages else {}),
                **(rest_documents(rests) if rests else {}),
            },
            tables=lambda: [
                *entry_tables(titles, rounds, averages, flown, everything=self.all),
                *([transparency_table(rests)] if rests else []),
            ],
            pictures={
                "plot": lambda: _drawn(flown, rounds[0], titles[0], rests),
                "envelope": lambda: draw_envelope(rounds[0], titles[0]),
            },
        )

    def _alone(self, flight: Flight) -> SuiteResult:
        from neuroflight.cli.compare.figures import alone_tables, flight_document
        from neuroflight.sim.analysis.response_plot import draw_response
        from neuroflight.sim.analysis.spectrum_plot import Line
        from neuroflight.training.evaluation.comparison import entered

        request, flown, controllers, throttles, bar = flight
        (controller,), (throttle,) = controllers, throttles
        flights = flown.fly(controller, throttle, bar(f"{commands_flown(flown)} commands"))
        entry = entered(flights, controller, flown, throttle)
        result = entry.evaluation
        title = f"{controller.name} on {flown.aircraft.name}: {flown_words(flown)}"

        def drawn() -> Figure | None:
            held = flights.hold()
            if drawn_as_flown(flown):
                return _drawn(flown, [entry], title, ())
            line = Line(controller.label, result.spectrum, result.smoothness)
            return draw_response(held, result.response, line, title) if held and result.response else None

        return SuiteResult(
            request=request,
            aircraft=flown.aircraft,
            document=lambda: {**self._document(flown), **flight_document(entry)},
            tables=lambda: alone_tables(title, result, flown, everything=self.all),
            pictures={"plot": drawn},
        )

    def _at_thrusts(self, flight: Flight) -> SuiteResult:
        from neuroflight.cli.compare.thrust import documents, equal_thrust_tables
        from neuroflight.training.evaluation.equal_thrust import equal_thrust

        request, flown, controllers, _, bar = flight
        assert self.thrust is not None
        found = equal_thrust(controllers, flown, self.thrust, bar)
        title = f"{flown.aircraft.name}: {flown_words(flown)}"
        first = found.levels[0]
        drawn = f"{title}, thrust {first.wanted:g}"
        return SuiteResult(
            request=request,
            aircraft=flown.aircraft,
            document=lambda: {**self._document(flown), **documents(found)},
            tables=lambda: equal_thrust_tables(title, found, flown, everything=self.all),
            pictures={"plot": lambda: _drawn(flown, first.entries, drawn, found.transparency)},
        )


def _told(throttle: Number) -> float | str:
    """Return a throttle as JSON data."""
    return "recorded" if throttle is None else throttle


def _throttle_words(throttle: Number) -> str:
    """Return the pilot's thrust, for titles, after a comma; nothing for none."""
    if throttle is None:
        return ", recorded throttle"
    return f", throttle {throttle:g}" if throttle else ""


def _drawn(flown: Conditions, entries: Sequence[Entry], title: str, rests: Sequence[Transparency]) -> Figure:
    """Draw one episode as all flew it where that says more than percentiles do; else all commands."""
    from neuroflight.training.evaluation.comparison_plot import draw_comparison
    from neuroflight.training.evaluation.tracking_plot import Tracked, draw_long, draw_step

    if not drawn_as_flown(flown):
        return draw_comparison(entries, title, rests)
    tracked = [Tracked(entry.controller.label, entry.curves.t, entry.curves.example) for entry in entries]
    held = all(entry.evaluation.response is not None for entry in entries)
    return draw_step(tracked, title) if held else draw_long(tracked, title)
