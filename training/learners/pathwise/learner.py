"""The pathwise learner: updates the policy along the gradient of the loss of whole flights.

A flight in the twin is a function of the policy's weights, and the twin's equations are known. So the loss of
a batch of flights has a gradient, which is computed backwards through them, step by step. This needs no
critic and no exploration, and its noise is some hundred times less than that of a likelihood-ratio policy
gradient from as many steps.

Source: SVG(inf) of Heess et al. 2015, "Learning Continuous Control Policies by Stochastic Value Gradients",
for a policy without noise: the states are those of the flight, the model only gives the derivatives there.
`training.learners.pathwise.gradient` and `sim.physics.derivative` say which derivatives are exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from sim.aircraft.model import Aircraft
from sim.control.observation import Observer
from sim.physics.derivative import StepModel
from sim.physics.twin import Twin
from sim.physics.variation import Variation
from sim.physics.world import Mount
from toolchain.errors import TrainingError
from training.config.pathwise_config import PathwiseConfig
from training.config.training_config import TrainingConfig
from training.learners.pathwise.descent import State, adapted, descended, with_parameters
from training.learners.pathwise.flight import Batch, fly
from training.learners.pathwise.gradient import gradient
from training.learners.pathwise.loss import Figures, Weights, figures_and_gradient
from training.learners.pathwise.network import Network
from training.learners.protocol import Report, named_layers
from training.tasks.random_steps import RandomStepsTask, StepWeights

Floats = NDArray[np.float32]

RATE_LAST = 0.02  # of the learning rate, at the end


class PathwiseLearner:
    """See Learner."""

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, pathwise: PathwiseConfig) -> None:
        """Raises TrainingError, one line, on a configuration without such a gradient."""
        for error in _errors(config):
            raise TrainingError(error)
        self._terms = config.blocks()
        self._aircraft, self._config, self._pathwise = aircraft, config, pathwise
        self._scale = np.array(config.observation_scale(aircraft.motor_count), np.float32)
        self._batch_steps = pathwise.aircraft * round(config.task.duration_s * config.control_rate_hz)
        self._updates = math.ceil(config.steps / self._batch_steps)
        network = Network.fresh(
            [len(self._scale), *config.hidden, aircraft.motor_count],
            config.activation,
            config.output,
            pathwise.start_output,
            np.random.default_rng(config.seed),
        )
        nothing = [np.zeros_like(parameter) for parameter in network.parameters]
        weights = Weights(pathwise.square, pathwise.output, pathwise.change)
        self._state = State(0, network, nothing, nothing, weights, None)

    @property
    def steps(self) -> int:
        """See Learner."""
        return self._state.updates * self._batch_steps

    def learn(self, segment: int, report: Callable[[Report], None]) -> None:
        """See Learner."""
        config, count = self._config, self._pathwise.aircraft
        rng = np.random.default_rng(np.random.SeedSequence([config.seed, segment]))
        own = self._aircraft.propulsion.delay
        twin = Twin(
            self._aircraft,
            count,
            rate_hz=config.control_rate_hz,
            noise=config.world.noise,
            variation=Variation.nominal(count, own) if config.world.randomization.active else None,
            rng=rng,
        )
        try:
            for _ in range(math.ceil(self._pathwise.leg_steps / self._batch_steps)):
                if self._state.updates == self._updates:
                    return
                figures = self._update(twin, self._batch(rng))
                report(self._report(figures))
        finally:
            twin.close()

    def _batch(self, rng: np.random.Generator) -> Batch:
        """Draw the episodes of an update."""
        config, world, count = self._config, self._config.world, self._pathwise.aircraft
        task, rate_hz = config.task, config.control_rate_hz
        if isinstance(task, RandomStepsTask):
            setpoint, step_weights = task.batch(count, rng, rate_hz)
        else:
            setpoint = task.episodes(count, rng, rate_hz)
            step_weights = StepWeights.equal(*setpoint.shape[:2])
        return Batch(
            setpoint=np.ascontiguousarray(setpoint.swapaxes(0, 1)),
            step_weights=step_weights,
            throttle=world.draw_throttle(count, rng),
            variation=world.randomization.draw(count, rng, self._aircraft.propulsion.delay),
        )

    def _update(self, twin: Twin, batch: Batch) -> Figures:
        """Fly `batch` and update the policy; returns the batch's figures."""
        config, aircraft, state = self._config, self._aircraft, self._state
        if config.world.randomization.active:
            twin.vary(np.arange(twin.count), batch.variation)
        twin.reset()
        observer = Observer(self._terms, twin.count, aircraft.motor_count, config.control_rate_hz)
        flight = fly(twin, observer, state.network, self._scale, batch, config.idle)
        figures, by_flight = figures_and_gradient(flight, batch, state.weights)
        model = StepModel.of(aircraft, config.control_rate_hz, batch.variation)
        found = gradient(
            flight,
            batch,
            by_flight,
            state.network,
            self._scale,
            self._terms,
            model,
            aircraft.gyro,
            config.idle,
        )
        adapting = state.updates >= self._pathwise.adaption_start * self._updates
        state = descended(state, found, self._rate(), self._pathwise)
        self._state = adapted(state, figures, self._pathwise, adapting)
        return figures

    def _rate(self) -> float:
        """Learning rate of the next update."""
        done, pathwise = self._state.updates, self._pathwise
        rise = min(1.0, (done + 1) / max(1, pathwise.warm_up))
        fall = 0.5 * (1.0 + math.cos(math.pi * done / self._updates))
        return pathwise.learning_rate * rise * (RATE_LAST + (1.0 - RATE_LAST) * fall)

    def _report(self, figures: Figures) -> Report:
        weights = self._state.weights
        return Report(
            self.steps,
            -figures.loss(weights),
            {
                "train/mae_deg_s": figures.mae,
                "train/mse": figures.mse,
                "train/output": figures.output,
                "train/change": figures.change,
                "train/weight_output": weights.output,
                "train/weight_change": weights.change,
                "train/learning_rate": self._rate(),
            },
        )

    def policy(self) -> dict[str, torch.Tensor]:
        """See Learner."""
        return named_layers(
            [
                {"weight": torch.from_numpy(layer.weight), "bias": torch.from_numpy(layer.bias)}
                for layer in self._state.network.layers
            ]
        )

    def state(self) -> dict[str, Any]:
        """See Learner."""
        state = self._state

        def tensors(arrays: list[Floats]) -> list[torch.Tensor]:
            return [torch.from_numpy(array) for array in arrays]

        return {
            "updates": state.updates,
            "parameters": tensors(state.network.parameters),
            "mean": tensors(state.mean),
            "square": tensors(state.square),
            "weights": vars(state.weights),
            "figures": None if state.figures is None else vars(state.figures),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """See Learner."""

        def arrays(tensors: list[torch.Tensor]) -> list[Floats]:
            return [tensor.numpy().copy() for tensor in tensors]

        figures = state["figures"]
        self._state = State(
            updates=state["updates"],
            network=with_parameters(self._state.network, arrays(state["parameters"])),
            mean=arrays(state["mean"]),
            square=arrays(state["square"]),
            weights=Weights(**state["weights"]),
            figures=None if figures is None else Figures(**figures),
        )

    def close(self) -> None:
        """See Learner; each segment closes its own twin."""


def _errors(config: TrainingConfig) -> list[str]:
    """Reasons why `config` has no pathwise gradient, one line each."""
    world = config.world
    demands = {
        f"mount {world.mount!r}: the pathwise gradient knows an aircraft that turns about its centre of "
        f"mass; choose mount centre, or another algorithm": world.mount == Mount.CENTRE.value,
        "wind: the pathwise gradient knows calm air only; leave wind_m_s and gust_m_s at 0, or choose "
        "another algorithm": not (any(world.wind_m_s) or world.gust_m_s),
        "observation gravity: the pathwise gradient does not follow the attitude; leave it out, or choose "
        "another algorithm": all(term.name != "gravity" for term in config.blocks()),
    }
    return [error for error, met in demands.items() if not met]
