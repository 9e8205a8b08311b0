"""Mass, centre of mass and inertia of an aircraft, from its parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from neuroflight.sim.arrays import Array

Vector = tuple[float, float, float]
Tensor = tuple[Vector, Vector, Vector]


@dataclass(frozen=True)
class MeshPose:
    """The placement of a mesh in its part's frame: turned about its own origin, then moved."""

    rotation_deg: Vector  # roll, pitch, yaw: about the fixed x, then y, then z axis
    offset: Vector  # [m]


@dataclass(frozen=True)
class Part:
    """A rigid part. Its own frame sits at `position` in the body frame, turned by `rotation`."""

    name: str
    mass: float  # [kg]
    position: Vector  # [m], body frame
    rotation: Vector  # [rad], roll, pitch, yaw: about the fixed x, then y, then z axis
    centre: Vector  # [m], centre of mass in the part's own frame
    inertia: Tensor  # [kg m^2], about that centre, along the part's own axes
    surface: Array | None = field(  # (K, 3, 3) [m], triangles in the part's own frame
        default=None, repr=False, compare=False
    )
    mesh: MeshPose | None = None  # None: not a mesh


@dataclass(frozen=True)
class MassProperties:
    """Mass, centre and inertia of all parts together."""

    mass: float  # [kg]
    centre: Array  # (3,) [m], body frame
    inertia: Array  # (3, 3) [kg m^2], about the centre, body axes


def mass_properties(parts: Sequence[Part]) -> MassProperties:
    """Combine the parts by the parallel-axis theorem."""
    turns = [rotation_matrix(part.rotation) for part in parts]
    masses = np.array([part.mass for part in parts])
    centres = np.array(
        [np.array(p.position) + turn @ np.array(p.centre) for p, turn in zip(parts, turns, strict=True)]
    )
    mass = float(masses.sum())
    centre = masses @ centres / mass
    inertia = np.zeros((3, 3))
    for part, turn, where in zip(parts, turns, centres - centre, strict=True):
        inertia += turn @ np.array(part.inertia) @ turn.T
        inertia += part.mass * (where @ where * np.eye(3) - np.outer(where, where))
    return MassProperties(mass, centre, inertia)


def principal(inertia: Array) -> tuple[Array, Array]:
    """Return principal moments (3,) and their axes, the columns of (3, 3), of a symmetric inertia tensor.

    In the order of the body axes that the principal axes are nearest to; each points along its body axis.
    """
    moments, axes = np.linalg.eigh(inertia)
    order = []
    for axis in range(3):
        free = [column for column in range(3) if column not in order]
        order.append(max(free, key=lambda column: abs(axes[axis, column])))
    axes = axes[:, order]
    return moments[order], axes * np.where(np.diag(axes) < 0, -1.0, 1.0)


def rotation_matrix(rotation: Vector) -> Array:
    """Return the rotation (3, 3), part to body, of roll, pitch, yaw [rad] about the fixed x, y, z axes."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(rotation), np.sin(rotation)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    turn: Array = about_z @ about_y @ about_x
    return turn


def rotation_angles(turn: Array) -> Vector:
    """Return roll, pitch and yaw [rad] of a rotation matrix: the inverse of `rotation_matrix`."""
    pitch = float(np.arcsin(np.clip(-turn[2, 0], -1.0, 1.0)))
    if abs(turn[2, 0]) < 1.0 - 1e-9:
        return float(np.arctan2(turn[2, 1], turn[2, 2])), pitch, float(np.arctan2(turn[1, 0], turn[0, 0]))
    # With the nose straight up or down roll and yaw turn about the same axis: all is called roll.
    return float(np.arctan2(-turn[1, 2], turn[1, 1])), pitch, 0.0
