"""Updates in C against torch's gradients and Adam, on the same minibatches."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from neuroflight.training.config.training_config import OutputMap
from neuroflight.training.learners.network.normalization import Normalization
from neuroflight.training.learners.network.shape import Shape
from neuroflight.training.learners.ppo1.update import ActorCritic, Engine, Losses, Samples

COUNT, INPUTS, MOTORS = 50, 7, 4
LOSSES = Losses(clip=0.2, entropy=0.01, rate=1e-2, minibatch=20)
MODULES = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}


def networks_of(activation: str, hidden: tuple[int, ...] = (9, 6)) -> ActorCritic:
    return ActorCritic(
        Shape((INPUTS, *hidden, MOTORS), activation, OutputMap()),
        Shape((INPUTS, *hidden, 1), activation, OutputMap()),
    )


class Case:
    """A rollout of random samples, and networks that are no longer fresh."""

    def __init__(self, activation: str, number: str) -> None:
        rng = np.random.default_rng(5)
        self.networks, self.number = networks_of(activation), number
        self.engine = Engine(self.networks, number)
        self.parameters = self.drawn(rng, self.networks.count) * self.kind(0.5)
        self.normalization = Normalization(
            self.drawn(rng, INPUTS), np.abs(self.drawn(rng, INPUTS)) + self.kind(0.3)
        )
        observations, actions = self.drawn(rng, COUNT, INPUTS), self.drawn(rng, COUNT, MOTORS)
        log_prob = self.engine.log_prob(self.parameters, self.normalization, observations, actions)
        self.samples = Samples(
            observations,
            actions,
            log_prob + self.kind(0.3) * self.drawn(rng, COUNT),  # some ratios lie beyond the clip range
            self.drawn(rng, COUNT),
            self.drawn(rng, COUNT),
        )
        self.order = rng.permutation(COUNT).astype(np.int32)

    def kind(self, value: float) -> Any:
        return np.dtype(self.number).type(value)

    def drawn(self, rng: np.random.Generator, *shape: int) -> NDArray[Any]:
        return rng.standard_normal(shape).astype(self.number)

    def in_c(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.float64]]:
        """Parameters after an epoch, the last gradient, and the figures."""
        parameters = self.parameters.copy()
        adam = np.zeros_like(parameters), np.zeros_like(parameters)
        figures, gradient = self.engine.epoch(
            parameters, adam, 0, self.normalization, self.samples, self.order, LOSSES
        )
        return parameters, gradient, figures

    def in_torch(self, activation: str) -> tuple[NDArray[Any], NDArray[Any], list[float]]:
        """Likewise, in double precision."""
        torch.manual_seed(0)
        actor, log_std, critic = (
            [torch.tensor(part, dtype=torch.float64, requires_grad=True) for part in parts]
            for parts in self.parts()
        )
        every = [*actor, *log_std, *critic]
        adam = torch.optim.Adam(every, lr=LOSSES.rate, eps=1e-5)
        samples = {name: torch.from_numpy(value).double() for name, value in vars(self.samples).items()}
        mean, factor = (torch.from_numpy(part).double() for part in vars(self.normalization).values())
        observed = (samples["observations"] - mean) * factor
        surrogates, errors = [], []
        size = LOSSES.minibatch
        for batch in np.split(self.order[: COUNT // size * size], COUNT // size):
            means, values = (
                computed(actor, observed[batch], activation),
                computed(critic, observed[batch], activation),
            )
            away = (samples["actions"][batch] - means) / log_std[0].exp()
            log_prob = -(0.5 * away.square() + log_std[0]).sum(dim=1)
            ratio = (log_prob - samples["log_prob"][batch]).exp()
            advantage = samples["advantages"][batch]
            lesser = torch.min(
                advantage * ratio, advantage * ratio.clamp(1.0 - LOSSES.clip, 1.0 + LOSSES.clip)
            ).mean()
            error = (values[:, 0] - samples["returns"][batch]).square().mean()
            loss = error - lesser - LOSSES.entropy * log_std[0].sum()
            adam.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            adam.step()
            surrogates.append(lesser.item())
            errors.append(error.item())
        flat = torch.cat([part.detach().ravel() for part in every]).numpy()
        slopes = torch.cat([part.grad.ravel() for part in every if part.grad is not None]).numpy()
        return flat, slopes, [float(np.mean(surrogates)), float(np.mean(errors))]

    def parts(self) -> tuple[list[NDArray[Any]], list[NDArray[Any]], list[NDArray[Any]]]:
        actor, log_std, critic = self.networks.split(self.parameters)
        return self.networks.actor.split(actor), [log_std], self.networks.critic.split(critic)


def computed(parts: list[torch.Tensor], x: torch.Tensor, activation: str) -> torch.Tensor:
    for weight, bias in zip(parts[:-2:2], parts[1:-2:2], strict=True):
        x = MODULES[activation]()(x @ weight.T + bias)
    return x @ parts[-2].T + parts[-1]


@pytest.mark.parametrize("activation", MODULES)
@pytest.mark.parametrize(("number", "near"), [("float64", 1e-12), ("float32", 2e-5)])
def test_an_epoch_is_torchs_when_the_minibatches_are_the_same(
    activation: str, number: str, near: float
) -> None:
    case = Case(activation, number)
    parameters, gradient, figures = case.in_c()
    expected, slopes, means = case.in_torch(activation)
    assert np.abs(expected - case.parameters).max() > 0.01
    np.testing.assert_allclose(gradient, slopes, rtol=0, atol=10 * near)
    np.testing.assert_allclose(parameters, expected, rtol=0, atol=near)
    np.testing.assert_allclose(figures[:2], means, rtol=0, atol=10 * near)
    assert 0.1 < figures[2] < 0.9


def test_outputs_are_those_of_the_network_when_aircraft_fill_no_lanes() -> None:
    case = Case("tanh", "float64")
    rows = case.samples.observations[:21]
    found = case.engine.outputs(case.parameters, case.normalization, rows)
    actor = [torch.from_numpy(part) for part in case.parts()[0]]
    normalized = torch.from_numpy((rows - case.normalization.mean) * case.normalization.factor)
    np.testing.assert_allclose(found, computed(actor, normalized, "tanh").numpy(), rtol=0, atol=1e-12)


def test_samples_that_fill_no_minibatch_count_nothing() -> None:
    case = Case("tanh", "float32")
    whole, _, _ = case.in_c()
    samples = replace(case.samples, advantages=case.samples.advantages.copy())
    samples.advantages[case.order[40:]] = 1e6
    case.samples = samples
    np.testing.assert_array_equal(case.in_c()[0], whole)
