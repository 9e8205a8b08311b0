"""Bodies of a pybullet client: the ground, an aircraft's collision box, an aircraft on its rig."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.bullet import pybullet
from neuroflight.sim.physics.rotation import quaternion, roll_pitch_yaw

GROUND, AIRCRAFT = 1, 2  # collision groups


def create_ground(client: int) -> None:
    """Create the plane z = 0."""
    plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
    ground = pybullet.createMultiBody(0, plane, physicsClientId=client)
    pybullet.changeDynamics(ground, -1, lateralFriction=1.0, restitution=1.0, physicsClientId=client)
    pybullet.setCollisionFilterGroupMask(ground, -1, GROUND, AIRCRAFT, client)


def resting_height(aircraft: Aircraft) -> float:
    """Return the height [m] of the centre of mass when the aircraft stands on the ground."""
    assert aircraft.body is not None
    return float(aircraft.body.size[2] / 2 - _box_offset(aircraft)[2])


def create_box(aircraft: Aircraft, axes: Array, client: int) -> int:
    """Create the aircraft's collision box about its centre of mass, in its principal axes."""
    assert aircraft.body is not None
    w, x, y, z = quaternion(axes.T)
    return int(
        pybullet.createCollisionShape(
            pybullet.GEOM_BOX,
            halfExtents=[size / 2 for size in aircraft.body.size],
            collisionFramePosition=(_box_offset(aircraft) @ axes).tolist(),
            collisionFrameOrientation=(x, y, z, w),
            physicsClientId=client,
        )
    )


def _box_offset(aircraft: Aircraft) -> Array:
    """Return the centre of the box from the centre of mass [m], body axes, (3,)."""
    assert aircraft.body is not None
    return np.array(aircraft.body.centre) - aircraft.mass_properties.centre


def load_rig(mass: float, arm: Array, moments: Array, axes: Array, client: int) -> int:
    """Load a fixed base with the aircraft on a ball joint at its centre of thrust.

    Goes through a URDF because pybullet ignores the inertia of a link that has no collision shape.
    """
    x, y, z = (f"{value:.17g}" for value in arm @ axes)
    # The link's frame lies along the principal axes: pybullet's joint turns in those, whatever the file says.
    roll, pitch, yaw = (f"{value:.17g}" for value in roll_pitch_yaw(axes))
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
        body = int(
            pybullet.loadURDF(
                str(path),
                useFixedBase=True,
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=client,
            )
        )
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
    return body
