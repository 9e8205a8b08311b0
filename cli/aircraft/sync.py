"""`neuroflight aircraft sync`: what changed about an aircraft since its file, by a later log."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from neuroflight.cli.aircraft.flights import OfFlights, print_limits
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Option

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.identification.changes import Changes
    from neuroflight.sim.identification.fit.flight import Flight
    from neuroflight.sim.identification.fit.result import Fit
    from neuroflight.sim.identification.sag import Sag
    from neuroflight.training.fitness.margin import Margin

PIECE_S = 30.0  # of the flight's commands, flown side by side
PIECES_MAX = 4


@dataclass(frozen=True, kw_only=True)
class Sync(OfFlights):
    """A request for what changed about an aircraft."""

    aircraft: Annotated[str, Option("NAME|FILE", "the aircraft's own file, of before")]
    policy: Annotated[
        Path | None,
        Option("POLICY.onnx", "what it flies: its margin on the aircraft of the log (a minute or two)"),
    ] = None
    out: Annotated[
        Path | None,
        Option(
            "FILE.toml", "write the aircraft of the log, if anything changed", suffix=".toml", recorded=False
        ),
    ] = None

    more: ClassVar[str] = (
        ": a bent propeller, a new battery, a heavier camera, tired motors, each only if it is beyond what "
        "the log and the file can tell"
    )

    def run(self) -> int:
        """Fit, compare, tell. Returns 0."""
        from neuroflight.sim.aircraft.model import load_aircraft, parse_aircraft
        from neuroflight.sim.identification.changes import find_changes
        from neuroflight.sim.identification.fit.fit import fit
        from neuroflight.sim.identification.fit.write import fitted_text, start_text
        from neuroflight.sim.identification.sag import find_sag
        from neuroflight.toolchain.files import write_text

        self.check_new(self.out, self.aircraft)
        aircraft = load_aircraft(self.aircraft)
        text = start_text(self.aircraft)
        base = Path(self.aircraft).parent if Path(self.aircraft).is_file() else None
        with progress_bars(self.json) as bar:
            show = bar("reading")
            flights = self.flights(aircraft.motor_count)
            found = fit(flights, aircraft, progress=lambda stage: show(0.0, None, stage))
            sag = find_sag(flights, aircraft)
            changes = find_changes(found, aircraft, sag)
            if changes:
                text = _with_battery(fitted_text(text, aircraft, found), changes, found)
            name = str(self.out or self.aircraft)
            synced = parse_aircraft(text.encode(), name, self.out.parent if self.out and base else base)
            margin, errors = None, None
            if self.policy is not None:
                show(0.0, None, "the policy on both aircraft")
                errors = self._errors(aircraft, synced, changes, found)
                if changes:
                    margin = self._margin(aircraft, synced, changes)
        written = self.out if changes and self.out is not None else None
        if written is not None:
            write_text(written, text)
        if self.json:
            print_json(
                {
                    "changes": changes.document(),
                    "fit": found.document(),
                    "flight": errors,
                    "margin": None if margin is None else margin.document(),
                    "written": None if written is None else str(written),
                }
            )
        else:
            self._print(found, changes, sag, flights)
            self._advise(changes, margin, errors, written)
        return 0

    def _margin(self, aircraft: Aircraft, synced: Aircraft, changes: Changes) -> Margin:
        """Fly the policy on both aircraft, beside a reference if there is one without building anything."""
        from neuroflight.cli.policy.check import find_betaflight
        from neuroflight.toolchain.errors import AircraftError
        from neuroflight.training.fitness.margin import find_margin
        from neuroflight.training.fitness.references import References

        assert self.policy is not None
        with ExitStack() as ends:
            betaflight, missing = find_betaflight(synced, None, build=False)
            try:
                references = ends.enter_context(References(synced, self.aircraft, betaflight, missing))
            except AircraftError:
                references = None
            return find_margin(self.policy, aircraft, synced, changes.strengths, references)

    def _errors(
        self, aircraft: Aircraft, synced: Aircraft, changes: Changes, found: Fit
    ) -> dict[str, float] | None:
        """Compare the first log's error with those of its commands in both twins; None: it has none."""
        from neuroflight.sim.recorded.files import load_commands
        from neuroflight.toolchain.contract import AXES
        from neuroflight.toolchain.errors import ScenarioError, TraceError
        from neuroflight.training.evaluation.controllers import load_controller
        from neuroflight.training.fitness.margin import predicted_error
        from neuroflight.training.tasks.pieces import RecordedPieces

        try:
            flown = _flown_error(self.logs[0], self.part)
            commands = load_commands(self.logs[0], self.part, self.lines, cut=True)
        except (ScenarioError, TraceError):
            return None
        pieces = RecordedPieces.cut(commands.scenario(), max(PIECE_S, commands.length_s / PIECES_MAX))
        controller = load_controller(str(self.policy), aircraft)
        noise = [found.parameters[f"gyro.noise.{axis}"].value for axis in AXES]
        before = predicted_error(controller, aircraft, pieces, noise)
        after = predicted_error(controller, synced, pieces, noise, changes.strengths) if changes else before
        return {"logged": flown, "by_file": before, "by_log": after}

    def _print(self, found: Fit, changes: Changes, sag: Sag | None, flights: list[Flight]) -> None:
        from neuroflight.sim.identification.fit.result import share_words

        if changes.numbers:
            rows = [("", "file", "log", "95 % interval")]
            for one in changes.numbers.values():
                unit = f" [{one.unit}]" if one.unit else ""
                rows.append(
                    (
                        f"{one.words}{unit}",
                        f"{one.before:.4g}",
                        f"{one.after:.4g}",
                        f"{one.low:.4g} to {one.high:.4g}",
                    )
                )
            print_table(
                f"{found.name}: {found.seconds:.0f} s of flight",
                rows,
                numbers={"file", "log", "95 % interval"},
            )
        print(
            f"of what your sticks did to it, {self.aircraft} predicts: {share_words(found.explained_start)}; "
            f"with the log's numbers: {share_words(found.explained)}"
        )
        if not changes:
            print(
                f"nothing changed: every number that {found.name} tells is the file's, as far as both are "
                "known"
            )
        for cause in changes.causes:
            print(f"- {cause}")
        if sag is None and not any(flight.has_voltage for flight in flights):
            print("the log has no voltage: a battery that changed looks like weight or weaker rotors")
        print_limits(found)

    def _advise(
        self, changes: Changes, margin: Margin | None, errors: dict[str, float] | None, written: Path | None
    ) -> None:
        """Print the policy's margin, and what to do."""
        if errors is not None:
            print(
                f"this flight's commands: MAE {errors['logged']:.2f} deg/s against the gyro as logged, "
                f"{errors['by_file']:.2f} by {self.policy} in the twin of the file"
                + (f", {errors['by_log']:.2f} in that of the log" if changes else "")
            )
        if margin is not None:
            own, synced = margin.own, margin.synced
            print(
                f"{self.policy} in the twins, unseen commands: MAE {float(own.mae.value):.2f} deg/s as its "
                f"file says, {float(synced.mae.value):.2f} as the log says ({margin.worse:.2f} times), "
                f"motors' change {own.change:.4f} and {synced.change:.4f} in 1 ms, drift {own.drift:.1f} and "
                f"{synced.drift:.1f} deg"
            )
            if margin.verdict is not None:
                met = sum(bar.met for bar in margin.verdict.bars)
                print(f"policy check on the log's aircraft: {met} of {len(margin.verdict.bars)} bars met")
                for reason in margin.verdict.reasons:
                    print(f"- {reason}")
            if not margin.refine:
                print("it keeps its margin: a refinement would gain little")
        if written is not None:
            print(f"wrote {written}")
        if changes and (margin is None or margin.refine):
            file = written or Path("mine-2.toml")
            if written is None:
                print(f"write the log's aircraft by --out {file}, then refine the policy on it:")
            else:
                print("refine the policy on it, a minute; swap it by yourself:")
            if changes.uneven:
                print("  (the twin's motors are alike: mend the weak one first)")
            run = self.policy.parent if self.policy is not None else Path("RUN")
            out = Path("runs") / file.stem
            print(f"  neuroflight policy train --from {run} --aircraft {file} --out {out}")
            print(f"  neuroflight policy check {out / 'policy.onnx'} --aircraft {file}")
            print(f"  neuroflight board policy swap {out / 'policy.onnx'} --other-aircraft --port PORT")


def _with_battery(text: str, changes: Changes, found: Fit) -> str:
    """Put the pack's resistance into a file's text, if it changed."""
    from neuroflight.sim.aircraft.edit import with_key, with_known
    from neuroflight.sim.aircraft.known import How, Known

    one: Any = changes.numbers.get("battery.resistance_ohm")
    if one is None:
        return text
    text = with_key(text, "battery", "resistance_ohm", float(f"{one.after:.4g}"))
    return with_known(text, {one.key: Known(How.MEASURED, (one.low, one.high), f"sag in {found.name}")})


def _flown_error(path: Path, part: Any) -> float:  # noqa: ANN401 - Part, whose room is imported late
    """Compute the MAE [deg/s] of a logged flight, setpoint less gyro. Raises TraceError."""
    from neuroflight.sim.blackbox.flight import cut, log_flight, trace_flight
    from neuroflight.sim.blackbox.log import read_log
    from neuroflight.sim.flight.trace import load_trace
    from neuroflight.sim.recorded.log import split_number

    file, number = split_number(path)
    if file.suffix == ".npz":
        flight = trace_flight("trace", cut(load_trace(file), part))
    else:
        flight = log_flight(read_log(file, number), part)
    return float(flight.figures.gyro_mae.mean())
