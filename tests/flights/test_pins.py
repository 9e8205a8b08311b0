"""Motors on the emulated pins: which line is which motor, and which of them answer a turn."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.board.hints import brown_out
from neuroflight.flash.board.overview import read_overview
from neuroflight.flash.link import requests
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.messages import arming_reasons
from neuroflight.flash.link.records import safety
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.devices.gyro_bmi import BMI270
from neuroflight.sim.board.devices.gyro_chip import GyroKind
from neuroflight.sim.board.devices.gyro_mount import accel_counts
from neuroflight.sim.board.devices.gyro_mpu import ICM20602, MPU6500
from neuroflight.sim.board.fitted import FULL_VOLTS, GYRO, GYROS, MATEKF722
from neuroflight.sim.board.peripherals.option_bytes import OptionBytes
from neuroflight.sim.board.serial.bridge import LineTransport, UartLine
from neuroflight.sim.board.serial.idle_board import configured
from neuroflight.sim.control import sticks
from neuroflight.sim.ports.emulator import EmulatedPort, PortSnapshot
from neuroflight.sim.ports.port import Sample
from neuroflight.toolchain.boards import facts
from neuroflight.toolchain.boards.allocation import allocate
from neuroflight.toolchain.boards.description import pack
from neuroflight.toolchain.contract import CALIBRATION_MS, GRAVITY, MOTOR_TEST_MAGIC, Alignment, Msp
from neuroflight.toolchain.image.elf import read_flashable
from neuroflight.toolchain.image.stamp import stamp
from tests.sampling import sampled

MOTORS = 4
LEVEL = np.array([0.0, 0.0, GRAVITY])
TURN = 1.0  # rad/s
PLAIN = [kind for kind in GYROS if kind != "bmi270"]  # that need no file
ORDINARY = (("icm20689", False), ("icm20689", True))  # chip, said
# Places in the ecosystem's app's list of gyro chips at API 1.47, which has L3G4200D and MPU3050 no more.
_APP = (
    "AUTO NONE MPU6050 L3GD20 MPU6000 MPU6500 MPU9250 ICM20601 ICM20602 ICM20608G ICM20649 ICM20689 ICM42605 "
    "ICM42688P BMI160 BMI270 LSM6DSO LSM6DSV16X IIM42653 ICM45605 ICM45686 ICM40609D IIM42652 LSM6DSK320X"
)
APP_NUMBERS = {name: number for number, name in enumerate(_APP.split())}


class Bench:
    """A board on the bench, spoken to over MSP."""

    def __init__(
        self,
        flash: bytes,
        elf: Path,
        chip: GyroKind = ICM20602,
        wiring: facts.Board = MATEKF722,
        place: int = 0,
    ) -> None:
        self.board = Board(flash, board=wiring, elf=elf, chip=chip, gyro_place=place)
        self.board.hardware.adc.set_battery(FULL_VOLTS, 0.0)
        rng = np.random.default_rng(1)
        gyro = self.board.hardware.gyro
        gyro.before_sample = lambda number: gyro.measure(
            accel_counts(LEVEL.tolist(), GYRO.alignment), 0, tuple(rng.integers(-9, 10, 3).tolist())
        )
        line = LineTransport(UartLine(self.board), self.board.run_to)
        self.client = Client(line, line.clock)
        self.board.run(CALIBRATION_MS / 1000 + 0.5)

    def reasons(self) -> set[str]:
        """What forbids arming."""
        return set(arming_reasons(safety(self.client.request(Msp.SAFETY)).arming_flags))


def test_a_motor_turns_on_its_own_line_when_it_is_asked_for(board_image: Path) -> None:
    bench = Bench(read_flashable(board_image.with_suffix(".bin")), board_image)
    try:
        bench.client.request(Msp.MOTOR_TEST, requests.motor_test(MOTOR_TEST_MAGIC))
        for motor in range(MOTORS):
            asked = [1000] * MOTORS
            asked[motor] = 1080
            bench.client.request(Msp.SET_MOTOR, requests.set_motor(asked))
            bench.board.run(0.01)
            turning = bench.board.hardware.obeyed(MOTORS) > 0
            assert turning.tolist() == [index == motor for index in range(MOTORS)]
    finally:
        bench.board.close()


@pytest.mark.parametrize("chip", sampled(product(PLAIN, (False, True)), *ORDINARY), ids=str)
def test_a_disputed_gyro_arms_only_when_the_pilot_has_said_how_it_is_turned(
    board_image: Path, chip: tuple[str, bool]
) -> None:
    name, said = chip
    flash = read_flashable(board_image.with_suffix(".bin"))
    if said:
        flash = configured(flash, board_image, {"gyro_alignment": 2.0})
    kind = GYROS[name].chip
    bench = Bench(flash, board_image, kind)
    held = bench.reasons() - {"BOOT_GRACE", "RECEIVER_LOST", "SWITCH_NOT_CYCLED", "NOT_LEVEL"}
    told = read_overview(bench.client).flight
    hardware = bench.client.request(Msp.GYRO_SENSOR), bench.client.request(Msp.SENSOR_CONFIG_ACTIVE)[:1]
    bench.board.close()
    assert hardware == (bytes([1, APP_NUMBERS[kind.name]]), bytes([APP_NUMBERS[kind.name]]))
    assert told is not None and told.gyro_chip == f"{kind.name} (0x{kind.who_am_i:02X})"
    known = said or kind in (ICM20602, MPU6500)
    assert held == (set() if known else {"GYRO_ALIGNMENT"})


@pytest.mark.parametrize("place_ready", sampled([(0, "PB0"), (1, None)], (1, None)))
def test_the_second_gyro_flies_when_the_pilot_chooses_it(
    board_image: Path, tmp_path: Path, place_ready: tuple[int, str | None]
) -> None:
    place, ready = place_ready
    line = None if ready is None else facts.Pin.of(ready)
    second = facts.GyroPlace(1, facts.Pin("A", 15), line, Alignment.CW90_FLIP)
    wiring = replace(MATEKF722, gyros=(*MATEKF722.gyros, second))
    elf = tmp_path / "neuroflight.elf"
    stamp(board_image, pack(allocate(wiring)), elf)
    binary = ("arm-none-eabi-objcopy", "-O", "binary", "--gap-fill", "0xFF", "--remove-section=.slot_b")
    subprocess.run([*binary, elf, elf.with_suffix(".bin")], check=True)
    flash = configured(read_flashable(elf.with_suffix(".bin")), elf, {"gyro_select": 1.0})
    bench = Bench(flash, elf, MPU6500, wiring, place)
    told = read_overview(bench.client).flight
    taken, held = bench.board.hardware.gyro.samples, bench.reasons()
    bench.board.close()
    assert told is not None
    chosen = place == 1
    assert (told.gyro_chip == "MPU6500 (0x70)") is chosen
    assert (taken > 0) is chosen
    assert ("GYRO_BAD" in held) is not chosen


@pytest.mark.parametrize("level", sampled(range(4), 0, 3))
def test_the_level_of_the_brown_out_detector_is_told(board_image: Path, level: int) -> None:
    options = OptionBytes()
    options = replace(options, optcr=options.optcr & ~0xC | (3 - level) << 2)  # BOR_LEV, 3: off
    flash = read_flashable(board_image.with_suffix(".bin"))
    with closing(Board(flash, elf=board_image, options=options)) as board:
        assert board.hardware.flash.options.detects_brown_out is (level > 0)
        line = LineTransport(UartLine(board), board.run_to)
        board.run(0.5)
        told = read_overview(Client(line, line.clock)).flight
    assert told is not None and told.brown_out_level == level
    assert ("off" in brown_out(level)) is (level == 0)


@pytest.mark.parametrize(
    ("identity", "told"),
    [(0x19, "unknown chip (0x19)"), (0xFF, "no chip answers (0xFF)"), (0x00, "")],
)
def test_a_chip_that_is_not_known_is_told_by_its_number_and_forbids_arming(
    board_image: Path, identity: int, told: str
) -> None:
    flash = read_flashable(board_image.with_suffix(".bin"))
    bench = Bench(flash, board_image, replace(ICM20602, who_am_i=identity, trim=0x11))
    overview = read_overview(bench.client)
    bench.board.close()
    assert overview.flight is not None and overview.flight.gyro_chip == told
    hint = overview.arming_reasons["GYRO_BAD"]
    known = "ICM20602 (0x12)"
    assert (known in hint) is (identity == 0x19)
    assert "--gyro-file" not in hint


def test_a_bmi270_is_told_by_name_and_what_it_lacks(board_image: Path) -> None:
    bench = Bench(read_flashable(board_image.with_suffix(".bin")), board_image, BMI270)
    overview = read_overview(bench.client)
    hardware = bench.client.request(Msp.SENSOR_CONFIG_ACTIVE)[0]
    samples = bench.board.hardware.gyro.samples
    bench.board.close()
    assert overview.flight is not None and overview.flight.gyro_chip == "BMI270 (0x24)"
    assert "--gyro-file, bmi270_maximum_fifo.c" in overview.arming_reasons["GYRO_BAD"]
    assert (hardware, samples) == (APP_NUMBERS["BMI270"], 0)


@pytest.fixture(scope="module")
def flying(board_image: Path) -> Iterator[tuple[EmulatedPort, PortSnapshot]]:
    """An armed board at half throttle, without a turn."""
    port = EmulatedPort(board_image.with_suffix(".bin"))
    samples = turned(port, 1.2, np.zeros(3), armed=False, throttle=0.0)
    samples = turned(port, 0.1, np.zeros(3), armed=True, throttle=0.0, number=samples)
    turned(port, 0.1, np.zeros(3), armed=True, throttle=0.5, number=samples)
    yield port, port.save()
    port.close()


def turned(
    port: EmulatedPort, seconds: float, rate: np.ndarray, *, armed: bool, throttle: float, number: int = 0
) -> int:
    """Flies on with that rate measured; returns the number of the next sample."""
    rng = np.random.default_rng(number)
    channels = sticks.channels((0.0, 0.0, 0.0), throttle, armed=armed).tolist()
    for _ in range(round(seconds * port.gyro_rate_hz)):
        if number % 40 == 0:
            port.announce(channels, 16)
        now = channels if number % 40 == 16 else None
        gyro = rate + rng.normal(0.0, 0.01, 3)
        port.exchange(Sample(0.0, gyro, np.eye(3), np.zeros(3), np.zeros(3), LEVEL), now)
        number += 1
    return number


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("way", sampled([1, -1], -1))
def test_the_motors_that_turn_it_back_speed_up_when_it_turns(
    flying: tuple[EmulatedPort, PortSnapshot], axis: int, way: int
) -> None:
    """For a roll the motors on its side, for a falling nose those in front, for a yaw those that spin so."""
    port, moment = flying
    port.restore(moment)
    rate = np.zeros(3)
    rate[axis] = way * TURN
    calm = port.board.hardware.obeyed(MOTORS).astype(float)
    start = round((1.2 + 0.1 + 0.1) * port.gyro_rate_hz)
    turned(port, 0.01, rate, armed=True, throttle=0.5, number=start)
    change = port.board.hardware.obeyed(MOTORS) - calm
    rotors = load_aircraft("nf1").rotors
    sides = (
        [-np.sign(rotor.position[1]) for rotor in rotors],
        [np.sign(rotor.position[0]) for rotor in rotors],
        [rotor.spin for rotor in rotors],
    )[axis]
    assert calm.min() > 0
    assert way * float(change @ np.array(sides)) > 50
