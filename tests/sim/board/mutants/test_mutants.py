"""The real firmware with one mistake each: the emulated board names all of them, and where they were made."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.toolchain.contract import DSHOT_MIN
from tests.conftest import ROOT
from tests.firmware.mutants.mutant import spaced
from tests.sampling import sampled
from tests.sim.board.mutants.bus_mutants import BUS_MUTANTS
from tests.sim.board.mutants.clock_mutants import CLOCK_MUTANTS
from tests.sim.board.mutants.core_mutants import CORE_MUTANTS
from tests.sim.board.mutants.gyro_mutants import GYRO_MUTANTS
from tests.sim.board.mutants.mutant import Mutant

if TYPE_CHECKING:
    from tests.sim.board.mutants.conftest import Fly

MUTANTS = (*CLOCK_MUTANTS, *BUS_MUTANTS, *GYRO_MUTANTS, *CORE_MUTANTS)
UNCHANGED = Mutant(
    name="none",
    file="src/runtime.c",
    old="void runtime_sample(",
    new="void runtime_sample(",
    message="",
)


@pytest.mark.parametrize(
    "mutant",
    [
        pytest.param(m, id=m.name.replace(" ", "-"), marks=[] if m.ordinary else [pytest.mark.slow])
        for m in MUTANTS
    ],
)
def test_mistake_is_named_when_the_firmware_makes_it(fly_mutant: Fly, mutant: Mutant) -> None:
    with pytest.raises(BoardError, match=mutant.message) as caught:
        fly_mutant(mutant)
    if mutant.place:
        assert re.search(rf"in {mutant.place}\+0x\w+ \(", str(caught.value)), caught.value


@pytest.mark.slow
def test_firmware_flies_when_it_is_built_and_flown_as_mutants_are(fly_mutant: Fly) -> None:
    flight = fly_mutant(replace(UNCHANGED, seconds=3.8, flown=True))
    assert flight.report.resets == ("power",)
    assert min(flight.values) >= DSHOT_MIN


@pytest.mark.slow
@pytest.mark.parametrize("controller", sampled(["CONTROLLER_POLICY", "CONTROLLER_PID"], "CONTROLLER_POLICY"))
def test_firmware_does_not_arm_when_a_controller_takes_longer_than_a_sample(
    fly_mutant: Fly, controller: str
) -> None:
    """Before arming none runs: what they take is measured at boot."""
    begin = "\tcontrol_mix(control, input->throttle, output);\n\tcontrol_hand_over("
    slow = (
        f"\tfor (volatile unsigned i = 0; control->flying == {controller} && i < 12000u; ++i)\n\t\t;\n{begin}"
    )
    flight = fly_mutant(
        replace(UNCHANGED, file="src/control/control.c", old=begin, new=slow, seconds=3.8, flown=True)
    )
    assert flight.report.resets == ("power",)
    assert not any(flight.values)


@pytest.mark.slow
def test_firmware_saves_its_settings_when_it_is_built_and_asked_as_mutants_are(fly_mutant: Fly) -> None:
    report = fly_mutant(replace(UNCHANGED, seconds=0.8, saves=0.5, boots=2)).report
    assert report.resets == ("power", "power")
    assert report.flash_operations > 2 * 50  # settings; the log of boots takes 25 of each


@pytest.mark.slow
def test_line_is_noted_when_the_firmware_listens_at_another_baud(fly_mutant: Fly) -> None:
    """No error: a receiver of another kind may be plugged in. The firmware does not arm."""
    wrong = Mutant(
        name="receiver's line at another baud",
        file="hal/stm32f7/devices/receiver_line.c",
        old=".baud = 100000,",
        new=".baud = 115200,",
        message="",
        seconds=3.8,
        flown=True,
    )
    flight = fly_mutant(wrong)
    (note,) = flight.report.notes
    assert note.message == (
        "USART2 listens at 115139 baud 8E2 inverted, but is sent 100000 baud 8E2 inverted"
    )
    assert note.times > 25
    assert not any(flight.values)


def test_image_is_the_same_when_it_is_built_as_mutants_are(
    build_mutant: Callable[[Mutant], Path], board_image: Path
) -> None:
    assert build_mutant(UNCHANGED).with_suffix(".bin").read_bytes() == (
        board_image.with_suffix(".bin").read_bytes()
    )


def test_mistakes_have_their_places_in_the_sources_of_today() -> None:
    files = {m.file: spaced((ROOT / "firmware" / m.file).read_text()) for m in MUTANTS}
    stale = [m.name for m in MUTANTS if files[m.file].count(spaced(m.old)) != 1]
    assert not stale, "choose other places for these mistakes"


@pytest.mark.slow
def test_firmware_flies_when_its_barriers_order_memory_alone(fly_mutant: Fly) -> None:
    """A DMB is enough before a DMA stream starts."""
    lesser = Mutant(
        name="DMB for DSB",
        file="hal/stm32f7/core/core.h",
        old='__asm volatile("dsb" :::',
        new='__asm volatile("dmb" :::',
        message="",
        seconds=1.8,
        flown=True,
    )
    assert min(fly_mutant(lesser).values) >= DSHOT_MIN
