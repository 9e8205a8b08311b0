"""The mean of a control period's gyro samples: where it begins, and the order of its sum."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neuroflight.sim.control.gyro_mean import GyroMean, samples_per_step

RATES = st.floats(-40.0, 40.0, width=32)


@pytest.mark.parametrize(
    ("mean", "control_rate_hz", "samples"),
    [(True, 1000, 4), (True, 2000, 2), (True, 4000, 1), (True, 8000, 1), (False, 1000, 1)],
)
def test_a_batch_has_the_samples_of_a_control_period(mean: bool, control_rate_hz: int, samples: int) -> None:
    assert samples_per_step(mean, control_rate_hz) == samples


@given(st.lists(RATES, min_size=1, max_size=12), st.integers(1, 8))
def test_the_mean_is_the_sum_from_the_oldest_on_with_the_first_for_those_before(
    rates: list[float], samples: int
) -> None:
    mean = GyroMean(1, samples)
    for rate in rates:
        mean.add(np.full((1, 3), rate, np.float32))
    last = ([rates[0]] * samples + rates)[-samples:]
    total = np.float32(last[0])
    for rate in last[1:]:
        total = np.float32(total + np.float32(rate))
    expected = np.full((1, 3), total * np.float32(1.0 / samples), np.float32)
    assert mean.mean().tobytes() == expected.tobytes()


def test_a_sum_in_another_order_would_have_other_bits() -> None:
    mean = GyroMean(1, 4)
    for rate in (1.0, 2.0**-24, 2.0**-24, 0.0):
        mean.add(np.full((1, 3), rate, np.float32))
    assert mean.mean().tolist() == [[0.25] * 3]  # from the newest on: 0.25 + 2^-25


def test_one_sample_is_itself_when_the_mean_is_of_one() -> None:
    mean, rates = GyroMean(2, 1), np.random.default_rng(1).normal(size=(5, 2, 3)).astype(np.float32)
    for rate in rates:
        mean.add(rate)
        assert mean.mean().tobytes() == rate.tobytes()


def test_a_reset_begins_anew_for_the_aircraft_that_are_named_and_no_others() -> None:
    mean = GyroMean(3, 4)
    for rate in (1.0, 2.0, 3.0, 4.0):
        mean.add(np.full((3, 3), rate, np.float32))
    mean.reset(np.array([1]))
    mean.add(np.full((3, 3), 8.0, np.float32))
    assert mean.mean()[:, 0].tolist() == [4.25, 8.0, 4.25]


def test_part_of_the_gyros_can_give_samples_without_touching_the_others() -> None:
    mean = GyroMean(3, 2)
    mean.add(np.full((3, 3), 1.0, np.float32))
    mean.add(np.full((2, 3), 3.0, np.float32), np.array([2, 0]))
    assert mean.mean()[:, 0].tolist() == [2.0, 1.0, 2.0]
    assert mean.mean(np.array([1, 2]))[:, 0].tolist() == [1.0, 2.0]
