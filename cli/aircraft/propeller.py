"""`neuroflight aircraft propeller`: fit the fall of thrust and torque with the advance ratio."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from neuroflight.cli.options import Json, picture
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Argument, Option, Request
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.known import Known
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.identification.propeller import Curve, PropellerFit
    from neuroflight.sim.identification.propeller_tables import Tables

CLIMB_MAX = 200.0  # [m/s]


@dataclass(frozen=True, kw_only=True)
class Propeller(Request):
    """A request for a propeller's coefficients."""

    tables: Annotated[tuple[Path, ...], Argument("TABLE", "of one propeller, .csv, .txt or .dat")]
    rpm: Annotated[
        float | None, Option("N", "take the nearest of the speeds in the tables; default: all", above=0.0)
    ] = None
    diameter: Annotated[
        float | None,
        Option(
            "M",
            "of the propeller, for K_T and K_Q at rest; default: the aircraft's",
            low=0.01,
            high=5.0,
            unit="m",
        ),
    ] = None
    degree: Annotated[
        int,
        Option(
            None,
            "1 fits lines, a2 = 0: for tables that end long before the thrust does; default 2",
            choices=(1, 2),
        ),
    ] = 2
    aircraft: Annotated[
        str | None, Option("NAME|FILE", "tell what is left of its thrust in a climb, at hover's rpm")
    ] = None
    climb: Annotated[
        float, Option("M_S", "that climb [m/s]; default 5", low=0.0, high=CLIMB_MAX, unit="m/s")
    ] = 5.0
    write: Annotated[Path | None, Option("AIRCRAFT.toml", "put the coefficients into this aircraft file")] = (
        None
    )
    plot: Annotated[Path | None, picture("draw measurements and fit")] = None
    json: Json = False

    more: ClassVar[str] = (
        ": columns J, CT and CQ or CP, as the UIUC Propeller Data Site has them, or "
        "APC's PER3_*.dat. Fits 1 + a1 J + a2 J^2 to each over its value at J = 0, for "
        "[propulsion.advance_ratio] of an aircraft file. A table of measurements at rest (RPM, CT, CP) gives "
        "C_T and C_Q, and with a diameter K_T and K_Q. See docs/guides/own-aircraft.md."
    )

    def run(self) -> int:
        """Fit the tables, write the outputs, print the coefficients. Returns 0."""
        from neuroflight.sim.aircraft.edit import edit_aircraft
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.identification.propeller import fit_propeller
        from neuroflight.sim.identification.propeller_plot import draw_coefficients
        from neuroflight.sim.identification.propeller_tables import read_tables
        from neuroflight.sim.plotting import png
        from neuroflight.toolchain.files import write_bytes

        tables = read_tables(self.tables, self.rpm)
        if not len(tables.wind.ratio):
            return _run_rest(self, tables)
        aircraft = load_aircraft(self.aircraft) if self.aircraft else None
        fit = fit_propeller(tables.measurements, self.degree)
        climb = None if aircraft is None else _climb(fit, aircraft, self.climb)
        picture = (
            png(draw_coefficients(fit, ", ".join(path.stem for path in self.tables))) if self.plot else b""
        )
        if self.write:
            advance = {"thrust": fit.advance.thrust, "torque": fit.advance.torque}
            marked = {"propulsion.advance_ratio": _mark(self)}
            edit_aircraft(self.write, {"propulsion.advance_ratio": advance}, known=marked)
        if self.plot:
            write_bytes(self.plot, picture)
        if self.json:
            print_json(_document(self, tables, fit, climb))
        else:
            _print(self, tables, fit, climb)
        return 0


def _climb(fit: PropellerFit, aircraft: Aircraft, speed: float) -> dict[str, float]:
    """Return the shares of thrust and torque that remain in a climb at `speed` [m/s] with the hover's rpm."""
    from dataclasses import replace

    import numpy as np

    from neuroflight.sim.design.figures import hovering
    from neuroflight.sim.physics.rotor import advance_factors, rotor_geometry

    hover = hovering(aircraft)
    if hover is None or aircraft.propulsion.propeller_diameter is None:
        lacks = "cannot hover" if hover is None else "has no propulsion.propeller_diameter_m"
        raise NeuroflightError(f"aircraft {aircraft.name} {lacks}; leave out --aircraft")
    rotor = float(np.mean(hover.speed))
    flying = replace(aircraft, propulsion=replace(aircraft.propulsion, advance=fit.advance))
    speeds = np.full((1, aircraft.motor_count), rotor)
    velocity = np.array([[0.0, 0.0, speed]])
    thrust, torque = advance_factors(speeds, velocity, np.zeros((1, 3)), rotor_geometry(flying))
    diameter = aircraft.propulsion.propeller_diameter
    return {
        "speed_m_s": speed,
        "rotor_rad_s": rotor,
        "advance_ratio": 2.0 * math.pi * speed / (rotor * diameter),
        "thrust_percent": 100.0 * float(thrust[0, 0]),
        "torque_percent": 100.0 * float(torque[0, 0]),
    }


def _document(
    args: Propeller, tables: Tables, fit: PropellerFit, climb: dict[str, float] | None
) -> dict[str, Any]:
    from neuroflight.sim.identification.propeller import doubts

    return {
        "tables": [str(path) for path in args.tables],
        "speeds_rpm": list(tables.speeds_rpm),
        "rows": len(fit.used.ratio),
        "ratio_measured": float(fit.used.ratio.max()),
        "ratio_end": fit.advance.ratio_max,
        "thrust": _curve(fit.thrust),
        "torque": _curve(fit.torque),
        "advance_ratio": {"thrust": list(fit.advance.thrust), "torque": list(fit.advance.torque)},
        "climb": climb,
        "warnings": doubts(fit),
        "notes": list(tables.notes),
        "written": str(args.write) if args.write else None,
    }


def _curve(curve: Curve) -> dict[str, Any]:
    return {
        "static": curve.static,
        "terms": list(curve.terms),
        "standard_errors": [None if math.isnan(error) else error for error in curve.errors],
        "residual": curve.residual,
    }


def _print(args: Propeller, tables: Tables, fit: PropellerFit, climb: dict[str, float] | None) -> None:
    from neuroflight.sim.identification.propeller import doubts

    last, end = float(fit.used.ratio.max()), fit.advance.ratio_max
    for note in tables.notes:
        print(note)
    print(f"{len(fit.used.ratio)} measurements up to J = {last:.3g}; the curves are used up to J = {end:.3g}")
    for name, curve in (("C_T", fit.thrust), ("C_Q", fit.torque)):
        terms = ", ".join(
            f"{term:.4g}" + ("" if math.isnan(error) else f" ± {1.96 * error:.2g}")
            for term, error in list(zip(curve.terms, curve.errors, strict=True))[: args.degree]
        )
        print(
            f"{name}: {curve.static:.4g} at J = 0, a = {terms}; the fit leaves {100 * curve.residual:.1f} %"
        )
    for doubt in doubts(fit):
        print(f"warning: {doubt}")
    if climb is not None:
        print(
            f"climbing at {climb['speed_m_s']:g} m/s with the rotors of a hover, "
            f"{climb['rotor_rad_s']:.0f} rad/s, J = {climb['advance_ratio']:.3f}: "
            f"{climb['thrust_percent']:.1f} % of the thrust and {climb['torque_percent']:.1f} % of the "
            f"torque are left"
        )
    _print_place(args)
    print("  [propulsion.advance_ratio]")
    print(f"  thrust = {list(fit.advance.thrust)}\n  torque = {list(fit.advance.torque)}")


def _print_place(args: Propeller) -> None:
    """Print the heading above keys of an aircraft file."""
    print(f"\n{f'written to {args.write}' if args.write else 'for an aircraft file'}:")


# --- At rest: C_T and C_Q, K_T and K_Q -----------------------------------------------------------------
@dataclass(frozen=True)
class Coefficients:
    """Coefficients of a propeller at rest; None where they need a diameter and none is known."""

    c_t: float
    c_q: float
    diameter: float | None  # [m]
    k_t: float | None  # [N s^2/rad^2]
    k_q: float | None  # [m]


def _run_rest(args: Propeller, tables: Tables) -> int:
    """Average the table, write and print the coefficients. Returns 0."""
    from neuroflight.sim.aircraft.model import thrust_coefficient, torque_ratio
    from neuroflight.sim.identification.propeller import at_rest
    from neuroflight.sim.physics.air import AIR_DENSITY

    args.refuse("plot", because="a table of measurements at rest has no curve over J; leave it out")
    diameter = _diameter(args)
    c_t, c_q = at_rest(tables.rest)
    k_t = k_q = None
    if diameter is not None:
        k_t, k_q = thrust_coefficient(c_t, diameter, AIR_DENSITY), torque_ratio(c_t, c_q, diameter)
    found = Coefficients(c_t, c_q, diameter, k_t, k_q)
    if args.write:
        _write(args.write, found, _mark(args))
    if args.json:
        document = {
            "tables": [str(path) for path in args.tables],
            "rows": len(tables.rest.rpm),
            "rpm": [float(tables.rest.rpm.min()), float(tables.rest.rpm.max())],
            "c_t": c_t,
            "c_q": c_q,
            "propeller_diameter_m": diameter,
            "air_density_kg_m3": AIR_DENSITY,
            "thrust_coefficient": k_t,
            "torque_ratio_m": k_q,
            "advance_ratio": None,
            "notes": list(tables.notes),
            "written": str(args.write) if args.write else None,
        }
        print_json(document)
    else:
        _print_rest(args, tables, found)
    return 0


def _diameter(args: Propeller) -> float | None:
    """Return the propeller's diameter [m]: of --diameter, else of the aircraft named or written to."""
    from neuroflight.sim.aircraft.model import load_aircraft

    if args.diameter is not None:
        return args.diameter
    name = args.aircraft or (None if args.write is None else str(args.write))
    return load_aircraft(name).propulsion.propeller_diameter if name else None


def _mark(args: Propeller) -> Known:
    """Return how numbers from tables are known: as of the propeller's kind, not of the aircraft's own."""
    from neuroflight.sim.aircraft.known import SOURCE_MAX, How, Known

    return Known(How.TYPICAL, None, ", ".join(path.name for path in args.tables)[:SOURCE_MAX])


def _write(path: Path, found: Coefficients, mark: Known) -> None:
    """Write the coefficients into the aircraft file, in the form that it already uses."""
    import tomllib

    from neuroflight.sim.aircraft.edit import edit_aircraft

    kept = tomllib.loads(path.read_text(encoding="utf-8")).get("propulsion", {})
    if "c_t" in kept:
        keys = {"c_t": _rounded(found.c_t), "c_q": _rounded(found.c_q)}
        edit_aircraft(path, {"propulsion": keys}, known={f"propulsion.{key}": mark for key in keys})
        return
    if found.k_t is None or found.k_q is None:
        raise NeuroflightError(f"{path} has no propeller_diameter_m, which K_T and K_Q need; give --diameter")
    changes = {"thrust_coefficient": _rounded(found.k_t), "torque_ratio_m": _rounded(found.k_q)}
    edit_aircraft(path, {"propulsion": changes}, known={f"propulsion.{key}": mark for key in changes})


def _print_rest(args: Propeller, tables: Tables, found: Coefficients) -> None:
    from neuroflight.sim.physics.air import AIR_DENSITY

    rest = tables.rest
    for note in tables.notes:
        print(note)
    print(f"{len(rest.rpm)} measurements at rest, {rest.rpm.min():g} to {rest.rpm.max():g} rpm")
    for name, mean, values in (("C_T", found.c_t, rest.thrust), ("C_Q", found.c_q, rest.torque)):
        print(f"{name}: {mean:.4g}, from {values.min():.4g} to {values.max():.4g}")
    if found.k_t is not None and found.k_q is not None and found.diameter is not None:
        print(
            f"K_T = {found.k_t:.4g} N s²/rad², K_Q = {found.k_q:.4g} m, with a diameter of "
            f"{1000 * found.diameter:.1f} mm and air of {AIR_DENSITY:g} kg/m³"
        )
    print("how they fall in a climb it does not tell: that takes a table with a column J")
    _print_place(args)
    print("  [propulsion]")
    if found.k_t is not None and found.k_q is not None:
        print(f"  thrust_coefficient = {_rounded(found.k_t)}\n  torque_ratio_m = {_rounded(found.k_q)}")
        return
    print(f"  c_t = {_rounded(found.c_t)}\n  c_q = {_rounded(found.c_q)}")
    print(f"  air_density_kg_m3 = {AIR_DENSITY:g}\n  propeller_diameter_m = (measure it)")


def _rounded(value: float) -> float:
    """Round to four significant digits."""
    return float(f"{value:.{3 - math.floor(math.log10(abs(value)))}f}")
