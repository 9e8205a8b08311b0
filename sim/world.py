"""The rigid-body world: N copies of an aircraft in one pybullet client.

pybullet integrates; this module only applies wrenches at each centre of mass and reads the motion back.
The copies have no collision shapes and do not feel each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import Enum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pybullet
from numpy.typing import NDArray

from sim.aircraft import Aircraft
from sim.rotation import quaternion

Array = NDArray[np.float64]
GRAVITY = 9.80665  # [m/s^2], standard gravity
COUNT_MAX = 4096
_TERMS = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


class Mount(Enum):
    """What holds the aircraft."""

    CENTRE = "centre"  # turns about its centre of mass; forces have no effect
    RIG = "rig"  # ball joint at the centre of thrust
    FREE = "free"  # nothing


class World:
    """A pybullet client with `count` aircraft; state arrays are refreshed by `reset` and `step`.

    rate: (N, 3) [rad/s] body axes; velocity, position: (N, 3) [m/s], [m] world axes, of the centre of
    mass; rotation: (N, 3, 3) body to world.
    """

    def __init__(self, aircraft: Aircraft, count: int, dt: float, mount: Mount, gravity: bool) -> None:
        if not 1 <= count <= COUNT_MAX:
            raise ValueError(f"got {count} aircraft, expected 1 to {COUNT_MAX} in one world")
        self.mount = mount
        self._client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(dt, self._client)
        pybullet.setGravity(0.0, 0.0, -GRAVITY if gravity else 0.0, self._client)
        moments, axes = np.linalg.eigh(aircraft.mass_properties.inertia)
        if np.linalg.det(axes) < 0:
            axes[:, 0] = -axes[:, 0]
        # A loose body is turned in its principal axes (the columns of `axes`), the rig's link in body axes.
        self._axes = np.eye(3) if mount is Mount.RIG else axes
        w, x, y, z = quaternion(self._axes)
        self._quaternion = (x, y, z, w)  # pybullet's order
        self._link = 0 if mount is Mount.RIG else -1
        self._bodies = [self._create(aircraft, moments) for _ in range(count)]
        self.rate = np.zeros((count, 3))
        self.velocity = np.zeros((count, 3))
        self.position = np.zeros((count, 3))
        self.rotation = np.zeros((count, 3, 3))
        self._read()

    def close(self) -> None:
        """Leave the client; the world cannot be used afterwards."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

    def reset(self, index: Iterable[int]) -> None:
        """Put the aircraft of `index` at rest, level, at the origin."""
        for i in index:
            body = self._bodies[i]
            if self.mount is Mount.RIG:
                pybullet.resetJointStateMultiDof(
                    body, 0, [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0], physicsClientId=self._client
                )
            else:
                zero = (0.0, 0.0, 0.0)
                pybullet.resetBasePositionAndOrientation(body, zero, self._quaternion, self._client)
                pybullet.resetBaseVelocity(body, zero, zero, self._client)
        self._read()

    def step(self, wrench: Array) -> None:
        """Advance one time step under `wrench` (N, 6): body-axes force and moment at the centre of mass."""
        client, link, world = self._client, self._link, pybullet.WORLD_FRAME
        apply_torque = pybullet.applyExternalTorque
        moments = np.matmul(self.rotation, wrench[:, 3:, None])[:, :, 0].tolist()
        for body, moment in zip(self._bodies, moments, strict=True):
            apply_torque(body, link, moment, world, client)
        if self.mount is not Mount.CENTRE:
            apply_force = pybullet.applyExternalForce
            forces = np.matmul(self.rotation, wrench[:, :3, None])[:, :, 0].tolist()
            for body, force, at in zip(self._bodies, forces, self.position.tolist(), strict=True):
                apply_force(body, link, force, at, world, client)
        pybullet.stepSimulation(client)
        self._read()

    def _create(self, aircraft: Aircraft, moments: Array) -> int:
        mass, client = aircraft.mass_properties.mass, self._client
        if self.mount is Mount.RIG:
            body = _load_rig(aircraft, client)
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
            body = int(
                pybullet.createMultiBody(
                    baseMass=mass, baseOrientation=self._quaternion, physicsClientId=client
                )
            )
            pybullet.changeDynamics(body, -1, localInertiaDiagonal=moments.tolist(), physicsClientId=client)
        pybullet.changeDynamics(
            body,
            self._link,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        # Copies share the origin; without this the broad phase pairs all of them, quadratically.
        pybullet.setCollisionFilterGroupMask(body, self._link, 0, 0, client)
        return body

    def _read(self) -> None:
        client, bodies = self._client, self._bodies
        if self.mount is Mount.RIG:
            states: Sequence[Any] = [pybullet.getLinkState(b, 0, 1, 0, client) for b in bodies]
            poses = [(state[0], state[5]) for state in states]
            motions = [(state[6], state[7]) for state in states]
        else:
            poses = [pybullet.getBasePositionAndOrientation(b, client) for b in bodies]
            motions = [pybullet.getBaseVelocity(b, client) for b in bodies]
        matrix = pybullet.getMatrixFromQuaternion
        principal = np.array([matrix(pose[1]) for pose in poses]).reshape(-1, 3, 3)
        self.rotation = principal @ self._axes.T
        spin = np.array([motion[1] for motion in motions])
        self.rate = np.matmul(spin[:, None, :], self.rotation)[:, 0, :]
        if self.mount is not Mount.CENTRE:
            self.velocity = np.array([motion[0] for motion in motions])
            self.position = np.array([pose[0] for pose in poses])


def _load_rig(aircraft: Aircraft, client: int) -> int:
    """A fixed base with the aircraft on a ball joint at its centre of thrust.

    Goes through a URDF because pybullet ignores the inertia of a link that has no collision shape.
    """
    arm = aircraft.mass_properties.centre - np.array(aircraft.centre_of_thrust)
    inertia = aircraft.mass_properties.inertia
    x, y, z = (f"{value:.17g}" for value in arm)
    terms = " ".join(f'{term}="{inertia[i, j]:.17g}"' for term, (i, j) in _TERMS.items())
    nothing = " ".join(f'{term}="0"' for term in _TERMS)
    urdf = f"""<robot name="rig">
  <link name="base"><inertial><mass value="0"/><inertia {nothing}/></inertial></link>
  <link name="aircraft"><inertial>
    <origin xyz="{x} {y} {z}"/><mass value="{aircraft.mass_properties.mass:.17g}"/><inertia {terms}/>
  </inertial></link>
  <joint name="ball" type="spherical">
    <parent link="base"/><child link="aircraft"/><axis xyz="0 0 1"/>
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
