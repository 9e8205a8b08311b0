"""`neuroflight aircraft import`: an aircraft file from a model of another simulator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from neuroflight.cli.options import Json
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Argument, Option, Request


@dataclass(frozen=True, kw_only=True)
class Import(Request):
    """A request for an aircraft file from another simulator's model."""

    file: Annotated[Path, Argument("FILE.urdf|FILE.sdf", "expanded, if it is a template")]
    out: Annotated[Path, Option("FILE.toml", "a new file", suffix=".toml")]
    like: Annotated[
        str | None,
        Option(
            "NAME|FILE",
            "the aircraft that has what the model does not say: drives, gyro, battery; default: the model's "
            "motor plugins, and what is marked as assumed",
        ),
    ] = None
    spins: Annotated[
        str | None,
        Option("cw,ccw,…", "turns of the rotors seen from above, where the model does not say them"),
    ] = None
    name: Annotated[str | None, Option("NAME", "of the aircraft; default: the model's")] = None
    json: Json = False

    def run(self) -> int:
        """Write the aircraft of a model, and print what it is and what is assumed."""
        from neuroflight.sim.aircraft.robot_aircraft import import_aircraft
        from neuroflight.toolchain.errors import AircraftError
        from neuroflight.toolchain.files import write_text

        if self.out.exists():
            raise AircraftError(
                f"--out {self.out}: exists; name a new file, so that nothing written by hand is lost"
            )
        spins = None if self.spins is None else self.spins.split(",")
        found = import_aircraft(self.file, like=self.like, spins=spins, name=self.name)
        write_text(self.out, found.text)
        aircraft = found.aircraft
        if self.json:
            told = {
                "name": aircraft.name,
                "sha256": aircraft.sha256,
                "motors": aircraft.motor_count,
                "mass_kg": aircraft.mass_properties.mass,
                "centre_of_mass_m": aircraft.mass_properties.centre.tolist(),
                "inertia_kg_m2": aircraft.mass_properties.inertia.tolist(),
                "assumed": list(found.assumed),
                "notes": list(found.notes),
            }
            print_json(told)
            return 0
        parts = f"{aircraft.motor_count} rotors, {aircraft.mass_properties.mass:.4g} kg"
        print(f"{self.file} -> {self.out}: {aircraft.name}, {parts}")
        for line in found.assumed:
            print(f"assumed: {line}")
        for line in found.notes:
            print(line)
        print(f"look at it: neuroflight aircraft check {self.out}")
        return 0
