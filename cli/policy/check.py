"""`neuroflight policy check POLICY --aircraft FILE`: judge if a policy is fit to fly, and write its stamp."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.options import Build, Json
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Argument, Option, Request

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.ports.betaflight.build import Betaflight
    from neuroflight.training.fitness.check import Verdict


@dataclass(frozen=True, kw_only=True)
class Check(Request):
    """A request to judge if a policy is fit to fly."""

    policy: Annotated[Path, Argument("POLICY.onnx", "to judge")]
    aircraft: Annotated[str, Option("NAME|FILE", "that it is to fly: shipped name or a .toml file")]
    no_stamp: Annotated[bool, Option(None, "write no POLICY.check.json, which build and flash ask for")] = (
        False
    )
    build: Build = None
    json: Json = False

    def run(self) -> int:
        """Check, write the stamp, print. Returns 0 if the policy is fit, else 1."""
        from neuroflight.cli.compare.controllers import say_foreign
        from neuroflight.cli.output import check_output
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.control.any_policy import own_file
        from neuroflight.toolchain.policy.check_stamp import stamp_path, write_stamp
        from neuroflight.training.evaluation.controllers import load_controller
        from neuroflight.training.fitness.check import check
        from neuroflight.training.fitness.references import References

        aircraft = load_aircraft(self.aircraft)
        policy = own_file(self.policy, aircraft)
        say_foreign([load_controller(str(policy), aircraft)])
        if not self.no_stamp:
            check_output(stamp_path(policy), ".json")
        betaflight, missing = find_betaflight(aircraft, self.build, build=True)
        with ExitStack() as ends:
            references = ends.enter_context(References(aircraft, self.aircraft, betaflight, missing))
            bar = ends.enter_context(progress_bars())
            verdict = check(policy, aircraft, references, bar(f"checking {policy.name}"))
        if not self.no_stamp:
            write_stamp(policy, verdict.document())
        if self.json:
            print_json(verdict.document() | {"cases": verdict.cases()})
        else:
            print_verdict(verdict, policy)
        return int(not verdict.fit)


def find_betaflight(aircraft: Aircraft, folder: Path | None, *, build: bool) -> tuple[Betaflight | None, str]:
    """Return Betaflight, if it can fly the aircraft; else None and why. build: unless built already."""
    from neuroflight.cli.fly.ports import BETAFLIGHT
    from neuroflight.sim.ports.betaflight.build import build_betaflight, is_built
    from neuroflight.sim.ports.betaflight.port import aircraft_settings
    from neuroflight.toolchain.errors import NeuroflightError

    place = folder or BETAFLIGHT
    try:
        aircraft_settings(aircraft)
        if not build and not is_built(place):
            return None, "Betaflight is not built; `neuroflight policy check` builds it"
        return build_betaflight(
            place, lambda stage: print(f"Betaflight is not built yet, once: {stage}", file=sys.stderr)
        ), ""
    except NeuroflightError as error:
        return None, f"Betaflight: {error}"


def print_verdict(verdict: Verdict, policy: Path) -> None:
    """Print the table of the bars, the reasons, and one line with the verdict."""
    rows = [("", "seen", "at most", "unit", "where", " ")]
    for bar in verdict.bars:
        seen, worst = (f"{value:.3g}" for value in (bar.worst.seen, bar.worst.limit))
        rows.append((bar.name, seen, worst, bar.unit, bar.worst.where, "" if bar.met else "FAILED"))
    print_table("", rows, numbers=("seen", "at most"))
    print_end(verdict, policy)


def print_end(verdict: Verdict, policy: Path) -> None:
    """Print the reasons, the missing parts, and one line with the verdict."""
    for reason in verdict.reasons:
        print(f"- {reason}")
    for missing in verdict.missing:
        print(f"not compared with one reference: {missing}")
    if above := verdict.above_least:
        words = ", ".join(f"{where} {100 * mae:.0f} and {100 * mse:.0f} %" for where, mae, mse in above)
        print(f"MAE and MSE above the least that any motors could leave, without noise: {words}")
    met = sum(bar.met for bar in verdict.bars)
    told = "fit" if verdict.fit else "NOT fit"
    print(
        f"{policy} is {told} to fly {verdict.aircraft.name}: {met} of {len(verdict.bars)} bars met, beside "
        f"{' and '.join(each.label for each in verdict.references)}"
    )
