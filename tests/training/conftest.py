"""Trainings of these tests fly their checkpoints in the process of the test."""

from __future__ import annotations

import pytest

from neuroflight.training.checkpoints.monitor_process import Monitor


@pytest.fixture(autouse=True)
def monitor_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Save a process with torch for each run: its metrics are the same, as test_monitor.py holds."""
    init = Monitor.__init__

    def here(self: Monitor, *known: object, apart: bool = False) -> None:
        init(self, *known)  # type: ignore[arg-type]

    monkeypatch.setattr(Monitor, "__init__", here)
