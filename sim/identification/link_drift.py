"""Drift of an aircraft's links in reduced and in maximal coordinates, after Koch 2019, chapter 5.

The twin is one rigid body, so its parts cannot drift. Here airframe and propellers are links of their own on
hinges about body z. Every combination of motors on and off flies from rest, free and without gravity, and the
distance of each propeller from the airframe is compared with that at the start.

Reduced coordinates are pybullet's multibody (Featherstone), whose links cannot leave their joints. For
maximal ones pybullet would load the same URDF as separate bodies, but then reports only the first: so they
are made one by one, with two ball joints on each propeller's axis, which the impulse solver holds
approximately.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from neuroflight.sim.aircraft.mass import MassProperties, mass_properties, principal
from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Indices
from neuroflight.sim.physics.bullet import pybullet
from neuroflight.sim.physics.rotation import quaternion, roll_pitch_yaw
from neuroflight.sim.physics.rotor import speeds_along, target_speed, thrust_and_torque
from neuroflight.toolchain.contract import GYRO_FULL_SCALE_DEG_S
from neuroflight.toolchain.errors import AircraftError

FORMULATIONS = ("reduced", "maximal")
STEPS_MS = (2.0, 1.0, 0.5)  # Koch 2019, chapter 5, of maximal coordinates; reduced ones at 1 ms alone
DURATION_S = 0.5  # of each flight; a racer with two of four motors on is past RATE_MAX in 0.2 s
RATE_MAX = math.radians(GYRO_FULL_SCALE_DEG_S)  # [rad/s], where a flight ends: full scale of the gyro
ONSET_M = 0.001  # sum of the changes from which links count as apart; the dissertation names no threshold
HINGE_HALF = 0.005  # [m], from the middle of a hinge to each of its two ball joints
FORCE_MAX = 1e4  # [N], what a ball joint may hold with: never the limit
SPEED_MAX = 1e5  # [rad/s], in place of pybullet's limit of 100

Link = tuple[int, int]  # pybullet's body and link, -1 for its base


@dataclass(frozen=True, eq=False)
class Drift:
    """Samples of all flights of one formulation at one step, in the order they were flown."""

    formulation: str
    step_s: float
    flight: Indices  # (K,), its motors as a binary number, motor 1 first
    rates: Array  # (K, 3) [rad/s], of the airframe about its own roll, pitch and yaw axes
    drift: Array  # (K,) [m], change of distance of the propeller that moved most from the airframe
    separation: Array  # (K,) [m], change of distance of every link from every other, summed

    @property
    def rate(self) -> Array:
        """Magnitude of the airframe's rate (K,) [rad/s]."""
        return np.asarray(np.linalg.norm(self.rates, axis=1))

    @property
    def worst(self) -> float:
        """Largest change of distance [m]."""
        return float(self.drift.max())


@dataclass(frozen=True, eq=False)
class Onset:
    """The slowest sample of a run whose links are apart by more than a threshold."""

    rates: Array  # (3,) [rad/s], roll, pitch, yaw
    separation: float  # [m]

    @property
    def rate(self) -> float:
        """Magnitude [rad/s]."""
        return float(np.linalg.norm(self.rates))


def drift(
    aircraft: Aircraft,
    formulation: str,
    step_s: float,
    progress: Callable[[], None] = lambda: None,
) -> Drift:
    """Fly every combination of motors on and off; `progress` is called after each.

    Raises AircraftError if a rotor has no propeller part.
    """
    airframe, propellers = _links(aircraft)
    flights = []
    for command in product((0.0, 1.0), repeat=aircraft.motor_count):
        client = pybullet.connect(pybullet.DIRECT)
        try:
            pybullet.setTimeStep(step_s, client)
            build = _reduced if formulation == "reduced" else _maximal
            base, rotors = build(airframe, propellers, client)
            flown = _fly(aircraft, airframe, propellers, base, rotors, np.array([command]), step_s, client)
        finally:
            pybullet.disconnect(client)
        flights.append(flown)
        progress()
    flight = np.repeat(np.arange(len(flights)), [len(rates) for rates, _ in flights])
    rates, places = (np.concatenate(part) for part in zip(*flights, strict=True))
    # Every flight begins where the links were put, so the first sample is the reference of all.
    changes = np.abs(_distances(places) - _distances(places[:1]))
    return Drift(formulation, step_s, flight, rates, changes[:, 0].max(axis=1), changes.sum(axis=(1, 2)))


def onset(measured: Drift, threshold: float) -> Onset | None:
    """Find the lowest rate at which the links are apart by more than `threshold` [m] in sum, or None."""
    apart = np.flatnonzero(measured.separation > threshold)
    if not len(apart):
        return None
    slowest = apart[np.argmin(measured.rate[apart])]
    return Onset(measured.rates[slowest], float(measured.separation[slowest]))


def worst_by_rate(measured: Drift, width: float) -> tuple[Array, Array]:
    """Return the largest drift [m] in each interval of `width` [rad/s], and these intervals' middles."""
    interval = np.floor(measured.rate / width).astype(int)
    worst = np.full(interval.max() + 1, -1.0)
    np.maximum.at(worst, interval, measured.drift)
    flown = np.flatnonzero(worst >= 0)
    return np.asarray((flown + 0.5) * width, np.float64), np.asarray(worst[flown])


def _distances(places: Array) -> Array:
    """Compute the distance of every link from every other (K, N, N) [m] from their places (K, N, 3) [m]."""
    return np.asarray(np.linalg.norm(places[:, :, None] - places[:, None], axis=3))


def _links(aircraft: Aircraft) -> tuple[MassProperties, list[MassProperties]]:
    """Return the airframe and each propeller, in motor order."""
    parts = {part.name: part for part in aircraft.parts}
    propellers = []
    for number in range(1, aircraft.motor_count + 1):
        if f"propeller {number}" not in parts:
            raise AircraftError(f"aircraft {aircraft.name}: rotor {number} has no propeller part")
        propellers.append(mass_properties([parts.pop(f"propeller {number}")]))
    return mass_properties(list(parts.values())), propellers


def _fly(
    aircraft: Aircraft,
    airframe: MassProperties,
    propellers: Sequence[MassProperties],
    base: Link,
    rotors: Sequence[Link],
    command: Array,
    step_s: float,
    client: int,
) -> tuple[Array, Array]:
    """Fly; return rates (K, 3) [rad/s] of the airframe about its axes and places (K, N, 3) [m] of the links.

    The airframe is the first link. One sample at rest, where the links belong, then one after each step,
    until DURATION_S or RATE_MAX.
    """
    _, axes = principal(airframe.inertia)
    spin_inertia = np.array([p.inertia[2, 2] for p in propellers])
    steps = round(DURATION_S / step_s)
    targets = np.repeat(target_speed(command, aircraft.propulsion), steps, axis=0)
    speeds = speeds_along(np.zeros(targets.shape[1]), targets, step_s, aircraft.propulsion)
    thrusts, torques = thrust_and_torque(speeds[1:], aircraft.propulsion)
    # What accelerates each propeller, and beside its drag the airframe's reaction to both.
    shafts = aircraft.spins * spin_inertia * np.diff(speeds, axis=0) / step_s
    motors = shafts + aircraft.spins * torques
    world = pybullet.WORLD_FRAME
    rates = [np.zeros(3)]
    places = [np.array([np.zeros(3), *(propeller.centre - airframe.centre for propeller in propellers)])]
    _, turned = _pose(base, client)
    poses = [_pose(rotor, client) for rotor in rotors]
    for thrust, shaft, motor in zip(thrusts, shafts, motors, strict=True):
        pybullet.applyExternalTorque(*base, (turned @ axes.T)[:, 2] * -motor.sum(), world, client)
        for (body, link), (at, attitude), force, turn in zip(rotors, poses, thrust, shaft, strict=True):
            up = attitude[:, 2]
            pybullet.applyExternalForce(body, link, up * force, at, world, client)
            pybullet.applyExternalTorque(body, link, up * turn, world, client)
        pybullet.stepSimulation(client)
        rate = np.array(pybullet.getBaseVelocity(base[0], client)[1])
        if np.linalg.norm(rate) > RATE_MAX:
            break
        centre, turned = _pose(base, client)
        poses = [_pose(rotor, client) for rotor in rotors]
        rates.append(rate @ (turned @ axes.T))
        places.append(np.array([centre, *(at for at, _ in poses)]))
    return np.array(rates), np.array(places)


def _pose(part: Link, client: int) -> tuple[Array, Array]:
    """Return centre of mass [m] and attitude (3, 3) of a link."""
    body, link = part
    if link < 0:
        at, turned = pybullet.getBasePositionAndOrientation(body, client)
    else:
        at, turned = pybullet.getLinkState(body, link, False, True, client)[:2]
    return np.array(at), np.array(pybullet.getMatrixFromQuaternion(turned)).reshape(3, 3)


def _reduced(
    airframe: MassProperties, propellers: Sequence[MassProperties], client: int
) -> tuple[Link, list[Link]]:
    """Create one multibody whose links hang on its base by hinges."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "aircraft.urdf"
        path.write_text(_urdf(airframe, propellers))
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        body = pybullet.loadURDF(str(path), flags=flags, physicsClientId=client)
    for link in range(-1, len(propellers)):
        _free(body, link, client)
    for link in range(len(propellers)):  # a joint comes with a motor that brakes it
        pybullet.setJointMotorControl2(
            body, link, pybullet.VELOCITY_CONTROL, force=0.0, physicsClientId=client
        )
    return (body, -1), [(body, link) for link in range(len(propellers))]


def _maximal(
    airframe: MassProperties, propellers: Sequence[MassProperties], client: int
) -> tuple[Link, list[Link]]:
    """Create separate bodies, held together by ball joints."""
    moments, axes = principal(airframe.inertia)
    base = _body(airframe.mass, np.zeros(3), moments, axes, client)
    rotors = []
    for propeller in propellers:
        at = propeller.centre - airframe.centre
        body = _body(propeller.mass, at, np.diag(propeller.inertia), np.eye(3), client)
        for height in (-HINGE_HALF, HINGE_HALF):
            up = np.array([0.0, 0.0, height])
            joint = pybullet.createConstraint(
                base,
                -1,
                body,
                -1,
                pybullet.JOINT_POINT2POINT,
                [0.0, 0.0, 0.0],
                ((at + up) @ axes).tolist(),
                up.tolist(),
                physicsClientId=client,
            )
            pybullet.changeConstraint(joint, maxForce=FORCE_MAX, physicsClientId=client)
        rotors.append((body, -1))
    return (base, -1), rotors


def _body(mass: float, at: Array, moments: Array, axes: Array, client: int) -> int:
    w, x, y, z = quaternion(axes)
    body = int(
        pybullet.createMultiBody(
            baseMass=mass,
            basePosition=at.tolist(),
            baseOrientation=(x, y, z, w),
            physicsClientId=client,
        )
    )
    pybullet.changeDynamics(body, -1, localInertiaDiagonal=moments.tolist(), physicsClientId=client)
    _free(body, -1, client)
    return body


def _free(body: int, link: int, client: int) -> None:
    """Switch off damping, sleep, the speed limit and contacts."""
    pybullet.changeDynamics(
        body,
        link,
        linearDamping=0.0,
        angularDamping=0.0,
        jointDamping=0.0,
        maxJointVelocity=SPEED_MAX,
        activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
        physicsClientId=client,
    )
    pybullet.setCollisionFilterGroupMask(body, link, 0, 0, client)


def _urdf(airframe: MassProperties, propellers: Sequence[MassProperties]) -> str:
    moments, axes = principal(airframe.inertia)
    turn = roll_pitch_yaw(axes)
    lines = ['<robot name="aircraft">', _urdf_link("airframe", airframe.mass, moments, turn)]
    for number, propeller in enumerate(propellers, start=1):
        name, at = f"propeller_{number}", _numbers(propeller.centre - airframe.centre)
        lines += [
            _urdf_link(name, propeller.mass, np.diag(propeller.inertia), (0.0, 0.0, 0.0)),
            f'<joint name="hinge_{number}" type="continuous"><origin xyz="{at}"/><parent link="airframe"/>'
            f'<child link="{name}"/><axis xyz="0 0 1"/></joint>',
        ]
    return "\n".join([*lines, "</robot>\n"])


def _urdf_link(name: str, mass: float, moments: Array, turn: Sequence[float]) -> str:
    terms = " ".join(
        f'i{axis}="{moment:.17g}"' for axis, moment in zip(("xx", "yy", "zz"), moments, strict=True)
    )
    return (
        f'<link name="{name}"><inertial><origin rpy="{_numbers(turn)}"/><mass value="{mass:.17g}"/>'
        f'<inertia {terms} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _numbers(values: Sequence[float] | Array) -> str:
    return " ".join(f"{value:.17g}" for value in values)
