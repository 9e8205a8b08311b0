"""GDB's remote protocol, by a client written for these tests."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from sim.board.core.context import BoardError
from sim.board.core.engine import Engine
from sim.board.debug.gdb import GdbServer
from toolchain.errors import LinkError

LOOPING = """
__attribute__((noinline)) void step(void) { RESULT[0] += 3; }
HANDLER reset(void) { RESULT[0] = 0; for (;;) step(); }
VECTORS();
"""


class Client:
    """Packets to a server on loopback and back."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=20)
        self.buffer = b""

    def send(self, packet: str) -> None:
        data = packet.encode()
        self.socket.sendall(b"$" + data + b"#%02x" % (sum(data) % 256))

    def receive(self) -> str:
        while b"#" not in self.buffer or len(self.buffer) < self.buffer.index(b"#") + 3:
            data = self.socket.recv(4096)
            assert data, "the server has gone"
            self.buffer += data
        end = self.buffer.index(b"#")
        body = self.buffer[: end + 3].lstrip(b"+")
        self.buffer = self.buffer[end + 3 :]
        assert body[0:1] == b"$" and sum(body[1:-3]) % 256 == int(body[-2:], 16)
        self.socket.sendall(b"+")
        return body[1:-3].decode()

    def ask(self, packet: str) -> str:
        self.send(packet)
        return self.receive()

    def word(self, packet: str) -> int:
        return int.from_bytes(bytes.fromhex(self.ask(packet)), "little")


class Session:
    """A board that runs to a cycle in a thread of its own, with a debugger on it."""

    def __init__(self, engine: Engine, cycle: int) -> None:
        self.engine, self.error = engine, ""
        self.server = GdbServer(engine, 0)
        self.thread = threading.Thread(target=self._run, args=(cycle,), daemon=True)
        self.client = Client(self.server.port)
        self.thread.start()

    def _run(self, cycle: int) -> None:
        try:
            self.server.wait(20)
            self.server.run_to(cycle)
        except BoardError as error:
            self.error = str(error)

    def end(self) -> None:
        self.client.socket.close()
        self.thread.join(20)
        assert not self.thread.is_alive()
        self.server.close()


@pytest.fixture
def session(boot: Callable[..., Engine]) -> Iterator[Session]:
    """A looping program, halted at its start."""
    one = Session(boot(LOOPING), 1_000_000)
    yield one
    one.end()


def test_registers_and_memory_are_read_and_written_when_it_is_halted(session: Session) -> None:
    client = session.client
    assert client.ask("?") == "S05"
    registers = bytes.fromhex(client.ask("g"))
    assert len(registers) == 68
    assert int.from_bytes(registers[52:56], "little") == 0x20001000
    assert client.word("pf") == session.engine.symbols["reset"]
    assert client.ask("P3=78563412") == "OK" and client.word("p3") == 0x12345678
    assert client.ask("M20003000,4:01020304") == "OK" and client.ask("m20003000,2") == "0102"
    assert client.ask("m70000000,4") == "E01"
    assert client.ask("m40023800,4") == "E01", "reading RCC could change it"
    assert client.word("me000ef34,4") == 0xC0000000, "FPCCR after reset"
    assert client.ask("qXfer:features:read:target.xml:0,fff").startswith("l<?xml")
    assert client.ask("vMustReplyEmpty") == ""


@pytest.mark.parametrize(
    "packet", ["G" + "00" * 64, "G" + "00" * 72, "G", "P3=01", "P3=", "M20003000,4:01", "M20003000,1:0102"]
)
def test_nothing_changes_when_a_packet_holds_too_little_or_too_much(session: Session, packet: str) -> None:
    client = session.client
    before = client.ask("g"), client.ask("m20003000,8")
    assert client.ask(packet) == "E01"
    assert (client.ask("g"), client.ask("m20003000,8")) == before


def test_all_registers_are_set_when_the_packet_holds_them(session: Session) -> None:
    client = session.client
    registers = bytearray.fromhex(client.ask("g"))
    registers[12:16] = bytes.fromhex("78563412")
    assert client.ask("G" + registers.hex()) == "OK"
    assert client.ask("g") == registers.hex()


def test_one_instruction_is_executed_when_it_steps(session: Session) -> None:
    before = session.engine.instructions
    for expected in range(1, 6):
        assert session.client.ask("s") == "S05"
        assert session.engine.instructions == before + expected


def test_it_stops_at_every_pass_when_there_is_a_breakpoint(session: Session) -> None:
    client, address = session.client, session.engine.symbols["step"]
    assert client.ask(f"Z0,{address:x},2") == "OK"
    for passes in range(4):
        assert client.ask("c") == "S05"
        assert client.word("pf") == address
        assert client.word("m20002000,4") == 3 * passes
    assert client.ask(f"z0,{address:x},2") == "OK"
    client.send("c")
    session.thread.join(20)
    assert session.engine.cycle >= 1_000_000


def test_it_stops_when_interrupted(boot: Callable[..., Engine]) -> None:
    session = Session(boot(LOOPING), 2**62)
    session.client.send("c")
    session.client.socket.sendall(b"\x03")
    assert session.client.receive() == "S02"
    assert (
        session.client.ask(f"M{session.engine.symbols['step']:x},2:00de") == "OK"
    )  # udf #0: or it runs for ever
    session.client.send("c")
    assert session.client.receive()[0] == "O"
    assert session.client.receive() == "S06"
    session.end()


def test_the_debugger_sees_it_when_the_image_fails(boot: Callable[..., Engine]) -> None:
    source = 'HANDLER reset(void) { RESULT[0] = 1; __asm volatile("udf #0"); } VECTORS();'
    session = Session(boot(source), 1_000_000)
    session.client.send("c")
    console = session.client.receive()
    assert console[0] == "O" and "undefined instruction" in bytes.fromhex(console[1:]).decode()
    assert session.client.receive() == "S06"
    assert session.client.word("m20002000,4") == 1
    session.end()
    assert "undefined instruction" in session.error


def test_a_damaged_packet_is_asked_for_again_when_its_sum_is_wrong(session: Session) -> None:
    session.client.socket.sendall(b"$?#00")
    assert session.client.socket.recv(1) == b"-"
    assert session.client.ask("?") == "S05"


def test_one_line_says_so_when_the_port_is_taken(session: Session, boot: Callable[..., Engine]) -> None:
    with pytest.raises(LinkError, match="cannot listen for gdb"):
        GdbServer(session.engine, session.server.port)


def test_it_runs_free_when_the_debugger_goes(session: Session) -> None:
    session.client.socket.close()
    session.thread.join(20)
    assert session.engine.cycle >= 1_000_000
