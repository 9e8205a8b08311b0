"""The whole control task on ARM code, as `make bench` counts it, against what it may take."""

from __future__ import annotations

import pytest

LOGGED_BETWEEN_BAR = 25  # instructions
STEPS = 300  # armed: commands, receiver frames, and the step that arms


@pytest.mark.slow
def test_the_control_task_keeps_to_its_bars_when_a_flight_is_played() -> None:
    from tests.bench.firmware import CYCLES_BAR, LOGGED_BAR, POLICY, VARIES_BAR, rows

    measured = rows(STEPS)
    assert [row.policy for row in measured] == [POLICY]
    for row in measured:
        assert row.steps == STEPS
        if row.cycles is not None:  # without llvm-mca there are none
            assert row.cycles[1] <= CYCLES_BAR, row
        assert row.varies <= VARIES_BAR, row
        assert 0 < row.logged <= LOGGED_BAR, row
        assert 0 < row.logged_between <= LOGGED_BETWEEN_BAR, row
