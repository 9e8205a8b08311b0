"""Actor and critic as one array of parameters, and the C that computes and updates them (`c/`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from neuroflight.training.learners.network.computed import Computed, observed, set_adam
from neuroflight.training.learners.network.library import aligned, load, pointer
from neuroflight.training.learners.network.normalization import Normalization
from neuroflight.training.learners.network.shape import Shape

Numbers = NDArray[np.floating]

EPS = 1e-5  # Adam's, as in Baselines
LAST_GAIN = 0.01  # length of the actor's last rows at first: outputs are then near 0


@dataclass(frozen=True)
class ActorCritic:
    """Two networks that share nothing, and log_std. Parameters: the actor's, log_std (M,), the critic's."""

    actor: Shape
    critic: Shape

    @property
    def motors(self) -> int:
        """Number of outputs of the actor."""
        return self.actor.widths[-1]

    @property
    def count(self) -> int:
        """Number of parameters."""
        return self.actor.count + self.motors + self.critic.count

    def split(self, parameters: Numbers) -> tuple[Numbers, Numbers, Numbers]:
        """Return views of the actor's parameters, of log_std and of the critic's parameters."""
        first, second = self._ends
        return parameters[:first], parameters[first:second], parameters[second:]

    @cached_property
    def _ends(self) -> tuple[int, int]:
        """Indices at which log_std begins, and the critic."""
        count = self.actor.count
        return count, count + self.motors

    def fresh(self, log_std: float, rng: np.random.Generator) -> NDArray[np.float32]:
        """Draw parameters of untrained networks: each unit's weights have length 1, the last LAST_GAIN."""
        parameters = np.zeros(self.count, np.float32)
        actor, deviations, critic = self.split(parameters)
        deviations[:] = log_std
        for shape, part, gain in ((self.actor, actor, LAST_GAIN), (self.critic, critic, 1.0)):
            weights = shape.split(part)[::2]
            for weight in weights:
                drawn = rng.standard_normal(weight.shape)
                length = gain if weight is weights[-1] else 1.0
                weight[:] = length * drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
        return parameters


@dataclass(frozen=True, eq=False)
class Samples:
    """A rollout: what the losses are made of."""

    observations: Numbers  # (N, n)
    actions: Numbers  # (N, M)
    log_prob: Numbers  # (N,), before the update
    advantages: Numbers  # (N,)
    returns: Numbers  # (N,), in the critic's units


@dataclass(frozen=True)
class Losses:
    """Constants of an update."""

    clip: float
    entropy: float
    rate: float  # Adam's
    minibatch: int


class Engine:
    """The networks in C; number: float32 for training, float64 for tests. All arrays are of it."""

    def __init__(self, networks: ActorCritic, number: str = "float32") -> None:
        """Load the C. Raises BuildError, one line, without a C compiler."""
        self._networks, self._number = networks, number
        self._library = library = load("ppo1", number)
        self._actor, self._critic = (
            Computed(library, shape, number) for shape in (networks.actor, networks.critic)
        )
        size = library.lib.ppo1_memory(self._actor.described, self._critic.described)
        self._memory = aligned(size, number)

    def acting(
        self, parameters: Numbers, normalization: Normalization, count: int
    ) -> Callable[[Numbers], Numbers]:
        """Return a function of the actor with these parameters, see `Computed.acting`."""
        return self._actor.acting(self._networks.split(parameters)[0], normalization, count)

    def outputs(self, parameters: Numbers, normalization: Normalization, observations: Numbers) -> Numbers:
        """Compute the actor's outputs (N, M) for observations (N, n)."""
        return self._actor.outputs(self._networks.split(parameters)[0], normalization, observations)

    def values(self, parameters: Numbers, normalization: Normalization, observations: Numbers) -> Numbers:
        """Compute the critic's values (N,), in its units."""
        critic = self._networks.split(parameters)[2]
        return self._critic.outputs(critic, normalization, observations)[:, 0]

    def log_prob(
        self, parameters: Numbers, normalization: Normalization, observations: Numbers, actions: Numbers
    ) -> Numbers:
        """Compute the log-likelihood (N,) of the actions (N, M), without its constant."""
        means = self.outputs(parameters, normalization, observations)
        found = np.empty(len(actions), self._number)
        log_std = self._networks.split(parameters)[1]
        arrays = map(pointer, (actions, means, log_std, found))
        self._library.lib.ppo1_log_prob(len(actions), self._networks.motors, *arrays)
        return found

    def epoch(
        self,
        parameters: Numbers,
        adam: tuple[Numbers, Numbers],
        updates: int,
        normalization: Normalization,
        samples: Samples,
        order: NDArray[np.int32],
        losses: Losses,
    ) -> tuple[NDArray[np.float64], Numbers]:
        """Change `parameters` and Adam's two means in place, by each whole minibatch of `order`.

        Samples that are left over count nothing, as in Baselines. updates: Adam's so far. Returns means of
        the surrogate, of the values' squared error and of the share of clipped ratios, and the last gradient.
        """
        count = len(order) - len(order) % losses.minibatch
        gradient, figures = np.zeros_like(parameters), np.zeros(self._library.lib.PPO1_FIGURES)
        epoch = self._library.ffi.new("struct epoch *")
        epoch.actor, epoch.critic = self._actor.described[0], self._critic.described[0]
        epoch.count, epoch.minibatch, epoch.order = count, losses.minibatch, pointer(order)
        epoch.observed = observed(self._library, normalization, samples.observations)[0]
        for name in ("actions", "log_prob", "advantages", "returns"):
            setattr(epoch, name, pointer(getattr(samples, name)))
        epoch.clip, epoch.entropy = losses.clip, losses.entropy
        set_adam(epoch.adam, adam, EPS)
        epoch.adam.rate, epoch.adam.updates = losses.rate, updates
        epoch.parameters, epoch.gradient, epoch.figures = map(pointer, (parameters, gradient, figures))
        self._library.lib.ppo1_epoch(epoch, pointer(self._memory))
        return figures, gradient
