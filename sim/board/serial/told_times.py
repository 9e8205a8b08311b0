"""The duration of control tasks as the firmware itself measured it, reported over its UART.

The firmware reads its processor's cycle counter at the begin and at the end of each control task, so that
what interrupts the task is in it. TASKS tells worst, best and mean of all runs since power-up, the stream
single runs.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass

from neuroflight.flash.link import records
from neuroflight.flash.link.msp import Decoder, Direction, Message, encode, request
from neuroflight.flash.monitoring.stream import Sample, decode_sample
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import MSP_UART, UartLine
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.toolchain.contract import MSP_STREAM_RATE_MAX_HZ, Msp, Task
from neuroflight.toolchain.errors import LinkError

WAIT_S = 1.0  # of the board's time within which a control step must have come


@dataclass(frozen=True)
class ToldTimes:
    """The control tasks of one kind."""

    armed: bool
    controller: str  # that flew, "policy" or "pid"; "" while disarmed
    runs: int
    worst: int  # cycles
    best: int  # cycles
    mean: float  # cycles
    missed: int | None  # deadlines; None: not told of single runs

    @property
    def variability(self) -> float:
        """(worst - best) / worst, as of the task costs."""
        return (self.worst - self.best) / self.worst


def told_while_idle(image: bytes, runs: int) -> ToldTimes:
    """Return the times of the first `runs` or a few more control tasks of an idle board with `image`.

    Raises LinkError if it does not answer or runs no control tasks, BoardError for what it does wrong.
    """
    idle = IdleBoard(image)
    try:
        idle.boot()
        with idle.client() as client:
            before = -1
            while True:
                told = records.tasks(client.request(Msp.TASKS))
                load = next(load for load in told.loads if load.task is Task.CONTROL)
                if load.runs >= runs:
                    cycles = (load.worst_cycles, load.best_cycles, load.mean_cycles)
                    return ToldTimes(False, "", load.runs, *cycles, load.misses)
                if load.runs == before:
                    raise LinkError(
                        f"{client.name}: the firmware has told {load.runs} control tasks for {WAIT_S:g} s, "
                        f"expected {runs}"
                    )
                before = load.runs
                ahead = (runs - load.runs) / load.rate_hz if load.rate_hz else WAIT_S
                idle.run_to(idle.board.cycle + round(min(ahead, WAIT_S) * TIME_HZ) + 1)
    finally:
        idle.close()


class StreamListener:
    """A listener that has a board stream its control steps over a UART while something else runs it."""

    def __init__(self, board: Board, baud: int, uart: str = MSP_UART) -> None:
        """baud: in the board's settings."""
        self._line = UartLine(board, uart, Format(baud))

    def begin(self) -> None:
        """Ask for as many samples as the firmware sends; it must have booted."""
        self._line.send(encode(request(Msp.STREAM, struct.pack("<H", MSP_STREAM_RATE_MAX_HZ))))

    def samples(self) -> list[Sample]:
        """Return the samples since `begin` or the last call. Raises LinkError for anything else."""
        decoder, samples = Decoder(), []
        for event in decoder.feed(self._line.take()):
            if not isinstance(event, Message):
                continue
            if event.direction is Direction.ERROR:
                raise LinkError(f"{self._line.uart}: the firmware refuses MSP STREAM, expected samples")
            if event.command == Msp.STREAM_SAMPLE:
                samples.append(decode_sample(event.payload))
        return samples


def told_of_samples(samples: Iterable[Sample]) -> dict[str, ToldTimes]:
    """Return the times of the armed ones among `samples`, by the controller that flew: "policy", "pid"."""
    cycles: dict[str, list[int]] = {}
    for sample in samples:
        if sample.armed:
            cycles.setdefault("pid" if sample.pid_flies else "policy", []).append(sample.cycles)
    return {
        name: ToldTimes(True, name, len(each), max(each), min(each), sum(each) / len(each), None)
        for name, each in cycles.items()
    }
