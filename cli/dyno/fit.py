"""`neuroflight dyno fit`: a rotor's model from the log of a dynamometer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.dyno.repeats import print_repeats, repeats_document
from neuroflight.cli.dyno.run import COLUMNS
from neuroflight.cli.options import Json, picture
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Argument, Option, Request
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.dyno.fit import Fit
    from neuroflight.sim.identification.dyno.response import ResponseFit
    from neuroflight.sim.identification.dyno.robust_fit import Estimate


@dataclass(frozen=True, kw_only=True)
class MakeFit(Request):
    """A request to fit a rotor's model to a dynamometer's log."""

    data: Annotated[
        tuple[Path, ...],
        Argument(
            "DATA.csv",
            f"one or more runs: {COLUMNS}; or logs of a thrust stand's program whose headings name units "
            "(RCbenchmark, Tyto and their like)",
        ),
    ]
    column: Annotated[
        tuple[str, ...],
        Option(
            "QUANTITY=HEADING",
            "which column holds the time, throttle, speed, thrust or torque, where headings leave it open",
            once=True,
        ),
    ] = ()
    unit: Annotated[
        tuple[str, ...],
        Option("QUANTITY=UNIT", "unit of a column whose heading names none, such as thrust=gf", once=True),
    ] = ()
    poles: Annotated[
        int | None,
        Option("N", "magnets of the motor, where the log counts electrical turns: they are divided by N/2"),
    ] = None
    esc_us: Annotated[
        tuple[float, ...] | None,
        Option(
            ("ZERO", "FULL"),
            "pulses that the ESC takes for 0 and full throttle, where the log has its signal in us",
            number=2,
        ),
    ] = None
    aircraft: Annotated[
        str | None, Option("NAME|FILE", "whose rotor inertia turns accelerations into torques")
    ] = None
    write: Annotated[
        Path | None,
        Option(
            "AIRCRAFT.toml",
            "put the fit into this aircraft file; made from --aircraft if that is another",
            suffix=".toml",
        ),
    ] = None
    response: Annotated[
        str, Option(None, "auto: the one that fits better", choices=("auto", "torque", "first_order"))
    ] = "auto"
    speed_dependent: Annotated[bool, Option(None, "K_T and K_Q may be polynomials of speed")] = False
    delay: Annotated[
        float | None,
        Option("S", "latency from command to rotor; default: fitted", low=0.0, high=0.1, unit="s"),
    ] = None
    inertia: Annotated[
        float | None,
        Option("KG_M2", "rotor inertia, instead of the file's", low=1e-12, high=10.0, unit="kg m²"),
    ] = None
    plot: Annotated[Path | None, picture("draw the model beside the data")] = None
    json: Json = False

    def run(self) -> int:
        """Fit, write the outputs, print the figures. Returns 0."""
        from neuroflight.sim.aircraft.model import aircraft_file, load_aircraft
        from neuroflight.sim.identification.dyno.fit import fit
        from neuroflight.sim.identification.dyno.points import PointsFit, fit_points
        from neuroflight.sim.identification.dyno.stand import choices, read_logs
        from neuroflight.toolchain.errors import DynoError

        name = self.aircraft if self.aircraft is not None else self.write
        if self.aircraft is None and self.write is not None and not self.write.is_file():
            raise NeuroflightError(
                f"--write {self.write}: no such file, expected an aircraft to put the fit into; "
                f"give --aircraft NAME|FILE to make it from another"
            )
        aircraft = load_aircraft(name) if name is not None else None
        with progress_bars(self.json) as bar:
            show = bar("reading")
            chosen = choices(self.column, self.unit, self.poles, self.esc_us)
            recording, stands, reason = read_logs(self.data, chosen)
            found: Fit | PointsFit | None = None
            if recording is not None:
                try:
                    found = fit(
                        recording,
                        kind=self.response,
                        delay=self.delay,
                        speed_dependent=self.speed_dependent,
                        progress=lambda stage: show(0.0, None, stage),
                    )
                except DynoError as error:
                    if not stands:
                        raise
                    reason = f"no speed curve and response: {error}"
            if found is None:
                found = fit_points(stands, reason, speed_dependent=self.speed_dependent)
        title = ", ".join(path.name for path in self.data)
        if self.write:
            from neuroflight.sim.identification.dyno.write import write_fit

            write_fit(aircraft_file(self.aircraft or self.write), self.write, found, title, self.inertia)
        if self.plot:
            from neuroflight.sim.identification.dyno.plot import save_fit_plot

            save_fit_plot(self.plot, found, f"{title}: dynamometer fit")
        inertia = self.inertia
        if inertia is None and aircraft is not None:
            inertia = aircraft.propulsion.rotor_inertia
        if isinstance(found, PointsFit):
            from neuroflight.cli.dyno.points import points_document, print_points

            if self.json:
                print_json(points_document(self.data, found, self.write))
            else:
                print_points(title, found, self.write)
        elif self.json:
            print_json(_document(self, found, inertia))
        else:
            _print_fit(title, found, inertia, self.write)
        return 0


def _document(args: MakeFit, fit: Fit, inertia: float | None) -> dict[str, Any]:
    from neuroflight.cli.dyno.points import estimate
    from neuroflight.sim.aircraft.model import RPM

    def response(item: ResponseFit | None) -> dict[str, Any] | None:
        if item is None:
            return None
        document: dict[str, Any] = {"kind": item.kind}
        if item.kind == "first_order":
            document["time_constant_up_s"] = estimate(item.time_constant_up)
            document["time_constant_down_s"] = estimate(item.time_constant_down)
        else:
            document["gain_per_inertia"] = estimate(item.rate_up)
            document["up_per_inertia"] = estimate(item.slew_up)
            document["down_per_inertia"] = estimate(item.slew_down)
            document["up_reached"], document["down_reached"] = item.reached
            if inertia is not None:
                document["gain"] = estimate(item.rate_up, inertia)
                document["torque_up_n_m"] = estimate(item.slew_up, inertia)
                document["torque_down_n_m"] = estimate(item.slew_down, inertia)
        document["delay_s"] = estimate(item.delay)
        document["speed_rms_percent"] = 100 * item.rms / fit.speed_max
        return document

    from neuroflight.sim.identification.bench.summary import repeats

    return {
        "data": [str(path) for path in args.data],
        "rows": len(fit.recording.time),
        "runs": len(fit.recording.starts),
        "speed_max_rpm": fit.speed_max / RPM,
        "speed_curve_rpm": [estimate(term, 1 / RPM) for term in fit.speed_curve],
        "thrust_coefficient": [estimate(term) for term in fit.thrust_coefficient],
        "torque_ratio_m": [estimate(term) for term in fit.torque_ratio] or None,
        "rotor_inertia_kg_m2": inertia,
        "response": response(fit.response),
        "rejected_response": response(fit.rejected),
        "reason": fit.reason,
        "notes": list(fit.notes),
        "speed_errors_percent": [
            {
                "throttle": error.level,
                "mae": 100 * error.mae,
                "rms": 100 * error.rms,
                "max": 100 * error.largest,
                "model_rms": 100 * error.model_rms,
                "model_max": 100 * error.model_largest,
            }
            for error in fit.speed_errors
        ],
        "thrust_mae_n": fit.thrust_mae,
        "torque_mae_n_m": fit.torque_mae if fit.torque_ratio else None,
        "outliers": dict(
            zip(("rpm", "thrust", "torque"), (int(off.sum()) for off in fit.outliers), strict=True)
        ),
        "repeats": repeats_document(repeats(fit.recording)),
        "written": None if args.write is None else str(args.write),
    }


def _print_fit(title: str, fit: Fit, inertia: float | None, written: Path | None) -> None:
    from neuroflight.cli.dyno.points import print_parameters
    from neuroflight.sim.identification.bench.summary import repeats

    outliers = [int(off.sum()) for off in fit.outliers]
    print_parameters(f"{title}: {len(fit.recording.time)} rows", _parameters(fit, inertia))
    errors: list[tuple[str, ...]] = [("throttle", "MAE", "RMS", "max", "model RMS", "model max")]
    for part in fit.speed_errors:
        values = (part.mae, part.rms, part.largest, part.model_rms, part.model_largest)
        level = "elsewhere" if part.level is None else f"step to {100 * part.level:.0f} %"
        errors.append((level, *(f"{100 * value:.2f}" for value in values)))
    print_table("\nspeed error, % of top speed", errors)
    if repeated := repeats(fit.recording):
        title = f"\n{repeated.runs} runs: mean ± 95 % interval"
        print_repeats(title, repeated.steps, repeated.ramp_top)
    lines = [
        "model: data minus model averaged over 50 ms, so that noise is not counted; outliers left out",
        f"thrust MAE {fit.thrust_mae:.3g} N"
        + (f", torque MAE {fit.torque_mae:.3g} N m; " if fit.torque_ratio else "; ")
        + f"outliers: {outliers[0]} rpm, {outliers[1]} thrust, {outliers[2]} torque",
        f"response {fit.reason}" if fit.response is not None else fit.reason,
    ]
    if fit.response is not None and fit.response.kind == "torque" and inertia is None:
        lines.append(
            "a bench shows torques only divided by the rotor's inertia: give --aircraft or --inertia to "
            "have them in N m"
        )
    lines += [f"note: {note}" for note in fit.notes]
    if written is not None:
        lines.append(
            f"wrote {written}; not the latency: an aircraft's delay_s holds the control loop's sample too"
        )
    print(*lines, sep="\n")


def _parameters(fit: Fit, inertia: float | None) -> list[tuple[str, Estimate, float, str]]:
    """Return label, estimate, scale and unit of everything fitted."""
    from neuroflight.cli.dyno.points import static_parameters

    rows = static_parameters(fit)
    response = fit.response
    if response is None:
        return rows
    if response.slew_up is None or response.slew_down is None:
        rows.append(("time constant up", response.time_constant_up, 1000.0, "ms"))
        rows.append(("time constant down", response.time_constant_down, 1000.0, "ms"))
    else:
        torques = (
            ("gain", response.rate_up, "1/s", "N m s/rad"),
            ("torque up", response.slew_up, "rad/s²", "N m"),
            ("torque down", response.slew_down, "rad/s²", "N m"),
        )
        rows += [(f"{label} / inertia", item, 1.0, unit) for label, item, unit, _ in torques]
        if inertia is not None:
            rows += [(label, item, inertia, unit) for label, item, _, unit in torques]
    rows.append(("latency", response.delay, 1000.0, "ms"))
    return rows
