"""An aircraft file from a model of another simulator, which marks what that model does not say.

Parts and rotors are the model's. Of the drives it takes what the model's motor plugins say; what they leave
out is another aircraft's, if the user names one, else a value that is marked as assumed. Thrust, torque and
speed are never assumed.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim.aircraft.mass import Part, Vector, rotation_angles
from sim.aircraft.model import (
    RPM,
    Aircraft,
    FirstOrderResponse,
    TorqueResponse,
    aircraft_file,
    load_aircraft,
    parse_aircraft,
)
from sim.aircraft.robot import VERTICAL, Array, Drive, Link, Robot, read_xml
from sim.aircraft.sdf import read_sdf
from sim.aircraft.urdf import read_urdf
from toolchain.contract import MOTOR_COUNT_MAX
from toolchain.errors import AircraftError

ROTORS_MIN = 3
MASS_MIN = 1e-6  # [kg], of a part
SAME = 1e-6  # relative: propellers that differ by less are one
GYRO_OF = "nf1"  # whose gyro and accelerometer an aircraft has that says nothing of them
LAG_S = (0.03, 0.04)  # assumed; small brushless drives have 20 to 60 ms
DELAY_S = 0.002
ROTOR_MASS = 0.013  # of the aircraft's, a propeller: the NF1's is 1.3 %, the Iris' 1.7 %
BLADE = 0.6 / 12  # of a tapered rod's moment, in m D^2; see docs/own-aircraft.md


@dataclass(frozen=True)
class Said:
    """A value of the aircraft file, and whose it is."""

    value: Any
    source: str


@dataclass(frozen=True, eq=False)
class Imported:
    """An aircraft file made of a model."""

    text: str
    aircraft: Aircraft
    assumed: tuple[str, ...]  # what stands in it that the model does not say
    notes: tuple[str, ...]


def read_robot(path: Path) -> Robot:
    """Return the content of a URDF or SDF file. Raises AircraftError, one line."""
    where = str(path)
    if not path.is_file():
        raise AircraftError(f"{where}: no such file; expected a .urdf or .sdf")
    root = read_xml(path, where)
    if root.tag == "robot":
        return read_urdf(root, where)
    if root.tag == "sdf":
        return read_sdf(root, path, where)
    raise AircraftError(f"{where}: its root is <{root.tag!s:.60}>, expected <robot> (URDF) or <sdf>")


def import_aircraft(
    path: Path, *, like: str | None = None, spins: Sequence[str] | None = None, name: str | None = None
) -> Imported:
    """Return the aircraft of a URDF or SDF file.

    like: a shipped name or a file, of the aircraft that has what the model does not say; spins: "cw" or "ccw"
    of each rotor, in the model's order; name: of the aircraft, None: the model's. Raises AircraftError, one
    line, naming what is missing or cannot be flown.
    """
    robot, where = read_robot(path), str(path)
    drives = _turning(robot, spins, where)
    if spins is not None:
        robot = replace(robot, spins_by="")
    other = None if like is None else load_aircraft(like)
    writer = _Writer(robot, drives, where, other, like)
    text = writer.text(name or _name(robot.name), path.name)
    try:
        aircraft = parse_aircraft(text.encode(), where)
    except AircraftError as error:
        raise AircraftError(f"{error} (of the aircraft that {path.name} makes)") from error
    held = [f"joint {joint} moves in the model; here it is fixed at its zero" for joint in robot.held]
    return Imported(text, aircraft, tuple(writer.assumed), (*held, *writer.notes))


def _turning(robot: Robot, spins: Sequence[str] | None, where: str) -> list[Drive]:
    """The drives in the order of the aircraft file's rotors, each with its spin, checked."""
    drives = list(robot.drives)
    if all(drive.number is not None for drive in drives):
        drives.sort(key=lambda drive: drive.number or 0)
    if not ROTORS_MIN <= len(drives) <= MOTOR_COUNT_MAX:
        raise AircraftError(
            f"{where}: {len(drives)} rotors, expected {ROTORS_MIN} to {MOTOR_COUNT_MAX}: links that a motor "
            f"plugin names (motorConstant, turningDirection, linkName), or on continuous joints about z"
        )
    for drive in drives:
        if drive.link not in robot.links:
            raise AircraftError(
                f"{where}: a motor plugin turns link {drive.link!r}, which is not in the file"
            )
        axis = robot.axes.get(drive.link, robot.links[drive.link].pose.turn[:, 2])
        if abs(axis[2]) < VERTICAL * float(np.linalg.norm(axis)):
            pointing = ", ".join(f"{part:.3g}" for part in axis)
            raise AircraftError(
                f"{where}: rotor {drive.link} turns about [{pointing}], expected z: all thrust is along "
                f"the body's z here"
            )
    names = ", ".join(drive.link for drive in drives)
    if spins is not None:
        wrong = next((spin for spin in spins if spin not in ("cw", "ccw")), None)
        if wrong is not None or len(spins) != len(drives):
            raise AircraftError(f"--spins {','.join(spins)}: expected cw or ccw for each of: {names}")
        drives = [
            replace(drive, spin=1 if spin == "ccw" else -1) for drive, spin in zip(drives, spins, strict=True)
        ]
    if any(drive.spin is None for drive in drives):
        raise AircraftError(
            f"{where}: does not say which way its rotors turn; give --spins, cw or ccw seen from above for "
            f"each of: {names}"
        )
    return _in_bench_order(robot, drives)


def _hub(robot: Robot, drive: Drive) -> Array:
    link = robot.links[drive.link]
    return (link.pose @ link.centre).position if robot.hubs_at_centre else link.pose.position


def _in_bench_order(robot: Robot, drives: list[Drive]) -> list[Drive]:
    """Four rotors in X: 1 rear right, 2 front right, 3 rear left, 4 front left; others as they are."""
    centre = np.mean([_hub(robot, drive) for drive in drives], axis=0)
    places = {}
    for drive in drives:
        x, y, _ = _hub(robot, drive) - centre
        if min(abs(x), abs(y)) > 1e-3:
            places[y > 0.0, x > 0.0] = drive
    return [places[key] for key in sorted(places)] if len(places) == len(drives) == 4 else drives


def _name(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-._")[:32] or "imported"


class _Writer:
    """Writes the file, and keeps what is assumed in it."""

    def __init__(
        self, robot: Robot, drives: list[Drive], where: str, other: Aircraft | None, like: str | None
    ) -> None:
        self._robot, self._drives, self._where = robot, drives, where
        self._other, self._like = other, like
        self.assumed: list[str] = []
        self.notes: list[str] = []

    def text(self, name: str, file: str) -> str:
        """The whole file."""
        robot = self._robot
        hubs = np.array([_hub(robot, drive) for drive in self._drives])
        rotors = {drive.link for drive in self._drives}
        thrust = robot.centre_of_thrust
        middle = Said(thrust or _vector(hubs.mean(axis=0)), "its centerOfThrust" if thrust else "")
        lines = [
            f"# Made of {file} by `neuroflight aircraft import`. What that file does not say is marked as",
            "# assumed, or as another aircraft's. Look at it with `neuroflight aircraft check`.",
            "format = 1",
            f"name = {json.dumps(name)}",
            self._line("centre_of_thrust_m", middle, "the middle of the propellers"),
        ]
        for link in robot.links.values():
            if link.name not in rotors and link.mass >= MASS_MIN:
                lines += ["", "[[part]]", *_part_lines(link, self._where)]
            elif link.name not in rotors and link.mass > 0.0:
                self.notes.append(
                    f"link {link.name}, {link.mass:g} kg, is left out: lighter than a milligram"
                )
        lines += self._propellers(hubs)
        if robot.spins_by:
            self.assumed.append(f"rotor.spin: {robot.spins_by}")
        for drive, hub in zip(self._drives, hubs, strict=True):
            number = "" if drive.number is None else f", its motor {drive.number}"
            spin = '"ccw"' if drive.spin == 1 else '"cw"'
            assumed = f" # assumed: {robot.spins_by}" if robot.spins_by else ""
            lines += ["", f"[[rotor]] # {drive.link}{number}"]
            lines += [f"propeller_m = {_listed(_vector(hub))}", f"spin = {spin}{assumed}"]
        lines += self._propulsion()
        lines += self._others()
        lines += self._body(rotors)
        return "\n".join(lines) + "\n"

    def _line(self, key: str, said: Said, assumed: str = "") -> str:
        """A key with its value, and whose it is; assumed: what is, where the source is empty."""
        if not said.source:
            self.assumed.append(f"{key}: {assumed}")
        source = said.source or f"assumed: {assumed}"
        return f"{key} = {_toml(said.value)} # {source}"

    def _propellers(self, hubs: Array) -> list[str]:
        """The propellers' masses: one [propeller_part] where all are alike, else a part each."""
        links = [self._robot.links[drive.link] for drive in self._drives]
        parts = [_spun(link, hub, self._where) for link, hub in zip(links, hubs, strict=True)]
        known = [part for part in parts if part is not None]
        if not known:
            return []
        said = "# A turning blade is a disc on average: half of both cross moments each."
        first = known[0]
        if len(known) == len(parts) and all(_alike(first, part) for part in known):
            return [
                "",
                said,
                "[propeller_part]",
                *_mass_lines(first.mass, first.centre, np.array(first.inertia)),
            ]
        lines = ["", said]
        for part, hub in zip(parts, hubs, strict=True):
            if part is not None:
                lines += [
                    "[[part]]",
                    f"name = {json.dumps(part.name)}",
                    f"position_m = {_listed(_vector(hub))}",
                ]
                lines += _mass_lines(part.mass, part.centre, np.array(part.inertia))
        return lines

    def _common(self, key: str, tag: str) -> Any:  # noqa: ANN401 - a number or a vector
        """What all drives say alike. Raises AircraftError where they differ: an aircraft's are all alike."""
        values = [getattr(drive, key) for drive in self._drives]
        if any(value is not None and value != values[0] for value in values):
            raise AircraftError(
                f"{self._where}: its motors differ in {tag} ({values}); an aircraft here has the "
                f"same drive on all"
            )
        return values[0]

    def _given(self, key: str, tag: str) -> Said | None:
        value = self._common(key, tag)
        return None if value is None else Said(value, f"the file's {tag}")

    def _propulsion(self) -> list[str]:
        other = None if self._other is None else self._other.propulsion
        as_other = f"as of {self._like}"
        thrust, torque = (
            self._given("thrust_coefficient", "motorConstant"),
            self._given("torque_ratio", "momentConstant"),
        )
        if self._robot.hubs_at_centre:
            thrust = thrust and Said(thrust.value, "the file's kf, of rpm")
            torque = torque and Said(torque.value, "the file's km / kf")
        curve = self._curve()
        if other is not None:
            thrust = thrust or Said(_few(other.thrust_coefficient), as_other)
            torque = torque or Said(_few(other.torque_ratio), as_other)
            curve = curve or Said(_rounded(part / RPM for part in other.speed_curve), as_other)
        missing = [
            told
            for told, said in (
                ("thrust (motorConstant, or properties kf)", thrust),
                ("torque (momentConstant, or properties km)", torque),
                ("greatest speed (maxRotVelocity, or properties thrust2weight)", curve),
            )
            if said is None
        ]
        if thrust is None or torque is None or curve is None:
            raise AircraftError(
                f"{self._where}: says nothing of the rotors' {', '.join(missing)}; such a number "
                f"cannot be guessed: give --like AIRCRAFT, which has such drives"
            )
        radius = self._common("radius", "propellers")
        across = [self._robot.links[drive.link].radius for drive in self._drives]
        if radius is None and across[0] is not None and all(each == across[0] for each in across):
            radius = across[0]
        lines = ["", "[propulsion]"]
        lines.append(self._line("speed_curve_rpm", curve))
        lines.append(self._line("thrust_coefficient", thrust))
        lines.append(self._line("torque_ratio_m", torque))
        if radius is not None:
            lines.append(
                self._line("propeller_diameter_m", Said(2 * radius, "the file's, of its rotors' shape"))
            )
        lines.append(self._line("rotor_inertia_kg_m2", *self._rotor_inertia(radius, as_other)))
        drag, rolling = (
            self._given("drag", "rotorDragCoefficient"),
            self._given("rolling", "rollingMomentCoefficient"),
        )
        if self._robot.hubs_at_centre and drag is not None:
            drag = Said(drag.value, "the file's drag_coeff_xy")
        if other is not None:
            drag = drag or Said(other.drag_coefficient, as_other)
            rolling = rolling or Said(other.rolling_coefficient, as_other)
        lines.append(self._line("drag_coefficient", drag or Said(0.0, ""), "none"))
        lines.append(self._line("rolling_coefficient", rolling or Said(0.0, ""), "none"))
        delay = Said(DELAY_S, "") if other is None else Said(other.delay, as_other)
        lines.append(self._line("delay_s", delay, "ESC and loop together, as of the aircraft that ship"))
        if other is not None and curve.source == as_other and other.supply_voltage is not None:
            lines.append(self._line("supply_voltage_v", Said(other.supply_voltage, as_other)))
        return [*lines, "", "[propulsion.response]", *self._response(as_other)]

    def _curve(self) -> Said | None:
        """The speed over the throttle, [rpm]: GymFC's curve, or a line up to the greatest speed."""
        curve = self._given("speed_curve_rpm", "escTransferFunction")
        speed = self._common("speed_max", "maxRotVelocity")
        if curve is not None or speed is None:
            return curve
        tag = "thrust2weight and kf" if self._robot.hubs_at_centre else "maxRotVelocity"
        return Said(
            _rounded((0.0, speed / RPM, 0.0)), f"a line up to the file's {tag}, as that simulator has it"
        )

    def _rotor_inertia(self, radius: float | None, as_other: str) -> tuple[Said, str]:
        links = [self._robot.links[drive.link] for drive in self._drives]
        spun = _spun(links[0], links[0].pose.position, self._where)
        if spun is not None and spun.inertia[2][2] > 0.0:
            return Said(
                float(f"{spun.inertia[2][2]:.6g}"), "the file's, of a rotor's link; a motor's bell may lack"
            ), ""
        if self._other is not None:
            return Said(self._other.propulsion.rotor_inertia, as_other), ""
        if radius is None:
            raise AircraftError(
                f"{self._where}: its rotors have neither a mass nor a size; give --like AIRCRAFT, "
                f"which has such rotors"
            )
        mass = ROTOR_MASS * sum(link.mass for link in self._robot.links.values())
        moment = float(f"{BLADE * mass * (2 * radius) ** 2:.2g}")
        return Said(
            moment, ""
        ), f"a blade of {100 * ROTOR_MASS:g} % of the aircraft's mass; the file's weighs nothing"

    def _response(self, as_other: str) -> list[str]:
        torque = self._given("torque", "joint_control_pid")
        up, down = self._given("time_up", "timeConstantUp"), self._given("time_down", "timeConstantDown")
        other = None if self._other is None else self._other.propulsion.response
        if torque is None and (up is None or down is None) and isinstance(other, TorqueResponse):
            torque = Said((other.gain, other.torque_up, other.torque_down), as_other)
        if torque is not None:
            keys = ("gain", "torque_up_n_m", "torque_down_n_m")
            each = [
                self._line(key, Said(value, torque.source))
                for key, value in zip(keys, torque.value, strict=True)
            ]
            return ['kind = "torque"', *each]
        if isinstance(other, FirstOrderResponse):
            up = up or Said(other.time_constant_up, as_other)
            down = down or Said(other.time_constant_down, as_other)
        lag = "small brushless drives have 20 to 60 ms"
        return [
            'kind = "first_order"',
            self._line("time_constant_up_s", up or Said(LAG_S[0], ""), lag),
            self._line("time_constant_down_s", down or Said(LAG_S[1], ""), lag),
        ]

    def _others(self) -> list[str]:
        """Gyro and accelerometer, which a model does not have, and of another aircraft the battery too."""
        name = GYRO_OF if self._like is None else self._like
        document = tomllib.loads(aircraft_file(name).read_text())
        told = f"the {GYRO_OF}'s, as the chip is not known" if self._like is None else f"as of {self._like}"
        keys = ["gyro", "accelerometer", *(["esc", "battery"] if self._like is not None else [])]
        lines = []
        for key in keys:
            if isinstance(table := document.get(key), dict):
                plain = {name: value for name, value in table.items() if not isinstance(value, dict)}
                lines += ["", f"[{key}] # {'assumed: ' * (self._like is None)}{told}"]
                lines += [f"{name} = {_toml(value)}" for name, value in plain.items()]
                if self._like is None:
                    self.assumed.append(f"[{key}]: {told}")
        return lines

    def _body(self, rotors: set[str]) -> list[str]:
        """The box around what collides but for the rotors; nothing where nothing does."""
        corners = [
            link.pose.position + link.corners @ link.pose.turn.T
            for link in self._robot.links.values()
            if link.corners is not None and link.name not in rotors
        ]
        if not corners:
            self.notes.append(
                "nothing of the file collides, so there is no [body]: no ground, and no drag of it"
            )
            return []
        low, high = np.concatenate(corners).min(axis=0), np.concatenate(corners).max(axis=0)
        size, centre = np.maximum(high - low, 1e-3), (low + high) / 2
        return [
            "",
            "[body] # the box around what collides in the file; it says no drag areas",
            f"size_m = {_listed(_vector(size))}",
            f"centre_m = {_listed(_vector(centre))}",
        ]


def _part_lines(link: Link, where: str) -> list[str]:
    """Name, place and mass of a link."""
    turn = rotation_angles(link.pose.turn)
    lines = [f"name = {json.dumps(link.name)}", f"position_m = {_listed(_vector(link.pose.position))}"]
    if max(map(abs, turn)) > 1e-9:
        lines.append(f"rotation_rad = {_listed(_vector(np.array(turn)))}")
    return lines + _mass_lines(link.mass, _vector(link.centre.position), _inertia(link, where))


def _inertia(link: Link, where: str) -> Array:
    """The tensor about the link's centre of mass, along its axes."""
    if link.inertia is None:
        raise AircraftError(f"{where}: link {link.name} has a mass but no inertia; give it one")
    turned: Array = link.centre.turn @ link.inertia @ link.centre.turn.T
    return turned


def _spun(link: Link, hub: Array, where: str) -> Part | None:
    """A rotor's mass as it turns about z: in the body's axes, on the axis; None: it has none."""
    if link.mass < MASS_MIN:
        return None
    whole = link.pose.turn @ _inertia(link, where) @ link.pose.turn.T
    across, along = float(whole[0, 0] + whole[1, 1]) / 2, float(whole[2, 2])
    above = float((link.pose @ link.centre).position[2] - hub[2])
    inertia = ((across, 0.0, 0.0), (0.0, across, 0.0), (0.0, 0.0, along))
    return Part(link.name, link.mass, _vector(hub), (0.0, 0.0, 0.0), (0.0, 0.0, above), inertia)


def _alike(one: Part, other: Part) -> bool:
    mine, its = (np.array([part.mass, part.centre[2], *np.diag(part.inertia)]) for part in (one, other))
    return bool(np.allclose(mine, its, rtol=SAME, atol=1e-12))


def _mass_lines(mass: float, centre: Vector, inertia: Array) -> list[str]:
    """Mass, centre of mass and moments: three where there is nothing else, or the whole tensor."""
    moments = [inertia[0, 0], inertia[1, 1], inertia[2, 2]]
    products = [inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    if max(map(abs, products)) > 1e-9 * max(moments):
        moments += products
    return [
        f"mass_kg = {_number(mass)}",
        f"centre_of_mass_m = {_listed(centre)}",
        f"inertia_kg_m2 = {_listed(moments)}",
    ]


def _vector(values: Array) -> Vector:
    x, y, z = (float(value) for value in values)
    return (x, y, z)


def _few(polynomial: Sequence[float]) -> Any:  # noqa: ANN401 - one number, or several
    return polynomial[0] if len(polynomial) == 1 else tuple(polynomial)


def _rounded(values: Any) -> Vector:  # noqa: ANN401 - an iterable of three
    x, y, z = (float(f"{value:.7g}") for value in values)
    return (x, y, z)


def _toml(value: Any) -> str:  # noqa: ANN401 - of a TOML file
    if isinstance(value, list | tuple):
        return _listed(value)
    return (
        _number(value)
        if isinstance(value, int | float) and not isinstance(value, bool)
        else json.dumps(value)
    )


def _listed(values: Sequence[Any]) -> str:
    return f"[{', '.join(map(_toml, values))}]"


def _number(value: float) -> str:
    """A number with at most nine significant digits; whole ones stay whole."""
    return str(value) if isinstance(value, int) else repr(float(f"{value:.9g}") + 0.0)
