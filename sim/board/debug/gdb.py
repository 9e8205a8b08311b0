"""GDB's remote protocol on a loopback port: read the emulated core, change it, step it, run to breakpoints.

`GdbServer.run_to` stands in the place of the board's own: while the debugger holds the core, time stands
still for the whole board, and whoever drives it waits.
"""

from __future__ import annotations

import re
import select
import socket
from collections.abc import Callable

from sim.board.core.context import BoardError
from sim.board.core.engine import Engine, Outcome
from toolchain.errors import LinkError

SLICE = 2_160_000  # cycles between two checks for the debugger's Ctrl-C: 10 ms
PACKET_BYTES = 0x1000
BUFFER_BYTES = 4 * PACKET_BYTES  # of a packet that does not end
TRAP, INTERRUPT, ABORT = 5, 2, 6  # signals that tell why the core stands
# Registers that reading leaves alone: system control block, floating-point context (ARMv7-M B3.2, B4.6).
READABLE = (*range(0xE000ED00, 0xE000ED40, 4), 0xE000EF34, 0xE000EF38, 0xE000EF3C)
REGISTERS = 17  # r0 to r12, sp, lr, pc, xPSR
TARGET = """<?xml version="1.0"?><!DOCTYPE target SYSTEM "gdb-target.dtd"><target>
<architecture>arm</architecture><feature name="org.gnu.gdb.arm.m-profile">{registers}</feature></target>"""
NAMES = (*(f"r{i}" for i in range(13)), "sp", "lr", "pc", "xpsr")


class GdbServer:
    """One debugger at a time, on 127.0.0.1 only."""

    def __init__(self, engine: Engine, port: int) -> None:
        """Listen; port 0: any free one. Raises LinkError when the port is taken."""
        self._engine = engine
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
        self._buffer = b""
        self._breakpoints: set[int] = set()
        self._halted = self._steps = False

    def wait(self, timeout: float | None = None) -> None:
        """Until a debugger is there; it finds the core halted. Raises LinkError after `timeout` s."""
        self._listener.settimeout(timeout)
        try:
            self._client, _ = self._listener.accept()
        except TimeoutError as error:
            raise LinkError(f"no gdb on port {self.port} within {timeout} s") from error
        self._client.setblocking(True)
        self._halted = True

    @property
    def holds(self) -> bool:
        """Whether the debugger keeps the core from running."""
        return self._halted

    def poll(self) -> None:
        """Take up a debugger that has come since; it finds the core halted. Waits for none."""
        if self._client is None and select.select([self._listener], [], [], 0)[0]:
            self.wait()

    def close(self) -> None:
        """No debugger any more; the core runs free."""
        self._leave()
        self._listener.close()

    def run_to(self, cycle: int) -> None:
        """Like `Engine.run_to`, as the debugger lets it. Raises BoardError when the debugger has seen it."""
        while self._engine.cycle < cycle:
            if self._client is None:
                self._engine.run_to(cycle)
                return
            if self._halted:
                self._serve()
            else:
                self._advance(cycle)

    def _advance(self, cycle: int) -> None:
        self._engine.skip_breakpoint()
        try:
            if self._steps:
                self._engine.run(cycle, instructions=1)
                self._stop(TRAP)
                return
            outcome = self._engine.run(min(cycle, self._engine.cycle + SLICE))
        except BoardError as error:
            self._console(f"{error}\n")
            self._stop(ABORT)
            self._serve()
            raise
        if outcome is Outcome.BREAKPOINT:
            self._stop(TRAP)
        elif self._interrupted():
            self._stop(INTERRUPT)

    def _stop(self, signal: int) -> None:
        self._halted, self._signal = True, signal
        self._send(f"S{signal:02x}")

    def _interrupted(self) -> bool:
        if self._client is not None and select.select([self._client], [], [], 0)[0]:
            self._receive()
        return b"\x03" in self._buffer

    # ---- packets ----

    def _serve(self) -> None:
        """Answer until the core may run."""
        self._buffer = self._buffer.replace(b"\x03", b"")
        while self._halted and self._client is not None:
            packet = self._packet()
            if packet is not None:
                self._send_reply(self._answer(packet))

    def _receive(self) -> bool:
        assert self._client is not None
        try:
            data = self._client.recv(PACKET_BYTES)
        except OSError:
            data = b""
        if not data:
            self._leave()
        self._buffer += data
        return bool(data)

    def _packet(self) -> str | None:
        """The next whole packet, acknowledged; None when the debugger has gone."""
        while True:
            found = re.search(rb"\$([^#]*)#([0-9a-fA-F]{2})", self._buffer)
            if found is None:
                if len(self._buffer) > BUFFER_BYTES:
                    self._buffer = b""  # that is no debugger
                if not self._receive():
                    return None
                continue
            self._buffer = self._buffer[found.end() :]
            good = sum(found[1]) % 256 == int(found[2], 16)
            self._raw(b"+" if good else b"-")
            if good:
                return found[1].decode("latin-1")

    def _send_reply(self, reply: str | None) -> None:
        if reply is not None:
            self._send(reply)

    def _send(self, text: str) -> None:
        data = text.encode("latin-1")
        self._raw(b"$" + data + b"#%02x" % (sum(data) % 256))

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
        self._engine.set_breakpoints(())

    # ---- what it asks ----

    _signal = TRAP

    def _answer(self, packet: str) -> str | None:
        """The reply; None: it comes when the core stands again."""
        for start, answer in self._table().items():
            if packet.startswith(start):
                try:
                    return answer(packet[len(start) :])
                except (ValueError, IndexError):
                    return "E01"
        return ""

    def _table(self) -> dict[str, Callable[[str], str | None]]:
        return {
            "?": lambda rest: f"S{self._signal:02x}",
            "g": lambda rest: "".join(_word(self._engine.register(i)) for i in range(REGISTERS)),
            "G": self._set_all,
            "p": lambda rest: _word(self._engine.register(int(rest, 16))),
            "P": self._set_one,
            "m": self._read,
            "M": self._write,
            "c": lambda rest: self._resume(steps=False),
            "s": lambda rest: self._resume(steps=True),
            "Z0": lambda rest: self._break_at(rest, on=True),
            "Z1": lambda rest: self._break_at(rest, on=True),
            "z0": lambda rest: self._break_at(rest, on=False),
            "z1": lambda rest: self._break_at(rest, on=False),
            "H": lambda rest: "OK",
            "D": lambda rest: self._detach(),
            "k": lambda rest: self._kill(),
            "qSupported": lambda rest: f"PacketSize={PACKET_BYTES:x};qXfer:features:read+",
            "qXfer:features:read:target.xml:": _features,
            "qAttached": lambda rest: "1",
            "qC": lambda rest: "QC1",
            "qfThreadInfo": lambda rest: "m1",
            "qsThreadInfo": lambda rest: "l",
        }

    def _set_all(self, rest: str) -> str:
        data = bytes.fromhex(rest)
        if len(data) != 4 * REGISTERS:
            raise ValueError(f"{len(data)} bytes for {REGISTERS} registers")
        for i in range(REGISTERS):
            self._engine.set_register(i, int.from_bytes(data[4 * i : 4 * i + 4], "little"))
        return "OK"

    def _set_one(self, rest: str) -> str:
        number, _, value = rest.partition("=")
        data = bytes.fromhex(value)
        if len(data) != 4:
            raise ValueError(f"{len(data)} bytes for a register")
        self._engine.set_register(int(number, 16), int.from_bytes(data, "little"))
        return "OK"

    def _read(self, rest: str) -> str:
        """Memory, and what gdb needs to see through exceptions; reading other registers may change them."""
        address, size = (int(part, 16) for part in rest.split(","))
        if size == 4 and address in READABLE:
            return _word(self._engine.load(address, size))
        return self._engine.memory(address, min(size, PACKET_BYTES // 2)).hex()

    def _write(self, rest: str) -> str:
        place, _, text = rest.partition(":")
        address, size = (int(part, 16) for part in place.split(","))
        data = bytes.fromhex(text)
        if len(data) != size:
            raise ValueError(f"{len(data)} bytes for {size}")
        self._engine.set_memory(address, data)
        return "OK"

    def _break_at(self, rest: str, *, on: bool) -> str:
        address = int(rest.split(",")[1], 16)
        wanted = self._breakpoints | {address} if on else self._breakpoints - {address}
        self._engine.set_breakpoints(wanted)
        self._breakpoints = wanted
        return "OK"

    def _resume(self, *, steps: bool) -> None:
        self._halted, self._steps = False, steps

    def _detach(self) -> None:
        self._send("OK")
        self._leave()

    def _kill(self) -> None:
        self._leave()


def _features(rest: str) -> str:
    offset, size = (int(part, 16) for part in rest.split(","))
    types = {"sp": "data_ptr", "pc": "code_ptr"}
    registers = "".join(
        f'<reg name="{name}" bitsize="32" type="{types.get(name, "int")}"/>' for name in NAMES
    )
    text = TARGET.format(registers=registers)
    return ("m" if offset + size < len(text) else "l") + text[offset : offset + size]


def _word(value: int) -> str:
    return value.to_bytes(4, "little").hex()
