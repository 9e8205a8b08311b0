"""Speed, measured in one run: `make bench`. Machines differ and are shared, so compare within a run.

Bare pybullet is the floor that the twin stands on: the same calls (moment in, step, pose and velocity out)
with no rotors, no gyro and no arithmetic around them.
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


def bare(count: int, seconds: float) -> float:
    """pybullet alone, with the calls that the twin makes."""
    client = pybullet.connect(pybullet.DIRECT)
    bodies = [pybullet.createMultiBody(baseMass=0.4, physicsClientId=client) for _ in range(count)]
    for body in bodies:
        pybullet.setCollisionFilterGroupMask(body, -1, 0, 0, client)

    def advance() -> object:
        for body in bodies:
            pybullet.applyExternalTorque(body, -1, (1e-4, 0, 0), pybullet.WORLD_FRAME, client)
        pybullet.stepSimulation(client)
        poses = [pybullet.getBasePositionAndOrientation(body, client) for body in bodies]
        turns = [pybullet.getMatrixFromQuaternion(pose[1]) for pose in poses]
        return turns, [pybullet.getBaseVelocity(body, client) for body in bodies]

    try:
        return rate(advance, count, seconds)
    finally:
        pybullet.disconnect(client)


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
    learning = PpoConfig().aircraft
    figures = {"bare pybullet, 64 aircraft": bare(64, args.seconds)}
    figures["world, 64 aircraft"] = world(64, args.seconds)
    for count in (1, 64, learning):
        figures[f"twin, {count} aircraft"] = twin(count, Mount.CENTRE, args.seconds)
    figures["twin on the rig, 64 aircraft"] = twin(64, Mount.RIG, args.seconds)
    figures[f"training, {learning} aircraft"] = training(args.steps)
    if args.json:
        print(json.dumps({name: round(value) for name, value in figures.items()}))
        return 0
    reference = figures["bare pybullet, 64 aircraft"]
    print(f"{'aircraft steps a second':36}{'':>10}  of bare pybullet")
    for name, value in figures.items():
        print(f"{name:36}{value:>10,.0f}  {value / reference:.2f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
