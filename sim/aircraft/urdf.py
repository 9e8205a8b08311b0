"""URDF: links hang on joints; the element `properties` of gym-pybullet-drones says what its rotors do."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET

import numpy as np

from neuroflight.sim.aircraft.model import RPM
from neuroflight.sim.aircraft.robot import (
    HERE,
    LINKS_MAX,
    Drive,
    Link,
    Pose,
    Robot,
    collisions,
    motor_plugins,
    numbers,
    spinning_drives,
    tensor,
    vector,
)
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import AircraftError

ENDLESS = "continuous"
PROPELLER = re.compile(r"prop(\d+)_link")  # how gym-pybullet-drones names them
# Turning directions in its program, not in its files. `racer` turns the other way round.
TURNS = (1, -1, 1, -1)
TURNED_ROUND = "racer"
SPINS_BY = "as gym-pybullet-drones' program turns them; the file does not say it"


def read_urdf(root: ET.Element, where: str) -> Robot:
    """Return what the file says. Raises AircraftError, one line, on a file that is no tree of links."""
    elements = {_name(element, where): element for element in root.iterfind("link")}
    if not 1 <= len(elements) <= LINKS_MAX:
        raise AircraftError(f"{where}: {len(elements)} links, expected 1 to {LINKS_MAX}")
    joints: dict[str, ET.Element] = {}
    for joint in root.iterfind("joint"):
        child = _end(joint, "child", elements, where)
        _end(joint, "parent", elements, where)
        if child in joints:
            raise AircraftError(f"{where}: link {child} hangs on two joints; expected a tree")
        joints[child] = joint
    poses = {name: _pose_of(name, joints, where) for name in elements}
    links = {name: _link(element, poses[name], where) for name, element in elements.items()}
    axes = {
        child: poses[child].turn @ _axis(joint, where)
        for child, joint in joints.items()
        if joint.get("type") == ENDLESS
    }
    name = root.get("name") or "imported"
    drives = tuple(motor_plugins(root, where))
    properties = root.find("properties")
    if drives or properties is None:
        drives = drives or tuple(spinning_drives(links, axes))
        turning = {drive.link for drive in drives}
        held = tuple(
            f"{joint.get('name')} ({joint.get('type')})"
            for child, joint in joints.items()
            if joint.get("type") != "fixed" and child not in turning
        )
        return Robot(name, links, axes, drives, held=held)
    mass = sum(link.mass for link in links.values())
    drives = tuple(_propellers(properties, links, mass, name, f"{where}: properties"))
    return Robot(name, links, axes, drives, hubs_at_centre=True, spins_by=SPINS_BY)


def _propellers(
    properties: ET.Element, links: dict[str, Link], mass: float, name: str, where: str
) -> list[Drive]:
    """Return the drives: kf [N/rpm^2], km [N m/rpm^2], thrust2weight at full speed."""
    found = sorted((int(match[1]), link) for link in links if (match := PROPELLER.fullmatch(link)))
    if not found:
        raise AircraftError(f"{where}: no link is called prop0_link, prop1_link and so on")

    def number(key: str) -> float | None:
        return numbers(properties.get(key), 1, f"{where}: {key}")[0] if properties.get(key) else None

    lift, twist, most = number("kf"), number("km"), number("thrust2weight")
    if lift is None or lift <= 0.0:
        return [Drive(link=link, number=index) for index, link in found]
    speed = None if most is None else math.sqrt(most * mass * GRAVITY / (len(found) * lift)) * RPM
    turns = [-turn if name == TURNED_ROUND else turn for turn in TURNS]
    return [
        Drive(
            link=link,
            number=index,
            spin=turns[index] if len(found) == len(turns) and index < len(turns) else None,
            thrust_coefficient=lift / RPM**2,
            torque_ratio=None if twist is None else twist / lift,
            speed_max=speed,
            drag=number("drag_coeff_xy"),
            radius=number("prop_radius"),
        )
        for index, link in found
    ]


def _name(element: ET.Element, where: str) -> str:
    name = element.get("name")
    if not name:
        raise AircraftError(f"{where}: a {element.tag} has no name")
    return name


def _end(joint: ET.Element, which: str, links: dict[str, ET.Element], where: str) -> str:
    end = joint.find(which)
    name = None if end is None else end.get("link")
    if name is None or name not in links:
        raise AircraftError(
            f"{where}: joint {joint.get('name')}: its {which} {name!r} is no link of the file"
        )
    return name


def _pose_of(link: str, joints: dict[str, ET.Element], where: str) -> Pose:
    """Return the link's frame in that of the root, with all joints at zero."""
    pose, seen = HERE, {link}
    while link in joints:
        joint = joints[link]
        pose = _origin(joint, f"{where}: joint {joint.get('name')}") @ pose
        parent = joint.find("parent")
        link = "" if parent is None else str(parent.get("link"))
        if link in seen:
            raise AircraftError(f"{where}: the joints around link {link} form a circle; expected a tree")
        seen.add(link)
    return pose


def _origin(element: ET.Element, what: str) -> Pose:
    origin = element.find("origin")
    if origin is None:
        return HERE
    return Pose.of(*(vector(origin.get(key), f"{what}: origin {key}") for key in ("xyz", "rpy")))


def _axis(joint: ET.Element, where: str) -> Array:
    axis = joint.find("axis")
    if axis is None:
        return np.array([1.0, 0.0, 0.0])  # the format's default
    return np.array(vector(axis.get("xyz"), f"{where}: joint {joint.get('name')}: axis"))


def _link(element: ET.Element, pose: Pose, where: str) -> Link:
    name = _name(element, where)
    what = f"{where}: link {name}"
    corners, radius = collisions(
        element, lambda collision: _origin(collision, f"{what}: collision"), ET.Element.get, what
    )
    inertial = element.find("inertial")
    if inertial is None:
        return Link(name, pose, corners=corners, radius=radius)
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    kilograms = 0.0 if mass is None else numbers(mass.get("value"), 1, f"{what}: mass")[0]
    moments = None
    if inertia is not None:
        moments = tensor(inertia.get, f"{what}: inertia")
    return Link(name, pose, kilograms, _origin(inertial, what), moments, corners, radius)
