"""Recurrent models whose state is an input and an output, against onnxruntime on the model itself."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.interpreter import replay
from neuroflight.toolchain.policy.import_onnx import PolicyClaims, imported_model
from neuroflight.toolchain.policy.model import parse_policy
from neuroflight.toolchain.verification.original import compare
from tests.sampling import sampled

Float32 = NDArray[np.float32]
CLAIMS = PolicyClaims("rate_error,rate_error_delta", 1000, "[]", "nf1", "ab" * 32, 4)
INPUTS, UNITS, ACTIONS, STEPS = 6, 5, 4, 300
TOLERANCE = 7e-7  # of an action; the state is carried over all steps


class Actor(nn.Module):
    """A cell between an encoder and a head; `shapes` are those of its states."""

    shapes: tuple[tuple[int, ...], ...] = ((1, UNITS),)
    given: int | None = None  # number of states with a new value, if not all

    def __init__(self) -> None:
        super().__init__()
        self.head = nn.Linear(UNITS, ACTIONS)

    def action(self, hidden: Tensor) -> Tensor:
        return torch.sigmoid(self.head(hidden.reshape(1, UNITS)))


class Sequence_(Actor):  # noqa: N801
    """nn.GRU, nn.LSTM or nn.RNN of one step."""

    def __init__(self, kind: type[nn.RNNBase], layers: int = 1, *, batch_first: bool = False) -> None:
        super().__init__()
        self.first = batch_first
        options = {"num_layers": layers, "batch_first": batch_first}
        self.cell = kind(INPUTS, UNITS, **options)  # type: ignore[arg-type, misc]
        self.shapes = ((layers, 1, UNITS),) * (2 if kind is nn.LSTM else 1)

    def forward(self, observation: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        given: Any = state if len(state) > 1 else state[0]
        hidden, after = self.cell(observation.unsqueeze(1 if self.first else 0), given)
        return self.action(hidden), *(after if isinstance(after, tuple) else (after,))


class Step(Actor):
    """nn.GRUCell, nn.LSTMCell or nn.RNNCell, behind an encoder, with a way around it."""

    def __init__(self, kind: type[nn.GRUCell] | type[nn.LSTMCell] | type[nn.RNNCell]) -> None:
        super().__init__()
        self.encoder, self.norm = nn.Linear(INPUTS, 7), nn.LayerNorm(7)
        self.cell, self.around = kind(7, UNITS), nn.Linear(INPUTS, UNITS)
        self.shapes = ((1, UNITS),) * (2 if kind is nn.LSTMCell else 1)

    def forward(self, observation: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        given: Any = state if len(state) > 1 else state[0]
        after = self.cell(self.norm(torch.tanh(self.encoder(observation))), given)
        after = after if isinstance(after, tuple) else (after,)
        return self.action(after[0] + torch.relu(self.around(observation))), *after


class Packed(Actor):
    """Two LSTM cells whose four states are one tensor, in an order of its own."""

    shapes = ((1, 4 * UNITS),)

    def __init__(self) -> None:
        super().__init__()
        self.low, self.high = nn.LSTMCell(INPUTS, UNITS), nn.LSTMCell(UNITS, UNITS)

    def forward(self, observation: Tensor, state: Tensor) -> tuple[Tensor, ...]:
        c1, h2, h1, c2 = state.chunk(4, dim=1)
        h1, c1 = self.low(observation, (h1, c1))
        h2, c2 = self.high(h1, (h2, c2))
        return self.action(h2), torch.cat([c1, h2, h1, c2], dim=1)


class Matrices(Actor):
    """A GRU written out, in one of several forms."""

    def __init__(self, form: str) -> None:
        super().__init__()
        self.form = form
        self.gates = nn.ModuleList(
            [nn.Linear(INPUTS, UNITS), nn.Linear(INPUTS, UNITS), nn.Linear(INPUTS, UNITS)]
        )
        self.kept = nn.ModuleList([nn.Linear(UNITS, UNITS, bias=False) for _ in range(3)])
        self.joint = nn.Linear(INPUTS + UNITS, 2 * UNITS)

    def forward(self, observation: Tensor, state: Tensor) -> tuple[Tensor, ...]:
        update, reset, new = (gate(observation) for gate in self.gates)
        if self.form == "joint":
            update, reset = torch.sigmoid(self.joint(torch.cat([observation, state], 1))).chunk(2, 1)
        else:
            update, reset = (
                torch.sigmoid(update + self.kept[0](state)),
                torch.sigmoid(self.kept[1](state) + reset),
            )
        if self.form == "before":
            new = torch.tanh(new + self.kept[2](reset * state))
        else:
            new = torch.tanh(new + reset * (self.kept[2](state) + 0.1))
        if self.form == "flipped":
            after = (1 - update) * state + update * new
        else:
            after = (1 - update) * new + update * state
        return self.action(after), after


class WithCritic(Actor):
    """An LSTM beside a critic's, as of sb3-contrib's RecurrentPPO: the critic's states are of no use."""

    shapes = ((1, 1, UNITS),) * 4

    def __init__(self) -> None:
        super().__init__()
        self.actor, self.critic = nn.LSTM(INPUTS, UNITS), nn.LSTM(INPUTS, UNITS)
        self.value = nn.Linear(UNITS, 1)

    def forward(
        self, observation: Tensor, h: Tensor, c: Tensor, hv: Tensor, cv: Tensor
    ) -> tuple[Tensor, ...]:
        hidden, (h, c) = self.actor(observation[None], (h, c))
        valued, (hv, cv) = self.critic(observation[None], (hv, cv))
        return self.action(hidden), h, c, hv, cv, self.value(valued[0])


class Restarts(Actor):
    """An LSTM whose states an input of the trainer's clears, as of sb3-contrib."""

    shapes, given = ((1, UNITS), (1, UNITS), (1, 1)), 2

    def __init__(self) -> None:
        super().__init__()
        self.cell = nn.LSTMCell(INPUTS, UNITS)

    def forward(self, observation: Tensor, h: Tensor, c: Tensor, starts: Tensor) -> tuple[Tensor, ...]:
        h, c = self.cell(observation, ((1 - starts) * h, (1 - starts) * c))
        return self.action(h), h, c


class Filter(Actor):
    """A low-pass, which is no cell."""

    shapes = ((1, INPUTS),)

    def forward(self, observation: Tensor, state: Tensor) -> tuple[Tensor, ...]:
        state = 0.9 * state + 0.1 * observation
        return self.action(state[:, :UNITS]), state


class Reads(Actor):
    """An LSTM's action that is made of its cell state, or of the state before."""

    shapes = ((1, UNITS),) * 2

    def __init__(self, what: str) -> None:
        super().__init__()
        self.what, self.cell = what, nn.LSTMCell(INPUTS, UNITS)

    def forward(self, observation: Tensor, h: Tensor, c: Tensor) -> tuple[Tensor, ...]:
        after, memory = self.cell(observation, (h, c))
        return self.action(after + (memory if self.what == "memory" else h)), after, memory


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """Silence the exporters, which print and log a lot."""
    logging.disable(logging.CRITICAL)
    torch.manual_seed(0)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        yield
    logging.disable(logging.NOTSET)


def export(actor: Actor, *, dynamo: bool = False, outputs: Sequence[str] = ()) -> bytes:
    """Export the model with torch."""
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.mul_(2)
    states = [f"state_{number}" for number in range(len(actor.shapes))]
    names: dict[str, Any] = {
        "input_names": ["obs", *states],
        "output_names": ["actions", *(f"next_{name}" for name in states[: actor.given]), *outputs],
        "dynamo": dynamo,
        "opset_version": 18 if dynamo else 11,
    }
    example = (torch.randn(1, INPUTS), *(torch.zeros(shape) for shape in actor.shapes))
    if dynamo:
        pytest.importorskip("onnxscript", reason="torch's newer exporter needs onnxscript")
        program = torch.onnx.export(actor.eval(), example, verbose=False, **names)
        assert program is not None
        return bytes(program.model_proto.SerializeToString())
    file: Any = io.BytesIO()
    torch.onnx.export(actor.eval(), example, file, **names)
    return bytes(file.getvalue())


def by_onnxruntime(data: bytes, observation: Float32) -> Float32:
    """Run the model itself; its states are carried by hand, from zero."""
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    state = {i.name: np.zeros(i.shape, np.float32) for i in session.get_inputs() if i.name != "obs"}
    names, actions = ["actions", *(f"next_{name}" for name in state)], []
    for row in observation:
        action, *after = session.run(names, {"obs": row[None], **state})
        state = dict(zip(state, after, strict=True))
        actions.append(action[0])
    return np.array(actions)


ACTORS: dict[str, tuple[Callable[[], Actor], str]] = {
    "GRU": (lambda: Sequence_(nn.GRU), "a GRU of 5 units"),
    "GRU of two layers": (lambda: Sequence_(nn.GRU, 2, batch_first=True), "a GRU of 5 units"),
    "LSTM": (lambda: Sequence_(nn.LSTM, batch_first=True), "an LSTM of 5 units"),
    "LSTM of two layers": (lambda: Sequence_(nn.LSTM, 2), "an LSTM of 5 units"),
    "RNN": (lambda: Sequence_(nn.RNN), "an RNN of 5 units, as a GRU whose gates stand still"),
    "GRUCell": (lambda: Step(nn.GRUCell), "a GRU of 5 units"),
    "LSTMCell": (lambda: Step(nn.LSTMCell), "an LSTM of 5 units"),
    "RNNCell": (lambda: Step(nn.RNNCell), "an RNN of 5 units"),
    "packed": (Packed, "an LSTM of 5 units"),
    "by gates": (lambda: Matrices("gates"), "a GRU of 5 units"),
    "joint": (lambda: Matrices("joint"), "a GRU of 5 units"),
    "flipped": (lambda: Matrices("flipped"), "a GRU of 5 units"),
    "beside a critic": (WithCritic, "an LSTM of 5 units"),
}


# Of two layers or one, as an operator, a cell or its matrices: the others differ in one of these.
ORDINARY = ("GRU of two layers", "LSTM of two layers", "RNN", "LSTMCell", "packed", "by gates", "joint")


@pytest.mark.parametrize("dynamo", sampled([False, True], False))
@pytest.mark.parametrize("name", sampled(ACTORS, *ORDINARY))
def test_state_is_carried_as_onnxruntime_carries_it_when_it_is_input_and_output(
    name: str, dynamo: bool
) -> None:
    make, words = ACTORS[name]
    data = export(make(), dynamo=dynamo, outputs=["value"] if name == "beside a critic" else [])
    imported, changes = imported_model(data, CLAIMS, clip=False, output="actions")
    assert any(
        f"a state that the policy carries, from zero at its start: {words}" in line for line in changes
    )
    dropped = [line for line in changes if line.startswith("dropped the input")]
    assert len(dropped) == (2 if name == "beside a critic" else 0)
    network = parse_policy(imported).network
    assert network.inputs == INPUTS
    observation = np.random.default_rng(0).normal(size=(STEPS, INPUTS)).astype(np.float32)
    expected = by_onnxruntime(data, observation)
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(replay(network, observation), expected, rtol=0, atol=TOLERANCE)


GIVEN = (
    "the input 'state_0', which the output 'next_state_0' gives anew, is no state of a GRU, LSTM or tanh RNN"
)
REFUSED: dict[str, Callable[[], Actor]] = {
    f"{GIVEN}: its state is multiplied before its matrix, as by a GRU": lambda: Matrices("before"),
    f"{GIVEN}: its new value is not that of a GRU, LSTM or tanh RNN; export the memory as": Filter,
    "the output 'actions' depends on the state 'state_0' beside the cell": lambda: Reads("before"),
    "the output 'actions' depends on the state": lambda: Reads("memory"),
}


@pytest.mark.parametrize("words", REFUSED)
def test_model_is_refused_by_the_names_of_its_state_when_no_cell_carries_it(words: str) -> None:
    with pytest.raises(PolicyError) as caught:
        imported_model(export(REFUSED[words]()), CLAIMS, clip=False)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_state_is_carried_when_the_input_that_clears_it_is_a_constant() -> None:
    data = export(Restarts())
    with pytest.raises(PolicyError, match="or set 'state_2' with --constant NAME=VALUE"):
        imported_model(data, CLAIMS, clip=False)
    imported, changes = imported_model(data, CLAIMS, clip=False, constants={"state_2": 0.0}, prove=compare)
    assert changes[0] == "took 0 for the input 'state_2' throughout"
    assert "300 steps, its state carried: at most" in changes[-1]
    assert parse_policy(imported).network.text == "6-lstm5-4 sigmoid"


def test_batch_is_taken_from_observation_and_state_when_it_is_fixed() -> None:
    model = onnx.load_from_string(export(Sequence_(nn.GRU, 2)))
    for value in (*model.graph.input, *model.graph.output):
        axis = 1 if "state" in value.name else 0
        value.type.tensor_type.shape.dim[axis].dim_value = 3
    _, changes = imported_model(model.SerializeToString(), CLAIMS, clip=False)
    fixed = [line for line in changes if line.startswith("fixed")]
    assert fixed == ["fixed axis 0 of 'obs' to 1 (was 3)", "fixed axis 1 of 'state_0' to 1 (was 3)"]


def test_search_ends_when_a_graph_has_no_end_of_branches() -> None:
    """Double x + x forty times, so that 2^40 paths lead back to the state."""
    data = onnx.load_from_string(export(Filter()))
    graph, value = data.graph, "next_state_0"
    for node in graph.node:
        node.output[:] = ["doubled_0" if name == value else name for name in node.output]
        node.input[:] = ["doubled_0" if name == value else name for name in node.input]
    for number in range(40):
        name = f"doubled_{number + 1}" if number < 39 else value
        graph.node.append(onnx.helper.make_node("Add", [f"doubled_{number}"] * 2, [name]))
    with pytest.raises(PolicyError, match="more branches than a cell's"):
        imported_model(data.SerializeToString(), CLAIMS, clip=False, output="actions")
