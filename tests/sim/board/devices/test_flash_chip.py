"""The emulated flash chips as an independent host finds them, byte by byte, and what they call an error."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.sim.board.core.context import TIME_HZ, BoardError
from neuroflight.sim.board.devices.flash_chip import KINDS, FlashChip
from neuroflight.toolchain.errors import LinkError

HZ = 13.5e6
NOR, NAND = "W25Q16", "W25N01G"


class Host:
    """A host that speaks in whole transactions."""

    def __init__(self, chip: FlashChip) -> None:
        self.chip, self.cycle, self.transaction = chip, 1000, 0

    def send(self, *sent: int, hear: int = 0, hz: float = HZ, mode: int = 0) -> bytes:
        """Exchanges bytes; what came behind `sent`."""
        self.transaction += 1
        length = round(8 * TIME_HZ / hz)
        data = bytes(sent) + b"\xff" * hear
        got = self.chip.exchange(
            data, self.cycle, length, hz, mode, selected=True, transaction=self.transaction
        )
        self.cycle += len(data) * length
        return got[len(sent) :]

    def status(self) -> int:
        return self.send(0x05, *([0xC0] if self.chip.kind.nand else []), hear=1)[0]

    def wait(self, seconds: float = 3.0) -> float:
        """Until it is at rest; how long that took."""
        begun = self.cycle
        while self.status() & 1:
            self.cycle += TIME_HZ // 10_000
            assert self.cycle - begun < seconds * TIME_HZ
        return (self.cycle - begun) / TIME_HZ

    def program(self, page: int, data: bytes) -> None:
        self.send(0x06)
        if self.chip.kind.nand:
            self.send(0x02, 0, 0, *data)
            self.send(0x10, *page.to_bytes(3, "big"))
        else:
            self.send(0x02, *(page * 256).to_bytes(3, "big"), *data)
        self.wait()

    def read(self, page: int, count: int) -> bytes:
        if not self.chip.kind.nand:
            return self.send(0x03, *(page * 256).to_bytes(3, "big"), hear=count)
        self.send(0x13, *page.to_bytes(3, "big"))
        self.wait()
        return self.send(0x03, 0, 0, 0, hear=count)

    def erase(self, block: int) -> float:
        self.send(0x06)
        page = block * self.chip.kind.pages
        self.send(0xD8, *(page if self.chip.kind.nand else page * 256).to_bytes(3, "big"))
        return self.wait()


def host(kind: str = NOR, path: Path | None = None) -> Host:
    new = Host(FlashChip(kind, path, seed=1))
    if new.chip.kind.nand:
        new.send(0x01, 0xA0, 0)
    return new


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_tells_its_identity(kind: str) -> None:
    chip = KINDS[kind]
    assert host(kind).send(0x9F, hear=4)[chip.nand :][:3] == chip.identity


@pytest.mark.parametrize("kind", [NOR, NAND])
def test_pages_keep_what_was_programmed_until_their_block_is_erased(kind: str, tmp_path: Path) -> None:
    one = host(kind, tmp_path / "chip.bin")
    assert one.read(3, 8) == b"\xff" * 8
    one.program(3, b"abcd")
    assert one.read(3, 6) == b"abcd\xff\xff"
    one.chip.close()
    again = host(kind, tmp_path / "chip.bin")
    assert again.read(3, 6) == b"abcd\xff\xff"
    low, high = again.chip.kind.erase
    assert low <= again.erase(0) <= high
    assert again.read(3, 4) == b"\xff" * 4
    assert again.chip.memory.erases == {0: 1}
    again.chip.close()


def mistake(kind: str, *transactions: bytes, hz: float = HZ, mode: int = 0, protection: int = 0) -> str:
    """What the chip says against these transactions."""
    one = host(kind)
    for die in one.chip.dies:
        die.protection = protection
        if protection:
            die.power_on()
    with pytest.raises(BoardError) as error:
        for sent in (*transactions, b"\x05\xc0"):
            one.send(*sent, hz=hz, mode=mode)
    return str(error.value)


@pytest.mark.parametrize(
    ("kind", "transactions", "words"),
    [
        (NOR, [b"\x02\0\0\0a"], "without its write enable latch"),
        (NOR, [b"\xd8\0\0\0"], "without its write enable latch"),
        (NAND, [b"\x02\0\0a"], "without its write enable latch"),
        (NOR, [b"\x06", b"\x02\0\0\0a", b"\x03\0\0\0"], "while it is busy: programming page 0"),
        (NOR, [b"\x06", b"\xd8\0\0\0", b"\x06"], "while it is busy: erasing block 0"),
        (NOR, [b"\x06", b"\x02\0\0\x80" + bytes(129)], "what is over goes to the page's begin"),
        (NOR, [b"\x06", b"\xd8\x20\0\0"], "is asked for page 8192, expected one below 8192"),
        (NOR, [b"\xab"], "0xAB, a command that W25Q16 does not know"),
        (NAND, [b"\x06", b"\x02\x08\0" + bytes(65)], "too many"),
        (NAND, [b"\x01\xb0\x10", b"\x13\0\0\0"], "continuous mode; set BUF"),
    ],
)
def test_what_a_chip_would_ignore_or_do_elsewhere_is_an_error(
    kind: str, transactions: list[bytes], words: str
) -> None:
    assert words in mistake(kind, *transactions)


def test_clock_mode_and_protection_are_watched() -> None:
    assert "clocked at 54 MHz, expected 50 at most" in mistake(NOR, b"\x9f", hz=54e6)
    assert "SPI mode 1, expected 0 or 3" in mistake(NOR, b"\x9f", mode=1)
    assert "while its blocks are protected" in mistake(NOR, b"\x06", b"\x02\0\0\0a", protection=0x1C)
    assert "while its blocks are protected" in mistake(NAND, b"\x06", b"\xd8\0\0\0", protection=0x7C)


@pytest.mark.parametrize("kind", [NOR, NAND])
def test_programming_over_what_is_there_is_an_error(kind: str) -> None:
    one = host(kind)
    one.program(0, b"\x0f")
    with pytest.raises(BoardError, match="over what is there: only erasing sets bits"):
        one.program(0, b"\xf0")
        one.status()


def test_nand_pages_are_programmed_in_order_and_four_times_at_most() -> None:
    one = host(NAND)
    one.program(1, b"a")
    with pytest.raises(BoardError, match="program page 0 after page 1 of the same block"):
        one.program(0, b"a")
    one = host(NAND)
    for value in (0xFE, 0xFC, 0xF8, 0xF0):
        one.program(0, bytes([value]))
    with pytest.raises(BoardError, match="page 0 a 5th time since it was erased"):
        one.program(0, b"\x00")


def test_a_bad_block_is_told_kept_and_not_erased() -> None:
    one = host(NAND)
    one.chip.mark_bad(2)
    one.send(0x13, 0, 0, 128)
    one.wait()
    assert one.send(0x03, 8, 0, 0, hear=1) == b"\0"
    with pytest.raises(BoardError, match="to erase block 2, which its maker has marked as bad"):
        one.erase(2)
    one.chip.wear_out(3)
    one.erase(3)
    assert one.status() & 0x04
    one.program(192, b"a")
    assert one.status() & 0x08
    one.chip.decay(5)
    one.read(5, 1)
    assert one.status() & 0x30 == 0x20


@pytest.mark.parametrize("kind", [NOR, NAND])
def test_a_page_whose_programming_is_cut_short_has_some_of_its_bits(kind: str) -> None:
    found = set()
    for seed in range(20):
        one = Host(FlashChip(kind, seed=seed))
        if one.chip.kind.nand:
            one.send(0x01, 0xA0, 0)
        one.program(0, b"\xf0\xf0")
        one.chip.cut_at(2)
        cut: list[bool] = []
        one.chip.on_power_cut = lambda cut=cut: cut.append(True)  # type: ignore[misc]
        one.send(0x06)
        if kind == NAND:
            one.send(0x02, 0, 0, 0, 0)
        one.send(*([0x10, 0, 0, 0] if kind == NAND else [0x02, 0, 0, 0, 0, 0]))
        one.status()
        assert cut == [True]
        one.chip.power_on(one.cycle)
        (left,) = {one.chip.memory.read(0)[:2]}
        assert not (left[0] | left[1]) & 0x0F, "what was there stays"
        found.add(left)
    assert {b"\0\0", b"\xf0\xf0"} < found


def test_a_file_of_another_size_or_in_use_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "chip.bin"
    path.write_bytes(b"abc")
    with pytest.raises(LinkError, match=r"3 bytes, expected 2097152 of a W25Q16; name another file"):
        FlashChip(NOR, path)
    path.unlink()
    chip = FlashChip(NOR, path)
    with pytest.raises(LinkError, match="another board has this chip"):
        FlashChip(NOR, path)
    chip.close()


def test_a_snapshot_brings_content_and_work_back(tmp_path: Path) -> None:
    one = host(NOR, tmp_path / "chip.bin")
    one.program(0, b"first")
    kept = one.chip.state()
    one.program(1, b"second")
    one.erase(0)
    one.chip.restore(kept)
    assert one.chip.memory.read(0)[:5] == b"first"
    assert one.chip.memory.read(1) == one.chip.memory.blank
    assert (tmp_path / "chip.bin").read_bytes()[:5] == b"first"
    one.chip.close()
