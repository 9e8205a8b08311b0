"""The emulated chip's ROM as ST's DFU device: requests, orders, refusals, who is first."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.debug.snapshot import restore_snapshot, take_snapshot
from neuroflight.sim.board.peripherals.option_bytes import OptionBytes
from neuroflight.sim.board.rom.boot_loader import Stage
from neuroflight.sim.board.usb.cable import Handshake
from neuroflight.sim.board.usb.enumeration import complete, enumerate_device
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES, FLASH_SECTORS
from tests.sim.board.programs import Program, compile_program  # noqa: F401 - a fixture
from tests.sim.board.rom.test_boot_loader import ACK, FORMAT, Peer
from tests.sim.board.rom.usb_host import StalledError, UsbHost

IDLE, DNLOAD_IDLE, MANIFEST, UPLOAD_IDLE, ERROR = 2, 5, 7, 9, 10
TARGET, VENDOR, STALLED = 1, 11, 15
USED = bytes(i % 251 + 1 for i in range(FLASH_BYTES))
LOCKED = OptionBytes(optcr=0xC0FF55FC)  # RDP level 1
DATA = bytes(range(256)) * 8
LOOP = 'NAKED reset(void) { __asm volatile("b ."); }\nVECTORS(0);'


def order(command: int, address: int) -> bytes:
    """One of ST's commands."""
    return bytes([command]) + address.to_bytes(4, "little")


@pytest.fixture
def plug() -> Iterator[Callable[..., UsbHost]]:
    """Power a chip with its BOOT button held and a cable in."""
    boards = []

    def make(flash: bytes = b"", **options: object) -> UsbHost:
        boards.append(Board(flash, boot_button=True, newly_installed=True, **options))  # type: ignore[arg-type]
        boards[-1].run(0.001)
        host = UsbHost(boards[-1])
        host.plug()
        return host

    yield make
    for board in boards:
        board.close()


def flash(host: UsbHost) -> bytes:
    return host.board.engine.memory(FLASH_BASE, FLASH_BYTES)


# --- What it is ----------------------------------------------------------------------------------
def test_its_descriptors_are_those_of_an_f722(plug: Callable[..., UsbHost]) -> None:
    host = plug()
    device = host.control(0x80, 6, 0x0100, length=64)
    assert device.hex() == "1201000100000040830411df002201020301"
    whole = host.control(0x80, 6, 0x0200, length=255)
    assert len(whole) == 0x36 == int.from_bytes(whole[2:4], "little")
    assert whole[-9:].hex() == "09210bff0000081a01"
    assert host.control(0x80, 6, 0x0200, length=9) == whole[:9]
    strings = [host.control(0x80, 6, 0x0300 | n, 0x0409, 255)[2:].decode("utf-16-le") for n in range(1, 8)]
    assert strings[3] == "@Internal Flash  /0x08000000/04*016Kg,01*64Kg,03*128Kg"
    assert sum(sector.size for sector in FLASH_SECTORS) == (4 * 16 + 64 + 3 * 128) * 1024
    for value in (0x0308, 0x0600, 0x0F00):
        with pytest.raises(StalledError):
            host.control(0x80, 6, value, length=64)
    assert host.control(0xA1, 2, 0, length=64) == bytes([0, 0x21, 0x41, 0x92])


def test_alternates_are_taken_and_others_refused(plug: Callable[..., UsbHost]) -> None:
    host = plug()
    for alternate in range(4):
        host.control(0x01, 11, alternate)
        assert host.control(0x81, 10, length=1) == bytes([alternate])
    for kind, number, value in ((0x01, 11, 4), (0x00, 9, 2), (0x00, 7, 0), (0xC0, 1, 0), (0x02, 1, 0)):
        with pytest.raises(StalledError):
            host.control(kind, number, value, length=1 if kind & 0x80 else 0)
    assert host.control(0x80, 8, length=1) == b"\1"


# --- Orders --------------------------------------------------------------------------------------
def test_a_sector_is_erased_and_written_in_the_time_of_flash(plug: Callable[..., UsbHost]) -> None:
    host = plug(USED)
    address = FLASH_SECTORS[4].address
    begin = host.now
    assert host.download(0, order(0x41, address)) == (0, 1200, DNLOAD_IDLE)
    assert 1.2 <= host.now - begin < 1.25
    assert host.naks <= 1  # asked at the very cycle in which it ends
    assert host.download(0, order(0x21, address)) == (0, 1, DNLOAD_IDLE)
    begin = host.now
    assert host.download(2, DATA) == (0, 33, DNLOAD_IDLE)  # 2048 bytes of 16 us
    assert 0.0327 < host.now - begin < 0.04
    assert host.download(4, DATA[:100]) == (0, 2, DNLOAD_IDLE)
    at = address - FLASH_BASE
    expected = bytearray(USED)
    expected[at : at + 0x10000] = b"\xff" * 0x10000
    expected[at : at + 2048] = DATA
    expected[at + 4096 : at + 4196] = DATA[:100]
    assert flash(host) == expected
    host.control(0x21, 6)  # ABORT
    assert host.status() == (0, 0, IDLE)
    assert host.control(0xA1, 2, 4, length=2048)[:100] == DATA[:100]
    assert host.status() == (0, 0, UPLOAD_IDLE)


def test_who_does_not_wait_as_told_waits_for_the_answer(plug: Callable[..., UsbHost]) -> None:
    host = plug(USED)
    host.control(0x21, 1, 0, data=order(0x41, FLASH_BASE))
    assert host.status() == (0, 400, 4)
    begin = host.now
    assert host.status() == (0, 0, DNLOAD_IDLE)
    assert host.naks > 0 and 0.39 < host.now - begin < 0.41


def test_the_whole_chip_is_erased_by_one_byte(plug: Callable[..., UsbHost]) -> None:
    host = plug(USED)
    assert host.download(0, b"\x41") == (0, 8000, DNLOAD_IDLE)
    assert flash(host) == b"\xff" * FLASH_BYTES


def test_an_erasure_goes_on_when_the_bus_is_reset(plug: Callable[..., UsbHost]) -> None:
    host = plug(USED)
    host.control(0x21, 1, 0, data=order(0x41, FLASH_BASE))
    host.status()
    host.plug()
    assert host.now > 0.4 and host.naks  # SET_ADDRESS waited
    assert host.status() == (0, 0, IDLE)
    assert flash(host)[:0x4001] == b"\xff" * 0x4000 + USED[0x4000:0x4001]


def test_half_of_it_is_there_when_power_goes_amid_writing(plug: Callable[..., UsbHost]) -> None:
    host = plug()
    host.board.hardware.flash.cut_at = 1000
    host.control(0x21, 1, 2, data=DATA)
    host.status()
    host.board.run(0.1)
    assert flash(host)[:999] == DATA[:999] and flash(host)[1001:2048] == b"\xff" * 1047
    host.plug()  # the button is still held
    assert host.status() == (0, 0, IDLE)


# --- Refusals ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("block", "data", "status"),
    [
        (0, order(0x41, FLASH_BASE - 1), TARGET),
        (0, order(0x41, FLASH_BASE + FLASH_BYTES), TARGET),
        (0, order(0x41, 0x1FFF0000), TARGET),
        (0, order(0x21, 0x40000000), TARGET),
        (0, order(0x41, FLASH_BASE)[:3], STALLED),
        (0, b"\x00", STALLED),
        (0, b"\x92\x00", STALLED),
        (0, b"\x77", STALLED),
        (258, DATA, TARGET),  # just behind flash
    ],
)
def test_a_wrong_order_is_an_error_that_clrstatus_lifts(
    plug: Callable[..., UsbHost], block: int, data: bytes, status: int
) -> None:
    host = plug(USED)
    assert host.download(block, data)[::2] == (status, ERROR)
    for again in ((0x21, 1), (0xA1, 2)):
        with pytest.raises(StalledError):
            host.control(*again, 2, length=64 if again[0] & 0x80 else 0)
    host.control(0x21, 4)
    assert host.status() == (0, 0, IDLE)
    assert flash(host) == USED and host.board.hardware.flash.operations == 0


@pytest.mark.parametrize(
    ("request_", "length"),
    [((0x21, 1, 1), -1), ((0xA1, 2, 1), 64), ((0xA1, 2, 2), 4096), ((0x21, 0, 0), 0), ((0x21, 4, 0), 0)],
)
def test_a_request_that_does_not_fit_stalls(
    plug: Callable[..., UsbHost], request_: tuple[int, int, int], length: int
) -> None:
    host = plug(USED)
    with pytest.raises(StalledError):
        host.control(*request_, length=max(length, 0), data=DATA if length < 0 else b"")
    assert host.status() == (STALLED, 0, ERROR)


def test_nothing_is_read_or_written_when_the_chip_is_protected(plug: Callable[..., UsbHost]) -> None:
    host = plug(USED, options=LOCKED)
    for block, data in ((0, order(0x21, FLASH_BASE)), (0, order(0x41, FLASH_BASE)), (2, DATA)):
        assert host.download(block, data)[::2] == (VENDOR, ERROR)
        host.control(0x21, 4)
    with pytest.raises(StalledError):
        host.control(0xA1, 2, 2, length=64)
    assert host.status() == (VENDOR, 0, ERROR)
    assert flash(host) == USED


def test_lifting_the_protection_erases_the_chip_and_resets_it(plug: Callable[..., UsbHost]) -> None:
    host = plug(USED, options=LOCKED)
    host.control(0x21, 1, 0, data=b"\x92")
    assert host.status() == (0, 8000, 4)
    host.board.run(8.01)
    host.plug()
    assert host.download(2, DATA)[::2] == (0, DNLOAD_IDLE)
    assert flash(host) == DATA.ljust(FLASH_BYTES, b"\xff")


# --- Into it, who is first, and out of it ----------------------------------------------------------
def test_whoever_speaks_first_is_served(plug: Callable[..., UsbHost]) -> None:
    host = plug()
    assert Peer(host.board).ask(b"\x7f") == b""
    assert host.status() == (0, 0, IDLE)
    host.board.reset()
    host.board.run(0.06)
    dfu = host.board.hardware.rom.dfu
    assert dfu.attached  # the cable is in as before
    assert Peer(host.board).ask(b"\x7f") == ACK
    assert not dfu.attached
    assert dfu.setup(0, 0, bytes.fromhex("8006000100004000")) is Handshake.SILENT


def test_a_computer_sees_it_go_and_come_when_the_chip_restarts() -> None:
    """The emulated computer at the board's connector, which shows the OTG to it while an image runs."""
    board = Board(b"", boot_button=True)
    host = board.hardware.usb_host
    host.plug()
    changes: list[bool] = []
    host.on_change = lambda: changes.append(host.connected)
    for _ in range(2):
        board.run(0.5)
        found = complete(host, enumerate_device(host), board.run_to)
        assert (found.vendor, found.product, found.release) == (0x0483, 0xDF11, 0x2200)
        board.reset()
    board.run(0.01)
    assert changes == [True, False, True, False]


def test_a_cable_alone_takes_nothing_from_usart1(plug: Callable[..., UsbHost]) -> None:
    board = Board(b"", boot_button=True)
    board.run(0.001)
    board.hardware.rom.dfu.vbus(True)  # a charger
    assert Peer(board, FORMAT).ask(b"\x7f") == ACK


def test_nobody_is_there_while_an_image_runs(compile_program: Callable[[str], Program]) -> None:  # noqa: F811
    program = compile_program(LOOP)
    board = Board(program.flash, elf=program.elf)
    board.hardware.rom.dfu.vbus(True)
    board.run(0.001)
    assert not board.hardware.rom.dfu.attached


def test_leave_starts_what_the_pointer_points_to(
    plug: Callable[..., UsbHost],
    compile_program: Callable[[str], Program],  # noqa: F811
) -> None:
    program = compile_program(LOOP)
    host = plug(program.flash)
    host.download(0, order(0x21, FLASH_BASE))
    host.control(0x21, 1)  # DNLOAD without data
    status, wait, state = host.status()
    assert (status, state) == (0, MANIFEST)
    assert host.board.hardware.rom.stage is Stage.DFU
    host.board.run(wait / 1000 + 0.001)
    assert not host.board.hardware.rom.dfu.attached
    assert FLASH_BASE <= host.board.engine.pc < FLASH_BASE + FLASH_BYTES
    assert host.board.hardware.flash.get("CR", "LOCK")


def test_it_goes_on_from_a_snapshot_when_that_was_taken_amid_an_order(plug: Callable[..., UsbHost]) -> None:
    host = plug()
    host.control(0x21, 1, 2, data=DATA)
    host.status()
    host.board.run(0.01)
    snapshot = take_snapshot(host.board.engine)
    ends = []
    for _ in range(2):
        restore_snapshot(host.board.engine, snapshot)
        host.naks = 0
        ends.append((host.status(), flash(host)[:2048] == DATA, host.naks, host.board.cycle))
    assert ends[0] == ends[1]
    assert ends[0][:2] == ((0, 0, DNLOAD_IDLE), True) and host.naks > 100
