"""The aircraft as polygons: parts, arms, rotor discs, and the arrow that points forward."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from neuroflight.sim.aircraft.mass import Part, rotation_matrix
from neuroflight.sim.aircraft.mesh import box, equal_box
from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.design.drawing import SPIN_COLOURS, is_propeller, part_surface, propeller_radius

DISC_CORNERS = 28
MOTOR_SIDES = 12  # of the can that stands for a motor
PLATE = 0.3  # side of a frame's plate, of the distance between the hubs that are furthest apart
PLATE_M = 0.004  # its thickness, and that of an arm
ARM = 0.12  # width of an arm, of a propeller's radius
TRIANGLES_MAX = 1500  # of the true surfaces together; finer meshes are drawn coarser
BELOW = 1.3  # of the aircraft's radius: how far the floor lies below the lowest place
IDLE_COLOUR, FULL_COLOUR = "#ffe9a8", "#b3261e"  # of a rotor disc: command 0, command 1


class Kind(Enum):
    """The objects of polygons, by which they are coloured."""

    BODY = "body"
    DISC = "disc"  # coloured by its motor's command
    NOSE = "nose"


@dataclass(frozen=True, eq=False)
class Face:
    """A flat polygon."""

    kind: Kind
    corners: Array  # (K, 3) [m], about the centre of mass, body axes
    motor: int = -1  # of a disc, from 0
    edge: str = ""  # of a disc: the colour of its direction of turning


def aircraft_faces(aircraft: Aircraft) -> list[Face]:
    """Return the polygons of the aircraft.

    Solids and meshes are drawn as they are. Of the parts of which only mass and inertia are known, one that
    reaches far out between the rotors is drawn as a plate, others as the boxes of their inertia. Arms go to
    the motors that no solid reaches.
    """
    centre = aircraft.mass_properties.centre
    hubs = aircraft.rotor_positions  # about the centre of mass
    radius = propeller_radius(aircraft)
    span = float(np.linalg.norm(hubs[:, None] - hubs[None], axis=2).max())
    true, surfaces = [np.zeros((0, 3, 3))], []
    for part in aircraft.parts:
        if is_propeller(part):
            continue
        surface, known = part_surface(part)
        if known and not part.name.startswith("motor "):
            true.append(surface)
        elif not part.name.startswith("motor "):
            surfaces.append(_estimate(part, span))
    solid = _coarse(np.concatenate(true))
    faces = [Face(Kind.BODY, triangle - centre) for triangle in np.concatenate([solid, *surfaces])]
    angle = 2 * np.pi * np.arange(DISC_CORNERS) / DISC_CORNERS
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    seats = {part.name: np.array(part.position) for part in aircraft.parts}
    middle = hubs.mean(axis=0) + centre
    for number, rotor in enumerate(aircraft.rotors):
        hub = np.array(rotor.position)
        seat = seats.get(f"motor {number + 1}", hub - [0.0, 0.0, 0.15 * radius])
        reached = solid.reshape(-1, 3)[:, :2] - hub[:2]
        if not (np.hypot(*reached.T) < 0.5 * radius).any():
            faces += [Face(Kind.BODY, bar - centre) for bar in _arm(middle, seat, ARM * radius)]
        faces += [Face(Kind.BODY, side - centre) for side in _can(seat, hub, 0.17 * radius)]
        faces.append(Face(Kind.DISC, hub - centre + ring, number, SPIN_COLOURS[rotor.spin]))
    tip, height = float(hubs[:, 0].max()) + 0.8 * radius, float(hubs[:, 2].mean())
    base, half = tip - 0.9 * radius, 0.28 * radius
    arrow = [[tip, 0.0, height], [base, half, height], [base + 0.3 * radius, 0.0, height]]
    faces.append(Face(Kind.NOSE, np.array(arrow)))
    faces.append(Face(Kind.NOSE, np.array(arrow) * [1.0, -1.0, 1.0]))
    return faces


def reach(aircraft: Aircraft) -> float:
    """Return the radius [m] of a sphere about the centre of mass that contains all polygons."""
    return max(float(np.linalg.norm(face.corners, axis=1).max()) for face in aircraft_faces(aircraft))


def disc_colour(command: float) -> tuple[float, float, float]:
    """Return RGB 0..1 of a rotor disc at a motor's command, 0..1."""
    low, high = (np.array([int(c[k : k + 2], 16) for k in (1, 3, 5)]) for c in (IDLE_COLOUR, FULL_COLOUR))
    red, green, blue = ((low + min(max(command, 0.0), 1.0) * (high - low)) / 255).tolist()
    return red, green, blue


def _estimate(part: Part, span: float) -> Array:
    """Return triangles (12, 3, 3) [m], body frame, of a part of which only the inertia is known."""
    size, axes = equal_box(part.mass, part.inertia)
    if size.max() > 0.5 * span:  # weight far from the middle: plate and arms, not the slab of equal inertia
        size, axes = np.array([PLATE * span, 0.7 * PLATE * span, PLATE_M]), np.eye(3)
        turn = np.eye(3)
    else:
        turn = rotation_matrix(part.rotation)
    about = box((float(size[0]), float(size[1]), float(size[2])), (0.0, 0.0, 0.0)).surface
    placed: Array = about @ (turn @ axes).T + rotation_matrix(part.rotation) @ part.centre + part.position
    return placed


def _arm(middle: Array, seat: Array, width: float) -> Array:
    """Return triangles (12, 3, 3) [m] of a flat bar from under the middle of the rotors to a motor."""
    along = (seat - middle) * [1.0, 1.0, 0.0]
    length = float(np.linalg.norm(along))
    x = along / length if length > 0 else np.array([1.0, 0.0, 0.0])
    axes = np.column_stack([x, np.cross([0.0, 0.0, 1.0], x), [0.0, 0.0, 1.0]])
    bar: Array = box((length + width, width, PLATE_M), (0.0, 0.0, 0.0)).surface @ axes.T + seat - along / 2
    return bar


def _can(seat: Array, hub: Array, radius: float) -> list[Array]:
    """Return sides and lid of a motor between its seat and the hub."""
    angle = 2 * np.pi * np.arange(MOTOR_SIDES) / MOTOR_SIDES
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    low, high = seat + ring, hub + ring
    sides = [np.array([low[k - 1], low[k], high[k], high[k - 1]]) for k in range(MOTOR_SIDES)]
    return [*sides, high]


def _coarse(triangles: Array) -> Array:
    """Simplify triangles (K, 3, 3): move their corners to an ever wider grid until few are left."""
    cells = 64
    while len(triangles) > TRIANGLES_MAX and cells > 4:
        step = float(np.ptp(triangles.reshape(-1, 3), axis=0).max()) / cells
        moved = np.unique(np.rint(triangles / step), axis=0)
        thin = (moved == np.roll(moved, 1, axis=1)).all(axis=2).any(axis=1)
        triangles, cells = step * moved[~thin], cells // 2
    return triangles
