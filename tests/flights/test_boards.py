"""One code on many boards: with its table each flies the host's bits, on an emulated board of its wiring."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.board.board import Board as Powered
from neuroflight.sim.board.fitted import GYROS, fitted_gyro
from neuroflight.sim.board.serial.idle_board import configured
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.boards.allocation import Allocation, allocate
from neuroflight.toolchain.boards.description import pack
from neuroflight.toolchain.boards.facts import Board, Pin, Turn
from neuroflight.toolchain.boards.processor import Stream
from neuroflight.toolchain.boards.table import boards, find_board
from neuroflight.toolchain.boards.verdict import judge
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.image.elf import read_flashable
from neuroflight.toolchain.image.stamp import stamp
from tests.flights.wiring import on_turned_board
from tests.sampling import sampled

Flown = Callable[..., Trace]
Stamped = Callable[[Board], Path]

MOTORS = 4
# A board of each layout of motors, place of the gyro, mounting and line that the public table has.
CLASSES = {
    "MATEKF722": "motors on ports C, B, A; CW180; a card",
    "KAKUTEF7MINIV3": "motors on one port, B; CW270",
    "FF_RACEPITF7_MINI": "four motors on one port",
    "DOLPHINRC_F722": "motors on PC6 to PC9; CW90",
    "MAMBAF722_X8": "motors 3 and 4 on TIM1's pins PA8 and PA9; three ports; no supply pin of USB",
    "SPEEDYBEEF7V2": "motors 1 to 3 on PA8 to PA10, so that UART1 is elsewhere",
    "AOCODARCF7DUAL": "gyro on SPI2",
    "ZEEZF7": "gyro on SPI2, on the underside",
    "LUXAIO": "gyro on SPI2, on the underside and turned",
    "APEXF7": "gyro on SPI3, receiver on another UART",
    "GEPRCF722": "gyro on SPI3, motors on one port",
    "HGLRCF722": "CW180 on the underside; a flash chip",
    "RUSHCORE7": "CW270 on the underside",
    "FLYCOLORF7V2": "motors on three ports, receiver on another UART",
    "NERO": "motors on ports A, B, C; a card; receiver and MSP on other UARTs",
    "FOXEERF722V4": "motors on PA9, PA8, PC9, PC8",
    "OMNINXT7": "no data-ready line",
    "SKYSTARSF7HD": "turned by its maker: roll 180, yaw 90",
    "AOCODARCF722_AIO": "turned by its maker: yaw 135",
}


def part() -> Scenario:
    """Both controllers, each axis and some throttle in 0.4 s."""
    rates = ((300.0, 0.0, 0.0), (0.0, -200.0, 100.0), (-100.0, 150.0, -50.0), (0.0, 0.0, 0.0))
    return Scenario("a part", tuple(Segment(0.1, rate, 0.15 * k, pid=k == 2) for k, rate in enumerate(rates)))


def arming() -> Scenario:
    return Scenario(
        "half a second", (Segment(0.25, (100.0, -100.0, 50.0), 0.3), Segment(0.25, (0.0,) * 3, 0.1))
    )


@pytest.fixture
def stamped(board_image: Path, tmp_path: Path) -> Stamped:
    """Makes a board's image from the one that is linked."""

    def make(board: Board) -> Path:
        elf = tmp_path / f"{board.name}.elf"
        stamp(board_image, pack(allocate(board)), elf)
        return flat(elf)

    return make


def flat(elf: Path) -> Path:
    """What goes into flash of an ELF, as a file beside it."""
    out = elf.with_suffix(".bin")
    command = ["arm-none-eabi-objcopy", "-O", "binary", "--gap-fill", "0xFF", str(elf), str(out)]
    subprocess.run(command, check=True)
    return out


@pytest.mark.parametrize("name", sampled(list(CLASSES), "LUXAIO"))
def test_the_code_flies_the_bits_of_the_host_program_on_a_board_of_each_class(
    stamped: Stamped, reference_library: Path, flown: Flown, name: str
) -> None:
    board = find_board(name)
    on_board = flown(EmulatedPort(stamped(board)), part())
    assert np.ptp(on_board.dshot, axis=0).min() > 300  # every motor has something to do
    assert flown(on_host(reference_library, board.turn_deg), part()).same(on_board)


def on_host(library: Path, turn: Turn) -> ReferencePort:
    """The library, its chip mounted as on the board: the maker's turn is told it by the pilot's settings."""
    turns = dict(zip(("board_roll_deg", "board_pitch_deg", "board_yaw_deg"), turn, strict=True))
    return on_turned_board(ReferencePort(library, settings=turns), turn)


@pytest.mark.slow
@pytest.mark.parametrize("name", sampled([b.name for b in boards().values() if any(b.turn_deg)], "RUSHF7AIO"))
def test_the_aircraft_does_as_it_is_told_when_its_maker_turns_the_board(
    board_image: Path, stamped: Stamped, tmp_path: Path, reference_library: Path, flown: Flown, name: str
) -> None:
    """It flies as one with a board that is not turned; and not so where the table has the other sign."""
    board, wrong = find_board(name), tmp_path / "wrong.elf"
    roll, pitch, yaw = board.turn_deg
    stamp(board_image, pack(allocate(replace(board, turn_deg=(roll, pitch, -yaw)))), wrong)
    straight = flown(ReferencePort(reference_library), part())
    right, other = (
        flown(EmulatedPort(image, wiring=board), part()) for image in (stamped(board), flat(wrong))
    )
    assert flown(on_host(reference_library, board.turn_deg), part()).same(right)
    apart = [np.degrees(np.abs(flight.rate - straight.rate).mean()) for flight in (right, other)]
    print(f"{name}: {apart[0]:.2f} deg/s off a straight board's flight, with the other sign {apart[1]:.0f}")
    assert apart[0] < 2 and apart[1] > 40


def supported() -> list[Board]:
    """All boards that the firmware flies on, and that have a motor output for each of the policy's."""
    verdicts = map(judge, boards().values())
    flown = [verdict.board for verdict in verdicts if not verdict.fault and not verdict.file]
    return [board for board in flown if len(board.motors) >= MOTORS]


@pytest.fixture(scope="module")
def on_library(reference_library: Path, flown: Flown) -> Callable[[Turn], Trace]:
    """Flies the library on a board that is so turned, once for each turn."""
    return cache(lambda turn: flown(on_host(reference_library, turn), arming()))


@pytest.mark.slow
@pytest.mark.parametrize("name", [board.name for board in supported()])
def test_the_code_arms_and_flies_the_same_bits_on_every_board(
    stamped: Stamped, on_library: Callable[[Turn], Trace], flown: Flown, name: str
) -> None:
    board = find_board(name)
    kinds = [kind.lower() for kind in board.gyro_kinds if kind.lower() in GYROS and kind != "BMI270"]
    exact = next((kind for kind in kinds if not kind.startswith("lsm")), None)  # those count in other steps
    gyro = fitted_gyro(board, kind=exact)
    on_board = flown(EmulatedPort(stamped(board), gyro=gyro), arming())
    expected = on_library(board.turn_deg)
    assert np.ptp(on_board.dshot, axis=0).min() > 100
    assert on_board.same(expected) if exact else np.abs(on_board.gyro - expected.gyro).max() < 0.01


def with_two_gyros() -> list[str]:
    """The boards whose second gyro can be chosen."""
    served = [allocation for board in supported() if (allocation := judge(board).allocation)]
    return [one.board.name for one in served if one.gyros[1:] and one.gyros[1].spi != 0]


@pytest.mark.slow
@pytest.mark.parametrize("name", sampled(with_two_gyros(), "ALIENFLIGHTNGF7_DUAL"))  # on a bus of its own
def test_the_second_gyro_of_a_board_is_read_when_it_is_chosen(stamped: Stamped, name: str) -> None:
    board, image = find_board(name), stamped(find_board(name))
    elf, gyro = image.with_suffix(".elf"), fitted_gyro(board, place=1)
    flash = configured(read_flashable(image), elf, {"gyro_select": 1.0}, fitted_gyro(board), board)
    with closing(Powered(flash, elf=elf, board=board, chip=gyro.chip, gyro_place=1)) as powered:
        powered.run(0.5)
        assert powered.hardware.gyro.samples > 400


# ---- tables that do not fit the board ----

WRONG: dict[str, tuple[Callable[[Allocation], Allocation], str]] = {
    "request of a bus": (
        lambda told: replace(told, streams={**told.streams, "SPI1_RX": Stream(2, 2, 4)}),
        "DMA2 stream 2: channel 4 is driven by USART1_RX, but its peripheral address is SPI1_DR; expected",
    ),
    "request of a motors' port": (
        lambda told: replace(told, ports=(replace(told.ports[0], stream=Stream(2, 6, 5)), *told.ports[1:])),
        "DMA2 stream 6: channel 5 is driven by USART6_TX, but its peripheral address is GPIOC_BSRR; expected",
    ),
    "bus of the gyro": (
        lambda told: replace(told, gyros=(replace(told.gyros[0], spi=3), *told.gyros[1:])),
        "reads no gyro sample|the firmware",
    ),
    "pin of the battery": (
        lambda told: replace(told, volts=Pin("C", 3)),
        "ADC1 converts channel 13, but the board leads ADC1_IN13 to no pin",
    ),
    "UART of the receiver": (lambda told: allocate(told.board, 5), "arm"),
}


def restamped(board_image: Path, told: Allocation, folder: Path) -> Path:
    """The image with the table of `told`."""
    elf = folder / "wrong.elf"
    stamp(board_image, pack(told), elf)
    return flat(elf)


@pytest.mark.parametrize("name", sampled(list(WRONG), "request of a motors' port"))
def test_an_image_fails_when_its_table_is_not_the_boards(
    board_image: Path, tmp_path: Path, flown: Flown, name: str
) -> None:
    change, message = WRONG[name]
    image = restamped(board_image, change(allocate(find_board("MATEKF722"))), tmp_path)
    with pytest.raises(LinkError, match=message):
        flown(EmulatedPort(image, receiver=2), part())  # wired to where it belongs


@pytest.mark.slow
def test_a_motor_stands_when_the_table_has_another_pin_for_it(
    board_image: Path, tmp_path: Path, flown: Flown
) -> None:
    told = allocate(find_board("MATEKF722"))
    image = restamped(board_image, replace(told, motors=(Pin("C", 12), *told.motors[1:])), tmp_path)
    on_board = flown(EmulatedPort(image), arming())
    assert not on_board.dshot[:, 0].any() and on_board.dshot[:, 1:].all()
