"""nf_math.c against numpy in double precision."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray


def float32(values: Any) -> NDArray[np.float32]:
    return np.array(values, np.float32)


TURNS = np.unique(float32([*np.linspace(0, 0.5, 4001), *np.geomspace(1e-30, 0.5, 500), 0.125, 0.25, 0.49999]))


def of_each(function: Callable[[float], float], arguments: Any) -> NDArray[np.float64]:
    return np.array([function(float(argument)) for argument in arguments])


def test_sine_and_cosine_keep_their_digits_when_turns_go_from_nothing_to_a_half(scripted: Any) -> None:
    turns = TURNS.astype(float)
    # Near a zero of the result the argument is taken from it first: double's own pi would blur it.
    sine = np.sin(2 * np.pi * np.minimum(turns, 0.5 - turns))
    cosine = np.sin(2 * np.pi * (0.25 - turns))
    np.testing.assert_allclose(of_each(scripted.lib.nf_sin_turns, TURNS), sine, rtol=2e-7)
    np.testing.assert_allclose(of_each(scripted.lib.nf_cos_turns, TURNS), cosine, rtol=2e-7)


def test_gain_of_a_low_pass_keeps_its_digits_when_it_is_small_and_is_one_when_it_is_large(
    scripted: Any,
) -> None:
    x = np.unique(float32([*np.geomspace(1e-30, 30, 3000), 0.125, 0.25, 20]))
    got = of_each(scripted.lib.nf_one_minus_exp, x)
    np.testing.assert_allclose(got, -np.expm1(-x.astype(float)), rtol=1e-6)
    assert got.max() <= 1.0
    assert scripted.lib.nf_one_minus_exp(0.0) == 0.0
    assert scripted.lib.nf_one_minus_exp(1e30) == 1.0


def test_logarithm_is_right_when_it_is_of_a_ratio_of_frequencies(scripted: Any) -> None:
    x = np.unique(float32([*np.geomspace(1e-6, 1e6, 4001), *np.linspace(0.5, 2, 2001), 1]))
    got = of_each(scripted.lib.nf_log, x)
    np.testing.assert_allclose(got, np.log(x.astype(float)), rtol=2e-7, atol=1e-7)
    assert scripted.lib.nf_log(1.0) == 0.0
    assert scripted.lib.nf_log(math.inf) == scripted.lib.nf_log(1e6)
    assert scripted.lib.nf_log(0.0) == scripted.lib.nf_log(1e-6)


def test_angle_of_a_vector_is_right_when_it_points_anywhere(scripted: Any) -> None:
    rng = np.random.default_rng(1)
    around = np.radians(np.arange(-180, 180.5, 0.5))
    vectors = float32(
        [
            *rng.normal(size=(4000, 2)),
            *np.stack([np.cos(around), np.sin(around)], axis=1),
            *[(1, 1), (-1, 1), (1, -1), (-1, -1), (0, 2), (0, -2), (3, 0), (1e-20, 1), (1, 1e-20)],
        ]
    )
    got = np.array([scripted.lib.nf_atan2(y, x) for x, y in vectors.tolist()])
    expected = np.arctan2(vectors[:, 1].astype(float), vectors[:, 0].astype(float))
    assert np.abs(got - expected).max() < 5e-7
    assert scripted.lib.nf_atan2(0.0, -1.0) == pytest.approx(math.pi, abs=5e-7)
    assert scripted.lib.nf_atan2(0.0, 0.0) == 0.0


def test_arc_sine_is_right_when_it_exists_and_a_quarter_turn_beyond(scripted: Any) -> None:
    x = float32([*np.linspace(-1, 1, 4001), np.nextafter(np.float32(1), np.float32(0))])
    got = of_each(scripted.lib.nf_asin, x)
    assert np.abs(got - np.arcsin(x.astype(float))).max() < 5e-7
    assert scripted.lib.nf_asin(1.5) == pytest.approx(math.pi / 2, abs=2e-7)
    assert scripted.lib.nf_asin(-1.5) == pytest.approx(-math.pi / 2, abs=2e-7)
