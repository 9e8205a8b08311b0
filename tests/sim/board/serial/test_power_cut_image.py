"""The real image's settings through resets, and through power that goes at any moment of their save."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from flash.client import read_info
from flash.msp import encode, request
from flash.settings import Settings
from sim.board.core.context import TIME_HZ
from sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from sim.board.peripherals.flash import Cut
from sim.board.serial.bridge import UartLine
from sim.board.serial.idle_board import Desk
from toolchain.contract import MSP_BAUD_DEFAULT, MSP_BAUDS, MSP_PAYLOAD_MAX, SETTINGS, Msp
from toolchain.errors import LinkError

OLD = {"roll_expo": 0.25, "yaw_deadband_us": 7, "battery_low_v": 3.0}
NEW = {"roll_expo": 0.75, "yaw_deadband_us": 9, "battery_low_v": 3.25}
HEAD_WORDS, ENTRY_WORDS, CRC_WORDS = 4, 2, 1  # of a set in flash: settings_store.c
OPERATIONS = 1 + HEAD_WORDS + ENTRY_WORDS * len(SETTINGS) + CRC_WORDS  # of a save: erase, then words
ERASE, LAST = 0, OPERATIONS - 1
MICROSECOND = TIME_HZ // 1_000_000
SAVE_S = 2.0  # what it may take, with the restart behind it


def until(desk: Desk, happened: Callable[[], bool], step: int) -> None:
    """Run in steps of so many cycles until it has."""
    end = desk.board.cycle + round(SAVE_S * TIME_HZ)
    while not happened():
        assert desk.board.cycle < end
        desk.run_to(desk.board.cycle + step)


def store(desk: Desk, values: dict[str, float]) -> None:
    settings = Settings(desk.client())
    for name, value in values.items():
        settings.set(name, value)
    settings.save()


def held(desk: Desk) -> dict[str, float]:
    settings = Settings(desk.client())
    return {name: settings.get(name) for name in NEW}


@pytest.fixture(scope="module")
def booted(board_image: Path) -> Iterator[tuple[Desk, Snapshot]]:
    """A board that has stored OLD."""
    desk = Desk(board_image.with_suffix(".bin").read_bytes(), elf=board_image)
    desk.boot()
    store(desk, OLD)
    yield desk, take_snapshot(desk.board.engine)
    desk.close()


@pytest.fixture
def desk(booted: tuple[Desk, Snapshot]) -> Desk:
    restore_snapshot(booted[0].board.engine, booted[1])
    return booted[0]


# --- Resets -------------------------------------------------------------------------------------
def test_stored_settings_are_there_when_power_was_gone(desk: Desk) -> None:
    Settings(desk.client()).set("roll_expo", 0.5)  # and not stored
    desk.board.reset()
    desk.boot()
    assert held(desk) == OLD
    assert desk.board.engine.resets[-1] == "power"


def test_stored_settings_are_there_when_the_board_was_told_to_start_anew(desk: Desk) -> None:
    with desk.client() as client:
        Settings(client).set("roll_expo", 0.5)  # and not stored
        assert client.request(Msp.REBOOT, retries=0) == b"", "the reply comes before the reset"
        resets = desk.board.engine.resets
        until(desk, lambda: resets[-1] == "software", MICROSECOND)
    desk.boot()
    assert held(desk) == OLD


@pytest.mark.parametrize(
    "baud",
    [
        pytest.param(baud, marks=[] if baud in (MSP_BAUDS[0], MSP_BAUDS[-1]) else pytest.mark.prove)
        for baud in MSP_BAUDS
    ],
)
def test_it_talks_at_the_speed_that_is_stored_when_it_has_started_anew(desk: Desk, baud: int) -> None:
    store(desk, {"msp_baud": baud, "gyro_rate_hz": 8000})
    with desk.client() as client:
        read_info(client)  # at the old one, until then
        client.request(Msp.REBOOT)
    until(desk, lambda: desk.board.engine.resets[-1] == "software", 100 * MICROSECOND)
    desk.boot()
    other = 57_600 if baud != 57_600 else MSP_BAUD_DEFAULT
    with desk.client(other) as client, pytest.raises(LinkError, match="silence"):
        client.request(Msp.API_VERSION, timeout=0.1, retries=0)
    with desk.client(baud) as client:
        assert read_info(client).variant == "NRFL"
        assert Settings(client).get("msp_baud") == baud
        with pytest.raises(LinkError, match="a length or a value that the command does not take"):
            client.request(Msp.SETTING_GET, bytes(MSP_PAYLOAD_MAX), retries=0)  # came whole
        assert client.request(Msp.REBOOT, retries=0) == b""


# --- Power cuts ---------------------------------------------------------------------------------
@dataclass(frozen=True)
class Save:
    """A board that has stored OLD and is about to store NEW."""

    desk: Desk
    before: Snapshot
    erased: Snapshot  # of the same save: its first word is about to be programmed
    begun: int  # flash operations before it

    def cut(self, operation: int, cut: Cut) -> None:
        """Power goes in the middle of that operation of the save, and comes back."""
        board = self.desk.board
        restore_snapshot(board.engine, self.before if operation == ERASE else self.erased)
        resets = len(board.engine.resets)
        board.hardware.flash.cut_at, board.hardware.flash.cut = self.begun + operation, cut
        if operation == ERASE:
            UartLine(board).send(encode(request(Msp.EEPROM_WRITE)))
        until(self.desk, lambda: len(board.engine.resets) > resets, 100 * MICROSECOND)
        assert board.engine.resets[resets:] == ["power"]
        self.desk.boot()


@pytest.fixture(scope="module")
def save(booted: tuple[Desk, Snapshot]) -> Save:
    desk, snapshot = booted
    restore_snapshot(desk.board.engine, snapshot)
    settings = Settings(desk.client())
    for name, value in NEW.items():
        settings.set(name, value)
    before, flash = take_snapshot(desk.board.engine), desk.board.hardware.flash
    begun = flash.operations
    UartLine(desk.board).send(encode(request(Msp.EEPROM_WRITE)))
    until(desk, lambda: flash.operations == begun + 1, 100 * MICROSECOND)
    erased = desk.board.engine.alarms["flash.done"].due
    assert erased is not None
    desk.run_to(erased)
    assert flash.operations == begun + 1
    return Save(desk, before, take_snapshot(desk.board.engine), begun)


def test_a_save_takes_as_many_operations_as_are_cut_when_it_is_left_alone(save: Save) -> None:
    restore_snapshot(save.desk.board.engine, save.erased)
    save.desk.run_to(save.desk.board.cycle + TIME_HZ // 20)
    assert save.desk.board.hardware.flash.operations == save.begun + OPERATIONS
    assert held(save.desk) == NEW


SAMPLE = [
    *((ERASE, cut) for cut in (Cut.AFTER, Cut.BETWEEN, Cut.NOISE)),
    (1, Cut.BETWEEN),
    (1 + HEAD_WORDS, Cut.AFTER),
    (OPERATIONS // 2, Cut.WORDS),
    (OPERATIONS // 2 + 1, Cut.NOISE),
    *((LAST, cut) for cut in Cut),
]


@pytest.mark.parametrize(
    ("operation", "cut"),
    [
        pytest.param(
            operation,
            cut,
            marks=[] if (operation, cut) in SAMPLE else pytest.mark.prove,
            id=f"{operation}-{cut.name.lower()}",
        )
        for operation in range(OPERATIONS)
        for cut in Cut
    ],
)
def test_the_board_boots_with_all_the_old_or_all_the_new_settings_when_power_goes(
    save: Save, operation: int, cut: Cut
) -> None:
    save.cut(operation, cut)
    whole = (operation, cut) in ((LAST, Cut.AFTER), (LAST, Cut.WORDS))
    assert held(save.desk) in ([OLD, NEW] if whole else [OLD])
    with save.desk.client() as client:
        info = read_info(client)
    assert info.policy is not None
    assert info.policy.good
    assert "FAULT" not in info.arming_reasons


def test_settings_can_be_stored_when_the_last_save_was_cut(save: Save) -> None:
    save.cut(ERASE, Cut.NOISE)
    store(save.desk, NEW)
    save.desk.board.reset()
    save.desk.boot()
    assert held(save.desk) == NEW


@pytest.mark.prove
@pytest.mark.parametrize("cut", Cut)
def test_the_board_boots_when_power_goes_while_a_boot_is_logged(board_image: Path, cut: Cut) -> None:
    image = board_image.with_suffix(".bin").read_bytes()
    operation, resets = 0, 2
    while resets == 2:  # until there is no such operation any more
        desk = Desk(image, elf=board_image)
        desk.board.hardware.flash.cut_at, desk.board.hardware.flash.cut = operation, cut
        desk.boot()
        with desk.client() as client:
            assert "FAULT" not in read_info(client).arming_reasons
        resets = len(desk.board.engine.resets)
        desk.close()
        operation += 1
    assert operation > 20
