"""Aircraft that are built otherwise than their files."""

from __future__ import annotations

from pathlib import Path

from sim.aircraft.model import Aircraft, load_aircraft

AIRCRAFT = Path(__file__).parents[2] / "sim" / "aircraft"
OTHER_WAY = {'spin = "cw"': 'spin = "ccw"', 'spin = "ccw"': 'spin = "cw"'}


def reversed_aircraft(name: str, folder: Path) -> Aircraft:
    """The shipped aircraft `name`, every motor turning the other way; its file is written to `folder`."""
    lines = (AIRCRAFT / f"{name}.toml").read_text().splitlines()
    path = folder / f"{name}.toml"
    path.write_text("\n".join(OTHER_WAY.get(line, line) for line in lines) + "\n")
    aircraft = load_aircraft(path)
    assert (aircraft.spins == -load_aircraft(name).spins).all()
    return aircraft
