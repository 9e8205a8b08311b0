"""All tasks by name."""

from __future__ import annotations

from training.tasks.flight import FlightTask, PilotTask
from training.tasks.random_steps import RandomStepsTask
from training.tasks.recorded import RecordedTask
from training.tasks.task import ContinuousTask, EnvelopeTask, EpisodicTask, PulseTask, Task

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
