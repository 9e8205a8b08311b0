"""background.c on a board that says of itself what forbids arming: clock, alignment, load, motors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import pytest

from neuroflight.toolchain.contract import (
    BOOT_GRACE_MS,
    FLASH_FAULT_RECORD,
    FLASH_POLICY_SLOTS,
    FLASH_SETTINGS,
    LOAD_CALM_MS,
    MOTOR_TEST_MAGIC,
    MOTOR_TEST_TIMEOUT_MS,
    ArmingReason,
    Refusal,
    Task,
)
from neuroflight.toolchain.policy.blob import pack
from tests.firmware.conftest import G_COUNTS, scripted_blob
from tests.firmware.storage.test_settings_store import as_set

GYRO_HZ = 1000
CYCLES_HZ = 216_000_000
RENEW_MS = 5000  # FAULT_LOG_RENEW_MS of background.c
OTHERS = {ArmingReason.RECEIVER_LOST, ArmingReason.SWITCH_NOT_CYCLED}
GYRO_COUNTS = 32768 / 2000  # a deg/s
CW90 = 2  # of the setting gyro_alignment
Make = Callable[..., "Board"]


class Board:
    """The core and its background around a hal that measures nothing."""

    made_of: Any = None  # the flash

    def __init__(
        self, core: Any, flash: Any, alignment: int = 0, controller: float = 0.0, **board: Any
    ) -> None:
        """Start it.

        alignment: the setting. controller: share of a gyro period that passes between two looks at the
        cycles. board: of struct hal_info.
        """
        self.core, ffi = core, core.ffi
        self.clock, passing = 0, int(controller * CYCLES_HZ / GYRO_HZ)
        self.fed = 0

        def cycles(context: Any) -> int:
            self.clock += passing
            return self.clock & 0xFFFFFFFF

        def feed(context: Any) -> None:
            self.fed += 1

        self.cycles = ffi.callback("uint32_t(void *)", cycles)
        self.feed = ffi.callback("void(void *)", feed)
        self.power = ffi.callback("void(void *, struct power_sample *)", self._power)
        self.switch = ffi.callback("void(void *, bool)", lambda context, on: None)
        self.log = ffi.callback("struct log_device *(void *, uint8_t)", lambda context, device: ffi.NULL)
        hal = {"cycles": self.cycles, "power_read": self.power, "beeper": self.switch, "led": self.switch}
        hal |= {"log": self.log, "watchdog_feed": self.feed}
        self.hal = core.new("struct hal *", {**hal, "flash": flash[0]})
        self.fw, self.stats = core.new("struct firmware *"), core.new("struct task_stats[]", len(Task))
        self.pid, self.target = core.new("struct pid_gains *"), core.new("char[]", b"TARGET")
        self.weights = core.new("double[]", 8)
        settings = {"gyro_alignment": alignment, "arming_delay_ms": BOOT_GRACE_MS}
        self.change = core.new("struct setting_change[]", len(settings))
        for change, (name, value) in zip(self.change, settings.items(), strict=True):
            change.index, change.value.as_uint32_t = core.lib.settings_find(name.encode()), value
        self.background = core.new("struct background *")
        identity = {"target": self.target, "volts_scale": 11.0, "amps_scale": 17.9}
        info = {
            "hal": self.hal, "changes": self.change,
            "identity": {**identity, **board.pop("identity", {})},
            "change_count": len(settings), "gyro_rate_hz": GYRO_HZ, "cycles_hz": CYCLES_HZ, **board,
        }  # fmt: skip
        parts = {"firmware": self.fw, "weights": ffi.cast("float *", self.weights), "stats": self.stats}
        config = {"board": info, **parts, "pid": self.pid}
        self.config = core.new("struct background_config *", config)
        assert core.lib.background_start(self.background, self.config) == 0
        self.dshot, self.number = core.new("uint16_t[8]"), 0

    def bytes_of(self, part: str) -> bytes:
        """Of a member of struct firmware, pointers in it excepted."""
        ffi = self.core.ffi
        return bytes(ffi.buffer(ffi.addressof(self.fw, *part.split("."))))

    def _power(self, context: Any, power: Any) -> None:
        power.volts_mv, power.amps_mv, power.valid = 1527, 0, True

    def run(self, ms: int, load: float = 0.4, turning_deg_s: float = 0.0) -> set[ArmingReason]:
        """Samples that take that share of their period, still or turning; what forbids arming then."""
        rates = (round(turning_deg_s * GYRO_COUNTS), 0, 0)
        for _ in range(ms):
            self.number += 1
            accel = (0, 0, G_COUNTS + self.number % 2)
            sample = self.core.new("struct imu_sample *", (rates, accel, 0, True))
            self.core.lib.firmware_sample(self.fw, sample, self.dshot)
            self.core.lib.task_stats_add(self.stats + Task.CONTROL, int(load * CYCLES_HZ / GYRO_HZ), False)
            for _ in Task:
                self.core.lib.background_step(self.background)
        status = self.core.new("struct firmware_status *")
        self.core.lib.firmware_status(self.fw, status)
        return {reason for reason in ArmingReason if status.arming_reasons >> reason & 1} - OTHERS


@pytest.fixture
def board(scripted: Any, chip: Callable[..., Any]) -> Make:
    scripted.lib.scripted_action = [0.0] * 4

    def make(*, full_log: bool = False, stored: Mapping[str, float] | None = None, **options: Any) -> Board:
        made = chip()
        if stored is not None:
            made.fill(FLASH_SETTINGS[0].address, as_set(stored, 1))
        made.fill(FLASH_POLICY_SLOTS[0].address, pack(scripted_blob()))
        if full_log:
            made.fill(FLASH_FAULT_RECORD.address, b"\x55" * FLASH_FAULT_RECORD.size)
        built = Board(scripted, made.flash, **options)
        built.made_of = made
        return built

    return make


def test_nothing_is_held_when_the_board_is_as_it_should_be(board: Make) -> None:
    assert board(real_time=True).run(1200) == set()


def test_it_does_not_arm_when_no_crystal_makes_the_clock(board: Make) -> None:
    assert board(clock_inexact=True, real_time=True).run(1200) == {ArmingReason.CLOCK}


def test_it_arms_with_the_turn_of_the_board_that_its_maker_sets(board: Make, scripted: Any) -> None:
    turn = scripted.new("int16_t[3]", [0, 0, 90])
    turned = board(turn_deg=turn, real_time=True)
    assert turned.run(1200) == set()
    assert list(turned.fw.gyro.turn[0]) == pytest.approx([0, 1, 0], abs=1e-6)
    hanging = scripted.new("int16_t[3]", [180, 0, 0])  # so that the accelerometer feels it upside down
    assert board(turn_deg=hanging, real_time=True).run(1200) == {ArmingReason.NOT_LEVEL}


@pytest.mark.parametrize(("alignment", "held"), [(0, {ArmingReason.GYRO_ALIGNMENT}), (CW90, set())])
def test_it_arms_with_a_disputed_alignment_only_when_the_pilot_has_said_it(
    board: Make, alignment: int, held: set[ArmingReason]
) -> None:
    assert board(alignment=alignment, alignment_disputed=True).run(1200) == held


@pytest.mark.parametrize(
    ("stored", "held"),
    [
        ({"deadband_us": 7}, set()),
        ({"mode1": 99}, set()),  # a mode to come: no range, and what it was for is not here
        ({"map_aux1": 9}, {ArmingReason.SETTINGS}),
        ({"motor1_output": 4}, {ArmingReason.SETTINGS}),
    ],
)
def test_it_does_not_arm_when_other_settings_are_flown_than_were_stored(
    board: Make, stored: dict[str, float], held: set[ArmingReason]
) -> None:
    assert board(stored=stored).run(1200) == held


@pytest.mark.parametrize(
    ("otherwise", "held"),
    [
        ({}, set()),
        ({"motor1_output": 2, "motor2_output": 1}, {ArmingReason.MOTORS_UNCHECKED}),
        ({"motors_reversed": 1}, {ArmingReason.MOTORS_UNCHECKED}),
        ({"board_yaw_deg": 90.0}, {ArmingReason.MOTORS_UNCHECKED}),
        ({"gyro_alignment": CW90}, {ArmingReason.MOTORS_UNCHECKED}),
        ({"gyro_alignment": CW90, "motor_check": 0}, set()),
        ({"gyro_stuck_ms": 20, "motor_stop": 1}, set()),
    ],
)
def test_it_does_not_arm_when_motors_or_gyro_are_set_otherwise_than_they_were_checked(
    board: Make, otherwise: dict[str, float], held: set[ArmingReason]
) -> None:
    key = int(board().background.motor_key)
    alignment = int(otherwise.get("gyro_alignment", 0))
    made = board(stored={"motors_checked": key, **otherwise}, alignment=alignment)
    assert made.run(1200) == held
    assert made.background.motor_key == key or held or "gyro_alignment" in otherwise


def test_another_board_or_aircraft_is_not_checked_when_one_was(board: Make) -> None:
    keys = {int(board(identity={"unique_id": [number, 7, 8]}).background.motor_key) for number in range(3)}
    assert len(keys) == 3


def test_it_does_not_arm_until_a_second_has_passed_without_an_overload(board: Make) -> None:
    b = board(real_time=True)
    assert b.run(1200) == set()
    assert b.run(110, load=0.99) == set()
    assert b.run(110, load=1.02) == {ArmingReason.LOAD}
    assert b.run(LOAD_CALM_MS - 110) == {ArmingReason.LOAD}
    assert b.run(220) == set()


@pytest.mark.parametrize(
    ("load", "controller", "held"), [(0.4, 0.59, False), (0.4, 0.62, True), (0.0, 1.02, True)]
)
def test_the_controllers_time_counts_for_the_load_before_one_has_flown(
    board: Make, load: float, controller: float, held: bool
) -> None:
    b = board(real_time=True, controller=controller)
    assert b.fed >= 2, "a slow controller's rehearsals must not end in a watchdog's reset"
    assert b.run(1200, load=load) == ({ArmingReason.LOAD} if held else set())
    told = b.core.new("struct firmware_status *")
    b.core.lib.background_status(b.background, told)
    assert told.load_percent == pytest.approx(100 * (load + controller), abs=1)


def test_nothing_is_left_of_the_rehearsals(board: Make) -> None:
    rehearsed, other = board(real_time=True, controller=0.3), board(real_time=False)
    for b in (rehearsed, other):
        b.run(50)
    for part in (
        "control.observation",
        "control.pid.integral",
        "turning",
        "plausibility",
        "crash",
        "status.trace",
    ):
        assert rehearsed.bytes_of(part) == other.bytes_of(part), part


def test_a_load_is_no_reason_when_samples_wait_for_the_processor(board: Make) -> None:
    assert board(real_time=False).run(1200, load=3.0) == set()


def test_a_full_fault_log_is_begun_anew_after_seconds_and_only_while_no_motor_turns(board: Make) -> None:
    b = board(full_log=True)
    flash = b.made_of
    b.run(RENEW_MS - 200)
    lib, test = b.core.lib, b.core.ffi.addressof(b.fw, "motor_test")
    still = b.core.new("float[]", [0.0] * 4)
    assert lib.motor_test_ask(test, MOTOR_TEST_MAGIC, True) == Refusal.NONE
    for _ in range(10):  # the test is kept open beyond the time
        b.run(50)
        assert lib.motor_test_give(test, still, 4) == Refusal.NONE
    assert flash.operations == 0
    assert not b.run(1) & {ArmingReason.STORING}, "what was refused forbids nothing"
    b.run(2 * MOTOR_TEST_TIMEOUT_MS + 200)
    assert flash.region(FLASH_FAULT_RECORD)[:4] == b"NFFL"
    assert flash.region(FLASH_FAULT_RECORD)[-4:] == b"\xff" * 4
    done = flash.operations
    b.run(2000)
    assert flash.operations == done, "once is enough"


@pytest.mark.parametrize(("turning_deg_s", "open_still"), [(290.0, True), (-310.0, False)])
def test_a_motor_test_ends_when_the_aircraft_turns_as_one_that_nobody_holds(
    board: Make, turning_deg_s: float, open_still: bool
) -> None:
    b = board()
    b.run(1200)
    lib, test = b.core.lib, b.core.ffi.addressof(b.fw, "motor_test")
    gentle = b.core.new("float[]", [0.1, 0.0, 0.0, 0.0])
    assert lib.motor_test_ask(test, MOTOR_TEST_MAGIC, True) == Refusal.NONE
    assert lib.motor_test_give(test, gentle, 4) == Refusal.NONE
    b.run(5)
    assert b.dshot[0] > 0
    b.run(25, turning_deg_s=turning_deg_s)
    assert lib.motor_test_open(test) is open_still
    assert (b.dshot[0] > 0) is open_still
