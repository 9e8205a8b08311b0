"""An idle board with the real image: at rest, set over MSP, served in time."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from neuroflight.flash.board.info import read_info
from neuroflight.flash.link import messages, records
from neuroflight.flash.link.msp import encode, request
from neuroflight.flash.settings.values import Settings
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.gdb import GdbServer
from neuroflight.sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from neuroflight.sim.board.fitted import GYROS
from neuroflight.sim.board.serial import idle_board as idle_board
from neuroflight.sim.board.serial.bridge import Bridge, PtyEnd, UartLine
from neuroflight.sim.board.serial.idle_board import (
    TEMPERATURE_DEG_C,
    IdleBoard,
    Keeper,
    configured,
    serve,
    with_image,
)
from neuroflight.toolchain.contract import (
    ARMING_DELAY_MS,
    FLASH_BANK_A,
    FLASH_BANK_B,
    FLASH_BASE,
    FLASH_BOOT,
    FLASH_BYTES,
    FLASH_SETTINGS,
    GyroHealth,
    Msp,
)
from neuroflight.toolchain.errors import LinkError
from tests.sampling import sampled

MILLISECOND = TIME_HZ // 1000


@pytest.fixture(scope="module")
def image(board_image: Path) -> Path:
    """What is flashed."""
    return board_image.with_suffix(".bin")


@pytest.fixture(scope="module")
def booted(image: Path) -> Iterator[tuple[IdleBoard, Snapshot]]:
    idle = IdleBoard(image.read_bytes(), elf=image.with_suffix(".elf"))
    idle.run_to(TIME_HZ // 2)
    yield idle, take_snapshot(idle.board.engine)
    idle.close()


@pytest.fixture
def idle(booted: tuple[IdleBoard, Snapshot]) -> IdleBoard:
    """The real image on an idle board, shortly after its boot."""
    restore_snapshot(booted[0].board.engine, booted[1])
    return booted[0]


def test_only_the_pilot_is_missing_when_the_board_has_lain_still(idle: IdleBoard) -> None:
    idle.run_to((ARMING_DELAY_MS + 500) * TIME_HZ // 1000)
    with idle.client() as client:
        info = read_info(client)
        battery = messages.battery_state(client.request(Msp.BATTERY_STATE))
    assert info.arming_reasons == ("RECEIVER_LOST", "SWITCH_NOT_CYCLED")
    assert (battery.cells, battery.level) == (4, messages.BatteryLevel.GOOD)


@pytest.mark.parametrize("chip", sampled([kind for kind in GYROS if kind != "bmi270"], "mpu6500"))
def test_the_chips_temperature_is_read_by_its_own_formula_when_another_one_is_fitted(
    image: Path, chip: str
) -> None:
    idle = IdleBoard(image.read_bytes(), elf=image.with_suffix(".elf"), gyro=GYROS[chip])
    idle.run_to(TIME_HZ)
    with idle.client() as client:
        safety = records.safety(client.request(Msp.SAFETY))
    idle.close()
    assert safety.temperature_deg_c == pytest.approx(TEMPERATURE_DEG_C, abs=0.01)
    assert safety.gyro_health is GyroHealth.GOOD


def test_the_first_question_is_heard_when_the_board_has_booted(image: Path) -> None:
    idle = IdleBoard(image.read_bytes(), elf=image.with_suffix(".elf"))
    idle.boot()
    assert idle.board.cycle < TIME_HZ
    assert idle.client().request(Msp.FC_VARIANT, retries=0) == b"BTFL"
    idle.close()


@pytest.mark.slow
def test_settings_are_there_after_a_reset_when_the_board_was_configured(image: Path) -> None:
    flash = configured(
        image.read_bytes(),
        image.with_suffix(".elf"),
        {"gyro_rate_hz": 8000, "roll_expo": 0.1, "filter1_kind": 5},
    )
    assert len(flash) == FLASH_BYTES
    assert flash[: FLASH_BOOT.size] == image.read_bytes()[: FLASH_BOOT.size]
    idle = IdleBoard(flash, elf=image.with_suffix(".elf"))
    settings = Settings(idle.client())
    got = [settings.get(name) for name in ("gyro_rate_hz", "roll_expo", "filter1_kind", "pitch_expo")]
    assert got == [8000, 0.10000000149011612, 5, 0.0]
    assert messages.policy_info(idle.client().request(Msp.POLICY_INFO)).gyro_rate_hz == 8000
    idle.close()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"roll_expo": 2.0}, "setting roll_expo got 2, expected 0 to 1"),
        ({"gyro_rate_hz": 2000.5}, "got 2000.5, expected a whole number from 1000 to 8000 Hz"),
        ({"gyro_rate_hz": 7000}, "EEPROM_WRITE: gyro_rate_hz does not fit the policy or other settings"),
        ({"no_such": 1}, "setting 'no_such': the firmware has none of that name"),
    ],
)
def test_a_setting_is_refused_with_the_reason_when_the_image_does_not_take_it(
    idle: IdleBoard, monkeypatch: pytest.MonkeyPatch, image: Path, settings: dict[str, float], words: str
) -> None:
    monkeypatch.setattr(idle_board, "IdleBoard", lambda *_, **__: idle)  # booted once for all
    monkeypatch.setattr(idle, "close", lambda: None)
    with pytest.raises(LinkError, match=words):
        configured(image.read_bytes(), image.with_suffix(".elf"), settings)


@pytest.mark.parametrize(
    ("held_s", "seconds", "slept_s"), [(0.0, 0.05, 0.05), (10.0, 0.3, 0.3 - 0.001 - 0.1)]
)
def test_the_board_keeps_to_the_wall_clock_and_catches_up_a_tenth_of_a_second_at_most(
    idle: IdleBoard, held_s: float, seconds: float, slept_s: float
) -> None:
    wall, slept, begin = 5.0, 0.0, idle.board.cycle

    def sleep(seconds: float) -> None:
        nonlocal wall, slept
        wall, slept = wall + seconds, slept + seconds

    def hold() -> None:
        nonlocal wall
        wall += 0.0 if idle.board.cycle > begin + MILLISECOND else held_s

    serve(idle, [], seconds=seconds, update=hold, clock=lambda: wall, sleep=sleep)
    assert idle.board.cycle - begin == round(seconds * 1000) * MILLISECOND
    assert slept == pytest.approx(slept_s, abs=0.002 if held_s else 1e-9)


def test_a_program_is_served_when_the_board_is_idle(idle: IdleBoard) -> None:
    bridge = Bridge(UartLine(idle.board), PtyEnd())
    with serial.Serial(bridge.end.name, timeout=0) as program:
        program.write(encode(request(Msp.FC_VARIANT)))
        serve(idle, [bridge], seconds=0.01, clock=lambda: 0.0, sleep=lambda _: None)
        assert program.read(100).startswith(b"$M>\x04\x02BTFL")
    bridge.close()


def test_flash_is_kept_once_when_a_save_has_come_to_rest(idle: IdleBoard) -> None:
    kept: list[bytes] = []
    keeper = Keeper(idle, kept.append)
    settings = Settings(idle.client())
    settings.set("roll_expo", 0.5)
    settings.save()
    keeper.update()
    assert kept == [], "it may go on"
    serve(idle, [], seconds=0.2, update=keeper.update, clock=lambda: 0.0, sleep=lambda _: None)
    keeper.update(at_once=True)
    assert kept == [idle.flash()]
    assert any(
        kept[0][s.address - FLASH_BASE : s.address - FLASH_BASE + 4] == b"NFPS" for s in FLASH_SETTINGS
    )


def test_flash_is_kept_once_when_a_debugger_has_programmed_it(idle: IdleBoard) -> None:
    kept: list[bytes] = []
    keeper = Keeper(idle, kept.append)
    server = GdbServer(idle.board.engine, 0, on_flashed=keeper.note_change)
    with socket.create_connection(("127.0.0.1", server.port), 20) as client:
        server.wait(20)
        client.sendall(b"$vFlashErase:8060000,20000#0a$D#44")
        server.run_to(idle.board.cycle + 1)
    server.close()
    keeper.update()
    assert kept == [], "more may come"
    serve(idle, [], seconds=0.2, update=keeper.update, clock=lambda: 0.0, sleep=lambda _: None)
    keeper.update(at_once=True)
    assert kept == [idle.flash()]
    assert kept[0][-0x20000:] == b"\xff" * 0x20000


def test_all_but_the_image_stays_when_another_image_is_flashed(image: Path) -> None:
    new = image.read_bytes()
    old = bytes(FLASH_BYTES)
    flash = with_image(new, old)
    for sector in (FLASH_BOOT, FLASH_BANK_A):
        begin = sector.address - FLASH_BASE
        flashed = new[begin : begin + sector.size].ljust(sector.size, b"\xff")
        assert flash[begin : begin + sector.size] == flashed
    banks = FLASH_BANK_A.size + FLASH_BANK_B.size
    assert flash[FLASH_BANK_B.address - FLASH_BASE :][: FLASH_BANK_B.size] == b"\xff" * FLASH_BANK_B.size
    assert flash.count(0) >= FLASH_BYTES - FLASH_BOOT.size - banks
    assert with_image(new, None) == new
    with pytest.raises(LinkError, match="5 bytes, expected the 524288 of a whole flash"):
        with_image(new, b"photo")
