"""Reads another trainer's model into the network of one observation."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import onnx

from neuroflight.toolchain.contract import POLICY_INPUT, POLICY_OUTPUT
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.network import OBSERVATION, Network, Node, sweep
from neuroflight.toolchain.ir.operations import Concat, Lstm, Recurrent, Slice
from neuroflight.toolchain.policy.foreign_ends import Ends, computed, find_action, find_states, input_shapes
from neuroflight.toolchain.policy.foreign_model import keep_outputs, listed
from neuroflight.toolchain.reader.cells import Cell, find_cells
from neuroflight.toolchain.reader.graph import read_nodes
from neuroflight.toolchain.reader.recurrent import GATE_OPEN
from neuroflight.toolchain.reader.values import (
    MULTIPLY_ADDS_MAX,
    Builder,
    RowValue,
    Unread,
    Value,
    label,
    printable,
    shown,
)

CRITICS = 8  # times a policy's size limit: all outputs are read before the action is known


@dataclass(frozen=True, eq=False)
class Adopted:
    """The network read from a foreign model, and the roles of the model's inputs and outputs."""

    network: Network  # from observation to action, without limits
    changes: tuple[str, ...]  # descriptions
    action: str  # the output
    inputs: Mapping[str, tuple[int, ...]]  # of the observation, in its order, and their shapes
    states: Mapping[str, str]  # inputs that the policy carries, and the outputs that give them anew
    forgetful: bool  # whether a cell inside starts from zero at every run of the model


@dataclass(frozen=True)
class _Reading:
    """The nodes of a model. Value 0 is the concatenation of all inputs; each input is a slice of it."""

    build: Builder
    values: Mapping[str, Value]
    inputs: Mapping[str, RowValue]  # of floats, by name

    @property
    def names(self) -> dict[int, str]:
        """Names of the inputs by the number of their value."""
        return {row.number: name for name, row in self.inputs.items()}


@dataclass(frozen=True)
class _Action:
    """The action and what it is computed from."""

    row: RowValue
    cells: tuple[Cell, ...]  # that it needs
    failed: Mapping[str, str]  # states that no cell carries, and why
    needed: frozenset[int]  # numbers of the values that it is computed from, itself included


def read_foreign(model: onnx.ModelProto, ends: Ends) -> Adopted:
    """Read a checked model and drop from it what the action does not need. Raises PolicyError."""
    shapes, fixed = input_shapes(model, ends)
    reading = _read(model, shapes, CRITICS * MULTIPLY_ADDS_MAX)
    name = find_action(model, reading.values, ends)
    states = find_states(model, reading.values, reading.inputs, name)
    with contextlib.suppress(PolicyError):  # the second reading raises it again if it matters
        states = _needed_states(reading, _action(reading, name, states), states)
    outputs, nodes = keep_outputs(model.graph, {name, *states.values()})
    dropped = f"kept the output {shown(name)}, dropped {outputs} other(s) and {nodes} node(s)"
    changes = [*([dropped] if outputs or nodes else []), *fixed]
    reading = _read(model, shapes, MULTIPLY_ADDS_MAX)
    try:
        action = _action(reading, name, states)
    except PolicyError as error:
        raise _of_one_observation(error, fixed) from error
    changes += _left_out(model, reading)
    changes += _told(reading, action, states)
    names, more = _observed(reading, action, name)
    changes += more
    _check_failed(reading, names, action, states, ends)
    names, more = _ordered(reading, names, ends)
    changes += more
    if name != POLICY_OUTPUT:
        changes.append(f"renamed the output {shown(name)} to {POLICY_OUTPUT!r}")
    carried = {reading.names[number] for cell in action.cells for number in cell.states}
    return Adopted(
        network=_assembled(reading, names, action),
        changes=tuple(changes),
        action=name,
        inputs={name: shapes[name] for name in names},
        states={name: states[name] for name in reading.inputs if name in carried},
        forgetful=bool(_forgetful(reading, action)),
    )


def _action(reading: _Reading, name: str, states: Mapping[str, str]) -> _Action:
    """Return the action `name` with its cells and values. Raises PolicyError where it could not be read."""
    row, nodes = computed(reading.values, name), reading.build.nodes
    after = {reading.inputs[s].number: computed(reading.values, states[s]).number for s in states}
    found, failed = find_cells(nodes, reading.build.widths, set(reading.names), after)
    needed = _needed(nodes, row.number, found)
    reasons = {reading.names[number]: why for number, why in failed.items() if number in needed}
    return _Action(row, tuple(cell for cell in found if cell.result in needed), reasons, frozenset(needed))


def _needed_states(reading: _Reading, action: _Action, states: Mapping[str, str]) -> dict[str, str]:
    """Return those of `states` that the action depends on, without those that only a critic uses."""
    carried = {reading.names[number] for cell in action.cells for number in cell.states}
    return {name: after for name, after in states.items() if name in carried or name in action.failed}


def _left_out(model: onnx.ModelProto, reading: _Reading) -> list[str]:
    """Describe the nodes that could not be read and that the action does not need."""
    nodes = []
    for node in model.graph.node:
        values = [reading.values.get(name) for name in node.output]
        if any(isinstance(value, Unread) and value.error is not None for value in values):
            nodes.append(label(node))
    more = f" and {len(nodes) - 1} more" if len(nodes) > 1 else ""
    return [f"left out {nodes[0]}{more}: nothing but a shape is read of what they compute"] if nodes else []


def _of_one_observation(error: PolicyError, fixed: Sequence[str]) -> PolicyError:
    """Return the error, with a hint where the model was exported for more than one observation."""
    batches = [line for line in fixed if line[-2].isdigit()]
    if not batches:
        return error
    return PolicyError(f"{error} ({'; '.join(batches)}: export it for one observation, [1, n])")


def _read(model: onnx.ModelProto, shapes: dict[str, tuple[int, ...]], multiply_adds_max: int) -> _Reading:
    """Read the nodes. Value 0 is the concatenation of all inputs; each input is a slice of it."""
    build = Builder(sum(map(math.prod, shapes.values())), multiply_adds_max=multiply_adds_max)
    inputs, start = dict[str, RowValue](), 0
    for name, shape in shapes.items():
        width = math.prod(shape)
        build.nodes.append(Node(Slice(start, width), (OBSERVATION,), printable(name)))
        build.widths.append(width)
        inputs[name] = RowValue(len(build.nodes), shape)
        start += width
    values: dict[str, Value] = dict(inputs)
    given = {tensor.name for tensor in model.graph.initializer}
    for value in model.graph.input:
        if value.name not in inputs and value.name not in given:
            error = PolicyError(
                f"the input {shown(value.name)} is read and holds no floats, expected float32 [1, n]; set it "
                "with --constant NAME=VALUE, or export without it"
            )
            values[value.name] = Unread("an input", error)
    return _Reading(build, read_nodes(model, build, values), inputs)


def _told(reading: _Reading, action: _Action, states: Mapping[str, str]) -> list[str]:
    """Describe each cell in a line."""
    lines = []
    for cell in action.cells:
        names = dict.fromkeys(reading.names[number] for number in cell.states)
        pairs = " and ".join(f"{shown(name)} -> {shown(states[name])}" for name in names)
        lines.append(
            f"{pairs}: a state that the policy carries, from zero at its start: {_kind(cell.operation)}"
        )
    for node in _forgetful(reading, action):
        assert isinstance(node.operation, Recurrent)
        kind = _kind(node.operation)
        lines.append(f"node {shown(node.name)}: the policy carries its state, from zero at its start: {kind}")
    return lines


def _forgetful(reading: _Reading, action: _Action) -> list[Node]:
    """Return the cells inside the model whose state starts from zero each time the model runs."""
    nodes = (reading.build.nodes[number - 1] for number in sorted(action.needed))
    return [node for node in nodes if isinstance(node.operation, Recurrent)]


def _kind(operation: Recurrent) -> str:
    units = operation.units
    if isinstance(operation, Lstm):
        return f"an LSTM of {units} units"
    if (operation.input_bias[: 2 * units] == np.repeat([-GATE_OPEN, GATE_OPEN], units)).all():
        return f"an RNN of {units} units, as a GRU whose gates stand still (three times the weights)"
    return f"a GRU of {units} units"


def _needed(nodes: Sequence[Node], action: int, cells: Sequence[Cell]) -> set[int]:
    """Return the numbers of the action and all values it is computed from, without the observation."""
    replaced = {cell.result: cell for cell in cells}
    needed, waiting = {OBSERVATION}, [action]
    while waiting:
        number = waiting.pop()
        if number not in needed:
            needed.add(number)
            waiting += replaced[number].takes if number in replaced else nodes[number - 1].inputs
    return needed - {OBSERVATION}


def _observed(reading: _Reading, action: _Action, output: str) -> tuple[list[str], list[str]]:
    """Return the inputs that make up the observation, and a line for each input that nothing reads."""
    carried = {number for cell in action.cells for number in cell.states}
    names, dropped = list[str](), list[str]()
    for name, row in reading.inputs.items():
        if row.number in action.needed and row.number in carried:
            raise PolicyError(
                f"the output {shown(output)} depends on the state {shown(name)} beside the cell that carries "
                "it, which is not supported; export the action as a function of the cell's output alone"
            )
        if row.number in action.needed:
            names.append(name)
        elif row.number not in carried:
            dropped.append(f"dropped the input {shown(name)}: the action does not depend on it")
    if not names:
        raise PolicyError(
            f"the output {shown(output)} is no function of the inputs {listed(list(reading.inputs))}; "
            "is the export right?"
        )
    return names, dropped


def _check_failed(
    reading: _Reading, names: Sequence[str], action: _Action, states: Mapping[str, str], ends: Ends
) -> None:
    """Raise PolicyError where an input is no cell's state and does not fit the observation's width."""
    if ends.observation_count in (None, sum(reading.inputs[name].width for name in names)):
        return
    for name, why in action.failed.items():
        if name in names:
            others = [shown(other) for other in names[1:] if other not in states]
            hint = f", or set {' or '.join(others)} with --constant NAME=VALUE" if others else ""
            raise PolicyError(
                f"the input {shown(name)}, which the output {shown(states[name])} gives anew, is no state of "
                f"a GRU, LSTM or tanh RNN: {why}; export the memory as torch.nn.GRU or LSTM, or observe the "
                f"past with terms like rate@1{hint}"
            )


def _ordered(reading: _Reading, names: list[str], ends: Ends) -> tuple[list[str], list[str]]:
    """Return the observation's inputs in their order, and lines for the user about it."""
    order = list(ends.input_order or names)
    if sorted(order) != sorted(names):
        raise PolicyError(
            f"--input-order names {listed(order)}, but the observation of the model is {listed(names)}; "
            "name each of these once"
        )
    if len(order) == 1:
        renamed = f"renamed the input {shown(order[0])} to {POLICY_INPUT!r}"
        return order, [renamed] if order != [POLICY_INPUT] else []
    widths = {name: reading.inputs[name].width for name in order}
    if ends.observation_count not in (None, sum(widths.values())):
        listing = ", ".join(f"{shown(name)} ({width} values)" for name, width in widths.items())
        raise PolicyError(
            f"the model takes {listing}, together {sum(widths.values())}, but the blocks of --observation "
            f"make {ends.observation_count} with {ends.motors} motors; name the blocks of all, or set an "
            "input that the firmware does not have with --constant NAME=VALUE"
        )
    parts, terms, joined = list[str](), list(ends.terms or ()), list[str]()
    for name in order:
        width, taken = widths[name], list[str]()
        while terms and width >= terms[0][1]:
            text, count = terms.pop(0)
            taken.append(text)
            width -= count
        if width and terms:
            raise PolicyError(
                f"the input {shown(name)} takes {widths[name]} values and so ends inside "
                f"{terms[0][0]} of --observation, whose terms follow the inputs {listed(order)}; name the "
                "terms in that order or the inputs with --input-order"
            )
        joined.append(shown(name))
        parts.append(f"{shown(name)} takes {','.join(taken)}")
    how = "as told" if ends.input_order else "the model's, --input-order names another"
    return order, [f"joined the inputs {' and '.join(joined)} ({how}): {'; '.join(parts)}"]


def _assembled(reading: _Reading, names: Sequence[str], action: _Action) -> Network:
    """Return the network of the observation alone: inputs in their order, cells in place of their nodes."""
    replaced, start = {cell.result: cell for cell in action.cells}, 0
    nodes, renamed = list[Node](), {OBSERVATION: OBSERVATION}
    for name in names:
        row = reading.inputs[name]
        if len(names) > 1:
            nodes.append(Node(Slice(start, row.width), (OBSERVATION,), printable(name)))
        renamed[row.number] = len(nodes)
        start += row.width
    for number in sorted(action.needed - renamed.keys()):
        node, cell = reading.build.nodes[number - 1], replaced.get(number)
        operation = node.operation if cell is None else cell.operation
        takes = [renamed[value] for value in (node.inputs if cell is None else cell.takes)]
        if cell is not None and len(takes) > 1:
            nodes.append(Node(Concat(), tuple(takes), node.name))
            takes = [len(nodes)]
        nodes.append(Node(operation, tuple(takes), node.name))
        renamed[number] = len(nodes)
    return sweep(Network(start, tuple(nodes[: renamed[action.row.number]])))
