"""The rigid-body world: N copies of an aircraft in one pybullet client.

pybullet turns and moves the bodies; this module applies wrenches and keeps the angular momentum. pybullet
steps the rate by explicit Euler and then turns the body by the new rate, which gains or loses 0.2 % of the
momentum of a tumbling racer each second. Here pybullet's rate is the one in the middle of a step: the torque
asked of it is the one whose Euler step ends there, so it turns the body by the step's mean rate. The momentum
is integrated from the moments, and the rate at a sample follows from momentum and attitude. Without a moment
the momentum is thus kept to rounding, and energy to second order of the step.

The copies do not touch each other; with `ground` each can touch the plane z = 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import chain

import numpy as np
import pybullet
from numpy.typing import NDArray

from sim.aircraft.model import Aircraft
from sim.physics.bodies import AIRCRAFT, GROUND, create_box, create_ground, load_rig, resting_height
from sim.physics.rotation import cross_matrix, quaternion, turned, turned_back
from toolchain.contract import GRAVITY
from toolchain.errors import AircraftError

Array = NDArray[np.float64]
COUNT_MAX = 4096
RATE_MAX = 1e5  # [rad/s], in place of pybullet's limit of 100
FRICTION = 0.6  # of the ground; grass and asphalt lie on either side
RESTITUTION = 0.1
_CENTRE = (0.0, 0.0, 0.0)


class Mount(Enum):
    """What holds the aircraft."""

    CENTRE = "centre"  # turns about its centre of mass; forces have no effect
    RIG = "rig"  # ball joint at the centre of thrust
    FREE = "free"  # nothing


@dataclass(frozen=True)
class _Turning:
    """Constant maps of a step from momenta and moments to rates, of one aircraft for all or of N."""

    inertia: Array  # (..., 3, 3) [kg m^2], about the pivot
    inverse: Array
    half_push: Array  # (..., 3, 3), rate gained in half a step by a moment
    half_gyro: Array  # (..., 9, 3), and by turning, from the products of two rates


class World:
    """A pybullet client with `count` aircraft; state arrays are refreshed by `reset` and `step`.

    rate: (N, 3) [rad/s] body axes; rotation: (N, 3, 3) body to world; body_velocity: (N, 3) [m/s] of the
    centre of mass, body axes; momentum: (N, 3) [N m s] world axes, angular, about the centre of mass or, on
    the rig, about the ball joint. Off the rig, an aircraft that `vary` changed is moved as
    the file's aircraft under the wrench divided by its factors, and the momentum is of the file's aircraft.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        count: int,
        dt: float,
        mount: Mount,
        gravity: bool,
        *,
        ground: bool = False,
    ) -> None:
        if not 1 <= count <= COUNT_MAX:
            raise ValueError(f"got {count} aircraft, expected 1 to {COUNT_MAX} in one world")
        if ground and mount is not Mount.FREE:
            raise ValueError(f"ground with mount {mount.value!r}: only a free aircraft can touch it")
        if ground and aircraft.body is None:
            raise AircraftError(f"aircraft {aircraft.name}: no [body] table, so nothing can touch the ground")
        self.mount = mount
        self._ground = ground
        properties = aircraft.mass_properties
        moments, axes = np.linalg.eigh(properties.inertia)
        if np.linalg.det(axes) < 0:
            axes[:, 0] = -axes[:, 0]
        self._axes = axes  # pybullet turns bodies in their principal axes, the columns
        self._mass = properties.mass
        self._weight = np.array([0.0, 0.0, -GRAVITY * properties.mass if gravity else 0.0])  # [N], world
        arm = np.zeros(3)  # [m], pivot to centre of mass, body axes
        if mount is Mount.RIG:
            arm = properties.centre - np.array(aircraft.centre_of_thrust)
        self._arm = arm
        self._swing = cross_matrix(arm)  # rows: rate @ swing = rate x arm, -force @ swing = arm x force
        self._dt = dt
        self._inertias = properties.inertia, self._mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        self._maps(self._inertias[0] + self._inertias[1])
        self._factors: tuple[Array, Array] | None = None  # of mass and inertia, (N,) each
        self._burden: Array | None = None  # (N, 6), the same beside a wrench; None on the rig
        self._moments = moments  # [kg m^2], principal

        self._client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(dt, self._client)
        if mount is Mount.FREE:
            pybullet.setGravity(0.0, 0.0, self._weight[2] / self._mass, self._client)
        if ground:
            create_ground(self._client)
            self._height = resting_height(aircraft)
        w, x, y, z = quaternion(axes)
        self._quaternion = (x, y, z, w)  # pybullet's order
        self._link = 0 if mount is Mount.RIG else -1
        self._bodies = [self._create(aircraft, moments, axes) for _ in range(count)]
        self._inner_rate = np.zeros((count, 3))  # [rad/s], pybullet's own, body axes
        self._position = np.zeros((count, 3))
        self._velocity = np.zeros((count, 3))
        self.momentum = np.zeros((count, 3))
        self.rate = np.zeros((count, 3))
        self.body_velocity = np.zeros((count, 3))
        self.rotation = np.zeros((count, 3, 3))
        self.reset(range(count))

    def close(self) -> None:
        """Disconnect from pybullet; the world cannot be used afterwards."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

    @property
    def velocity(self) -> Array:
        """Velocity of the centre of mass [m/s], world axes, (N, 3)."""
        return self._velocity if self.mount is Mount.FREE else turned(self.rotation, self.body_velocity)

    @property
    def position(self) -> Array:
        """Position of the centre of mass [m], world axes, (N, 3), from the mount or the start."""
        return self._position if self.mount is Mount.FREE else self.rotation @ self._arm

    def reset(self, index: Iterable[int], rate: Array | None = None) -> None:
        """Put the aircraft of `index` level, at the origin or on the ground, at rest.

        rate: turning at `rate` (len, 3) [rad/s], body axes, instead of at rest.
        """
        which = list(index)
        rates = np.zeros((len(which), 3)) if rate is None else rate
        origin = (0.0, 0.0, self._height if self._ground else 0.0)
        for i, turning in zip(which, rates.tolist(), strict=True):
            body = self._bodies[i]
            if self.mount is Mount.RIG:
                still, spin = [0.0, 0.0, 0.0, 1.0], (self._axes.T @ turning).tolist()
                pybullet.resetJointStateMultiDof(body, 0, still, spin, physicsClientId=self._client)
            else:
                pybullet.resetBasePositionAndOrientation(body, origin, self._quaternion, self._client)
                pybullet.resetBaseVelocity(body, (0.0, 0.0, 0.0), turning, self._client)
        self._inner_rate[which] = rates
        varied = self._turning.inertia.ndim == 3
        inertia = self._turning.inertia[which] if varied else self._turning.inertia
        self.momentum[which] = _times(rates, inertia)  # body axes are world axes here
        self._read_pose()
        self.rate[which] = rates
        self._velocity[which] = 0.0
        self.body_velocity[which] = rates @ self._swing

    def vary(self, index: NDArray[np.intp], mass: Array, inertia: Array) -> None:
        """Set mass and moments of inertia of the aircraft of `index`: factors of the file's, (len,) each.

        The moments are those about the centre of mass, which stays. Resting aircraft only: `reset` them.
        """
        if self._factors is None:
            self._factors = np.ones(len(self._bodies)), np.ones(len(self._bodies))
        masses, inertias = self._factors
        masses[index], inertias[index] = mass, inertia
        if self.mount is Mount.RIG:
            own, swung = self._inertias
            self._turning = self._turning_of(inertias[:, None, None] * own + masses[:, None, None] * swung)
            return
        self._burden = np.repeat(np.stack([masses, inertias], axis=1), 3, axis=1)
        if self._ground:  # contact needs the true masses
            for i in index.tolist():
                pybullet.changeDynamics(
                    self._bodies[i],
                    -1,
                    mass=self._mass * masses[i],
                    localInertiaDiagonal=(self._moments * inertias[i]).tolist(),
                    physicsClientId=self._client,
                )

    def step(self, wrench: Array) -> None:
        """Advance one time step under `wrench` (N, 6): body-axes force and moment at the centre of mass."""
        client, link, frame = self._client, self._link, self._frame
        before, inner, turning = self.rotation, self._inner_rate, self._turning
        if self._burden is not None:
            wrench = wrench / self._burden
        moment = self._moment(wrench)
        squares = _squares(np.concatenate([self.rate, inner]))
        count = len(inner)
        middle = self.rate + _times(moment, turning.half_push) - _times(squares[:count], turning.half_gyro)
        asked = (middle - inner) @ self._rate_to_torque + squares[count:] @ self._gyro_torque
        push = wrench[:, :3]
        if self._ground and self._burden is not None:
            asked, push = asked * self._burden[:, 3:], push * self._burden[:, :3]
        if self.mount is Mount.RIG:
            asked = turned(before, asked)
        apply_torque = pybullet.applyExternalTorque
        for body, torque in zip(self._bodies, asked.tolist(), strict=True):
            apply_torque(body, link, torque, frame, client)
        if self.mount is Mount.FREE:
            apply_force = pybullet.applyExternalForce
            forces = (push @ self._axes).tolist()
            for body, force in zip(self._bodies, forces, strict=True):
                apply_force(body, link, force, _CENTRE, frame, client)
        pybullet.stepSimulation(client)
        self._inner_rate = middle
        self._read_pose()
        # The moment keeps its body axes while they turn: it acts along their mean over the step.
        self.momentum += turned(before + self.rotation, moment * self._half_step)
        if self.mount is Mount.FREE:
            self._read_motion()
        self.rate = _times(turned_back(self.rotation, self.momentum), turning.inverse)
        if self.mount is Mount.RIG:
            self.body_velocity = self.rate @ self._swing

    def _turning_of(self, inertia: Array) -> _Turning:
        """Maps of `inertia` (..., 3, 3) about the pivot."""
        inverse: Array = np.linalg.inv(inertia).astype(np.float64)
        half_push = np.asarray(0.5 * self._dt * inverse)
        return _Turning(inertia, inverse, half_push, _gyroscopic(inertia) @ half_push)

    def _maps(self, inertia: Array) -> None:
        """Constant matrices of a step; `inertia` is about the pivot, pybullet's own."""
        self._turning = self._turning_of(inertia)
        self._half_step = 0.5 * self._dt
        # pybullet takes a loose body's torque along its principal axes. A link it would turn by the attitude
        # of the step before, so the rig's torque is turned here.
        rig = self.mount is Mount.RIG
        self._frame = pybullet.WORLD_FRAME if rig else pybullet.LINK_FRAME
        along = np.eye(3) if rig else self._axes
        self._rate_to_torque = inertia @ along / self._dt
        self._gyro_torque = _gyroscopic(inertia) @ along
        # Body to world, nine numbers, from the squares of pybullet's quaternion.
        matrix = _matrix_of_squares() @ self._axes.T
        if rig:  # the joint's zero lies along the principal axes
            matrix = self._axes @ matrix
        self._attitude = matrix.reshape(16, 9)

    def _moment(self, wrench: Array) -> Array:
        """Moment about the pivot, body axes, (N, 3); gravity pulls at the rig's hanging centre of mass."""
        moment: Array = wrench[:, 3:]
        if self.mount is Mount.RIG:
            force = wrench[:, :3]
            if self._weight[2]:
                weight = self._weight @ self.rotation
                force = force + (weight if self._factors is None else weight * self._factors[0][:, None])
            moment = moment - force @ self._swing
        return moment

    def _read_pose(self) -> None:
        client, bodies = self._client, self._bodies
        if self.mount is Mount.RIG:
            joint = pybullet.getJointStateMultiDof
            turns: Sequence[tuple[float, ...]] = [joint(b, 0, client)[0] for b in bodies]
        else:
            pose = pybullet.getBasePositionAndOrientation
            if self.mount is Mount.CENTRE:
                turns = [pose(b, client)[1] for b in bodies]
            else:
                places, turns = zip(*[pose(b, client) for b in bodies], strict=True)
                self._position = _rows(places, 3)
        self.rotation = (_squares(_rows(turns, 4)) @ self._attitude).reshape(-1, 3, 3)

    def _read_motion(self) -> None:
        """Read pybullet's velocities; the change of rate by ground contact goes into the momentum."""
        motions = [pybullet.getBaseVelocity(b, self._client) for b in self._bodies]
        self._velocity = _rows([motion[0] for motion in motions], 3)
        self.body_velocity = turned_back(self.rotation, self._velocity)
        if self._ground:
            inner = turned_back(self.rotation, _rows([motion[1] for motion in motions], 3))
            impulse = (inner - self._inner_rate) @ self._turning.inertia
            self.momentum += turned(self.rotation, impulse)
            self._inner_rate = inner

    def _create(self, aircraft: Aircraft, moments: Array, axes: Array) -> int:
        client = self._client
        if self.mount is Mount.RIG:
            body = load_rig(self._mass, self._arm, moments, axes, client)
        else:
            shape = create_box(aircraft, self._axes, client) if self._ground else -1
            body = int(
                pybullet.createMultiBody(
                    baseMass=self._mass,
                    baseCollisionShapeIndex=shape,
                    baseOrientation=self._quaternion,
                    physicsClientId=client,
                )
            )
            pybullet.changeDynamics(body, -1, localInertiaDiagonal=moments.tolist(), physicsClientId=client)
        pybullet.changeDynamics(
            body,
            self._link,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
            maxJointVelocity=RATE_MAX,
            lateralFriction=FRICTION,
            restitution=RESTITUTION,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        # Copies share the origin; without this the broad phase pairs all of them, quadratically.
        group, mask = (AIRCRAFT, GROUND) if self._ground else (0, 0)
        pybullet.setCollisionFilterGroupMask(body, self._link, group, mask, client)
        return body


def _squares(rows: Array) -> Array:
    """All products of two components of each row: (N, k) to (N, k^2)."""
    return (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), -1)


def _times(rows: Array, matrix: Array) -> Array:
    """Rows (N, k) times a matrix (k, 3), or each times its own of (N, k, 3)."""
    times: Array = rows @ matrix if matrix.ndim == 2 else np.matmul(rows[:, None], matrix)[:, 0]
    return times


def _gyroscopic(inertia: Array) -> Array:
    """Map (..., 9, 3) with w x I w = squares(w) @ map, of an inertia (..., 3, 3)."""
    units = np.eye(3)
    pairs: Array = np.einsum("ikc,...kj->...ijc", np.cross(units[:, None], units), inertia)
    return pairs.reshape(*inertia.shape[:-2], 9, 3)


def _matrix_of_squares() -> Array:
    """(16, 3, 3): the rotation matrix of a unit quaternion x, y, z, w is linear in its `_squares`."""
    x, y, z, w = np.eye(4)

    def product(a: Array, b: Array) -> Array:
        return np.outer(a, b).ravel()

    xx, yy, zz, ww = (product(a, a) for a in (x, y, z, w))
    xy, xz, yz = 2 * product(x, y), 2 * product(x, z), 2 * product(y, z)
    wx, wy, wz = 2 * product(w, x), 2 * product(w, y), 2 * product(w, z)
    rows = [
        [ww + xx - yy - zz, xy - wz, xz + wy],
        [xy + wz, ww - xx + yy - zz, yz - wx],
        [xz - wy, yz + wx, ww - xx - yy + zz],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _rows(tuples: Sequence[tuple[float, ...]], width: int) -> Array:
    """Array (N, width) of pybullet's tuples; quicker than np.array."""
    return np.fromiter(chain.from_iterable(tuples), np.float64, width * len(tuples)).reshape(-1, width)
