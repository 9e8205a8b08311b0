"""An image goes over the emulated board's UART into its spare bank; it proves itself or gives way."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from neuroflight.flash.image.board import read_board
from neuroflight.flash.image.files import Image, ImageFile, Policy
from neuroflight.flash.image.install import Installation, Installed
from neuroflight.flash.image.plan import InstallPlan, plan_install
from neuroflight.flash.image.settings_kept import read_settings
from neuroflight.flash.image.trial import Ending
from neuroflight.flash.link.client import Client
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import LineTransport, UartLine
from neuroflight.sim.board.serial.idle_board import IdleBoard, configured
from neuroflight.toolchain.contract import FLASH_BANK_B, image_header
from tests.flash.image.conftest import board_images as board_images
from tests.flash.image.conftest import board_policy as board_policy
from tests.flash.image.conftest import policy_of_build, stamped

pytestmark = pytest.mark.slow
BAUD = 921_600
LOOP = b"\xfe\xe7"  # b .


class FlashedBoard:
    """A board at rest whose line runs at BAUD, and what is flashed onto it."""

    def __init__(self, idle: IdleBoard) -> None:
        self.idle = idle
        self.line = LineTransport(UartLine(idle.board, format=Format(BAUD)), idle.run_to)
        self.plan: InstallPlan | None = None

    def flash(self, file: ImageFile) -> tuple[Installed, float]:
        """How it ended, and after how many seconds of the board's time."""
        client = Client(self.line, self.line.clock)
        begun = self.line.clock()
        self.plan = plan_install(read_board(client), file)
        installation = Installation(
            client, self.plan, lambda: self.line, lambda what, done, total: None, self.line.clock, self._sleep
        )
        done = installation.run(read_settings(client))
        assert done is not None
        return done, self.line.clock() - begun

    def _sleep(self, seconds: float) -> None:
        self.idle.run_to(self.idle.board.cycle + round(seconds * TIME_HZ))


@pytest.fixture
def board(board_image: Path) -> Iterator[FlashedBoard]:
    flash = configured(board_image.with_suffix(".bin").read_bytes(), board_image, {"msp_baud": BAUD})
    idle = IdleBoard(flash, watchdog_resets=True)
    idle.boot()
    yield FlashedBoard(idle)
    idle.close()


def build_of(images: list[bytes], policy: Policy, build: bytes) -> ImageFile:
    """The images as those of another build."""
    made = []
    for image in images:
        data = stamped(image, build=build)
        header = image_header(data)
        assert header is not None
        made.append(Image(header, data))
    return ImageFile(Path(f"{build.decode()}.nfi"), tuple(made), policy_of_build(policy, build))


def test_a_second_image_runs_within_30_s_and_a_third_goes_back_into_bank_a(
    board: FlashedBoard, board_images: list[bytes], board_policy: Policy
) -> None:
    for build, bank in ((b"second__", 1), (b"third___", 0)):
        file = build_of(board_images, board_policy, build)
        done, seconds = board.flash(file)
        assert done.trial.ending is Ending.KEPT, done.trial.why
        assert done.kept is not None and done.kept.lines == [] and done.restarts == 1
        assert seconds < 30.0
        assert board.plan is not None and board.plan.bank == bank
        assert 0.5 * board.plan.seconds(BAUD) < seconds < 1.2 * board.plan.seconds(BAUD)


def test_the_tool_says_so_when_an_image_never_starts_and_the_board_has_gone_back(
    board: FlashedBoard, board_images: list[bytes], board_policy: Policy
) -> None:
    (reset,) = struct.unpack_from("<I", board_images[1], 4)
    at = (reset & ~1) - FLASH_BANK_B.address
    stuck = board_images[1][:at] + LOOP + board_images[1][at + 2 :]
    done, _ = board.flash(build_of([board_images[0], stuck], board_policy, b"stuck___"))
    assert done.trial.ending is Ending.WENT_BACK
    assert (
        "the board went back to bank A, version 0.1.0: the new image was started 2 time(s)" in done.trial.why
    )
    good, _ = board.flash(build_of(board_images, board_policy, b"good____"))
    assert good.trial.ending is Ending.KEPT
