"""Peers on both MSP ports while it flies: neither motors nor the control task notice; streams tell it all."""

from __future__ import annotations

import itertools
import socket
import struct
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.flash.link import records
from neuroflight.flash.link.msp import Decoder, Direction, Event, Message, encode, request
from neuroflight.flash.settings.values import parse_change
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.profile import EXCEPTIONS
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import MSP_UART, UartLine
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.toolchain.contract import FlightState, Msp, Refusal, Task
from neuroflight.toolchain.ir.interpreter import replay
from neuroflight.toolchain.policy.model import read_policy
from tests.firmware.telemetry import Sample as Record
from tests.firmware.telemetry import gaps, samples

Flown = Callable[..., Trace]
Send = Callable[[int, bytes], None]
UART3 = "USART3"
UARTS = (MSP_UART, UART3)
HANDLER = "gyro_sample_handler"
VTOR = 0xE000ED08
REQUESTS_HZ = 200  # on each of the two ports
STREAM_HZ = 250  # what 921,600 baud carry of 27 observations, beside 200 requests a second
FLIGHT = Scenario(
    "busy",
    tuple(Segment(0.1, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.1 * k) for k in range(5)),
)
READING = (
    *(Msp.STATUS, Msp.STATUS_EX, Msp.RC, Msp.MOTOR, Msp.ATTITUDE, Msp.RAW_IMU, Msp.ANALOG, Msp.BATTERY_STATE),
    *(Msp.TASKS, Msp.SAFETY, Msp.FAULTS, Msp.POLICY_INFO, Msp.BOARD_INFO, Msp.BUILD_INFO, Msp.UID, Msp.NAME),
)
QUESTIONS = tuple(encode(request(command)) for command in READING)
CHANGE = encode(request(Msp.SETTING_SET, struct.pack("<HI", 0, 2000)))  # refused: it flies


@dataclass
class Peers:
    """Two peers that ask by the clock of what they talk to, and keep what comes."""

    stream: Sequence[int] = ()  # ports on which one is asked for
    asks: Sequence[int] = (0, 1)  # ports on which other things are asked
    period: int = TIME_HZ // REQUESTS_HZ
    due: int = 0
    begun: int = 0
    sent: list[int] = field(default_factory=lambda: [0, 0])
    heard: list[bytearray] = field(default_factory=lambda: [bytearray(), bytearray()])

    def begin(self, now: int, send: Send) -> None:
        """The board can be talked to from now on."""
        self.due = self.begun = now
        for port in self.stream:
            send(port, encode(request(Msp.STREAM, struct.pack("<H", STREAM_HZ))))

    def ask(self, send: Send) -> None:
        """One request each."""
        self.due += self.period
        for port in self.asks:
            number = self.sent[port]
            send(port, CHANGE if number % 10 == 9 else QUESTIONS[(number + 5 * port) % len(QUESTIONS)])
            self.sent[port] += 1

    def told(self, port: int) -> list[Event]:
        return Decoder().feed(bytes(self.heard[port]))

    def answers(self, port: int) -> list[Message]:
        """Replies to requests; all frames must be whole."""
        told = self.told(port)
        assert all(isinstance(event, Message) for event in told)
        return [
            event
            for event in told
            if isinstance(event, Message) and event.command not in (Msp.STREAM, Msp.STREAM_SAMPLE)
        ]

    def records(self, port: int) -> list[Record]:
        return samples(self.told(port))


def check_answers(peers: Peers) -> None:
    """Each request got the answer to it, in order, but for the last ones, which were on their way."""
    for port in peers.asks:
        answers = peers.answers(port)
        asked = [
            Msp.SETTING_SET if n % 10 == 9 else READING[(n + 5 * port) % len(READING)]
            for n in range(peers.sent[port])
        ]
        assert peers.sent[port] >= REQUESTS_HZ
        assert peers.sent[port] - len(answers) <= 3
        assert [answer.command for answer in answers] == asked[: len(answers)]
        refused = [answer for answer in answers if answer.direction is Direction.ERROR]
        assert refused and {answer.command for answer in refused} == {Msp.SETTING_SET}
        assert {answer.payload[0] for answer in refused} == {Refusal.ARMED}


# --- The emulated board ------------------------------------------------------------------------------
class TalkedTo(EmulatedPort):
    """A board whose two UARTs are talked to, and whose instructions are counted sample by sample."""

    def __init__(
        self, image: Path, peers: Peers, baud: Mapping[str, int], settings: Mapping[str, float]
    ) -> None:
        self.peers = peers
        self.counts: list[tuple[int, int]] = []  # of each sample's handler so far: instructions, runs
        self._lines: tuple[UartLine, ...] = ()
        self.first: int | None = None  # armed control step
        super().__init__(image, settings=settings, attach=self._attached)
        self._lines = tuple(UartLine(self.board, uart, Format(baud[uart])) for uart in UARTS)
        engine = self.board.engine
        vectors = np.frombuffer(engine.memory(engine.load(VTOR, 4), 4 * EXCEPTIONS), "<u4")
        # Of the interrupts that lead there a board enables one.
        self._tasks = np.flatnonzero(vectors == self.board.symbols[HANDLER] | 1).tolist()
        peers.begin(self.board.cycle, self._send)

    def _attached(self, board: Board) -> Callable[[int], None]:
        def run(cycle: int) -> None:
            while self._lines and self.peers.due <= cycle:
                board.run_to(max(board.cycle, self.peers.due))
                self.peers.ask(self._send)
            board.run_to(cycle)
            for line, heard in zip(self._lines, self.peers.heard, strict=False):
                heard += line.take()

        return run

    def _send(self, port: int, data: bytes) -> None:
        self._lines[port].send(data)

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        reply = super().exchange(sample, channels_us)
        engine = self.board.engine
        tasks = [engine.library.engine_task(engine.handle, number) for number in self._tasks]
        self.counts.append(
            (sum(task.instructions for task in tasks), sum(task.activations for task in tasks))
        )
        if reply.armed and self.first is None:
            self.first = reply.step
        return reply


def settings_of(baud: Mapping[str, int]) -> dict[str, float]:
    texts = ("uart3_function=msp", f"msp_baud={baud[MSP_UART]}", f"uart3_baud={baud[UART3]}")
    return dict(parse_change(text) for text in texts)


@dataclass(frozen=True)
class Flight:
    """What a flight left."""

    trace: Trace
    counts: NDArray[np.int64]  # (N, 2), of each sample since the boot
    peers: Peers
    first: int  # control step of the trace's first row

    def check_records(self, port: int) -> list[Record]:
        """Those of the flight: they say what the trace says."""
        found = [r for r in self.peers.records(port) if 0 <= r.step - self.first < len(self.trace.t)]
        for record in found:
            row = record.step - self.first
            assert record.setpoint == tuple(self.trace.setpoint[row].tolist())
            assert record.gyro == tuple(self.trace.gyro[row].tolist())
            assert record.dshot == tuple(self.trace.dshot[row].tolist())
            assert record.throttle == self.trace.throttle[row]
            assert (record.state, record.armed, record.pid_flies) == (FlightState.ARMED, True, False)
        return found


FlyBoard = Callable[..., Flight]


@pytest.fixture(scope="module")
def fly_board(board_image: Path, flown: Flown) -> FlyBoard:
    """Flies FLIGHT on the emulated board, whose two lines have these speeds, while peers talk to it."""

    def fly(peers: Peers, *, uart1: int = 921600, uart3: int = 921600) -> Flight:
        baud = {MSP_UART: uart1, UART3: uart3}
        port = TalkedTo(board_image.with_suffix(".bin"), peers, baud, settings_of(baud))
        trace = flown(port, FLIGHT)
        assert port.first is not None
        return Flight(trace, np.diff(np.array(port.counts), axis=0), peers, port.first)

    return fly


@pytest.fixture(scope="module")
def quiet(fly_board: FlyBoard) -> Flight:
    """Nobody asks."""
    return fly_board(Peers(asks=()))


@pytest.fixture(scope="module")
def busy(fly_board: FlyBoard) -> Flight:
    """Both ports get requests and carry a stream."""
    return fly_board(Peers(stream=(0, 1)))


def test_neither_a_motor_nor_an_instruction_changes_when_two_peers_ask_200_times_a_second_each(
    quiet: Flight, busy: Flight, reference_library: Path, flown: Flown
) -> None:
    assert (quiet.counts[:, 1] == 1).all()  # one run of the handler a sample
    steps = quiet.counts[quiet.counts[:, 0] > 5_000, 0]
    assert len(steps) >= len(quiet.trace.t)
    assert busy.trace.same(quiet.trace)
    assert np.array_equal(busy.counts, quiet.counts)
    check_answers(busy.peers)
    assert flown(ReferencePort(reference_library), FLIGHT).same(quiet.trace)
    print(f"{len(quiet.counts)} samples, {len(steps)} of them armed steps of {steps.min()} to {steps.max()}")
    last = next(answer for answer in reversed(busy.peers.answers(0)) if answer.command == Msp.TASKS)
    tasks = records.tasks(last.payload)
    for task in (Task.CONTROL, Task.BATTERY, Task.ALERT, Task.STORAGE):
        load = tasks.loads[task]
        assert load.misses == 0
        print(f"{task.name}: {load.runs} runs, {load.misses} late, worst {load.worst_cycles} cycles")
    load = tasks.loads[Task.MSP]
    print(f"MSP: {load.runs} runs, worst {load.worst_cycles} cycles, mean {load.mean_cycles}")


def test_a_stream_tells_the_flight_to_the_bit_when_the_line_is_fast(
    busy: Flight, shipped_policy: Path
) -> None:
    policy = read_policy(shipped_policy)
    for port in (0, 1):
        whole = busy.peers.records(port)
        assert gaps(whole) == 0
        assert {b.step - a.step for a, b in itertools.pairwise(whole)} == {1000 // STREAM_HZ}
        found = busy.check_records(port)
        assert len(found) == round(STREAM_HZ * FLIGHT.duration_s)
        seen = np.array([record.observation for record in found], np.float32)
        answered = np.array([record.action for record in found], np.float32)
        assert np.array_equal(replay(policy.network, seen), answered)
        assert all(8_000 < record.cycles < 216_000 for record in found)
        assert len({record.cycles for record in found}) > 10
        grounded = [record for record in whole if not record.armed]
        assert grounded and all(r.observation == r.action == () for r in grounded)


@pytest.mark.slow
def test_gaps_are_told_and_all_else_is_whole_when_the_line_is_too_slow_for_the_stream(
    quiet: Flight, fly_board: FlyBoard
) -> None:
    slow = fly_board(Peers(stream=(1,), asks=(0,)), uart3=115200)
    assert slow.trace.same(quiet.trace)
    whole = slow.peers.records(1)
    found = slow.check_records(1)
    assert gaps(found) > len(found)
    first = whole[0]
    for record in whole:  # each is as old as the step it was due at, or one more
        due = first.step + 1000 // STREAM_HZ * (record.sequence - first.sequence)
        assert 0 <= record.step - due <= 1
    taken_s = (slow.peers.due - slow.peers.begun) / TIME_HZ
    used = len(slow.peers.heard[1]) * 10 / 115200 / taken_s
    print(f"at 115200 baud {len(found)} records, {gaps(found)} gaps; the line is {used:.0%} full")
    assert used > 0.95
    check_answers(slow.peers)


# --- The host program --------------------------------------------------------------------------------
class Called(HostPort):
    """A host program with two clients at its TCP port, by the clock of its samples."""

    def __init__(self, program: Path, peers: Peers) -> None:
        super().__init__(program)
        self.peers, self._samples_seen = peers, 0
        self._clients = [socket.create_connection(("127.0.0.1", self.msp_port)) for _ in range(2)]
        for client in self._clients:
            client.setblocking(False)
        peers.period = self.gyro_rate_hz // REQUESTS_HZ
        peers.begin(0, self._send)

    def _send(self, port: int, data: bytes) -> None:
        assert self._clients[port].send(data) == len(data)

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        while self.peers.due <= self._samples_seen:
            self.peers.ask(self._send)
        self._samples_seen += 1
        reply = super().exchange(sample, channels_us)
        for client, heard in zip(self._clients, self.peers.heard, strict=True):
            with suppress(BlockingIOError):
                heard += client.recv(1 << 16)
        return reply

    def close(self) -> None:
        for client, heard in zip(self._clients, self.peers.heard, strict=True):
            client.setblocking(True)
            client.shutdown(socket.SHUT_WR)
            while data := client.recv(1 << 16):
                heard += data
            client.close()
        super().close()


def test_no_motor_changes_when_two_clients_ask_200_times_a_second_each_over_sockets(
    host_program: Path, flown: Flown
) -> None:
    quiet = flown(HostPort(host_program), FLIGHT)
    peers = Peers(stream=(0, 1))
    assert flown(Called(host_program, peers), FLIGHT).same(quiet)
    check_answers(peers)
    for port in (0, 1):
        found = peers.records(port)
        assert gaps(found) == 0
        assert len(found) > STREAM_HZ * FLIGHT.duration_s
