"""The rigid-body world: N copies of an aircraft in one pybullet client.

pybullet turns and moves the bodies; this module applies wrenches and keeps the angular momentum. pybullet
steps the rate by explicit Euler and then turns the body by the new rate, which gains or loses 0.2 % of the
momentum of a tumbling racer each second. Here pybullet's rate is the one in the middle of a step: the torque
asked of it is the one whose Euler step ends there, so it turns the body by the step's mean rate. The momentum
is integrated from the moments, and the rate at a sample follows from momentum and attitude. Without a moment
the momentum is thus kept to rounding, and energy to second order of the step.

The copies do not feel each other; with `ground` each meets the plane z = 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from enum import Enum
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pybullet
from numpy.typing import NDArray

from sim.aircraft import Aircraft
from sim.rotation import quaternion
from toolchain.errors import AircraftError

Array = NDArray[np.float64]
GRAVITY = 9.80665  # [m/s^2], standard gravity
COUNT_MAX = 4096
RATE_MAX = 1e5  # [rad/s], in place of pybullet's limit of 100
FRICTION = 0.6  # of the ground; grass and asphalt lie on either side
RESTITUTION = 0.1
_GROUND, _AIRCRAFT = 1, 2  # collision groups


class Mount(Enum):
    """What holds the aircraft."""

    CENTRE = "centre"  # turns about its centre of mass; forces have no effect
    RIG = "rig"  # ball joint at the centre of thrust
    FREE = "free"  # nothing


class World:
    """A pybullet client with `count` aircraft; state arrays are refreshed by `reset` and `step`.

    rate: (N, 3) [rad/s] body axes; velocity, position: (N, 3) [m/s], [m] world axes, of the centre of
    mass; rotation: (N, 3, 3) body to world; momentum: (N, 3) [N m s] world axes, angular, about the centre
    of mass or, on the rig, about the ball joint.
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
        self._dt = dt
        self._ground = ground
        properties = aircraft.mass_properties
        self._mass = properties.mass
        self._weight = np.array([0.0, 0.0, -GRAVITY * properties.mass if gravity else 0.0])  # [N], world
        self._arm = np.zeros(3)  # [m], pivot to centre of mass, body axes
        self._inertia = properties.inertia  # about the pivot
        if mount is Mount.RIG:
            self._arm = properties.centre - np.array(aircraft.centre_of_thrust)
            squared = self._arm @ self._arm * np.eye(3) - np.outer(self._arm, self._arm)
            self._inertia = self._inertia + properties.mass * squared
        self._inverse = np.linalg.inv(self._inertia)

        self._client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(dt, self._client)
        if mount is Mount.FREE:
            pybullet.setGravity(0.0, 0.0, self._weight[2] / self._mass, self._client)
        if ground:
            self._create_ground()
        moments, axes = np.linalg.eigh(properties.inertia)
        if np.linalg.det(axes) < 0:
            axes[:, 0] = -axes[:, 0]
        self._axes = axes  # pybullet turns bodies in their principal axes, the columns
        w, x, y, z = quaternion(self._axes)
        self._quaternion = (x, y, z, w)  # pybullet's order
        self._link = 0 if mount is Mount.RIG else -1
        self._bodies = [self._create(aircraft, moments, axes) for _ in range(count)]
        self._everyone = np.arange(count)
        self._inner_rate = np.zeros((count, 3))  # [rad/s], pybullet's own, body axes
        self.momentum = np.zeros((count, 3))
        self.rate = np.zeros((count, 3))
        self.velocity = np.zeros((count, 3))
        self.position = np.zeros((count, 3))
        self.rotation = np.zeros((count, 3, 3))
        self.reset(range(count))

    def close(self) -> None:
        """Leave the client; the world cannot be used afterwards."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

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
                still = [0.0, 0.0, 0.0, 1.0]
                spin = (self._axes.T @ turning).tolist()
                pybullet.resetJointStateMultiDof(body, 0, still, spin, physicsClientId=self._client)
            else:
                pybullet.resetBasePositionAndOrientation(body, origin, self._quaternion, self._client)
                pybullet.resetBaseVelocity(body, (0.0, 0.0, 0.0), turning, self._client)
        self._inner_rate[which] = rates
        self.momentum[which] = rates @ self._inertia  # body axes are world axes here
        self._read_pose()
        self.rate[which] = rates
        if self.mount is not Mount.FREE:
            self._swing()
        else:
            self.velocity[which] = 0.0

    def step(self, wrench: Array) -> None:
        """Advance one time step under `wrench` (N, 6): body-axes force and moment at the centre of mass."""
        client, link, world = self._client, self._link, pybullet.WORLD_FRAME
        dt, rotation = self._dt, self.rotation
        moment = self._moment(wrench)
        middle = self.rate + (0.5 * dt) * (self._euler(moment, self.rate) @ self._inverse)
        asked = (middle - self._inner_rate) @ (self._inertia / dt) - self._euler(0.0, self._inner_rate)
        apply_torque = pybullet.applyExternalTorque
        torques = np.matmul(rotation, asked[:, :, None])[:, :, 0].tolist()
        for body, torque in zip(self._bodies, torques, strict=True):
            apply_torque(body, link, torque, world, client)
        if self.mount is Mount.FREE:
            apply_force = pybullet.applyExternalForce
            forces = np.matmul(rotation, wrench[:, :3, None])[:, :, 0].tolist()
            for body, force, at in zip(self._bodies, forces, self.position.tolist(), strict=True):
                apply_force(body, link, force, at, world, client)
        pybullet.stepSimulation(client)
        self._inner_rate = middle
        self._read_pose()
        mean = rotation + self.rotation  # twice the mean attitude of the step
        self.momentum += np.matmul(mean, moment[:, :, None])[:, :, 0] * (0.5 * dt)
        if self.mount is Mount.FREE:
            self._read_motion()
        self.rate = np.matmul(self.momentum[:, None, :], self.rotation)[:, 0, :] @ self._inverse
        if self.mount is Mount.RIG:
            self._swing()

    def _moment(self, wrench: Array) -> Array:
        """Moment about the pivot, body axes, (N, 3); gravity pulls at the rig's hanging centre of mass."""
        moment: Array = wrench[:, 3:]
        if self.mount is Mount.RIG:
            force = wrench[:, :3] + self._weight @ self.rotation
            moment = moment + _cross(self._arm[None], force)
        return moment

    def _euler(self, moment: Array | float, rate: Array) -> Array:
        """Euler's equations: rate of change of the body-axes momentum, (N, 3)."""
        change: Array = moment - _cross(rate, rate @ self._inertia)
        return change

    def _read_pose(self) -> None:
        client, bodies = self._client, self._bodies
        matrix = pybullet.getMatrixFromQuaternion
        if self.mount is Mount.RIG:
            joint = pybullet.getJointStateMultiDof
            turned = np.array([matrix(joint(b, 0, client)[0]) for b in bodies]).reshape(-1, 3, 3)
            self.rotation = self._axes @ turned @ self._axes.T
            return
        poses = [pybullet.getBasePositionAndOrientation(b, client) for b in bodies]
        principal = np.array([matrix(pose[1]) for pose in poses]).reshape(-1, 3, 3)
        self.rotation = principal @ self._axes.T
        if self.mount is Mount.FREE:
            self.position = np.array([pose[0] for pose in poses])

    def _read_motion(self) -> None:
        """Velocities as pybullet has them; what the ground did to the rate goes into the momentum."""
        motions = [pybullet.getBaseVelocity(b, self._client) for b in self._bodies]
        self.velocity = np.array([motion[0] for motion in motions])
        if self._ground:
            spin = np.array([motion[1] for motion in motions])
            inner = np.matmul(spin[:, None, :], self.rotation)[:, 0, :]
            impulse = (inner - self._inner_rate) @ self._inertia
            self.momentum += np.matmul(self.rotation, impulse[:, :, None])[:, :, 0]
            self._inner_rate = inner

    def _swing(self) -> None:
        """Motion of the rig's centre of mass about the ball joint."""
        self.position = self.rotation @ self._arm
        speed = _cross(self.rate, self._arm[None])
        self.velocity = np.matmul(self.rotation, speed[:, :, None])[:, :, 0]

    def _create(self, aircraft: Aircraft, moments: Array, axes: Array) -> int:
        client = self._client
        if self.mount is Mount.RIG:
            body = _load_rig(self._mass, self._arm, moments, axes, client)
            # A spherical joint comes with a motor that holds it still.
            pybullet.setJointMotorControlMultiDof(
                body,
                0,
                pybullet.POSITION_CONTROL,
                targetPosition=[0.0, 0.0, 0.0, 1.0],
                positionGain=0.0,
                velocityGain=1.0,
                force=[0.0, 0.0, 0.0],
                physicsClientId=client,
            )
        else:
            shape = self._create_box(aircraft) if self._ground else -1
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
        group, mask = (_AIRCRAFT, _GROUND) if self._ground else (0, 0)
        pybullet.setCollisionFilterGroupMask(body, self._link, group, mask, client)
        return body

    def _create_ground(self) -> None:
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        ground = pybullet.createMultiBody(0, plane, physicsClientId=self._client)
        pybullet.changeDynamics(
            ground, -1, lateralFriction=1.0, restitution=1.0, physicsClientId=self._client
        )
        pybullet.setCollisionFilterGroupMask(ground, -1, _GROUND, _AIRCRAFT, self._client)

    def _create_box(self, aircraft: Aircraft) -> int:
        """Collision box of the aircraft, in the principal axes about the centre of mass."""
        assert aircraft.body is not None
        offset = np.array(aircraft.body.centre) - aircraft.mass_properties.centre
        self._height = aircraft.body.size[2] / 2 - offset[2]  # of the centre of mass when it stands
        w, x, y, z = quaternion(self._axes.T)
        return int(
            pybullet.createCollisionShape(
                pybullet.GEOM_BOX,
                halfExtents=[size / 2 for size in aircraft.body.size],
                collisionFramePosition=(offset @ self._axes).tolist(),
                collisionFrameOrientation=(x, y, z, w),
                physicsClientId=self._client,
            )
        )


def _cross(a: Array, b: Array) -> Array:
    """a x b of rows; np.cross costs several times as much on small arrays."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.column_stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _load_rig(mass: float, arm: Array, moments: Array, axes: Array, client: int) -> int:
    """A fixed base with the aircraft on a ball joint at its centre of thrust.

    Goes through a URDF because pybullet ignores the inertia of a link that has no collision shape.
    """
    x, y, z = (f"{value:.17g}" for value in arm @ axes)
    # The link's frame lies along the principal axes: pybullet's joint turns in those, whatever the file says.
    turn = (math.atan2(axes[2, 1], axes[2, 2]), math.asin(-axes[2, 0]), math.atan2(axes[1, 0], axes[0, 0]))
    roll, pitch, yaw = (f"{value:.17g}" for value in turn)
    terms = " ".join(f'i{i}="{v:.17g}"' for i, v in zip(("xx", "yy", "zz"), moments, strict=True))
    nothing = 'ixx="0" iyy="0" izz="0"'
    products = 'ixy="0" ixz="0" iyz="0"'
    urdf = f"""<robot name="rig">
  <link name="base"><inertial><mass value="0"/><inertia {nothing} {products}/></inertial></link>
  <link name="aircraft"><inertial>
    <origin xyz="{x} {y} {z}"/><mass value="{mass:.17g}"/><inertia {terms} {products}/>
  </inertial></link>
  <joint name="ball" type="spherical">
    <origin rpy="{roll} {pitch} {yaw}"/><parent link="base"/><child link="aircraft"/><axis xyz="0 0 1"/>
  </joint>
</robot>"""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.urdf"
        path.write_text(urdf)
        return int(
            pybullet.loadURDF(
                str(path),
                useFixedBase=True,
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=client,
            )
        )
