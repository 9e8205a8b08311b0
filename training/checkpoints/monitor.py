"""The monitor: flies the policy of a checkpoint on five episodes that are always the same.

Commands, noise and throttle come from a seed of their own. The policy flies as it would be frozen:
deterministic, with the run's idle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.holding import DRIFT_S
from neuroflight.sim.analysis.metrics import effort, tracking
from neuroflight.toolchain.ir.interpreter import advance, clear_state
from neuroflight.toolchain.passes import optimize
from neuroflight.toolchain.policy.freeze import to_onnx
from neuroflight.toolchain.policy.model import parse_policy
from neuroflight.training.checkpoints.metrics import CheckpointMetrics, Spread
from neuroflight.training.config.algorithms import PpoConfig
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

Weights = Mapping[str, NDArray[np.float32]]  # by the names that `toolchain.policy.freeze` knows


def flown(config: TrainingConfig) -> TrainingConfig:
    """Return the configuration that the monitor flies: the run's task if it is one of OWN_TASKS, otherwise
    FLIGHT.

    Continuous commands are the dissertation's: they fly pulses.
    The world is the run's with the gyro's noise, without randomization, and with a throttle that stays.
    """
    world = replace(config.world, noise=True, randomization=Randomization(), throttle_steps=0.0)
    if config.task.name in OWN_TASKS:
        return replace(config, world=world)
    # Nothing is learned here, and the run's own hyperparameters may not fit the length of other episodes.
    task = PulseTask() if isinstance(config.task, ContinuousTask) else FLIGHT
    return replace(config, world=world, task=task, algorithm=PpoConfig(), recurrent="none")


def fly(aircraft: Aircraft, config: TrainingConfig, steps: int, policy: Weights) -> CheckpointMetrics:
    """Compute the metrics of a policy of the run `config` that was trained for `steps`.

    Raises PolicyError for weights that make no policy, such as NaN.
    """
    model = parse_policy(to_onnx(config.document(aircraft), policy))
    network, _ = optimize(model.network)
    rng = np.random.default_rng(SEED)
    simulation = AttitudeSimulation(aircraft, EPISODES, config=flown(config), rng=rng)
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
    return CheckpointMetrics(
        steps=steps,
        mae=Spread.of(errors.mae.mean(axis=1)),
        mse=Spread.of(errors.mse.mean(axis=1)),
        output=Spread.of([item.output for item in efforts]),
        change=Spread.of([item.change for item in efforts]),
        reward=Spread.of(reward / simulation.steps),
    )
