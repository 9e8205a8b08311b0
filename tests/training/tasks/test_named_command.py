"""A named command in the episodes of other tasks."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.training.tasks.named_command import NamedCommand
from neuroflight.training.tasks.task import EnvelopeTask, EpisodicTask, PulseTask

RATE_HZ = 1000
COMMAND = (120.9, -72.2, 286.5)


@pytest.mark.parametrize(
    ("task", "begin", "end"),
    [(PulseTask(), 500, 2500), (EpisodicTask(), 0, 1000), (EnvelopeTask(hold_s=0.5), 0, 500)],
)
def test_every_episode_commands_it_when_the_task_does(
    task: PulseTask | EpisodicTask, begin: int, end: int
) -> None:
    named = NamedCommand(task, COMMAND)
    setpoints = np.rad2deg(named.episodes(3, np.random.default_rng(1), RATE_HZ))
    assert setpoints.shape == (3, round(named.duration_s * RATE_HZ), 3)
    assert setpoints[:, begin:end] == pytest.approx(np.broadcast_to(COMMAND, (3, end - begin, 3)), rel=1e-6)
    assert not setpoints[:, :begin].any() and not setpoints[:, end:].any()
