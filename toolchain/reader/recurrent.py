"""GRU, LSTM and RNN nodes of one step: the compiled policy carries their state to the next observation.

In the file every run starts from the initial state; the policy was trained with a state that goes on, and the
compiled one starts from zero, so other initial states are refused. A node that takes its state
from an input of the model is read as the sums and products that it stands for: `toolchain.reader.cells` finds
the cell in them, as it does where an exporter wrote it so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.operations import (
    Add,
    Affine,
    Gru,
    Linear,
    Lstm,
    Multiply,
    Operation,
    Sigmoid,
    Slice,
    Tanh,
)
from neuroflight.toolchain.reader.values import Call, RowValue, Unread, Value, shown

SEQUENCE_LENGTHS, INITIAL_H, INITIAL_C, PEEPHOLES = 4, 5, 6, 7  # places of inputs
STATES = {INITIAL_H: "h", INITIAL_C: "c"}
GATE_OPEN = 100.0  # input of a constant gate: its sigmoid is 1, or with a minus 0
DEFAULTS = {  # attribute: the one value that is accepted
    "direction": b"forward",
    "layout": 0,
    "input_forget": 0,
    "clip": 0.0,
}
ACTIVATIONS = {"RNN": [b"Tanh"], "GRU": [b"Sigmoid", b"Tanh"], "LSTM": [b"Sigmoid", b"Tanh", b"Tanh"]}


def read_gru(call: Call) -> tuple[Value, ...]:
    """Read GRU: Y and Y_h."""
    if call.attributes.get("linear_before_reset", 0) != 1:
        raise call.error(
            "has linear_before_reset 0, expected 1: the reset gate after the state's matrix, as torch's GRU "
            "and Keras' with reset_after=True"
        )
    row, weight, state_weight, bias = _parts(call, 3)
    units = state_weight.shape[1]
    before = _initial(call, units, INITIAL_H)
    input_bias, state_bias = bias[: 3 * units], bias[3 * units :]
    if before is None:
        result = call.append(Gru(weight, state_weight, input_bias, state_bias), row, shape=(units,))
    else:
        write = _Writer(call, units)
        given = write.gates(Linear(weight, input_bias), row)
        kept = write.gates(Linear(state_weight, state_bias), before[0])
        update, reset = (write(Sigmoid(), write(Add(), given[k], kept[k])) for k in (0, 1))
        new = write(Tanh(), write(Add(), given[2], write(Multiply(), reset, kept[2])))
        result = write(Add(), new, write(Multiply(), update, write(Add(), before[0], write.negative(new))))
    return _outputs(result)


def read_lstm(call: Call) -> tuple[Value, ...]:
    """Read LSTM: Y, Y_h and the cell state, which no operation may read where the policy carries it."""
    if call.input(PEEPHOLES) is not None:
        raise call.error("has peepholes, expected none")
    row, weight, state_weight, bias = _parts(call, 4)
    units = state_weight.shape[1]
    before = _initial(call, units, INITIAL_H, INITIAL_C)
    joint = (bias[: 4 * units].astype(np.float64) + bias[4 * units :]).astype(np.float32)
    if before is None:
        result = call.append(Lstm(weight, state_weight, joint), row, shape=(units,))
        return *_outputs(result), Unread(f"the cell state of {call.label}")
    write = _Writer(call, units)
    given = write.gates(Linear(weight, joint), row)
    kept = write.gates(Linear(state_weight, np.zeros(4 * units, np.float32)), before[0])
    sums = [write(Add(), one, other) for one, other in zip(given, kept, strict=True)]
    enter, leave, forget = (write(Sigmoid(), total) for total in sums[:3])
    inside = write(
        Add(), write(Multiply(), forget, before[1]), write(Multiply(), enter, write(Tanh(), sums[3]))
    )
    return *_outputs(write(Multiply(), leave, write(Tanh(), inside))), RowValue(inside.number, (1, 1, units))


def read_rnn(call: Call) -> tuple[Value, ...]:
    """Read RNN: Y and Y_h of h' = tanh(W x + b + R h + c)."""
    row, weight, state_weight, bias = _parts(call, 1)
    units = state_weight.shape[1]
    before = _initial(call, units, INITIAL_H)
    if before is None:
        return _outputs(
            call.append(plain_cell(weight, state_weight, bias[:units], bias[units:]), row, shape=(units,))
        )
    write = _Writer(call, units)
    given = call.append(Linear(weight, bias[:units]), row, shape=(units,))
    kept = call.append(Linear(state_weight, bias[units:]), before[0], shape=(units,))
    return _outputs(write(Tanh(), write(Add(), given, kept)))


def plain_cell(weight: Float32, state_weight: Float32, bias: Float32, state_bias: Float32) -> Gru:
    """Return h' = tanh(W x + b + R h + c) as a GRU with constant gates: nothing kept, nothing reset.

    A bias of +-GATE_OPEN makes a sigmoid of float32 exactly 1 and at most 4e-44.
    """
    units = len(weight)
    gates = np.repeat(np.array([-GATE_OPEN, GATE_OPEN], np.float32), units)
    return Gru(
        np.concatenate([np.zeros((2 * units, weight.shape[1]), np.float32), weight]),
        np.concatenate([np.zeros((2 * units, units), np.float32), state_weight]),
        np.concatenate([gates, bias]),
        np.concatenate([np.zeros(2 * units, np.float32), state_bias]),
    )


def _outputs(result: RowValue) -> tuple[RowValue, RowValue]:
    """Return the result as Y [1, 1, 1, H] and as Y_h [1, 1, H]."""
    units = result.width
    return RowValue(result.number, (1, 1, 1, units)), RowValue(result.number, (1, 1, units))


@dataclass(frozen=True)
class _Writer:
    """A writer of the operations of one cell, all of its width."""

    call: Call
    units: int

    def __call__(self, operation: Operation, *rows: RowValue) -> RowValue:
        return self.call.append(operation, *rows, shape=(self.units,))

    def gates(self, layer: Linear, row: RowValue) -> list[RowValue]:
        """Return the sum of each gate; `layer` computes them one after the other."""
        count = layer.outputs // self.units
        joint = self.call.append(layer, row, shape=(layer.outputs,))
        return [self(Slice(gate * self.units, self.units), joint) for gate in range(count)]

    def negative(self, row: RowValue) -> RowValue:
        """Append -x."""
        return self(Affine(np.full(self.units, -1.0), np.zeros(self.units)), row)


def _initial(call: Call, units: int, *places: int) -> list[RowValue] | None:
    """Return the computed state that the cell starts from; None where it starts from zero."""
    given = []
    for place in places:
        value = call.input(place)
        if isinstance(value, np.ndarray) and value.any():
            raise call.error(
                f"has an initial state {STATES[place]} other than zero; policy_init clears the state"
            )
        if not isinstance(value, RowValue | np.ndarray):
            continue
        # a constant may have the axis of a batch, of which one policy is taken
        fits = value.width == units if isinstance(value, RowValue) else value.shape[-1:] == (units,)
        if not fits:
            raise call.error(
                f"has an initial state {STATES[place]} of shape {list(value.shape)}, expected [1, 1, {units}]"
            )
        if isinstance(value, RowValue):
            given.append(value)
    if given and len(given) < len(places):
        raise call.error(
            "takes one of its states h and c from an input and not the other; export both or none"
        )
    return given or None


def _parts(call: Call, gates: int) -> tuple[RowValue, Float32, Float32, Float32]:
    """Return input, weights (gates H, inputs), state weights (gates H, H) and both biases (2 gates H,)."""
    _check_options(call)
    row = call.row(0)
    if len(row.shape) != 3 or row.shape[:2] != (1, 1):
        raise call.error(
            f"takes a sequence of shape {list(row.shape)}, expected one step of one policy: [1, 1, n]"
        )
    weight, state_weight, bias = (call.floats(place) for place in (1, 2, 3))
    if weight is None or state_weight is None:
        raise call.error("has no weights")
    units = int(state_weight.shape[-1]) if state_weight.ndim else 0
    size = gates * units
    bias = np.zeros((1, 2 * size), np.float32) if bias is None else bias
    shapes = [list(values.shape) for values in (weight, state_weight, bias)]
    expected = [[1, size, row.width], [1, size, units], [1, 2 * size]]
    if shapes != expected or call.attributes.get("hidden_size", units) != units or not units:
        raise call.error(f"has weights of shapes {shapes}, expected {expected}")
    return row, weight[0], state_weight[0], bias[0]


def _check_options(call: Call) -> None:
    for name, expected in DEFAULTS.items():
        got = call.attributes.get(name, expected)
        if got != expected:
            words = [v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in (got, expected)]
            raise call.error(f"has {name} {shown(str(words[0]))}, expected {words[1]}")
    activations = ACTIVATIONS[call.operator]
    got = list(call.attributes.get("activations", activations))
    if [name.lower() for name in got] != [name.lower() for name in activations]:
        names = ", ".join(name.decode("utf-8", "replace") for name in got)
        expected = ", ".join(name.decode() for name in activations)
        raise call.error(f"has activations {shown(names)}, expected {expected}")
    if call.input(SEQUENCE_LENGTHS) is not None:
        raise call.error("has sequence_lens, expected none: a policy takes one step at a time")
