"""Runs of a sweep in processes of this machine, without Ray."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path

from neuroflight.toolchain.workers import Worker
from neuroflight.training.sweeps.jobs import FAILURES_MAX, End, Job, SweepCallback, do


def run_jobs(jobs: Sequence[Job], out: Path, cpus: int, callback: SweepCallback) -> None:
    """Do all runs, at most `cpus` at a time, each in a process of its own.

    A run whose process dies is resumed in another one, up to FAILURES_MAX times.
    """
    open_jobs, deaths = deque(jobs), dict.fromkeys((job.trial.number for job in jobs), 0)
    active: dict[Connection, tuple[Job, Worker]] = {}
    try:
        while open_jobs or active:
            while open_jobs and len(active) < cpus:
                job = open_jobs.popleft()
                worker = Worker(_work, job, out, name=f"run {job.trial.number}")
                active[worker.link] = job, worker
            for link in wait(list(active)):
                assert isinstance(link, Connection)
                job, worker = active[link]
                number = job.trial.number
                try:
                    news = worker.hear()
                except (EOFError, RuntimeError) as error:  # it died: a run's last news is End
                    del active[link]
                    worker.process.join()
                    worker.end(kill=True)
                    deaths[number] += 1
                    if deaths[number] <= FAILURES_MAX:
                        open_jobs.appendleft(job)
                        callback.restarted(number)
                    else:
                        why = str(error) or f"status {worker.process.exitcode}"
                        times = f"ended {FAILURES_MAX + 1} times before it was done"
                        callback.failed(number, f"{times}, at last with {why}")
                    continue
                if isinstance(news, End):
                    del active[link]
                    worker.end(kill=True)
                    if news.finished:
                        callback.finished(number)
                    elif news.reason:
                        callback.failed(number, news.reason)
                else:
                    steps, reward = news
                    callback.progressed(number, steps, reward, worker.process.pid or 0)
    finally:
        for _, worker in active.values():
            worker.end(kill=True)


def _work(link: Connection, job: Job, out: Path) -> None:
    """Do a run. Ctrl-C is for the process that began this one, which asks it to stop."""
    link.send(do(job, out, lambda steps, reward: link.send((steps, reward))))
