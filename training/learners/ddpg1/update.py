"""Actor and critic as one array of parameters, and the C that computes and updates them (`c/`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.training.config.training_config import OutputMap
from neuroflight.training.learners.network.computed import Computed, described, observed, set_adam
from neuroflight.training.learners.network.library import aligned, load, pointer
from neuroflight.training.learners.network.normalization import Normalization
from neuroflight.training.learners.network.shape import Shape

Numbers = NDArray[np.floating]

EPS = 1e-8  # Adam's, as in Baselines
LAST = 3e-3  # the last layers' weights are drawn from within this of 0, as in Lillicrap et al. 2016


@dataclass(frozen=True)
class ActorCritic:
    """Two networks that share nothing. Parameters: the actor's, then the critic's.

    The critic's second layer sees the action beside the first layer's values.
    """

    inputs: int
    hidden: tuple[int, ...]  # of both
    motors: int
    activation: str

    @property
    def actor(self) -> Shape:
        """Shape of the network from an observation to outputs, before the tanh."""
        return Shape((self.inputs, *self.hidden, self.motors), self.activation, OutputMap())

    @property
    def critic_first(self) -> Shape:
        """The critic's first layer."""
        return Shape((self.inputs, self.hidden[0]), self.activation, OutputMap())

    @property
    def critic_rest(self) -> Shape:
        """The layers that follow."""
        first, *others = self.hidden
        return Shape((first + self.motors, *others, 1), self.activation, OutputMap())

    @property
    def counts(self) -> tuple[int, int]:
        """Number of parameters of actor and critic."""
        return self.actor.count, self.critic_first.count + self.critic_rest.count

    def split(self, parameters: Numbers) -> tuple[Numbers, Numbers]:
        """Return views of the actor's and the critic's parameters."""
        actor = self.counts[0]
        return parameters[:actor], parameters[actor:]

    def parts(self, parameters: Numbers) -> tuple[list[Numbers], list[Numbers]]:
        """Return views of weights and biases of each layer: of the actor, of the critic."""
        actor, critic = self.split(parameters)
        first = self.critic_first.count
        return (
            self.actor.split(actor),
            [*self.critic_first.split(critic[:first]), *self.critic_rest.split(critic[first:])],
        )

    def fresh(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Draw parameters of untrained networks as in Baselines (Glorot and Bengio 2010); biases are 0."""
        parameters = np.zeros(sum(self.counts), np.float32)
        for parts in self.parts(parameters):
            weights = parts[::2]
            for weight in weights:
                limit = LAST if weight is weights[-1] else np.sqrt(6.0 / sum(weight.shape))
                weight[:] = rng.uniform(-limit, limit, weight.shape)
        return parameters


@dataclass(frozen=True)
class Losses:
    """Constants of an update."""

    discount: float
    tau: float
    decay: float  # of the critic
    rates: tuple[float, float]  # Adam's, of actor and critic


@dataclass(frozen=True, eq=False)
class Learnt:
    """The arrays of all parameters that updates change in place."""

    parameters: Numbers
    targets: Numbers
    first: Numbers  # Adam's means of the gradient
    second: Numbers  # and of its square

    @staticmethod
    def fresh(parameters: Numbers) -> Learnt:
        """Return the state before the first update: targets are copies."""
        return Learnt(parameters, parameters.copy(), np.zeros_like(parameters), np.zeros_like(parameters))


class Engine:
    """The networks in C; number: float32 for training, float64 for tests. All arrays are of it."""

    def __init__(self, networks: ActorCritic, number: str = "float32") -> None:
        """Load the C. Raises BuildError, one line, without a C compiler."""
        self._networks, self._number = networks, number
        self._library = library = load("ddpg1", number)
        self._actor = Computed(library, networks.actor, number, squash=True)
        self._critic = critic = library.ffi.new("struct critic *")
        critic.inputs, critic.units = networks.inputs, networks.hidden[0]
        critic.rest = described(library, networks.critic_rest)[0]
        self._memory = aligned(library.lib.ddpg1_memory(self._actor.described, critic), number)

    def outputs(self, parameters: Numbers, normalization: Normalization, observations: Numbers) -> Numbers:
        """Compute the actor's outputs (N, M) for observations (N, n)."""
        return self._actor.outputs(self._networks.split(parameters)[0], normalization, observations)

    def acting(self, actors: Numbers, normalization: Normalization) -> Callable[[Numbers], Numbers]:
        """Return a function from observations (N, n) to outputs (N, M), of actors with parameters of their
        own.

        actors: (parameters of an actor, N). The caller keeps the arrays. Each call overwrites the last
        result.
        """
        networks, number = self._networks, self._number
        count, widest = actors.shape[1], max(networks.actor.widths)
        memory = aligned(2 * widest * count, number)
        observations = np.empty((count, networks.inputs), number)
        found = np.empty((count, networks.motors), number)
        given = observed(self._library, normalization, observations)
        weights, result, space = pointer(actors), pointer(found), pointer(memory)
        act, actor = self._library.lib.ddpg1_act, self._actor.described

        def outputs(rows: Numbers) -> Numbers:
            observations[:] = rows
            act(actor, weights, count, given, result, space)
            return found

        return outputs

    def values(
        self, parameters: Numbers, normalization: Normalization, observations: Numbers, actions: Numbers
    ) -> Numbers:
        """Compute the critic's values (N,) of actions (N, M) at observations (N, n)."""
        rows = np.concatenate([observations, actions], axis=1, dtype=self._number)
        found, critic = np.empty(len(rows), self._number), self._networks.split(parameters)[1]
        given = observed(self._library, normalization, rows)
        self._library.lib.ddpg1_values(
            self._critic, pointer(critic), len(rows), given, pointer(found), pointer(self._memory)
        )
        return found

    def update(
        self,
        learnt: Learnt,
        updates: int,
        normalization: Normalization,
        rows: Numbers,
        drawn: NDArray[np.int32],
        losses: Losses,
    ) -> tuple[NDArray[np.float64], Numbers]:
        """Change `learnt` by a minibatch for each row of `drawn` (K, minibatch), which names rows of `rows`.

        rows: see `Replay`; updates: so far. Returns means of the critic's squared error and of the value of
        what the actor does, and the last gradient.
        """
        gradient, figures = np.zeros_like(learnt.parameters), np.zeros(self._library.lib.DDPG1_FIGURES)
        made = self._library.ffi.new("struct updates *")
        made.actor, made.critic = self._actor.described[0], self._critic[0]
        made.count, made.minibatch = drawn.shape
        made.drawn = pointer(drawn)
        made.observed = observed(self._library, normalization, rows)[0]
        made.discount, made.tau, made.decay = losses.discount, losses.tau, losses.decay
        made.parameters, made.targets = pointer(learnt.parameters), pointer(learnt.targets)
        made.gradient, made.figures = pointer(gradient), pointer(figures)
        means = zip(self._networks.split(learnt.first), self._networks.split(learnt.second), strict=True)
        for adam, rate, pair in zip(made.adam, losses.rates, means, strict=True):
            set_adam(adam, pair, EPS)
            adam.rate, adam.updates = rate, updates
        self._library.lib.ddpg1_update(made, pointer(self._memory))
        return figures, gradient
