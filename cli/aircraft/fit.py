"""`neuroflight aircraft fit`: the twin of an aircraft from logs of ordinary flights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from neuroflight.cli.aircraft.flights import OfFlights, print_limits
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Option
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.fit.flight import Flight
    from neuroflight.sim.identification.fit.result import Fit

MOTORS = 4  # of an aircraft without a file


@dataclass(frozen=True, kw_only=True)
class FitAircraft(OfFlights):
    """A request for an aircraft file from logs."""

    aircraft: Annotated[
        str | None,
        Option("NAME|FILE", "the file to begin with; default: one typical of --weight, --arm and --props"),
    ] = None
    weight: Annotated[
        float | None, Option("KG", "of the aircraft with its battery", low=0.015, high=100.0, unit="kg")
    ] = None
    arm: Annotated[
        float | None, Option("M", "from a motor to the middle of the four", low=0.015, high=1.0, unit="m")
    ] = None
    props: Annotated[
        str | None,
        Option("SIZE", "of the propellers: diameter x pitch x blades in inches, 5.1x4.3x3, or 31mmx4"),
    ] = None
    kv: Annotated[
        float | None, Option("KV", "of the motors, if known", low=50.0, high=60000.0, unit="rpm/V")
    ] = None
    cells: Annotated[
        int | None, Option("N", "of the battery; default: by the log's voltage", low=1, high=14)
    ] = None
    out: Annotated[Path, Option("FILE.toml", "the aircraft file that is written", suffix=".toml")]
    report: Annotated[
        Path | None, Option("FILE.html", "a page with what was held back, and its prediction", suffix=".html")
    ] = None

    more: ClassVar[str] = (
        ": authority, response, delay and curve of the rotors, yaw torque, noise of the gyro, motor order, "
        "each with its 95 % interval, and what the logs cannot tell with the manoeuvre that would"
    )

    def run(self) -> int:
        """Fit, write the aircraft, print the figures. Returns 0."""
        from neuroflight.sim.aircraft.model import load_aircraft, parse_aircraft
        from neuroflight.sim.identification.fit.fit import fit
        from neuroflight.sim.identification.fit.write import fitted_text, start_text
        from neuroflight.toolchain.files import write_text

        if self.aircraft is None and self.weight is None:
            raise NeuroflightError(
                "give --weight KG, and --arm and --props, or an aircraft file to begin with (--aircraft)"
            )
        if (
            self.aircraft is not None
            and (self.weight, self.arm, self.props, self.kv, self.cells) != (None,) * 5
        ):
            raise NeuroflightError(
                "aircraft fit: --aircraft has weight, arm and propellers: give it or these"
            )
        self.check_new(self.out, self.aircraft)
        with progress_bars(self.json) as bar:
            show = bar("reading")
            start = load_aircraft(self.aircraft) if self.aircraft is not None else None
            flights = self.flights(MOTORS if start is None else start.motor_count)
            if start is None:
                text = self._typical(flights)
                start = parse_aircraft(text.encode(), "typical")
            else:
                text = start_text(str(self.aircraft))
            found = fit(flights, start, progress=lambda stage: show(0.0, None, stage))
            text = fitted_text(text, start, found)
            parse_aircraft(text.encode(), str(self.out), self.out.parent)
            if self.report is not None:
                from neuroflight.sim.identification.fit.report import report_page

                show(0.0, None, "report")
                write_text(self.report, report_page(flights, start, found))
        write_text(self.out, text)
        if self.json:
            print_json({**found.document(), "written": str(self.out)})
        else:
            _print(found, self.out, self.report)
        return 0

    def _typical(self, flights: list[Flight]) -> str:
        """Return the text of a typical aircraft of these answers."""
        from neuroflight.sim.aircraft.typical import Answers, Propeller, typical

        assert self.weight is not None
        answers = Answers(
            weight_kg=self.weight,
            cells=self.cells if self.cells is not None else _cells(flights),
            kv=self.kv,
            propeller=None if self.props is None else Propeller.parse(self.props),
            arm_m=self.arm,
            name=self.out.stem,
        )
        return typical(answers).text


def _cells(flights: list[Flight]) -> int | None:
    """Return the cells in series by the highest voltage of the logs: none is above 4.35 V."""
    highest = [
        float(piece.voltage.max()) for one in flights for piece in one.pieces if piece.voltage is not None
    ]
    return max(1, -int(-max(highest) // 4.35)) if highest else None


def _print(fit: Fit, out: Path, report: Path | None) -> None:
    from neuroflight.sim.identification.fit.result import share_words

    rows = [("", "start", "fit", "95 % interval", "told by")]
    for one in fit.parameters.values():
        bounds = f"{one.low:.4g} to {one.high:.4g}" if one.high > one.low else ""
        unit = f" [{one.unit}]" if one.unit else ""
        rows.append(
            (
                f"{one.words}{unit}",
                f"{one.start:.4g}",
                f"{one.value:.4g}",
                bounds,
                one.data if one.told else "not told",
            )
        )
    print_table(f"{fit.name}: {fit.seconds:.0f} s of flight", rows, numbers={"start", "fit", "95 % interval"})
    print(f"of what your sticks did to it, the fit predicts: {share_words(fit.explained)}")
    print(f"the file it began with predicts: {share_words(fit.explained_start)} (both on data held back)")
    if fit.rewired:
        order = ", ".join(str(rotor + 1) for rotor in fit.order)
        print(f"motor order: logged motors drive the start file's rotors {order}")
    if fit.props_out:
        print("propellers turn the other way than in the start file; the written file has it so")
    print_limits(fit)
    print(f"wrote {out}" + (f" and {report}" if report is not None else ""))
    print(f"look at it: neuroflight aircraft check {out}")
    print(f"a policy:   neuroflight policy train --from any --aircraft {out} --out {Path('runs') / out.stem}")
