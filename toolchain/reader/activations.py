"""Readers of activations that are put together from operations the compiler has.

    GELU        x / 2 (1 + erf(x / sqrt 2)), or x / 2 (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3)))
    Mish        x tanh(log(1 + e^x))
    SELU        gamma ELU(x)
    CELU        alpha ELU(x / alpha), with an ELU of alpha 1
    PReLU       LeakyReLU, or max(x, 0) + slope min(x, 0) where each value has a slope of its own
    HardSwish   x HardSigmoid(x)
    Swish       x sigmoid(alpha x)
    LogSigmoid  -log(1 + e^-x)

An exporter that writes these in parts needs no reader here: the parts give the same nodes.
"""

from __future__ import annotations

import math

import numpy as np

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.reader.arithmetic import constant_row, mapped
from neuroflight.toolchain.reader.values import Call, RowValue, joint_shape

GELU_CUBE = 0.044715  # of GELU's tanh form, in ONNX as in torch and JAX
# ONNX's defaults, the float32 nearest to Klambauer et al.'s numbers.
SELU_ALPHA, SELU_GAMMA = 1.67326319217681884765625, 1.05070102214813232421875
POWERS = (2, 3)


def read_gelu(call: Call) -> RowValue:
    """Read Gelu, of either form."""
    row, form = call.row(), call.attributes.get("approximate", b"none")
    if form == b"none":
        inner = _then(call, op.Erf(), _scaled(call, row, math.sqrt(0.5)))
    elif form == b"tanh":
        # sqrt(2 / pi) x (1 + 0.044715 x^2) passes tanh's limits long before x is 10: x is clipped there, so
        # that its square stays within float32.
        near = _then(call, op.Clip(-10.0, 10.0), row)
        factor = math.sqrt(2 / math.pi)
        square = _then(call, op.Multiply(), near, near)
        cubic = mapped(call, square, GELU_CUBE * factor, factor, row.shape)
        inner = _then(call, op.Tanh(), _then(call, op.Multiply(), near, cubic))
    else:
        raise call.error(f"has approximate {form!r}, expected none or tanh")
    return _then(call, op.Multiply(), row, mapped(call, inner, 0.5, 0.5, row.shape))


def read_mish(call: Call) -> RowValue:
    """Read Mish."""
    gate = _then(call, op.Tanh(), _then(call, op.Softplus(), call.row()))
    return _then(call, op.Multiply(), call.row(), gate)


def read_selu(call: Call) -> RowValue:
    """Read Selu."""
    alpha, gamma = _attribute(call, "alpha", SELU_ALPHA), _attribute(call, "gamma", SELU_GAMMA)
    return _scaled(call, _then(call, op.Elu(alpha), call.row()), gamma)


def read_celu(call: Call) -> RowValue:
    """Read Celu."""
    if (alpha := _attribute(call, "alpha", 1.0)) <= 0:
        raise call.error(f"has alpha {alpha:g}, expected more than 0")
    row = call.row()
    if alpha == 1:
        return _then(call, op.Elu(1.0), row)
    return _scaled(call, _then(call, op.Elu(1.0), _scaled(call, row, 1 / alpha)), alpha)


def read_prelu(call: Call) -> RowValue:
    """Read PRelu, of one slope or one for each value."""
    row, slope = call.row(), call.floats(1)
    if slope is None or joint_shape(call, slope.shape, row.shape) != row.shape:
        raise call.error(f"has slopes that do not fit a value of shape {list(row.shape)}")
    slopes = np.broadcast_to(slope, row.shape).ravel().astype(np.float64)
    if (slopes == slopes[0]).all():
        return _then(call, op.LeakyRelu(float(slopes[0])), row)
    below = mapped(call, _then(call, op.Clip(None, 0.0), row), slopes, 0.0, row.shape)
    return _then(call, op.Add(), _then(call, op.Relu(), row), below)


def read_hard_sigmoid(call: Call) -> RowValue:
    """Read HardSigmoid: alpha x + beta, between 0 and 1."""
    return _hard_sigmoid(call, _attribute(call, "alpha", 0.2), _attribute(call, "beta", 0.5))


def read_hard_swish(call: Call) -> RowValue:
    """Read HardSwish."""
    return _then(call, op.Multiply(), call.row(), _hard_sigmoid(call, 1 / 6, 0.5))


def read_swish(call: Call) -> RowValue:
    """Read Swish."""
    row = call.row()
    if (alpha := _attribute(call, "alpha", 1.0)) == 1:
        return _then(call, op.Silu(), row)
    gate = _then(call, op.Sigmoid(), _scaled(call, row, alpha))
    return _then(call, op.Multiply(), row, gate)


def read_thresholded(call: Call) -> RowValue:
    """Read ThresholdedRelu: x where it is above alpha, else 0."""
    row, alpha = call.row(), _attribute(call, "alpha", 1.0)
    if alpha == 0:
        return _then(call, op.Relu(), row)
    above = mapped(call, row, 1.0, -alpha, row.shape)
    return _then(call, op.Select(), above, row, constant_row(call, row, np.zeros(row.width)))


def read_power(call: Call) -> RowValue:
    """Read Pow of a value to the second or third."""
    row, power = call.row(), call.constant(1)
    if power is None or power.size != 1 or power.flat[0] not in POWERS:
        raise call.error("raises to another power than 2 or 3, expected one of these")
    square = _then(call, op.Multiply(), row, row)
    return square if power.flat[0] == 2 else _then(call, op.Multiply(), square, row)


def read_log(call: Call) -> RowValue:
    """Read Log of a sigmoid: -log(1 + e^-x)."""
    row = call.row()
    node = call.build.operation(row)
    if node is None or node.operation != op.Sigmoid():
        raise call.error("takes the logarithm of what is no Sigmoid, which is not supported")
    inner = _scaled(call, RowValue(node.inputs[0], row.shape), -1.0)
    return _scaled(call, _then(call, op.Softplus(), inner), -1.0)


def _hard_sigmoid(call: Call, alpha: float, beta: float) -> RowValue:
    row = call.row()
    return _then(call, op.Clip(0.0, 1.0), mapped(call, row, alpha, beta, row.shape))


def _then(call: Call, operation: op.Operation, *rows: RowValue) -> RowValue:
    return call.append(operation, *rows, shape=rows[0].shape)


def _scaled(call: Call, row: RowValue, factor: float) -> RowValue:
    return mapped(call, row, factor, 0.0, row.shape)


def _attribute(call: Call, name: str, default: float) -> float:
    value = float(call.attributes.get(name, default))
    if not math.isfinite(value):
        raise call.error(f"has {name} {value}, expected a finite number")
    return value
