"""Builds mutants with the project's own makefile, and flies them on the emulated board."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest

from neuroflight.flash.link.msp import encode, request
from neuroflight.sim.board.board import Board, Report
from neuroflight.sim.board.fitted import FULL_VOLTS, GYROS
from neuroflight.sim.board.peripherals.usart import SBUS, Format
from neuroflight.sim.control.sticks import channels
from neuroflight.sim.ports.receiver_frames import sbus_frame
from neuroflight.toolchain.contract import Msp
from neuroflight.toolchain.image.build import BOARD_FAMILY, find_target, run_make
from tests.conftest import ROOT
from tests.firmware.mutants.mutant import replaced, spaced
from tests.sim.board.mutants.mutant import Mutant

TARGET = find_target("MATEKF722")
MSP = Format(115_200)
MOTORS = 4
STEP_S = 0.0097  # no multiple of the control period: frames come at every phase of it
HEARD_S, ARM_S, THROTTLE_S, PID_S = 0.4, 3.45, 3.5, 3.55  # receiver on, armed, throttle and roll, PID


@dataclass(frozen=True)
class Flight:
    """What an image did."""

    report: Report
    values: list[int]  # DShot values that the motors obeyed at the end


Fly = Callable[[Mutant], Flight]


@pytest.fixture(scope="session")
def workshop(board_image: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[], Path]:
    """Puts the firmware, and all that make has made of it, into a folder that is always the same."""
    kept = tmp_path_factory.mktemp("firmware")
    shutil.copytree(ROOT / "firmware", kept / "firmware", ignore=shutil.ignore_patterns("generated"))
    built = board_image.parents[1] / BOARD_FAMILY
    shutil.copytree(built, kept / "build")
    folder = kept.with_name(f"{kept.name}-mutant")
    for dependencies in (kept / "build").rglob("*.d"):  # they name objects by where these were made
        text = dependencies.read_text().replace(str(built), str(folder / "build"))
        dependencies.write_text(text)

    def fresh() -> Path:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(kept, folder)
        return folder

    return fresh


@pytest.fixture
def build_mutant(workshop: Callable[[], Path]) -> Callable[[Mutant], Path]:
    """Compiles and links a mutant; its ELF."""

    def build(mutant: Mutant) -> Path:
        folder = workshop()
        mutate(folder / "firmware" / mutant.file, mutant)
        run_make(TARGET, folder, folder / "build", folder / "build" / "generated")
        return folder / "build" / "make" / "neuroflight.elf"

    return build


@pytest.fixture
def fly_mutant(build_mutant: Callable[[Mutant], Path]) -> Fly:
    """Builds a mutant and runs it. Raises BoardError."""
    return lambda mutant: fly(build_mutant(mutant), mutant)


def mutate(source: Path, mutant: Mutant) -> None:
    """Make the mistake in `source`. Fails when it no longer says what the mutant replaces."""
    text = source.read_text()
    found = spaced(text).count(spaced(mutant.old))
    if found != 1:
        pytest.fail(
            f"mutant {mutant.name}: {mutant.file} has {found} times {mutant.old!r}, expected once: "
            f"the source has changed, choose another place for the mistake"
        )
    source.write_text(replaced(text, mutant.old, mutant.new.lstrip()))  # the indentation before `old` stays


def fly(elf: Path, mutant: Mutant) -> Flight:
    """What the image did in `mutant.seconds`, on a board that is held in the hand: nearly still."""
    chip = GYROS[mutant.gyro].chip
    with closing(Board(elf.with_suffix(".bin").read_bytes(), elf=elf, chip=chip, dshot=600)) as board:
        gyro = board.hardware.gyro
        gyro.before_sample = lambda n: gyro.measure((0, 0, 2048), 333, (n // 2 % 3 - 1, 0, -(n // 2 % 2)))
        board.hardware.adc.set_battery(FULL_VOLTS, 0.0)
        for boot in range(mutant.boots):
            if boot:
                board.reset()
            _run(board, mutant)
        return Flight(board.report(), board.hardware.obeyed(MOTORS).tolist())


def _run(board: Board, mutant: Mutant) -> None:
    for step in range(round(mutant.seconds / STEP_S)):
        now = step * STEP_S
        if mutant.flown and now >= HEARD_S:
            throttle, roll = (0.3, 100.0) if now >= THROTTLE_S else (0.0, 0.0)
            sticks = channels((roll, 0.0, 0.0), throttle, armed=now >= ARM_S, pid=now >= PID_S)
            board.hardware.usarts["USART2"].feed(sbus_frame(sticks.tolist()), SBUS)
        if mutant.saves is not None and now <= mutant.saves < now + STEP_S:
            board.hardware.usarts["USART1"].feed(encode(request(Msp.EEPROM_WRITE)), MSP)
        board.run(STEP_S)
