"""Work in processes of their own: begun, heard, and ended in one way.

Ctrl-C is for the process that began them, which ends them. Each computes on one thread: matrices here are
small, and more threads fight for the cores.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, Literal, NoReturn, Self, TypeVar
from weakref import WeakSet

from neuroflight.toolchain.errors import LinkError, NeuroflightError

T = TypeVar("T")
Show = Callable[[float], None]  # gets the part of a task that is done, 0..1
PART, DONE = "part", "done"  # what a process tells of a task
END_S = 10.0  # from the request to end to the kill: others may have to end before
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
_LINKS: WeakSet[Connection] = WeakSet()  # our ends, which a forked process must not hold


class Worker:
    """A process at work, and our end of the link to it. Use it in a `with`, or call `end`."""

    def __init__(
        self,
        work: Callable[..., None],
        *arguments: object,
        name: str,
        method: Literal["spawn", "fork"] = "spawn",
        quiet: bool = False,
    ) -> None:
        """work: called there with its end of the link and `arguments`. name: of it, in what it raises.

        spawn: a new interpreter. fork: it has what this process has, which must not have threads, as torch's,
        or a twin. quiet: what goes to its stderr is dropped.
        """
        context: Any = multiprocessing.get_context(method)
        self.link, theirs = context.Pipe()
        _LINKS.add(self.link)
        self.process = context.Process(
            target=_run, args=(theirs, name, quiet, work, arguments), daemon=True, name=name
        )
        with _interrupts_ignored(), _one_thread():  # the process inherits both
            self.process.start()
        theirs.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def hear(self) -> Any:  # noqa: ANN401 - whatever the process tells
        """Return what it tells next. Raises what it raised, EOFError if it is gone."""
        try:
            told = self.link.recv()
        except ConnectionError as error:
            raise EOFError from error
        if isinstance(told, Exception):
            raise told
        return told

    def end(self, *, kill: bool = False) -> None:
        """End it: asked to, so that it closes what it has open, or killed at once."""
        self.link.close()
        if not kill:
            self.process.terminate()
            self.process.join(END_S)
        self.process.kill()
        self.process.join()


class Crew(Generic[T]):
    """Forked processes that run `tasks`, at most `jobs` at a time, in their order. Use it in a `with`.

    Each runs one task after another until none is left. Nothing is shared, so that results are the same as
    one after another. It must be made while this process has one thread. Leaving it early ends the processes.
    """

    def __init__(self, tasks: Sequence[Callable[[Show], T]], jobs: int) -> None:
        """tasks: each gets what hears of its progress, and returns something that can be pickled."""
        self._tasks = list(tasks)
        self._waiting = list(range(len(self._tasks)))
        self._results: dict[int, T] = {}
        self._parts: dict[int, float] = {}  # done so far, of each task that has begun
        self._workers = {
            worker.link: worker
            for worker in (
                Worker(self._work, name="a flight's process", method="fork")
                for _ in range(min(jobs, len(self._tasks)))
            )
        }
        self._idle = list(self._workers)
        self._assign()

    def __enter__(self) -> Crew[T]:
        return self

    def __exit__(self, *_: object) -> None:
        """End all processes at once."""
        for worker in self._workers.values():
            worker.process.terminate()
        for worker in self._workers.values():
            worker.end()

    def poll(self, timeout: float | None = 0.0) -> dict[int, float]:
        """Take in what the processes tell, and wait for it for `timeout` [s]; None: until they do.

        Returns the part that is done of each task that has begun, by its number. Raises the error of a task
        that failed, LinkError if a process is gone.
        """
        ready = [link for link in self._workers if not link.closed and link not in self._idle]
        for link in wait(ready, timeout):
            assert isinstance(link, Connection)
            try:
                kind, number, told = self._workers[link].hear()
            except EOFError as error:
                raise LinkError("a flight's process ended early; is memory short? try --jobs 1") from error
            self._parts[number] = 1.0 if kind == DONE else told
            if kind == DONE:
                self._results[number] = told
                self._idle.append(link)
        self._assign()
        return self._parts

    def results(self, shows: Sequence[Show]) -> list[T]:
        """Return the results of all tasks, in their order. shows: what hears of the progress of each."""
        while len(self._results) < len(self._tasks):
            for number, part in self.poll(None).items():
                shows[number](part)
        return [self._results[number] for number in range(len(self._tasks))]

    def _assign(self) -> None:
        while self._idle and self._waiting:
            with suppress(ConnectionError):  # its end shows in the next poll
                link = self._idle.pop()
                link.send(self._waiting.pop(0))

    def _work(self, link: Connection) -> None:
        """Run the tasks whose numbers come, in a process."""
        while True:
            number = link.recv()
            link.send((DONE, number, self._tasks[number](_teller(link, number))))


def usable_cores() -> int:
    """Return the number of cores that this process may run on."""
    return len(os.sched_getaffinity(0))


def _teller(link: Connection, number: int) -> Show:
    return lambda part: link.send((PART, number, part))


def _run(
    link: Connection, name: str, quiet: bool, work: Callable[..., None], arguments: Sequence[object]
) -> None:
    """Do the work of a process, and tell what it raises."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    for ours in list(_LINKS):  # an end is seen only when nobody else holds it
        ours.close()
    if quiet:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    with suppress(EOFError, ConnectionError):  # nobody listens any more
        try:
            work(link, *arguments)
        except NeuroflightError as error:
            link.send(error)
        except Exception as error:  # the first process reports it
            link.send(RuntimeError(f"{name} failed: {type(error).__name__}: {error}"))


def _leave(number: int, frame: object) -> NoReturn:
    """Let what is open be closed on the way out."""
    raise SystemExit(number)


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Ignore Ctrl-C in the block, and in processes that start in it."""
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set handlers
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Have processes that start meanwhile compute on one thread."""
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
