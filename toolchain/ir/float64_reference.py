"""Evaluates a policy's network in float64: the reference that float32 results are compared with.

The operations' mathematics with numpy's functions: no kernel, pass or table of the compiler takes part, so
that an error in one of them shows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, assert_never

import numpy as np

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.float64_functions import Float64, erf, softplus
from neuroflight.toolchain.ir.network import Network

ULP = 2.0**-23  # relative, at most: from one float32 to the next
CONSTANTS = ("weight", "bias", "scale", "offset", "input_weight", "state_weight", "input_bias", "state_bias")


Function = Callable[[Float64], Float64]


def reference(network: Network, observation: Float32, tabulated: Function = lambda values: values) -> Float64:
    """Compute actions (S, T, outputs) of S sequences of T observations (S, T, inputs), from cleared state.

    tabulated: applied to each result that the policy takes from a table, such as every tanh.
    """

    def tanh(x: Float64) -> Float64:
        return tabulated(np.tanh(x))

    if not network.recurrent and observation.shape[1] > 1:
        flat = reference(network, observation.reshape(-1, 1, network.inputs), tabulated)
        return flat.reshape(*observation.shape[:2], network.outputs)
    sequences, steps, _ = observation.shape
    state = {index: _clear(node.operation, sequences) for index, node in enumerate(network.nodes)}
    actions = np.empty((sequences, steps, network.outputs))
    with np.errstate(all="ignore"):
        for step in range(steps):
            values = [observation[:, step].astype(np.float64)]
            for index, node in enumerate(network.nodes):
                inputs = [values[number] for number in node.inputs]
                match node.operation:
                    case op.Gru() | op.Lstm() as cell:
                        state[index] = _cell(cell, tanh, inputs[0], *state[index])
                        values.append(state[index][0])
                    case operation:
                        values.append(_apply(operation, tanh, tabulated, inputs))
            actions[:, step] = values[-1]
    return actions


def disturbed(network: Network, observation: Float32, rng: np.random.Generator) -> Float64:
    """Compute `reference` with constants and table values changed by about a unit in their last place.

    Rounding in a float32 evaluation acts like several such changes. So the distance between these actions and
    the reference's shows how sensitive to rounding an observation is.
    """

    def tabulated(values: Float64) -> Float64:
        return values * (1 + ULP * rng.standard_normal(values.shape))

    nodes = tuple(replace(node, operation=_moved(node.operation, rng)) for node in network.nodes)
    return reference(replace(network, nodes=nodes), observation, tabulated)


def _moved(operation: op.Operation, rng: np.random.Generator) -> op.Operation:
    changes: dict[str, Any] = {}
    for name in CONSTANTS:
        values = getattr(operation, name, None)
        if isinstance(values, np.ndarray):
            moved = values * (1 + ULP * rng.standard_normal(values.shape))
            changes[name] = moved.astype(values.dtype)
    return replace(operation, **changes) if changes else operation


def _clear(operation: op.Operation, sequences: int) -> tuple[Float64, ...]:
    """Return the state after policy_init: none, h, or h and c."""
    if not isinstance(operation, op.Recurrent):
        return ()
    none = np.zeros((sequences, operation.units))
    return (none,) if isinstance(operation, op.Gru) else (none, none)


def _cell(
    cell: op.Gru | op.Lstm, tanh: Function, x: Float64, h: Float64, c: Float64 | None = None
) -> tuple[Float64, ...]:
    """Compute h' of a Gru, or h' and c' of an Lstm."""
    from_input, from_state = x @ _wide(cell.input_weight), h @ _wide(cell.state_weight)
    if isinstance(cell, op.Gru):
        z, r, n = np.split(from_input + cell.input_bias, 3, axis=1)
        state_z, state_r, state_n = np.split(from_state + cell.state_bias, 3, axis=1)
        update, reset = _sigmoid(z + state_z, tanh), _sigmoid(r + state_r, tanh)
        return ((1 - update) * tanh(n + reset * state_n) + update * h,)
    i, o, f, g = np.split(from_input + from_state + cell.bias, 4, axis=1)
    c = _sigmoid(f, tanh) * (0.0 if c is None else c) + _sigmoid(i, tanh) * tanh(g)
    return (_sigmoid(o, tanh) * tanh(c), c)


def _apply(operation: op.Stateless, tanh: Function, tabulated: Function, inputs: list[Float64]) -> Float64:
    x = inputs[0]
    match operation:
        case op.Linear():
            return np.asarray(x @ _wide(operation.weight) + operation.bias)
        case op.Affine(scale, offset):
            return x * scale + offset
        case op.Tanh():
            return tanh(x)
        case op.Sigmoid():
            return _sigmoid(x, tanh)
        case op.Silu():
            return x * _sigmoid(x, tanh)
        case op.Softsign():
            return np.asarray(x / (1 + np.abs(x)))
        case op.Erf():
            return tabulated(erf(x))
        case op.Softplus():
            return np.maximum(x, 0) + tabulated(softplus(-np.abs(x)))
        case op.Relu():
            return np.maximum(x, 0)
        case op.LeakyRelu(slope):
            return np.asarray(np.where(x < 0, slope * x, x))
        case op.Elu(alpha):
            return np.where(x < 0, alpha * tabulated(np.expm1(np.minimum(x, 0))), x)
        case op.Clip(low, high):
            return np.clip(x, -np.inf if low is None else low, np.inf if high is None else high)
        case op.LayerNorm(epsilon, scale, offset) | op.RmsNorm(epsilon, scale, offset):
            x = x - x.mean(axis=1, keepdims=True) if isinstance(operation, op.LayerNorm) else x
            root = np.sqrt(np.square(x).mean(axis=1, keepdims=True) + epsilon)
            return np.asarray(x / root * scale + offset)
        case op.Softmax():
            share = 1 + tabulated(np.expm1(x - x.max(axis=1, keepdims=True)))
            return np.asarray(share / share.sum(axis=1, keepdims=True))
        case op.Add():
            return x + inputs[1]
        case op.Multiply():
            return x * inputs[1]
        case op.Select():
            return np.where(x > 0, inputs[1], inputs[2])
        case op.Concat():
            return np.concatenate(inputs, axis=1)
        case op.Slice(start, count, step):
            return x[:, start + step * np.arange(count)]
        case never:
            assert_never(never)


def _sigmoid(x: Float64, tanh: Function) -> Float64:
    return np.asarray(0.5 + 0.5 * tanh(x / 2))


def _wide(weight: Float32) -> Float64:
    return weight.T.astype(np.float64)
