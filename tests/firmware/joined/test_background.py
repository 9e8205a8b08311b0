"""background.c around a scripted policy: the boot, what MSP may change and when, and what it reports."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.flash.settings.values import Settings
from neuroflight.sim.control import sticks
from neuroflight.sim.ports.library import Reference
from neuroflight.sim.ports.port import flight_settings
from neuroflight.toolchain.contract import (
    ARMING_DELAY_MS,
    BOOT_GRACE_MS,
    MOTOR_TEST_MAGIC,
    MOTOR_TEST_TIMEOUT_MS,
    RECEIVER_LOST_MS,
    DshotCommand,
    FlightState,
    GyroHealth,
    Msp,
    Task,
)
from neuroflight.toolchain.errors import LinkError

G = 9.80665
Make = Callable[..., "Board"]


class Board:
    """The whole firmware as a library, a millisecond a step."""

    def __init__(self, library: Path, **settings: float) -> None:
        self.core = Reference(library, 1000, flight_settings(settings))
        self.client = Client(self.core)
        self.ms, self.arm, self.heard, self.values = 0, False, True, b""

    def run(self, ms: int, force: tuple[float, float, float] = (0.0, 0.0, G)) -> list[int]:
        for _ in range(ms):
            if self.heard and self.ms % 10 == 0:
                self.core.receiver(sticks.channels((0.0, 0.0, 0.0), 0.0, armed=self.arm).tolist())
            x, y, z = force
            self.values = self.core.sample(np.zeros(3), np.array([x, y, z + 0.01 * (self.ms % 2)]))
            self.ms += 1
        return list(np.frombuffer(self.values, np.uint16)[:4])

    def fly(self) -> None:
        self.run(1100)
        self.arm = True
        self.run(30)
        assert self.safety.state == FlightState.ARMED

    def ask(self, command: Msp, payload: bytes = b"") -> bytes:
        return self.client.request(command, payload)

    @property
    def safety(self) -> records.Safety:
        return records.safety(self.ask(Msp.SAFETY))

    @property
    def reasons(self) -> set[str]:
        return set(messages.arming_reasons(self.safety.arming_flags))


@pytest.fixture
def make_board(scripted_build: Path, scripted: Any) -> Make:
    """Boots boards; the scripted policy answers 0."""
    scripted.lib.scripted_action = [0.0] * 4
    return lambda **settings: Board(scripted_build / "libneuroflight.so", **settings)


@pytest.fixture
def board(make_board: Make) -> Board:
    return make_board()


def test_it_boots_and_is_ready_when_all_is_well(board: Board) -> None:
    board.run(1100)
    assert board.reasons == set()
    state = messages.battery_state(board.ask(Msp.BATTERY_STATE))
    assert (state.cells, state.level) == (4, messages.BatteryLevel.GOOD)
    assert state.voltage_v == pytest.approx(16.8, abs=0.05)


@pytest.mark.parametrize(
    "settings",
    [
        {"battery_low_v": 4.0},
        {"map_roll": 1},
        {"nothing": 1},
        {"roll_expo": 2.0},
        {"gyro_stuck_ms": -1},
        {"gyro_stuck_ms": 2**33},
        {"failsafe_stage": 0.5},
        {"a_name_that_is_longer_than_that_of_any_setting": 1},
    ],
)
def test_it_does_not_boot_when_settings_are_none_or_contradict_each_other(
    make_board: Make, settings: dict[str, float]
) -> None:
    with pytest.raises(LinkError, match="refuses the settings"):
        make_board(**settings)


@pytest.mark.parametrize(
    "filters", [{"filter1_kind": 1}, {"dynamic_notch_count": 1, "dynamic_notch_high_hz": 300}]
)
def test_the_policy_is_bad_when_it_was_trained_behind_other_filters(
    make_board: Make, filters: dict[str, float]
) -> None:
    b = make_board(**filters)
    b.run(1100)
    assert b.reasons == {"POLICY_BAD"}


def test_the_chip_is_turned_as_set_when_the_board_is_not_asked(make_board: Make) -> None:
    straight, turned = make_board(), make_board(gyro_alignment=1)
    for b in (straight, turned):
        for _ in range(5):
            b.core.sample(np.array([0.5, 0.25, 0.1]), np.array([0.0, 0.0, G]))
    assert list(straight.core.trace().gyro) == pytest.approx([0.5, 0.25, 0.1], abs=1e-3)
    assert list(turned.core.trace().gyro) == pytest.approx([-0.5, -0.25, 0.1], abs=1e-3)


def test_settings_are_saved_only_when_nothing_flies(board: Board) -> None:
    board.run(1100)
    board.ask(Msp.EEPROM_WRITE)
    board.run(20)
    assert board.reasons == set()
    board.arm = True
    board.run(30)
    with pytest.raises(LinkError):
        board.ask(Msp.EEPROM_WRITE)
    board.run(30)
    assert board.safety.state == FlightState.ARMED


def test_it_starts_anew_only_when_nothing_flies(board: Board) -> None:
    board.fly()
    with pytest.raises(LinkError):
        board.ask(Msp.REBOOT)
    board.run(30)
    assert board.safety.state == FlightState.ARMED


def test_nothing_arms_when_it_is_about_to_start_anew(board: Board) -> None:
    board.run(1100)
    board.ask(Msp.REBOOT)
    board.ask(Msp.EEPROM_WRITE)  # whose end allows arming else
    board.run(20)
    assert board.reasons == {"STORING"}
    board.arm = True
    board.run(30)
    assert board.safety.state == FlightState.DISARMED


def test_a_motor_turns_while_its_value_is_given_anew_when_the_test_is_open(board: Board) -> None:
    board.run(1100)
    with pytest.raises(LinkError):
        board.ask(Msp.SET_MOTOR, struct.pack("<4H", 1000, 1100, 1000, 1000))
    for _ in range(2):
        board.ask(Msp.MOTOR_TEST, struct.pack("<I", MOTOR_TEST_MAGIC))
        board.run(2)
    board.ask(Msp.SET_MOTOR, struct.pack("<4H", 1000, 1100, 1000, 1000))
    assert board.run(5) == [0, 248, 0, 0]
    with pytest.raises(LinkError):
        board.ask(Msp.DSHOT_COMMAND, bytes([0, DshotCommand.BEACON_1]))
    with pytest.raises(LinkError):
        board.ask(Msp.SET_MOTOR, struct.pack("<9H", *[1000] * 9))
    assert board.run(MOTOR_TEST_TIMEOUT_MS + 2) == [0] * 4
    board.arm = True
    board.run(30)
    assert board.safety.state == FlightState.DISARMED, "the switch came too early"


def test_a_silent_gyro_keeps_the_background_going_when_it_is_told(board: Board) -> None:
    board.fly()
    assert not any(board.core.silent())
    assert board.safety.gyro_health == GyroHealth.SILENT
    assert board.safety.state == FlightState.FAULT
    runs = {load.task: load.runs for load in records.tasks(board.ask(Msp.TASKS)).loads}
    board.run(100)
    later = {load.task: load.runs for load in records.tasks(board.ask(Msp.TASKS)).loads}
    assert later[Task.BATTERY] - runs[Task.BATTERY] in (10, 11, 12)


def test_the_tasks_run_at_their_rates_when_samples_come(board: Board) -> None:
    board.run(1005)
    loads = {load.task: load for load in records.tasks(board.ask(Msp.TASKS)).loads}
    # Due at sample 0, and again at 1000.
    assert loads[Task.BATTERY].runs == loads[Task.BATTERY].rate_hz + 1 == 101
    assert loads[Task.ALERT].runs == loads[Task.ALERT].rate_hz + 1 == 51
    assert loads[Task.CONTROL].rate_hz == 1000


def test_sticks_by_msp_are_refused_when_the_receiver_is_another(board: Board) -> None:
    board.run(100)
    with pytest.raises(LinkError):
        board.ask(Msp.SET_RAW_RC, struct.pack("<16H", *[1500] * 16))


def test_sticks_by_msp_are_flown_one_frame_a_step_when_that_is_the_receiver(make_board: Make) -> None:
    b = make_board(receiver_protocol=2)
    b.heard = False
    frame = struct.pack("<16H", 1600, 1500, 1000, 1500, *[1000] * 12)
    for _ in range(30):
        b.ask(Msp.SET_RAW_RC, frame)
        with pytest.raises(LinkError):
            b.ask(Msp.SET_RAW_RC, frame)
        b.run(10)
    assert np.rad2deg(list(b.core.trace().setpoint)) == pytest.approx([200, 0, 0])


def test_the_link_is_lost_and_the_motors_descend_when_that_is_the_stage(make_board: Make) -> None:
    b = make_board(failsafe_stage=1, failsafe_descend_ms=200, failsafe_throttle=0.5)
    b.fly()
    b.heard = False
    assert b.run(RECEIVER_LOST_MS - 10) == [48] * 4
    assert b.run(100) == [1048] * 4
    assert b.safety.state == FlightState.FAILSAFE_DROP
    assert b.run(200) == [0] * 4


def setpoint_deg_s(b: Board, us: int) -> float:
    """Roll rate that a stick there asks for."""
    b.heard = False
    for _ in range(30):
        b.core.receiver([us, 1500, 1000, 1500, *[1000] * 12])
        b.run(10)
    return math.degrees(b.core.trace().setpoint[0])


@pytest.mark.parametrize(
    ("settings", "at_1501", "at_full"),
    [
        ({"rates_style": 1}, 0.40056, 666.667),
        ({"rates_style": 1, "roll_rate": 2.0}, 0.80112, 1333.33),
        ({"roll_rate": 2.0, "rates_style": 1}, 0.80112, 1333.33),  # the order of changes does not matter
        ({"roll_rate": 70.0, "roll_max": 670.0}, 0.1424, 670.0),
        ({}, 2.0, 1000.0),
    ],
)
def test_a_style_alone_gives_its_own_rates_when_set_for_a_start(
    make_board: Make, settings: dict[str, float], at_1501: float, at_full: float
) -> None:
    b = make_board(**settings)
    assert setpoint_deg_s(b, 1501) == pytest.approx(at_1501, rel=1e-4)
    assert setpoint_deg_s(b, 2000) == pytest.approx(at_full, rel=1e-4)


@pytest.mark.parametrize("settings", [{"roll_rate": 3.0}, {"yaw_max": 1.5}])
def test_it_does_not_boot_when_a_rate_is_beyond_its_style(
    make_board: Make, settings: dict[str, float]
) -> None:
    make_board(**settings)
    with pytest.raises(LinkError, match="refuses the settings"):
        make_board(rates_style=1, **settings)


def test_limits_are_those_of_the_style_when_settings_are_changed_by_name(make_board: Make) -> None:
    settings = Settings(make_board().client)
    settings.set("roll_rate", 500.0)
    settings.set("rates_style", 1.0)
    assert settings.get("roll_rate") == 1.0
    settings.set("roll_rate", 1.5)
    settings.set("rates_style", 1.0)
    assert settings.get("roll_rate") == 1.5
    with pytest.raises(LinkError, match=r"roll_rate got 500, expected 0\.01 to 2\.38"):
        settings.set("roll_rate", 500.0)
    settings.save()
    settings.set("rates_style", 0.0)
    settings.set("roll_rate", 500.0)


@pytest.mark.parametrize("delay_ms", [BOOT_GRACE_MS, 2000, ARMING_DELAY_MS])
def test_nothing_arms_before_the_delay_that_is_set_is_over(make_board: Make, delay_ms: int) -> None:
    b = make_board(arming_delay_ms=delay_ms)
    b.run(delay_ms - 40)
    assert b.reasons & {"BOOT_GRACE"} == {"BOOT_GRACE"}
    b.run(50)
    assert b.reasons == set()


def test_a_users_board_waits_for_its_escs_tunes_when_nothing_is_set(
    scripted_build: Path, scripted: Any
) -> None:
    core = Reference(scripted_build / "libneuroflight.so", 1000)
    told = Settings(Client(core))
    assert (told.get("arming_delay_ms"), ARMING_DELAY_MS) == (3000, 3000)
    assert told.info("arming_delay_ms").low == BOOT_GRACE_MS
    frame = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False).tolist()

    def reasons(ms: int) -> set[str]:
        for k in range(ms):
            core.receiver(frame)
            core.sample(np.zeros(3), np.array([0.0, 0.0, G + 0.01 * (k % 2)]))
        safety = records.safety(Client(core).request(Msp.SAFETY))
        return set(messages.arming_reasons(safety.arming_flags))

    assert reasons(ARMING_DELAY_MS - 1) == {"BOOT_GRACE"}
    assert reasons(2) == set()
