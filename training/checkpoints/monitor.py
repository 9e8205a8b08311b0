"""The monitor: flies the policy of a checkpoint on five episodes that are always the same.

Commands, noise and throttle come from a seed of their own. The policy flies as it would be frozen:
deterministic, with the run's idle. A policy for any aircraft flies five episodes of each of several, drawn
from that seed; each is off what it is told, as far as a file of guesses is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.holding import DRIFT_S
from neuroflight.sim.analysis.metrics import effort, tracking
from neuroflight.sim.arrays import Array
from neuroflight.sim.control.told import told, told_model
from neuroflight.toolchain.ir.interpreter import advance, clear_state
from neuroflight.toolchain.passes import optimize
from neuroflight.toolchain.policy.freeze import to_onnx
from neuroflight.toolchain.policy.model import PolicyModel, parse_policy
from neuroflight.toolchain.policy.specialize import specialize
from neuroflight.training.checkpoints.metrics import CheckpointMetrics, Spread
from neuroflight.training.config.algorithms import PpoConfig
from neuroflight.training.config.any_aircraft import difficulty, draw_aircraft
from neuroflight.training.config.randomization import Randomization
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.envs.simulation import AttitudeSimulation
from neuroflight.training.tasks.flight import FlightTask
from neuroflight.training.tasks.task import ContinuousTask, EnvelopeTask, EpisodicTask, PulseTask

EPISODES = 5
SEED = 1_000_003  # of the monitor's episodes; results are measured with other seeds
OWN_TASKS = (PulseTask.name, EpisodicTask.name, EnvelopeTask.name, FlightTask.name)
# What a policy that will fly for minutes is chosen by: long enough for a memory that winds up to show.
FLIGHT = FlightTask(pulses=4, hover_s=DRIFT_S)
DRAWN = 8  # aircraft that a policy for any flies, pulses on each: as long as FLIGHT
# How far each of their flights is off what is told: about as far as real aircraft are off `aircraft new`.
GUESSED = Randomization(
    inertia=(0.65, 1.5),
    thrust=(0.77, 1.3),
    torque=(0.65, 1.5),
    lag=(0.6, 1.7),
    motors=(0.9, 1.0),
    delay_s=(0.001, 0.003),
    vibration_deg_s=(0.0, 12.0),
)

Weights = Mapping[str, NDArray[np.float32]]  # by the names that `toolchain.policy.freeze` knows


def episodes(config: TrainingConfig) -> int:
    """Return how many episodes a checkpoint flies."""
    return EPISODES * (DRAWN if _general(config) else 1)


def _general(config: TrainingConfig) -> bool:
    return config.world.aircraft == "any"


def flown(config: TrainingConfig) -> TrainingConfig:
    """Return the configuration that the monitor flies: the run's task if it is one of OWN_TASKS, otherwise
    FLIGHT.

    Continuous commands are the dissertation's: they fly pulses, as do the aircraft of a policy for any.
    The world is the run's with the gyro's noise, without randomization, and with a throttle that stays;
    aircraft that are drawn differ from what is told as GUESSED says.
    """
    general = _general(config)
    drawn = GUESSED if general else Randomization()
    world = replace(config.world, noise=True, randomization=drawn, throttle_steps=0.0)
    if config.task.name in OWN_TASKS:
        return replace(config, world=world)
    # Nothing is learned here, and the run's own hyperparameters may not fit the length of other episodes.
    task = PulseTask() if general or isinstance(config.task, ContinuousTask) else FLIGHT
    return replace(config, world=world, task=task, algorithm=PpoConfig(), recurrent="none")


def fly(aircraft: Aircraft, config: TrainingConfig, steps: int, policy: Weights) -> CheckpointMetrics:
    """Compute the metrics of a policy of the run `config` that was trained for `steps`.

    Errors of a policy for any are those of each aircraft over its `difficulty`, as in its training. Raises
    PolicyError for weights that make no policy, such as NaN.
    """
    data = to_onnx(config.document(aircraft), policy)
    if _general(config):
        rng = np.random.default_rng(SEED)
        drawn = [draw_aircraft(aircraft, rng) for _ in range(DRAWN)]
        flights = [_flown(each, config, _specialized(data, each)) for each in drawn]
        hard = np.repeat([difficulty(told(each)) for each in drawn], EPISODES)
    else:
        flights, hard = [_flown(aircraft, config, parse_policy(data))], np.ones(EPISODES)
    mae, mse, output, change, reward = (np.concatenate(parts) for parts in zip(*flights, strict=True))
    return CheckpointMetrics(
        steps=steps,
        mae=Spread.of(mae / hard),
        mse=Spread.of(mse / hard),
        output=Spread.of(output),
        change=Spread.of(change),
        reward=Spread.of(reward),
    )


def _specialized(data: bytes, aircraft: Aircraft) -> PolicyModel:
    """Return a policy for any, `data`, that is told of `aircraft`."""
    general = parse_policy(data)
    model = told_model(aircraft, general.blocks, general.control_rate_hz)
    return parse_policy(specialize(data, told(aircraft), aircraft.name, aircraft.sha256, model))


def _flown(aircraft: Aircraft, config: TrainingConfig, policy: PolicyModel) -> tuple[Array, ...]:
    """Fly the episodes; return MAE, MSE, mean output, mean change and mean reward of each."""
    network, _ = optimize(policy.network)
    rng = np.random.default_rng(SEED)
    simulation = AttitudeSimulation(aircraft, EPISODES, config=flown(config), rng=rng, model=policy.model)
    setpoint, rate = (np.empty((simulation.steps, EPISODES, 3)) for _ in range(2))
    output = np.empty((simulation.steps, EPISODES, simulation.motor_count))
    reward = np.zeros(EPISODES)
    try:
        observation, state = simulation.reset(), clear_state(network, EPISODES)
        for k in range(simulation.steps):
            setpoint[k], rate[k] = simulation.setpoint, simulation.rate
            output[k], state = advance(network, observation, state, exact=False)
            result = simulation.step(output[k].astype(np.float32))
            observation = result.observation
            reward += result.reward
    finally:
        simulation.close()
    step_s = 1.0 / config.control_rate_hz
    errors = tracking(setpoint.swapaxes(0, 1), rate.swapaxes(0, 1), step_s)
    efforts = [effort(y, step_s) for y in output.swapaxes(0, 1)]
    return (
        errors.mae.mean(axis=1),
        errors.mse.mean(axis=1),
        np.array([item.output for item in efforts]),
        np.array([item.change for item in efforts]),
        reward / simulation.steps,
    )
