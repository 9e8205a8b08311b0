"""GDB's remote protocol, by a client written for these tests."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from xml.etree import ElementTree

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.debug.gdb import GdbServer
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES
from neuroflight.toolchain.errors import LinkError
from tests.sim.board.programs import DEVICE, Boot, Device, Program

LOOPING = """
__attribute__((noinline)) void step(void) { RESULT[0] += 3; }
HANDLER reset(void) { RESULT[0] = 0; for (;;) step(); }
VECTORS();
"""


class Client:
    """Packets to a server on loopback and back."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=20)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
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
def session(boot: Boot) -> Iterator[Session]:
    """A looping program, halted at its start."""
    one = Session(boot(LOOPING), 1_000_000)
    yield one
    one.end()


def test_registers_and_memory_are_read_and_written_when_it_is_halted(session: Session) -> None:
    client = session.client
    assert client.ask("?") == "S05"
    registers = bytes.fromhex(client.ask("g"))
    assert len(registers) == 4 * 17 + 8 * 16 + 4 + 4 * 6
    assert int.from_bytes(registers[52:56], "little") == 0x20001000
    assert client.word("pf") == session.engine.symbols["reset"]
    assert client.ask("P3=78563412") == "OK" and client.word("p3") == 0x12345678
    assert client.ask("M20003000,4:01020304") == "OK" and client.ask("m20003000,2") == "0102"
    assert client.ask("m70000000,4") == "E01"
    assert client.word("me000ef34,4") == 0xC0000000, "FPCCR after reset"
    assert client.ask("qXfer:features:read:target.xml:0,fff").startswith("l<?xml")
    assert client.ask("vMustReplyEmpty") == ""


@pytest.mark.parametrize(
    "packet",
    [
        *("G" + "00" * 64, "G" + "00" * 228, "G", "P3=01", "P3=", "P11=00000000", "M20003000,4:01"),
        *(
            "M20003000,1:0102",
            "M2003fffe,4:00000000",
            "X20003000,4:ab",
            "p38",
            "p-1",
            "m20003000",
            "m20003000,-4",
        ),
        *(
            "m120003000,4",
            "m20003000,100000000",
            "maaaaaaaaaaaaaaaaaaaa,4",
            "m 20003000, 4",
            "Z0,-1,2",
            "Z2,20003000",
        ),
        *("Z0,123456789,2", "vCont;x", "vFlashErase:0,-4", "c-1", "qXfer:features:read:target.xml:-1,5"),
    ],
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


def test_it_stops_when_interrupted(boot: Boot) -> None:
    session = Session(boot(LOOPING), 2**62)
    session.client.send("c")
    session.client.socket.sendall(b"\x03")
    assert session.client.receive() == "S02"
    session.client.send("c70000000")  # or it runs for ever
    assert session.client.receive()[0] == "O"
    assert session.client.receive() == "S06"
    session.end()


def test_the_debugger_sees_it_when_the_image_fails(boot: Boot) -> None:
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


def test_one_line_says_so_when_the_port_is_taken(session: Session, boot: Boot) -> None:
    with pytest.raises(LinkError, match="cannot listen for gdb"):
        GdbServer(session.engine, session.server.port)


def test_it_runs_free_when_the_debugger_goes(session: Session) -> None:
    session.client.socket.close()
    session.thread.join(20)
    assert session.engine.cycle >= 1_000_000


class Clearing(Device):
    """Reading it clears its value, lowers its interrupt's line and sets an alarm."""

    def __init__(self, engine: Engine) -> None:
        super().__init__(engine)
        self.alarm = engine.alarm("clearing", lambda: None)

    def read(self, offset: int, size: int) -> int:
        if offset:
            self.engine.fail("a register that is not there")
        value, self.value = super().read(offset, size), 0
        self.engine.irq(self.irq, False)
        self.alarm.set(self.engine.cycle + 1000)
        return value


def test_a_register_of_a_peripheral_is_as_it_was_when_the_debugger_has_read_it(
    boot: Boot,
) -> None:
    engine = boot(LOOPING)
    device = Clearing(engine)
    engine.attach(DEVICE, 0x400, device, "DEVICE")
    session = Session(engine, 1_000_000)
    client = session.client
    for _ in range(20):
        client.ask("s")
    engine.irq(0, True)
    device.value = 0x12345678
    for packet, expected in (
        *((f"m{DEVICE:x},4", "78563412"), (f"m{DEVICE:x},8", "78563412"), (f"m{DEVICE + 1:x},2", "5634")),
        *((f"m{DEVICE + 4:x},4", "E01"), (f"m{DEVICE + 0x400:x},4", "E01"), ("me000e200,4", "01000000")),
    ):
        before = engine.trace_hash, client.ask("g")
        assert client.ask(packet) == expected
        assert (engine.trace_hash, client.ask("g")) == before
        assert (device.value, device.log, device.alarm.due) == (0x12345678, [], None)
        assert client.ask("s") == "S05"
    session.end()
    assert not session.error


def test_the_description_names_every_register_that_is_read(session: Session) -> None:
    client = session.client
    text = client.ask("qXfer:features:read:target.xml:0,2000")[1:]
    registers = list(ElementTree.fromstring(text).iter("reg"))
    for number, register in enumerate(registers):
        assert len(client.ask(f"p{number:x}")) == int(register.attrib["bitsize"]) // 4
    assert client.ask("g") == "".join(client.ask(f"p{i:x}") for i in range(len(registers)))
    names = [register.attrib["name"] for register in registers]
    for name, value in (("d0", "000080bf0000203f"), ("primask", "01000000"), ("basepri", "40000000")):
        number = names.index(name)
        assert client.ask(f"P{number:x}={value}") == "OK"
        assert client.ask(f"p{number:x}") == value
    for offset in (0, 100, len(text)):
        piece = client.ask(f"qXfer:features:read:target.xml:{offset:x},40")
        assert piece == ("l" if offset == len(text) else "m") + text[offset : offset + 64]


def test_control_reads_as_the_chip_has_it_when_floats_are_in_use(boot: Boot) -> None:
    """FPCA is set by the first floating-point instruction; SFPA is none of ARMv7-M's."""
    session = Session(
        boot('HANDLER reset(void) { FPU_ON(); __asm volatile("vmov s0, #1.0"); REST(); } VECTORS();'), 2**62
    )
    assert session.client.word("p27") == 0
    session.client.send("c")
    while not session.engine.sleeping:
        time.sleep(0.001)
    session.client.socket.sendall(b"\x03")
    assert session.client.receive() == "S02"
    assert session.client.word("p27") == 4
    assert session.client.ask("p11")[:8] == "0000803f", "s0 is 1.0"
    session.client.send("c70000000")
    session.end()


@pytest.mark.parametrize(("kind", "told"), [("2", "watch"), ("4", "awatch"), ("3", "rwatch")])
def test_it_stops_before_the_access_when_memory_is_watched(session: Session, kind: str, told: str) -> None:
    client = session.client
    client.ask(f"Z0,{session.engine.symbols['step']:x},2")
    assert client.ask("c") == "S05"
    assert client.ask(f"Z{kind},20002001,1") == "OK", "a byte of the word that is accessed"
    for passes in range(3):
        assert client.ask("c") == f"T05{told}:20002001;"
        assert client.word("m20002000,4") == 3 * passes
        if kind != "2":
            assert (session.engine.memory(session.engine.pc, 2)[1] & 0xF8) == 0x68, "LDR"
        if kind == "4":
            assert client.ask("c") == "T05awatch:20002001;", "it is stored, too"
        assert client.ask("s") == "S05"
        if kind != "3":
            assert client.word("m20002000,4") == 3 * passes + 3
        assert client.ask("c") == "S05", "the breakpoint"
    assert client.ask(f"z{kind},20002001,1") == "OK"
    assert client.ask("c") == "S05"
    assert client.word("pf") == session.engine.symbols["step"]
    for i in range(32):
        assert client.ask(f"Z2,{0x20003000 + 8 * i:x},4") == "OK"
    assert client.ask("Z2,20004000,4") == "E.33 watchpoints, at most 32"


def test_no_breakpoint_is_missed_when_the_board_runs_in_small_pieces(boot: Boot) -> None:
    """A piece may end right before an instruction with a breakpoint."""
    engine = boot(LOOPING)
    session = Session(engine, 0)
    session.thread.join(20)
    stops = []

    def drive() -> None:
        for cycle in range(20_000):
            session.server.run_to(cycle)

    thread = threading.Thread(target=drive, daemon=True)
    thread.start()
    session.client.ask(f"Z0,{engine.symbols['step']:x},2")
    session.client.send("c")
    session.client.socket.settimeout(1)
    try:
        while True:
            stops.append(session.client.receive())
            session.client.send("c")
    except TimeoutError:
        thread.join(20)
    assert len(stops) in (engine.load(0x20002000, 4) // 3, engine.load(0x20002000, 4) // 3 + 1)
    assert len(stops) > 50
    session.end()


TICKING = """
HANDLER tick(void) { for (int i = 0; i < 20; ++i) RESULT[1] += 1; }
HANDLER reset(void)
{
    REG(0xE000E014) = 400; REG(0xE000E018) = 0; REG(0xE000E010) = 7;
    RESULT[0] = RESULT[1] = 0;
    for (;;) ++RESULT[0];
}
VECTORS([15] = tick);
"""


def test_a_step_goes_over_the_handler_that_interrupts_it(boot: Boot) -> None:
    """And the run is the one that nobody has stepped through."""
    free, engine = boot(TICKING), boot(TICKING)
    session = Session(engine, 20_000)
    free.run_to(20_000)
    for _ in range(300):
        assert session.client.ask("s") == "S05"
        assert engine.depth == 0
    assert engine.load(0x20002004, 4) >= 20
    session.client.ask(f"Z0,{engine.symbols['tick']:x},2")
    while engine.pc != engine.symbols["tick"]:
        assert session.client.ask("s") == "S05", "a breakpoint in it counts"
    for _ in range(3):
        session.client.ask("s")
        assert engine.depth == 1
    session.client.socket.close()
    session.thread.join(20)
    assert (engine.cycle, engine.trace_hash) == (free.cycle, free.trace_hash)
    session.server.close()


def load(client: Client, flash: bytes) -> None:
    """Load as gdb does: erase whole sectors, then write the bytes, escaped where the protocol needs it."""
    assert client.ask("vFlashErase:8000000,4000") == "OK"
    for at in range(0, len(flash), 300):
        data = b"".join(bytes([0x7D, c ^ 0x20]) if c in b"$#}*" else bytes([c]) for c in flash[at : at + 300])
        client.socket.sendall(_framed(b"vFlashWrite:%x:" % (FLASH_BASE + at) + data))
        assert client.receive() == "OK"
    assert client.ask("vFlashDone") == "OK"


def _framed(data: bytes) -> bytes:
    return b"$" + data + b"#%02x" % (sum(data) % 256)


def test_the_new_program_runs_from_its_reset_when_it_was_loaded(
    session: Session, compile_program: Callable[[str], Program]
) -> None:
    client = session.client
    client.ask(f"Z0,{session.engine.symbols['step']:x},2")
    client.ask("c")
    other = compile_program("HANDLER reset(void) { RESULT[0] = 0x7D2A2324; REST(); } VECTORS();").flash
    load(client, other)
    assert session.engine.memory(FLASH_BASE, 0x4000) == other.ljust(0x4000, b"\xff")
    assert session.engine.resets == ["power", "pin"]
    assert client.word("pf") == int.from_bytes(other[4:8], "little") & ~1
    assert client.ask("s") == "S05"
    client.socket.close()
    session.thread.join(20)
    assert not session.error
    assert session.engine.load(0x20002000, 4) == 0x7D2A2324


@pytest.mark.parametrize(
    ("packet", "why"),
    [
        ("M8000000,4:00000000", "flash takes no store; program it by `load`"),
        ("M200000,4:00000000", "flash takes no store; program it by `load`"),
        ("X27fffc,4:\0\0\0\0", "flash takes no store; program it by `load`"),
        ("M1ff00000,4:00000000", "the chip's ROM takes no store"),
        ("vFlashErase:8000100,4000", "16384 bytes at 0x08000100 are no whole sectors of flash"),
        ("vFlashErase:8000000,5000", "20480 bytes at 0x08000000 are no whole sectors of flash"),
        ("vFlashErase:8060000,40000", "262144 bytes at 0x08060000 are no whole sectors of flash"),
        ("vFlashErase:0,0", "0 bytes at 0x00000000 are no whole sectors of flash"),
        ("vFlashWrite:8000000:\x7f\x7f", "2 bytes at 0x08000000 over others that are not erased"),
        ("vFlashWrite:20000000:ab", "2 bytes at 0x20000000, expected flash"),
        ("vFlashWrite:807ffff:ab", "2 bytes at 0x0807FFFF, expected flash"),
    ],
)
def test_flash_stays_when_it_is_written_as_no_flash_can_be(session: Session, packet: str, why: str) -> None:
    before = session.engine.memory(FLASH_BASE, FLASH_BYTES)
    assert session.client.ask(packet) == f"E.{why}"
    assert session.engine.memory(FLASH_BASE, FLASH_BYTES) == before


def monitor(client: Client, text: str) -> str:
    return bytes.fromhex(client.ask("qRcmd," + text.encode().hex())).decode()


@pytest.mark.parametrize("command", ["reset", "reset halt", "reset init"])
def test_a_board_that_failed_lives_again_when_it_is_reset(boot: Boot, command: str) -> None:
    session = Session(boot(LOOPING), 1_000_000)
    client = session.client
    client.send("c70000000")
    assert client.receive()[0] == "O" and client.receive() == "S06"
    assert "stands at its first instruction" in monitor(client, command)
    assert client.word("pf") == session.engine.symbols["reset"]
    client.ask(f"Z0,{session.engine.symbols['step']:x},2")
    assert client.ask("c") == "S05"
    session.end()
    assert not session.error


def test_monitor_tells_what_there_is_when_it_does_not_know_a_word(session: Session) -> None:
    assert "got 'arm semihosting enable', expected one of\nreset" in monitor(
        session.client, "arm semihosting enable"
    )
    assert monitor(session.client, "time").startswith("0.000000 s, 0 instructions")


def test_a_second_debugger_is_turned_away_when_there_is_one(session: Session) -> None:
    assert session.client.ask("?") == "S05"
    with socket.create_connection(("127.0.0.1", session.server.port), timeout=20) as other:
        assert other.recv(1) == b""
    assert session.client.ask("s") == "S05"


def test_nothing_is_acknowledged_when_both_have_agreed_on_it(session: Session) -> None:
    client = session.client
    assert client.ask("QStartNoAckMode") == "OK"
    client.socket.sendall(b"+" + _framed(b"?"))
    assert client.socket.recv(64) == b"$S05#b8"


def test_the_last_packet_comes_again_when_it_was_damaged(session: Session) -> None:
    client = session.client
    first = client.ask("g")
    client.socket.sendall(b"-")
    assert client.receive() == first


def test_the_board_lives_when_a_client_sends_anything(boot: Boot) -> None:
    """Random bytes, and packets of random text whose checksum is right; no answer tells of this computer."""
    rng = random.Random(1)
    starts = (
        *(
            "m",
            "M",
            "X",
            "G",
            "P",
            "p",
            "Z0,",
            "Z2,",
            "z3,",
            "qXfer:features:read:target.xml:",
            "H",
            "T",
            "q",
        ),
        *("vFlashErase:", "vFlashWrite:", "vCont", "qRcmd,", "v", "Q", ""),
    )
    letters = "0123456789abcdef,:;=-#$}\x03\x00xXzZ *"
    session = Session(boot(LOOPING), 2**62)
    client = session.client
    client.socket.sendall(b"$" + b"m" * 1_000_000)
    for _ in range(300):
        text = rng.choice(starts) + "".join(rng.choices(letters, k=rng.randrange(24)))
        client.socket.sendall(_framed(text.encode()) if rng.random() < 0.8 else rng.randbytes(40))
    client.socket.sendall(b"#00" + _framed(b"m20000000,ffffffff"))
    client.socket.sendall(b"\x03" + _framed(b"qC") + _framed(b"c70000000"))  # or it runs for ever
    heard = b""
    while b"$S06#" not in heard:
        data = client.socket.recv(1 << 16)
        assert data
        heard += data
    assert b"$QC1#" in heard
    assert max(map(len, heard.split(b"$"))) < 0x4000 + 10
    session.end()
