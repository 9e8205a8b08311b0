"""The text of an aircraft file from a model of another simulator, each line with whose number it is."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.mass import Vector
from neuroflight.sim.aircraft.model import RPM, Aircraft, FirstOrderResponse, TorqueResponse, aircraft_file
from neuroflight.sim.aircraft.robot import Drive, Robot
from neuroflight.sim.aircraft.robot_parts import (
    MASS_MIN,
    alike,
    hub_of,
    listed,
    mass_lines,
    part_lines,
    spun,
    toml,
    vector_of,
)
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.errors import AircraftError

GYRO_OF = "nf1"  # the aircraft whose gyro and accelerometer are assumed if a model has none
LAG_S = (0.03, 0.04)  # assumed; small brushless drives have 20 to 60 ms
DELAY_S = 0.002
ROTOR_MASS = 0.013  # of the aircraft's, a propeller: the NF1's is 1.3 %, the Iris' 1.7 %
BLADE = 0.6 / 12  # of a tapered rod's moment, in m D^2; see docs/guides/own-aircraft.md


@dataclass(frozen=True)
class Said:
    """A value of the aircraft file with its source."""

    value: Any
    source: str


class Writer:
    """A writer of the file, which also keeps the assumed values."""

    def __init__(
        self, robot: Robot, drives: list[Drive], where: str, other: Aircraft | None, like: str | None
    ) -> None:
        self._robot, self._drives, self._where = robot, drives, where
        self._other, self._like = other, like
        self.assumed: list[str] = []
        self.notes: list[str] = []

    def text(self, name: str, file: str) -> str:
        """Return the whole file."""
        robot = self._robot
        hubs = np.array([hub_of(robot, drive) for drive in self._drives])
        rotors = {drive.link for drive in self._drives}
        thrust = robot.centre_of_thrust
        middle = Said(thrust or vector_of(hubs.mean(axis=0)), "its centerOfThrust" if thrust else "")
        lines = [
            f"# Made of {file} by `neuroflight aircraft import`. What that file does not say is marked as",
            "# assumed, or as another aircraft's. Look at it with `neuroflight aircraft check`.",
            "format = 1",
            f"name = {json.dumps(name)}",
            self._line("centre_of_thrust_m", middle, "the middle of the propellers"),
        ]
        for link in robot.links.values():
            if link.name not in rotors and link.mass >= MASS_MIN:
                lines += ["", "[[part]]", *part_lines(link, self._where)]
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
            lines += [f"propeller_m = {listed(vector_of(hub))}", f"spin = {spin}{assumed}"]
        lines += self._propulsion()
        lines += self._others()
        lines += self._body(rotors)
        return "\n".join(lines) + "\n"

    def _line(self, key: str, said: Said, assumed: str = "") -> str:
        """Return a key with its value, and whose it is; assumed: what is, where the source is empty."""
        if not said.source:
            self.assumed.append(f"{key}: {assumed}")
        source = said.source or f"assumed: {assumed}"
        return f"{key} = {toml(said.value)} # {source}"

    def _propellers(self, hubs: Array) -> list[str]:
        """Return the propellers' masses: one [propeller_part] where all are alike, else a part each."""
        links = [self._robot.links[drive.link] for drive in self._drives]
        parts = [spun(link, hub, self._where) for link, hub in zip(links, hubs, strict=True)]
        known = [part for part in parts if part is not None]
        if not known:
            return []
        said = "# A turning blade is a disc on average: half of both cross moments each."
        first = known[0]
        if len(known) == len(parts) and all(alike(first, part) for part in known):
            return [
                "",
                said,
                "[propeller_part]",
                *mass_lines(first.mass, first.centre, np.array(first.inertia)),
            ]
        lines = ["", said]
        for part, hub in zip(parts, hubs, strict=True):
            if part is not None:
                lines += [
                    "[[part]]",
                    f"name = {json.dumps(part.name)}",
                    f"position_m = {listed(vector_of(hub))}",
                ]
                lines += mass_lines(part.mass, part.centre, np.array(part.inertia))
        return lines

    def _common(self, key: str, tag: str) -> Any:  # noqa: ANN401 - a number or a vector
        """Return the value that all drives share. Raises AircraftError if they differ."""
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
        """Return the speed over the throttle [rpm]: GymFC's curve, or a line up to the greatest speed."""
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
        turning = spun(links[0], links[0].pose.position, self._where)
        if turning is not None and turning.inertia[2][2] > 0.0:
            moment = float(f"{turning.inertia[2][2]:.6g}")
            return Said(moment, "the file's, of a rotor's link; a motor's bell may lack"), ""
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
        """Return gyro and accelerometer, which no model has, and of another aircraft the battery too."""
        name = GYRO_OF if self._like is None else self._like
        document = tomllib.loads(aircraft_file(name).read_text())
        told = f"the {GYRO_OF}'s, as the chip is not known" if self._like is None else f"as of {self._like}"
        keys = ["gyro", "accelerometer", *(["esc", "battery"] if self._like is not None else [])]
        lines = []
        for key in keys:
            if isinstance(table := document.get(key), dict):
                plain = {name: value for name, value in table.items() if not isinstance(value, dict)}
                lines += ["", f"[{key}] # {'assumed: ' * (self._like is None)}{told}"]
                lines += [f"{name} = {toml(value)}" for name, value in plain.items()]
                if self._like is None:
                    self.assumed.append(f"[{key}]: {told}")
        return lines

    def _body(self, rotors: set[str]) -> list[str]:
        """Return the box around what collides but for the rotors; nothing where nothing does."""
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
            f"size_m = {listed(vector_of(size))}",
            f"centre_m = {listed(vector_of(centre))}",
        ]


def _few(polynomial: Sequence[float]) -> Any:  # noqa: ANN401 - one number, or several
    return polynomial[0] if len(polynomial) == 1 else tuple(polynomial)


def _rounded(values: Any) -> Vector:  # noqa: ANN401 - an iterable of three
    x, y, z = (float(f"{value:.7g}") for value in values)
    return (x, y, z)
