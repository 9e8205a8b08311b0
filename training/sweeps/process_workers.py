"""Runs of a sweep in processes of this machine, without Ray."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from neuroflight.training.sweeps.jobs import FAILURES_MAX, THREADS, End, Job, SweepCallback, do


@dataclass(frozen=True, eq=False)
class _Worker:
    """A process at work on a run."""

    job: Job
    process: BaseProcess
    link: Connection

    @property
    def number(self) -> int:
        return self.job.trial.number


def run_jobs(jobs: Sequence[Job], out: Path, cpus: int, callback: SweepCallback) -> None:
    """Do all runs, at most `cpus` at a time, each in a process of its own.

    A run whose process dies is resumed in another one, up to FAILURES_MAX times.
    """
    open_jobs, deaths = deque(jobs), dict.fromkeys((job.trial.number for job in jobs), 0)
    active: dict[Connection, _Worker] = {}
    try:
        while open_jobs or active:
            while open_jobs and len(active) < cpus:
                worker = _start(open_jobs.popleft(), out)
                active[worker.link] = worker
            for link in wait(list(active)):
                assert isinstance(link, Connection)
                worker = active[link]
                try:
                    news = link.recv()
                except (EOFError, ConnectionError):  # it is dead; what it says last is its End
                    _close(active.pop(link))
                    deaths[worker.number] += 1
                    if deaths[worker.number] <= FAILURES_MAX:
                        open_jobs.appendleft(worker.job)
                        callback.restarted(worker.number)
                    else:
                        status = f"at last with status {worker.process.exitcode}"
                        times = f"ended {FAILURES_MAX + 1} times before it was done"
                        callback.failed(worker.number, f"{times}, {status}")
                    continue
                if isinstance(news, End):
                    _close(active.pop(link))
                    if news.finished:
                        callback.finished(worker.number)
                    elif news.reason:
                        callback.failed(worker.number, news.reason)
                else:
                    steps, reward = news
                    callback.progressed(worker.number, steps, reward, worker.process.pid or 0)
    finally:
        for worker in active.values():
            worker.process.kill()
            _close(worker)


def _start(job: Job, out: Path) -> _Worker:
    context = multiprocessing.get_context("spawn")  # a fork would share torch's threads and the twin
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(job, out, theirs), daemon=True)
    with _one_thread():
        process.start()
    theirs.close()
    return _Worker(job, process, ours)


def _close(worker: _Worker) -> None:
    worker.link.close()
    worker.process.join()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes started meanwhile compute on one thread: small matrices gain nothing from more."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(THREADS)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _work(job: Job, out: Path, link: Connection) -> None:
    """Do a job in a process, which ignores Ctrl-C: the process that started it asks it to stop."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    link.send(do(job, out, lambda steps, reward: link.send((steps, reward))))
