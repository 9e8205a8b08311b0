"""The error of the project's tanh, measured against float64's."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from toolchain.tanh import LIMIT, tanh

BOUND = 2e-7  # what policy.c's comment and the documentation promise
INFINITY_BITS = 0x7F800000


def worst(x: NDArray[np.float32]) -> float:
    return float(np.abs(tanh(x) - np.tanh(x.astype(np.float64))).max())


def floats(first: float, last: float, stride: int) -> NDArray[np.float32]:
    """Every `stride`-th float32 from `first` to `last`, both positive."""
    ends = np.array([first, last], np.float32).view(np.uint32)
    return np.arange(ends[0], ends[1], stride, dtype=np.uint32).view(np.float32)


def test_tanh_keeps_its_bound_when_x_is_any_float() -> None:
    x = np.arange(0, INFINITY_BITS + 1, 1499, dtype=np.uint32).view(np.float32)
    assert worst(x) < BOUND
    assert worst(-x) < BOUND


def test_tanh_keeps_its_bound_when_x_is_where_it_bends() -> None:
    assert worst(floats(0.2, LIMIT, 37)) < BOUND


@pytest.mark.prove
def test_tanh_keeps_its_bound_when_x_is_every_float_that_matters() -> None:
    edges = np.geomspace(2.0**-12, 10, 60)
    for first, last in pairwise(edges):
        x = floats(first, last, 1)
        assert worst(x) < BOUND
        assert tanh(x).max() <= 1


def test_tanh_stays_within_one_and_odd_when_x_grows() -> None:
    x = np.concatenate([floats(0.5, 12, 997), np.array([1e9, 3e38, np.inf], np.float32)])
    assert tanh(x).max() == 1
    np.testing.assert_array_equal(tanh(-x), -tanh(x))


def test_tanh_returns_x_when_x_is_tiny() -> None:
    x = np.array([0.0, -0.0, 1e-45, -1e-40, 1.2e-38, 1e-20, -1e-5], np.float32)
    np.testing.assert_array_equal(tanh(x).view(np.uint32), x.view(np.uint32))


def test_tanh_stays_nan_when_x_is_nan() -> None:
    assert np.isnan(tanh(np.array([np.nan], np.float32))).all()
