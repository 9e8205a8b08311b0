"""`neuroflight aircraft propeller`: fit the fall of thrust and torque with the advance ratio."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.identification.propeller import Curve, PropellerFit
    from neuroflight.sim.identification.propeller_tables import Tables

CLIMB_MAX = 200.0  # [m/s]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the logs or tables, and the outputs."""
    parser.description = (
        f"{parser.description}: columns J, CT and CQ or CP, as the UIUC Propeller Data Site has them, or "
        "APC's PER3_*.dat. Fits 1 + a1 J + a2 J^2 to each over its value at J = 0, for "
        "[propulsion.advance_ratio] of an aircraft file. A table of measurements at rest (RPM, CT, CP) gives "
        "C_T and C_Q, and with a diameter K_T and K_Q. See docs/guides/own-aircraft.md."
    )
    parser.add_argument(
        "tables", nargs="+", type=Path, metavar="TABLE", help="of one propeller, .csv, .txt or .dat"
    )
    parser.add_argument(
        "--rpm", type=float, metavar="N", help="take the nearest of the speeds in the tables; default: all"
    )
    parser.add_argument(
        "--diameter",
        type=float,
        metavar="M",
        help="of the propeller, for K_T and K_Q at rest; default: the aircraft's",
    )
    parser.add_argument(
        "--degree",
        type=int,
        choices=(1, 2),
        default=2,
        help="1 fits lines, a2 = 0: for tables that end long before the thrust does; default 2",
    )
    parser.add_argument(
        "--aircraft", metavar="NAME|FILE", help="tell what is left of its thrust in a climb, at hover's rpm"
    )
    parser.add_argument("--climb", type=float, default=5.0, metavar="M_S", help="that climb [m/s]; default 5")
    parser.add_argument(
        "--write", type=Path, metavar="AIRCRAFT.toml", help="put the coefficients into this aircraft file"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw measurements and fit")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Fit the tables, write the outputs, print the coefficients. Returns 0."""
    from neuroflight.cli.output import check_output
    from neuroflight.sim.aircraft.edit import edit_aircraft
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.sim.identification.propeller import fit_propeller
    from neuroflight.sim.identification.propeller_plot import draw_coefficients
    from neuroflight.sim.identification.propeller_tables import read_tables
    from neuroflight.sim.plotting import png
    from neuroflight.toolchain.files import write_bytes

    if not (math.isfinite(args.climb) and 0.0 <= args.climb <= CLIMB_MAX):
        raise NeuroflightError(f"--climb {args.climb}, expected 0 to {CLIMB_MAX:g} m/s")
    if args.rpm is not None and not (math.isfinite(args.rpm) and args.rpm > 0.0):
        raise NeuroflightError(f"--rpm {args.rpm}, expected a number above 0")
    check_output(args.plot, ".png")
    tables = read_tables(args.tables, args.rpm)
    if not len(tables.wind.ratio):
        from neuroflight.cli.aircraft.propeller_rest import run_rest

        return run_rest(args, tables)
    aircraft = load_aircraft(args.aircraft) if args.aircraft else None
    fit = fit_propeller(tables.measurements, args.degree)
    climb = None if aircraft is None else _climb(fit, aircraft, args.climb)
    picture = png(draw_coefficients(fit, ", ".join(path.stem for path in args.tables))) if args.plot else b""
    if args.write:
        advance = {"thrust": fit.advance.thrust, "torque": fit.advance.torque}
        edit_aircraft(args.write, {"propulsion.advance_ratio": advance})
    if args.plot:
        write_bytes(args.plot, picture)
    if args.json:
        print(json.dumps(_document(args, tables, fit, climb), indent=2))
    else:
        _print(args, tables, fit, climb)
    return 0


def _climb(fit: PropellerFit, aircraft: Aircraft, speed: float) -> dict[str, float]:
    """Return the shares of thrust and torque that remain in a climb at `speed` [m/s] with the hover's rpm."""
    from dataclasses import replace

    import numpy as np

    from neuroflight.sim.design.figures import aircraft_figures
    from neuroflight.sim.physics.rotor import advance_factors, rotor_geometry

    hover = aircraft_figures(aircraft).hover
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
    args: argparse.Namespace, tables: Tables, fit: PropellerFit, climb: dict[str, float] | None
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


def _print(
    args: argparse.Namespace, tables: Tables, fit: PropellerFit, climb: dict[str, float] | None
) -> None:
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
    print(f"\n{'written to ' + str(args.write) if args.write else 'for an aircraft file'}:")
    print("  [propulsion.advance_ratio]")
    print(f"  thrust = {list(fit.advance.thrust)}\n  torque = {list(fit.advance.torque)}")
