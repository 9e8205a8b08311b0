"""Runs the monitor in this process, or in a process of its own beside the training.

The twin is imported late, so that the other process has redirected its stderr before that happens.
"""

from __future__ import annotations

from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.workers import Worker

if TYPE_CHECKING:
    import torch

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.training.checkpoints.metrics import CheckpointMetrics
    from neuroflight.training.checkpoints.monitor import Weights
    from neuroflight.training.config.training_config import TrainingConfig


class Monitor:
    """A monitor that takes policies and returns their metrics in the same order. The metrics are the same
    either way.

    A context manager; leaving it ends the other process, if there is one.
    """

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, *, apart: bool = False) -> None:
        """apart: in a process of its own, started with the first policy; otherwise in this one."""
        self._aircraft, self._config, self._apart = aircraft, config, apart
        self._worker: Worker | None = None
        self._waiting = 0  # policies in the other process
        self._ready: list[CheckpointMetrics] = []

    def __enter__(self) -> Monitor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def submit(self, steps: int, policy: dict[str, torch.Tensor]) -> None:
        """Have a policy flown. Raises PolicyError on weights that make no policy."""
        weights: Weights = {name: tensor.detach().cpu().numpy() for name, tensor in policy.items()}
        if not self._apart:
            from neuroflight.training.checkpoints.monitor import fly

            self._ready.append(fly(self._aircraft, self._config, steps, weights))
            return
        if self._worker is None:
            self._worker = Worker(_work, name="the monitor", quiet=True)
            self._worker.link.send((self._aircraft, self._config))
        self._worker.link.send((steps, weights))
        self._waiting += 1

    def collect(self, *, wait: bool = False) -> list[CheckpointMetrics]:
        """Return the metrics since the last call; wait: those of all submitted policies."""
        while self._worker is not None and self._waiting and (wait or self._worker.link.poll()):
            try:
                self._ready.append(self._worker.hear())
            except EOFError as error:
                raise TrainingError(
                    "the monitor's process ended early; is memory short? --resume goes on from the checkpoint"
                ) from error
            self._waiting -= 1
        ready, self._ready = self._ready, []
        return ready

    def close(self) -> None:
        """Kill the other process."""
        if self._worker is not None:
            self._worker.end(kill=True)
            self._worker = None


def _work(link: Connection) -> None:
    """Fly the policies that arrive."""
    aircraft, config = link.recv()
    from neuroflight.training.checkpoints.monitor import fly

    while True:
        steps, weights = link.recv()
        link.send(fly(aircraft, config, steps, weights))
