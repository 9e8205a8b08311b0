"""Which tasks there are, by name."""

from __future__ import annotations

from training.task import EnvelopeTask, EpisodicTask, PulseTask, Task

TASKS: dict[str, type[Task]] = {task.name: task for task in (PulseTask, EpisodicTask, EnvelopeTask)}
