"""`neuroflight aircraft check`: figures of an aircraft file, and a verdict on its fitness to fly."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.options import Json
from neuroflight.cli.report import print_facts, print_json
from neuroflight.cli.requests import Argument, Option, Request

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.design.airworthiness import Verdict
    from neuroflight.sim.design.figures import AircraftFigures


@dataclass(frozen=True, kw_only=True)
class Check(Request):
    """An aircraft file and what follows from it."""

    file: Annotated[str, Argument("file", "path of a .toml file, or the name of a shipped aircraft")]
    plot: Annotated[
        Path | None, Option("FILE.png", "draw it from above and from behind", old=("--draw",), suffix=".png")
    ] = None
    json: Json = False

    def run(self) -> int:
        """Examine, draw and print. Returns 0, or 1 if one of the verdicts is an error."""
        from neuroflight.cli.aircraft.marks import known_document, print_known
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.design.airworthiness import Level, examine
        from neuroflight.sim.design.drawing import save_drawing

        aircraft = load_aircraft(self.file)
        figures, verdicts = examine(aircraft)
        if self.plot is not None:
            save_drawing(self.plot, aircraft, figures)
        if self.json:
            print_json(_document(aircraft, figures, verdicts) | {"known": known_document(self.file)})
        else:
            _print(aircraft, figures, verdicts, self.plot)
            if aircraft.known:
                print()
                print_known(self.file)
        return int(any(verdict.level is Level.ERROR for verdict in verdicts))


def _document(aircraft: Aircraft, figures: AircraftFigures, verdicts: list[Verdict]) -> dict[str, Any]:
    """Return the whole report in SI units; unknown or impossible values are null."""
    hover, endurance = figures.hover, figures.endurance
    return {
        "name": aircraft.name,
        "sha256": aircraft.sha256,
        "motors": aircraft.motor_count,
        "mass_kg": figures.mass,
        "centre_of_mass_m": figures.centre.tolist(),
        "inertia_kg_m2": figures.inertia.tolist(),
        "principal_moments_kg_m2": figures.principal_moments.tolist(),
        "principal_axes": figures.principal_axes.T.tolist(),
        "wheelbase_m": figures.wheelbase,
        "thrust_n": figures.thrust_max,
        "thrust_to_weight": figures.thrust_to_weight,
        "acceleration_rad_s2": figures.acceleration.tolist(),
        "hover_acceleration_rad_s2": figures.hover_acceleration.tolist(),
        "hover": hover
        and {
            "throttle": hover.throttle.tolist(),
            "speed_rad_s": hover.speed.tolist(),
            "thrust_n": hover.thrust.tolist(),
            "power_w": hover.power,
            "current_a": endurance and endurance.current,
            "seconds": endurance and endurance.seconds,
        },
        "full_throttle": endurance
        and {
            "current_a": endurance.full_throttle_current if endurance.full_throttle_voltage else None,
            "voltage_v": endurance.full_throttle_voltage or None,
        },
        "verdicts": [
            {"level": verdict.level.value, "subject": verdict.subject, "message": verdict.message}
            for verdict in verdicts
        ],
    }


def _print(aircraft: Aircraft, figures: AircraftFigures, verdicts: list[Verdict], drawn: Path | None) -> None:
    from neuroflight.sim.design.airworthiness import Level

    print(f"{aircraft.name}: {aircraft.description or 'no description'}")
    print_facts(_rows(aircraft, figures))
    print()
    styles = {Level.OK: "green", Level.WARNING: "yellow", Level.ERROR: "bold red"}
    print_facts(
        ((each.level.value, each.subject, each.message) for each in verdicts),
        styles=[styles[each.level] for each in verdicts],
    )
    if drawn is not None:
        print(f"\ndrawn: {drawn}")


def _rows(aircraft: Aircraft, figures: AircraftFigures) -> list[tuple[str, str]]:
    """Return label and text of each figure."""
    import numpy as np

    from neuroflight.sim.aircraft.model import RPM

    def three(values: Any, form: str = ".3g") -> str:  # noqa: ANN401 - an array or a list
        return " / ".join(format(value + 0.0, form) for value in values)

    rows = [
        ("mass", f"{figures.mass:.4g} kg"),
        ("centre of mass", f"{three(np.rint(1e4 * figures.centre) / 10, '.1f')} mm, x / y / z"),
        ("principal moments", f"{three(figures.principal_moments)} kg m²"),
    ]
    axes = zip("xyz", figures.principal_axes.T, strict=True)
    tilt = np.rad2deg(np.arccos(np.clip(np.diag(figures.principal_axes), -1.0, 1.0)))
    if tilt.max() < 0.1:
        rows.append(("principal axes", "the body's"))
    else:
        vectors = "; ".join(f"{name} [{', '.join(f'{v + 0.0:.3f}' for v in axis)}]" for name, axis in axes)
        rows.append(("principal axes", f"{vectors}, up to {tilt.max():.1f} deg off the body's"))
    rows += [
        ("wheelbase", f"{1000 * figures.wheelbase:.0f} mm, {aircraft.motor_count} motors"),
        ("thrust to weight", f"{figures.thrust_to_weight:.2f}"),
        ("greatest acceleration", f"{three(figures.acceleration)} rad/s² roll / pitch / yaw"),
        ("  in a hover", f"{three(figures.hover_acceleration)} rad/s²"),
    ]
    if (hover := figures.hover) is not None:
        speeds = hover.speed / RPM
        rows += [
            ("hover throttle", _span(100 * hover.throttle, ".0f", "%")),
            ("hover speed", _span(speeds, ",.0f", "rpm")),
            ("hover power", f"{hover.power:.0f} W"),
        ]
    if (endurance := figures.endurance) is not None:
        minutes = f"{endurance.seconds / 60:.0f} min from full to 20 %"
        rows.append(("hover current", f"{endurance.current:.1f} A, {minutes}"))
        if endurance.full_throttle_voltage:
            volts = f"{endurance.full_throttle_voltage:.1f} V from a full pack"
            rows.append(("full throttle", f"{endurance.full_throttle_current:.0f} A at {volts}"))
    return rows


def _span(values: Any, form: str, unit: str) -> str:  # noqa: ANN401 - an array
    """Return one number where all motors have the same, else the least and the greatest."""
    low, high = format(values.min(), form), format(values.max(), form)
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
