"""Speed of the twin and of training beside bare pybullet.

Bare pybullet is a Python loop that makes the same calls for as many bodies (moment in, step, pose out; in
free flight force and velocity too), without rotors, sensors and arithmetic. The twin makes them in C, below
pybullet's Python layer, so it may be the faster one. All are timed in turn, several times, and the best of
each counts, so that other load on the machine slows a turn, not the figure.
"""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pybullet

from neuroflight.sim.aircraft.mass import principal
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.controller import PolicyController
from neuroflight.sim.physics.bodies import load_rig
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount, World
from neuroflight.toolchain.policy.model import read_policy
from neuroflight.training.config.algorithms import PpoConfig
from neuroflight.training.config.config_file import load_config
from neuroflight.training.evaluation.evaluation import figures, record
from neuroflight.training.runs.train import train
from neuroflight.training.tasks.task import PulseTask
from tests.bench.subject import Subject

NF1 = load_aircraft("nf1")
LEARNING = PpoConfig().aircraft
ROUNDS = 5
MINUTE_S = 57.0  # of learning; the rest is for what comes before and after
UNSEEN, UNSEEN_SEED = 200, 20002  # pulses that the policy trained for a minute is evaluated on


@dataclass
class Mounted(Subject):
    """A subject whose aircraft hang in a mount."""

    mount: Mount = field(kw_only=True)


@dataclass(frozen=True)
class Speed:
    """A figure: aircraft steps a second, and bare pybullet's on the same mount."""

    name: str
    value: float
    floor: float  # with as many aircraft


def bodies(count: int, mount: Mount, stack: ExitStack) -> tuple[int, list[int]]:
    """A pybullet client of its own with bodies as the world has them; its number and theirs."""
    client = pybullet.connect(pybullet.DIRECT)
    stack.callback(pybullet.disconnect, client)
    pybullet.setTimeStep(0.001, client)
    properties = NF1.mass_properties
    moments, axes = principal(properties.inertia)
    arm = properties.centre - np.array(NF1.centre_of_thrust)
    made = []
    for _ in range(count):
        if mount is Mount.RIG:
            made.append(load_rig(properties.mass, arm, moments, axes, client))
        else:
            made.append(pybullet.createMultiBody(baseMass=properties.mass, physicsClientId=client))
        link = link_of(mount)
        pybullet.changeDynamics(
            made[-1],
            link,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        if mount is not Mount.RIG:
            pybullet.changeDynamics(made[-1], -1, localInertiaDiagonal=moments, physicsClientId=client)
        pybullet.setCollisionFilterGroupMask(made[-1], link, 0, 0, client)
    return client, made


def link_of(mount: Mount) -> int:
    """pybullet's number of the link that moves."""
    return 0 if mount is Mount.RIG else -1


def bare(count: int, mount: Mount, stack: ExitStack, *, rates: bool = False) -> Mounted:
    """pybullet alone, called as a Python program calls it: what the world has its C do.

    rates: with one more call an aircraft, for the rate that the world keeps by itself.
    """
    client, numbers = bodies(count, mount, stack)
    link, world, nothing = link_of(mount), pybullet.WORLD_FRAME, (0.0, 0.0, 0.0)

    def advance() -> object:
        for body in numbers:
            pybullet.applyExternalTorque(body, link, nothing, world, client)
        if mount is Mount.FREE:
            for body in numbers:
                pybullet.applyExternalForce(body, link, nothing, nothing, world, client)
        pybullet.stepSimulation(client)
        if mount is Mount.RIG:
            return [pybullet.getJointStateMultiDof(body, 0, client) for body in numbers]
        poses = [pybullet.getBasePositionAndOrientation(body, client) for body in numbers]
        if mount is Mount.FREE or rates:
            return poses, [pybullet.getBaseVelocity(body, client) for body in numbers]
        return poses

    name = f"bare pybullet, {mount.value}" + (" and its rates" if rates else "")
    return Mounted(name, count, advance, mount=mount)


def uncorrected(count: int, stack: ExitStack) -> Mounted:
    """pybullet's own integration: rates read back from it instead of kept as momentum."""
    client, numbers = bodies(count, Mount.CENTRE, stack)
    matrix = pybullet.getMatrixFromQuaternion
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

    return Mounted("pybullet's own rates, in Python", count, advance, mount=Mount.CENTRE)


def world(count: int, stack: ExitStack) -> Mounted:
    """The rigid bodies alone."""
    made = World(NF1, count, 0.001, Mount.CENTRE, False)
    stack.callback(made.close)
    wrench = np.zeros((count, 6))
    return Mounted("world that keeps momentum", count, lambda: made.step(wrench), mount=Mount.CENTRE)


def twin(count: int, mount: Mount, stack: ExitStack) -> Mounted:
    """Rotors, sensors and world."""
    aircraft = Twin(NF1, count, mount=mount, rng=np.random.default_rng(0))
    stack.callback(aircraft.close)
    motors = np.full((count, NF1.motor_count), 0.3)
    return Mounted(f"twin, {mount.value}", count, lambda: aircraft.step(motors), mount=mount)


def twin_speeds(seconds: float) -> list[Speed]:
    """The twin and what it stands on. seconds: for each figure."""
    with ExitStack() as stack:
        floors = [bare(count, mount, stack) for count in (1, 64) for mount in Mount]
        floors.append(bare(LEARNING, Mount.CENTRE, stack))
        subjects = [
            *floors,
            bare(64, Mount.CENTRE, stack, rates=True),
            uncorrected(64, stack),
            world(64, stack),
            *(twin(count, mount, stack) for count in (1, 64) for mount in Mount),
            twin(LEARNING, Mount.CENTRE, stack),
        ]
        for _ in range(ROUNDS):
            for subject in subjects:
                subject.time(seconds / ROUNDS)
    floor = {(subject.mount, subject.aircraft): subject.best for subject in floors}
    return [Speed(f"{s.name}, {s.aircraft} aircraft", s.best, floor[s.mount, s.aircraft]) for s in subjects]


@dataclass(frozen=True)
class Learning:
    """What `neuroflight policy train` does with a recipe, checkpoints and all."""

    recipe: str
    steps_a_second: float  # end to end
    of_the_twin: float  # that, beside the twin alone with as many aircraft
    of_bare_pybullet: float  # and beside the Python loop of `bare`
    steps_in_a_minute: int
    seconds: float  # that they took
    mae_deg_s: float  # mean over axes of the policy that they made, on unseen pulses
    worst_mae_deg_s: float  # of a command and axis


def learning(recipe: str, steps: int, seconds: float, seed: int) -> Learning:
    """A recipe on the NF1's pulses. steps: to take the speed with; seconds: for the twin alone."""
    config = replace(load_config(recipe), steps=steps, seed=seed)
    aircraft = config.algorithm.aircraft
    with ExitStack() as stack:
        floor, alone = bare(aircraft, Mount.CENTRE, stack), twin(aircraft, Mount.CENTRE, stack)
        for _ in range(ROUNDS):
            floor.time(seconds / ROUNDS)
            alone.time(seconds / ROUNDS)
    with tempfile.TemporaryDirectory() as folder:
        state = train(NF1, config, Path(folder))
    speed = state.steps / state.seconds
    with tempfile.TemporaryDirectory() as folder:
        minute = train(NF1, replace(config, steps=int(MINUTE_S * speed)), Path(folder))
        policy = PolicyController(read_policy(Path(folder) / "policy.onnx"), UNSEEN, exact=False)
    flights = record(
        policy, NF1, PulseTask(), episodes=UNSEEN, seed=UNSEEN_SEED, control_rate_hz=1000, idle=config.idle
    )
    result = figures(flights)
    return Learning(
        recipe=recipe,
        steps_a_second=speed,
        of_the_twin=speed / alone.best,
        of_bare_pybullet=speed / floor.best,
        steps_in_a_minute=minute.steps,
        seconds=minute.seconds,
        mae_deg_s=float(result.tracking.mae.mean()),
        worst_mae_deg_s=result.worst_mae,
    )
