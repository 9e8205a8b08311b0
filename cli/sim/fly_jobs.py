"""`neuroflight fly`: several flights at a time, each in a process forked from this one.

A forked process has everything that a flight needs, imported and read: none starts a new interpreter. Each
flies one flight after another until none is left. Nothing is shared, so that flights are the same as one
after another.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Generic, NoReturn, TypeVar

from neuroflight.toolchain.errors import LinkError, NeuroflightError

T = TypeVar("T")
Show = Callable[[float], None]  # gets the flown part of a flight, 0..1
PART, DONE, FAILED = "part", "done", "failed"  # what a process tells of a task
END_S = 2.0  # from the request to end to the kill


def usable_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0))


class Crew(Generic[T]):
    """Processes that run `tasks`, at most `jobs` at a time, in their order. Use it in a `with`.

    It must be made while this process has one thread. Leaving it early ends the processes.
    """

    def __init__(self, tasks: Sequence[Callable[[Show], T]], jobs: int) -> None:
        """tasks: each gets what hears of its progress, and returns something that can be pickled."""
        self._tasks = list(tasks)
        self._waiting = list(range(len(self._tasks)))
        self._results: dict[int, T] = {}
        self._parts: dict[int, float] = {}  # flown so far, of each task that has begun
        context = multiprocessing.get_context("fork")
        pipes = [context.Pipe() for _ in range(min(jobs, len(self._tasks)))]
        self._links = [ours for ours, _ in pipes]
        self._processes = [
            context.Process(target=self._work, args=(number, pipes), daemon=True)
            for number in range(len(pipes))
        ]
        for process in self._processes:
            process.start()
        for _, theirs in pipes:
            theirs.close()
        self._idle = list(self._links)
        self._assign()

    def __enter__(self) -> Crew[T]:
        return self

    def __exit__(self, *_: object) -> None:
        """End all processes at once."""
        for link in self._links:
            link.close()
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join(END_S)
            if process.is_alive():
                process.kill()
                process.join()

    def poll(self, timeout: float | None = 0.0) -> dict[int, float]:
        """Take in what the processes tell, and wait for it for `timeout` [s]; None: until they do.

        Returns the flown part of each task that has begun, by its number. Raises the error of a task that
        failed, LinkError if a process is gone.
        """
        ready = [link for link in self._links if not link.closed and link not in self._idle]
        for link in wait(ready, timeout):
            assert isinstance(link, Connection)
            try:
                kind, number, told = link.recv()
            except (EOFError, ConnectionError) as error:
                raise LinkError("a flight's process ended early; is memory short? try --jobs 1") from error
            if kind == FAILED:
                raise told
            self._parts[number] = 1.0 if kind == DONE else told
            if kind == DONE:
                self._results[number] = told
                self._idle.append(link)
        self._assign()
        return self._parts

    def results(self, shows: Sequence[Show]) -> list[T]:
        """Results of all tasks, in their order. shows: what hears of the progress of each."""
        while len(self._results) < len(self._tasks):
            for number, part in self.poll(None).items():
                shows[number](part)
        return [self._results[number] for number in range(len(self._tasks))]

    def _assign(self) -> None:
        while self._idle and self._waiting:
            with suppress(ConnectionError):  # its end shows in the next poll
                link = self._idle.pop()
                link.send(self._waiting.pop(0))

    def _work(self, process: int, pipes: Sequence[tuple[Connection, Connection]]) -> None:
        """Of process number `process`: run the tasks whose numbers come."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process handles Ctrl-C
        signal.signal(signal.SIGTERM, _leave)
        link = pipes[process][1]
        for ours, theirs in pipes:  # an end is seen only when nobody else holds it
            ours.close()
            if theirs is not link:
                theirs.close()
        with suppress(EOFError, ConnectionError, KeyboardInterrupt):
            while True:
                number = link.recv()
                link.send(self._tried(number, link))

    def _tried(self, number: int, link: Connection) -> tuple[str, int, object]:
        """What to tell of a task that is over."""
        try:
            return DONE, number, self._tasks[number](lambda part: link.send((PART, number, part)))
        except NeuroflightError as error:
            return FAILED, number, error
        except ConnectionError:  # the first process is gone
            raise
        except Exception as error:  # the first process reports it
            said = f"{type(error).__name__}: {error}"
            return FAILED, number, RuntimeError(f"a flight's process failed: {said}")


def _leave(number: int, frame: object) -> NoReturn:
    """Let what is open be closed on the way out."""
    raise SystemExit(number)
