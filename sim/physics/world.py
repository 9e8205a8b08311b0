"""The rigid-body world: N copies of an aircraft in one pybullet client.

pybullet turns and moves the bodies; world.c applies wrenches and keeps the angular momentum, and says how.
Without a moment momentum is kept to rounding, and energy to second order of the step; bare pybullet gains or
loses 0.2 % of a tumbling racer's momentum each second. This module makes client and bodies with the package
pybullet and hands them to C, which steps them through that library's own C functions (bullet.h).

The copies do not touch each other; with `ground` each can touch the plane z = 0.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Indices
from neuroflight.sim.physics.bodies import (
    AIRCRAFT,
    GROUND,
    create_box,
    create_ground,
    load_rig,
    resting_height,
)
from neuroflight.sim.physics.bullet import pybullet
from neuroflight.sim.physics.library import assign, library, pointer, struct
from neuroflight.sim.physics.rotation import cross_matrix, quaternion
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import AircraftError, BuildError

COUNT_MAX = 4096
RATE_MAX = 1e5  # [rad/s], in place of pybullet's limit of 100
FRICTION = 0.6  # of the ground; grass and asphalt lie on either side
RESTITUTION = 0.1


class Mount(Enum):
    """Mounts of the aircraft."""

    CENTRE = "centre"  # turns about its centre of mass; forces have no effect
    RIG = "rig"  # ball joint at the centre of thrust
    FREE = "free"  # nothing


@dataclass(frozen=True)
class Held:
    """A soft hold of an aircraft on the rig: a rope, a hand, foam. Alike about all axes."""

    swing_hz: float  # that it swings at about each axis, undamped, with the file's inertia
    damping: float  # ratio; 1: it swings no more


@dataclass(frozen=True)
class _Turning:
    """Constant maps of a step from momenta and moments to rates, of one aircraft for all or of N."""

    inertia: Array  # (..., 3, 3) [kg m^2], about the pivot
    inverse: Array
    half_push: Array  # (..., 3, 3), rate gained in half a step by a moment
    half_gyro: Array  # (..., 9, 3), and by turning, from the products of two rates


class World:
    """A pybullet client with `count` aircraft; `reset` and `step` write the new state into the arrays.

    rate: (N, 3) [rad/s] body axes; rotation: (N, 3, 3) body to world; velocity: (N, 3) [m/s] of the centre of
    mass, world axes; body_velocity: the same in body axes; position: (N, 3) [m] of the centre of mass, world
    axes, from the mount or the start; momentum: (N, 3) [N m s] world axes, angular, about
    the centre of mass or, on the rig, about the ball joint. Off the rig, an aircraft that `vary` changed is
    moved as the file's aircraft under the wrench divided by its factors, and the momentum is of the file's
    aircraft.
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
        held: Held | None = None,
    ) -> None:
        if held is not None and mount is not Mount.RIG:
            raise ValueError(f"held, with mount {mount.value!r}: only on the rig")
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
        weight = -GRAVITY * properties.mass if gravity else 0.0  # [N], along world z
        arm = np.zeros(3)  # [m], pivot to centre of mass, body axes
        if mount is Mount.RIG:
            arm = properties.centre - np.array(aircraft.centre_of_thrust)
        self._arm = arm
        self._swing = cross_matrix(arm)  # rows: rate @ swing = rate x arm, -force @ swing = arm x force
        self._dt = dt
        self._inertias = properties.inertia, self._mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        self._masses, self._inertia_factors = np.ones(count), np.ones(count)
        self._burden = np.ones((count, 6))  # that a wrench is divided by; on the rig nothing
        self._moments = moments  # [kg m^2], principal

        self._client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(dt, self._client)
        if mount is Mount.FREE:
            pybullet.setGravity(0.0, 0.0, weight / self._mass, self._client)
        if ground:
            create_ground(self._client)
            self._height = resting_height(aircraft)
        w, x, y, z = quaternion(axes)
        self._quaternion = (x, y, z, w)  # pybullet's order
        self._link = 0 if mount is Mount.RIG else -1
        self._bodies = np.array([self._create(aircraft, moments, axes) for _ in range(count)], np.int32)
        self.momentum = np.zeros((count, 3))
        self.rate = np.zeros((count, 3))
        self.velocity = np.zeros((count, 3))
        self.body_velocity = np.zeros((count, 3))
        self.rotation = np.zeros((count, 3, 3))
        self._inner_rate = np.zeros((count, 3))  # [rad/s], pybullet's own, body axes
        self.position = np.zeros((count, 3))
        self._step_arrays = np.zeros((3, count, 3))  # torque, push and moment of the step at hand
        torque, push, moment = self._step_arrays
        self.state = struct(
            "world",
            count=count,
            mount=getattr(library().lib, f"MOUNT_{mount.name}"),
            ground=ground,
            gravity=gravity,
            client=self._handle(),
            link=self._link,
            bodies=self._bodies,
            half_step=0.5 * dt,
            weight=weight,
            axes=axes.ravel().tolist(),
            swing=self._swing.ravel().tolist(),
            arm=arm.tolist(),
            burden=self._burden,
            mass_factor=self._masses,
            inner_rate=self._inner_rate,
            momentum=self.momentum,
            rate=self.rate,
            rotation=self.rotation,
            velocity=self.velocity,
            position=self.position,
            body_velocity=self.body_velocity,
            torque=torque,
            push=push,
            moment=moment,
        )
        if held is not None:
            stiffness = np.diag(self._inertias[0] + self._inertias[1]) * (2 * np.pi * held.swing_hz) ** 2
            damping = stiffness * held.damping / (np.pi * held.swing_hz)
            assign(self.state, held=True, stiffness=stiffness.tolist(), damping=damping.tolist())
        self._maps(self._inertias[0] + self._inertias[1])
        self.reset(range(count))

    def close(self) -> None:
        """Disconnect from pybullet; the world cannot be used afterwards."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1
            self.state.client = library().ffi.NULL  # so that C refuses instead of using freed memory

    def reset(self, index: Iterable[int], rate: Array | None = None) -> None:
        """Put the aircraft of `index` level, at the origin or on the ground, at rest.

        rate: turning at `rate` (len, 3) [rad/s], body axes, instead of at rest.
        """
        which = np.fromiter(index, np.int64)
        rates = np.zeros((len(which), 3)) if rate is None else rate
        origin = (0.0, 0.0, self._height if self._ground else 0.0)
        for i, turning in zip(which, rates.tolist(), strict=True):
            body = int(self._bodies[i])
            if self.mount is Mount.RIG:
                still, spin = [0.0, 0.0, 0.0, 1.0], (self._axes.T @ turning).tolist()
                pybullet.resetJointStateMultiDof(body, 0, still, spin, physicsClientId=self._client)
            else:
                pybullet.resetBasePositionAndOrientation(body, origin, self._quaternion, self._client)
                pybullet.resetBaseVelocity(body, (0.0, 0.0, 0.0), turning, self._client)
        self._inner_rate[which] = rates
        inertia = self._turning.inertia
        each = inertia[which] if inertia.ndim == 3 else np.broadcast_to(inertia, (len(which), 3, 3))
        # Body axes are world axes here.
        self.momentum[which] = np.einsum("ni,nij->nj", rates, each)
        if not library().lib.world_read_pose(self.state, len(which), pointer(which)):
            raise _failed()
        self.rate[which] = rates
        self.body_velocity[which] = self.velocity[which] = rates @ self._swing

    def vary(self, index: Indices, mass: Array, inertia: Array) -> None:
        """Set mass and moments of inertia of the aircraft of `index`: factors of the file's, (len,) each.

        The moments are those about the centre of mass, which stays. Resting aircraft only: `reset` them.
        """
        masses, inertias = self._masses, self._inertia_factors
        masses[index], inertias[index] = mass, inertia
        if self.mount is Mount.RIG:
            own, swung = self._inertias
            self._turn_by(inertias[:, None, None] * own + masses[:, None, None] * swung)
            return
        self._burden[:] = np.repeat(np.stack([masses, inertias], axis=1), 3, axis=1)
        if self._ground:  # contact needs the true masses
            for i in index.tolist():
                pybullet.changeDynamics(
                    int(self._bodies[i]),
                    -1,
                    mass=self._mass * masses[i],
                    localInertiaDiagonal=(self._moments * inertias[i]).tolist(),
                    physicsClientId=self._client,
                )

    def load(self, inertia: Array) -> None:
        """Give all aircraft the moments `inertia` (3, 3) [kg m^2] about the centre of mass, as they turn now.

        Held at the centre only, and not beside `vary`. pybullet's own bodies keep the file's moments: it is
        told the rates, and turns them.
        """
        assert self.mount is Mount.CENTRE
        self._turn_by(np.repeat(inertia[None], len(self.rate), axis=0))
        self.momentum[:] = np.einsum("nij,nj->ni", self.rotation, self.rate @ inertia)

    def step(self, wrench: Array) -> None:
        """Advance one time step under `wrench` (N, 6): body-axes force and moment at the centre of mass.

        Raises RuntimeError if pybullet refuses.
        """
        given = np.ascontiguousarray(wrench, np.float64)
        if not library().lib.world_step(self.state, pointer(given)):
            raise _failed()

    def _handle(self) -> object:
        """Return the client as C has it. Raises BuildError if pybullet does not export what C needs."""
        lacking = library().lib.bullet_open(os.fsencode(pybullet.__file__))
        if lacking:
            name = library().ffi.string(lacking).decode()
            raise BuildError(f"{pybullet.__file__}: lacks {name}, which the twin calls; install pybullet 3.2")
        path = str(library().path)
        number = pybullet.loadPlugin(path, physicsClientId=self._client)
        handle = library().lib.bullet_client()
        if number < 0 or not handle:
            raise BuildError(f"pybullet does not load {path} as a plugin; install pybullet 3.2")
        return handle

    def _maps(self, inertia: Array) -> None:
        """Compute the constant matrices of a step; `inertia` is about the pivot, pybullet's own."""
        # pybullet takes a loose body's torque along its principal axes. A link it would turn by the attitude
        # of the step before, so the rig's torque is turned here.
        rig = self.mount is Mount.RIG
        along = np.eye(3) if rig else self._axes
        # Body to world, nine numbers, from the squares of pybullet's quaternion.
        matrix = _matrix_of_squares() @ self._axes.T
        if rig:  # the joint's zero lies along the principal axes
            matrix = self._axes @ matrix
        assign(
            self.state,
            frame=pybullet.WORLD_FRAME if rig else pybullet.LINK_FRAME,
            rate_to_torque=(inertia @ along / self._dt).ravel().tolist(),
            gyro_torque=(_gyroscopic(inertia) @ along).ravel().tolist(),
            attitude=matrix.ravel().tolist(),
        )
        self._turn_by(inertia)

    def _turn_by(self, inertia: Array) -> None:
        """Compute the maps of a step of `inertia` (3, 3), or (N, 3, 3), about the pivot."""
        inverse = np.linalg.inv(inertia).astype(np.float64)
        half_push = np.asarray(0.5 * self._dt * inverse)
        maps = inertia, inverse, half_push, _gyroscopic(inertia) @ half_push
        self._turning = turning = _Turning(*(np.ascontiguousarray(each) for each in maps))
        assign(self.state, each=inertia.ndim == 3, **vars(turning))

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


def _failed() -> RuntimeError:
    return RuntimeError("pybullet refuses a command of the world; is it closed?")


def _gyroscopic(inertia: Array) -> Array:
    """Compute the map (..., 9, 3) with w x I w = squares(w) @ map, of an inertia (..., 3, 3)."""
    units = np.eye(3)
    pairs: Array = np.einsum("ikc,...kj->...ijc", np.cross(units[:, None], units), inertia)
    return pairs.reshape(*inertia.shape[:-2], 9, 3)


def _matrix_of_squares() -> Array:
    """Return (16, 3, 3): the rotation matrix, linear in the products of two of x, y, z, w."""
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
