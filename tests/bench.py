"""Speed, measured in one run: `make bench`. Machines differ and are shared, so compare within a run.

Bare pybullet is the floor that the twin stands on: the same calls (moment in, step, attitude out; in free
flight force and velocity too) with no rotors, no gyro and no arithmetic around them.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pybullet

from sim.aircraft import load_aircraft
from sim.twin import Twin
from sim.world import Mount, World
from training.configuration import PpoConfig, TrainingConfig
from training.synthesis import train

NF1 = load_aircraft("nf1")


def rate(advance: Callable[[], object], aircraft: int, seconds: float) -> float:
    """Aircraft steps a second of `advance`, which steps `aircraft` of them."""
    advance()
    calls, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        advance()
        calls += 1
    return calls * aircraft / (time.perf_counter() - began)


def bare(count: int, mount: Mount, seconds: float) -> float:
    """pybullet alone, with the calls that the world makes: the same bodies, no arithmetic around them."""
    bodies = World(NF1, count, 0.001, mount, False)
    client, link, world = bodies._client, bodies._link, pybullet.WORLD_FRAME
    numbers = bodies._bodies

    def advance() -> object:
        for body in numbers:
            pybullet.applyExternalTorque(body, link, (0, 0, 0), world, client)
        if mount is Mount.FREE:
            for body in numbers:
                pybullet.applyExternalForce(body, link, (0, 0, 0), (0, 0, 0), world, client)
        pybullet.stepSimulation(client)
        if mount is Mount.RIG:
            return [pybullet.getJointStateMultiDof(body, 0, client) for body in numbers]
        poses = [pybullet.getBasePositionAndOrientation(body, client) for body in numbers]
        if mount is Mount.FREE:
            return poses, [pybullet.getBaseVelocity(body, client) for body in numbers]
        return poses

    try:
        return rate(advance, count, seconds)
    finally:
        bodies.close()


def uncorrected(count: int, seconds: float) -> float:
    """pybullet's own integration: rates read back from it instead of kept from the momentum."""
    bodies = World(NF1, count, 0.001, Mount.CENTRE, False)
    client, numbers, matrix = bodies._client, bodies._bodies, pybullet.getMatrixFromQuaternion
    rotation, moment = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))

    def advance() -> object:
        nonlocal rotation
        torques = np.matmul(rotation, moment[:, :, None])[:, :, 0].tolist()
        for body, torque in zip(numbers, torques, strict=True):
            pybullet.applyExternalTorque(body, -1, torque, pybullet.WORLD_FRAME, client)
        pybullet.stepSimulation(client)
        poses = [pybullet.getBasePositionAndOrientation(body, client) for body in numbers]
        rotation = np.array([matrix(pose[1]) for pose in poses]).reshape(-1, 3, 3)
        spin = np.array([pybullet.getBaseVelocity(body, client)[1] for body in numbers])
        return np.matmul(spin[:, None, :], rotation)[:, 0, :]

    try:
        return rate(advance, count, seconds)
    finally:
        bodies.close()


def world(count: int, seconds: float) -> float:
    """The rigid bodies alone."""
    bodies = World(NF1, count, 0.001, Mount.CENTRE, False)
    wrench = np.zeros((count, 6))
    try:
        return rate(lambda: bodies.step(wrench), count, seconds)
    finally:
        bodies.close()


def twin(count: int, mount: Mount, seconds: float) -> float:
    """Rotors, gyro and world."""
    aircraft = Twin(NF1, count, mount=mount, rng=np.random.default_rng(0))
    motors = np.full((count, NF1.motor_count), 0.3)
    try:
        return rate(lambda: aircraft.step(motors), count, seconds)
    finally:
        aircraft.close()


def training(steps: int) -> float:
    """Environment steps a second of `neuroflight train`, learning, checkpoints and all."""
    with tempfile.TemporaryDirectory() as folder:
        state = train(NF1, TrainingConfig(steps=steps), Path(folder))
    return state.steps / state.seconds


def main() -> int:
    """Measure everything and print it."""
    parser = argparse.ArgumentParser(description="speed of the twin and of training, in one run")
    parser.add_argument("--seconds", type=float, default=3.0, help="for each figure of the twin")
    parser.add_argument("--steps", type=int, default=2_000_000, help="of training")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    seconds, learning = args.seconds, PpoConfig().aircraft
    references = {mount: bare(64, mount, seconds) for mount in Mount}
    rows = [
        (f"bare pybullet, {mount.value}, 64 aircraft", value, mount) for mount, value in references.items()
    ]
    rows.append(("world with pybullet's own rates, 64", uncorrected(64, seconds), Mount.CENTRE))
    rows.append(("world that keeps momentum, 64", world(64, seconds), Mount.CENTRE))
    rows += [(f"twin, {mount.value}, 64 aircraft", twin(64, mount, seconds), mount) for mount in Mount]
    for count in (1, learning):
        rows.append((f"twin, centre, {count} aircraft", twin(count, Mount.CENTRE, seconds), Mount.CENTRE))
    rows.append((f"training, {learning} aircraft", training(args.steps), Mount.CENTRE))
    if args.json:
        print(json.dumps({name: round(value) for name, value, _ in rows}))
        return 0
    print(f"{'aircraft steps a second':36}{'':>10}  of bare pybullet on the same mount")
    for name, value, mount in rows:
        print(f"{name:36}{value:>10,.0f}  {value / references[mount]:.2f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
