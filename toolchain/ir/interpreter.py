"""Evaluates a policy's network exactly as the emitted C does, bit for bit, on many observations at once.

Every operation has the order of the kernels that `toolchain.codegen.emit` writes: a linear layer
starts from the bias and adds inputs in ascending order, each by one fused multiply-add. What is no number
stays so: an activation or a Clip whose input is NaN or infinite gives NaN, and an observation that holds
either gives NaN on every motor. A step whose action holds NaN clears the recurrent state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import assert_never

import numpy as np

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.activation_tables import ERF, EXPM1, SOFTPLUS, TANH, apply
from neuroflight.toolchain.ir.float32 import Float32, fma
from neuroflight.toolchain.ir.lanes import LANES
from neuroflight.toolchain.ir.network import Network

State = tuple[Float32, ...]  # (N, units) of each recurrent node in order; for an Lstm h, then c

_HALF, _1, _NAN = np.float32(0.5), np.float32(1), np.float32(np.nan)
_LARGEST = np.finfo(np.float32).max


def evaluate(network: Network, observation: Float32, *, exact: bool = True) -> Float32:
    """Compute the actions (N, outputs) of observations (N, inputs), both float32, each from cleared recurrent
    state.

    exact: give the emitted C's bits; otherwise matrices go through BLAS, tanh through numpy and cells' sums
    round twice, many times as fast and a few ulp away, which is for statistics over many flights.
    Actions are within the last Clip's bounds; NaN where the observation or a sum of it leaves float32.
    """
    return advance(network, observation, clear_state(network, len(observation)), exact=exact)[0]


def replay(network: Network, observation: Float32) -> Float32:
    """Compute the actions (T, outputs) of T observations (T, inputs) in turn, keeping recurrent state."""
    if not network.recurrent:
        return evaluate(network, observation)
    state, actions = clear_state(network, 1), []
    for row in observation:
        action, state = advance(network, row[None], state)
        actions.append(action)
    return np.concatenate(actions)


def clear_state(network: Network, count: int) -> State:
    """Return the state after policy_init, for `count` policies side by side."""
    cells = [node.operation for node in network.nodes if isinstance(node.operation, op.Recurrent)]
    rows = [cell.units for cell in cells for _ in range(2 if isinstance(cell, op.Lstm) else 1)]
    return tuple(np.zeros((count, units), np.float32) for units in rows)


def advance(
    network: Network, observation: Float32, state: State, *, exact: bool = True
) -> tuple[Float32, State]:
    """Advance N policies by one step: actions (N, outputs) and the state after it."""
    last = network.nodes[-1].operation
    if not isinstance(last, op.Clip) or last.low is None or last.high is None:
        raise ValueError(f"the last operation is {last}, expected a Clip with both bounds")
    usable = np.isfinite(observation).all(axis=1, keepdims=True)
    old, new = iter(state), list[Float32]()
    with np.errstate(all="ignore"):
        values = [observation + np.float32(0)]  # -0 becomes 0
        for node in network.nodes:
            inputs = [values[number] for number in node.inputs]
            match node.operation:
                case op.Gru() as cell:
                    h = _gru(cell, inputs[0], next(old), exact)
                    new.append(h)
                    values.append(h)
                case op.Lstm() as cell:
                    h, c = _lstm(cell, inputs[0], next(old), next(old), exact)
                    new += [h, c]
                    values.append(h)
                case operation:
                    values.append(_apply(operation, inputs, exact))
    action = np.where(usable, values[-1], _NAN)
    lost = np.isnan(action).any(axis=1, keepdims=True)
    return action, tuple(np.where(lost, np.float32(0), part + np.float32(0)) for part in new)


def _apply(operation: op.Stateless, inputs: Sequence[Float32], exact: bool) -> Float32:
    x = inputs[0]
    match operation:
        case op.Linear(weight, bias):
            return _linear(weight, bias, x, exact)
        case op.Affine(scale, offset):
            return fma(x, scale.astype(np.float32), offset.astype(np.float32))
        case op.Tanh():
            return _tanh(x, exact)
        case op.Sigmoid():
            return _sigmoid(x, exact)
        case op.Silu():
            return x * _sigmoid(x, exact)
        case op.Softsign():
            quotient: Float32 = np.divide(x, _1 + np.abs(x))
            return quotient
        case op.Erf():
            return apply(ERF, x)
        case op.Softplus():
            return apply(SOFTPLUS, x) + _at_least(x, 0.0)
        case op.Relu():
            return _at_least(x, 0.0)
        case op.LeakyRelu(slope):
            return fma(_at_most(x, 0.0), np.float32(slope), _at_least(x, 0.0))
        case op.Elu(alpha):
            return fma(apply(EXPM1, x), alpha, _at_least(x, 0.0))
        case op.Clip(low, high):
            x = x if low is None else _at_least(x, low)
            return x if high is None else _at_most(x, high)
        case op.LayerNorm() | op.RmsNorm():
            return _norm(operation, x)
        case op.Softmax():
            return _softmax(x)
        case op.Add():
            return x + inputs[1]
        case op.Multiply():
            return x * inputs[1]
        case op.Select():
            return fma(x, np.float32(0), np.where(x > 0, inputs[1], inputs[2]))
        case op.Concat():
            return np.concatenate(inputs, axis=1)
        case op.Slice(start, count, step):
            return x[:, [start + step * index for index in range(count)]]
        case never:
            assert_never(never)


def _linear(weight: Float32, bias: Float32, x: Float32, exact: bool) -> Float32:
    if not exact:
        product: Float32 = x @ weight.T + bias
        return product
    total = np.broadcast_to(bias, (x.shape[0], bias.size))
    for index in range(x.shape[1]):
        total = fma(x[:, index, None], weight[:, index], total)
    return total


def _tanh(x: Float32, exact: bool) -> Float32:
    return apply(TANH, x) if exact else np.tanh(x)


def _sigmoid(x: Float32, exact: bool) -> Float32:
    return _fma(_tanh(x * _HALF, exact), _HALF, _HALF, exact)


def _fma(a: Float32, b: Float32 | np.float32, c: Float32 | np.float32, exact: bool) -> Float32:
    return fma(a, b, c) if exact else a * b + c


def _gru(cell: op.Gru, x: Float32, h: Float32, exact: bool) -> Float32:
    units = cell.units
    from_input = _linear(cell.input_weight, cell.input_bias, x, exact)
    from_state = _linear(cell.state_weight, cell.state_bias, h, exact)
    gates = _sigmoid(from_input[:, : 2 * units] + from_state[:, : 2 * units], exact)
    update, reset = gates[:, :units], gates[:, units:]
    candidate = _tanh(_fma(reset, from_state[:, 2 * units :], from_input[:, 2 * units :], exact), exact)
    return _fma(update, h - candidate, candidate, exact)


def _lstm(cell: op.Lstm, x: Float32, h: Float32, c: Float32, exact: bool) -> tuple[Float32, Float32]:
    units = cell.units
    none = np.zeros(4 * units, np.float32)
    sums = _linear(cell.input_weight, cell.bias, x, exact) + _linear(cell.state_weight, none, h, exact)
    gates = _sigmoid(sums[:, : 3 * units], exact)
    write, output, forget = gates[:, :units], gates[:, units : 2 * units], gates[:, 2 * units :]
    c = _fma(forget, c, write * _tanh(sums[:, 3 * units :], exact), exact)
    return output * _tanh(c, exact), c


def _norm(norm: op.Norm, x: Float32) -> Float32:
    share = np.float32(1 / x.shape[1])
    if isinstance(norm, op.LayerNorm):
        x = x - _sum(x, lambda value, total: value + total) * share
    square = _sum(x, lambda value, total: fma(value, value, total)) * share
    inverse = _1 / np.sqrt(square + np.float32(norm.epsilon))
    return fma(x * inverse, norm.scale, norm.offset)


def _softmax(x: Float32) -> Float32:
    """Compute e^x from the table of e^x - 1; the largest x is subtracted first, so no exponent is above 0."""
    largest = np.where(x > -_LARGEST, x, -_LARGEST).max(axis=1, keepdims=True)
    powers = apply(EXPM1, x - largest) + _1
    shares: Float32 = powers * (_1 / _sum(powers, lambda value, total: value + total))
    return shares


def _sum(x: Float32, add: Callable[[Float32, Float32], Float32]) -> Float32:
    """Sum a row in LANES partial sums in turn; the remainder goes to the first."""
    whole = x.shape[1] - x.shape[1] % LANES
    lanes = [np.zeros(len(x), np.float32) for _ in range(LANES)]
    for index in range(x.shape[1]):
        lane = index % LANES if index < whole else 0
        lanes[lane] = add(x[:, index], lanes[lane])
    return ((lanes[0] + lanes[1]) + (lanes[2] + lanes[3]))[:, None]


def _at_most(x: Float32, high: float) -> Float32:
    return _if_finite(x, np.where(x <= np.float32(high), x, np.float32(high)))


def _at_least(x: Float32, low: float) -> Float32:
    return _if_finite(x, np.where(x > np.float32(low), x, np.float32(low)))


def _if_finite(x: Float32, y: Float32) -> Float32:
    return np.where(np.isfinite(x), y, _NAN)
