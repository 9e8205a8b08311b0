"""Solids of uniform density: a closed triangle mesh, a box, a cylinder.

A solid is what an aircraft file may give in place of a measured inertia. Meshes are STL, text or binary;
they are read as numbers and nothing in them is executed.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.mass import MeshPose, Tensor, Vector, rotation_matrix
from neuroflight.sim.arrays import Array

BYTES_MAX = 32 << 20  # of a mesh file; 670,000 triangles in binary
SIZE_MIN, SIZE_MAX = 1e-4, 10.0  # [m], longest side of a part; another size means a wrong unit
CORNERS = 48  # of the polygon that a cylinder's surface is drawn with
VOLUME_MIN = 1e-6  # relative to its size cubed: less is a sheet, not a solid
_HEADER = 84  # bytes of a binary STL before the triangles
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


@dataclass(frozen=True)
class Solid:
    """A solid of one kilogram, in its own frame."""

    centre: Vector  # [m], of mass
    inertia: Tensor  # [m^2], about the centre, a kilogram
    surface: Array  # (K, 3, 3) [m], triangles, counter-clockwise seen from outside


def read_solid(data: bytes, unit: float) -> Solid:
    """Compute the solid inside an STL mesh whose coordinates are in `unit` [m].

    Raises ValueError saying what is wrong with it: no STL, open, inside out, empty, or of absurd size.
    """
    import trimesh  # imported here, because only aircraft with a mesh need it

    corners = _corners(data)
    if len(corners) < 4 or not np.isfinite(corners).all():
        raise ValueError("holds no solid: it has fewer than four triangles or corners that are no numbers")
    size = unit * float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    if not SIZE_MIN <= size <= SIZE_MAX:
        raise ValueError(
            f"is {size:g} m long with mesh_unit_m = {unit:g}; expected {SIZE_MIN:g} to {SIZE_MAX:g} m: "
            f"mesh_unit_m is 0.001 for a mesh in millimetres, 0.0254 in inches, 1 in metres"
        )
    # Meshed in units of its size, because trimesh joins corners nearer than 1e-8.
    mesh = trimesh.Trimesh(corners.reshape(-1, 3) * (unit / size), np.arange(3 * len(corners)).reshape(-1, 3))
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        raise ValueError(
            "is not watertight, so it has no inside to weigh; close its holes and remove loose or doubled "
            "faces (the repair tools of MeshLab, Blender or the slicer do), or give inertia_kg_m2 instead"
        )
    surface = corners * unit
    with np.errstate(all="ignore"):  # a flat mesh divides by its volume
        if mesh.volume < 0:
            mesh.invert()
            surface = surface[:, ::-1]
        volume = float(mesh.volume)
    if volume < VOLUME_MIN:
        raise ValueError(
            "encloses next to no volume; export the part as a solid with walls of a true thickness"
        )
    mesh.density = 1.0 / volume
    centre = np.asarray(mesh.center_mass) * size
    return Solid(_vector(centre), _tensor(np.asarray(mesh.moment_inertia) * size**2), surface)


def placed(solid: Solid, pose: MeshPose) -> Solid:
    """Return `solid` turned about the origin of its frame, then moved."""
    x, y, z = np.deg2rad(pose.rotation_deg).tolist()
    turn, offset = rotation_matrix((x, y, z)), np.array(pose.offset)
    centre = turn @ np.array(solid.centre) + offset
    inertia = turn @ np.array(solid.inertia) @ turn.T
    return Solid(_vector(centre), _tensor(inertia), solid.surface @ turn.T + offset)


def box(size: Vector, centre: Vector) -> Solid:
    """Return a box of `size` [m] along the axes about `centre` [m]."""
    x, y, z = np.array(size) ** 2 / 12
    # Two triangles a face, counter-clockwise seen from outside.
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    corners = np.array(centre) + signs * np.array(size) / 2
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    return Solid(centre, _tensor(np.diag([y + z, z + x, x + y])), corners[np.array(faces)])


def cylinder(radius: float, height: float, centre: Vector) -> Solid:
    """Return a cylinder [m] about z around `centre` [m]."""
    across, along = radius**2 / 4 + height**2 / 12, radius**2 / 2
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    low = np.column_stack([x, y, np.full(CORNERS, -height / 2)])
    high = low * [1.0, 1.0, -1.0]
    next_low, next_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    bottom, top = np.zeros((2, CORNERS, 3)) + np.array([[[0, 0, -height / 2]], [[0, 0, height / 2]]])
    triangles = [
        (bottom, next_low, low),
        (top, high, next_high),
        (low, next_low, next_high),
        (low, next_high, high),
    ]
    surface = np.concatenate([np.stack(corners, axis=1) for corners in triangles]) + np.array(centre)
    return Solid(centre, _tensor(np.diag([across, across, along])), surface)


def equal_box(mass: float, inertia: Tensor) -> tuple[Array, Array]:
    """Return size (3,) [m] and axes, columns (3, 3), of the uniform box with this mass and inertia.

    Source: I_x = m (l_y^2 + l_z^2) / 12 and its like, solved for the sides.
    """
    moments, axes = np.linalg.eigh(np.array(inertia))
    return np.sqrt(np.maximum(0.0, 6 / mass * (moments.sum() - 2 * moments))), axes


def _corners(data: bytes) -> Array:
    """Read the triangles (K, 3, 3) of an STL file, in its own unit. Raises ValueError if it is none."""
    if len(data) >= _HEADER:
        (count,) = struct.unpack_from("<I", data, _HEADER - 4)
        if len(data) == _HEADER + count * _TRIANGLE.itemsize:
            with np.errstate(invalid="ignore"):  # the caller looks for NaN
                return np.frombuffer(data, _TRIANGLE, offset=_HEADER)["corners"].astype(np.float64)
    if not (data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096].lower()):
        raise ValueError("is not an STL mesh, text or binary; export the part as STL")
    try:
        values = np.array(_VERTEX.findall(data)).astype(np.float64)
        return values.reshape(-1, 3, 3)
    except ValueError as error:
        raise ValueError("is a damaged STL mesh; export the part again") from error


def _vector(values: Array) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)


def _tensor(values: Array) -> Tensor:
    symmetric = (values + values.T) / 2
    return (_vector(symmetric[0]), _vector(symmetric[1]), _vector(symmetric[2]))
