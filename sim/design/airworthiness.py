"""The airworthiness of an aircraft and the plausibility of its numbers: figures and verdicts from its file.

Values that cannot be right are errors where the file is read; here are checks of plausibility. Their limits
are wide: they find a wrong unit or decimal place, not an unusual aircraft.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

import numpy as np

from neuroflight.sim.aircraft.mass import MeshPose, rotation_angles, rotation_matrix
from neuroflight.sim.aircraft.model import RPM, Aircraft, Propulsion
from neuroflight.sim.arrays import Array
from neuroflight.sim.design.figures import AircraftFigures, aircraft_figures, balanced_thrust, thrust_map
from neuroflight.sim.physics.air import AIR_DENSITY
from neuroflight.sim.physics.rotor import thrust_and_torque
from neuroflight.toolchain.contract import AXES, GRAVITY, MOTOR_PLACES

THRUST_TO_WEIGHT_LOW = 1.5  # below it little thrust is left for control
HEAVY = 1.0  # [kg], a part that may have been given in grams, where the aircraft cannot lift itself
PROPS_IN, PROPS_OUT = ("cw", "ccw", "ccw", "cw"), ("ccw", "cw", "cw", "ccw")  # in that order
BESIDE = 0.2  # of the hubs' distance: a hub nearer to an axis than this lies on it, as in a plus
SHARE_HIGH = 1.3  # greatest hover thrust of a rotor over the least
# Radius of gyration over the hubs' distance from the centre of mass: 0.35 to 0.6 for the shipped aircraft,
# 1 if all mass sat at the hubs of a ring. A slip of a thousand in the unit moves it by 30.
GYRATION_USUAL, GYRATION_POSSIBLE = (0.15, 0.85), (0.03, 1.5)
# Mass over the square of the wheelbase [kg/m^2]: 3 for a 27 g palm-sized quadrotor, 9 for a 5 inch racer.
LOADING_USUAL, LOADING_POSSIBLE = (1.0, 40.0), (0.1, 400.0)
FAR = 2.0  # a part farther from the centre of mass than this many hub distances is misplaced
# Ideal over actual power of a propeller at rest: 0.4 to 0.75 for small ones, 1 is the limit of physics.
MERIT_USUAL = (0.25, 0.85)
TIP_SPEED_HIGH = 270.0  # [m/s], 0.8 of the speed of sound; small propellers stay below
SUPPLY_USUAL, SUPPLY_POSSIBLE = (0.95, 1.25), (0.7, 1.5)  # full pack over the supply of the speed curve
CELL_LOADED_LOW = 3.0  # [V], where ESCs cut off and cells take harm
UPRIGHT = math.radians(20.0)  # between a propeller's thin axis and z
UPRIGHT_MOMENT = 1.05  # greatest moment over that about z; equal for one with two blades
THIN = 0.5  # greatest ratio of the least second moment to the next one of a thin propeller
STRAIGHT = 0.01  # smaller components of a thin axis come from the mesh's shape, not from its pose
OUTER_MIN = 0.05  # least part of the surface in the outer halves of the blades
UNBALANCED = 0.05  # in propeller radii: largest offset of the centre of mass from the hub's axis
CENTRE_OFF = 0.1  # of the hubs' distance: how far the stated centre of thrust may lie from theirs


class Level(Enum):
    """Severity of a verdict."""

    OK = "ok"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Verdict:
    """Result of one check."""

    level: Level
    subject: str
    message: str


Finding = tuple[Level, str]  # of a check, whose subject stands in CHECKS


def examine(aircraft: Aircraft) -> tuple[AircraftFigures, list[Verdict]]:
    """Compute the figures of an aircraft and the verdicts of all checks."""
    figures = aircraft_figures(aircraft)
    return figures, [
        Verdict(level, subject, message)
        for subject, check in CHECKS
        for level, message in check(aircraft, figures)
    ]


def _thrust(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    ratio = figures.thrust_to_weight
    message = f"{figures.thrust_max:.3g} N at full throttle, {ratio:.2f} times the weight"
    if ratio <= 1:
        hint = _grams(aircraft, figures) or (
            "; check mass_kg of the parts, speed_curve_rpm and the thrust coefficient"
        )
        yield Level.ERROR, f"{message}: it cannot lift itself{hint}"
    elif ratio < THRUST_TO_WEIGHT_LOW:
        low = f": little is left to steer with; expected {THRUST_TO_WEIGHT_LOW:g} or more"
        yield Level.WARNING, message + low
    else:
        yield Level.OK, message


def _grams(aircraft: Aircraft, figures: AircraftFigures) -> str:
    """Suggest, if the aircraft would fly then, that its parts of more than a kilogram were meant in grams."""
    heavy = [part for part in aircraft.parts if part.mass > HEAVY]
    meant = figures.mass - 0.999 * sum(part.mass for part in heavy)
    if not heavy or figures.thrust_max <= meant * GRAVITY:
        return ""
    first = max(heavy, key=lambda part: part.mass)
    return (
        f"; mass_kg is in kilograms, and {first.name!r} has {first.mass:g} of them: if grams are meant, "
        f"write {first.mass / 1000:.4g}"
    )


def _motors(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    """Check places and turning directions of a quadcopter's motors, on which everything else depends."""
    hubs = np.array([rotor.position[:2] for rotor in aircraft.rotors])
    offset = (hubs - hubs.mean(axis=0)) / max(figures.reach, 1e-9)
    if len(hubs) != len(MOTOR_PLACES) or np.abs(offset).min() < BESIDE:
        return  # no X: its motors have no such names
    places = [MOTOR_PLACES[2 * int(y > 0) + int(x > 0)] for x, y in offset]
    if sorted(places) != sorted(MOTOR_PLACES):
        return
    turns = ["ccw" if rotor.spin > 0 else "cw" for rotor in aircraft.rotors]
    listed = [
        f"{number} {place} {turn}" for number, (place, turn) in enumerate(zip(places, turns, strict=True), 1)
    ]
    found = ", ".join(listed)
    if tuple(places) != MOTOR_PLACES:
        wanted = ", ".join(f"{number} {place}" for number, place in enumerate(MOTOR_PLACES, 1))
        yield (
            Level.WARNING,
            f"{found}; expected {wanted}, as on the bench and in Betaflight: put the [[rotor]] tables into "
            f"that order",
        )
        return
    ways: dict[tuple[str, ...], str] = {
        PROPS_IN: ": propellers in, as Betaflight has it",
        PROPS_OUT: ": propellers out",
    }
    way = ways.get(tuple(turns), "")
    yield Level.OK, found + way


def _hover(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    if figures.hover is not None:
        thrust = figures.hover.thrust
        share = thrust.max() / max(thrust.min(), 1e-9)
        low, high = figures.hover.throttle.min(), figures.hover.throttle.max()
        message = f"throttle {low:.2f} to {high:.2f}" if high - low > 0.005 else f"throttle {high:.2f}"
        if share <= SHARE_HIGH:
            yield Level.OK, message
            return
        weak, strong = int(thrust.argmin()) + 1, int(thrust.argmax()) + 1
        times = f"{share:.1f} times that of" if share < 100 else "all of its weight beside"
        yield (
            Level.WARNING,
            f"{message}: motor {strong} carries {times} motor {weak}; the centre of mass lies off the "
            f"rotors' middle, or the spins are uneven",
        )
    elif figures.thrust_to_weight > 1:
        level = balanced_thrust(
            thrust_map(aircraft, np.ones(aircraft.motor_count))[:3],
            np.array([GRAVITY * figures.mass, 0.0, 0.0]),
            figures.thrust_max / aircraft.motor_count,
        )
        if level is None:
            x, y, _ = 1000 * figures.centre
            problem = (
                f"no distribution of thrust holds it level: the centre of mass, x {x:.0f} mm y {y:.0f} mm, "
                f"must lie among the rotors; check position_m of the parts and propeller_m"
            )
        else:
            problem = (
                "it can be held level, but the propellers' torques never cancel; check spin of the rotors"
            )
        yield Level.ERROR, problem


def _control(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    rows = thrust_map(aircraft, np.ones(aircraft.motor_count))
    rows[1:3] /= max(figures.reach, 1e-9)
    rank = int(np.linalg.matrix_rank(rows, tol=1e-3))
    if rank < 4:
        yield (
            Level.ERROR,
            f"the motors can set {rank} of thrust, roll, pitch and yaw independently, expected all 4; "
            f"it takes four rotors or more, at different places, with both spins",
        )
        return
    values = " / ".join(f"{value:.3g}" for value in figures.hover_acceleration)
    weakest = int(figures.hover_acceleration.argmin())
    message = f"roll / pitch / yaw up to {values} rad/s² in a hover"
    if figures.hover is not None and figures.hover_acceleration[weakest] < 1.0:
        low = f": next to nothing in {AXES[weakest]}; check inertia_kg_m2 and torque_ratio_m"
        yield Level.WARNING, message + low
    elif figures.hover is not None:
        yield Level.OK, message


def _size(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    loading = figures.mass / figures.wheelbase**2
    message = f"{figures.mass:.3g} kg on a wheelbase of {1000 * figures.wheelbase:.0f} mm"
    hint = "; masses are in kg, lengths in m"
    yield _graded(message, loading, LOADING_USUAL, LOADING_POSSIBLE, hint)
    for part in aircraft.parts:
        at = np.array(part.position) + rotation_matrix(part.rotation) @ np.array(part.centre)
        away = float(np.linalg.norm(at - figures.centre))
        if away > FAR * figures.reach:
            yield (
                Level.WARNING,
                f"part {part.name!r} lies {1000 * away:.0f} mm from the centre of mass, the farthest rotor "
                f"{1000 * figures.reach:.0f} mm; check its position_m and centre_of_mass_m",
            )


def _inertia(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    radii = np.sqrt(figures.principal_moments / figures.mass)
    ratios = radii / max(figures.reach, 1e-9)
    worst = int(np.abs(np.log(ratios)).argmax())
    values = " / ".join(f"{1000 * radius:.0f}" for radius in radii)
    message = f"radii of gyration {values} mm, the farthest rotor {1000 * figures.reach:.0f} mm"
    hint = "; check inertia_kg_m2 of the parts: kg m², about their own centre of mass"
    yield _graded(message, float(ratios[worst]), GYRATION_USUAL, GYRATION_POSSIBLE, hint)


def _centre(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    middle = np.mean([rotor.position for rotor in aircraft.rotors], axis=0)
    away = float(np.linalg.norm(np.array(aircraft.centre_of_thrust) - middle))
    message = f"centre_of_thrust_m lies {1000 * away:.0f} mm from the middle of the propellers"
    if away > CENTRE_OFF * figures.reach:
        where = ", ".join(f"{value:.4g}" for value in middle)
        hint = f", [{where}]; the rig would hold it in the wrong place"
        yield Level.WARNING, message + hint
    else:
        yield Level.OK, message


def _propeller(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    propulsion, diameter = aircraft.propulsion, aircraft.propulsion.propeller_diameter
    if diameter is None:
        return
    merit = _merit(propulsion, diameter)
    tip = propulsion.speed_max * diameter / 2
    message = (
        f"figure of merit {merit.max():.2f}, tips at {tip:.0f} m/s at full throttle "
        f"({propulsion.speed_max / RPM:,.0f} rpm)"
    )
    if merit.max() > 1:
        hint = "more thrust than its torque can pay for; check thrust coefficient, torque ratio and diameter"
        yield Level.ERROR, f"{message}: {hint}"
    elif not MERIT_USUAL[0] <= merit.min() <= merit.max() <= MERIT_USUAL[1]:
        usual = f"unusual, expected {MERIT_USUAL[0]:g} to {MERIT_USUAL[1]:g}"
        yield Level.WARNING, f"{message}: {usual}; check the coefficients and diameter"
    elif tip > TIP_SPEED_HIGH:
        yield Level.WARNING, f"{message}: near the speed of sound; check speed_curve_rpm"
    else:
        yield Level.OK, message
    for (i, a), (j, b) in combinations(enumerate(aircraft.rotors, start=1), 2):
        across = math.dist(a.position[:2], b.position[:2])
        if across < diameter:
            yield (
                Level.WARNING,
                f"those of motors {i} and {j} overlap: hubs {1000 * across:.0f} mm apart, diameter "
                f"{1000 * diameter:.0f} mm; the twin knows no loss by that",
            )


def _propeller_part(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    """Check that the propeller lies flat, thin along the thrust axis z, and is balanced about its hub."""
    part = next((part for part in aircraft.parts if part.name == "propeller 1"), None)
    if part is None:
        return
    if part.surface is None:
        moments = np.diag(np.array(part.inertia))
        if moments.argmax() != 2 and moments.max() > UPRIGHT_MOMENT * moments[2]:
            about = "xyz"[int(moments.argmax())]
            message = (
                f"propeller_part has its greatest moment about {about}, a propeller that lies flat about z"
            )
            yield Level.WARNING, f"{message}; check the order of inertia_kg_m2"
        return
    axis = _thin_axis(part.surface, np.array(part.centre))
    if axis is not None and axis[2] < math.cos(UPRIGHT):
        off = math.degrees(math.acos(axis[2]))
        message = f"propeller_part stands upright: its thin axis is {off:.0f} deg off z, where rotors thrust"
        hint = "check the order of box_m" if part.mesh is None else f"turn it by {_turned(part.mesh, axis)}"
        yield Level.WARNING, f"{message}; {hint}"
        return
    away = math.hypot(*part.centre[:2])
    reach = float(np.ptp(part.surface.reshape(-1, 3)[:, :2], axis=0).max()) / 2
    if part.mesh is not None and away > UNBALANCED * reach:
        x, y, z = np.round(np.array(part.mesh.offset) - [*part.centre[:2], 0.0], 5)
        message = f"propeller_part's centre of mass lies {1000 * away:.0f} mm off its hub's axis"
        yield (
            Level.WARNING,
            f"{message}; move it by mesh_offset_m = [{x + 0:g}, {y + 0:g}, {z + 0:g}]",
        )


def _thin_axis(surface: Array, centre: Array) -> Array | None:
    """Return the axis (3,), z >= 0, across which a propeller is thinnest; None where its blades do not tell.

    It follows from the second moments of area of the blades' outer halves: near the hub, which may be tall, a
    propeller with two blades is nearly as thin along their chord.
    """
    corners = surface - centre
    middles = corners.mean(axis=1)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    far = np.linalg.norm(middles, axis=1) > np.linalg.norm(corners, axis=2).max() / 2
    if areas[far].sum() < OUTER_MIN * areas.sum():  # a few large triangles
        far[:] = True
    corners, middles, areas = corners[far], middles[far], areas[far]
    # Of a triangle of area A: A / 12 (v1 v1' + v2 v2' + v3 v3' + 9 m m').
    second = np.einsum("t,tki,tkj->ij", areas, corners, corners) + 9 * np.einsum(
        "t,ti,tj->ij", areas, middles, middles
    )
    moments, axes = np.linalg.eigh(second)
    if moments[0] > THIN * moments[1]:
        return None
    axis: Array = np.where(np.abs(axes[:, 0]) < STRAIGHT, 0.0, axes[:, 0])
    last = axis[np.flatnonzero(axis)[-1]]  # z where it has any, else y, else x
    return np.asarray(axis / np.linalg.norm(axis) * math.copysign(1.0, last))


def _turned(pose: MeshPose, axis: Array) -> str:
    """Return the setting that turns a mesh, posed by `pose`, such that `axis` (3,) points along z."""
    roll = math.atan2(axis[1], axis[2])
    pitch = math.atan2(-axis[0], math.hypot(axis[1], axis[2]))
    before = np.deg2rad(pose.rotation_deg).tolist()
    angles = rotation_angles(
        rotation_matrix((roll, pitch, 0.0)) @ rotation_matrix((before[0], before[1], before[2]))
    )
    shown = ", ".join(f"{round(math.degrees(angle), 1) + 0:g}" for angle in angles)
    return f"mesh_rotation_deg = [{shown}]"


def _merit(propulsion: Propulsion, diameter: float) -> Array:
    """Compute the figure of merit from a tenth of full speed up: ideal over actual power, in still air.

    Source: momentum theory, P = T^1.5 / sqrt(2 rho A).
    """
    speed = np.linspace(0.1, 1.0, 50) * propulsion.speed_max
    thrust, torque = thrust_and_torque(speed, propulsion)
    area = math.pi * diameter**2 / 4
    return np.asarray(thrust**1.5 / math.sqrt(2 * AIR_DENSITY * area) / (torque * speed))


def _rotor(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    inertia = aircraft.propulsion.rotor_inertia
    together, whole = aircraft.motor_count * inertia, float(figures.inertia[2, 2])
    hint = "check rotor_inertia_kg_m2: propeller and motor bell, about their axis, kg m²"
    if together >= whole:
        message = f"rotors of {together:.3g} kg m² in an aircraft of {whole:.3g} kg m² about z; {hint}"
        yield Level.ERROR, message
        return
    propeller = next((part.inertia[2][2] for part in aircraft.parts if part.name == "propeller 1"), 0.0)
    if inertia < 0.5 * propeller:
        message = f"a rotor of {inertia:.3g} kg m² carries a propeller of {propeller:.3g} kg m²; {hint}"
        yield Level.WARNING, message


def _battery(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    battery, supply = aircraft.battery, aircraft.propulsion.supply_voltage
    if battery is None:
        yield Level.OK, "none given: it flies at a constant voltage"
        return
    if supply is None:
        hint = "give propulsion.supply_voltage_v, where speed_curve_rpm was measured"
        yield Level.WARNING, f"the twin cannot tell how speed follows its voltage; {hint}"
    else:
        message = f"{battery.rest_voltage:g} V full, speed curve at {supply:g} V"
        hint = "; check cells, rest_voltage_v and supply_voltage_v"
        ratio = battery.rest_voltage / supply
        yield _graded(message, ratio, SUPPLY_USUAL, SUPPLY_POSSIBLE, hint)
    endurance = figures.endurance
    if endurance is not None:
        voltage = endurance.full_throttle_voltage
        cell = voltage / battery.cells
        if cell < CELL_LOADED_LOW:
            sag = f"sags to {cell:.2f} V a cell at full throttle" if voltage else "cannot feed full throttle"
            hint = f"expected {CELL_LOADED_LOW:g} V or more; check resistance_ohm and efficiency"
            yield Level.WARNING, f"a full pack {sag}; {hint}"


def _body(aircraft: Aircraft, figures: AircraftFigures) -> Iterator[Finding]:
    if aircraft.body is None:
        yield Level.OK, "none given: no ground to stand on, no drag"
        return
    low = np.array(aircraft.body.centre) - np.array(aircraft.body.size) / 2
    high = low + np.array(aircraft.body.size)
    hub = min(rotor.position[2] for rotor in aircraft.rotors)
    if not ((low < figures.centre) & (figures.centre < high)).all():
        hint = "check size_m and centre_m"
        yield Level.WARNING, f"the centre of mass lies outside the box; {hint}"
    elif hub < low[2]:
        below = f"the propellers are {1000 * (low[2] - hub):.0f} mm below the box's bottom"
        yield Level.WARNING, f"{below}, in the ground when it stands; check centre_m"
    else:
        sides = " x ".join(f"{1000 * side:.0f}" for side in aircraft.body.size)
        yield Level.OK, f"{sides} mm, centre of mass inside"


def _graded(
    message: str, value: float, usual: tuple[float, float], possible: tuple[float, float], hint: str
) -> Finding:
    if usual[0] <= value <= usual[1]:
        return Level.OK, message
    if possible[0] <= value <= possible[1]:
        return Level.WARNING, f"{message}: unusual{hint}"
    return Level.ERROR, f"{message}: cannot be{hint}"


CHECKS = (
    *(("thrust", _thrust), ("hover", _hover), ("control", _control), ("motors", _motors), ("size", _size)),
    *(("inertia", _inertia), ("centre of thrust", _centre), ("propeller", _propeller)),
    *(("propeller", _propeller_part), ("rotor", _rotor), ("battery", _battery), ("body", _body)),
)
