"""The whole control task on ARM code, as `make bench` counts it, against what it may take."""

from __future__ import annotations

import pytest

LOGGED_BETWEEN_BAR = 25  # instructions
STEPS = 300  # armed: commands, receiver frames, and the step that arms


@pytest.mark.slow
def test_the_control_task_keeps_to_its_bars_when_it_flies_as_delivered_and_by_all_that_escs_tell() -> None:
    from tests.bench.firmware import CYCLES_BAR, FLIGHTS, LOGGED_BAR, VARIES_BAR, rows

    measured = rows(STEPS)
    assert [row.flight for row in measured] == list(FLIGHTS)
    for row in measured:
        assert row.steps >= STEPS
        if row.cycles is not None:  # without llvm-mca there are none
            assert row.cycles[1] <= CYCLES_BAR, row
        assert row.varies <= VARIES_BAR, row
        assert 0 < row.logged <= LOGGED_BAR, row
        assert 0 < row.logged_between <= LOGGED_BETWEEN_BAR, row
    delivered, told = measured
    assert told.instructions[0] > delivered.instructions[0] + 500, "it hears its ESCs and filters by them"
