"""An emulated board at the end of a fast line, for programs that install images on it in lockstep."""

from __future__ import annotations

from typing import Protocol

from neuroflight.flash.image.board import check_ready, read_board
from neuroflight.flash.image.files import ImageFile
from neuroflight.flash.image.install import Installation, Installed
from neuroflight.flash.image.plan import plan_install
from neuroflight.flash.image.settings_kept import read_settings
from neuroflight.flash.link.client import Client
from neuroflight.flash.policy import swap as swaps
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import LineTransport, UartLine

BAUD = 921_600


class Powered(Protocol):
    """A board that has what it measures, such as an IdleBoard."""

    board: Board

    def run_to(self, cycle: int) -> None:
        """Let it run."""


class Wired:
    """A board's MSP line and the time on it."""

    def __init__(self, powered: Powered, baud: int = BAUD) -> None:
        self.powered, self.baud = powered, baud

    @property
    def seconds(self) -> float:
        """The board's time."""
        return self.powered.board.cycle / TIME_HZ

    def sleep(self, seconds: float) -> None:
        """Let so much of it pass."""
        self.powered.run_to(self.powered.board.cycle + round(seconds * TIME_HZ))

    def transport(self) -> LineTransport:
        """Of a new client."""
        return LineTransport(UartLine(self.powered.board, format=Format(self.baud)), self.powered.run_to)

    def client(self) -> Client:
        """On the other end of the line."""
        transport = self.transport()
        return Client(transport, transport.clock)

    def for_swaps(self) -> swaps.Board:
        """As policies are swapped over it."""
        return swaps.Board(self.transport, lambda: self.seconds, self.sleep)

    def install(self, file: ImageFile) -> Installed:
        """An image over the line, as the command does it: asked, planned, written, switched, proven."""
        client = self.client()
        state = read_board(client)
        check_ready(state)
        plan = plan_install(state, file)
        settings = read_settings(client)
        installation = Installation(
            client, plan, self.transport, lambda *step: None, lambda: self.seconds, self.sleep
        )
        try:
            done = installation.run(settings)
            assert done is not None
            return done
        finally:
            installation.client.close()
