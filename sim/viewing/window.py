"""A flight in pybullet's window, in real time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from sim.physics.bullet import pybullet
from sim.physics.rotation import quaternion
from sim.viewing.scene import Scene
from sim.viewing.shapes import Face, Kind, aircraft_faces, disc_colour, reach
from toolchain.errors import NeuroflightError

Array = NDArray[np.float64]
BODY, NOSE = (0.54, 0.58, 0.63, 1.0), (0.13, 0.15, 0.18, 1.0)
OPACITY = 0.6  # of a rotor disc
FRAME_S = 1 / 60


def play(scene: Scene, speed: float, clock: Callable[[], float], wait: Callable[[float], None]) -> None:
    """Play the flight `speed` times as fast as it was, again and again, until the window is closed.

    clock: seconds, rising. wait: sleeps for so many seconds. Raises NeuroflightError if no window opens.
    """
    try:
        client = pybullet.connect(pybullet.GUI)
    except pybullet.error as error:
        raise NeuroflightError(f"no window: {error}; give --out FILE.html") from error
    if client < 0:
        raise NeuroflightError("pybullet opened no window; give --out FILE.html for a page instead")
    try:
        with suppress(pybullet.error):  # what a call says when the window was closed
            _show(scene, speed, client, clock, wait)
    finally:
        if pybullet.isConnected(client):
            pybullet.disconnect(client)


def _show(
    scene: Scene, speed: float, client: int, clock: Callable[[], float], wait: Callable[[float], None]
) -> None:
    faces, size = aircraft_faces(scene.aircraft), reach(scene.aircraft)
    pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0, physicsClientId=client)
    solid = [
        _body([face for face in faces if face.kind is kind], colour, client)
        for kind, colour in ((Kind.BODY, BODY), (Kind.NOSE, NOSE))
    ]
    discs = {face.motor: _body([face], _disc(0.0), client) for face in faces if face.kind is Kind.DISC}
    t = scene.trace.t
    length = float(t[-1] - t[0])
    begin = clock()
    yaw, pitch, distance = -55.0, -28.0, 3.0 * size
    while pybullet.isConnected(client):
        passed = speed * (clock() - begin)
        row = scene.rows(np.array([float(t[0]) + (passed % length if length > 0 else 0.0)]))[0]
        w, x, y, z = quaternion(scene.rotation[row])
        place = [0.0, 0.0, 0.0] if scene.position is None else scene.position[row].tolist()
        for body in (*solid, *discs.values()):
            pybullet.resetBasePositionAndOrientation(body, place, (x, y, z, w), physicsClientId=client)
        for motor, body in discs.items():
            colour = _disc(float(scene.trace.motors[row, motor]))
            pybullet.changeVisualShape(body, -1, rgbaColor=colour, physicsClientId=client)
        if scene.position is not None:  # the camera follows; who turned it by mouse keeps the direction
            seen = pybullet.getDebugVisualizerCamera(physicsClientId=client)
            if passed > 0 and seen[10]:
                yaw, pitch, distance = seen[8], seen[9], seen[10]
        if scene.position is not None or passed == 0:
            pybullet.resetDebugVisualizerCamera(distance, yaw, pitch, place, physicsClientId=client)
        wait(FRAME_S)


def _disc(command: float) -> tuple[float, float, float, float]:
    return (*disc_colour(command), OPACITY)


def _body(faces: list[Face], colour: tuple[float, float, float, float], client: int) -> int:
    """A massless body of polygons seen from both sides."""
    corners: list[list[float]] = []
    indices: list[int] = []
    for face in faces:
        first, count = len(corners), len(face.corners)
        corners += face.corners.tolist()
        for k in range(1, count - 1):
            indices += [first, first + k, first + k + 1, first, first + k + 1, first + k]
    shape = pybullet.createVisualShape(
        pybullet.GEOM_MESH, vertices=corners, indices=indices, rgbaColor=colour, physicsClientId=client
    )
    body: int = pybullet.createMultiBody(baseVisualShapeIndex=shape, physicsClientId=client)
    return body
