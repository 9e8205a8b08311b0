from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.physics.delay import CommandDelay


def given(sample: int, count: int = 2) -> np.ndarray:
    """Commands of a sample, told apart by their value."""
    return np.full((count, 4), sample / 100)


@pytest.mark.parametrize("delay", [1, 3])
def test_a_command_acts_after_so_many_samples(delay: int) -> None:
    line = CommandDelay(2, 4, delay)
    acting = [line.step(given(k))[0, 0] * 100 for k in range(1, 10)]
    assert acting == pytest.approx([0.0] * delay + list(range(1, 10 - delay)))


def test_each_aircraft_has_its_own_delay_and_keeps_those_under_way_when_varied() -> None:
    line = CommandDelay(2, 4, 2)
    for k in range(1, 5):
        line.step(given(k))
    line.vary(np.array([1, 4]))  # the first command has acted already and is gone
    acting = [line.step(given(k))[:, 0] * 100 for k in range(5, 9)]
    assert np.array(acting) == pytest.approx(np.array([[4, 0], [5, 2], [6, 3], [7, 4]]))


def test_commands_of_one_aircraft_are_zero_when_it_is_reset() -> None:
    line = CommandDelay(2, 4, 3)
    for k in range(1, 5):
        line.step(given(k))
    line.reset(np.array([1]))
    assert line.step(given(5))[:, 0] * 100 == pytest.approx([2, 0])


def test_a_command_out_of_range_is_refused_also_after_a_good_one() -> None:
    line = CommandDelay(1, 4, 1)
    line.step(np.full((1, 4), 0.5))
    for wrong in (1.01, -0.01, np.nan):
        with pytest.raises(ValueError, match=r"expected 0\.\.1"):
            line.step(np.full((1, 4), wrong))
    with pytest.raises(ValueError, match="shape"):
        line.step(np.full(4, 0.5))
