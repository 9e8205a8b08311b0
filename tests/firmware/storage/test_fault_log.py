"""fault_log.c: boots counted and faults kept until acknowledged, whenever power is cut."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    FAULT_FILE_BYTES,
    FAULT_REGISTERS,
    FLASH_FAULT_RECORD,
    FaultKind,
    Refusal,
)

MakeChip = Callable[..., Any]
ENTRY_BYTES = 104
ENTRIES = FLASH_FAULT_RECORD.size // ENTRY_BYTES
ROOM = 8  # entries left, when it is to be begun anew
WORDS = ENTRY_BYTES // 4 - 1  # of an entry; one more acknowledges it
KINDS = range(5)  # of cuts: enum flash_cut


class Log:
    """Boots of a firmware over a chip."""

    def __init__(self, chip: Any) -> None:
        self.chip, self.core = chip, chip.core
        self.log = self.core.new("struct fault_log *")

    def boot(self, line: int = 0) -> Any:
        """A boot after an assertion at that line; 0: after no fault."""
        record = self.core.ffi.NULL
        if line:
            record = self.core.new(
                "struct fault_record *", {"kind": FaultKind.ASSERT, "line": line, "file": b"src/x.c"}
            )
        self.core.lib.fault_log_boot(self.log, self.chip.flash, record)
        return self.log

    def renew(self) -> None:
        """Begins anew, as the background does where little room is left."""
        assert self.log.crowded
        self.core.lib.fault_log_renew(self.log)
        assert not self.log.crowded

    def fill(self, boots: int, line: int = 0) -> None:
        """So many boots, the last after an assertion at that line; nobody renews the log."""
        for boot in range(boots):
            self.boot(line if boot == boots - 1 else 0)

    def acknowledge(self, boot: int) -> int:
        return int(self.core.lib.fault_log_acknowledge(self.log, boot))

    @property
    def pending(self) -> tuple[int, int] | None:
        """Boot that found the pending fault, and its line."""
        return (self.log.boot, self.log.record.line) if self.log.pending else None


@pytest.fixture
def log(chip: MakeChip) -> Callable[[], Log]:
    return lambda: Log(chip())


def test_the_record_is_as_python_reads_it_when_laid_out(scripted: Any) -> None:
    ffi, lib = scripted.ffi, scripted.lib
    assert {name: getattr(lib, f"FAULT_{name}") for name in FaultKind.__members__} == FaultKind.__members__
    offsets = {name: ffi.offsetof("struct fault_record", name) for name in ("r", "r12", "sp", "line", "file")}
    assert offsets == {"r": 4, "r12": 20, "sp": 52, "line": 56, "file": 60}
    assert ffi.offsetof("struct fault_record", "sp") == 4 * len(FAULT_REGISTERS)
    assert ffi.offsetof("struct fault_record", "uptime_steps") == 60 + FAULT_FILE_BYTES
    assert ffi.sizeof("struct fault_record") == ENTRY_BYTES - 16


def test_boots_are_counted_when_nothing_happens(log: Callable[[], Log]) -> None:
    x = log()
    renewed = []
    for boot in range(1, 3 * ENTRIES):
        assert x.boot().boots == boot
        assert x.pending is None
        if x.log.crowded:
            x.renew()
            renewed.append(boot)
        x.chip.power_on()
    assert renewed[0] == ENTRIES - ROOM + 1
    assert len(renewed) == 3


def test_a_fault_is_pending_over_boots_when_nobody_has_read_it(log: Callable[[], Log]) -> None:
    x = log()
    x.boot()
    x.boot(line=77)
    assert x.pending == (2, 77)
    assert x.core.ffi.string(x.log.record.file) == b"src/x.c"
    for _ in range(5):
        x.boot()
        assert x.pending == (2, 77)


def test_it_is_pending_no_more_when_it_was_acknowledged(log: Callable[[], Log]) -> None:
    x = log()
    x.boot(line=77)
    assert x.acknowledge(1) == Refusal.NONE
    assert x.pending is None
    assert x.boot().boots == 2
    assert x.pending is None


@pytest.mark.parametrize("boot", [0, 1, 3, 2**32 - 1])
def test_another_is_not_acknowledged_when_the_number_is_not_that_of_the_pending_one(
    log: Callable[[], Log], boot: int
) -> None:
    x = log()
    assert x.boot() is not None
    assert x.acknowledge(1) == Refusal.INDEX, "nothing is pending"
    x.boot(line=77)
    assert x.acknowledge(boot) == Refusal.INDEX
    assert x.pending == (2, 77)


def test_faults_come_one_by_one_newest_first_when_there_are_several(log: Callable[[], Log]) -> None:
    x = log()
    for line in (10, 20, 0, 30):
        x.boot(line)
    assert x.pending == (4, 30)
    for boot, following in ((4, (2, 20)), (2, (1, 10)), (1, None)):
        assert x.acknowledge(boot) == Refusal.NONE
        assert x.pending == following
    assert x.log.boots == 4


def test_all_are_acknowledged_at_once_when_asked(log: Callable[[], Log]) -> None:
    x = log()
    for line in (10, 20, 0, 30):
        assert x.boot(line).logged
    assert x.core.lib.fault_log_acknowledge_all(x.log) == Refusal.NONE
    assert x.pending is None
    assert x.boot().boots == 5
    assert x.pending is None
    assert x.core.lib.fault_log_acknowledge_all(x.log) == Refusal.NONE, "nothing is pending"


def test_the_rest_stays_pending_when_flash_refuses_to_acknowledge_all(log: Callable[[], Log]) -> None:
    x = log()
    for line in (10, 20):
        x.boot(line)
    x.chip.cut(1, 0, 1)
    assert x.core.lib.fault_log_acknowledge_all(x.log) == Refusal.FLASH
    assert x.pending == (1, 10)


def test_nothing_is_erased_at_boot_when_the_log_is_full(log: Callable[[], Log]) -> None:
    x = log()
    x.fill(ENTRIES)
    for _ in range(3):
        operations = x.chip.operations
        assert x.boot().boots == ENTRIES + 1, "flash has no room for it"
        assert x.log.crowded
        assert x.chip.operations == operations
    x.renew()
    assert x.boot().boots == ENTRIES + 2


@pytest.mark.parametrize("boots", [ENTRIES - ROOM + 1, ENTRIES, ENTRIES + 1])
def test_a_pending_fault_is_carried_over_when_the_log_begins_anew(log: Callable[[], Log], boots: int) -> None:
    x = log()
    x.boot(line=5)
    x.fill(boots - 1)
    assert x.pending == (1, 5)
    operations = x.chip.operations
    x.renew()
    assert x.chip.operations == operations + 1 + 2 * WORDS, "erased, and two entries written"
    assert x.pending == (1, 5)
    assert x.boot().boots == boots + 1
    assert x.pending == (1, 5)
    assert x.acknowledge(1) == Refusal.NONE
    assert x.boot().boots == boots + 2
    assert x.pending is None


def test_the_new_fault_is_kept_when_the_full_log_holds_another(log: Callable[[], Log]) -> None:
    x = log()
    x.boot(line=5)
    x.fill(ENTRIES - 1)
    x.boot(line=6)
    assert x.pending == (ENTRIES + 1, 6)
    x.renew()
    assert x.pending == (ENTRIES + 1, 6)
    assert x.boot().boots == ENTRIES + 2
    assert x.pending == (ENTRIES + 1, 6)
    assert x.acknowledge(ENTRIES + 1) == Refusal.NONE


def test_a_fault_is_pending_when_flash_does_not_take_it(log: Callable[[], Log]) -> None:
    x = log()
    x.boot(line=5)
    x.chip.cut(3, 0, 1)
    x.boot(line=6)
    assert x.pending == (2, 6)
    assert (x.log.address, x.log.logged) == (0, False)
    assert x.acknowledge(2) == Refusal.NONE, "there is nothing to write"
    assert x.pending == (1, 5), "the one before it comes up again"
    assert x.acknowledge(1) == Refusal.FLASH
    assert x.pending == (1, 5)
    assert x.log.boots == 2


def test_a_fault_is_pending_when_a_full_flash_cannot_be_erased(log: Callable[[], Log]) -> None:
    x = log()
    x.fill(ENTRIES)
    x.boot(line=6)
    x.chip.cut(0, 0, 1)
    x.renew()
    assert x.pending == (ENTRIES + 1, 6)
    assert x.log.address == 0


def test_nothing_is_believed_when_flash_holds_noise(log: Callable[[], Log]) -> None:
    x = log()
    rng = np.random.default_rng(1)
    for fill in (rng.bytes(FLASH_FAULT_RECORD.size), bytes(FLASH_FAULT_RECORD.size)):
        x.chip.fill(FLASH_FAULT_RECORD.address, fill)
        assert x.boot().boots == 1
        assert x.pending is None
        x.renew()
        assert x.boot(line=9).boots == 2
        assert x.pending == (2, 9)


def test_an_entry_with_another_magic_is_none_when_read(log: Callable[[], Log]) -> None:
    x = log()
    x.boot(line=5)
    x.chip.fill(FLASH_FAULT_RECORD.address, b"NFFX")
    assert x.boot().boots == 1
    assert x.pending is None


# --- Power goes ---------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("line", [0, 6])
def test_each_entry_is_whole_or_none_when_power_goes_while_it_is_written(
    log: Callable[[], Log], line: int, kind: int
) -> None:
    x = log()
    x.boot(line=5)
    x.boot()
    before = x.chip.content
    for at in range(WORDS):
        for seed in range(3):
            x.chip.content = before
            x.chip.cut(at, kind, 7 * at + seed)
            x.boot(line)
            x.chip.power_on()
            boots = x.boot().boots
            assert boots in (3, 4), (at, seed)
            assert x.pending == ((3, 6) if line and boots == 4 else (1, 5))
            assert x.boot().boots == boots + 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_read_or_not_when_power_goes_while_it_is_acknowledged(
    log: Callable[[], Log], kind: int
) -> None:
    x = log()
    x.boot(line=5)
    before = x.chip.content
    for seed in range(40):
        x.chip.content = before
        x.boot()
        x.chip.cut(0, kind, seed)
        assert x.acknowledge(1) == Refusal.FLASH
        x.chip.power_on()
        assert x.boot().boots == 3
        if x.pending:
            assert x.pending == (1, 5)
            assert x.acknowledge(1) == Refusal.NONE, "a second try"
            assert x.pending is None


@pytest.mark.parametrize(("word", "pending"), [(0xFFFFFFFF, True), (0x0000FF00, True), (1, True), (0, False)])
def test_a_fault_stays_pending_when_its_acknowledgement_is_not_whole(
    log: Callable[[], Log], word: int, pending: bool
) -> None:
    x = log()
    x.boot(line=5)
    x.chip.fill(FLASH_FAULT_RECORD.address + 4 * WORDS, word.to_bytes(4, "little"))
    x.boot()
    assert x.pending == ((1, 5) if pending else None)


@pytest.mark.parametrize("kind", KINDS)
def test_the_log_goes_on_when_power_goes_while_it_is_begun_anew(log: Callable[[], Log], kind: int) -> None:
    """Then, and only then, it may be lost; what it says is never false."""
    x = log()
    x.fill(ENTRIES, line=5)
    before = x.chip.content
    for at in range(1 + 2 * WORDS):
        for seed in range(4):
            x.chip.content = before
            x.boot()
            x.chip.cut(at, kind, 31 * at + seed)
            x.renew()
            x.chip.power_on()
            boots = x.boot().boots
            assert boots in (1, *range(2, ENTRIES + 3))
            assert x.pending in (None, (ENTRIES, 5))
            if x.log.crowded:
                x.renew()
            assert x.boot(line=8).boots == boots + 1
            assert x.pending == (boots + 1, 8)
