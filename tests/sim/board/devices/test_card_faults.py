"""What goes wrong with an emulated SD card, as an independent host finds it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.devices.sd_card import CardFault, CardTiming, Cut, SdCard
from tests.sim.board.devices.host import FAST_HZ, SLOW_HZ, Host, blank, blocks_of, crc16, pattern

OK, ACCEPTED, CRC_ERROR, WRITE_ERROR = b"\x00", 5, 11, 13
EVEN = CardTiming(write=(1e-3, 1e-3), pause_share=0.0, wake=(0.0, 0.0), read=(1e-4, 1e-4))
Make = Callable[..., Host]


@pytest.fixture
def image(tmp_path: Path) -> Path:
    return blank(tmp_path / "card.img")


@pytest.fixture
def host(image: Path) -> Host:
    """Of a card that is initialised and always takes equally long."""
    host = Host(SdCard(image, timing=EVEN))
    host.start()
    return host


def at(host: Host, seconds: float) -> int:
    """The cycle so many seconds from now."""
    return host.cycle + round(seconds * 216_000_000)


def stream(host: Host, first: int, count: int) -> list[float]:
    """How long the card was busy after each of several blocks [s]."""
    assert host.command(25, first) == OK
    busy = []
    for number in range(count):
        assert host.put(0xFC, pattern(number)) == ACCEPTED
        busy.append(host.wait())
    host.send(b"\xfd\xff")
    host.wait()
    host.select(False)
    return busy


def test_a_stall_holds_what_is_under_way(host: Host) -> None:
    host.command(24, 0)
    host.put(0xFE, pattern(0))
    host.card.schedule(CardFault.STALL, 0.5, cycle=at(host, 0.0003))
    assert host.wait() == pytest.approx(0.501, abs=1e-4)


def test_a_stall_holds_the_next_block_when_nothing_is_under_way(host: Host) -> None:
    host.card.schedule(CardFault.STALL, 0.2, cycle=at(host, 0.0))
    host.rest(0.05)
    busy = stream(host, 0, 3)
    assert busy == pytest.approx([0.201, 0.001, 0.001], abs=1e-4)


def test_a_stall_comes_with_its_block(host: Host) -> None:
    host.card.schedule(CardFault.STALL, 0.1, write=host.card.writes + 3)
    assert stream(host, 0, 4) == pytest.approx([0.001, 0.001, 0.101, 0.001], abs=1e-4)


def test_a_stall_holds_data_that_are_read(host: Host) -> None:
    host.card.schedule(CardFault.STALL, 0.2, cycle=at(host, 0.0))
    begun = host.seconds
    assert host.read(0) == bytes(512)
    assert host.seconds - begun > 0.2


def test_all_takes_longer_when_a_card_is_slow(host: Host) -> None:
    host.card.schedule(CardFault.SLOW, 20.0, cycle=at(host, 0.0))
    assert stream(host, 0, 2) == pytest.approx([0.02, 0.02], abs=1e-4)


def test_a_worn_card_refuses_blocks_and_still_reads(host: Host, image: Path) -> None:
    host.card.schedule(CardFault.WORN, 2, cycle=at(host, 0.0))
    assert host.write(10, *[pattern(i) for i in range(4)]) == [ACCEPTED, ACCEPTED, WRITE_ERROR, WRITE_ERROR]
    assert host.command(13, 0, 1) == OK + b"\x04"
    assert host.command(13, 0, 1) == OK + OK
    assert host.write(10, pattern(9)) == [WRITE_ERROR]
    assert host.read(10, 4) == pattern(0) + pattern(1) + bytes(1024) == blocks_of(image, 10, 4)


def test_a_card_may_be_worn_from_an_address_on(host: Host) -> None:
    host.card.schedule(CardFault.WORN_FROM, 100, cycle=at(host, 0.0))
    assert host.write(98, *[pattern(i) for i in range(4)]) == [ACCEPTED, ACCEPTED, WRITE_ERROR, WRITE_ERROR]
    assert host.write(5, pattern(5)) == [ACCEPTED]


def test_errors_on_the_line_are_found_by_checksums(host: Host, image: Path) -> None:
    host.card.schedule(CardFault.ERRORS, 0.2, cycle=at(host, 0.0))
    host.rest(0.001)
    told: Counter[str] = Counter()
    for number in range(200):
        first = host.command(24, number)
        told[f"command {first.hex()}"] += 1
        if first == OK:
            response = host.put(0xFE, pattern(number))
            told[f"block {response}"] += 1
            assert blocks_of(image, number) == (pattern(number) if response == ACCEPTED else bytes(512))
            host.wait()
        host.select(False)
    # A command is damaged in a fifth of the cases, and a block of those that are left.
    assert 20 < told["command 08"] < 60
    assert 15 < told[f"block {CRC_ERROR}"] < 55
    assert set(told) == {"command 00", "command 08", f"block {ACCEPTED}", f"block {CRC_ERROR}"}


def test_errors_on_the_line_damage_what_is_read(host: Host) -> None:
    host.write(1, pattern(1))
    host.card.schedule(CardFault.ERRORS, 1.0, cycle=at(host, 0.001))
    host.select(True)
    host.command(17, 1)
    host.rest(0.0012)
    while host.send(b"\xff") != b"\xfe":
        pass
    block = host.send(b"\xff" * 514)
    good = pattern(1) + crc16(pattern(1))
    assert sum((a ^ b).bit_count() for a, b in zip(block, good, strict=True)) == 1


def test_a_pulled_card_is_silent_and_comes_back_uninitialised(host: Host, image: Path) -> None:
    host.write(3, pattern(3))
    host.card.schedule(CardFault.REMOVED, cycle=at(host, 0.01))
    host.card.schedule(CardFault.INSERTED, cycle=at(host, 0.5))
    host.rest(0.02)
    assert host.card.fitted
    assert host.command(13, 0, 1) == b""
    assert not host.card.fitted
    host.rest(0.5)
    assert host.hz == FAST_HZ
    assert host.command(13, 0, 1) == b""  # the host cannot know yet: it is not heard
    assert host.card.fitted
    host.hz = SLOW_HZ
    assert host.command(17, 3) == b""  # it waits for its first command
    host.start()
    assert host.read(3) == pattern(3)
    with pytest.raises(BoardError, match="25 MHz at most"):
        host.hz = 27e6
        host.command(13)


def test_a_card_goes_silent_in_the_middle_of_a_block_when_it_is_pulled(host: Host, image: Path) -> None:
    host.command(24, 0)
    host.card.schedule(CardFault.REMOVED, cycle=host.cycle + 300 * host.length)
    assert host.put(0xFE, pattern(1)) == 0x1F
    assert blocks_of(image, 0) == bytes(512)


@pytest.mark.parametrize("seed", range(12))
def test_a_card_that_is_pulled_while_it_writes_keeps_all_other_blocks(image: Path, seed: int) -> None:
    host = Host(SdCard(image, timing=EVEN, seed=seed))
    host.start()
    host.command(25, 0)
    for number in range(3):
        host.put(0xFC, pattern(number))
        if number < 2:
            host.wait()
    host.card.schedule(CardFault.REMOVED, cycle=at(host, 0.0005))
    host.rest(0.01)
    host.send(b"\xff")
    assert blocks_of(image, 0, 2) == pattern(0) + pattern(1)
    left = blocks_of(image, 2)
    new = next((i for i in range(512) if left[i] != pattern(2)[i]), 512)
    assert left == pattern(2)[:new] + bytes(512 - new)


def test_every_kind_of_cut_happens_by_chance(image: Path) -> None:
    kinds = set()
    for seed in range(24):
        blank(image)
        host = Host(SdCard(image, timing=EVEN, seed=seed))
        host.start()
        host.card.schedule(CardFault.POWER_CUT, write=1)
        host.command(24, 0)
        host.put(0xFE, b"\x55" * 512)
        kept = blocks_of(image, 0).count(0x55)
        kinds.add("old" if kept == 0 else "new" if kept == 512 else "torn")
        host.card.close()
    assert kinds == {"old", "new", "torn"}


@pytest.mark.parametrize(
    ("cut", "kept", "left"),
    [(Cut.OLD, None, 0), (Cut.NEW, None, 512), (Cut.TORN, 100, 100), (Cut.TORN, 0, 0)],
)
def test_the_power_goes_with_the_block_that_was_asked_for(
    host: Host, image: Path, cut: Cut, kept: int | None, left: int
) -> None:
    host.write(50, *[b"\xaa" * 512] * 4)
    went: list[int] = []
    host.card.on_power_cut = lambda: went.append(host.cycle)
    host.card.schedule(CardFault.POWER_CUT, write=host.card.writes + 3, cut=cut, kept_bytes=kept)
    host.command(25, 50)
    assert [host.put(0xFC, pattern(i)) for i in (0,)] == [ACCEPTED]
    host.wait()
    assert host.put(0xFC, pattern(1)) == ACCEPTED
    host.wait()
    assert host.put(0xFC, pattern(2)) == 0x1F  # without power
    assert len(went) == 1
    assert blocks_of(image, 50, 2) == pattern(0) + pattern(1)
    assert blocks_of(image, 52) == pattern(2)[:left] + b"\xaa" * (512 - left)
    assert blocks_of(image, 53) == b"\xaa" * 512
    assert host.send(b"\xff" * 8) == b"\xff" * 8
    host.card.power_on(host.cycle)
    host.rest(0.01)
    host.start()
    assert host.read(50) == pattern(0)


def test_a_block_is_safe_once_the_card_is_not_busy(host: Host, image: Path) -> None:
    host.write(0, pattern(1))
    host.card.power_off(host.cycle)
    assert blocks_of(image, 0) == pattern(1)


def test_a_card_put_back_goes_on_alike(host: Host, image: Path) -> None:
    host.write(1, pattern(1))
    host.card.schedule(CardFault.ERRORS, 0.3, cycle=at(host, 0.0))
    host.card.schedule(CardFault.STALL, 0.05, write=host.card.writes + 4)
    host.rest(0.01)
    state, cycle, transaction = host.card.state(), host.cycle, host.transaction
    runs = []
    for _ in range(2):
        host.cycle, host.transaction, host.selected = cycle, transaction, False
        told = []
        for number in range(20):
            first = host.command(24, number)
            told.append((first, host.put(0xFE, pattern(number)), host.wait()))
            host.select(False)
        runs.append((told, blocks_of(image, 0, 30)))
        host.card.restore(state)
        assert blocks_of(image, 0, 3) == bytes(512) + pattern(1) + bytes(512)
    assert runs[0] == runs[1]


def test_a_card_goes_back_to_any_of_several_states(host: Host, image: Path) -> None:
    states, contents = [], []
    for number in range(4):
        host.write(number, pattern(number), pattern(100 + number))
        states.append(host.card.state())
        contents.append(image.read_bytes())
    for which in (2, 0, 3, 1, 1):
        host.card.restore(states[which])
        assert image.read_bytes() == contents[which]
        host.select(False)
        host.write(50 + which, pattern(which))


def test_a_card_refuses_the_state_of_another_one(host: Host, tmp_path: Path) -> None:
    other = SdCard(blank(tmp_path / "other.img"))
    other.state()
    with pytest.raises(BoardError, match="a snapshot of a board with another card"):
        other.restore(host.card.state())
