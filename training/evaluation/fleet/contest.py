"""Controllers of the fleet as a user names them, and the work of flying one aircraft with all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.ports.betaflight.build import Betaflight
from neuroflight.sim.ports.betaflight.fleet import ArmedBetaflight
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.policy.label import policy_label
from neuroflight.training.evaluation.betaflight import BETAFLIGHT, BetaflightSpec, betaflight_facts
from neuroflight.training.evaluation.controllers import AnyController, load_controller
from neuroflight.training.evaluation.fleet.arena import Figures, Plan, meet
from neuroflight.training.evaluation.fleet.scaled_pid import REFERENCE, SCALED, scaled_pid
from neuroflight.training.evaluation.fleet.store import keep, kept, place
from neuroflight.training.evaluation.fleet.unseen import Unseen

OWN = "own"  # own:DIR: of each aircraft the policy DIR/AIRCRAFT/policy.onnx, where there is one
TOLD = ("exact", "new", "nothing")  # what a policy that takes the aircraft's numbers is told of it
Show = Callable[[float], None]


@dataclass(frozen=True)
class Entrant:
    """A controller of the fleet: another one on each aircraft, under one name."""

    name: str  # as the user wrote it
    path: str  # without what stands behind @
    told: str = TOLD[0]

    @property
    def label(self) -> str:
        """A short name for tables and plots."""
        if self.name == SCALED:
            return "PID scaled"
        if self.name == BETAFLIGHT:
            return "Betaflight 4.6"
        if self.own:
            return "own policy"
        tail = "" if self.told == TOLD[0] and "@" not in self.name else f" @{self.told}"
        return f"{policy_label(self.path)}{tail}"

    @property
    def own(self) -> bool:
        """True if it is a policy that was trained on each aircraft."""
        return self.path.partition(":")[0] == OWN

    @staticmethod
    def of(name: str) -> Entrant:
        """Parse a name. Raises TrainingError, one line."""
        path, at, told = name.partition("@")
        if at and told not in TOLD:
            raise TrainingError(f"{name}: got @{told}, expected one of @{', @'.join(TOLD)}")
        kind, colon, which = path.partition(":")
        if kind == "pid" and path != SCALED:
            raise TrainingError(f"{name}: no aircraft of the fleet has a PID of its own; fly {SCALED}")
        if kind == BETAFLIGHT and colon:
            raise TrainingError(f"{name}: in the fleet Betaflight flies with its defaults; fly {BETAFLIGHT}")
        if kind == OWN and not Path(which).is_dir():
            raise TrainingError(f"{name}: no folder {which!r}; it holds AIRCRAFT/policy.onnx of each")
        return Entrant(name, path, told if at else TOLD[0])

    def facts(self, aircraft: Unseen) -> dict[str, str] | None:
        """Return what its flights on the aircraft depend on; None: it does not fly it."""
        if self.name == BETAFLIGHT:
            return betaflight_facts(None)
        spec = self.controller(aircraft)
        if spec is None:
            return None
        return {**spec.facts, "idle": f"{spec.idle:g}", "told": self._told(aircraft).sha256}

    def controller(self, aircraft: Unseen) -> AnyController | None:
        """Return it for the aircraft, None if it does not fly it; Betaflight is opened by `fly_all`."""
        if self.name == SCALED:
            return scaled_pid(aircraft.truth)
        path = self.path
        if self.own:
            file = Path(path.partition(":")[2]) / aircraft.name / "policy.onnx"
            if not file.is_file():
                return None
            path = str(file)
        return replace(load_controller(path, self._told(aircraft)), name=self.name)

    def _told(self, aircraft: Unseen) -> Aircraft:
        if self.told == "nothing":
            return load_aircraft(REFERENCE)
        return aircraft.truth if self.told == "exact" else aircraft.told


def fly_all(
    entrants: Sequence[Entrant],
    aircraft: Unseen,
    plan: Plan,
    built: Betaflight | None,
    folder: Path | None,
    show: Show,
) -> dict[str, dict[str, Figures]]:
    """Fly an aircraft with everybody; return figures by name and kind of flight.

    built: of Betaflight, if it takes part; folder: where figures are kept, and taken from.
    """
    found = {}
    for number, entrant in enumerate(entrants):

        def part(done: float, number: int = number) -> None:
            show((number + done) / len(entrants))

        facts = entrant.facts(aircraft)
        if facts is None:
            continue
        file = None if folder is None else place(folder, aircraft, entrant.told, facts, plan)
        figures = {} if file is None else kept(file)
        missing = tuple(kind for kind in plan.flights if kind not in figures)
        if missing:
            with ExitStack() as ends:
                controller: AnyController | None
                if entrant.name == BETAFLIGHT:
                    assert built is not None
                    armed = ends.enter_context(ArmedBetaflight(built, aircraft.truth))
                    controller = BetaflightSpec(armed)
                else:
                    controller = entrant.controller(aircraft)
                assert controller is not None
                figures |= meet(controller, aircraft, replace(plan, flights=missing), part)
            if file is not None:
                keep(file, figures)
        found[entrant.name] = {kind: figures[kind] for kind in plan.flights}
        show((number + 1) / len(entrants))
    return found
