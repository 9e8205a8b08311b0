"""Peers of the tests of flash: what answers MSP from a script, and host programs that run as boards do."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.link.msp import Decoder, Message, encode, error, reply
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain.contract import Msp

Answer = Callable[[bytes], bytes]
Reply = bytes | Callable[[bytes], bytes] | None
START_S = 10.0  # from start to its `ready` line


def answering(
    replies: Mapping[int, Reply], asked: list[tuple[int, bytes]] | None = None, through: str = ""
) -> Answer:
    """Answer by `replies`: a payload, a function of the true one, None to refuse.

    through: port of the firmware that answers all else; without one it is refused. asked: gets requests.
    """
    decoder, client = Decoder(), Client(open_transport(through)) if through else None

    def payload(message: Message) -> bytes | None:
        told = replies.get(message.command)
        if isinstance(told, bytes) or client is None or (told is None and message.command in replies):
            return told if isinstance(told, bytes) else None
        try:
            true = client.request(Msp(message.command), message.payload)
        except RefusedError:
            return None
        return true if told is None else told(true)

    def one(message: Message) -> bytes:
        if asked is not None:
            asked.append((message.command, message.payload))
        told = payload(message)
        return encode(error(message) if told is None else reply(message, told))

    return lambda data: b"".join(one(event) for event in decoder.feed(data) if isinstance(event, Message))


@dataclass(frozen=True)
class Run:
    """A function that runs a command: exit code, stdout, stderr."""

    run: Callable[..., tuple[int, str, str]]

    def __call__(self, *words: object, **how: object) -> tuple[int, str, str]:
        return self.run(*words, **how)

    def told(self, *words: object, **how: object) -> str:
        """What it prints; it must succeed."""
        code, out, err = self.run(*words, **how)
        assert (code, err) == (0, "")
        return out

    def refused(self, *words: object, **how: object) -> str:
        """The line in which it fails; it must print nothing else."""
        code, out, err = self.run(*words, **how)
        assert (code, out) == (1, "")
        return err


class HostBoard:
    """The host program with a flash of its own on one port, as a board is: started again whenever it ends.

    restarts: or stays away once it has ended. No sample ever comes to it, so that its motors stand.
    """

    def __init__(self, program: Path, flash: Path, restarts: bool = True) -> None:
        self.program, self.flash, self.restarts = program, flash, restarts
        self.starts = 0
        self._number, self._stopping = "0", False
        self._process = self._start()
        self._thread = threading.Thread(target=self._keep, daemon=True)
        self._thread.start()

    @property
    def port(self) -> str:
        return f"tcp:127.0.0.1:{self._number}"

    def _start(self) -> subprocess.Popen[str]:
        free = [f"--{name}-port=0" for name in ("state", "receiver", "power")]
        own = [f"--settings={self.flash}", f"--msp-port={self._number}", "--with-parent"]
        command = [str(self.program), "--gyro-hz=1000", *own, *free]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        self._number = dict(word.split("=") for word in process.stdout.readline().split()[1:])["msp"]
        self.starts += 1
        return process

    def _keep(self) -> None:
        while True:
            self._process.communicate()
            if self._stopping or not self.restarts:
                return
            self._process = self._start()

    def interrupt(self) -> None:
        """End the program; it is started again, as when the cable that powers a board is pulled."""
        self._process.kill()

    def close(self) -> None:
        self._stopping = True
        end = time.monotonic() + START_S
        while self._thread.is_alive() and time.monotonic() < end:
            self._process.terminate()  # the one that may just have been started, too
            self._thread.join(timeout=0.05)


@contextmanager
def host_board(program: Path, flash: Path, restarts: bool = True) -> Iterator[HostBoard]:
    """A HostBoard, closed at the end."""
    board = HostBoard(program, flash, restarts)
    try:
        yield board
    finally:
        board.close()
