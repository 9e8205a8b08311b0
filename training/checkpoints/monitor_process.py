"""Runs the monitor in this process, or in a process of its own beside the training.

The twin is imported late, so that the other process has redirected its stderr before that happens.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from neuroflight.toolchain.errors import NeuroflightError, TrainingError

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
        self._process: multiprocessing.process.BaseProcess | None = None
        self._link: Connection | None = None
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
        if self._link is None:
            self._begin()
        assert self._link is not None
        self._link.send((steps, weights))
        self._waiting += 1

    def collect(self, *, wait: bool = False) -> list[CheckpointMetrics]:
        """Return the metrics since the last call; wait: those of all submitted policies."""
        while self._link is not None and self._waiting and (wait or self._link.poll()):
            try:
                answer = self._link.recv()
            except (EOFError, ConnectionError) as error:
                raise TrainingError(
                    "the monitor's process ended early; is memory short? --resume goes on from the checkpoint"
                ) from error
            self._waiting -= 1
            if isinstance(answer, Exception):
                raise answer
            self._ready.append(answer)
        ready, self._ready = self._ready, []
        return ready

    def close(self) -> None:
        """Kill the other process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None
        if self._link is not None:
            self._link.close()
            self._link = None

    def _begin(self) -> None:
        context = multiprocessing.get_context("spawn")  # a fork would share torch's threads and the twin
        self._link, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,), daemon=True, name="monitor")
        with interrupts_ignored():  # the other process inherits it: only this one handles Ctrl-C
            self._process.start()
        theirs.close()
        self._link.send((self._aircraft, self._config))


def _work(link: Connection) -> None:
    """Fly the policies that arrive until the other end of the link is closed."""
    # The physics client prints a greeting on stderr; errors go back by the link.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        aircraft, config = link.recv()
        from neuroflight.training.checkpoints.monitor import fly

        while True:
            steps, weights = link.recv()
            link.send(_tried(fly, aircraft, config, steps, weights))
    except (EOFError, ConnectionError):
        return


def _tried(fly: Any, *args: Any) -> CheckpointMetrics | Exception:  # noqa: ANN401 - of training.checkpoints.monitor
    try:
        metrics: CheckpointMetrics = fly(*args)
        return metrics
    except NeuroflightError as error:
        return error
    except Exception as error:  # the training process reports it
        return RuntimeError(f"the monitor failed: {type(error).__name__}: {error}")


@contextmanager
def interrupts_ignored() -> Iterator[None]:
    """Ignore Ctrl-C in the block, and in processes that start in it."""
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set handlers
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
