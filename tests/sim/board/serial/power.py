"""A board at the end of a fast line, whose power goes in the middle of a flash operation."""

from __future__ import annotations

from neuroflight.flash.link.msp import Decoder, Message, encode, request
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from neuroflight.sim.board.peripherals.flash import Cut
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.toolchain.contract import Msp
from tests.flash.image.emulated import Wired

EXCHANGE_S = 3.0  # of a request: more than an erase and a restart
STEP = TIME_HZ // 10_000
SHOWN = frozenset({"POLICY_BAD", "FAULT"})  # arming reasons of a board that has lost something


class PowerBench:
    """An idle board, asked frame by frame."""

    def __init__(self, idle: IdleBoard) -> None:
        self.idle, self.wired = idle, Wired(idle)
        self.engine, self.flash = idle.board.engine, idle.board.hardware.flash

    def frame(self, command: Msp, payload: bytes = b"") -> bytes | None:
        """The reply to a request; None: power went."""
        resets, line, decoder = len(self.engine.resets), self.wired.transport(), Decoder()
        line.write(encode(request(command, payload)))
        end = self.idle.board.cycle + round(EXCHANGE_S * TIME_HZ)
        while self.idle.board.cycle < end:
            for event in decoder.feed(line.read(STEP / TIME_HZ)):
                assert isinstance(event, Message)
                assert event.direction.name == "REPLY", event
                return event.payload
            if len(self.engine.resets) > resets:
                assert self.engine.resets[resets:] == ["power"]
                return None
        raise AssertionError(f"no answer to {command.name}")

    def cut_at(self, operation: int, cut: Cut) -> None:
        """Let power go in the flash operation of that number from now on."""
        self.flash.cut_at, self.flash.cut = self.flash.operations + operation, cut

    def take(self) -> Snapshot:
        return take_snapshot(self.engine)

    def restore(self, snapshot: Snapshot) -> None:
        restore_snapshot(self.engine, snapshot)
