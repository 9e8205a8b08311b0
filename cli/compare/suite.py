"""An evaluation as data: a request whose fields are its options, and what its flights give.

A new one is a file of `cli/compare/suites` with a subclass of `Suite`; `compare` finds it there.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from neuroflight.cli import options
from neuroflight.cli.compare.controllers import (
    CONTROLLER,
    betaflight_tune,
    check_controllers,
    is_betaflight,
    say_foreign,
)
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import Table, print_table
from neuroflight.cli.requests import Argument, Option, Request

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.ports.betaflight.build import Betaflight
    from neuroflight.training.evaluation.controllers import AnyController

MOUNTS = ("centre", "rig", "free")
IDLE_MAX = 0.5
THROTTLES_MAX = 20
THRUST_MAX = 20.0  # of the weight
Bar = Callable[[str], Callable[[int, int], None]]  # adds a bar of that name and gives its update
Seed = Annotated[int, Option("S", "of commands, noise and bias", low=0)]
Mounted = Annotated[str | None, Option(None, "what holds the aircraft; default: centre", choices=MOUNTS)]
NoNoise = Annotated[bool, Option(None, "an ideal gyro")]
Idle = Annotated[
    float | None,
    Option("U", "motor fraction at no thrust; default: the controller's own", low=0.0, high=IDLE_MAX),
]
On = Annotated[
    str | None,
    Option(None, "add Betaflight with its defaults; all then fly as it does", choices=("betaflight",)),
]


@dataclass(frozen=True)
class SuiteResult:
    """The result of a suite."""

    request: Suite  # with what was left open filled in, as the printed command has it
    aircraft: Aircraft
    document: Callable[[], Mapping[str, Any]]  # JSON behind command and aircraft
    tables: Callable[[], Sequence[Table]]
    pictures: Mapping[str, Callable[[], Figure | None]]  # by the option that names the file; None: nothing


@dataclass(frozen=True, kw_only=True)
class Suite(Request):
    """Options that every suite has."""

    names: ClassVar[tuple[str, ...]]  # for --suite
    every: ClassVar[Mapping[str, type[Suite]]] = {}  # by name, from `cli/compare/compare.py`

    controllers: Annotated[
        tuple[str, ...],
        Argument(
            CONTROLLER,
            "policies, PIDs of the aircraft, classes of yours, Betaflight; differences are to the first",
        ),
    ] = ()
    suite: Annotated[str | None, Option("NAME", "what is flown; default: flights")] = None
    aircraft: options.Aircraft = "nf1"
    plot: options.Plot = None
    build: options.Build = None
    all: Annotated[bool, Option(None, "print every figure, not the headline alone", recorded=False)] = False
    json: options.Json = False

    @classmethod
    def add_arguments(cls, parser: argparse.ArgumentParser) -> None:
        """Declare every field; --suite names all suites that there are."""
        super().add_arguments(parser)
        parser.description = f"{parser.description}. {cls.__doc__}"
        (suite,) = (action for action in parser._actions if action.dest == "suite")
        suite.choices = tuple(cls.every)
        suite.help = (
            f"what is flown: {', '.join(cls.every)}; each has options of its own, see --suite NAME --help"
        )

    def fly(self, bar: Bar, ends: ExitStack) -> SuiteResult:
        """Fly all controllers. Resources to close afterwards go to `ends`. Raises NeuroflightError."""
        raise NotImplementedError

    @property
    def everybody(self) -> list[str]:
        """The names of all controllers."""
        asked = getattr(self, "on", None)
        return [*self.controllers, *([asked] if asked and asked not in self.controllers else [])]

    def opened(self, aircraft: Aircraft, ends: ExitStack, idle: float | None = None) -> list[AnyController]:
        """Load all controllers. A Betaflight is built if need be, armed, and ends with `ends`.

        idle: replaces that of each unless None. A policy that was trained on another aircraft is told.
        """
        from neuroflight.sim.ports.betaflight.fleet import ArmedBetaflight
        from neuroflight.training.evaluation.betaflight import BetaflightSpec
        from neuroflight.training.evaluation.controllers import load_controller

        found: list[AnyController] = []
        for name in self.everybody:
            if is_betaflight(name):
                tune = betaflight_tune(name, self.aircraft)
                armed = ArmedBetaflight(self.built_betaflight(aircraft), aircraft, tune)
                found.append(BetaflightSpec(ends.enter_context(armed), name))
            else:
                found.append(load_controller(name, aircraft, idle))
        say_foreign(found)
        return found

    def built_betaflight(self, aircraft: Aircraft) -> Betaflight:
        """Build Betaflight unless it is there. Raises AircraftError if it cannot fly the aircraft."""
        from neuroflight.cli.fly.ports import built_betaflight

        return built_betaflight(aircraft, self.build, quiet=self.json)

    def run(self) -> int:
        """Fly, draw and print."""
        from neuroflight.sim.plotting import save_png

        check_controllers(self.everybody)
        with ExitStack() as ends, progress_bars(self.json) as bar:
            flown = self.fly(bar, ends)
        for option, draw in flown.pictures.items():
            path = getattr(self, option)
            if path and (figure := draw()):
                save_png(path, figure)
            elif path:
                print(f"--{option}: {path} is not drawn: no command is held for a second", file=sys.stderr)
        if self.json:
            aircraft = {"aircraft": flown.aircraft.name, "aircraft_sha256": flown.aircraft.sha256}
            print(json.dumps({"command": flown.request.command, **aircraft, **flown.document()}, indent=2))
        else:
            for table in flown.tables():
                print_table(table.title, table.rows, table.note)
        return 0
