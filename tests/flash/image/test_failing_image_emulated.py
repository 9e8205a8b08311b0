"""An image that fails its start, installed on the emulated board: it goes back, and the tool says so."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.flash.image.files import Image, ImageFile, Policy
from neuroflight.flash.image.trial import Ending
from neuroflight.sim.board.serial.idle_board import configured
from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    IMAGE_STARTS_MAX,
    bound_policy,
    image_header,
    policy_header,
)
from tests.firmware.board.banks import (
    LOOP,
    UNDEFINED,
    A,
    B,
    Build,
    Trial,
    bad_policy,
    patched,
    read_build,
)
from tests.flash.image.conftest import stamped
from tests.flash.image.emulated import BAUD, Wired

UP_S = 2.0


@pytest.fixture(scope="module")
def build(board_image: Path) -> Build:
    return read_build(board_image)


@pytest.fixture(scope="module")
def fast_flash(board_image: Path) -> bytes:
    """Of a board whose line is fast."""
    return configured(board_image.with_suffix(".bin").read_bytes(), board_image, {"msp_baud": BAUD})


@pytest.fixture
def trial(fast_flash: bytes, board_image: Path) -> Iterator[Trial]:
    made = Trial(fast_flash, board_image)
    made.until(lambda: made.bank == A, UP_S)
    made.run(0.5)
    yield made
    made.close()


def only_its_begin(build: Build) -> bytes:
    """It ends soon behind its first instruction, which it never leaves."""
    end = (build.symbols[B]["reset_handler"] & ~1) - FLASH_BANKS[B].address + 64
    return stamped(
        patched(build, B, "reset_handler", LOOP)[: end & ~3], image_bytes=struct.pack("<I", end & ~3)
    )


FAILING: dict[str, tuple[Callable[[Build], bytes], str]] = {
    "hangs at its first instruction": (only_its_begin, "was started 2 time(s) and did not come up"),
    "hangs in its boot": (
        lambda build: patched(build, B, "background_start", LOOP),
        "was started 2 time(s) and did not come up",
    ),
    "faults in its loop": (
        lambda build: patched(build, B, "msp_lines_serve", UNDEFINED),
        "was started 2 time(s) and did not come up",
    ),
    "its policy fails its self-test": (
        lambda build: build.images[B],
        "was started and failed",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAILING)
def test_the_old_image_flies_within_three_starts_and_the_tool_says_why(
    build: Build, trial: Trial, name: str
) -> None:
    make, why = FAILING[name]
    data = stamped(make(build), build=b"newbuild")
    header = image_header(data)
    assert header is not None
    bad = "policy" in name
    blob = bad_policy(build, b"newbuild") if bad else bound_policy(build.policy, b"newbuild")
    told = policy_header(blob)
    assert told is not None
    file = ImageFile(Path("new.nfi"), (Image(header, data),), Policy("new.nfi", told, blob))
    starts = trial.starts
    done = Wired(trial).install(file)
    assert done.trial.ending is Ending.WENT_BACK and done.kept is None
    assert f"the board went back to bank A, version 0.1.0: the new image {why}" in done.trial.why
    assert trial.bank == A
    assert trial.starts - starts <= IMAGE_STARTS_MAX + 1
    began = trial.starts
    trial.board.reset()
    trial.until(lambda: trial.bank is not None, UP_S)
    assert (trial.bank, trial.starts) == (A, began + 1), "and stays with it"
