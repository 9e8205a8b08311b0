"""Our client and plan against the emulated chip's ROM: whole, spoilt, silent, and without power."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.flash.board.restart import enter_rom
from neuroflight.flash.link import messages
from neuroflight.flash.link.transport import Transport
from neuroflight.flash.rom.client import NoBootLoaderError, RefusedError, RomClient
from neuroflight.flash.rom.rescue import FlashPlan, install, plan_flash, start, verify
from neuroflight.flash.rom.segments import Segment, read_segments
from neuroflight.sim.board.peripherals.flash import Cut
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.toolchain.contract import (
    FLASH_BANK_A,
    FLASH_BASE,
    FLASH_BYTES,
    FLASH_SECTORS,
    Msp,
)
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.image.elf import read_flashable
from tests.flash.rom.conftest import BANK, BOOT, FULL, SLOT_B, SMALL, Rig, flash_with
from tests.sampling import sampled

PLAN = plan_flash(SMALL)


class Spoilt:
    """A line that lets a spoiler change what passes, either way."""

    def __init__(
        self,
        transport: Transport,
        sent: Callable[[bytes], bytes] = lambda data: data,
        heard: Callable[[bytes], bytes] = lambda data: data,
    ) -> None:
        self._transport, self._sent, self._heard = transport, sent, heard

    @property
    def name(self) -> str:
        return "spoilt"

    def read(self, timeout: float) -> bytes:
        return self._heard(self._transport.read(timeout))

    def write(self, data: bytes) -> None:
        if data := self._sent(data):
            self._transport.write(data)

    def close(self) -> None:
        self._transport.close()


def flip(position: int) -> Callable[[bytes], bytes]:
    """Changes one bit of the byte at `position` of all that passes."""
    passed = 0

    def change(data: bytes) -> bytes:
        nonlocal passed
        at, passed = position - passed, passed + len(data)
        if 0 <= at < len(data):
            return data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :]
        return data

    return change


def stall(position: int) -> Callable[[bytes], bytes]:
    """Lets `position` bytes pass and no more."""
    passed = 0

    def cut(data: bytes) -> bytes:
        nonlocal passed
        left, passed = max(0, position - passed), passed + len(data)
        return data[:left]

    return cut


def put(client: RomClient, plan: FlashPlan = PLAN) -> None:
    client.connect()
    install(client, plan)


def failure(client: RomClient, plan: FlashPlan = PLAN) -> str:
    """The one line in which an installation ends."""
    with pytest.raises(LinkError) as caught:
        put(client, plan)
    line = str(caught.value)
    assert "\n" not in line and len(line) < 400
    return line


# --- The way in without the button ---------------------------------------------------------------
def test_the_rom_takes_an_image_when_msp_asked_the_firmware_for_it(board_image: Path) -> None:
    flash = read_flashable(board_image.with_suffix(".bin"))
    with closing(IdleBoard(flash, elf=board_image)) as idle:
        idle.boot()
        with idle.client() as client:
            enter_rom(client)
        rig = Rig(idle)
        with rig.client() as rom:
            assert rom.connect().product_id == 0x452
            plan = plan_flash(read_segments(board_image.with_suffix(".hex")))
            verify(rom, replace(plan, segments=plan.segments[:1]))  # the boot part
        rig.idle.board.reset()
        idle.boot()
        with idle.client() as client:
            assert messages.api_version(client.request(Msp.API_VERSION)).major == 1


# --- Whole ---------------------------------------------------------------------------------------
@pytest.mark.slow
def test_the_image_flies_its_loop_when_an_erased_chip_gets_it(
    rig: Callable[..., Rig], board_image: Path
) -> None:
    chip = rig()
    said: list[tuple[str, int, int]] = []
    plan = plan_flash(read_segments(board_image.with_suffix(".hex")))
    with chip.client() as client:
        assert client.connect().product_id == 0x452
        begin = chip.idle.board.cycle
        install(client, plan, lambda *what: said.append(what))
        took = (chip.idle.board.cycle - begin) / 216e6
        assert client.repeated == 0
        assert abs(took / plan.seconds(115_200) - 1) < 0.1
        assert start(client)
    assert [what for what, done, total in said if done == total] == ["erase", "write", "verify"]
    assert chip.idle.flash()[: len(board_image.with_suffix(".bin").read_bytes())] == (
        board_image.with_suffix(".bin").read_bytes()
    )
    chip.idle.boot()
    board = messages.board_info(chip.idle.client().request(Msp.BOARD_INFO))
    assert "MATEKF722" in repr(board)
    assert chip.idle.board.engine.resets == ["power"]


@pytest.mark.parametrize(("all_banks", "erased"), [(False, (0, 5, 7)), (True, (0, 5, 6, 7))])
def test_other_sectors_stay_when_an_image_is_put_on_a_chip_in_use(
    rig: Callable[..., Rig], all_banks: bool, erased: tuple[int, ...]
) -> None:
    chip = rig(FULL)
    plan = plan_flash(SMALL, erase_bank_b=all_banks)
    assert plan.sectors == erased and set(plan.kept) == set(range(8)) - set(erased)
    put(chip.client(), plan)
    under = bytearray(FULL)
    for number in erased:
        sector = FLASH_SECTORS[number]
        start_, end = sector.address - FLASH_BASE, sector.address - FLASH_BASE + sector.size
        under[start_:end] = b"\xff" * sector.size
    assert chip.idle.flash() == flash_with((*SMALL, SLOT_B), bytes(under))


def test_the_boot_part_is_erased_first_and_written_last(rig: Callable[..., Rig]) -> None:
    orders: list[tuple[int, ...]] = []
    chip = rig(FULL)
    chip.idle.board.hardware.flash.on_begin = lambda what: orders.append(tuple(what.split()[2:3]))  # type: ignore[arg-type]
    put(chip.client())
    places = [int(order[0], 16) for order in orders]  # type: ignore[call-overload]
    assert places[0] == FLASH_BASE
    written = places[3:]
    assert written[:5] == [*(SLOT_B.address + i for i in range(4)), FLASH_BANK_A.address]
    assert written[-len(BOOT) :] == [FLASH_BASE + i for i in range(len(BOOT))]


def test_words_are_filled_up_when_segments_begin_and_end_within_them() -> None:
    segments = (
        Segment(FLASH_BASE, BOOT),
        Segment(FLASH_BASE + 0x101, b"abc"),
        Segment(FLASH_BASE + 0x105, b"d"),
        Segment(FLASH_BASE + 0x107, b"efg"),
    )
    assert plan_flash(segments).segments == (
        Segment(FLASH_BASE, BOOT),
        Segment(FLASH_BASE + 0x100, b"\xffabc"),
        Segment(FLASH_BASE + 0x104, b"\xffd\xffefg\xff\xff"),
        SLOT_B,
    )


# --- Compared ------------------------------------------------------------------------------------
def test_difference_is_told_by_its_first_address_when_only_compared(rig: Callable[..., Rig]) -> None:
    spoilt = bytearray(flash_with((*SMALL, SLOT_B)))
    spoilt[4], spoilt[0x20010] = 0, 0
    chip = rig(bytes(spoilt))
    client = chip.client()
    client.connect()
    with pytest.raises(
        LinkError, match=r"2 of \d+ bytes in flash differ from the image, the first at 0x08000004"
    ):
        verify(client, PLAN)
    assert chip.idle.flash() == spoilt


def test_a_protected_sector_is_found_by_comparing(rig: Callable[..., Rig]) -> None:
    chip = rig(bytes(FLASH_BYTES))
    chip.idle.board.hardware.flash.options = chip.idle.board.hardware.flash.options.with_registers(
        0xC0FFAAFC & ~(1 << 21), 0x00400080, 0x800000FF
    )
    line = failure(chip.client())
    assert f"first at 0x{FLASH_BANK_A.address:08X}" in line and "write-protected" in line


OPTION_BYTES = 0x1FFF0000  # with the read protection in the second one


@pytest.mark.parametrize(
    ("address", "data"),
    [
        (OPTION_BYTES, b"\xfc\xcc\x03\x33"),  # RDP 0xCC: the chip is locked for ever
        (OPTION_BYTES + 1, b"\xcc"),
        (FLASH_BASE + FLASH_BYTES - 4, bytes(8)),
        (FLASH_BASE - 4, bytes(8)),
        (0x40023C14, bytes(4)),  # FLASH_OPTCR
    ],
)
def test_nothing_but_flash_is_ever_written(rig: Callable[..., Rig], address: int, data: bytes) -> None:
    chip = rig(bytes(FLASH_BYTES))
    before = chip.idle.board.hardware.flash.options
    client = chip.client()
    client.connect()
    with pytest.raises(ValueError, match="expected flash"):
        client.write(address, data)
    assert chip.idle.board.hardware.flash.options == before
    assert chip.idle.board.hardware.flash.operations == 0


def test_an_image_that_brings_option_bytes_is_refused(tmp_path: Path) -> None:
    """As a chip's dump by another tool does."""
    path = tmp_path / "dump.hex"
    path.write_text(
        ":020000040800F2\n:0400000000000000FC\n:020000041FFFDC\n:04000000FCCC0333FE\n:00000001FF\n"
    )
    with pytest.raises(LinkError, match="0x1FFF0000"):
        read_segments(path)


# --- A spoilt line -------------------------------------------------------------------------------
@pytest.mark.parametrize("way", sampled(["sent", "heard"], "sent"))
def test_flash_holds_the_image_when_any_one_byte_on_the_line_was_another(
    rig: Callable[..., Rig], way: str
) -> None:
    """At every position of connecting, erasing and the first command to write; then at some of the rest."""
    positions = [*range(0, 45), *range(45, 600, 61)]
    ended = 0
    chip = rig()
    for position in positions:
        chip.renew(FULL)
        try:
            put(chip.client(lambda line, at=position: Spoilt(line, **{way: flip(at)})))  # type: ignore[misc]
        except LinkError as error:
            assert "\n" not in str(error)
            put(chip.client())
        else:
            ended += 1
        chip.check_whole()
    assert ended > 0.9 * len(positions)


@pytest.mark.parametrize("position", [0, 1, 3, 8, 9, 14, 40, 43, 48, 49, 150, 320, 350])
def test_the_line_says_what_was_not_written_and_the_next_try_works_when_it_stalls(
    rig: Callable[..., Rig], position: int
) -> None:
    chip = rig(FULL)
    line = failure(chip.client(lambda line: Spoilt(line, sent=stall(position))))
    if chip.idle.flash() == FULL:
        assert "nothing was written" in line
    else:
        assert "the board does not start before this is done again" in line
    put(chip.client())
    chip.check_whole()


class Scripted:
    """A boot loader that answers each write on the line from a table, and everything else with `default`."""

    name = "scripted"

    def __init__(self, answers: dict[bytes, bytes], default: bytes = b"") -> None:
        self._answers, self._default, self._due = answers, default, b""
        self.now = 0.0

    def read(self, timeout: float) -> bytes:
        due, self._due = self._due, b""
        self.now += 0.0 if due else timeout
        return due

    def write(self, data: bytes) -> None:
        self._due += self._answers.get(data, self._default)

    def close(self) -> None:
        pass


HELLO = {b"\x7f": b"\x79", b"\x00\xff": bytes.fromhex("790b310001021121314463738292 79")}
F722 = {b"\x02\xfd": bytes.fromhex("7901045279")}


@pytest.mark.parametrize(
    ("answers", "default", "said"),
    [
        ({}, b"", "nobody answers"),
        ({b"\x7f": b"\x7f"}, b"\x7f" * 48, "the line echoes what is sent"),
        ({}, b"$M>\x03\x01", "bytes came that are no answer, such as 24 4d 3e"),
        ({**HELLO, b"\x02\xfd": bytes.fromhex("7901041379")}, b"", "the boot loader of chip 0x413"),
        (
            {**HELLO, b"\x00\xff": bytes.fromhex("790b3100010211213143637382 9279")},
            b"",
            "without the command 0x44",
        ),
        ({**HELLO, **F722, b"\x44\xbb": b"\x1f"}, b"\x1f", "refuses to erase sector 0"),
    ],
)
def test_a_board_is_left_alone_when_it_is_not_ours(
    answers: dict[bytes, bytes], default: bytes, said: str
) -> None:
    peer = Scripted(answers, default)
    line = failure(RomClient(peer, lambda: peer.now))
    assert said in line
    assert "nothing was written" in line or "another board" in line


def test_reading_names_the_protection_when_it_is_refused() -> None:
    peer = Scripted({**HELLO, **F722, b"\x11\xee": b"\x1f"}, b"\x1f")
    client = RomClient(peer, lambda: peer.now)
    client.connect()
    with pytest.raises(RefusedError, match=r"may be read-protected.*0 of .* bytes are compared"):
        verify(client, PLAN)


# --- Without power -------------------------------------------------------------------------------
@pytest.mark.parametrize("cut", [Cut.BETWEEN, Cut.NOISE, Cut.BEFORE])
@pytest.mark.parametrize("operation", [0, 1, 2, 3, 200, len(BANK) + 2, len(BANK) + len(BOOT) + 1])
def test_the_next_try_works_when_power_is_lost_amid_an_operation(
    rig: Callable[..., Rig], operation: int, cut: Cut
) -> None:
    """With the button still held, the ROM is there again at once, and the very first try may succeed."""
    chip = rig(FULL)
    board = chip.idle.board
    flash = board.hardware.flash
    flash.cut_at, flash.cut = operation, cut
    try:
        put(chip.client())  # the ROM answers again after the cut
    except LinkError as error:
        assert "differ from the image" in str(error)
        assert cut is Cut.NOISE
        put(chip.client())
    assert board.engine.resets == ["power", "power"]
    chip.check_whole()


@pytest.mark.slow
@pytest.mark.parametrize("second", [None, 0, 1, 2, 5, 150])
def test_the_image_is_whole_in_the_end_wherever_power_is_lost_once_or_twice(
    rig: Callable[..., Rig], second: int | None
) -> None:
    """Every operation of an installation; then, counted from there, another one of what mends it."""
    chip = rig()
    flash = chip.idle.board.hardware.flash
    for operation in range(2 + len(BANK) + len(BOOT)):
        chip.renew(FULL)
        flash.cut_at, flash.cut = flash.operations + operation, Cut.NOISE
        for left in (1, 0):
            try:
                put(chip.client())
            except LinkError as error:
                assert "differ from the image" in str(error)
            flash.cut_at = flash.operations + second if left and second is not None else None
        put(chip.client())
        chip.check_whole()


def test_the_line_is_told_when_the_board_is_gone_amid_writing(rig: Callable[..., Rig]) -> None:
    chip = rig(FULL)

    def gone(data: bytes) -> bytes:
        return b"" if chip.idle.board.hardware.flash.operations > 100 else data

    line = failure(chip.client(lambda line: Spoilt(line, sent=gone, heard=gone)))
    assert "sector 0, 5, 7 erased, " in line and "none compared" in line and "silence" in line
    put(chip.client())
    chip.check_whole()


def test_nobody_is_written_to_before_he_is_known() -> None:
    peer = Scripted({})
    with pytest.raises(NoBootLoaderError):
        RomClient(peer, lambda: peer.now).connect()
