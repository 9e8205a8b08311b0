"""The emulated chip with its BOOT button held: a peer on USART1 in lockstep, true times, lost power."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ, BoardError
from neuroflight.sim.board.debug.snapshot import restore_snapshot, take_snapshot
from neuroflight.sim.board.peripherals.flash import Cut
from neuroflight.sim.board.peripherals.option_bytes import OptionBytes
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.rom.boot_loader import Stage
from neuroflight.sim.board.serial.bridge import LineTransport, UartLine
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES, FLASH_SECTORS
from tests.sim.board.programs import Program, compile_program  # noqa: F401 - a fixture
from tests.sim.board.rom.test_protocol import address, checked, command, sectors, write

ACK, NACK = b"\x79", b"\x1f"
FORMAT = Format(115_200, parity="E")
ODD = bytes(range(1, 256)) + b"\x00"
# Loads stack and first instruction from the ROM's two words, after what `BEFORE` does.
JUMP = """
NAKED reset(void) { __asm volatile(
    BEFORE
    "ldr r0, =0x1FF00000\\n\\tldr r1, [r0]\\n\\tmsr msp, r1\\n\\tldr r1, [r0, #4]\\n\\tbx r1\\n\\t.ltorg"); }
VECTORS(0);
"""
WATCHDOG = '"ldr r0, =0x40003000\\n\\tldr r1, =0xCCCC\\n\\tstr r1, [r0]\\n\\t"'
TICK = '"ldr r0, =0xE000E010\\n\\tmovs r1, #5\\n\\tstr r1, [r0]\\n\\t"'


@dataclass
class Peer:
    """The other end of the board's line."""

    board: Board
    format: Format = FORMAT

    def __post_init__(self) -> None:
        self.transport = LineTransport(UartLine(self.board, "USART1", self.format))

    def ask(self, request: bytes, size: int = 1, timeout: float = 0.3) -> bytes:
        """At most `size` bytes that come in answer, fewer after a silence of `timeout` [s]."""
        self.transport.write(request)
        answer = b""
        while len(answer) < size and (more := self.transport.read(timeout)):
            answer += more
        return answer

    def write(self, at: int, data: bytes) -> bytes:
        """The answers to a write, one behind the other."""
        request = write(at, data)
        return self.ask(request[:2]) + self.ask(request[2:7]) + self.ask(request[7:])

    def erase(self, *numbers: int) -> bytes:
        return self.ask(command(0x44)) + self.ask(sectors(*numbers), timeout=3.0 * len(numbers))

    def read(self, at: int, size: int) -> bytes:
        assert self.ask(command(0x11)) + self.ask(address(at)) == ACK + ACK
        return self.ask(command(size - 1), 1 + size)[1:]


@pytest.fixture
def start() -> Iterator[Callable[..., Peer]]:
    """Powers a board with the button held, and synchronises."""
    boards = []

    def make(flash: bytes = b"", **options: object) -> Peer:
        boards.append(Board(flash, boot_button=True, **options))  # type: ignore[arg-type]
        peer = Peer(boards[-1])
        assert peer.ask(b"\x7f") == ACK
        return peer

    yield make
    for board in boards:
        board.close()


# --- Into the ROM --------------------------------------------------------------------------------
@pytest.mark.parametrize("baud", [1200, 9600, 57_600, 115_200])
def test_it_answers_at_the_speed_of_the_first_byte_when_the_button_is_held(baud: float) -> None:
    peer = Peer(Board(b"", boot_button=True), Format(baud, parity="E"))
    assert peer.ask(b"\x7f") == ACK
    assert peer.ask(command(0x02), 5) == bytes.fromhex("7901045279")
    assert abs(peer.board.hardware.usarts["USART1"].format.baud / baud - 1) < 0.02


def test_it_stays_silent_when_the_first_byte_is_another_or_too_quick() -> None:
    peer = Peer(Board(b"", boot_button=True))
    assert peer.ask(b"$M<\x00\x01\x01") == b""
    assert peer.ask(b"\x7f") == ACK
    assert Peer(Board(b"", boot_button=True), Format(921_600, parity="E")).ask(b"\x7f") == b""


def test_nobody_understands_when_the_peer_sends_no_parity() -> None:
    peer = Peer(Board(b"", boot_button=True), Format(115_200))
    assert peer.ask(b"\x7f", timeout=0.01) == b""  # it answers with parity
    assert peer.board.hardware.rom.stage is Stage.SERVING


def test_an_image_comes_to_the_rom_when_it_jumps_there_as_after_a_reset(
    compile_program: Callable[[str], Program],  # noqa: F811
) -> None:
    program = compile_program(JUMP.replace("BEFORE", '""'))
    board = Board(program.flash, elf=program.elf)
    board.run(0.001)
    assert board.hardware.rom.runs
    assert Peer(board).ask(b"\x7f") == ACK
    board.reset()
    board.run(0.001)
    assert board.hardware.rom.stage is Stage.MEASURING
    assert Peer(board).ask(b"\x7f") == ACK


@pytest.mark.parametrize(
    ("before", "said"),
    [
        (WATCHDOG, "entered while the watchdog runs"),
        (TICK, "with interrupts or SysTick on"),
        (
            '"ldr r1, =0x20010000\\n\\tmsr msp, r1\\n\\tldr r1, =0x1FF00201\\n\\tbx r1\\n\\t"',
            "stack pointer 0x200100",
        ),
        (
            '"ldr r0, =0x1FF00000\\n\\tldr r1, [r0]\\n\\tmsr msp, r1\\n\\tadds r0, #1\\n\\tbx r0\\n\\t"',
            "at 0x1FF00001",
        ),
    ],
)
def test_the_board_fails_when_the_rom_is_not_entered_as_after_a_reset(
    compile_program: Callable[[str], Program],  # noqa: F811
    before: str,
    said: str,
) -> None:
    program = compile_program(JUMP.replace("BEFORE", before))
    board = Board(program.flash, elf=program.elf)
    with pytest.raises(BoardError, match=said):
        board.run(0.001)


def test_the_board_fails_when_the_option_bytes_start_the_watchdog() -> None:
    board = Board(b"", options=OptionBytes(optcr=OptionBytes().optcr & ~(1 << 5)), boot_button=True)
    with pytest.raises(BoardError, match="watchdog runs"):
        board.run(0.001)


# --- Flash ---------------------------------------------------------------------------------------
def test_erasing_and_programming_take_the_chip_s_time(start: Callable[..., Peer]) -> None:
    peer = start(bytes(FLASH_BYTES))
    begin = peer.board.cycle
    assert peer.erase(0, 4, 5) == ACK + ACK
    took = (peer.board.cycle - begin) / TIME_HZ
    assert 0.4 + 1.2 + 2.0 < took < 3.61
    for number, sector in enumerate(FLASH_SECTORS):
        first = peer.board.engine.memory(sector.address, 4)
        assert first == (b"\xff" * 4 if number in (0, 4, 5) else bytes(4))
    begin = peer.board.cycle
    assert peer.write(FLASH_BASE, ODD) == ACK * 3
    took = (peer.board.cycle - begin) / TIME_HZ
    on_line = (2 + 5 + 258 + 3) * 11 / 115_200
    assert on_line + 256 * 16e-6 < took < on_line + 256 * 16e-6 + 0.001
    assert peer.read(FLASH_BASE, 256) == ODD


def test_mass_erase_leaves_nothing(start: Callable[..., Peer]) -> None:
    peer = start(bytes(FLASH_BYTES))
    assert peer.ask(command(0x44)) == ACK
    assert peer.ask(checked(b"\xff\xff"), timeout=9.0) == ACK
    assert peer.board.engine.memory(FLASH_BASE, FLASH_BYTES) == b"\xff" * FLASH_BYTES


def test_bits_only_clear_when_something_stands_there(start: Callable[..., Peer]) -> None:
    peer = start(b"\x0f\xf0\xff\x00")
    assert peer.write(FLASH_BASE, b"\x3c\x3c\x3c\x3c") == ACK * 3
    assert peer.read(FLASH_BASE, 4) == b"\x0c\x30\x3c\x00"


def test_a_protected_sector_stays_and_nobody_is_told(start: Callable[..., Peer]) -> None:
    peer = start(bytes(16), options=OptionBytes(optcr=OptionBytes().optcr & ~(1 << 16)))
    assert peer.erase(0, 1) == ACK + ACK
    assert peer.write(FLASH_BASE + 32, b"abcd") == ACK * 3
    assert peer.read(FLASH_BASE, 4) + peer.read(FLASH_BASE + 32, 4) == bytes(4) + b"\xff" * 4


def test_ram_is_written_when_it_is_not_the_rom_s(start: Callable[..., Peer]) -> None:
    peer = start()
    assert peer.write(0x20008000, b"abcd") == ACK * 3
    assert peer.read(0x20008000, 4) == b"abcd"
    assert peer.ask(command(0x31)) + peer.ask(address(0x20001000)) == ACK + NACK


# --- Power and snapshots -------------------------------------------------------------------------
@pytest.mark.parametrize("operation", [0, 1, 2, 17])
def test_the_rom_waits_anew_when_power_is_lost_amid_an_operation(
    start: Callable[..., Peer], operation: int
) -> None:
    peer = start(bytes(64))
    flash = peer.board.hardware.flash
    flash.cut_at, flash.cut = operation, Cut.BETWEEN
    peer.erase(0)
    if operation:
        peer.write(FLASH_BASE, ODD)
    assert peer.board.engine.resets == ["power", "power"]
    assert peer.board.hardware.rom.stage is Stage.MEASURING
    assert flash.operations == operation + 1
    assert peer.ask(b"\x7f") == ACK
    assert peer.erase(0) == ACK + ACK
    assert peer.write(FLASH_BASE, ODD) == ACK * 3
    assert peer.read(FLASH_BASE, 256) == ODD


def test_it_goes_on_from_a_snapshot_when_that_was_taken_amid_a_request(start: Callable[..., Peer]) -> None:
    peer, other = start(bytes(64)), start(bytes(64))
    request = write(FLASH_BASE + 64, ODD)
    assert peer.ask(request[:2]) + peer.ask(request[2:7]) == ACK + ACK
    peer.transport.write(request[7:100])
    peer.board.run(0.003)  # within the data
    moments = [take_snapshot(peer.board.engine)]
    peer.transport.write(request[100:])
    while not peer.board.hardware.flash.operations:
        peer.board.run(0.0001)
    peer.board.run(0.001)  # within the programming
    moments.append(take_snapshot(peer.board.engine))
    assert peer.ask(b"") == ACK
    final = peer.board.cycle
    for moment, rest in zip(moments, (request[100:], b""), strict=True):
        restore_snapshot(other.board.engine, moment)
        assert other.ask(rest) == ACK
        assert other.board.cycle == final
        assert other.read(FLASH_BASE + 64, 256) == ODD


# --- Out of the ROM ------------------------------------------------------------------------------
PROGRAM = struct.pack("<IIHH", 0x20010000, FLASH_BASE + 9, 0xBF30, 0xE7FD)  # wfi, and again


def test_the_written_program_runs_when_told_to_go(start: Callable[..., Peer]) -> None:
    peer = start()
    assert peer.write(FLASH_BASE, PROGRAM) == ACK * 3
    assert peer.ask(command(0x21)) + peer.ask(address(FLASH_BASE)) == ACK + ACK
    peer.board.run(0.001)
    assert not peer.board.hardware.rom.runs
    assert peer.board.engine.pc - FLASH_BASE in (8, 10)
    assert peer.board.engine.register(13) == 0x20010000
    assert peer.board.hardware.rcc.words["APB2ENR"] == peer.board.hardware.rcc.words["AHB1ENR"] & 1 == 0
    assert peer.board.hardware.flash.get("CR", "LOCK")


def test_the_written_program_runs_when_the_button_is_let_go_at_power_up(start: Callable[..., Peer]) -> None:
    peer = start()
    assert peer.write(FLASH_BASE, PROGRAM) == ACK * 3
    peer.board.hold_boot_button(False)
    peer.board.reset()
    peer.board.run(0.001)
    assert not peer.board.hardware.rom.runs and peer.board.engine.sleeping


def test_the_board_fails_when_told_to_go_to_nothing(start: Callable[..., Peer]) -> None:
    peer = start(bytes(16))
    with pytest.raises(BoardError, match="reset vector is 0x00000000"):
        peer.ask(command(0x21))
        peer.ask(address(FLASH_BASE))
        peer.board.run(0.001)
