"""Updates in C against torch's gradients and Adam, on the same minibatches."""

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from neuroflight.training.learners.ddpg1.update import ActorCritic, Engine, Learnt, Losses
from neuroflight.training.learners.network.normalization import Normalization

ROWS, INPUTS, MOTORS = 50, 7, 4
UPDATES, MINIBATCH = 3, 20  # which fills no whole number of lanes
LOSSES = Losses(discount=0.9, tau=0.1, decay=0.05, rates=(3e-3, 1e-2))
MODULES = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
SHAPES = {"tanh": (9, 6), "relu": (10, 5, 6)}


class Case:
    """A buffer of random rows, and networks that are no longer fresh."""

    def __init__(self, activation: str, number: str) -> None:
        rng = np.random.default_rng(5)
        self.activation, self.number = activation, number
        self.networks = ActorCritic(INPUTS, SHAPES[activation], MOTORS, activation)
        self.engine = Engine(self.networks, number)
        count = sum(self.networks.counts)
        parameters = self.drawn(rng, count) * self.kind(0.5)
        self.learnt = Learnt(
            parameters,
            parameters + self.kind(0.1) * self.drawn(rng, count),
            self.kind(0.1) * self.drawn(rng, count),
            self.kind(0.1) * np.square(self.drawn(rng, count)),
        )
        self.normalization = Normalization(
            self.drawn(rng, INPUTS), np.abs(self.drawn(rng, INPUTS)) + self.kind(0.3)
        )
        self.rows = self.drawn(rng, ROWS, 2 * INPUTS + MOTORS + 1)
        self.order = rng.integers(ROWS, size=(UPDATES, MINIBATCH), dtype=np.int32)

    def kind(self, value: float) -> Any:
        return np.dtype(self.number).type(value)

    def drawn(self, rng: np.random.Generator, *shape: int) -> NDArray[Any]:
        return rng.standard_normal(shape).astype(self.number)

    def in_c(self, before: int = 4) -> tuple[Learnt, list[float]]:
        """What is learnt by the updates, with some before them, and the figures."""
        learnt = Learnt(*(array.copy() for array in vars(self.learnt).values()))
        figures, _ = self.engine.update(learnt, before, self.normalization, self.rows, self.order, LOSSES)
        return learnt, figures.tolist()

    def in_torch(self, before: int = 4) -> tuple[Learnt, list[float]]:
        """Likewise, in double precision."""
        kept = {name: self.parts(array) for name, array in vars(self.learnt).items()}
        actor, critic = kept["parameters"]
        target_actor, target_critic = kept["targets"]
        optimizers = []
        for part, rate in enumerate(LOSSES.rates):
            optimizer = torch.optim.Adam(kept["parameters"][part], lr=rate, eps=1e-8)
            for index, parameter in enumerate(kept["parameters"][part]):
                parameter.requires_grad_()
                optimizer.state[parameter] = {
                    "step": torch.tensor(float(before)),
                    "exp_avg": kept["first"][part][index],
                    "exp_avg_sq": kept["second"][part][index],
                }
            optimizers.append(optimizer)
        mean, factor = (torch.from_numpy(part).double() for part in vars(self.normalization).values())
        figures = []
        for batch in self.order:
            rows = torch.from_numpy(self.rows[batch]).double()
            observed, actions, rewards, following = torch.split(rows, [INPUTS, MOTORS, 1, INPUTS], dim=1)
            observed, following = (observed - mean) * factor, (following - mean) * factor
            with torch.no_grad():
                acted = self.acted(target_actor, following)
                wanted = rewards + LOSSES.discount * self.judged(target_critic, following, acted)
            loss = (self.judged(critic, observed, actions) - wanted).square().mean()
            decay = sum(0.5 * weight.square().sum() for weight in critic[:-2:2])
            value = self.judged(critic, observed, self.acted(actor, observed)).mean()
            for optimizer in optimizers:
                optimizer.zero_grad()
            (-value).backward(inputs=actor)  # type: ignore[no-untyped-call]
            (loss + LOSSES.decay * decay).backward(inputs=critic)  # type: ignore[no-untyped-call]
            for optimizer in optimizers:
                optimizer.step()
            with torch.no_grad():
                for target, now in zip([*target_actor, *target_critic], [*actor, *critic], strict=True):
                    target += LOSSES.tau * (now - target)
            figures.append([loss.item(), value.item()])
        flat = (torch.cat([p.detach().ravel() for part in kept[name] for p in part]) for name in kept)
        return Learnt(*(array.numpy() for array in flat)), np.mean(figures, axis=0).tolist()

    def parts(self, array: NDArray[Any]) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        actor, critic = self.networks.parts(array)
        return (
            [torch.tensor(part, dtype=torch.float64) for part in actor],
            [torch.tensor(part, dtype=torch.float64) for part in critic],
        )

    def acted(self, parts: list[torch.Tensor], x: torch.Tensor) -> torch.Tensor:
        return self.computed(parts, x).tanh()

    def judged(self, parts: list[torch.Tensor], x: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        first = MODULES[self.activation]()(x @ parts[0].T + parts[1])
        return self.computed(parts[2:], torch.cat([first, actions], dim=1))

    def computed(self, parts: list[torch.Tensor], x: torch.Tensor) -> torch.Tensor:
        for weight, bias in zip(parts[:-2:2], parts[1:-2:2], strict=True):
            x = MODULES[self.activation]()(x @ weight.T + bias)
        return x @ parts[-2].T + parts[-1]


@pytest.mark.parametrize("activation", MODULES)
@pytest.mark.parametrize(("number", "near"), [("float64", 1e-12), ("float32", 3e-5)])
def test_updates_are_torchs_when_the_minibatches_are_the_same(
    activation: str, number: str, near: float
) -> None:
    case = Case(activation, number)
    found, figures = case.in_c()
    expected, means = case.in_torch()
    for name, before in vars(case.learnt).items():
        wanted = getattr(expected, name)
        for part in case.networks.split(wanted - before):
            assert np.abs(part).max() > 1e-3, name  # all are moved, of actor and critic
        np.testing.assert_allclose(getattr(found, name), wanted, rtol=0, atol=near, err_msg=name)
    np.testing.assert_allclose(figures, means, rtol=10 * near)


def test_outputs_and_values_are_those_of_the_networks_when_aircraft_fill_no_lanes() -> None:
    case = Case("relu", "float64")
    normalization, parameters, rows = case.normalization, case.learnt.parameters, case.rows[:21]
    observations, actions = rows[:, :INPUTS].copy(), rows[:, INPUTS : INPUTS + MOTORS].copy()
    normalized = torch.from_numpy((observations - normalization.mean) * normalization.factor)
    actor, critic = case.parts(parameters)
    outputs = case.engine.outputs(parameters, normalization, observations)
    np.testing.assert_allclose(outputs, case.acted(actor, normalized).numpy(), rtol=0, atol=1e-12)
    values = case.engine.values(parameters, normalization, observations, actions)
    expected = case.judged(critic, normalized, torch.from_numpy(actions)).numpy()[:, 0]
    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("activation", MODULES)
def test_each_aircraft_flies_its_own_actor(activation: str) -> None:
    case = Case(activation, "float64")
    count, rng = 5, np.random.default_rng(6)
    actors = case.drawn(rng, case.networks.counts[0], count)
    observations = case.drawn(rng, count, INPUTS)
    found = case.engine.acting(actors, case.normalization)(observations)
    for who in range(count):
        parameters = case.learnt.parameters.copy()
        case.networks.split(parameters)[0][:] = actors[:, who]
        alone = case.engine.outputs(parameters, case.normalization, observations[who : who + 1])[0]
        np.testing.assert_allclose(found[who], alone, rtol=0, atol=1e-12)
    assert np.ptp(found, axis=0).min() > 0.1


def test_fresh_networks_are_drawn_as_in_baselines() -> None:
    networks = ActorCritic(7, (64, 64), 4, "relu")
    parameters = networks.fresh(np.random.default_rng(1))
    shapes = [[part.shape for part in parts[::2]] for parts in networks.parts(parameters)]
    assert shapes == [[(64, 7), (64, 64), (4, 64)], [(64, 7), (64, 68), (1, 64)]]
    for parts in networks.parts(parameters):
        assert all((bias == 0.0).all() for bias in parts[1::2])
        assert np.abs(parts[-2]).max() == pytest.approx(3e-3, rel=0.1)
        for weight in parts[:-2:2]:
            assert np.abs(weight).max() == pytest.approx(np.sqrt(6.0 / sum(weight.shape)), rel=0.05)
