"""The real image's settings through resets, and through power that goes at any moment of their save."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import pytest

from neuroflight.flash.board.info import read_info
from neuroflight.flash.link.msp import encode, request
from neuroflight.flash.settings.values import Settings
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from neuroflight.sim.board.peripherals.flash import Cut
from neuroflight.sim.board.serial.bridge import UartLine
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.toolchain.contract import (
    MSP_BAUD_DEFAULT,
    MSP_BAUDS,
    MSP_PAYLOAD_MAX,
    SETTING_TEXT_BYTES,
    SETTINGS,
    Msp,
)
from neuroflight.toolchain.errors import LinkError
from tests.sampling import sampled

OLD = {"roll_expo": 0.25, "yaw_deadband_us": 7, "battery_low_v": 3.0}
NEW = {"roll_expo": 0.75, "yaw_deadband_us": 9, "battery_low_v": 3.25}
HEAD_WORDS, ENTRY_WORDS, CRC_WORDS = 4, 2, 1  # of a set in flash: settings_store.c
ENTRIES = sum(SETTING_TEXT_BYTES // 4 if setting.kind == "text" else 1 for setting in SETTINGS)
OPERATIONS = 1 + HEAD_WORDS + ENTRY_WORDS * ENTRIES + CRC_WORDS  # of a save: erase, then words
ERASE, LAST = 0, OPERATIONS - 1
MICROSECOND = TIME_HZ // 1_000_000
SAVE_S = 2.0  # what it may take, with the restart behind it


def until(idle: IdleBoard, happened: Callable[[], bool], step: int) -> None:
    """Run in steps of so many cycles until it has."""
    end = idle.board.cycle + round(SAVE_S * TIME_HZ)
    while not happened():
        assert idle.board.cycle < end
        idle.run_to(idle.board.cycle + step)


def store(idle: IdleBoard, values: dict[str, float]) -> None:
    settings = Settings(idle.client())
    for name, value in values.items():
        settings.set(name, value)
    settings.save()


def held(idle: IdleBoard) -> dict[str, float]:
    settings = Settings(idle.client())
    return {name: float(settings.get(name)) for name in NEW}


@pytest.fixture(scope="module")
def booted(board_image: Path) -> Iterator[tuple[IdleBoard, Snapshot]]:
    """A board that has stored OLD."""
    idle = IdleBoard(board_image.with_suffix(".bin").read_bytes(), elf=board_image)
    idle.boot()
    store(idle, OLD)
    yield idle, take_snapshot(idle.board.engine)
    idle.close()


@pytest.fixture
def idle(booted: tuple[IdleBoard, Snapshot]) -> IdleBoard:
    restore_snapshot(booted[0].board.engine, booted[1])
    return booted[0]


# --- Resets -------------------------------------------------------------------------------------
def test_stored_settings_are_there_when_power_was_gone(idle: IdleBoard) -> None:
    Settings(idle.client()).set("roll_expo", 0.5)  # and not stored
    idle.board.reset()
    idle.boot()
    assert held(idle) == OLD
    assert idle.board.engine.resets[-1] == "power"


def test_stored_settings_are_there_when_the_board_was_told_to_start_anew(idle: IdleBoard) -> None:
    with idle.client() as client:
        Settings(client).set("roll_expo", 0.5)  # and not stored
        assert client.request(Msp.REBOOT, retries=0) == b"", "the reply comes before the reset"
        resets = idle.board.engine.resets
        until(idle, lambda: resets[-1] == "software", MICROSECOND)
    idle.boot()
    assert held(idle) == OLD


@pytest.mark.parametrize("baud", sampled(MSP_BAUDS, MSP_BAUDS[-1]))
def test_it_talks_at_the_speed_that_is_stored_when_it_has_started_anew(idle: IdleBoard, baud: int) -> None:
    store(idle, {"msp_baud": baud, "gyro_rate_hz": 8000})
    with idle.client() as client:
        read_info(client)  # at the old one, until then
        client.request(Msp.REBOOT)
    until(idle, lambda: idle.board.engine.resets[-1] == "software", 100 * MICROSECOND)
    idle.boot()
    other = 57_600 if baud != 57_600 else MSP_BAUD_DEFAULT
    with idle.client(other) as client, pytest.raises(LinkError, match="silence"):
        client.request(Msp.API_VERSION, timeout=0.1, retries=0)
    with idle.client(baud) as client:
        assert read_info(client).variant == "BTFL"
        assert Settings(client).get("msp_baud") == baud
        with pytest.raises(LinkError, match="a length or a value that the command does not take"):
            client.request(Msp.SETTING_GET, bytes(MSP_PAYLOAD_MAX), retries=0)  # came whole
        assert client.request(Msp.REBOOT, retries=0) == b""


# --- Power cuts ---------------------------------------------------------------------------------
@dataclass(frozen=True)
class Save:
    """A board that has stored OLD and is about to store NEW."""

    idle: IdleBoard
    before: Snapshot
    erased: Snapshot  # of the same save: its first word is about to be programmed
    begun: int  # flash operations before it

    def cut(self, operation: int, cut: Cut) -> None:
        """Power goes in the middle of that operation of the save, and comes back."""
        board = self.idle.board
        restore_snapshot(board.engine, self.before if operation == ERASE else self.erased)
        resets = len(board.engine.resets)
        board.hardware.flash.cut_at, board.hardware.flash.cut = self.begun + operation, cut
        if operation == ERASE:
            UartLine(board).send(encode(request(Msp.EEPROM_WRITE)))
        until(self.idle, lambda: len(board.engine.resets) > resets, 100 * MICROSECOND)
        assert board.engine.resets[resets:] == ["power"]
        self.idle.boot()


@pytest.fixture(scope="module")
def save(booted: tuple[IdleBoard, Snapshot]) -> Save:
    idle, snapshot = booted
    restore_snapshot(idle.board.engine, snapshot)
    settings = Settings(idle.client())
    for name, value in NEW.items():
        settings.set(name, value)
    before, flash = take_snapshot(idle.board.engine), idle.board.hardware.flash
    begun = flash.operations
    UartLine(idle.board).send(encode(request(Msp.EEPROM_WRITE)))
    until(idle, lambda: flash.operations == begun + 1, 100 * MICROSECOND)
    erased = idle.board.engine.alarms["flash.done"].due
    assert erased is not None
    idle.run_to(erased)
    assert flash.operations == begun + 1
    return Save(idle, before, take_snapshot(idle.board.engine), begun)


def test_a_save_takes_as_many_operations_as_are_cut_when_it_is_left_alone(save: Save) -> None:
    restore_snapshot(save.idle.board.engine, save.erased)
    save.idle.run_to(save.idle.board.cycle + TIME_HZ // 20)
    assert save.idle.board.hardware.flash.operations == save.begun + OPERATIONS
    assert held(save.idle) == NEW


SAMPLE = [  # of the ordinary run: tests/firmware/storage cuts at every operation
    (ERASE, Cut.NOISE),
    (1 + HEAD_WORDS, Cut.AFTER),
    (OPERATIONS // 2, Cut.WORDS),
    (LAST, Cut.BETWEEN),
]


@pytest.mark.parametrize(
    "case",
    sampled(product(range(OPERATIONS), Cut), *SAMPLE),
    ids=lambda case: f"{case[0]}-{case[1].name.lower()}",
)
def test_the_board_boots_with_all_the_old_or_all_the_new_settings_when_power_goes(
    save: Save, case: tuple[int, Cut]
) -> None:
    operation, cut = case
    save.cut(operation, cut)
    whole = (operation, cut) in ((LAST, Cut.AFTER), (LAST, Cut.WORDS))
    assert held(save.idle) in ([OLD, NEW] if whole else [OLD])
    with save.idle.client() as client:
        info = read_info(client)
    assert info.policy is not None
    assert info.policy.good
    assert "FAULT" not in info.arming_reasons


def test_settings_can_be_stored_when_the_last_save_was_cut(save: Save) -> None:
    save.cut(ERASE, Cut.NOISE)
    store(save.idle, NEW)
    save.idle.board.reset()
    save.idle.boot()
    assert held(save.idle) == NEW


@pytest.mark.slow
@pytest.mark.parametrize("cut", Cut)
def test_the_board_boots_when_power_goes_while_a_boot_is_logged(board_image: Path, cut: Cut) -> None:
    image = board_image.with_suffix(".bin").read_bytes()
    operation, resets = 0, 2
    while resets == 2:  # until there is no such operation any more
        idle = IdleBoard(image, elf=board_image)
        idle.board.hardware.flash.cut_at, idle.board.hardware.flash.cut = operation, cut
        idle.boot()
        with idle.client() as client:
            assert "FAULT" not in read_info(client).arming_reasons
        resets = len(idle.board.engine.resets)
        idle.close()
        operation += 1
    assert operation > 20
