"""Parts of an aircraft file from the links of another simulator's model; of a rotor's link as it turns."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.mass import Part, Vector, rotation_angles
from neuroflight.sim.aircraft.robot import Drive, Link, Robot
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.errors import AircraftError

MASS_MIN = 1e-6  # [kg], of a part
SAME = 1e-6  # relative: propellers that differ by less are one


def hub_of(robot: Robot, drive: Drive) -> Array:
    link = robot.links[drive.link]
    return (link.pose @ link.centre).position if robot.hubs_at_centre else link.pose.position


def part_lines(link: Link, where: str) -> list[str]:
    """Return name, place and mass of a link as lines."""
    turn = rotation_angles(link.pose.turn)
    lines = [f"name = {json.dumps(link.name)}", f"position_m = {listed(vector_of(link.pose.position))}"]
    if max(map(abs, turn)) > 1e-9:
        lines.append(f"rotation_rad = {listed(vector_of(np.array(turn)))}")
    return lines + mass_lines(link.mass, vector_of(link.centre.position), _inertia(link, where))


def _inertia(link: Link, where: str) -> Array:
    """Return the tensor about the link's centre of mass, along its axes."""
    if link.inertia is None:
        raise AircraftError(f"{where}: link {link.name} has a mass but no inertia; give it one")
    turned: Array = link.centre.turn @ link.inertia @ link.centre.turn.T
    return turned


def spun(link: Link, hub: Array, where: str) -> Part | None:
    """Return a rotor's mass as it turns about z, in the body's axes and on the axis; None: it has none."""
    if link.mass < MASS_MIN:
        return None
    whole = link.pose.turn @ _inertia(link, where) @ link.pose.turn.T
    across, along = float(whole[0, 0] + whole[1, 1]) / 2, float(whole[2, 2])
    above = float((link.pose @ link.centre).position[2] - hub[2])
    inertia = ((across, 0.0, 0.0), (0.0, across, 0.0), (0.0, 0.0, along))
    return Part(link.name, link.mass, vector_of(hub), (0.0, 0.0, 0.0), (0.0, 0.0, above), inertia)


def alike(one: Part, other: Part) -> bool:
    mine, its = (np.array([part.mass, part.centre[2], *np.diag(part.inertia)]) for part in (one, other))
    return bool(np.allclose(mine, its, rtol=SAME, atol=1e-12))


def mass_lines(mass: float, centre: Vector, inertia: Array) -> list[str]:
    """Return mass, centre of mass and moments as lines: three where these are all, or the whole tensor."""
    moments = [inertia[0, 0], inertia[1, 1], inertia[2, 2]]
    products = [inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    if max(map(abs, products)) > 1e-9 * max(moments):
        moments += products
    return [
        f"mass_kg = {_number(mass)}",
        f"centre_of_mass_m = {listed(centre)}",
        f"inertia_kg_m2 = {listed(moments)}",
    ]


def vector_of(values: Array) -> Vector:
    x, y, z = (float(value) for value in values)
    return (x, y, z)


def toml(value: Any) -> str:  # noqa: ANN401 - of a TOML file
    if isinstance(value, list | tuple):
        return listed(value)
    return (
        _number(value)
        if isinstance(value, int | float) and not isinstance(value, bool)
        else json.dumps(value)
    )


def listed(values: Sequence[Any]) -> str:
    return f"[{', '.join(map(toml, values))}]"


def _number(value: float) -> str:
    """Return a number with at most nine significant digits; whole ones stay whole."""
    return str(value) if isinstance(value, int) else repr(float(f"{value:.9g}") + 0.0)
