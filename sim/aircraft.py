"""The description of an aircraft: a TOML file in, one frozen object out.

Keys carry their unit; each number's source stands in the file. A file that is missing, malformed or
names a key nobody reads is refused with the key's name.
"""

from __future__ import annotations

import hashlib
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.mass import MassProperties, Part, Vector, mass_properties
from sim.table import Table
from toolchain.contract import AXES, MOTOR_COUNT_MAX
from toolchain.errors import AircraftError

FOLDER = Path(__file__).parent / "aircraft"
FILE_BYTES_MAX = 256 << 10
RPM = 2 * math.pi / 60  # [rad/s] in one revolution a minute


@dataclass(frozen=True)
class Rotor:
    """One motor with its propeller, thrusting along body +z."""

    position: Vector  # [m], hub of the propeller, body frame
    spin: int  # +1 counter-clockwise seen from above, -1 clockwise


@dataclass(frozen=True)
class Propulsion:
    """What a motor command does to a rotor, the same for every rotor of the aircraft."""

    speed_curve: Vector  # a, b, c of H(u) = a u^2 + b u + c [rad/s]
    thrust_coefficient: float  # [N s^2/rad^2]
    torque_ratio: float  # [m], drag torque a newton of thrust
    rotor_inertia: float  # [kg m^2]
    response_gain: float  # [N m s/rad]
    response_torque_up: float  # [N m]
    response_torque_down: float  # [N m]
    drag_coefficient: float  # [N s^2/(rad m)]
    rolling_coefficient: float  # [N s^2/rad]
    delay: float  # [s], command to rotor, the control loop's own sample included


@dataclass(frozen=True)
class GyroNoise:
    """Noise of the gyro as the controller samples it."""

    noise: Vector  # [rad/s], standard deviation of white noise, one draw a sample
    bias: float  # [rad/s], standard deviation of the constant drawn for each episode


@dataclass(frozen=True)
class Aircraft:
    """Everything the twin knows of an aircraft."""

    name: str
    description: str
    sha256: str  # of the file's bytes
    parts: tuple[Part, ...]
    rotors: tuple[Rotor, ...]
    propulsion: Propulsion
    gyro: GyroNoise
    centre_of_thrust: Vector  # [m], where the attitude rig holds it
    pid_gains: tuple[Vector, Vector, Vector] | None  # roll, pitch, yaw as K_P, K_I, K_D (docs in nf1.toml)
    mass_properties: MassProperties

    @property
    def motor_count(self) -> int:
        """Number of motors M."""
        return len(self.rotors)

    @property
    def rotor_positions(self) -> NDArray[np.float64]:
        """Hubs relative to the centre of mass [m], shape (M, 3), motor order."""
        return np.array([rotor.position for rotor in self.rotors]) - self.mass_properties.centre

    @property
    def spins(self) -> NDArray[np.float64]:
        """Turning directions, shape (M,), +1 counter-clockwise seen from above."""
        return np.array([float(rotor.spin) for rotor in self.rotors])


def shipped() -> tuple[str, ...]:
    """Names of the aircraft that come with the project."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def load_aircraft(name: str | Path) -> Aircraft:
    """Read an aircraft by shipped name or by path. Raises AircraftError naming the file and key."""
    path = FOLDER / f"{name}.toml" if str(name) in shipped() else Path(name)
    if not path.is_file():
        known = ", ".join(shipped())
        raise AircraftError(
            f"aircraft {str(name)!r}: no such file; give the path of a .toml file or one of: {known}"
        )
    if path.stat().st_size > FILE_BYTES_MAX:
        raise AircraftError(
            f"aircraft file {path}: {path.stat().st_size} bytes, expected at most {FILE_BYTES_MAX}"
        )
    return parse_aircraft(path.read_bytes(), str(path))


def parse_aircraft(data: bytes, where: str) -> Aircraft:
    """Aircraft from the bytes of its file; `where` names it in messages. Raises AircraftError."""
    try:
        document = tomllib.loads(data.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise AircraftError(f"aircraft file {where}: not TOML: {error}") from error
    root = Table(document, f"aircraft file {where}", AircraftError)
    root.integer("format", 1, 1)
    name = root.text("name")
    description = root.text("description", "")
    centre_of_thrust = root.vector("centre_of_thrust_m", -10, 10)
    rotors, mounted = _rotors(root)
    parts = (*(_part(table) for table in root.tables("part", 1, 1000)), *mounted)
    propulsion = _propulsion(root.table("propulsion"))
    gyro = _gyro(root.table("gyro"))
    pid = _pid(root.table("pid")) if root.has("pid") else None
    root.finish()
    return Aircraft(
        name=name,
        description=description,
        sha256=hashlib.sha256(data).hexdigest(),
        parts=parts,
        rotors=rotors,
        propulsion=propulsion,
        gyro=gyro,
        centre_of_thrust=centre_of_thrust,
        pid_gains=pid,
        mass_properties=mass_properties(parts),
    )


def _part(table: Table, name: str | None = None, position: Vector | None = None) -> Part:
    part = Part(
        name=name or table.text("name"),
        mass=table.number("mass_kg", 1e-6, 1000),
        position=position or table.vector("position_m", -10, 10),
        yaw=0.0 if position else table.number("yaw_rad", -2 * math.pi, 2 * math.pi, 0.0),
        centre=table.vector("centre_of_mass_m", -10, 10),
        inertia=table.vector("inertia_kg_m2", 1e-12, 1000),
    )
    table.finish()
    a, b, c = part.inertia
    if a + b < c or b + c < a or c + a < b:
        raise table.error(
            "inertia_kg_m2",
            f"{list(part.inertia)} is no rigid body's: each moment must be at most the sum of the other two",
        )
    return part


def _rotors(root: Table) -> tuple[tuple[Rotor, ...], tuple[Part, ...]]:
    motor, propeller = root.table("motor_part"), root.table("propeller_part")
    rotors: list[Rotor] = []
    parts: list[Part] = []
    for number, table in enumerate(root.tables("rotor", 3, MOTOR_COUNT_MAX), start=1):
        hub = table.vector("propeller_m", -10, 10)
        parts.append(_part(motor, f"motor {number}", table.vector("motor_m", -10, 10)))
        parts.append(_part(propeller, f"propeller {number}", hub))
        spin = table.choice("spin", {"cw": -1, "ccw": 1})
        table.finish()
        rotors.append(Rotor(hub, spin))
    return tuple(rotors), tuple(parts)


def _propulsion(table: Table) -> Propulsion:
    a, b, c = table.vector("speed_curve_rpm", -1e6, 1e6)
    propulsion = Propulsion(
        speed_curve=(a * RPM, b * RPM, c * RPM),
        thrust_coefficient=table.number("thrust_coefficient", 1e-12, 1),
        torque_ratio=table.number("torque_ratio_m", 0, 10),
        rotor_inertia=table.number("rotor_inertia_kg_m2", 1e-12, 10),
        response_gain=table.number("response_gain", 1e-12, 10),
        response_torque_up=table.number("response_torque_up_n_m", 1e-9, 1000),
        response_torque_down=table.number("response_torque_down_n_m", 1e-9, 1000),
        drag_coefficient=table.number("drag_coefficient", 0, 1),
        rolling_coefficient=table.number("rolling_coefficient", 0, 1),
        delay=table.number("delay_s", 0, 0.1),
    )
    table.finish()
    if b <= 0 or 2 * a + b < 0 or c < 0:
        raise table.error(
            "speed_curve_rpm", f"[{a}, {b}, {c}] must rise over throttle 0..1 and start at no less than 0 rpm"
        )
    return propulsion


def _gyro(table: Table) -> GyroNoise:
    x, y, z = (math.radians(value) for value in table.vector("noise_deg_s", 0, 100))
    gyro = GyroNoise((x, y, z), math.radians(table.number("bias_deg_s", 0, 100)))
    table.finish()
    return gyro


def _pid(table: Table) -> tuple[Vector, Vector, Vector]:
    gains: Sequence[Vector] = [table.vector(axis, 0, 1e6) for axis in AXES]
    table.finish()
    return (gains[0], gains[1], gains[2])
