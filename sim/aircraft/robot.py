"""A model of another simulator, URDF or SDF, as links, poses and drives: what both formats say alike.

The files are untrusted: of limited size, UTF-8, without DTD or entities. Nothing is fetched, and no mesh is
opened.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.mass import Vector, rotation_matrix
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.files import read_limited

FILE_BYTES_MAX = 4 << 20
ELEMENTS_MAX = 100_000
LINKS_MAX = 1000
VERTICAL = math.cos(math.radians(1.0))  # of a rotor's axis: thrust along the body's z


@dataclass(frozen=True, eq=False)
class Pose:
    """A frame in another one."""

    position: Array  # (3,) [m]
    turn: Array  # (3, 3), from this frame to the other

    @staticmethod
    def of(position: Vector, rotation: Vector) -> Pose:
        """Return a pose; rotation: roll, pitch, yaw [rad] about the fixed x, then y, then z axis."""
        return Pose(np.array(position), rotation_matrix(rotation))

    def __matmul__(self, inner: Pose) -> Pose:
        """Return the frame `inner` of this frame in the frame that this one is in."""
        return Pose(self.position + self.turn @ inner.position, self.turn @ inner.turn)


HERE = Pose(np.zeros(3), np.eye(3))


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid part."""

    name: str
    pose: Pose  # in the body frame
    mass: float = 0.0  # [kg]
    centre: Pose = HERE  # of mass, with the axes of the inertia, in the link
    inertia: Array | None = None  # (3, 3) [kg m^2]; None: not said
    corners: Array | None = None  # (K, 3) [m] of the boxes around colliding shapes, in the link
    radius: float | None = None  # [m], of a cylinder that collides


@dataclass(frozen=True)
class Drive:
    """A rotor, and what the file says of its motor; None: nothing."""

    link: str
    joint: str | None = None
    number: int | None = None
    spin: int | None = None  # +1 counter-clockwise seen from above
    thrust_coefficient: float | None = None  # [N s^2/rad^2]
    torque_ratio: float | None = None  # [m]
    speed_max: float | None = None  # [rad/s]
    speed_curve_rpm: Vector | None = None
    time_up: float | None = None  # [s]
    time_down: float | None = None  # [s]
    torque: Vector | None = None  # gain [N m s/rad], most that accelerates and brakes [N m]
    drag: float | None = None  # [N s^2/(rad m)]
    rolling: float | None = None  # [N s^2/rad]
    radius: float | None = None  # [m], of the propeller


@dataclass(frozen=True, eq=False)
class Robot:
    """The content of a model file."""

    name: str
    links: dict[str, Link]
    axes: dict[str, Array]  # of joints that turn without end, in the body frame, by their child link
    drives: tuple[Drive, ...]
    hubs_at_centre: bool = False  # whether a rotor's hub is its link's centre of mass, not its origin
    centre_of_thrust: Vector | None = None  # [m], body frame
    held: tuple[str, ...] = ()  # other joints that move: they are taken at zero
    spins_by: str = ""  # source of the turning directions in `drives`; empty: the file


def read_xml(path: Path, where: str) -> ET.Element:
    """Parse a file. Raises AircraftError, one line, on one that is missing, too large or no such XML."""
    try:
        text = read_limited(path, where, FILE_BYTES_MAX, AircraftError).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise AircraftError(f"{where}: not UTF-8 at byte {error.start}; save it as UTF-8 text") from error
    if any(word in text.upper() for word in ("<!DOCTYPE", "<!ENTITY")):
        raise AircraftError(f"{where}: has a document type or entities, which no robot needs; remove them")
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise AircraftError(f"{where}: not XML: {error}") from error
    for count, element in enumerate(root.iter()):
        if count > ELEMENTS_MAX:
            raise AircraftError(f"{where}: more than {ELEMENTS_MAX} elements")
        template = "xacro" in element.tag or any("${" in value for value in element.attrib.values())
        element.tag = element.tag.rpartition("}")[2]  # without its namespace
        if template or "{{" in (element.text or ""):
            raise AircraftError(
                f"{where}: is a template; expand it first, such as `xacro {path.name} > out.urdf`"
            )
    return root


def text_of(element: ET.Element | None, tag: str) -> str | None:
    """Return the text of a child, without space around it; None: there is none."""
    child = None if element is None else element.find(tag)
    return None if child is None or child.text is None or not child.text.strip() else child.text.strip()


def numbers(text: str | None, count: int, what: str) -> tuple[float, ...]:
    """Return `count` finite numbers of a text; none at all: zeros. Raises AircraftError naming `what`."""
    words = (text or "").split()
    if not words:
        return (0.0,) * count
    try:
        found = tuple(map(float, words))
    except ValueError:
        found = ()
    if len(found) != count or not all(map(math.isfinite, found)):
        raise AircraftError(f"{what}: got {text!r:.60}, expected {count} finite number{'s' * (count > 1)}")
    return found


def vector(text: str | None, what: str) -> Vector:
    """Return three numbers; none: zeros."""
    x, y, z = numbers(text, 3, what)
    return (x, y, z)


def tensor(moment: Callable[[str], str | None], what: str) -> Array:
    """Return a tensor (3, 3); moment: the text of one of its elements, by name."""
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (numbers(moment(key), 1, f"{what}: {key}")[0] for key in keys)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def box_corners(pose: Pose, size: Vector) -> Array:
    """Return the corners (8, 3) of a box in the frame that `pose` is in."""
    signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    corners: Array = pose.position + (signs * np.array(size)) @ pose.turn.T
    return corners


def collisions(
    link: ET.Element,
    pose: Callable[[ET.Element], Pose],
    size: Callable[[ET.Element, str], str | None],
    what: str,
) -> tuple[Array | None, float | None]:
    """Return corners of the boxes around a link's boxes, cylinders and spheres, and a cylinder's radius.

    pose: of a collision in the link; size: the text of a shape's key, which URDF and SDF keep differently.
    """
    corners, radius = [], None

    def number(shape: ET.Element, key: str) -> float:
        return numbers(size(shape, key), 1, f"{what}: {key}")[0]

    for collision in link.iterfind("collision"):
        for shape in collision.iterfind("geometry/*"):
            if shape.tag == "box":
                sides = vector(size(shape, "size"), f"{what}: box")
            elif shape.tag == "cylinder":
                radius, length = (
                    numbers(size(shape, key), 1, f"{what}: {key}")[0] for key in ("radius", "length")
                )
                sides = (2 * radius, 2 * radius, length)
            elif shape.tag == "sphere":
                sides = (2 * numbers(size(shape, "radius"), 1, f"{what}: radius")[0],) * 3
            else:
                continue
            corners.append(box_corners(pose(collision), sides))
    return (np.concatenate(corners) if corners else None), radius


def motor_plugins(root: ET.Element, where: str) -> Iterator[Drive]:
    """Return the drives of a file's motor plugins: Gazebo, RotorS, PX4 and GymFC use the same words."""
    for plugin in root.iter("plugin"):
        if plugin.find("motorConstant") is None:
            continue
        name = f"{where}: plugin {plugin.get('name') or plugin.get('filename')}"

        def number(tag: str, plugin: ET.Element = plugin, name: str = name) -> float | None:
            text = text_of(plugin, tag)
            return None if text is None else numbers(text, 1, f"{name}: {tag}")[0]

        direction = text_of(plugin, "turningDirection")
        if direction not in ("cw", "ccw"):
            raise AircraftError(f"{name}: turningDirection {direction!r}, expected cw or ccw")
        link = text_of(plugin, "linkName")
        if link is None:
            raise AircraftError(f"{name}: linkName: missing; it says which link turns")
        index = number("motorNumber")
        yield Drive(
            link=link,
            joint=text_of(plugin, "jointName"),
            number=None if index is None else int(index),
            spin=1 if direction == "ccw" else -1,
            thrust_coefficient=number("motorConstant"),
            torque_ratio=number("momentConstant"),
            speed_max=number("maxRotVelocity"),
            speed_curve_rpm=_speed_curve(plugin, name),
            time_up=number("timeConstantUp"),
            time_down=number("timeConstantDown"),
            torque=_torque(plugin, name, 1 if direction == "ccw" else -1),
            drag=number("rotorDragCoefficient"),
            rolling=number("rollingMomentCoefficient"),
        )


def _speed_curve(plugin: ET.Element, name: str) -> Vector | None:
    """Return GymFC's curve of speed over throttle: a, b, c of a u^2 + b u + c [rpm]."""
    curve = plugin.find("escTransferFunction")
    if curve is None:
        return None
    words = [text_of(curve, f"term{number}Coefficient") for number in (1, 2, 3)]
    return vector(" ".join(word or "0" for word in words), f"{name}: escTransferFunction")


def _torque(plugin: ET.Element, name: str, spin: int) -> Vector | None:
    """Return GymFC's controller of the joint's speed: gain, most torque that accelerates and brakes."""
    pid = plugin.find("joint_control_pid")
    if pid is None:
        return None
    gain, low, high = (
        numbers(text_of(pid, tag), 1, f"{name}: joint_control_pid {tag}")[0]
        for tag in ("p", "cmdMin", "cmdMax")
    )
    up, down = (high, -low) if spin > 0 else (-low, high)
    return (gain, up, down) if min(gain, up, down) > 0.0 else None


def spinning_drives(robot_links: dict[str, Link], axes: dict[str, Array]) -> Iterator[Drive]:
    """Return a drive for each link on a joint that turns without end about the vertical."""
    for link, axis in axes.items():
        if link in robot_links and abs(axis[2]) >= VERTICAL * float(np.linalg.norm(axis)):
            yield Drive(link=link)
