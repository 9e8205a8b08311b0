"""GRU and LSTM nodes of one step: the compiled policy carries their state from one observation to the next.

That is another meaning than the file's own, whose every run starts from the initial state; it is what the
policy was trained for, and it is the same only if that initial state is zero.
"""

from __future__ import annotations

import numpy as np

from toolchain.ir.float32 import Float32
from toolchain.ir.operations import Gru, Lstm
from toolchain.reader.values import Builder, Call, Row, Unread, Value, shown

SEQUENCE_LENGTHS, INITIAL_H, INITIAL_C, PEEPHOLES = 4, 5, 6, 7  # places of inputs
DEFAULTS = {  # attribute: the one value that is accepted
    "direction": b"forward",
    "layout": 0,
    "input_forget": 0,
    "clip": 0.0,
}
ACTIVATIONS = {"GRU": [b"Sigmoid", b"Tanh"], "LSTM": [b"Sigmoid", b"Tanh", b"Tanh"]}


def read_gru(build: Builder, call: Call) -> tuple[Value, ...]:
    """Y and Y_h of a GRU."""
    if call.attributes.get("linear_before_reset", 0) != 1:
        raise call.error(
            "has linear_before_reset 0, expected 1: the reset gate after the state's matrix, as torch's GRU"
        )
    row, weight, state_weight, bias = _parts(call, 3)
    units = state_weight.shape[1]
    cell = Gru(weight, state_weight, bias[: 3 * units], bias[3 * units :])
    result = build.append(call, cell, row, shape=(1, 1, 1, units))
    return result, Row(result.number, (1, 1, units))


def read_lstm(build: Builder, call: Call) -> tuple[Value, ...]:
    """Y, Y_h and the cell state of an LSTM, which no operation may read."""
    if call.input(PEEPHOLES) is not None:
        raise call.error("has peepholes, expected none")
    row, weight, state_weight, bias = _parts(call, 4)
    units = state_weight.shape[1]
    joint = bias[: 4 * units].astype(np.float64) + bias[4 * units :]
    cell = Lstm(weight, state_weight, joint.astype(np.float32))
    result = build.append(call, cell, row, shape=(1, 1, 1, units))
    return result, Row(result.number, (1, 1, units)), Unread(f"the cell state of {call.label}")


def _parts(call: Call, gates: int) -> tuple[Row, Float32, Float32, Float32]:
    """Input, weights (gates H, inputs), state weights (gates H, H) and both biases (2 gates H,)."""
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
    for place, name in ((INITIAL_H, "h"), (INITIAL_C, "c")):
        value = call.input(place)
        if value is None:
            continue
        if not isinstance(value, np.ndarray):
            raise call.error(f"computes its initial state {name}, expected zero or none")
        if value.any():
            raise call.error(f"has an initial state {name} other than zero; policy_init clears the state")
