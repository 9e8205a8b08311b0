"""The other end of a serial line of the emulated board: a pseudo terminal, TCP, or a client in lockstep.

`UartLine` is the end of the wires: bytes that the board has sent, bytes that go in, each at its exact time,
and what of either was no byte for its receiver because both ends run at different speeds. On it stand

- `LineTransport`: a client in this very program (flash.link.client), in lockstep with the board. It waits in
  emulated time only, so that a conversation is repeatable to the bit.
- `Bridge`: programs elsewhere on this computer, behind a `PtyEnd` or a `TcpEnd`. It has no thread and never
  waits: whoever runs the board calls `exchange` between two slices.
"""

from __future__ import annotations

import errno
import os
import pty
import select
import socket
import tty
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.rom.boot_loader import UART as ROM_UART
from neuroflight.sim.loopback import listen
from neuroflight.toolchain.contract import MSP_BAUD_DEFAULT
from neuroflight.toolchain.errors import LinkError

MSP_UART = "USART1"
SLICE = TIME_HZ // 10_000  # cycles between two reads of what the board has sent: 100 us
PENDING_MAX = 64 * 1024  # bytes kept for a program that does not read; what comes then is lost, as on wires
READ_MAX = 4096
AHEAD_MAX = 16 << 20  # bytes read to see whether a program has gone: more than a connection holds
AHEAD_S = 0.02  # until the system has delivered what a closed program had sent


class UartLine:
    """The far end of one UART's wires. A newer one on the same UART takes its place."""

    def __init__(self, board: Board, uart: str = MSP_UART, format: Format | None = None) -> None:
        """format: of this end; default: 115200 baud 8N1.

        Raises ValueError if the board has no such UART.
        """
        if uart not in board.hardware.usarts:
            raise ValueError(f"a line on {uart!r}, expected one of {', '.join(board.hardware.usarts)}")
        self.board, self.uart = board, uart
        self.format = format or Format(MSP_BAUD_DEFAULT)
        self._usart = board.hardware.usarts[uart]
        self._usart.on_sent = self._hear
        self._heard = bytearray()
        self.framing_errors = 0  # bytes of the board's that were none at this end's speed
        self.last_heard: int | None = None  # cycle at which the board's last byte ended

    @property
    def connected(self) -> bool:
        """True if no other line has taken its place."""
        return self._usart.on_sent == self._hear

    @property
    def refused(self) -> int:
        """Bytes from here that the board could not decode, because it runs at another speed."""
        return self._usart.mismatches

    @property
    def board_format(self) -> Format:
        """Format of the board. Raises BoardError before it has set up its UART."""
        return self._usart.format

    @property
    def pending(self) -> int:
        """Bytes on their way to the board."""
        return self._usart.arriving

    def send(self, data: bytes) -> int:
        """Put `data` on the line, behind what is on it. Returns the cycle at which its last byte ends."""
        return self._usart.feed(data, self.format)

    def take(self) -> bytes:
        """Return the bytes from the board since the last call."""
        data = bytes(self._heard)
        self._heard.clear()
        return data

    def room(self, cycles: int) -> int:
        """Return how many more bytes the line can carry within the next `cycles`."""
        return max(0, -(-cycles // self.format.byte_cycles) - self.pending)

    def _hear(self, byte: int) -> None:
        if self.format.understands(self._usart.format):
            self._heard.append(byte)
            self.last_heard = self.board.cycle
        else:
            self.framing_errors += 1


class LineTransport:
    """flash.transport.Transport over a line, in lockstep: waiting for bytes is what makes the board run.

    Give its `clock` to the client, so that timeouts count emulated seconds:

        client = Client(transport, transport.clock)
    """

    def __init__(self, line: UartLine, run_to: Callable[[int], None] | None = None) -> None:
        """run_to: runs the board, if something else has to happen as well; default: the board's own."""
        self._line = line
        self._run_to = run_to or line.board.run_to
        self._closed = False

    @property
    def name(self) -> str:
        """The port, as the board calls it."""
        return f"{self._line.uart} of the emulated board"

    def clock(self) -> float:
        """Return the emulated time since power-up [s]."""
        return self._line.board.cycle / TIME_HZ

    def read(self, timeout: float) -> bytes:
        """See Transport; `timeout` in emulated seconds. Raises BoardError for what the image does wrong."""
        self._check()
        end = self._line.board.cycle + max(1, round(timeout * TIME_HZ))
        while not (data := self._line.take()):
            cycle = self._line.board.cycle
            if cycle >= end:
                return b""
            self._run_to(min(end, cycle + SLICE))
        return data

    def write(self, data: bytes) -> None:
        """Write; see Transport. Bytes that came before are not the answer to this and stay to be read."""
        self._check()
        self._line.send(data)

    def close(self) -> None:
        """Close; see Transport. The board stays as it is."""
        self._closed = True

    def _check(self) -> None:
        if self._closed:
            raise LinkError(f"{self.name}: the line was closed, expected it to stay open")
        if not self._line.connected:
            raise LinkError(f"{self.name}: another line has taken its place, expected one at a time")


class End(Protocol):
    """The end of the line for another program. Nothing here waits."""

    @property
    def name(self) -> str:
        """Name for the user."""

    def receive(self, count: int) -> bytes:
        """Return at most `count` bytes from the program; b"" without any."""

    def send(self, data: bytes) -> int:
        """Send `data`; return how many bytes the program's side has taken, all of them without a program."""

    def close(self) -> None:
        """Close the line for the program; may be called twice."""


class PtyEnd:
    """A pseudo terminal, which programs open like a serial port. Its speed is ignored."""

    def __init__(self) -> None:
        """Open a pseudo terminal. Raises LinkError if the system gives none."""
        try:
            self._master, self._slave = pty.openpty()
        except OSError as error:
            raise LinkError(
                f"no pseudo terminal to be had ({error.strerror}); close programs that hold some, or take TCP"
            ) from None
        tty.setraw(self._slave)  # our own hold on it keeps the line when a program goes
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._closed = False

    @property
    def name(self) -> str:
        return self.path

    def receive(self, count: int) -> bytes:
        try:
            return os.read(self._master, count)
        except BlockingIOError:
            return b""

    def send(self, data: bytes) -> int:
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            os.close(self._master)
            os.close(self._slave)


class TcpEnd:
    """A TCP server on this computer only, for one program at a time; a second one is turned away.

    What a program sends waits in its connection, and its end behind that: minutes of a line's time. When the
    next one calls, all of it is read; if the first has gone, READ_MAX bytes of it still go to the board.
    """

    def __init__(self, port: int = 0) -> None:
        """port: 0 for any free one. Raises LinkError if it is taken."""
        self._listener = listen("TCP", port)
        self._client: socket.socket | None = None
        self._ahead = bytearray()  # read and not taken yet
        self.port: int = self._listener.getsockname()[1]

    @property
    def name(self) -> str:
        return f"tcp:127.0.0.1:{self.port}"

    def receive(self, count: int) -> bytes:
        self._accept()
        if self._ahead:
            first = bytes(self._ahead[:count])
            del self._ahead[:count]
            return first
        if self._client is None:
            return b""
        try:
            data = self._client.recv(count)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._leave()
        return data

    def send(self, data: bytes) -> int:
        if self._client is None:
            return len(data)
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._leave()
            return len(data)

    def close(self) -> None:
        self._leave()
        self._listener.close()

    def _accept(self) -> None:
        """Accept the next program, or refuse it while one is connected; unread bytes are taken first."""
        while select.select([self._listener], [], [], 0)[0]:
            if self._client is not None:
                self._read_ahead()
            if self._client is None and self._ahead:
                return
            try:
                peer, _ = self._listener.accept()
            except BlockingIOError:
                return
            except OSError as error:  # the peer has gone again
                if error.errno in (errno.ECONNABORTED, errno.EINTR):
                    continue
                raise
            if self._client is not None:
                peer.close()
                continue
            peer.setblocking(False)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = peer

    def _read_ahead(self) -> None:
        """Read all that the program has sent; if its end follows, most of that is dropped."""
        assert self._client is not None
        try:
            while data := self._client.recv(PENDING_MAX):
                self._ahead += data
                if len(self._ahead) > AHEAD_MAX:
                    return
                select.select([self._client], [], [], AHEAD_S)
        except BlockingIOError:
            return
        except OSError:
            pass
        del self._ahead[READ_MAX:]
        self._leave()

    def _leave(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


class Bridge:
    """A bridge that carries bytes between a line and its other end, at the line's speed.

    Pseudo terminals and TCP have no parity. The boot loader in the chip's ROM needs an even one: the line has
    it while that runs.
    """

    def __init__(self, line: UartLine, end: End) -> None:
        self.line, self.end = line, end
        self._format = line.format
        self.lost = 0  # bytes from the board that nobody took in time
        self._out = b""

    def exchange(self, cycles: int) -> None:
        """Carry what has come, either way, before the board runs for `cycles`.

        More than the line can carry meanwhile is left where it is: a sender that is too fast has to wait.
        """
        in_rom = self.line.uart == ROM_UART and self.line.board.hardware.rom.runs
        self.line.format = replace(self._format, parity="E") if in_rom else self._format
        room = min(self.line.room(cycles), READ_MAX)
        if room and (data := self.end.receive(room)):
            self.line.send(data)
        self._out += self.line.take()
        if self._out:
            self._out = self._out[self.end.send(self._out) :]
        self.lost += max(0, len(self._out) - PENDING_MAX)
        self._out = self._out[:PENDING_MAX]

    def close(self) -> None:
        """Hand out what is left, as far as it is taken, and let the end go."""
        self._out += self.line.take()
        if self._out:
            self.end.send(self._out)
        self.end.close()
