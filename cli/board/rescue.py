"""`neuroflight board rescue`: first installation, and a board out of reach, by its chip's ROM."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.board.built import built_image
from neuroflight.cli.board.checked import Unchecked, checked_image
from neuroflight.cli.board.dfu import find_rescue_port
from neuroflight.cli.board.state import connect
from neuroflight.cli.options import Json
from neuroflight.cli.progress import step_bars
from neuroflight.cli.questions import confirm
from neuroflight.cli.report import Account
from neuroflight.cli.requests import Argument, Option, Request
from neuroflight.toolchain.contract import (
    FLASH_BANK_A,
    FLASH_BANK_B,
    FLASH_BOOT,
    FLASH_FAULT_RECORD,
    FLASH_POLICY_SLOTS,
    FLASH_SECTORS,
    FLASH_SETTINGS,
)
from neuroflight.toolchain.errors import BuildError, LinkError, PolicyError

if TYPE_CHECKING:
    from neuroflight.flash.rom.rescue import FlashPlan, Progress, Rom

BAUD_MIN, BAUD_MAX = 1200, 115_200  # AN3155: what the ROM measures
WORDS = {"erase": "erasing", "write": "writing", "verify": "comparing"}
RUNS = "start  the image runs; let BOOT go, and plug the board out and in once"
BACK = "start  the image runs, and the board is back: {}"
WAITS = "start  let BOOT go, and plug the board out and in: the image starts then"
# The brown-out level is left to another tool: the same word of the chip can lock it.
BROWN_OUT = (
    "option brown-out detector: `board status` tells it; see docs/guides/board-bring-up.md,\n"
    "       hold BOOT again, plug in by USB: STM32_Programmer_CLI -c port=usb1 -ob BOR_LEV=0 sets level 3"
)
PURPOSES = (
    *((FLASH_BOOT, "boot part"), (FLASH_BANK_A, "bank A"), (FLASH_BANK_B, "bank B")),
    *((sector, "settings") for sector in FLASH_SETTINGS),
    (FLASH_FAULT_RECORD, "fault log"),
    *((slot, "policy slot") for slot in FLASH_POLICY_SLOTS),
)


@dataclass(frozen=True, kw_only=True)
class Rescue(Request):
    """A request to flash an image by the boot loader in the chip's ROM."""

    port: Annotated[
        str,
        Option(
            "PORT",
            "dfu: the board in its ROM's USB boot loader, dfu:BUS-PORT where there are several; a board's "
            "USB serial port: its firmware, of any make, is asked to start that; or the adapter on UART1, "
            "such as /dev/ttyUSB0, serial:/dev/ttyUSB0:57600, tcp:HOST:PORT; default: NEUROFLIGHT_PORT, or "
            "the only one that is there",
            find=find_rescue_port,
        ),
    ]
    image: Annotated[
        Path | None,
        Argument(
            "IMAGE",
            "a build's neuroflight.hex, .bin or .elf; default: that of the only board that was built for",
        ),
    ] = None
    dry_run: Annotated[bool, Option(None, "find the chip, print the plan, write nothing")] = False
    unchecked: Unchecked = False
    all: Annotated[bool, Option(None, "erase bank B as well: no other image is left to fall back to")] = False
    verify_only: Annotated[bool, Option(None, "compare flash with the image, write nothing")] = False
    yes: Annotated[bool, Option(None, "replace a firmware of another make without asking")] = False
    json: Json = False

    def run(self) -> int:
        """Flash by the ROM. Returns 0; raises LinkError of one line that says what was not written."""
        from neuroflight.flash.link.transport import open_transport
        from neuroflight.flash.rom.client import RomClient
        from neuroflight.flash.rom.dfu_board import board_ports, is_dfu, open_dfu, port_back
        from neuroflight.flash.rom.image_check import check_image
        from neuroflight.flash.rom.rescue import plan_flash, start, verify
        from neuroflight.flash.rom.segments import read_segments

        baud = _baud(self.port)
        try:
            image = self.image or built_image("neuroflight.hex")
        except BuildError as error:
            raise BuildError(f"{error}; nothing was written") from None
        segments = read_segments(image)
        try:
            facts = check_image(segments)
        except LinkError as error:
            raise LinkError(f"{image}: {error}") from None
        unchecked = self.unchecked or self.dry_run or self.verify_only
        try:
            check = checked_image(image, facts.policy.policy_sha256, unchecked=unchecked)
        except PolicyError as error:
            raise PolicyError(f"{error}; nothing was written") from error
        plan = plan_flash(segments, erase_bank_b=self.all)
        told = Account(self.json)
        port = self._enter(told, facts.board)
        before = board_ports()
        with open_dfu(port) if is_dfu(port) else RomClient(open_transport(port, "E")) as client:
            chip = client.connect()
            told.say(f"chip   {chip}, boot loader in its ROM, on {client.name}")
            _tell(told, f"{image}, {facts}", plan, baud, check)
            document = {
                "chip": chip.product_id,
                "image": str(image),
                "bytes": plan.bytes,
                "check": check,
                "erase": [_purpose(sector) for sector in plan.sectors],
                "result": "nothing written" if self.dry_run else "equal" if self.verify_only else "written",
            }
            if self.dry_run:
                return told.end(document, "nothing was written")
            if not self.verify_only:
                told.say("safety propellers off: the image starts when it is written")
            with step_bars(WORDS) as progress:
                if self.verify_only:
                    verify(client, plan, progress)
                else:
                    _install(client, plan, progress)
            if self.verify_only:
                if port != self.port:  # a firmware ran, and does again
                    start(client)
                return told.end(document, f"equal  {plan.bytes:,} bytes; nothing was written")
            repeated = f", {client.repeated} commands repeated" if client.repeated else ""
            told.say(f"done   {plan.bytes:,} bytes written and read back equal{repeated}")
            document["started"] = start(client)
        back = port_back(before) if is_dfu(port) and document["started"] else None
        told.say(BACK.format(back) if back else RUNS if document["started"] else WAITS)
        return told.end(document, BROWN_OUT)

    def _enter(self, told: Account, board: str) -> str:
        """Return the port of the ROM, after asking the firmware that runs on the board to start it.

        board: that the image is for. Raises LinkError for a firmware of another one, and unless the pilot
        wants one of another make replaced.
        """
        from neuroflight.flash.rom.dfu_board import check_board, into_dfu, read_running, runs_firmware

        if not runs_firmware(self.port):
            return self.port
        client = connect(self.port)
        try:
            running = read_running(client)
            check_board(client, running, board)
            told.say(f"board  {running.text}, on {client.name}")
            if self.dry_run:
                raise LinkError(
                    f"{client.name}: a firmware runs there, which --dry-run does not end; leave that out, or "
                    f"plug the board in with BOOT held; nothing was written"
                )
            if not running.ours and not self.verify_only:
                confirm(self.yes, f"replace {running.text} with Neuroflight", "nothing was written")
        except BaseException:
            client.close()
            raise
        told.say("enter  the firmware starts the boot loader in the chip's ROM")
        return into_dfu(client)


def _install(client: Rom, plan: FlashPlan, progress: Progress) -> None:
    from neuroflight.flash.rom.rescue import install

    try:
        install(client, plan, progress)
    except KeyboardInterrupt:
        raise LinkError(
            f"{client.name}: stopped by Ctrl-C before the image was whole: the board does not start before "
            f"this is done again"
        ) from None


def _tell(told: Account, image: str, plan: FlashPlan, baud: float | None, check: str) -> None:
    told.say(f"image  {image}, {plan.bytes:,} bytes")
    told.say(f"check  {check}")
    told.say(f"erase  {'; '.join(f'sector {n} ({_purpose(n)})' for n in plan.sectors)}")
    told.say(f"keep   {'; '.join(f'sector {n} ({_purpose(n)})' for n in plan.kept)}")
    by = "by USB" if baud is None else f"at {baud:.0f} baud"
    told.say(f"takes  about {plan.seconds(baud):.0f} s {by}")


def _purpose(number: int) -> str:
    """Return the purpose of a sector."""
    sector = FLASH_SECTORS[number]
    return next((what for place, what in PURPOSES if place.address == sector.address), "unused")


def _baud(port: str) -> int | None:
    """Return the speed of the line, None for USB. Raises LinkError for one that the ROM does not measure."""
    from neuroflight.flash.link.transport import SerialPort, parse_port
    from neuroflight.flash.rom.dfu_board import is_dfu, runs_firmware

    if is_dfu(port) or runs_firmware(port):
        return None
    parsed = parse_port(port)
    baud = parsed.baud if isinstance(parsed, SerialPort) else BAUD_MAX
    if not BAUD_MIN <= baud <= BAUD_MAX:
        raise LinkError(
            f"{port}: got {baud} baud, expected {BAUD_MIN} to {BAUD_MAX}, what the boot loader in the ROM "
            f"measures; nothing was written"
        )
    return baud
