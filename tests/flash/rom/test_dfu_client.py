"""Our DFU client against the emulated chip's ROM, in lockstep: whole, refused, gone, another chip."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.flash.link.transport import LineGoneError
from neuroflight.flash.rom.client import NoBootLoaderError, RefusedError
from neuroflight.flash.rom.dfu_client import DfuClient, memory_sectors
from neuroflight.flash.rom.rescue import install, plan_flash, start, verify
from neuroflight.flash.rom.segments import read_segments
from neuroflight.flash.usb.control import StalledError
from neuroflight.sim.board.peripherals.option_bytes import OptionBytes
from neuroflight.sim.board.rom.dfu_descriptors import STRINGS
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.toolchain.contract import FLASH_BANK_A, FLASH_BASE, FLASH_BYTES, FLASH_SECTORS
from neuroflight.toolchain.errors import LinkError
from tests.flash.rom.conftest import BANK, FULL, SLOT_B, SMALL, flash_with
from tests.sim.board.rom import usb_host

PLAN = plan_flash(SMALL)
LOCKED = OptionBytes(optcr=0xC0FF55FC)


class Line:
    """A `ControlLine` through the tests' host, which may lose the device after so many requests."""

    name = "dfu"

    def __init__(self, host: usb_host.UsbHost) -> None:
        self.host = host
        self.alternates = tuple(
            host.control(0x80, 6, 0x0304 + n, 0x0409, 255)[2:].decode("utf-16-le") for n in range(4)
        )
        self.left: int | None = None
        self.closed = False

    def _count(self) -> None:
        if self.left is not None:
            self.left -= 1
            if self.left < 0:
                raise LineGoneError("dfu: the device is gone")

    def read(self, request: int, value: int, size: int, timeout: float) -> bytes:
        self._count()
        begin = self.host.now
        try:
            return self.host.control(0xA1, request, value, length=size)
        except usb_host.StalledError:
            raise StalledError("dfu: refused") from None
        finally:
            assert self.host.now - begin < timeout

    def write(self, request: int, value: int, data: bytes, timeout: float) -> None:
        self._count()
        try:
            self.host.control(0x21, request, value, data=data)
        except usb_host.StalledError:
            raise StalledError("dfu: refused") from None

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def chip() -> Iterator[Callable[..., Line]]:
    """Power a chip with its BOOT button held and a cable in."""
    boards = []

    def make(flash: bytes = b"", options: OptionBytes | None = None) -> Line:
        idle = IdleBoard(flash, boot_button=True, newly_installed=True)
        if options is not None:
            idle.board.hardware.flash.options = options
        boards.append(idle)
        idle.boot()
        host = usb_host.UsbHost(idle.board)
        host.plug()
        return Line(host)

    yield make
    for board in boards:
        board.close()


def client_of(line: Line) -> DfuClient:
    return DfuClient(line, line.host.board.run)


def flash(line: Line) -> bytes:
    return line.host.board.engine.memory(FLASH_BASE, FLASH_BYTES)


def test_other_sectors_stay_when_an_image_is_put_on_a_chip_in_use(chip: Callable[..., Line]) -> None:
    line = chip(FULL)
    client = client_of(line)
    assert client.connect().product_id == 0x452
    install(client, PLAN)
    under = bytearray(FULL)
    for number in PLAN.sectors:
        sector = FLASH_SECTORS[number]
        at = sector.address - FLASH_BASE
        under[at : at + sector.size] = b"\xff" * sector.size
    assert flash(line) == flash_with((*SMALL, SLOT_B), bytes(under))


@pytest.mark.slow
def test_the_image_flies_its_loop_when_an_erased_chip_gets_it(
    chip: Callable[..., Line], board_image: Path
) -> None:
    line = chip()
    plan = plan_flash(read_segments(board_image.with_suffix(".hex")))
    with client_of(line) as client:
        client.connect()
        begin = line.host.now
        install(client, plan)
        took = line.host.now - begin
        of_flash = plan.seconds(None) - 2 * -(-plan.bytes // 2048) * 0.015
        assert of_flash < took < 1.1 * of_flash  # the tests' host has no time of its own
        assert start(client)
    assert line.closed
    board = line.host.board
    board.run(1.5)
    assert not board.hardware.rom.runs and board.hardware.usarts["USART1"].words["CR1"] & 1
    assert board.engine.resets == ["power"]


def test_flash_is_compared_and_the_first_difference_told(chip: Callable[..., Line]) -> None:
    spoilt = bytearray(flash_with((*SMALL, SLOT_B)))
    spoilt[4] = 0
    line = chip(bytes(spoilt))
    client = client_of(line)
    client.connect()
    with pytest.raises(LinkError, match=r"1 of \d+ bytes in flash differ .* 0x08000004"):
        verify(client, PLAN)
    assert line.host.board.hardware.flash.operations == 0


def test_a_protected_chip_is_told_and_left_alone(chip: Callable[..., Line]) -> None:
    line = chip(FULL, LOCKED)
    client = client_of(line)
    client.connect()
    for act in (install, verify):
        with pytest.raises(RefusedError, match="read-protected"):
            act(client, PLAN)
    assert flash(line) == FULL


@pytest.mark.parametrize("left", [0, 1, 2, 5, 12, 24])
def test_the_line_says_what_was_not_written_when_the_device_goes(
    chip: Callable[..., Line], left: int
) -> None:
    line = chip(FULL)
    client = client_of(line)
    client.connect()
    line.left = left
    with pytest.raises(LinkError, match=r"nothing was written|does not start before this is done again"):
        install(client, PLAN)
    line.left = None
    line.host.board.run(3.0)
    again = client_of(line)
    again.connect()
    install(again, PLAN)
    at = FLASH_BANK_A.address - FLASH_BASE
    assert flash(line)[at : at + len(BANK)] == BANK


@pytest.mark.parametrize(
    "orders",
    [
        [(0x21, 1, 2, b"x")],  # DNLOAD, whose status nobody has asked for
        [(0x21, 1, 0, b"\x77"), (0xA1, 3, 0, b""), (0xA1, 3, 0, b"")],  # error
        [(0xA1, 2, 2, b"")],  # upload
    ],
)
def test_a_device_that_somebody_left_in_the_middle_is_made_ready(
    chip: Callable[..., Line], orders: list[tuple[int, int, int, bytes]]
) -> None:
    line = chip(FULL)
    for kind, request, value, data in orders:
        line.host.control(kind, request, value, length=6 if kind & 0x80 else 0, data=data)
    client = client_of(line)
    client.connect()
    assert client.read(FLASH_BASE + 100, 300) == FULL[100:400]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ((), "no memory of ST's"),
        (("@Internal Flash  /0x08000000/04*016Kg,01*064Kg,07*128Kg", STRINGS[4]), "07*128Kg"),
        ((STRINGS[3], "@Option Bytes  /0x1FFFC000/01*016 e"), "0x1FFFC000"),  # an F411
        ((STRINGS[3],), "expected the memories of an STM32F722"),
    ],
)
def test_another_chip_is_refused_by_its_memories(
    chip: Callable[..., Line], names: tuple[str, ...], said: str
) -> None:
    line = chip(FULL)
    line.alternates = names
    with pytest.raises(NoBootLoaderError, match="nothing was written") as caught:
        client_of(line).connect()
    assert said in str(caught.value)


@pytest.mark.parametrize("answer", [b"", b"\0\0", b"\0\0\0\0\x63\0"])
def test_an_answer_that_is_none_is_told(answer: bytes) -> None:
    class Odd:
        name, alternates = "dfu", STRINGS[3:]

        def read(self, request: int, value: int, size: int, timeout: float) -> bytes:
            return answer

        def write(self, request: int, value: int, data: bytes, timeout: float) -> None:
            raise AssertionError

        def close(self) -> None:
            pass

    with pytest.raises(LinkError, match="expected six bytes with a state"):
        DfuClient(Odd()).connect()


@pytest.mark.parametrize("address", [FLASH_BASE - 4, FLASH_BASE + FLASH_BYTES - 4, 0x1FFF0000, 0x40023C14])
def test_nothing_but_flash_is_ever_written(chip: Callable[..., Line], address: int) -> None:
    line = chip(FULL)
    client = client_of(line)
    client.connect()
    with pytest.raises(ValueError, match="expected flash"):
        client.write(address, bytes(8))
    assert line.host.board.hardware.flash.operations == 0


def test_sectors_are_read_from_a_name() -> None:
    assert memory_sectors(STRINGS[3]) == [(sector.address, sector.size) for sector in FLASH_SECTORS]
    assert memory_sectors("@OTP Memory /0x1FF07800/01*528e") == [(0x1FF07800, 528)]
    assert memory_sectors("@X/0x0/1*2Ma") == [(0, 2 << 20)]
    for wrong in ("", "@Flash", "@F/x/1*2", "@F/0x0/a*1", "@F/0x0/1*", "@F/0x0/99999999*1Kg/"):
        assert memory_sectors(wrong) == []
    assert len(memory_sectors("@F/0x0/99999999*1Kg")) < 10
