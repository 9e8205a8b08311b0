"""The command as a process of its own that is forked: it has all that the tests' process has imported."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys

from neuroflight.cli.main import main


def _run(words: tuple[str, ...], out: int, err: int) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number, end in ((1, out), (2, err)):
        os.dup2(end, number)
        os.close(end)
    sys.stdout, sys.stderr = (open(number, "w", buffering=1, closefd=False) for number in (1, 2))  # noqa: SIM115
    sys.exit(main(list(words)))


class Forked:
    """`neuroflight` with these words, with the methods of subprocess.Popen that tests need."""

    def __init__(self, *words: str) -> None:
        out, err = os.pipe(), os.pipe()
        fork = multiprocessing.get_context("fork")
        self._process = fork.Process(target=_run, args=(words, out[1], err[1]))
        self._process.start()
        for end in (out, err):
            os.close(end[1])
        self.stdout, self.stderr = (os.fdopen(end[0], encoding="utf-8") for end in (out, err))

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        return self._process.exitcode

    def send_signal(self, number: signal.Signals) -> None:
        assert self._process.pid is not None
        os.kill(self._process.pid, number)

    def kill(self) -> None:
        self._process.kill()

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Wait for its end; what it said that was not read, a pipe's 64 KiB at most."""
        self._process.join(timeout)
        assert self._process.exitcode is not None, "it has not ended"
        with self.stdout, self.stderr:
            return self.stdout.read(), self.stderr.read()
