"""The emulated SD card as an independent host finds it, byte by byte."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.devices.sd_card import CardTiming, SdCard
from neuroflight.toolchain.errors import LinkError
from tests.sim.board.devices.host import SLOW_HZ, Host, blank, blocks_of, crc7, pattern

OK, ACCEPTED, CRC_ERROR = b"\x00", 5, 11
BLOCKS = 2048
Make = Callable[..., Host]


@pytest.fixture
def image(tmp_path: Path) -> Path:
    return blank(tmp_path / "card.img", BLOCKS)


@pytest.fixture
def make(image: Path) -> Make:
    """A host of a card that has just got its power; options are the card's."""
    return lambda chunk=1 << 20, **options: Host(SdCard(image, **options), chunk=chunk)


@pytest.fixture
def host(make: Make) -> Host:
    """A host of a card that is initialised, with checksums on."""
    host = make()
    host.start()
    return host


@pytest.fixture
def fresh(make: Make) -> Host:
    """A host of a card that was told to be idle, and no more."""
    host = make()
    host.send(b"\xff" * 10)
    host.command(0)
    return host


# ---- power-up ----


def test_a_card_initialises_within_a_second(host: Host) -> None:
    assert 0.05 < host.seconds < 1.0
    assert host.command(58, 0, 4) == OK + bytes((0xC0, 0xFF, 0x80, 0x00))


def test_a_card_does_not_hear_when_it_was_not_clocked_before(make: Make) -> None:
    host = make()
    host.send(b"\xff" * 9)  # 72 clocks
    assert host.command(0) == b""


def test_a_card_does_not_hear_when_the_first_command_is_broken(make: Make) -> None:
    host = make()
    host.send(b"\xff" * 10)
    assert host.command(0, crc=0x97) == b""
    assert host.command(0, crc=0x95) == b"\x01"  # as every host has it stored


def test_a_card_says_what_is_wrong_with_the_command_that_asks_for_its_version(fresh: Host) -> None:
    assert fresh.command(8, 0x1AA, crc=0x89) == b"\x09"
    assert fresh.command(8, 0x1AA, 4, crc=0x87) == bytes((1, 0, 0, 1, 0xAA))
    assert fresh.command(8, 0x25A, 4) == bytes((1, 0, 0, 0, 0x5A))  # a voltage that it has not


@pytest.mark.parametrize(("told", "argument"), [(False, 1 << 30), (True, 0)])
def test_a_card_never_gets_ready_when_the_host_knows_no_large_cards(
    fresh: Host, told: bool, argument: int
) -> None:
    if told:
        fresh.command(8, 0x1AA, 4)
    for _ in range(20):
        assert fresh.application(41, argument) == b"\x01"
        fresh.rest(0.1)


def test_most_commands_are_illegal_before_the_initialisation(fresh: Host) -> None:
    for index in (9, 10, 12, 13, 16, 17, 18, 24, 25, 32, 33, 38, 41, 60):
        assert fresh.command(index) == b"\x05", index
    assert fresh.command(58, 0, 4)[1] & 0x80 == 0


@pytest.mark.parametrize(
    ("initialised", "hz", "mode", "message"),
    [
        (False, 400_001, 0, "clocked at 0.400001 MHz before it is initialised, expected 0.4 MHz at most"),
        (True, 25_000_001, 0, "MHz after its initialisation, expected 25 MHz at most"),
        (True, 1_000_000, 1, "SPI mode 1, expected 0 or 3"),
    ],
)
def test_a_clock_that_no_card_takes_is_an_error(
    make: Make, initialised: bool, hz: int, mode: int, message: str
) -> None:
    host = make()
    if initialised:
        host.start()
    host.hz, host.mode = hz, mode
    host.select(True)
    with pytest.raises(BoardError, match=message):
        host.send(b"\xff")


def test_a_card_is_back_at_its_slow_clock_after_a_restart(host: Host) -> None:
    with pytest.raises(BoardError, match="before it is initialised"):
        host.command(0)
    host.hz = SLOW_HZ
    host.start()
    assert host.write(0, pattern(0)) == [ACCEPTED]


# ---- registers ----


def test_capacity_and_identity_are_those_of_the_image(make: Make) -> None:
    host = make(seed=0x1234)
    host.start()
    assert host.command(9) == OK
    csd = host.data(16)
    assert csd[0] == 0x40
    assert (int.from_bytes(csd[7:10], "big") & 0x3FFFFF) + 1 == BLOCKS // 1024
    assert csd[3] == 0x32  # 25 MHz
    assert csd[15] == crc7(csd[:15])
    assert host.command(10) == OK
    cid = host.data(16)
    assert cid[3:8] == b"EMUSD"
    assert cid[9:13] == bytes((0, 0, 0x12, 0x34))
    assert cid[15] == crc7(cid[:15])


@pytest.mark.parametrize("erased", [0x00, 0xFF])
def test_a_card_says_what_erased_bytes_are(make: Make, erased: int) -> None:
    host = make(erased=erased)
    host.start()
    assert host.application(51) == OK
    assert host.data(8)[1] >> 7 == (erased == 0xFF)
    assert host.application(13, 0, 1) == OK + b"\x00"
    assert len(host.data(64)) == 64
    host.write(10, *[pattern(i) for i in range(4)])
    host.erase(11, 12)
    assert host.read(10, 4) == pattern(0) + bytes([erased]) * 1024 + pattern(3)


# ---- blocks ----


@pytest.mark.parametrize("chunk", [1, 7, 1 << 20])
def test_blocks_read_back_however_the_bytes_are_cut(make: Make, image: Path, chunk: int) -> None:
    host = make(chunk)
    host.start()
    data = [pattern(i) for i in range(5)]
    assert host.write(100, data[0]) == [ACCEPTED]
    assert host.write(101, *data[1:]) == [ACCEPTED] * 4
    assert host.read(101) == data[1]
    assert host.read(100, 5) == b"".join(data) == blocks_of(image, 100, 5)
    assert blocks_of(image, 0, 100) == bytes(100 * 512)
    assert host.application(22) == OK
    assert host.data(4) == (4).to_bytes(4, "big")


def test_the_same_bytes_come_when_they_are_cut_otherwise(image: Path) -> None:
    def run(chunk: int) -> tuple[int, bytes]:
        host = Host(SdCard(image, seed=5), chunk=chunk)
        host.start()
        host.select(True)
        sent = b"".join(
            bytes([0x40 | index, 0, 0, 0, argument, crc7(bytes([0x40 | index, 0, 0, 0, argument]))]) + rest
            for index, argument, rest in (
                (24, 3, b"\xff" * 8 + b"\xfe" + bytes(514) + b"\xff" * 4000),
                (18, 2, b"\xff" * 4000),
                (12, 0, b"\xff" * 3000),
                (59, 0, b"\xff" * 9),
            )
        )
        got = host.send(sent)
        host.card.close()
        return host.cycle, got

    assert run(1) == run(64) == run(1 << 20)


def test_a_block_is_in_the_file_before_the_next_one_is_sent(host: Host, image: Path) -> None:
    assert host.command(25, 20) == OK
    for number in range(3):
        assert host.put(0xFC, pattern(number)) == ACCEPTED
        host.wait()
        assert blocks_of(image, 20 + number) == pattern(number)
        assert blocks_of(image, 21 + number) == bytes(512)


def test_a_host_may_let_go_of_the_card_while_it_is_busy(host: Host) -> None:
    host.command(25, 20)
    host.put(0xFC, pattern(1))
    host.select(False)
    assert host.send(b"\xff" * 3) == b"\xff" * 3
    host.select(True)
    assert host.send(b"\xff") == b"\x00"
    host.wait()
    assert host.put(0xFC, pattern(2)) == ACCEPTED
    host.wait()
    host.send(b"\xfd\xff")
    host.wait()
    host.select(False)
    assert host.read(20, 2) == pattern(1) + pattern(2)


def test_what_was_being_said_is_forgotten_when_the_host_lets_go(host: Host, image: Path) -> None:
    def reselect() -> None:
        host.select(False)
        host.send(b"\xff")
        host.select(True)

    assert host.command(25, 30) == OK
    host.send(b"\xff\xfc" + bytes([0x55]) * 300)  # a part of a block
    reselect()
    assert host.put(0xFC, pattern(1)) == ACCEPTED
    host.wait()
    host.send(b"\xfd\xff")
    host.wait()
    assert blocks_of(image, 30, 2) == pattern(1) + bytes(512)
    host.send(b"\x51\x00\x00")  # a part of a command
    reselect()
    assert host.command(17, 30) == OK
    reselect()
    host.rest(0.01)
    assert host.send(b"\xff" * 600) == b"\xff" * 600  # the block does not come any more


def test_times_are_those_of_a_card(host: Host) -> None:
    busy, limits = [], CardTiming()
    host.command(25, 0)
    for number in range(200):
        host.put(0xFC, pattern(number % 4))
        busy.append(host.wait())
    usual = [took for took in busy if took <= 2.1e-3]
    assert len(usual) > 195
    assert min(usual) > 0.45e-3
    assert max(busy) < limits.wake[1] + limits.write[1] + limits.pause[1]
    assert len(set(busy)) > 100


def test_pauses_come_now_and_then(make: Make) -> None:
    host = make(timing=CardTiming(pause_share=0.05))
    host.start()
    host.command(25, 0)
    busy = []
    for _ in range(100):
        host.put(0xFC, bytes(512))
        busy.append(host.wait())
    long = [took for took in busy if took > 15e-3]
    assert 2 <= len(long) <= 12
    assert all(20e-3 < took < 123e-3 for took in long)


def test_the_first_access_takes_longer_after_a_rest(make: Make) -> None:
    host = make(timing=CardTiming(write=(1e-3, 1e-3), pause_share=0.0, wake=(0.05, 0.05)))
    host.start()
    took = []
    for rest in (0.0, 0.4, 0.6):
        host.rest(rest)
        host.command(24, 0)
        host.put(0xFE, bytes(512))
        took.append(round(host.wait(), 2))
    assert took == [0.0, 0.0, 0.05]


def test_erasing_takes_longer_when_it_is_more(tmp_path: Path) -> None:
    path = tmp_path / "large.img"
    with path.open("wb") as file:
        file.truncate(256 << 20)
    host = Host(SdCard(path))
    host.start()
    assert 2e-3 < host.erase(0, 0) < 15e-3
    assert 14e-3 < host.erase(0, (256 << 11) - 1) < 40e-3


def test_the_same_seed_takes_the_same_times(image: Path) -> None:
    def run(seed: int) -> int:
        host = Host(SdCard(image, seed=seed))
        host.start()
        host.write(0, *[bytes(512)] * 10)
        host.card.close()
        return host.cycle

    assert run(1) == run(1) != run(2)


# ---- wrong use ----


@pytest.mark.parametrize("index", [1, 2, 3, 6, 7, 11, 20, 23, 27, 40, 42, 56, 63])
def test_an_unknown_command_is_illegal(host: Host, index: int) -> None:
    assert host.command(index) == b"\x04"


@pytest.mark.parametrize("index", [17, 18, 24, 25, 32, 33])
def test_an_address_behind_the_end_is_refused(host: Host, index: int) -> None:
    assert host.command(index, BLOCKS) == b"\x40"
    assert host.command(index, 0xFFFFFFFF) == b"\x40"
    assert host.command(index, BLOCKS - 1) == OK


def test_reading_on_behind_the_end_is_told(host: Host) -> None:
    host.command(18, BLOCKS - 1)
    assert len(host.data()) == 512
    assert host.data() == b"\x08"
    host.select(False)
    assert host.command(13, 0, 1) == OK + b"\x80"
    assert host.command(13, 0, 1) == OK + OK  # told once


def test_writing_on_behind_the_end_is_refused(host: Host) -> None:
    host.command(25, BLOCKS - 1)
    assert host.put(0xFC, pattern(1)) == ACCEPTED
    host.wait()
    assert host.put(0xFC, pattern(2)) == 13
    host.send(b"\xfd\xff")
    host.wait()
    assert host.command(13, 0, 1) == OK + b"\x80"


def test_a_command_is_not_heard_while_the_card_is_busy(host: Host) -> None:
    host.command(24, 0)
    host.put(0xFE, pattern(0))
    frame = bytes((0x4D, 0, 0, 0, 0))
    assert host.send(frame + bytes([crc7(frame)]) + b"\xff" * 8) == bytes(14)
    host.wait()
    assert host.command(13, 0, 1) == OK + OK


def test_a_block_is_not_taken_when_its_token_is_that_of_the_other_command(host: Host, image: Path) -> None:
    host.command(24, 0)
    assert host.put(0xFC, bytes([0xFF]) * 512) == 0x1F
    assert blocks_of(image, 0) == bytes(512)


def test_a_broken_command_is_refused_when_checksums_are_on(host: Host) -> None:
    assert host.command(17, 0, crc=0x01) == b"\x08"
    host.command(59, 0)
    assert host.command(17, 0, crc=0x01) == OK


def test_a_broken_block_is_refused_when_checksums_are_on(host: Host, image: Path) -> None:
    host.command(24, 9)
    assert host.put(0xFE, pattern(1), crc=b"\x00\x00") == CRC_ERROR
    assert blocks_of(image, 9) == bytes(512)
    host.command(59, 0)
    host.command(24, 9)
    assert host.put(0xFE, pattern(1), crc=b"\x00\x00") == ACCEPTED
    assert blocks_of(image, 9) == pattern(1)


def test_only_the_stop_ends_a_read_of_several_blocks(host: Host) -> None:
    host.command(18, 0)
    host.data()
    assert host.command(17, 0) == b"\x04"
    assert host.command(12) == OK
    host.wait()
    assert host.command(12) == b"\x04"
    assert host.command(17, 0) == OK


def test_erase_commands_out_of_order_are_refused(host: Host, image: Path) -> None:
    host.write(5, pattern(5))
    assert host.command(38) == b"\x10"
    assert host.command(32, 9) == OK
    assert host.command(38) == b"\x10"
    assert host.command(32, 4) == OK
    assert host.command(17, 0) == b"\x02"  # the sequence is forgotten
    host.data()
    assert host.command(33, 6) == OK
    assert host.command(38) == b"\x10"
    assert [host.command(32, 6), host.command(33, 5), host.command(38)] == [OK, OK, b"\x40"]
    assert host.command(13, 0, 1) == OK + b"\x40"
    assert blocks_of(image, 5) == pattern(5)


# ---- image files ----


@pytest.mark.parametrize(
    ("size", "message"),
    [
        (512 * 2048 + 1, r"1048577 bytes, expected a multiple of 512"),
        (512, r"512 bytes, expected 524288 or more"),
        (0, r"0 bytes, expected 524288 or more"),
        ((2 << 40) + 512, r"expected 2199023255552 at most"),
    ],
)
def test_an_image_of_a_size_that_no_card_has_is_refused(tmp_path: Path, size: int, message: str) -> None:
    path = tmp_path / "card.img"
    with path.open("wb") as file:
        file.truncate(size)
    with pytest.raises(LinkError, match=message):
        SdCard(path)


def test_a_file_that_is_none_is_refused(tmp_path: Path, image: Path) -> None:
    with pytest.raises(LinkError, match=r"there is no such file; make one with `truncate"):
        SdCard(tmp_path / "none.img")
    with pytest.raises(LinkError, match=r"Is a directory; name an image"):
        SdCard(tmp_path)
    card = SdCard(image)
    with pytest.raises(LinkError, match=r"another board has this card"):
        SdCard(image)
    card.close()
    SdCard(image).close()


def test_a_file_that_cannot_be_written_is_refused(image: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise PermissionError(13, "Permission denied", str(image))

    monkeypatch.setattr("neuroflight.sim.board.devices.sd_card.image.os.open", refuse)
    with pytest.raises(LinkError, match=r"Permission denied; name an image that can be written"):
        SdCard(image)
