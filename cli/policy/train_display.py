"""The progress of a training run on stderr: a bar, or in a log a line for each checkpoint."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from neuroflight.training.checkpoints.metrics import CheckpointMetrics
from neuroflight.training.runs.train import Callback
from neuroflight.training.runs.train import Progress as State


class Display(Callback):
    """The display of one run, as a context manager."""

    def __init__(self, name: str, steps: int, done: int = 0) -> None:
        """name, steps: of the run; done: steps before it was resumed."""
        self._console = Console(stderr=True)
        self._name = name
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=16),
            TextColumn("{task.completed:,.0f} of {task.total:,.0f}{task.fields[speed]}"),
            TimeRemainingColumn(),
        )
        self._bar = Progress(*columns)
        self._task = self._bar.add_task(name, total=steps, completed=done, speed="")
        self._first: State | None = None  # start of the speed measurement
        self._reward, self._metrics = "", ""
        self._live = Live(console=self._console, refresh_per_second=4, transient=True)

    def __enter__(self) -> Display:
        if self._console.is_terminal:
            self._live.update(self._bar)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live.is_started:
            self._live.stop()

    def progressed(self, progress: State) -> None:
        """Show the progress, see Callback."""
        self._first = self._first or progress
        steps, seconds = progress.steps - self._first.steps, progress.seconds - self._first.seconds
        speed = f" · {steps / seconds:,.0f}/s" if seconds > 0 else ""
        if progress.note:
            self._console.print(f"{self._name}, {progress.note}", highlight=False, soft_wrap=True)
        self._reward = f"training reward {progress.reward:.3f}"
        self._bar.update(self._task, completed=progress.steps, speed=speed)
        self._show()

    def monitored(self, metrics: CheckpointMetrics) -> None:
        """Show the figures of a checkpoint, see Callback."""
        self._metrics = f"at {metrics.steps:,} steps: {figures(metrics)}"
        if self._console.is_terminal:
            self._show()
        else:
            self._console.print(f"{self._name}, {self._metrics}", highlight=False, soft_wrap=True)

    def _show(self) -> None:
        line = " · ".join(part for part in (self._reward, self._metrics) if part)
        self._live.update(Group(self._bar, Text(line, style="dim")))


def figures(metrics: CheckpointMetrics) -> str:
    """Return the main figures, in one line."""
    return (
        f"MAE {metrics.mae.mean:.2f} deg/s, ū {metrics.output.mean:.3f}, |Δu| {metrics.change.mean:.4f}, "
        f"reward {metrics.reward.mean:.3f}"
    )
