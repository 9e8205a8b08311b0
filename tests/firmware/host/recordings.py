"""Visits of the Betaflight app as they were recorded, replayed in order at the host program's TCP port.

A recording has a line for each thing that happened. Numbers are MSP's, payloads hexadecimal:

    connect                 a connection, what the app asks first, and its first tab
    NUMBER [HEX] = [HEX]    a request, and the reply to it
    NUMBER [HEX] refused    a request that is refused on purpose
    reads NUMBER[/HEX]:COUNT ...  requests of a tab, and the bytes of each reply, which is not looked at
    poll [N]                N times (once): 250 ms, and what it asks then, whatever tab is shown
    frame LINE              a command line in a frame, answered without an error
    frame! LINE             likewise, with one
    typed TEXT              for the command line (\\n, \\r as such): its next prompt comes without an error
    + MS                    time that passes, with sticks down and the arm switch off
    turning MOTORS          which motors turn then, by number; 0: none
    ends                    the program has ended by itself, as told, and is started anew
    power                   the power goes and comes back
    stored SETTINGS         what differs from the defaults after that, as the command line sets it, ; between

What begins with # says what the pilot did.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from neuroflight.flash.link.msp import Decoder, Direction, Message, encode, request

GYRO_HZ = 1000
POLL, POLL_MS = (110, 130, 116, 150), 250
# What the app asks when it has connected, before it shows a tab.
HANDSHAKE = (
    *((1, ""), (2, ""), (3, ""), (5, ""), (4, ""), (101, ""), (160, ""), (12294, "05"), (12294, "02")),
    *((12294, "01"), (99, "0100"), (246, "0db8086ba002"), (36, ""), (32, ""), (80, ""), (70, ""), (79, "")),
)
FIRST_TAB = "240:4 12300:6 42:2 126:11 90:20"
REFUSED_AT_FIRST = {(12294, "05"), (246, "0db8086ba002")}  # the build's key, the time of day
ENDS = ("save", "exit")  # a session, with a restart
STX, ETX, PROMPT, LAST_WORD = b"\x02", b"\x03", b"\r\n# ", b"Rebooting\r\n"


class Replay:
    """The program that a recording is replayed at, and the app's connection to it."""

    def __init__(self, start: Callable[..., Any], build: Path, flash: Path) -> None:
        """flash: where the program keeps what is stored."""
        self._begin, self._build, self._flash = start, build, flash
        self._program = self._start()
        self._motors: tuple[float, ...] = ()
        self._peer: socket.socket | None = None
        self._decoder = Decoder()

    def _start(self) -> Any:
        return self._begin(f"--gyro-hz={GYRO_HZ}", f"--settings={self._flash}", build=self._build)

    def do(self, line: str) -> None:
        """Do what a line of a recording says. Raises AssertionError where something else comes of it."""
        word, _, rest = line.partition(" ")
        known: dict[str, Callable[[str], None]] = {
            "connect": self._connect,
            "reads": self._reads,
            "poll": lambda times: self._poll(int(times or 1)),
            "frame": self._frame,
            "frame!": lambda command: self._frame(command, error=True),
            "typed": self._typed,
            "+": lambda ms: self._run(int(ms)),
            "turning": self._turning,
            "ends": self._ends,
            "power": self._power,
            "stored": self._stored,
        }
        if word in known:
            known[word](rest)
        elif word != "#":
            self._request(line)

    def _connect(self, _: str) -> None:
        self._peer, self._decoder = self._program.connect(), Decoder()
        for number, payload in HANDSHAKE:
            told = self._ask(number, bytes.fromhex(payload))
            assert (told is None) == ((number, payload) in REFUSED_AT_FIRST), (number, payload)
        self._reads(FIRST_TAB)

    def _reads(self, requests: str) -> None:
        for each in requests.split():
            asked, count = each.split(":")
            number, _, payload = asked.partition("/")
            reply = self._ask(int(number), bytes.fromhex(payload))
            assert reply is not None and len(reply) == int(count), each

    def _poll(self, times: int) -> None:
        for _ in range(times):
            self._run(POLL_MS)
            for number in POLL:
                assert self._ask(number, b"") is not None, number

    def _ask(self, number: int, payload: bytes) -> bytes | None:
        """The reply, None: it was refused."""
        assert self._peer is not None
        self._peer.sendall(encode(request(number, payload)))
        while True:
            data = self._peer.recv(4096)
            assert data, f"hung up at {number}"
            for event in self._decoder.feed(data):
                assert isinstance(event, Message), event
                assert event.command == number
                return event.payload if event.direction == Direction.REPLY else None

    def _request(self, line: str) -> None:
        asked, sign, told = (part.strip() for part in line.partition("="))
        number, *payload = asked.removesuffix("refused").split()
        reply = self._ask(int(number), bytes.fromhex("".join(payload)))
        assert (reply is None) == asked.endswith("refused") == (sign == ""), "refused, or not"
        assert reply is None or reply.hex() == told

    def _frame(self, command: str, error: bool = False) -> None:
        assert self._peer is not None
        self._peer.sendall(STX + command.encode() + b"\n" + ETX)
        said = self._read_to(LAST_WORD if command in ENDS else ETX)
        assert said.startswith(STX)
        assert (b"###ERROR" in said) == error, said

    def _typed(self, text: str) -> None:
        assert self._peer is not None
        typed = text.encode().decode("unicode_escape")
        self._peer.sendall(typed.encode())
        said = self._read_to(LAST_WORD if typed.strip() in ENDS else PROMPT)
        assert b"###ERROR" not in said, said

    def _read_to(self, end: bytes) -> bytes:
        said = b""
        while not said.endswith(end):
            assert self._peer is not None
            data = self._peer.recv(4096)
            assert data, said
            said += data
        return said

    def _run(self, ms: int) -> None:
        for _ in range(ms * GYRO_HZ // 1000):
            self._program.sticks()
            self._motors = self._program.step()

    def _turning(self, motors: str) -> None:
        assert [n for n, fraction in enumerate(self._motors, 1) if fraction] == [
            int(n) for n in motors.split() if n != "0"
        ]

    def _hang_up(self) -> None:
        if self._peer is not None:
            self._peer.close()
        self._peer = None

    def _ends(self, _: str) -> None:
        self._hang_up()
        assert self._program.process.wait(5.0) == 0
        self._program = self._start()

    def _power(self, _: str) -> None:
        self._hang_up()
        self._program.end()
        self._program = self._start()

    def _stored(self, settings: str) -> None:
        with contextlib.closing(self._program.connect()) as peer:
            self._peer = peer
            peer.sendall(STX + b"diff all\n" + ETX)
            lines = self._read_to(ETX).decode().splitlines()
        self._peer = None
        assert [line.removeprefix("set ") for line in lines if line.startswith("set ")] == [
            each.strip() for each in settings.split(";") if each.strip()
        ]

    def close(self) -> None:
        self._hang_up()


def replay(recording: Path, start: Callable[..., Any], build: Path, flash: Path) -> Iterator[str]:
    """Replay a recording; yields each line before it is done."""
    with contextlib.closing(Replay(start, build, flash)) as at:
        for line in recording.read_text().splitlines():
            yield line
            at.do(line)
