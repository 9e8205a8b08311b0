"""A flight in pybullet's window, in real time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from neuroflight.sim.physics.bullet import pybullet
from neuroflight.sim.physics.rotation import quaternion
from neuroflight.sim.viewing.scene import Scene
from neuroflight.sim.viewing.shapes import BELOW, Face, Kind, aircraft_faces, disc_colour, reach
from neuroflight.toolchain.errors import NeuroflightError

BODY, NOSE = (0.54, 0.58, 0.63, 1.0), (0.13, 0.15, 0.18, 1.0)
RENDER = pybullet.COV_ENABLE_SINGLE_STEP_RENDERING  # a frame is drawn whole, once all has moved
OPACITY = 0.6  # of a rotor disc
FLOOR = (1.0, 1.0, 1.0, 1.0)
CELLS_MAX = 60  # of the chequered floor, along one side
AROUND_M = 15.0  # of floor beyond the place of a flight
FRAME_S = 1 / 60
BACKGROUND = " ".join(f"--background_color_{name}=0.96" for name in ("red", "green", "blue"))


def play(scene: Scene, speed: float, clock: Callable[[], float], wait: Callable[[float], None]) -> None:
    """Play the flight `speed` times as fast as it was, again and again, until the window is closed.

    clock: seconds, rising. wait: sleeps for so many seconds. Raises NeuroflightError if no window opens.
    """
    try:
        client = pybullet.connect(pybullet.GUI, options=BACKGROUND)
    except pybullet.error as error:
        raise NeuroflightError(f"no window: {error}; give --out FILE.html") from error
    if client < 0:
        raise NeuroflightError("pybullet opened no window; give --out FILE.html for a page instead")
    try:
        with suppress(pybullet.error):  # raised by a call after the window was closed
            _show(scene, speed, client, clock, wait)
    finally:
        if pybullet.isConnected(client):
            pybullet.disconnect(client)


def _show(
    scene: Scene, speed: float, client: int, clock: Callable[[], float], wait: Callable[[float], None]
) -> None:
    faces, size = aircraft_faces(scene.aircraft), reach(scene.aircraft)
    for setting in (pybullet.COV_ENABLE_GUI, pybullet.COV_ENABLE_SHADOWS):
        pybullet.configureDebugVisualizer(setting, 0, physicsClientId=client)
    pybullet.configureDebugVisualizer(lightPosition=[-40, -30, 100], physicsClientId=client)
    solid = [
        _body([face for face in faces if face.kind is kind], colour, client)
        for kind, colour in ((Kind.BODY, BODY), (Kind.NOSE, NOSE))
    ]
    discs = {face.motor: _body([face], _disc(0.0), client) for face in faces if face.kind is Kind.DISC}
    _body(floor_faces(scene, size), FLOOR, client)
    t = scene.trace.t
    length = float(t[-1] - t[0])
    follows = scene.position is not None  # the camera; who turns it by mouse keeps the direction
    yaw, pitch, distance, place = -55.0, -28.0, 2.4 * size, [0.0, 0.0, 0.0]
    pybullet.resetDebugVisualizerCamera(distance, yaw, pitch, place, physicsClientId=client)
    begin = clock()
    while pybullet.isConnected(client):
        passed = speed * (clock() - begin)
        row = scene.rows(np.array([float(t[0]) + (passed % length if length > 0 else 0.0)]))[0]
        w, x, y, z = quaternion(scene.rotation[row])
        if scene.position is not None:
            place = scene.position[row].tolist()
        for body in (*solid, *discs.values()):
            pybullet.resetBasePositionAndOrientation(body, place, (x, y, z, w), physicsClientId=client)
        for motor, body in discs.items():
            colour = _disc(float(scene.trace.motors[row, motor]))
            pybullet.changeVisualShape(body, -1, rgbaColor=colour, physicsClientId=client)
        if follows:
            seen = pybullet.getDebugVisualizerCamera(physicsClientId=client)
            if seen[10]:
                yaw, pitch, distance = seen[8], seen[9], seen[10]
            pybullet.resetDebugVisualizerCamera(distance, yaw, pitch, place, physicsClientId=client)
        pybullet.configureDebugVisualizer(RENDER, 1, physicsClientId=client)
        wait(FRAME_S)


def floor_faces(scene: Scene, size: float) -> list[Face]:
    """Return every other square of a chequered floor below the flight; size: the aircraft's radius [m]."""
    cell, low, high = size, np.full(3, -5 * size), np.full(3, 5 * size)
    if scene.position is not None:
        low, high = scene.position.min(axis=0) - AROUND_M, scene.position.max(axis=0) + AROUND_M
        cell = max(1.0, float((high - low)[:2].max()) / CELLS_MAX)
    lowest = 0.0 if scene.position is None else float(scene.position[:, 2].min())
    across, along = (int(np.ceil(each / cell)) for each in (high - low)[:2])
    square = cell * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    corner = np.array([low[0], low[1], lowest - BELOW * size])
    return [
        Face(Kind.BODY, corner + cell * np.array([i, j, 0]) + square)
        for i in range(across)
        for j in range(i % 2, along, 2)
    ]


def _disc(command: float) -> tuple[float, float, float, float]:
    return (*disc_colour(command), OPACITY)


def _body(faces: list[Face], colour: tuple[float, float, float, float], client: int) -> int:
    """Create a massless body of polygons seen from both sides."""
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
