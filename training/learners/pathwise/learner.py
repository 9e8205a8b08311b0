"""The pathwise learner: updates the policy along the gradient of the loss of whole flights.

A flight in the twin is a function of the policy's weights, and the twin's equations are known. So the loss of
a batch of flights has a gradient, which is computed backwards through them, step by step. This needs no
critic and no exploration, and its noise is some hundred times less than that of a likelihood-ratio policy
gradient from as many steps.

Source: SVG(inf) of Heess et al. 2015, "Learning Continuous Control Policies by Stochastic Value Gradients",
for a policy without noise. Flights and gradients are computed in C (`c/`), with the twin's equations but
without pybullet: of an aircraft that turns about its centre of mass only the rates matter, which need no
attitude. flight.c says which derivatives are exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array32
from neuroflight.sim.control.estimator import observed_model
from neuroflight.sim.control.gyro_filter import samples_per_step
from neuroflight.sim.control.told import told, told_model
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.policy.specialize import BASIS, FEATURES, features, input_factors
from neuroflight.training.config.pathwise_config import BLOCK, PathwiseConfig
from neuroflight.training.config.training_config import OBSERVATION_SCALES, TrainingConfig
from neuroflight.training.learners.network.shape import Shape
from neuroflight.training.learners.pathwise.basis import Basis, steering
from neuroflight.training.learners.pathwise.batch import Batch, draw_batch
from neuroflight.training.learners.pathwise.descent import Good, Setback, State, adapted, descended, guarded
from neuroflight.training.learners.pathwise.flights import Flights
from neuroflight.training.learners.pathwise.general import General
from neuroflight.training.learners.pathwise.loss import LossFigures, Weights
from neuroflight.training.learners.pathwise.plan import Surroundings
from neuroflight.training.learners.protocol import Report, named_layers

RATE_LAST = 0.02  # of the learning rate, at the end


class PathwiseLearner:
    """The pathwise learner."""

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, pathwise: PathwiseConfig) -> None:
        """Prepare the flights. Raises TrainingError for a configuration without such a gradient."""
        for error in _errors(config):
            raise TrainingError(error)
        if aircraft.propulsion.friction:
            raise TrainingError(
                f"pathwise: aircraft {aircraft.name} has rotors with friction "
                f"(propulsion.response.friction_n_m_s), which its gradient leaves out; train it with ppo"
            )
        self._aircraft, self._config, self._pathwise = aircraft, config, pathwise
        self._surroundings = surroundings = _surroundings(aircraft, config, pathwise)
        self._shape = surroundings.shape
        self._basis = Basis(self._shape, surroundings.terms, aircraft.motor_count, steering(aircraft))
        self._general: General | None = None
        if config.world.aircraft == "any":
            self._told = told(aircraft)
            self._general = General(self._basis, self._shape, surroundings.terms)
        self._flights = Flights(surroundings)
        self._batch_steps = pathwise.aircraft * surroundings.steps
        self._updates = math.ceil(config.steps / self._batch_steps)
        parameters = self._shape.fresh(pathwise.start_output, np.random.default_rng(config.seed))
        if self._general is not None:
            parameters = self._general.fresh(parameters)
        weights = Weights(pathwise.square, pathwise.output, pathwise.change, pathwise.closed)
        self._state = State.fresh(parameters, weights)

    @property
    def steps(self) -> int:
        """See Learner."""
        return self._state.updates * self._batch_steps

    def learn(self, segment: int, report: Callable[[Report], None]) -> None:
        """See Learner."""
        rng = np.random.default_rng(np.random.SeedSequence([self._config.seed, segment]))
        for _ in range(math.ceil(self._pathwise.leg_steps / self._batch_steps)):
            if self._state.updates == self._updates:
                return
            before = len(self._state.setbacks)
            figures = self._update(rng)
            report(self._report(figures, self._state.setbacks[before:]))

    def _update(self, rng: np.random.Generator) -> LossFigures:
        """Fly a batch and update the policy; returns the batch's figures."""
        state, pathwise = self._state, self._pathwise
        batch = draw_batch(self._config, pathwise, self._aircraft, rng)
        figures, found = self._gradient(batch)
        adapting = state.updates >= pathwise.adaption_start * self._updates
        state = descended(state, found, self._rate(), pathwise)
        state = adapted(state, figures, pathwise, adapting)
        self._state = guarded(state, figures.error(pathwise.square))
        return figures

    def _gradient(self, batch: Batch) -> tuple[LossFigures, Array32]:
        """Compute figures of the batch, and the loss's derivatives by what is learned."""
        state, general = self._state, self._general
        if general is None:
            figures, own = self._flights.gradient(batch, self._basis.network(state.parameters), state.weights)
            return figures, self._basis.gradient(own)
        known = [told(aircraft) for aircraft in batch.told]
        flown = [
            replace(
                self._surroundings,
                aircraft=aircraft,
                model=told_model(aircraft, self._surroundings.terms, self._config.control_rate_hz),
                shaken=bool(
                    np.isfinite(batch.variation.vibration[block * BLOCK : (block + 1) * BLOCK]).any()
                ),
            )
            for block, aircraft in enumerate(batch.told)
        ]
        networks = [general.network(state.parameters, each) for each in known]
        figures, each = self._flights.gradients(batch, flown, networks, state.weights)
        total, longest = np.zeros_like(state.parameters), self._pathwise.gradient_max
        for own, of in zip(each, known, strict=True):
            part = general.gradient(own, of)
            length = math.sqrt(float(np.square(part, dtype=np.float64).sum()))
            # All have the same say: an aircraft out of control has a gradient a thousand times as long.
            if math.isfinite(length):
                total += part * np.float32(longest / max(length, longest))
        return figures, total

    def _rate(self) -> float:
        """Return the learning rate of the next update."""
        state, pathwise = self._state, self._pathwise
        done = state.updates
        rise = state.rate_factor * min(1.0, (done - state.begun + 1) / max(1, pathwise.warm_up))
        fall = 0.5 * (1.0 + math.cos(math.pi * done / self._updates))
        return pathwise.learning_rate * rise * (RATE_LAST + (1.0 - RATE_LAST) * fall)

    def _report(self, figures: LossFigures, setbacks: Sequence[Setback]) -> Report:
        state = self._state
        return Report(
            self.steps,
            -figures.loss(state.weights),
            {
                "train/mae_deg_s": figures.mae,
                "train/mse": figures.mse,
                "train/output": figures.output,
                "train/change": figures.change,
                "train/closed": figures.closed,
                "train/weight_output": state.weights.output,
                "train/weight_change": state.weights.change,
                "train/gradient": state.length,
                "train/skipped": float(state.skipped),
                "train/setbacks": float(len(state.setbacks)),
                "train/learning_rate": self._rate(),
            },
            " ".join(setback.line(self._batch_steps) for setback in setbacks),
        )

    def policy(self) -> dict[str, torch.Tensor]:
        """See Learner."""
        general, learned = self._general, self._state.parameters
        if general is None:
            return self._named(self._basis.network(learned))
        bases = {
            f"{BASIS}{number}.{name}": part
            for number, basis in enumerate(general.bases(learned))
            for name, part in self._named(basis).items()
        }
        return self._named(general.network(learned, self._told)) | bases

    def _named(self, network: Array32) -> dict[str, torch.Tensor]:
        """Name the parameters of a network as freeze knows them."""
        parts = [torch.from_numpy(part.copy()) for part in self._shape.split(network)]
        memory: dict[str, torch.Tensor] = {}
        if self._shape.recurrent != "none":
            names = ("weight_ih", "bias_ih", "weight_hh", "bias_hh")
            memory = {f"recurrent.{name}_l0": part for name, part in zip(names, parts, strict=False)}
            parts = parts[len(names) :]
        layers = [
            {"weight": weight, "bias": bias} for weight, bias in zip(parts[::2], parts[1::2], strict=True)
        ]
        return memory | named_layers(layers)

    def state(self) -> dict[str, Any]:
        """See Learner."""
        state = self._state
        return {
            "updates": state.updates,
            **{name: torch.from_numpy(getattr(state, name)) for name in ("parameters", "mean", "square")},
            "weights": vars(state.weights),
            "figures": None if state.figures is None else vars(state.figures),
            "length": state.length,
            "skipped": state.skipped,
            "begun": state.begun,
            "error": state.error,
            "good": {
                **vars(state.good),
                "parameters": torch.from_numpy(state.good.parameters),
                "weights": vars(state.good.weights),
            },
            "setbacks": [vars(setback) for setback in state.setbacks],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """See Learner."""
        figures, good = state["figures"], dict(state["good"])
        good |= {"parameters": good["parameters"].numpy().copy(), "weights": Weights(**good["weights"])}
        self._state = State(
            updates=state["updates"],
            **{name: state[name].numpy().copy() for name in ("parameters", "mean", "square")},
            weights=Weights(**state["weights"]),
            figures=None if figures is None else LossFigures(**figures),
            length=state["length"],
            skipped=state["skipped"],
            begun=state["begun"],
            error=state["error"],
            good=Good(**good),
            setbacks=tuple(Setback(**setback) for setback in state["setbacks"]),
        )

    def start_from(self, policy: dict[str, torch.Tensor], state: dict[str, Any]) -> None:
        """Begin with the weights of another run's policy, and the loss weights that its limits had led to.

        An aircraft's run may start from a policy for any, and one for any from an aircraft's. Raises
        TrainingError on a policy of another network, AircraftError if a general one cannot fly the aircraft.
        """
        general, basis = self._general, self._basis
        bases = [
            {name.removeprefix(start): part for name, part in policy.items() if name.startswith(start)}
            for start in (f"{BASIS}{number}." for number in range(FEATURES))
        ]
        if bases[0]:
            parts = np.stack([self._joined(each) for each in bases])
            if general is not None:
                learned = np.concatenate([basis.learned(part) for part in parts])
            else:
                network = (features(told(self._aircraft)) @ parts.astype(np.float64)).astype(np.float32)
                learned = basis.learned(self._counted(network, 1.0))
        elif general is not None:
            learned = general.fresh(basis.learned(self._counted(self._joined(policy), -1.0)))
        else:
            learned = basis.learned(self._joined(policy))
        self._state = State.fresh(learned, Weights(**state["weights"]))

    def _joined(self, policy: dict[str, torch.Tensor]) -> Array32:
        """Return the parameters of a policy. Raises TrainingError if its network is another."""
        mine = self._named(np.zeros(self._shape.count, np.float32))
        if {name: part.shape for name, part in mine.items()} != {n: p.shape for n, p in policy.items()}:
            raise TrainingError("the policy to start from has another network than the configuration")
        return np.concatenate([policy[name].numpy().astype(np.float32).ravel() for name in mine])

    def _counted(self, network: Array32, power: float) -> Array32:
        """Multiply the first layer's columns by this power of the inputs' factors, in place."""
        factors = input_factors(told(self._aircraft), self._surroundings.terms)
        self._shape.split(network)[0][:] *= (factors**power).astype(np.float32)
        return network

    def flown(self, rng: np.random.Generator) -> LossFigures:
        """Fly a batch with the policy as it is, and return its figures; nothing is learned."""
        return self._gradient(draw_batch(self._config, self._pathwise, self._aircraft, rng))[0]

    def close(self) -> None:
        """See Learner."""
        self._flights.close()


def _surroundings(aircraft: Aircraft, config: TrainingConfig, pathwise: PathwiseConfig) -> Surroundings:
    terms, motors, rate_hz = config.blocks(), aircraft.motor_count, config.control_rate_hz
    inputs = len(config.observation_scale(motors))
    return Surroundings(
        aircraft=aircraft,
        steps=round(config.task.duration_s * rate_hz),
        control_rate_hz=rate_hz,
        samples=samples_per_step(config.gyro_filters, rate_hz),
        filters=config.gyro_filters,
        terms=terms,
        scales=tuple(OBSERVATION_SCALES[term.name] for term in terms),
        mix=config.mixing,
        idle=config.idle,
        model=observed_model(aircraft, terms, rate_hz),
        shape=Shape((inputs, *config.hidden, motors), config.activation, config.output, config.recurrent),
        of_motors=pathwise.change_of == "motors",
        soft=pathwise.soft,
        noise=config.world.noise,
        shaken=config.world.randomization.vibration_deg_s is not None,
    )


def _errors(config: TrainingConfig) -> list[str]:
    """List why `config` has no pathwise gradient, one line each."""
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
