"""The model of an aircraft, frozen dataclasses, and the reader of its TOML file.

Keys carry their unit; each number's source stands in the file. A file that is missing, malformed or has an
unknown key is an error that names the key. docs/reference/aircraft.md lists every key.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.advance import AdvanceRatio, read_advance
from neuroflight.sim.aircraft.airframe import ZERO, Meshes, read_parts, read_rotors, reject_collisions
from neuroflight.sim.aircraft.airframe import Rotor as Rotor
from neuroflight.sim.aircraft.digest import EARLIER, file_sha256, flown_sha256
from neuroflight.sim.aircraft.known import Known, read_known
from neuroflight.sim.aircraft.mass import MassProperties, Part, Vector, mass_properties
from neuroflight.sim.aircraft.props_out import SUFFIX, props_out
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.contract import AXES, GRAVITY, Mix
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.files import read_limited
from neuroflight.toolchain.policy.gyro_filters import NONE, UNFILTERED, GyroFilters
from neuroflight.toolchain.strict_toml import StrictTable, parse_toml

FOLDER = Path(__file__).parent
FILE_BYTES_MAX = 256 << 10
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,31}")  # it is printed into the C of a policy
RPM = 2 * math.pi / 60  # [rad/s] in one revolution a minute
COEFFICIENT_TERMS_MAX = 4  # of a polynomial of rotor speed
EFFICIENCY_DEFAULT = 0.7  # of motor and ESC together; small brushless drives reach 0.6 to 0.8 under load
MOTOR_THRUST = (0.1, 3.0)  # over the mean of an aircraft's motors
CELL_VOLTAGE_MIN, CELL_VOLTAGE_MAX = 3.0, 4.45  # [V], full cells of any lithium chemistry in use


@dataclass(frozen=True)
class TorqueResponse:
    """A P controller on rotor speed whose torque is clamped (Koch 2019, chapter 5)."""

    gain: float  # [N m s/rad]
    torque_up: float  # [N m], most it accelerates with
    torque_down: float  # [N m], most it brakes with
    friction: float = 0.0  # [N m s/rad], of the bearing: part of `gain`, and what the limits have to overcome

    @property
    def speed_max(self) -> float:
        """The speed [rad/s] at which friction takes all of the torque; infinite without friction."""
        return self.torque_up / self.friction if self.friction else math.inf


@dataclass(frozen=True)
class FirstOrderResponse:
    """A first-order lag, with one time constant for each direction."""

    time_constant_up: float  # [s], while the rotor gains speed
    time_constant_down: float  # [s], while it loses speed


Response = TorqueResponse | FirstOrderResponse


@dataclass(frozen=True)
class Propulsion:
    """The response of a rotor to a motor command, the same for every rotor of the aircraft.

    Coefficients are polynomials of rotor speed w [rad/s], lowest power first; one number is a constant.
    """

    speed_curve: Vector  # a, b, c of H(u) = a u^2 + b u + c [rad/s], at `supply_voltage`
    thrust_coefficient: tuple[float, ...]  # K_T(w) [N s^2/rad^2]: thrust = K_T w^2
    torque_ratio: tuple[float, ...]  # K_Q(w) [m]: drag torque = K_Q thrust
    rotor_inertia: float  # [kg m^2]
    response: Response
    drag_coefficient: float  # [N s^2/(rad m)]
    rolling_coefficient: float  # [N s^2/rad]
    delay: float  # [s], command to rotor, the control loop's own sample included
    supply_voltage: float | None  # [V], where the speed curve was measured; None: not known
    efficiency: float  # electrical power to power on the shaft, motor and ESC, 0..1
    propeller_diameter: float | None = None  # [m]; None: not known
    advance: AdvanceRatio | None = None  # needs the diameter; None: forces are those of a rotor at rest

    @property
    def speed_max(self) -> float:
        """Rotor speed at full command on the bench supply [rad/s]."""
        limit = self.response.speed_max if isinstance(self.response, TorqueResponse) else math.inf
        return min(sum(self.speed_curve), limit)

    @property
    def friction(self) -> float:
        """Friction of a rotor's bearing [N m s/rad] that its limited torque has to overcome."""
        return self.response.friction if isinstance(self.response, TorqueResponse) else 0.0


@dataclass(frozen=True)
class Battery:
    """A LiPo pack."""

    cells: int  # in series
    capacity: float  # [A s]
    rest_voltage: float  # [V], full, without load
    resistance: float  # [ohm], of pack and leads
    electronics_power: float  # [W], what runs besides the motors


@dataclass(frozen=True)
class Gyro:
    """The gyro as the controller samples it; what a file leaves out is ideal."""

    noise: Vector  # [rad/s], standard deviation of white noise, one draw a sample
    bias: float  # [rad/s], standard deviation of the constant drawn for each episode
    bandwidth_hz: float | None = None  # of the chip's own first-order low-pass; None: none
    misalignment: Vector = (0.0, 0.0, 0.0)  # [rad], small turns of the chip about the body axes
    vibration: Vector = (0.0, 0.0, 0.0)  # [rad/s], amplitude that one rotor causes at its full speed
    harmonics: tuple[float, ...] = ()  # of that, at 2 and 3 times the turns, for 1 at the turns themselves


@dataclass(frozen=True)
class Accelerometer:
    """The accelerometer beside the gyro."""

    noise: Vector  # [m/s^2], standard deviation of white noise, one draw a sample
    bias: float = 0.0  # [m/s^2], standard deviation of the constant drawn for each episode
    bandwidth_hz: float | None = None  # of a first-order low-pass; None: none
    full_scale: float = 16 * GRAVITY  # [m/s^2], where it saturates
    vibration: Vector = (0.0, 0.0, 0.0)  # [m/s^2], amplitude that one rotor causes at its full speed


@dataclass(frozen=True)
class Thermal:
    """A motor's winding as one heat capacity, which its resistance heats and the air around it cools."""

    winding_resistance: float  # [ohm]
    thermal_resistance: float  # [K/W], winding to ambient
    time_constant: float  # [s], of the winding's temperature
    ambient: float  # [degC]


@dataclass(frozen=True)
class EscTelemetry:
    """The resolution of the ESCs' reports; 0 is unrounded."""

    speed_step: float = 0.0  # [rad/s]
    voltage_step: float = 0.0  # [V]
    current_step: float = 0.0  # [A]
    thermal: Thermal | None = None  # of each motor; None: no temperature is known


@dataclass(frozen=True)
class Body:
    """The box that touches the ground and meets the wind."""

    size: Vector  # [m], along x, y, z
    centre: Vector  # [m], body frame
    drag_area: Vector  # [m^2], drag coefficient times area, along x, y, z


@dataclass(frozen=True)
class PidSettings:
    """A PID controller's settings; the sum in deg/s is divided by 1000 to a motor fraction."""

    gains: tuple[Vector, Vector, Vector]  # roll, pitch, yaw as K_P, K_I, K_D, on the error in deg/s
    derivative_cutoff_hz: float | None  # of the first-order low-pass on the derivative; None: none
    idle: float  # fraction an armed motor turns at without thrust, which these gains were found with
    # Share of each motor in roll, pitch and yaw, which the gains were found with; None: from the geometry.
    mixer: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]] | None = None
    tpa_rate: float = 0.0  # part of K_D that full throttle takes away
    tpa_breakpoint: float = 0.0  # throttle where that begins, 0..1
    nominal_voltage: float | None = None  # [V] that the gains were found with; None: not compensated
    mix: Mix = Mix.ATTITUDE_FIRST  # of its outputs with the pilot's thrust
    gyro_filters: GyroFilters = UNFILTERED  # of the gyro before it


@dataclass(frozen=True)
class Aircraft:
    """The content of an aircraft file."""

    name: str
    description: str
    sha256: str  # of what the twin flies: without name, description, comments and PIDs
    file_sha256: str  # of the file's bytes and its meshes', as in old policies; "": not of a file as it is
    parts: tuple[Part, ...]
    rotors: tuple[Rotor, ...]
    propulsion: Propulsion
    gyro: Gyro
    accelerometer: Accelerometer | None
    esc: EscTelemetry
    battery: Battery | None
    body: Body | None
    centre_of_thrust: Vector  # [m], where the attitude rig holds it
    pids: tuple[tuple[str, PidSettings], ...]  # by name; the first is the aircraft's own
    mass_properties: MassProperties
    known: Mapping[str, Known]  # how its numbers are known, by their keys; a number without has no mark
    motor_thrust: tuple[float, ...] | None  # of each over the mean, by a log; the twin's are alike

    @property
    def motor_count(self) -> int:
        """Number of motors M."""
        return len(self.rotors)

    def is_meant_by(self, sha256: str) -> bool:
        """Return True if the digest that a policy holds is this aircraft's, in the form of before too."""
        return EARLIER.get(sha256, sha256) in (self.sha256, self.file_sha256)

    @property
    def rotor_positions(self) -> Array:
        """Hubs relative to the centre of mass [m], shape (M, 3), motor order."""
        return np.array([rotor.position for rotor in self.rotors]) - self.mass_properties.centre

    @property
    def spins(self) -> Array:
        """Turning directions, shape (M,), +1 counter-clockwise seen from above."""
        return np.array([float(rotor.spin) for rotor in self.rotors])


def shipped() -> tuple[str, ...]:
    """List the aircraft that come with the project by name."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def aircraft_file(name: str | Path) -> Path:
    """Return the file of a shipped aircraft's name or of a path, with or without `:props-out` behind it."""
    plain = str(name).removesuffix(SUFFIX)
    return FOLDER / f"{plain}.toml" if plain in shipped() else Path(plain)


def load_aircraft(name: str | Path) -> Aircraft:
    """Read an aircraft by shipped name or by path. Raises AircraftError naming the file and key.

    With `:props-out` behind the name it is the same aircraft whose rotors all turn the other way.
    """
    path = aircraft_file(name)
    if not path.is_file():
        known = ", ".join(shipped())
        raise AircraftError(
            f"aircraft {str(name)!r}: no such file; give the path of a .toml file or one of: {known}"
        )
    data = read_limited(path, f"aircraft file {path}", FILE_BYTES_MAX, AircraftError)
    return parse_aircraft(data, str(path), path.parent, out=str(name).endswith(SUFFIX))


def parse_aircraft(data: bytes, where: str, folder: Path | None = None, *, out: bool = False) -> Aircraft:
    """Parse the bytes of an aircraft file; `where` names it in messages. Raises AircraftError.

    folder: where its meshes lie; without one, a file that names a mesh is refused. out: with its propellers
    out, all turning the other way than in the file.
    """
    document = over_base(parse_toml(data, f"aircraft file {where}", AircraftError), where)
    meshes = Meshes(folder)
    aircraft = aircraft_of(props_out(document) if out else document, where, meshes)
    return aircraft if out else replace(aircraft, file_sha256=file_sha256(data, meshes.contents()))


def aircraft_of(document: dict[str, Any], where: str, meshes: Meshes) -> Aircraft:
    """Return the aircraft of a parsed file, laid over its base. Raises AircraftError as parse_aircraft."""
    root = StrictTable(document, f"aircraft file {where}", AircraftError)
    root.integer("format", 1, 1)
    name = root.text("name")
    if not NAME.fullmatch(name):
        raise root.error("name", f"got {name!r}, expected at most 32 letters, digits, dots and dashes")
    description = root.text("description", "")
    centre_of_thrust = root.vector("centre_of_thrust_m", -10, 10)
    parts = read_parts(root, meshes)
    rotors, mounted = read_rotors(root, meshes)
    propulsion = root.part("propulsion", _propulsion)
    reject_collisions(root, rotors, propulsion.propeller_diameter)
    gyro = root.part("gyro", _gyro)
    accelerometer = root.optional_part("accelerometer", _accelerometer)
    esc = root.optional_part("esc", _esc) or EscTelemetry()
    if esc.thermal is not None and propulsion.supply_voltage is None:
        raise root.error(
            "esc.thermal", "heat needs the motors' current, and that propulsion.supply_voltage_v; give it"
        )
    battery = root.optional_part("battery", _battery)
    body = root.optional_part("body", _body)
    pids = root.optional_part("pid", lambda table: _pids(table, len(rotors))) or ()
    known = root.optional_part("known", lambda table: read_known(table, document)) or {}
    motors = len(rotors)
    motor_thrust = root.optional_part(
        "logged", lambda table: table.numbers("motor_thrust", motors, motors, *MOTOR_THRUST)
    )
    root.finish()
    parts += mounted
    return Aircraft(
        name=name,
        description=description,
        sha256=flown_sha256(document, meshes.read),
        file_sha256="",
        parts=tuple(parts),
        rotors=rotors,
        propulsion=propulsion,
        gyro=gyro,
        accelerometer=accelerometer,
        esc=esc,
        battery=battery,
        body=body,
        centre_of_thrust=centre_of_thrust,
        pids=pids,
        mass_properties=mass_properties(parts),
        known=known,
        motor_thrust=motor_thrust,
    )


def over_base(document: dict[str, Any], where: str) -> dict[str, Any]:
    """Return a parsed file laid over the shipped aircraft that its `base` names, if it has one.

    Tables are joined key by key; anything else, a list of tables too, is the file's or else the base's.
    Raises AircraftError where there is no such aircraft.
    """
    if (base := document.get("base")) is None:
        return document
    if base not in shipped():
        raise AircraftError(
            f"aircraft file {where}: base: got {base!r}, expected one of: {', '.join(shipped())}"
        )
    file = FOLDER / f"{base}.toml"
    below = parse_toml(file.read_bytes(), f"aircraft file {file}", AircraftError)
    return _over(below, {key: value for key, value in document.items() if key != "base"})


def _over(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    joined = {
        key: _over(below[key], value)
        for key, value in above.items()
        if isinstance(value, dict) and isinstance(below.get(key), dict)
    }
    return below | above | joined


def thrust_coefficient(c_t: float, diameter: float, density: float) -> float:
    """Compute K_T [N s^2/rad^2] of a propeller [m] in air of `density` [kg/m^3] from its dimensionless C_T.

    Source: T = C_T rho n^2 D^4 with n = w / 2 pi revolutions a second (UIUC Propeller Data Site).
    """
    return c_t * density * diameter**4 / (2 * math.pi) ** 2


def torque_ratio(c_t: float, c_q: float, diameter: float) -> float:
    """Compute K_Q [m], torque over thrust, of a propeller [m] from its dimensionless C_T and C_Q.

    Source: Q = C_Q rho n^2 D^5, beside T as above; C_Q is C_P / 2 pi.
    """
    return c_q * diameter / c_t


def _propulsion(table: StrictTable) -> Propulsion:
    a, b, c = table.vector("speed_curve_rpm", -1e6, 1e6)
    if b <= 0 or 2 * a + b < 0 or c < 0:
        raise table.error(
            "speed_curve_rpm", f"[{a}, {b}, {c}] must rise over throttle 0..1 and start at no less than 0 rpm"
        )
    diameter = table.optional_number("propeller_diameter_m", 0.01, 5)
    thrust, torque = _coefficients(table, (a + b + c) * RPM)
    propulsion = Propulsion(
        speed_curve=(a * RPM, b * RPM, c * RPM),
        thrust_coefficient=thrust,
        torque_ratio=torque,
        rotor_inertia=table.number("rotor_inertia_kg_m2", 1e-12, 10),
        response=table.part("response", _response),
        drag_coefficient=table.number("drag_coefficient", 0, 1),
        rolling_coefficient=table.number("rolling_coefficient", 0, 1),
        delay=table.number("delay_s", 0, 0.1),
        supply_voltage=table.optional_number("supply_voltage_v", 1, 1000),
        efficiency=table.number("efficiency", 0.05, 1, EFFICIENCY_DEFAULT),
        propeller_diameter=diameter,
        advance=table.optional_part("advance_ratio", read_advance),
    )
    if propulsion.advance is not None and diameter is None:
        raise table.error("propeller_diameter_m", "missing; [propulsion.advance_ratio] needs it")
    return propulsion


def _coefficients(table: StrictTable, speed_max: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Read K_T and K_Q, given as such or by the propeller's dimensionless C_T and C_Q."""
    if table.either("thrust_coefficient", "c_t") == "thrust_coefficient":
        table.either("torque_ratio_m", "c_q")
        thrust = _coefficient(table, "thrust_coefficient", speed_max, 1)
        return thrust, _coefficient(table, "torque_ratio_m", speed_max, 10)
    table.either("c_q", "torque_ratio_m")
    c_t, c_q = table.number("c_t", 1e-4, 1), table.number("c_q", 1e-6, 1)
    diameter = table.number("propeller_diameter_m", 0.01, 5)
    density = table.number("air_density_kg_m3", 0.01, 10)
    return (thrust_coefficient(c_t, diameter, density),), (torque_ratio(c_t, c_q, diameter),)


def _coefficient(table: StrictTable, key: str, speed_max: float, high: float) -> tuple[float, ...]:
    """Read a number, or a polynomial of rotor speed that stays positive up to `speed_max` [rad/s]."""
    polynomial = table.numbers(key, 1, COEFFICIENT_TERMS_MAX, -high, high)
    speeds = np.linspace(0.0, speed_max, 1001)
    values = np.polynomial.polynomial.polyval(speeds, polynomial)
    if values.min() <= 0 or values.max() > high:
        worst = values.min() if values.min() <= 0 else values.max()
        raise table.error(
            key,
            f"got {list(polynomial)}, which reaches {worst:.3g}; expected above 0 and at most {high:g} "
            f"at every speed up to {speed_max:.0f} rad/s",
        )
    return polynomial


def _response(table: StrictTable) -> Response:
    if table.choice("kind", {"torque": False, "first_order": True}):
        return FirstOrderResponse(
            time_constant_up=table.number("time_constant_up_s", 1e-4, 10),
            time_constant_down=table.number("time_constant_down_s", 1e-4, 10),
        )
    response = TorqueResponse(
        gain=table.number("gain", 1e-12, 10),
        torque_up=table.number("torque_up_n_m", 1e-9, 1000),
        torque_down=table.number("torque_down_n_m", 1e-9, 1000),
        friction=table.number("friction_n_m_s", 0, 10, 0.0),
    )
    if response.friction >= response.gain:
        raise table.error(
            "friction_n_m_s",
            f"got {response.friction:g}, expected less than gain, {response.gain:g}, which includes it",
        )
    return response


def _battery(table: StrictTable) -> Battery:
    battery = Battery(
        cells=table.integer("cells", 1, 100),
        capacity=3600 * table.number("capacity_ah", 1e-3, 1e4),
        rest_voltage=table.number("rest_voltage_v", 0.5, 1000),
        resistance=table.number("resistance_ohm", 0, 100),
        electronics_power=table.number("electronics_w", 0, 1000, 0.0),
    )
    cell = battery.rest_voltage / battery.cells
    if not CELL_VOLTAGE_MIN <= cell <= CELL_VOLTAGE_MAX:
        raise table.error(
            "rest_voltage_v",
            f"got {battery.rest_voltage:g} V, {cell:.2f} V for each of {battery.cells} cells; expected "
            f"{CELL_VOLTAGE_MIN:g} to {CELL_VOLTAGE_MAX:g} V a full cell",
        )
    return battery


def _gyro(table: StrictTable) -> Gyro:
    return Gyro(
        noise=_radians(table.vector("noise_deg_s", 0, 100)),
        bias=math.radians(table.number("bias_deg_s", 0, 100)),
        bandwidth_hz=table.optional_number("bandwidth_hz", 1, 1e5),
        misalignment=_radians(table.vector("misalignment_deg", -10, 10, ZERO)),
        vibration=_radians(table.vector("vibration_deg_s", 0, 1000, ZERO)),
        harmonics=(
            table.numbers("vibration_harmonics", 1, 2, 0, 10) if table.has("vibration_harmonics") else ()
        ),
    )


def _accelerometer(table: StrictTable) -> Accelerometer:
    return Accelerometer(
        noise=table.vector("noise_m_s2", 0, 100),
        bias=table.number("bias_m_s2", 0, 10, 0.0),
        bandwidth_hz=table.optional_number("bandwidth_hz", 1, 1e5),
        full_scale=table.number("full_scale_m_s2", 1, 1e4, Accelerometer.full_scale),
        vibration=table.vector("vibration_m_s2", 0, 1000, ZERO),
    )


def _esc(table: StrictTable) -> EscTelemetry:
    return EscTelemetry(
        speed_step=table.number("speed_step_rpm", 0, 1e4, 0.0) * RPM,
        voltage_step=table.number("voltage_step_v", 0, 10, 0.0),
        current_step=table.number("current_step_a", 0, 10, 0.0),
        thermal=table.optional_part("thermal", _thermal),
    )


def _thermal(table: StrictTable) -> Thermal:
    return Thermal(
        winding_resistance=table.number("winding_ohm", 0, 100),
        thermal_resistance=table.number("resistance_k_w", 1e-3, 1e4),
        time_constant=table.number("time_constant_s", 1e-3, 1e5),
        ambient=table.number("ambient_c", -90, 90, 20.0),
    )


def _body(table: StrictTable) -> Body:
    return Body(
        size=table.vector("size_m", 1e-3, 20),
        centre=table.vector("centre_m", -10, 10),
        drag_area=table.vector("drag_area_m2", 0, 100, ZERO),
    )


def _pids(table: StrictTable, motors: int) -> tuple[tuple[str, PidSettings], ...]:
    return tuple((name, table.part(name, lambda pid: _pid(pid, motors))) for name in table.names())


def _pid(table: StrictTable, motors: int) -> PidSettings:
    roll, pitch, yaw = (table.vector(axis, 0, 1e6) for axis in AXES)
    return PidSettings(
        gains=(roll, pitch, yaw),
        derivative_cutoff_hz=table.optional_number("derivative_cutoff_hz", 1, 1e5),
        idle=table.number("idle", 0, 0.5, 0.0),
        mixer=table.optional_part("mixer", lambda mixer: _mixer(mixer, motors)),
        tpa_rate=table.number("tpa_rate", 0, 1, 0.0),
        tpa_breakpoint=table.number("tpa_breakpoint", 0, 0.99, 0.0),
        nominal_voltage=table.optional_number("nominal_voltage_v", 1, 1000),
        mix=table.choice("mix", {mix.text: mix for mix in Mix}, Mix.ATTITUDE_FIRST.text),
        gyro_filters=_gyro_filters(table),
    )


def _gyro_filters(table: StrictTable) -> GyroFilters:
    try:
        return GyroFilters.parse(table.text("gyro_filter", NONE))
    except ValueError as error:
        raise table.error("gyro_filter", str(error)) from None


def _mixer(table: StrictTable, motors: int) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    roll, pitch, yaw = (table.numbers(axis, motors, motors, -10, 10) for axis in AXES)
    return roll, pitch, yaw


def _radians(degrees: Vector) -> Vector:
    x, y, z = (math.radians(value) for value in degrees)
    return (x, y, z)
