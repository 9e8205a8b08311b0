"""Mass, centre of mass and inertia of an aircraft, from its parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Part:
    """A rigid part. Its own frame sits at `position` in the body frame, turned by `yaw` about z."""

    name: str
    mass: float  # [kg]
    position: Vector  # [m], body frame
    yaw: float  # [rad]
    centre: Vector  # [m], centre of mass in the part's own frame
    inertia: Vector  # [kg m^2], principal moments about that centre, along the part's own axes


@dataclass(frozen=True)
class MassProperties:
    """What the parts weigh together."""

    mass: float  # [kg]
    centre: NDArray[np.float64]  # (3,) [m], body frame
    inertia: NDArray[np.float64]  # (3, 3) [kg m^2], about the centre, body axes


def mass_properties(parts: Sequence[Part]) -> MassProperties:
    """Sum of the parts by the parallel-axis theorem."""
    turns = [_rotation_z(part.yaw) for part in parts]
    masses = np.array([part.mass for part in parts])
    centres = np.array(
        [np.array(p.position) + turn @ np.array(p.centre) for p, turn in zip(parts, turns, strict=True)]
    )
    mass = float(masses.sum())
    centre = masses @ centres / mass
    inertia = np.zeros((3, 3))
    for part, turn, where in zip(parts, turns, centres - centre, strict=True):
        inertia += turn @ np.diag(part.inertia) @ turn.T
        inertia += part.mass * (where @ where * np.eye(3) - np.outer(where, where))
    return MassProperties(mass, centre, inertia)


def _rotation_z(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
