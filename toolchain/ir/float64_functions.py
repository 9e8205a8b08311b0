"""Functions in float64 that numpy lacks: references of tables, and ends of intervals."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

_ERF = np.frompyfunc(math.erf, 1, 1)  # value by value: an image is built without scipy


def erf(x: Float64) -> Float64:
    """Return the error function of each value."""
    return np.asarray(_ERF(x), np.float64)


def softplus(x: Float64) -> Float64:
    """Return log(1 + e^x) of each value."""
    return np.asarray(np.logaddexp(x, 0.0))
