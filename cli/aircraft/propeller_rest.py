"""`neuroflight aircraft propeller` with a table of measurements at rest: C_T and C_Q, K_T and K_Q."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.propeller_tables import Tables

DIAMETER_MIN_M, DIAMETER_MAX_M = 0.01, 5.0


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of a propeller at rest; None where they need a diameter and none is known."""

    c_t: float
    c_q: float
    diameter: float | None  # [m]
    k_t: float | None  # [N s^2/rad^2]
    k_q: float | None  # [m]


def run_rest(args: argparse.Namespace, tables: Tables) -> int:
    """Average the table, write and print the coefficients. Returns 0."""
    from neuroflight.sim.identification.propeller import at_rest, rotor_coefficients
    from neuroflight.sim.physics.air import AIR_DENSITY

    if args.plot:
        raise NeuroflightError("--plot: a table of measurements at rest has no curve over J; leave it out")
    diameter = _diameter(args)
    c_t, c_q = at_rest(tables.rest)
    k_t = k_q = None
    if diameter is not None:
        k_t, k_q = rotor_coefficients(c_t, c_q, diameter, AIR_DENSITY)
    found = Coefficients(c_t, c_q, diameter, k_t, k_q)
    if args.write:
        _write(args, found)
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
        print(json.dumps(document, indent=2))
    else:
        _print(args, tables, found)
    return 0


def _diameter(args: argparse.Namespace) -> float | None:
    """Return the propeller's diameter [m]: of --diameter, else of the aircraft named or written to."""
    from neuroflight.sim.aircraft.model import load_aircraft

    if args.diameter is not None:
        if not DIAMETER_MIN_M <= args.diameter <= DIAMETER_MAX_M:
            raise NeuroflightError(
                f"--diameter {args.diameter}, expected {DIAMETER_MIN_M:g} to {DIAMETER_MAX_M:g} m"
            )
        return float(args.diameter)
    name = args.aircraft or args.write
    return load_aircraft(name).propulsion.propeller_diameter if name else None


def _write(args: argparse.Namespace, found: Coefficients) -> None:
    """Write the coefficients into the aircraft file, in the form that it already uses."""
    import tomllib

    from neuroflight.sim.aircraft.edit import edit_aircraft

    kept = tomllib.loads(args.write.read_text(encoding="utf-8")).get("propulsion", {})
    if "c_t" in kept:
        edit_aircraft(args.write, {"propulsion": {"c_t": _rounded(found.c_t), "c_q": _rounded(found.c_q)}})
        return
    if found.k_t is None or found.k_q is None:
        raise NeuroflightError(
            f"{args.write} has no propeller_diameter_m, which K_T and K_Q need; give --diameter"
        )
    changes = {"thrust_coefficient": _rounded(found.k_t), "torque_ratio_m": _rounded(found.k_q)}
    edit_aircraft(args.write, {"propulsion": changes})


def _print(args: argparse.Namespace, tables: Tables, found: Coefficients) -> None:
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
    print(f"\n{'written to ' + str(args.write) if args.write else 'for an aircraft file'}:")
    print("  [propulsion]")
    if found.k_t is not None and found.k_q is not None:
        print(f"  thrust_coefficient = {_rounded(found.k_t)}\n  torque_ratio_m = {_rounded(found.k_q)}")
        return
    print(f"  c_t = {_rounded(found.c_t)}\n  c_q = {_rounded(found.c_q)}")
    print(f"  air_density_kg_m3 = {AIR_DENSITY:g}\n  propeller_diameter_m = (measure it)")


def _rounded(value: float) -> float:
    """Round to four significant digits."""
    return float(f"{value:.{3 - math.floor(math.log10(abs(value)))}f}")
