"""A computer at the USB connector floods the board in both directions while it flies: no step notices."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.flash.link import records
from neuroflight.flash.link.msp import Decoder, Direction, Message, encode, request
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.profile import EXCEPTIONS
from neuroflight.sim.board.usb.enumeration import Description, Steps, enumerate_device, transfer_to
from neuroflight.sim.board.usb.enumeration import request as usb_request
from neuroflight.sim.board.usb.host import Host, Transfer
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.toolchain.contract import Msp, Refusal, Task

Flown = Callable[..., Trace]
HANDLER = "gyro_sample_handler"
VTOR = 0xE000ED08
CDC_OUT, CDC_IN = 0x01, 0x81
DTR = usb_request(0x21, 0x22, 1)  # SET_CONTROL_LINE_STATE
FLIGHT = Scenario(
    "busy",
    tuple(Segment(0.1, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.1 * k) for k in range(4)),
)
ASKED = (Msp.STATUS, Msp.BOARD_INFO, Msp.TASKS, Msp.NAME, Msp.ANALOG)
CHANGE = encode(request(Msp.SETTING_SET, struct.pack("<HI", 0, 2000)))  # refused: it flies
FLOOD = b"".join(encode(request(command)) for command in ASKED) * 30 + CHANGE + bytes(range(256))
READ = 4096  # bytes asked for at a time


@dataclass
class Flooder:
    """A computer that sends requests and rubbish as fast as the bus takes it, and reads all that comes."""

    host: Host
    at_once: bool = True  # or when `begin` is called
    heard: bytearray = field(default_factory=bytearray)
    sent: int = 0
    begun: int | None = None  # cycle
    found: Description | None = None
    steps: Steps[Description] | None = None

    def __post_init__(self) -> None:
        self.host.on_change = self._come
        self.host.plug()

    def _come(self) -> None:
        assert self.host.connected, "the board has left the bus"
        self.steps = enumerate_device(self.host)
        self._step()

    def _step(self, _: Transfer | None = None) -> None:
        assert self.steps is not None
        try:
            next(self.steps).on_end = self._step
        except StopIteration as stop:
            self.found = stop.value
            self.host.control(DTR, address=1)
            if self.at_once:
                self.begin()

    def begin(self) -> None:
        """Flood from now on."""
        self.begun = self.host.engine.cycle
        self._send()
        self._read()

    def _send(self, ended: Transfer | None = None) -> None:
        assert self.found is not None
        self.sent += ended.sent if ended else 0
        transfer_to(self.host, self.found, CDC_OUT, FLOOD).on_end = self._send

    def _read(self, ended: Transfer | None = None) -> None:
        assert self.found is not None
        self.heard += ended.received if ended else b""
        transfer_to(self.host, self.found, CDC_IN, length=READ).on_end = self._read


class Counted(EmulatedPort):
    """A board whose control task's instructions are counted sample by sample."""

    flooder: Flooder | None = None

    def __init__(self, image: Path, flood: str) -> None:
        """flood: "none", "from power-up", or "armed", from the first armed step on."""
        self.counts: list[tuple[int, int]] = []  # of each sample's handler so far: instructions, runs
        self._flood = flood
        super().__init__(image, attach=self._plug)
        engine = self.board.engine
        vectors = np.frombuffer(engine.memory(engine.load(VTOR, 4), 4 * EXCEPTIONS), "<u4")
        # Of the interrupts that lead there a board enables one.
        self._tasks = np.flatnonzero(vectors == self.board.symbols[HANDLER] | 1).tolist()

    def _plug(self, board: Board) -> Callable[[int], None]:
        if self._flood != "none":
            self.flooder = Flooder(board.hardware.usb_host, at_once=self._flood == "from power-up")
        return board.run_to

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        reply = super().exchange(sample, channels_us)
        if reply.armed and self.flooder is not None and self.flooder.begun is None:
            self.flooder.begin()
        engine = self.board.engine
        tasks = [engine.library.engine_task(engine.handle, number) for number in self._tasks]
        self.counts.append(
            (sum(task.instructions for task in tasks), sum(task.activations for task in tasks))
        )
        return reply

    def close(self) -> None:
        """Close the board, which cannot be asked afterwards."""
        self.ended = self.board.cycle
        self.notes = tuple(note.message for note in self.board.report().notes)
        super().close()


@dataclass(frozen=True)
class Flight:
    """What a flight left."""

    trace: Trace
    counts: NDArray[np.int64]  # (N, 2), of each sample since the boot
    seconds: float  # of the flood
    flooder: Flooder | None
    notes: tuple[str, ...]


@pytest.fixture(scope="module")
def fly_board(board_image: Path, flown: Flown) -> Callable[..., Flight]:
    def fly(flood: str) -> Flight:
        port = Counted(board_image.with_suffix(".bin"), flood)
        trace = flown(port, FLIGHT)
        counts = np.diff(np.array(port.counts), axis=0)
        begun = port.flooder.begun if port.flooder else None
        return Flight(trace, counts, (port.ended - (begun or 0)) / TIME_HZ, port.flooder, port.notes)

    return fly


@pytest.fixture(scope="module")
def quiet(fly_board: Callable[..., Flight]) -> Flight:
    """Nothing is plugged in."""
    return fly_board("none")


@pytest.mark.parametrize("flood", ["armed", pytest.param("from power-up", marks=pytest.mark.slow)])
def test_neither_a_motor_nor_an_instruction_changes_when_a_computer_floods_the_usb_line(
    fly_board: Callable[..., Flight], quiet: Flight, reference_library: Path, flown: Flown, flood: str
) -> None:
    busy = fly_board(flood)
    assert busy.trace.same(quiet.trace)
    assert np.array_equal(busy.counts, quiet.counts)
    assert flown(ReferencePort(reference_library), FLIGHT).same(busy.trace)
    flooder = busy.flooder
    assert flooder is not None and flooder.found is not None and not busy.notes
    answers = [m for m in Decoder().feed(bytes(flooder.heard)) if isinstance(m, Message)]
    refused = [
        m.payload[0] for m in answers if m.direction is Direction.ERROR and m.command == Msp.SETTING_SET
    ]
    assert set(ASKED) <= {m.command for m in answers}
    assert refused and refused[-1] == Refusal.ARMED
    last = next(m for m in reversed(answers) if m.command == Msp.TASKS and m.direction is Direction.REPLY)
    for load in records.tasks(last.payload).loads:
        if load.task in (Task.CONTROL, Task.BATTERY, Task.ALERT, Task.STORAGE):
            assert load.misses == 0, load
            print(f"{load.task.name}: {load.runs} runs, worst {load.worst_cycles} cycles")
    rate = [n / busy.seconds / 1000 for n in (flooder.sent, len(flooder.heard))]
    print(f"{rate[0]:.0f} KB/s to the board, {rate[1]:.0f} KB/s from it; {len(answers)} answers")
    assert rate[0] > 50 and rate[1] > 300
