"""From an erased chip to a flight: the ROM, a second image and a policy over the line, all on one board."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.cli.board.policy import candidate_of
from neuroflight.flash.board.info import read_info
from neuroflight.flash.image.board import read_board
from neuroflight.flash.image.files import image_for, read_images
from neuroflight.flash.image.trial import Ending
from neuroflight.flash.image.update import hash_of
from neuroflight.flash.link.messages import PolicySource
from neuroflight.flash.policy import swap as swaps
from neuroflight.flash.rom import rescue
from neuroflight.flash.rom.segments import read_segments
from neuroflight.flash.settings.values import Settings
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.contract import FLASH_BASE, IMAGE_PROBATION_MS, MSP_BAUD_DEFAULT
from neuroflight.toolchain.image.elf import read_flashable
from tests.conftest import BUILD, build_beside
from tests.flash.image.emulated import BAUD, Wired
from tests.flash.policy.policies import another_policy
from tests.flash.rom.conftest import Rig

IMAGE_S, SWAP_S = 30.0, 5.0  # what an image and a policy may take of the board's time, restarts included
A, B = range(2)
FLIGHT = Scenario(
    "cycle", tuple(Segment(0.1, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.1 * k) for k in range(6))
)


@pytest.fixture(scope="module")
def second_image(shipped_policy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ELF of another build, for bank A: its policy is another."""
    policy = another_policy(shipped_policy, tmp_path_factory.mktemp("second") / "second.onnx", seed=11)
    table = pid_table(load_aircraft("nf1"))
    return build_beside("MATEKF722", policy, BUILD / "second", table) / "neuroflight.elf"


@pytest.fixture
def chip() -> Iterator[IdleBoard]:
    """An erased one whose BOOT button is held as it gets its power."""
    idle = IdleBoard(b"", boot_button=True, newly_installed=True)
    idle.boot()
    assert idle.board.hardware.rom.runs
    yield idle
    idle.close()


def install_by_rom(chip: IdleBoard, image: Path) -> None:
    """Then the button is released and the plug pulled once."""
    with Rig(chip).client() as client:
        client.connect()
        rescue.install(client, rescue.plan_flash(read_segments(image.with_suffix(".hex"))))
    chip.board.hold_boot_button(False)
    chip.board.reset()
    chip.boot()


def start_with(chip: IdleBoard, image: Path) -> None:
    """The same but for the ROM: the image lies in erased flash."""
    chip.board.engine.set_memory(FLASH_BASE, read_flashable(image.with_suffix(".bin")))
    chip.board.hold_boot_button(False)
    chip.board.reset()
    chip.boot()


def store(wired: Wired, name: str, value: float) -> None:
    """A setting that is flown from the next power-up on."""
    with wired.client() as client:
        settings = Settings(client)
        settings.set(name, value)
        settings.save()
    wired.powered.board.reset()
    assert isinstance(wired.powered, IdleBoard)
    wired.powered.boot()


def check_proves_itself(wired: Wired) -> None:
    """An image that the ROM installed is on probation; then it has a number and is kept."""
    with wired.client() as client:
        before = read_board(client).banks
        assert (before.running, before.now.installed, before.now.confirmed) == (A, True, False)
        assert "PROBATION" in read_info(client).arming_reasons
        wired.sleep(IMAGE_PROBATION_MS / 1000 + 0.5)
        after = read_board(client).banks
        assert after.now.confirmed and after.now.numbered and after.now.sequence == 1
        assert not after.banks[B].fits
        assert "PROBATION" not in read_info(client).arming_reasons


def swap(wired: Wired, policy: Path) -> float:
    """A policy into a slot and a start with it. Returns how long that took."""
    began, candidate = wired.seconds, candidate_of(policy)
    client, place = swaps.write(wired.client(), candidate, wired.for_swaps(), lambda done, total: None)
    assert place.source is PolicySource.SLOT_A
    swaps.start(client, candidate, place, wired.for_swaps()).close()
    return wired.seconds - began


@pytest.mark.slow
@pytest.mark.parametrize("by_rom", [False, True])
def test_an_erased_chip_becomes_a_board_that_flies_a_second_image_with_a_swapped_policy(
    by_rom: bool,
    chip: IdleBoard,
    board_image: Path,
    second_image: Path,
    shipped_policy: Path,
    reference_library: Path,
    flown: Callable[..., Trace],
    tmp_path: Path,
) -> None:
    if by_rom:
        install_by_rom(chip, board_image)
    else:  # which test_rescue.py sees the ROM make of it
        start_with(chip, board_image)
    factory = Wired(chip, MSP_BAUD_DEFAULT)
    check_proves_itself(factory)
    store(factory, "msp_baud", BAUD)
    wired = Wired(chip)

    file, began = read_images(second_image.with_suffix(".nfi")), wired.seconds
    installed = wired.install(file)
    image_s = wired.seconds - began
    print(f"an image: {image_s:.2f} s of emulated time")
    assert (installed.trial.ending, image_s < IMAGE_S) == (Ending.KEPT, True)
    with wired.client() as client:
        banks = read_board(client).banks
        assert (banks.running, banks.now.build, banks.now.sequence) == (B, file.build, 2)
        assert hash_of(client, B, lambda: wired.seconds) == image_for(file, B)[0].sha256
        info = read_info(client)
        assert info.policy is not None and info.policy.sha256 != candidate_of(shipped_policy).sha256

    swap_s = swap(wired, shipped_policy)
    print(f"a policy: {swap_s:.2f} s of emulated time")
    assert swap_s < SWAP_S

    store(wired, "msp_baud", MSP_BAUD_DEFAULT)  # which the port below talks at
    image = tmp_path / "chip.bin"
    image.write_bytes(chip.flash())
    shutil.copy(second_image.with_name("neuroflight-b.elf"), image.with_suffix(".elf"))
    on_board = flown(EmulatedPort(image), FLIGHT)
    assert (on_board.dshot > 0).all()
    assert on_board.same(flown(ReferencePort(reference_library), FLIGHT))
