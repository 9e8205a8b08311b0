"""Parts and rotors of an aircraft file: mass, inertia and place of each.

A part's inertia is given as measured, or follows from a mesh or a simple solid of uniform density.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft import mesh
from neuroflight.sim.aircraft.mass import MeshPose, Part, Tensor, Vector, principal
from neuroflight.sim.aircraft.mesh import Solid
from neuroflight.toolchain.contract import MOTOR_COUNT_MAX
from neuroflight.toolchain.files import file_size
from neuroflight.toolchain.strict_toml import StrictTable

ZERO: Vector = (0.0, 0.0, 0.0)
PARTS_MAX = 1000
ROTORS_MIN = 3
INERTIA_MIN = 1e-12  # [kg m^2]
SAME_PLANE = 0.1  # of a propeller's diameter: hubs nearer in height than this share a plane
SAME_PLACE = 1e-3  # [m], hubs nearer than this are one, whatever the propeller
TURN = 2 * math.pi  # [rad]


@dataclass(frozen=True)
class Rotor:
    """One motor with its propeller, thrusting along body +z."""

    position: Vector  # [m], hub of the propeller, body frame
    spin: int  # +1 counter-clockwise seen from above, -1 clockwise


class Meshes:
    """The mesh files of one aircraft, each read once."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._files: dict[str, bytes] = {}

    def read(self, name: str) -> bytes:
        """Read a mesh, `name` being relative to the aircraft file. Raises ValueError saying what is wrong."""
        if name not in self._files:
            self._files[name] = self._load(name)
        return self._files[name]

    def contents(self) -> tuple[bytes, ...]:
        """Return the meshes that were read, in that order."""
        return tuple(self._files.values())

    def _load(self, name: str) -> bytes:
        if self._folder is None:
            raise ValueError("has no folder to be looked for in; load the aircraft from a file")
        try:
            folder = self._folder.resolve()
            path = (folder / name).resolve()
            if not path.is_relative_to(folder):
                raise ValueError("lies outside the folder of the aircraft file; put the mesh beside the file")
            if not path.is_file():
                raise ValueError(f"is no file in {folder}; put the mesh there or mend the name")
            size = file_size(path)
            data = path.read_bytes() if size <= mesh.BYTES_MAX else b""
        except (OSError, RuntimeError) as error:  # RuntimeError: links that lead in a circle
            raise ValueError(f"cannot be read: {error}") from error
        if size > mesh.BYTES_MAX:
            raise ValueError(
                f"has {size} bytes, expected at most {mesh.BYTES_MAX}; export it with fewer triangles"
            )
        return data


def read_parts(root: StrictTable, meshes: Meshes) -> list[Part]:
    """Read every [[part]]."""
    return list(root.parts("part", 1, PARTS_MAX, lambda table: _placed_part(table, meshes)))


def read_rotors(root: StrictTable, meshes: Meshes) -> tuple[tuple[Rotor, ...], list[Part]]:
    """Read every [[rotor]], and the motors and propellers on them."""
    motor = root.optional_part("motor_part", lambda table: _part(table, "motor_part", meshes))
    propeller = root.optional_part("propeller_part", lambda table: _part(table, "propeller_part", meshes))
    rotors: list[Rotor] = []
    parts: list[Part] = []
    tables = root.tables("rotor", 1, PARTS_MAX)
    if not ROTORS_MIN <= len(tables) <= MOTOR_COUNT_MAX:
        raise root.error(
            "rotor",
            f"got {len(tables)} motors, expected {ROTORS_MIN} to {MOTOR_COUNT_MAX}: the firmware's limits",
        )
    for number, table in enumerate(tables, start=1):
        hub = table.vector("propeller_m", -10, 10)
        if motor is not None:
            at = table.vector("motor_m", -10, 10)
            parts.append(replace(motor, name=f"motor {number}", position=at))
        if propeller is not None:
            parts.append(replace(propeller, name=f"propeller {number}", position=hub))
        spin = table.choice("spin", {"cw": -1, "ccw": 1})
        table.finish()
        rotors.append(Rotor(hub, spin))
    return tuple(rotors), parts


def reject_collisions(root: StrictTable, rotors: Sequence[Rotor], diameter: float | None) -> None:
    """Raise for two hubs in one place, or nearer than a propeller's radius [m] in one plane."""
    for (i, a), (j, b) in combinations(enumerate(rotors), 2):
        across = math.dist(a.position[:2], b.position[:2])
        along = abs(a.position[2] - b.position[2])
        near, level = (diameter / 2, SAME_PLANE * diameter) if diameter else (SAME_PLACE, SAME_PLACE)
        if across < near and along < level:
            raise root.error(
                f"rotor[{j}].propeller_m",
                f"{list(b.position)} is {1000 * across:.3g} mm from rotor[{i}]'s: their propellers collide",
            )


def _placed_part(table: StrictTable, meshes: Meshes) -> Part:
    return replace(
        _part(table, table.text("name"), meshes),
        position=table.vector("position_m", -10, 10),
        rotation=_rotation(table),
    )


def _rotation(table: StrictTable) -> Vector:
    if not table.has("rotation_rad"):
        return (0.0, 0.0, table.number("yaw_rad", -TURN, TURN, 0.0))
    table.either("yaw_rad", "rotation_rad")
    return table.vector("rotation_rad", -TURN, TURN)


def _part(table: StrictTable, name: str, meshes: Meshes) -> Part:
    """Read a part with the table's mass and inertia, at the origin; the caller places it."""
    mass = table.number("mass_kg", 1e-6, 1000)
    form = table.either("inertia_kg_m2", "mesh", "box_m", "cylinder_m")
    if form == "inertia_kg_m2":
        centre = table.vector("centre_of_mass_m", -10, 10)
        return Part(name, mass, ZERO, ZERO, centre, _inertia(table))
    pose = None
    if form == "mesh":
        pose = MeshPose(
            table.vector("mesh_rotation_deg", -360, 360, ZERO), table.vector("mesh_offset_m", -10, 10, ZERO)
        )
        solid = mesh.placed(_mesh(table, meshes), pose)
    else:
        centre = table.vector("centre_of_mass_m", -10, 10, ZERO)
        if form == "box_m":
            solid = mesh.box(table.vector("box_m", mesh.SIZE_MIN, mesh.SIZE_MAX), centre)
        else:
            radius, height = table.numbers("cylinder_m", 2, 2, mesh.SIZE_MIN, mesh.SIZE_MAX)
            solid = mesh.cylinder(radius, height, centre)
    a, b, c = (tuple(mass * value for value in row) for row in solid.inertia)
    inertia = ((a[0], a[1], a[2]), (b[0], b[1], b[2]), (c[0], c[1], c[2]))
    return Part(name, mass, ZERO, ZERO, solid.centre, inertia, solid.surface, pose)


def _mesh(table: StrictTable, meshes: Meshes) -> Solid:
    name, unit = table.text("mesh"), table.number("mesh_unit_m", 1e-6, 1)
    try:
        return mesh.read_solid(meshes.read(name), unit)
    except ValueError as error:
        raise table.error("mesh", f"{name!r} {error}") from error


def _inertia(table: StrictTable) -> Tensor:
    """Read three principal moments along the part's axes, or the six elements xx, yy, zz, xy, xz, yz."""
    values = table.numbers("inertia_kg_m2", 3, 6, -1000, 1000)
    if len(values) not in (3, 6):
        raise table.error("inertia_kg_m2", f"got {len(values)} numbers, expected 3 or 6")
    xx, yy, zz, xy, xz, yz = values if len(values) == 6 else (*values, 0.0, 0.0, 0.0)
    inertia = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    a, b, c = sorted(principal(np.array(inertia))[0])
    if a < INERTIA_MIN or c > (a + b) * (1 + 1e-9):  # a flat part has c = a + b, up to rounding
        raise table.error(
            "inertia_kg_m2",
            f"{list(values)} is no rigid body's: its principal moments {a:.4g}, {b:.4g}, {c:.4g} must be "
            f"above 0, each at most the sum of the other two",
        )
    return inertia
