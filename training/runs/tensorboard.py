"""Writes a run's figures for TensorBoard."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from neuroflight.training.checkpoints.metrics import CheckpointMetrics, Spread
from neuroflight.training.runs.train import Callback, Progress


class TensorBoard(Callback):
    """A writer of event files; a step in them is a control step."""

    def __init__(self, folder: Path, resumed: int | None = None) -> None:
        """resumed: steps of the checkpoint that the run resumes from; later events are discarded."""
        self._folder = folder
        self._purge = None if resumed is None else resumed + 1
        self._writer: SummaryWriter | None = None  # created with the first figure

    def progressed(self, progress: Progress) -> None:
        self._add("train/reward", progress.reward, progress.steps)
        for name, value in progress.figures.items():
            self._add(name, value, progress.steps)
        self._add("time/seconds", progress.seconds, progress.steps)

    def monitored(self, metrics: CheckpointMetrics) -> None:
        for field in fields(metrics):
            spread = getattr(metrics, field.name)
            if isinstance(spread, Spread):
                for end in fields(spread):
                    self._add(f"monitor_{end.name}/{field.name}", getattr(spread, end.name), metrics.steps)

    def close(self) -> None:
        """Finish the event file."""
        if self._writer is not None:
            self._writer.close()  # type: ignore[no-untyped-call]

    def _add(self, name: str, value: float, steps: int) -> None:
        if self._writer is None:
            self._writer = SummaryWriter(str(self._folder), purge_step=self._purge)  # type: ignore[no-untyped-call]
        self._writer.add_scalar(name, value, steps)  # type: ignore[no-untyped-call]
