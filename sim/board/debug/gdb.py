"""GDB's remote protocol on a loopback port: read the emulated core, change it, step it, run to breakpoints.

`GdbServer.run_to` stands in the place of the board's own: while the debugger holds the core, time stands
still for the whole board, and whoever drives it waits.
"""

from __future__ import annotations

import select
import socket
from collections.abc import Callable

from neuroflight.sim.board.core.context import TIME_HZ, BoardError
from neuroflight.sim.board.core.engine import Engine, Outcome, Watchpoint
from neuroflight.sim.board.debug.gdb_description import memory_map_xml, target_xml
from neuroflight.sim.board.debug.gdb_packets import PACKET_BYTES, Inbox, Kind, packet
from neuroflight.sim.board.debug.gdb_target import RefusedError, Target, numbers
from neuroflight.toolchain.errors import LinkError

SLICE = 2_160_000  # cycles between two checks for the debugger's Ctrl-C: 10 ms
TRAP, INTERRUPT, ABORT = 5, 2, 6  # signals that tell why the core stands
WATCHES = {"2": "watch", "3": "rwatch", "4": "awatch"}  # kinds of Z packets, and how a stop is told
MONITOR = "reset: reset the board; it stands at its first instruction\ntime: how long the board has run\n"


class GdbServer:
    """One debugger at a time, on 127.0.0.1 only."""

    def __init__(self, engine: Engine, port: int, *, on_flashed: Callable[[], None] = lambda: None) -> None:
        """Listen; port 0: any free one. Raises LinkError if the port is taken.

        on_flashed: called when the debugger has changed flash.
        """
        self._engine, self._target = engine, Target(engine, on_flashed)
        self._listener = socket.socket()
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(("127.0.0.1", port))
            self._listener.listen(1)
        except OSError as error:
            self._listener.close()
            raise LinkError(f"cannot listen for gdb on port {port}: {error.strerror}") from error
        self.port: int = self._listener.getsockname()[1]
        self._client: socket.socket | None = None
        self._breakpoints: set[int] = set()
        self._watchpoints: dict[tuple[str, int, int], Watchpoint] = {}
        self._halted = self._steps = self._restarted = False
        self._depth = 0  # of exceptions, where a step began
        self._greet()
        self._whole, self._begun = self._commands(), self._beginnings()

    def _greet(self) -> None:
        self._inbox, self._acknowledges, self._last, self._signal = Inbox(), True, b"", f"S{TRAP:02x}"

    def wait(self, timeout: float | None = None) -> None:
        """Wait for a debugger, which finds the core halted. Raises LinkError after `timeout` s."""
        self._listener.settimeout(timeout)
        try:
            self._client, _ = self._listener.accept()
        except TimeoutError as error:
            raise LinkError(f"no gdb on port {self.port} within {timeout} s") from error
        self._client.setblocking(True)
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._greet()
        self._halted = True

    @property
    def holds(self) -> bool:
        """True if the debugger keeps the core from running."""
        return self._halted

    def poll(self) -> None:
        """Take up a debugger that has come since; it finds the core halted. Waits for none."""
        if self._client is None and select.select([self._listener], [], [], 0)[0]:
            self.wait()

    def close(self) -> None:
        """Tell the debugger that the program has ended, and hang up."""
        if self._client is not None:
            self._send("W00")
        self._leave()
        self._listener.close()

    def run_to(self, cycle: int) -> None:
        """Run like `Engine.run_to`, as the debugger allows; raises BoardError after showing it."""
        while self._engine.cycle < cycle:
            if self._client is None:
                self._engine.run_to(cycle)
                return
            if self._halted:
                self._serve()
            else:
                self._advance(cycle)

    def _advance(self, cycle: int) -> None:
        engine = self._engine
        try:
            if self._steps:
                outcome = engine.run(cycle, instructions=1)
            else:
                outcome = engine.run(min(cycle, engine.cycle + SLICE))
        except BoardError as error:
            self._console(f"{error}\n")
            self._stop(ABORT)
            self._restarted = False
            self._serve()
            if not self._restarted:
                raise
            return
        if outcome is Outcome.RESET:
            self._console(f"the chip resets: {engine.resets[-1]}\n")
        if outcome is Outcome.BREAKPOINT:
            self._stop(TRAP)
        elif outcome is Outcome.WATCHPOINT:
            number, address = engine.watch_hit
            kind = list(self._watchpoints)[number][0]
            self._stop(TRAP, f"{WATCHES[kind]}:{address:x};")
        elif self._steps and (  # a handler that interrupts the instruction belongs to its step
            outcome is Outcome.RESET or (outcome is Outcome.LIMIT and engine.depth <= self._depth)
        ):
            self._stop(TRAP)
        elif self._interrupted():
            self._stop(INTERRUPT)

    def _stop(self, signal: int, why: str = "") -> None:
        self._halted, self._signal = True, f"T{signal:02x}{why}" if why else f"S{signal:02x}"
        self._send(self._signal)

    # ---- the line ----

    def _interrupted(self) -> bool:
        while self._client is not None and self._is_readable(0):
            self._receive()
        return self._inbox.take_interrupt()

    def _serve(self) -> None:
        """Answer until the core may run."""
        while self._halted and self._client is not None:
            event = self._inbox.take()
            if event is None:
                if self._is_readable(None):
                    self._receive()
            elif event.kind is Kind.AGAIN:
                self._raw(self._last)
            elif event.kind is Kind.DAMAGED:
                self._raw(b"-" * self._acknowledges)
            elif event.kind is Kind.PACKET:
                self._raw(b"+" * self._acknowledges)
                reply = self._answer(event.data.decode("latin-1"))
                if reply is not None:
                    self._send(reply)

    def _is_readable(self, timeout: float | None) -> bool:
        """Return True if the client has sent something within `timeout` [s]. Turns others away meanwhile."""
        assert self._client is not None
        ready = select.select([self._client, self._listener], [], [], timeout)[0]
        if self._listener in ready:
            self._listener.accept()[0].close()
        return self._client in ready

    def _receive(self) -> None:
        assert self._client is not None
        try:
            data = self._client.recv(PACKET_BYTES)
        except OSError:
            data = b""
        if not data:
            self._leave()
        self._inbox.feed(data)

    def _send(self, text: str) -> None:
        self._last = packet(text.encode("latin-1"))
        self._raw(self._last)

    def _console(self, text: str) -> None:
        self._send("O" + text.encode().hex())

    def _raw(self, data: bytes) -> None:
        if self._client is not None:
            try:
                self._client.sendall(data)
            except OSError:
                self._leave()

    def _leave(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client, self._halted, self._steps = None, False, False
        self._breakpoints.clear()
        self._watchpoints.clear()
        self._engine.set_breakpoints(())
        self._engine.set_watchpoints(())

    # ---- what it asks ----

    def _answer(self, text: str) -> str | None:
        """Return the reply; None: it comes when the core stands again."""
        whole = self._whole.get(text)
        if whole is not None:
            return whole()
        for start, answer in self._begun.items():
            if text.startswith(start):
                try:
                    return answer(text[len(start) :])
                except RefusedError as refusal:
                    return f"E.{refusal}"
                except (ValueError, IndexError):
                    return "E01"
        return ""

    def _commands(self) -> dict[str, Callable[[], str | None]]:
        """Return what answers packets without arguments, by packet."""
        return {
            "?": lambda: self._signal,
            "g": self._target.registers,
            "vCont?": lambda: "vCont;c;C;s;S",
            "vFlashDone": self._restart,
            "QStartNoAckMode": self._quieten,
            "k": self._leave,
            "!": lambda: "OK",
            "qAttached": lambda: "1",
            "qC": lambda: "QC1",
            "qfThreadInfo": lambda: "m1",
            "qsThreadInfo": lambda: "l",
        }

    def _beginnings(self) -> dict[str, Callable[[str], str | None]]:
        """Return what answers packets with arguments, by how they begin."""
        return {
            "G": self._target.set_registers,
            "p": self._target.register,
            "P": self._target.set_register,
            "m": self._target.read,
            "M": lambda rest: self._target.write(rest, bytes.fromhex),
            "X": lambda rest: self._target.write(rest, lambda text: text.encode("latin-1")),
            "c": lambda rest: self._resume(rest, steps=False),
            "s": lambda rest: self._resume(rest, steps=True),
            "vCont;": lambda rest: self._resume("", steps="cCsS".index(rest[0]) > 1),
            "Z": lambda rest: self._break_at(rest, on=True),
            "z": lambda rest: self._break_at(rest, on=False),
            "vFlashErase:": self._target.erase,
            "vFlashWrite:": self._target.program,
            "qRcmd,": self._command,
            "R": lambda rest: self._restart() and None,
            "H": lambda rest: "OK",
            "T": lambda rest: "OK",
            "D": lambda rest: self._detach(),
            "qSupported": lambda rest: (
                f"PacketSize={PACKET_BYTES:x};qXfer:features:read+;qXfer:memory-map:read+;"
                "QStartNoAckMode+;vContSupported+"
            ),
            "qXfer:features:read:target.xml:": lambda rest: _piece(target_xml(), rest),
            "qXfer:memory-map:read::": lambda rest: _piece(memory_map_xml(), rest),
        }

    def _quieten(self) -> str:
        self._acknowledges = False
        return "OK"

    # ---- running ----

    def _resume(self, rest: str, *, steps: bool) -> None:
        if rest:
            self._engine.pc = numbers(rest, 1)[0]
        self._engine.skip_breakpoint()
        self._halted, self._steps, self._depth = False, steps, self._engine.depth

    def _break_at(self, rest: str, *, on: bool) -> str:
        kind, _, place = rest.partition(",")
        address, size = numbers(place.partition(";")[0], 2)
        if kind in ("0", "1"):
            breakpoints = self._breakpoints | {address} if on else self._breakpoints - {address}
            self._apply(self._engine.set_breakpoints, breakpoints)
            self._breakpoints = breakpoints
        elif kind in WATCHES:
            watchpoints = {key: one for key, one in self._watchpoints.items() if key != (kind, address, size)}
            if on:
                watchpoints[kind, address, size] = Watchpoint(
                    address, size, loads=kind in ("3", "4"), stores=kind in ("2", "4")
                )
            self._apply(self._engine.set_watchpoints, watchpoints.values())
            self._watchpoints = watchpoints
        else:
            return ""
        return "OK"

    def _apply(self, function: Callable[..., None], wanted: object) -> None:
        try:
            function(wanted)
        except ValueError as error:
            raise RefusedError(str(error)) from error

    def _detach(self) -> None:
        self._send("OK")
        self._leave()

    def _restart(self) -> str:
        """Reset the chip by its NRST pin; the core stands at its first instruction."""
        self._engine.pull_reset()
        self._restarted, self._signal = True, f"S{TRAP:02x}"
        return "OK"

    def _command(self, rest: str) -> str:
        """Execute a `monitor` command; front ends send `reset`, `reset halt` or `reset init`."""
        words = bytes.fromhex(rest).decode("latin-1").split()
        if words[:1] == ["reset"]:
            self._restart()
            text = "the board is reset and stands at its first instruction\n"
        elif words == ["time"]:
            text = f"{self._engine.cycle / TIME_HZ:.6f} s, {self._engine.instructions:,} instructions\n"
        elif words in (["halt"], []):
            text = "the core stands whenever gdb has its prompt\n"
        elif words == ["help"]:
            text = MONITOR
        else:
            text = f"got {' '.join(words)!r}, expected one of\n{MONITOR}"
        return text.encode().hex()


def _piece(text: str, rest: str) -> str:
    """Return the part of a document that a qXfer asks for. rest: its offset and size."""
    offset, size = numbers(rest, 2)
    return ("m" if offset + size < len(text) else "l") + text[offset : offset + size]
