"""Debian's gdb on the emulated core: what a person at its prompt sees."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import open_transport
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.debug.gdb import GdbServer
from neuroflight.toolchain.contract import Msp
from tests.cli.test_board import Running
from tests.conftest import ROOT
from tests.sim.board.programs import Program, compile_program  # noqa: F401 - a fixture

LIMIT_S = 60.0  # of a test that hangs
FLYING = """
HANDLER first(void) {} /* gdb looks no further out than the function at the start of the code */
volatile float mixed;
volatile uint32_t ticks, guarded;
__attribute__((noinline)) float gain(float error, float k) { return error * k; }
__attribute__((noinline)) void note(uint32_t count) { ticks = count; }
HANDLER tick(void) { note(ticks + 1); }
__attribute__((noinline)) uint32_t sum(const uint32_t *from)
{
    volatile uint32_t total = 0;
    for (uint32_t i = 0; i < 4; ++i)
        total += from[i];
    return total;
}
HANDLER reset(void)
{
    static const uint32_t terms[4] = {1, 20, 300, 4000};
    FPU_ON();
    ticks = 0; mixed = 0.25f; guarded = 0;
    REG(0xE000E014) = 4000; REG(0xE000E018) = 0; REG(0xE000E010) = 7;
    for (;;) {
        mixed = gain(mixed, -2.0f);
        guarded = sum(terms);
    }
}
VECTORS([15] = tick);
"""


def gdb(elf: Path, port: int, *commands: str) -> str:
    """Return gdb's output to these commands; gdb must exit with 0."""
    assert shutil.which("gdb-multiarch"), "gdb-multiarch is missing; run: make peers"
    orders = ("set pagination off", "set confirm off", f"target remote :{port}", *commands)
    done = subprocess.run(
        ["gdb-multiarch", "-nx", "-batch", *(part for order in orders for part in ("-ex", order)), str(elf)],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0 and "Error" not in done.stderr, done.stdout[-1000:] + done.stderr[-1000:]
    return done.stdout


@pytest.fixture
def ask(compile_program: Callable[[str], Program]) -> Iterator[Callable[..., str]]:  # noqa: F811
    """Run gdb on a program that waits at its first instruction, and runs free once gdb has gone."""
    program = compile_program(FLYING)
    engine = Engine(program.flash, elf=program.elf)
    server = GdbServer(engine, 0)

    def live() -> None:
        server.wait(LIMIT_S)
        server.run_to(100_000_000)

    life = threading.Thread(target=live)
    life.start()
    yield lambda *commands: gdb(program.elf, server.port, *commands)
    life.join(LIMIT_S)
    server.close()
    assert engine.cycle >= 100_000_000


def test_finish_shows_what_a_float_function_returns(ask: Callable[..., str]) -> None:
    said = ask("break gain", "continue", "print $s0", "print error * k", "finish")
    assert "$1 = 0.25" in said and "$2 = -0.5" in said
    assert "Value returned is $3 = -0.5" in said


def test_every_register_has_its_name(ask: Callable[..., str]) -> None:
    said = ask(
        *("break gain", "continue", "set $s1 = 8", "print $d0", "finish", "info registers", "info float"),
        *("print $primask", "print $basepri", "print $faultmask", "print $control", "print $msp == $sp"),
    )
    assert "Value returned is $2 = 2" in said
    for name in ("r0", "sp", "lr", "pc", "xpsr", "fpscr", "msp", "psp", "primask", "control", "s31", "d15"):
        assert re.search(rf"^{name} +\S", said, re.MULTILINE), name
    assert re.findall(r"^\$(?:3|4|5|6|7) = (.*)$", said, re.MULTILINE) == ["0", "0", "0", "4", "1"]


def test_watchpoints_tell_old_and_new_values(ask: Callable[..., str]) -> None:
    said = ask(
        *("break gain", "continue", "delete", "watch mixed", "continue", "continue"),
        *("delete", "rwatch ticks", "continue", "backtrace", "delete", "awatch guarded", "continue"),
    )
    assert "Hardware watchpoint 2: mixed\n\nOld value = 0.25\nNew value = -0.5\n" in said
    assert "Old value = -0.5\nNew value = 1\n" in said
    assert "Hardware read watchpoint 3: ticks\n\nValue = 0\n" in said
    assert re.search(r"#0 .* tick \(\).*\n#1  <signal handler called>\n#2 ", said)
    assert "Hardware access (read/write) watchpoint 4: guarded\n\nValue = 4321\n" in said


def test_a_local_is_watched_until_its_function_ends(ask: Callable[..., str]) -> None:
    said = ask("break sum", "continue", "next", "watch total", *["continue"] * 6)
    values = re.findall(r"^New value = (\d+)$", said, re.MULTILINE)
    assert values[-4:] == ["1", "21", "321", "4321"]
    assert "deleted because the program has left the block in" in said


def test_next_stays_in_the_thread_when_interrupts_come(ask: Callable[..., str]) -> None:
    said = ask("break sum", "continue", "delete", *["next"] * 40, "info registers xpsr", "print ticks > 0")
    assert "tick ()" not in said and "note (" not in said
    assert int(re.search(r"xpsr +0x(\w+)", said)[1], 16) & 0x1FF == 0  # type: ignore[index]


def test_the_image_is_loaded_and_runs_from_its_reset(board_image: Path) -> None:
    """`load` of gdb goes by sectors of flash, as the memory map has them; the board is well after it."""
    vectors = board_image.with_suffix(".bin").read_bytes()[:8]
    reset = int.from_bytes(vectors[4:], "little") & ~1  # bit 0 says Thumb
    board = Running(board_image.with_suffix(".bin"), "--gdb=0", "--serial=tcp")
    try:
        port = re.search(r"^gdb +127\.0\.0\.1:(\d+)", board.told, re.MULTILINE)
        assert port is not None
        said = gdb(
            board_image,
            int(port[1]),
            *("load", "compare-sections", "break main", "continue", "delete"),
            *("monitor reset halt", "maintenance flush register-cache", "print/x $pc", "detach"),
        )
        assert f"Start address 0x{reset:08x}" in said
        assert "MIS-MATCHED" not in said and said.count("matched.") >= 8
        assert re.search(r"Breakpoint 1, main \(", said)
        assert f"$1 = 0x{reset:x}" in said
        with Client(open_transport(board.port)) as client:
            assert client.request(Msp.FC_VARIANT) == b"BTFL"
        code, out, errors = board.interrupt()
        assert (code, errors) == (0, "")
        assert out.endswith("resets: pin, pin\n")
    finally:
        board.end()


@pytest.mark.slow
def test_the_session_of_the_page_goes_as_it_says(board_image: Path) -> None:
    page = (ROOT / "docs/explanation/emulated-board.md").read_text().partition("## A session with gdb")[2]
    session = page.split("```")[3].strip().splitlines()
    command = [
        sys.executable,
        "-m",
        "neuroflight.cli.main",
        "fly",
        "--on",
        "emulator",
        "--scenario",
        "roll",
        "--gdb",
        "0",
    ]
    with subprocess.Popen(
        [*command, "--build", str(board_image.parent)],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as flight:
        assert flight.stderr is not None
        port = re.search(r"target remote :(\d+)", flight.stderr.readline())
        assert port is not None
        said = gdb(board_image, int(port[1]), *session)
        out, errors = flight.communicate(timeout=LIMIT_S)
    assert (flight.returncode, errors) == (0, "")
    assert re.search(
        r"watchpoint 2: firmware.control.motors\[0\]\n\nOld value = \S+\nNew value = \S+\ncontrol_mix ", said
    )
    assert re.search(r"^Value returned is \$3 = ", said, re.MULTILINE)
    assert "flown, disarmed" in out
