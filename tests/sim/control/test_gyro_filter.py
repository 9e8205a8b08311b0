"""The gyro's filters: where the mean begins and the order of its sum, and notches as the firmware's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neuroflight.sim.control.gyro_filter import GyroFilter, samples_per_step
from neuroflight.toolchain.policy.gyro_filters import MEAN, UNFILTERED, GyroFilters, RpmFilter

RATES = st.floats(-40.0, 40.0, width=32)


@pytest.mark.parametrize(
    ("filters", "control_rate_hz", "samples"),
    [
        *((MEAN, 1000, 4), (MEAN, 2000, 2), (MEAN, 4000, 1), (MEAN, 8000, 1), (UNFILTERED, 1000, 1)),
        (GyroFilters(RpmFilter()), 1000, 4),
    ],
)
def test_a_batch_has_the_samples_of_a_control_period(
    filters: GyroFilters, control_rate_hz: int, samples: int
) -> None:
    assert samples_per_step(filters, control_rate_hz) == samples


def mean_of(count: int, samples: int) -> GyroFilter:
    return GyroFilter(MEAN, count, 4, 1000, samples)


@given(st.lists(RATES, min_size=1, max_size=12), st.integers(1, 8))
def test_the_mean_is_the_sum_from_the_oldest_on_with_the_first_for_those_before(
    rates: list[float], samples: int
) -> None:
    mean = mean_of(1, samples)
    for rate in rates:
        mean.add(np.full((1, 3), rate, np.float32))
    last = ([rates[0]] * samples + rates)[-samples:]
    total = np.float32(last[0])
    for rate in last[1:]:
        total = np.float32(total + np.float32(rate))
    expected = np.full((1, 3), total * np.float32(1.0 / samples), np.float32)
    assert mean.read().tobytes() == expected.tobytes()


def test_a_sum_in_another_order_would_have_other_bits() -> None:
    mean = mean_of(1, 4)
    for rate in (1.0, 2.0**-24, 2.0**-24, 0.0):
        mean.add(np.full((1, 3), rate, np.float32))
    assert mean.read().tolist() == [[0.25] * 3]  # from the newest on: 0.25 + 2^-25


def test_one_sample_is_itself_when_the_mean_is_of_one() -> None:
    mean, rates = mean_of(2, 1), np.random.default_rng(1).normal(size=(5, 2, 3)).astype(np.float32)
    for rate in rates:
        mean.add(rate)
        assert mean.read().tobytes() == rate.tobytes()


def test_a_reset_begins_anew_for_the_aircraft_that_are_named_and_no_others() -> None:
    mean = mean_of(3, 4)
    for rate in (1.0, 2.0, 3.0, 4.0):
        mean.add(np.full((3, 3), rate, np.float32))
    mean.reset(np.array([1]))
    mean.add(np.full((3, 3), 8.0, np.float32))
    assert mean.read()[:, 0].tolist() == [4.25, 8.0, 4.25]


def test_part_of_the_gyros_can_give_samples_without_touching_the_others() -> None:
    mean = mean_of(3, 2)
    mean.add(np.full((3, 3), 1.0, np.float32))
    mean.add(np.full((2, 3), 3.0, np.float32), np.array([2, 0]))
    assert mean.read()[:, 0].tolist() == [2.0, 1.0, 2.0]
    assert mean.read(np.array([1, 2]))[:, 0].tolist() == [1.0, 2.0]


def test_notches_stand_where_the_rotors_of_each_aircraft_turn() -> None:
    """Rotors of one aircraft turn at 250 Hz, of the other at 350 Hz; both shake at 250 Hz."""
    filter_ = GyroFilter(GyroFilters(RpmFilter(1)), 2, 4, 1000, 4)
    speeds = np.repeat(np.array([[250.0], [350.0]], np.float32) * np.float32(2 * np.pi), 4, axis=1)
    shake = np.sin(2 * np.pi * 250.0 / 4000 * np.arange(4000)).astype(np.float32)
    seen = []
    for k, value in enumerate(shake):
        if k % 4 == 0 and k >= 2000:
            filter_.told(speeds)
        filter_.add(np.full((2, 3), value, np.float32))
        seen.append(filter_.read())
    before, behind = np.abs(seen[:2000]).max(axis=(0, 2)), np.abs(seen[3000:]).max(axis=(0, 2))
    assert before.tolist() == [1.0, 1.0], "not a bit changes while they stand"
    assert behind[0] < 0.01 and behind[1] > 0.5
    filter_.reset(np.array([0]))
    for value in shake[:40]:
        filter_.add(np.full((2, 3), value, np.float32))
    assert filter_.read()[0].tolist() == [shake[39]] * 3
