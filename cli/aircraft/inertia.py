"""`neuroflight aircraft inertia`: moments of inertia from logs of the aircraft swinging on wires."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from neuroflight.cli.aircraft.recordings import FORMS, OfGyroLog
from neuroflight.cli.options import Json, picture
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Argument, Either, Option
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.identification.swing import Moment, Swing

WIRES = Either(required=True)


@dataclass(frozen=True, kw_only=True)
class Inertia(OfGyroLog):
    """A request for moments of inertia from swings."""

    logs: Annotated[tuple[Path, ...], Argument("LOG", "one a hanging, up to three axes", most=len(AXES))]
    bifilar: Annotated[
        tuple[float, ...] | None,
        Option(
            ("KG", "DISTANCE", "LENGTH"),
            "two parallel wires: mass that hangs on them, metres between them, metres of each",
            above=0.0,
            number=3,
            either=WIRES,
        ),
    ] = None
    stiffness: Annotated[
        float | None, Option("N_M_RAD", "of a torsion wire [N m/rad]", above=0.0, either=WIRES)
    ] = None
    reference: Annotated[
        tuple[str, ...] | None,
        Option(
            ("LOG", "KG_M2"),
            "a log of a body of known moment, the gyro's own included, on the same torsion wire",
            number=2,
            either=WIRES,
        ),
    ] = None
    aircraft: Annotated[str | None, Option("NAME|FILE", "compare with this aircraft's moments")] = None
    plot: Annotated[Path | None, picture("draw swings and fits")] = None
    json: Json = False

    more: ClassVar[str] = f", a log an axis: {FORMS}. See docs/guides/inertia.md."

    def run(self) -> int:
        """Fit the logs, print the moments. Returns 0."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.identification.recording import read_recording
        from neuroflight.sim.identification.swing import find_swing
        from neuroflight.sim.identification.swing_plot import draw_swings
        from neuroflight.sim.plotting import save_png

        aircraft = load_aircraft(self.aircraft) if self.aircraft else None
        chosen = self.choice
        swings: list[Swing] = []
        notes: list[str] = []
        for path in self.logs:
            recording = read_recording(path, chosen)
            swings.append(find_swing(recording, str(path)))
            notes += recording.notes
        found = sorted({swing.axis for swing in swings})
        if len(found) < len(swings):
            raise NeuroflightError(f"{len(swings)} logs swing about {len(found)} axes, expected an axis each")
        moments = _moments(self, swings)
        if self.plot:
            save_png(self.plot, draw_swings(swings, "Swings on wires"))
        if self.json:
            print_json(_document(self, swings, moments, aircraft))
        else:
            _print(self, swings, moments, aircraft)
        for note in notes:
            print(f"neuroflight: {note}", file=sys.stderr)
        return 0


def _moments(args: Inertia, swings: list[Swing]) -> list[Moment]:
    from neuroflight.sim.identification.recording import read_recording
    from neuroflight.sim.identification.swing import (
        Moment,
        bifilar_stiffness,
        find_swing,
        moment,
        reference_stiffness,
    )

    if args.bifilar:
        return [moment(swing, bifilar_stiffness(*args.bifilar), bifilar=True) for swing in swings]
    if args.stiffness:
        return [moment(swing, args.stiffness) for swing in swings]
    assert args.reference is not None  # one of the three is given
    path, text = args.reference
    try:
        known = float(text)
    except ValueError:
        known = math.nan
    if not (math.isfinite(known) and known > 0.0):
        raise NeuroflightError(f"--reference {path} {text}: expected LOG KG_M2, a moment above 0")
    body = find_swing(read_recording(Path(path), args.choice), path)
    stiffness, relative = reference_stiffness(body, known)
    each = [moment(swing, stiffness) for swing in swings]
    return [Moment(m.value, math.hypot(m.margin, relative * m.value)) for m in each]


def _document(
    args: Inertia, swings: list[Swing], moments: list[Moment], aircraft: Aircraft | None
) -> dict[str, Any]:
    rows = {}
    for path, swing, found in zip(args.logs, swings, moments, strict=True):
        filed = None if aircraft is None else float(aircraft.mass_properties.inertia[swing.axis, swing.axis])
        rows[AXES[swing.axis]] = {
            "log": str(path),
            "inertia_kg_m2": found.value,
            "margin_kg_m2": found.margin,
            "period_s": swing.period_s,
            "period_margin_s": swing.period_margin_s,
            "damping": swing.damping,
            "amplitude_deg": math.degrees(swing.amplitude),
            "periods": swing.periods,
            "explained": swing.explained,
            "aircraft_kg_m2": filed,
            "of_aircraft": None if filed is None else found.value / filed,
        }
    return {"axes": rows, "line": _line(swings, moments)}


def _line(swings: list[Swing], moments: list[Moment]) -> str | None:
    """Return the line of a part that stands for the whole aircraft, once all axes are known."""
    if len(swings) < len(AXES):
        return None
    by_axis = {swing.axis: found.value for swing, found in zip(swings, moments, strict=True)}
    return f"inertia_kg_m2 = [{', '.join(f'{by_axis[axis]:.4g}' for axis in range(len(AXES)))}]"


def _print(args: Inertia, swings: list[Swing], moments: list[Moment], aircraft: Aircraft | None) -> None:
    for path, swing, found in zip(args.logs, swings, moments, strict=True):
        words = ""
        if aircraft is not None:
            filed = float(aircraft.mass_properties.inertia[swing.axis, swing.axis])
            words = f"; {aircraft.name}'s file says {filed:.4g}, {found.value / filed:.3f} times that"
        print(
            f"{path}: {AXES[swing.axis]} {found.value:.5g} ± {found.margin:.2g} kg m² (95 %), period "
            f"{swing.period_s:.5f} ± {swing.period_margin_s:.2g} s, {swing.periods:.0f} of them{words}"
        )
    line = _line(swings, moments)
    if line:
        print(f"\nfor an aircraft file, of a part that stands for the whole aircraft:\n  {line}")
    if args.bifilar:
        print("Not in ±: the scale, the tape and the wires' distance; 1 % of the distance is 2 % of J.")
