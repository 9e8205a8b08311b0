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
def log(chip: MakeChip) -> Log:
    return Log(chip())


def test_the_record_is_as_python_reads_it_when_laid_out(scripted: Any) -> None:
    ffi, lib = scripted.ffi, scripted.lib
    assert {name: getattr(lib, f"FAULT_{name}") for name in FaultKind.__members__} == FaultKind.__members__
    offsets = {name: ffi.offsetof("struct fault_record", name) for name in ("r", "r12", "sp", "line", "file")}
    assert offsets == {"r": 4, "r12": 20, "sp": 52, "line": 56, "file": 60}
    assert ffi.offsetof("struct fault_record", "sp") == 4 * len(FAULT_REGISTERS)
    assert ffi.offsetof("struct fault_record", "uptime_steps") == 60 + FAULT_FILE_BYTES
    assert ffi.sizeof("struct fault_record") == ENTRY_BYTES - 16


def test_boots_are_counted_when_nothing_happens(log: Log) -> None:
    renewed = []
    for boot in range(1, 3 * ENTRIES):
        assert log.boot().boots == boot
        assert log.pending is None
        if log.log.crowded:
            log.renew()
            renewed.append(boot)
        log.chip.power_on()
    assert renewed[0] == ENTRIES - ROOM + 1
    assert len(renewed) == 3


def test_a_fault_is_pending_over_boots_when_nobody_has_read_it(log: Log) -> None:
    log.boot()
    log.boot(line=77)
    assert log.pending == (2, 77)
    assert log.core.ffi.string(log.log.record.file) == b"src/x.c"
    for _ in range(5):
        log.boot()
        assert log.pending == (2, 77)


def test_it_is_pending_no_more_when_it_was_acknowledged(log: Log) -> None:
    log.boot(line=77)
    assert log.acknowledge(1) == Refusal.NONE
    assert log.pending is None
    assert log.boot().boots == 2
    assert log.pending is None


@pytest.mark.parametrize("boot", [0, 1, 3, 2**32 - 1])
def test_another_is_not_acknowledged_when_the_number_is_not_that_of_the_pending_one(
    log: Log, boot: int
) -> None:
    assert log.boot() is not None
    assert log.acknowledge(1) == Refusal.INDEX, "nothing is pending"
    log.boot(line=77)
    assert log.acknowledge(boot) == Refusal.INDEX
    assert log.pending == (2, 77)


def test_faults_come_one_by_one_newest_first_when_there_are_several(log: Log) -> None:
    for line in (10, 20, 0, 30):
        log.boot(line)
    assert log.pending == (4, 30)
    for boot, following in ((4, (2, 20)), (2, (1, 10)), (1, None)):
        assert log.acknowledge(boot) == Refusal.NONE
        assert log.pending == following
    assert log.log.boots == 4


def test_all_are_acknowledged_at_once_when_asked(log: Log) -> None:
    for line in (10, 20, 0, 30):
        assert log.boot(line).logged
    assert log.core.lib.fault_log_acknowledge_all(log.log) == Refusal.NONE
    assert log.pending is None
    assert log.boot().boots == 5
    assert log.pending is None
    assert log.core.lib.fault_log_acknowledge_all(log.log) == Refusal.NONE, "nothing is pending"


def test_the_rest_stays_pending_when_flash_refuses_to_acknowledge_all(log: Log) -> None:
    for line in (10, 20):
        log.boot(line)
    log.chip.cut(1, 0, 1)
    assert log.core.lib.fault_log_acknowledge_all(log.log) == Refusal.FLASH
    assert log.pending == (1, 10)


def test_nothing_is_erased_at_boot_when_the_log_is_full(log: Log) -> None:
    log.fill(ENTRIES)
    for _ in range(3):
        operations = log.chip.operations
        assert log.boot().boots == ENTRIES + 1, "flash has no room for it"
        assert log.log.crowded
        assert log.chip.operations == operations
    log.renew()
    assert log.boot().boots == ENTRIES + 2


@pytest.mark.parametrize("boots", [ENTRIES - ROOM + 1, ENTRIES, ENTRIES + 1])
def test_a_pending_fault_is_carried_over_when_the_log_begins_anew(log: Log, boots: int) -> None:
    log.boot(line=5)
    log.fill(boots - 1)
    assert log.pending == (1, 5)
    operations = log.chip.operations
    log.renew()
    assert log.chip.operations == operations + 1 + 2 * WORDS, "erased, and two entries written"
    assert log.pending == (1, 5)
    assert log.boot().boots == boots + 1
    assert log.pending == (1, 5)
    assert log.acknowledge(1) == Refusal.NONE
    assert log.boot().boots == boots + 2
    assert log.pending is None


def test_the_new_fault_is_kept_when_the_full_log_holds_another(log: Log) -> None:
    log.boot(line=5)
    log.fill(ENTRIES - 1)
    log.boot(line=6)
    assert log.pending == (ENTRIES + 1, 6)
    log.renew()
    assert log.pending == (ENTRIES + 1, 6)
    assert log.boot().boots == ENTRIES + 2
    assert log.pending == (ENTRIES + 1, 6)
    assert log.acknowledge(ENTRIES + 1) == Refusal.NONE


def test_a_fault_is_pending_when_flash_does_not_take_it(log: Log) -> None:
    log.boot(line=5)
    log.chip.cut(3, 0, 1)
    log.boot(line=6)
    assert log.pending == (2, 6)
    assert (log.log.address, log.log.logged) == (0, False)
    assert log.acknowledge(2) == Refusal.NONE, "there is nothing to write"
    assert log.pending == (1, 5), "the one before it comes up again"
    assert log.acknowledge(1) == Refusal.FLASH
    assert log.pending == (1, 5)
    assert log.log.boots == 2


def test_a_fault_is_pending_when_a_full_flash_cannot_be_erased(log: Log) -> None:
    log.fill(ENTRIES)
    log.boot(line=6)
    log.chip.cut(0, 0, 1)
    log.renew()
    assert log.pending == (ENTRIES + 1, 6)
    assert log.log.address == 0


def test_nothing_is_believed_when_flash_holds_noise(log: Log) -> None:
    rng = np.random.default_rng(1)
    for fill in (rng.bytes(FLASH_FAULT_RECORD.size), bytes(FLASH_FAULT_RECORD.size)):
        log.chip.fill(FLASH_FAULT_RECORD.address, fill)
        assert log.boot().boots == 1
        assert log.pending is None
        log.renew()
        assert log.boot(line=9).boots == 2
        assert log.pending == (2, 9)


def test_an_entry_with_another_magic_is_none_when_read(log: Log) -> None:
    log.boot(line=5)
    log.chip.fill(FLASH_FAULT_RECORD.address, b"NFFX")
    assert log.boot().boots == 1
    assert log.pending is None


# --- Power goes ---------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("line", [0, 6])
def test_each_entry_is_whole_or_none_when_power_goes_while_it_is_written(
    log: Log, line: int, kind: int
) -> None:
    log.boot(line=5)
    log.boot()
    before = log.chip.content
    for at in range(WORDS):
        for seed in range(3):
            log.chip.content = before
            log.chip.cut(at, kind, 7 * at + seed)
            log.boot(line)
            log.chip.power_on()
            boots = log.boot().boots
            assert boots in (3, 4), (at, seed)
            assert log.pending == ((3, 6) if line and boots == 4 else (1, 5))
            assert log.boot().boots == boots + 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_read_or_not_when_power_goes_while_it_is_acknowledged(log: Log, kind: int) -> None:
    log.boot(line=5)
    before = log.chip.content
    for seed in range(40):
        log.chip.content = before
        log.boot()
        log.chip.cut(0, kind, seed)
        assert log.acknowledge(1) == Refusal.FLASH
        log.chip.power_on()
        assert log.boot().boots == 3
        if log.pending:
            assert log.pending == (1, 5)
            assert log.acknowledge(1) == Refusal.NONE, "a second try"
            assert log.pending is None


@pytest.mark.parametrize(("word", "pending"), [(0xFFFFFFFF, True), (0x0000FF00, True), (1, True), (0, False)])
def test_a_fault_stays_pending_when_its_acknowledgement_is_not_whole(
    log: Log, word: int, pending: bool
) -> None:
    log.boot(line=5)
    log.chip.fill(FLASH_FAULT_RECORD.address + 4 * WORDS, word.to_bytes(4, "little"))
    log.boot()
    assert log.pending == ((1, 5) if pending else None)


@pytest.mark.parametrize("kind", KINDS)
def test_the_log_goes_on_when_power_goes_while_it_is_begun_anew(log: Log, kind: int) -> None:
    """Then, and only then, it may be lost; what it says is never false."""
    log.fill(ENTRIES, line=5)
    before = log.chip.content
    for at in range(1 + 2 * WORDS):
        for seed in range(4):
            log.chip.content = before
            log.boot()
            log.chip.cut(at, kind, 31 * at + seed)
            log.renew()
            log.chip.power_on()
            boots = log.boot().boots
            assert boots in (1, *range(2, ENTRIES + 3))
            assert log.pending in (None, (ENTRIES, 5))
            if log.log.crowded:
                log.renew()
            assert log.boot(line=8).boots == boots + 1
            assert log.pending == (boots + 1, 8)
