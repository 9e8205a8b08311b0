"""All tasks by name."""

from __future__ import annotations

from neuroflight.training.tasks.flight import FlightTask, PilotTask
from neuroflight.training.tasks.random_steps import RandomStepsTask
from neuroflight.training.tasks.recorded import RecordedTask
from neuroflight.training.tasks.task import ContinuousTask, EnvelopeTask, EpisodicTask, PulseTask, Task

TASKS: dict[str, type[Task]] = {
    task.name: task
    for task in (
        PulseTask,
        FlightTask,
        PilotTask,
        EpisodicTask,
        EnvelopeTask,
        ContinuousTask,
        RecordedTask,
        RandomStepsTask,
    )
}
