"""SDF: links with poses in their model, or relative to another frame; included models lie beside the file."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from scipy.spatial.transform import Rotation

from neuroflight.sim.aircraft.mass import Vector
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
    read_xml,
    spinning_drives,
    tensor,
    text_of,
    vector,
)
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.errors import AircraftError

MODEL = "__model__"
INCLUDES_MAX, DEPTH_MAX = 50, 8
ENDLESS_RAD = 1e4  # of a revolute joint: wider limits are those of a rotor


def read_sdf(root: ET.Element, path: Path, where: str) -> Robot:
    """Return what the file says. Raises AircraftError, one line, on one that is not one model."""
    models = [*root.iterfind("model"), *root.iterfind("world/model")]
    if len(models) != 1:
        raise AircraftError(f"{where}: {len(models)} models, expected a file of one")
    reader = _Reader(where)
    reader.model(models[0], path, HERE, "", 0)
    if not 1 <= len(reader.links) <= LINKS_MAX:
        raise AircraftError(f"{where}: {len(reader.links)} links, expected 1 to {LINKS_MAX}")
    drives = tuple(reader.drives) or tuple(spinning_drives(reader.links, reader.axes))
    name = models[0].get("name") or "imported"
    turning = {drive.link for drive in drives}
    held = tuple(joint for child, joint in reader.moving.items() if child not in turning)
    return Robot(name, reader.links, reader.axes, drives, centre_of_thrust=reader.centre_of_thrust, held=held)


class _Reader:
    """A reader that collects links and drives of a model and of those that it includes."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.links: dict[str, Link] = {}
        self.axes: dict[str, Array] = {}
        self.moving: dict[str, str] = {}  # joints by their child link
        self.drives: list[Drive] = []
        self.centre_of_thrust: Vector | None = None
        self._included = 0

    def model(self, model: ET.Element, path: Path, at: Pose, prefix: str, depth: int) -> None:
        """Read a model whose frame is at `at`; names of its links get the prefix."""
        if depth > DEPTH_MAX:
            raise AircraftError(f"{self.where}: models within models, more than {DEPTH_MAX} deep")
        for include in model.iterfind("include"):
            self._include(include, path, at, prefix, depth)
        for nested in model.iterfind("model"):
            self._nested(
                nested, _pose(nested, self.where), path, at, f"{prefix}{nested.get('name')}::", depth
            )
        frames = {
            str(each.get("name")): each for tag in ("link", "frame", "joint") for each in model.iterfind(tag)
        }
        for element in model.iterfind("link"):
            name = f"{prefix}{element.get('name')}"
            if name in self.links:
                raise AircraftError(f"{self.where}: two links are called {name}")
            pose = at @ self._resolved(str(element.get("name")), frames, prefix, at, ())
            self.links[name] = _link(element, name, pose, self.where)
        for joint in model.iterfind("joint"):
            self._joint(joint, prefix)
        for plugin in model.iterfind("plugin"):
            self._centre(plugin, prefix)
        own = ET.Element("own")
        own.extend(model.iterfind("plugin"))
        for drive in motor_plugins(own, self.where):
            self.drives.append(replace(drive, link=f"{prefix}{drive.link}"))

    def _include(self, include: ET.Element, path: Path, at: Pose, prefix: str, depth: int) -> None:
        uri = text_of(include, "uri") or ""
        name = uri.removeprefix("model://").strip("/")
        self._included += 1
        parts = PurePosixPath(name).parts
        if len(parts) != 1 or parts[0] in ("..", ".") or self._included > INCLUDES_MAX:
            raise AircraftError(
                f"{self.where}: includes {uri!r:.60}, expected at most {INCLUDES_MAX} model://NAME"
            )
        beside = [
            folder / name / file
            for folder in (path.parent.parent, path.parent)
            for file in ("model.sdf", f"{name}.sdf")
        ]
        found = next((file for file in beside if file.is_file()), None)
        if found is None:
            raise AircraftError(f"{self.where}: includes {uri}, which is not beside it; expected {beside[0]}")
        models = [*read_xml(found, str(found)).iterfind("model")]
        if len(models) != 1:
            raise AircraftError(f"{found}: {len(models)} models, expected one")
        merged = include.get("merge") in ("true", "1")
        called = text_of(include, "name") or models[0].get("name")
        pose = (
            _pose(include, self.where)
            if include.find("pose") is not None
            else (HERE if merged else _pose(models[0], self.where))
        )
        self._nested(models[0], pose, found, at, prefix if merged else f"{prefix}{called}::", depth)

    def _nested(self, model: ET.Element, pose: Pose, path: Path, at: Pose, prefix: str, depth: int) -> None:
        self.model(model, path, at @ pose, prefix, depth + 1)

    def _resolved(
        self, name: str, frames: dict[str, ET.Element], prefix: str, at: Pose, seen: tuple[str, ...]
    ) -> Pose:
        """Return the frame called `name` in that of its model."""
        if name in ("", MODEL):
            return HERE
        if name in seen or len(seen) > LINKS_MAX:
            raise AircraftError(f"{self.where}: frame {name} is relative to itself")
        if name not in frames:
            if f"{prefix}{name}" in self.links:  # of an included model, in the body frame
                known = self.links[f"{prefix}{name}"].pose
                back = at.turn.T
                return Pose(back @ (known.position - at.position), back @ known.turn)
            raise AircraftError(
                f"{self.where}: a pose is relative to {name!r}, which is no frame of the model"
            )
        element = frames[name]
        pose = element.find("pose")
        given = None if pose is None else pose.get("relative_to") or pose.get("frame")
        usual = (
            (text_of(element, "child") or "") if element.tag == "joint" else element.get("attached_to") or ""
        )
        base = usual if given is None else given
        return self._resolved(base, frames, prefix, at, (*seen, name)) @ _pose(element, self.where)

    def _joint(self, joint: ET.Element, prefix: str) -> None:
        """Keep the axis of a joint that turns without end."""
        axis, child = joint.find("axis"), f"{prefix}{text_of(joint, 'child')}"
        if joint.get("type") != "fixed" and not _is_locked(axis):
            self.moving[child] = f"{prefix}{joint.get('name')} ({joint.get('type')})"
        if joint.get("type") not in ("revolute", "continuous") or axis is None or child not in self.links:
            return
        what = f"{self.where}: joint {joint.get('name')}"
        limit = axis.find("limit")
        low, high = (text_of(limit, tag) for tag in ("lower", "upper")) if limit is not None else (None, None)
        for end in (low, high):
            if end is not None and abs(numbers(end, 1, f"{what}: limit")[0]) < ENDLESS_RAD:
                return
        xyz = axis.find("xyz")
        direction = np.array(vector(text_of(axis, "xyz") or "0 0 1", f"{what}: axis"))
        # Up to SDF 1.6 `use_parent_model_frame`, later `expressed_in`; without either in the joint's frame.
        in_model = text_of(axis, "use_parent_model_frame") in ("1", "true") or (
            xyz is not None and xyz.get("expressed_in") == MODEL
        )
        if not in_model:
            turned = self.links[child].pose @ _pose(joint, self.where)
            direction = turned.turn @ direction
        self.axes[child] = direction

    def _centre(self, plugin: ET.Element, prefix: str) -> None:
        """Keep GymFC's centre of thrust."""
        thrust = plugin.find("centerOfThrust")
        if thrust is None:
            return
        link = f"{prefix}{text_of(thrust, 'link')}"
        if link not in self.links:
            raise AircraftError(f"{self.where}: centerOfThrust: link {link} is none of the file's")
        offset = np.array(vector(text_of(thrust, "offset"), f"{self.where}: centerOfThrust: offset"))
        pose = self.links[link].pose
        x, y, z = (pose.position + pose.turn @ offset).tolist()
        self.centre_of_thrust = (x, y, z)


def _is_locked(axis: ET.Element | None) -> bool:
    """Return True if a joint's limits are both zero: made so where a format had no fixed joints."""
    limit = None if axis is None else axis.find("limit")
    ends = [text_of(limit, tag) or "1" for tag in ("lower", "upper")]
    return limit is not None and not any(end.strip("-+0.") for end in ends)


def _pose(element: ET.Element, where: str) -> Pose:
    """Return the `pose` of an element; none: where its frame is."""
    pose = element.find("pose")
    if pose is None:
        return HERE
    what = f"{where}: {element.tag} {element.get('name') or ''}: pose"
    count = 7 if pose.get("rotation_format") == "quat_xyzw" else 6
    words = (
        numbers(pose.text, count, what)
        if len((pose.text or "").split()) != 3
        else (*vector(pose.text, what), *(0.0,) * (count - 3))
    )
    position, turn = (words[0], words[1], words[2]), words[3:]
    if count == 7:
        if not any(turn):
            raise AircraftError(f"{what}: a quaternion of zeros, expected one of length 1")
        return Pose(np.array(position), Rotation.from_quat(turn).as_matrix())
    if pose.get("degrees") in ("true", "1"):
        turn = tuple(map(math.radians, turn))
    return Pose.of(position, (turn[0], turn[1], turn[2]))


def _link(element: ET.Element, name: str, pose: Pose, where: str) -> Link:
    what = f"{where}: link {name}"
    inertial = element.find("inertial")
    if inertial is None or text_of(inertial, "mass") is None:
        raise AircraftError(f"{what}: has no mass, which SDF takes for 1 kg; give it an <inertial>")
    inertia = inertial.find("inertia")
    moments = None
    if inertia is not None:
        moments = tensor(lambda key: text_of(inertia, key), what)
    corners, radius = collisions(element, lambda collision: _pose(collision, what), text_of, what)
    mass = numbers(text_of(inertial, "mass"), 1, f"{what}: mass")[0]
    return Link(name, pose, mass, _pose(inertial, what), moments, corners, radius)
