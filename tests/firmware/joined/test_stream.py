"""Streaming telemetry around a scripted policy: what is granted, told, counted and dropped, port by port."""

from __future__ import annotations

import itertools
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link import records
from neuroflight.flash.link.msp import Decoder, Direction, Message, encode, request
from neuroflight.sim.control import sticks
from neuroflight.sim.ports.library import Reference
from neuroflight.toolchain.contract import BOOT_GRACE_MS, FlightState, Msp, Refusal
from tests.firmware.telemetry import Sample, gaps, samples

G = 9.80665
DIVISORS = (1, 2, 4, 5, 8, 10, 20, 25, 40, 50, 100, 125, 200, 250, 500)  # of 1000 Hz, up to the most


class Board:
    """The firmware as a library, a control step and a millisecond at a time; two peers."""

    def __init__(self, library: Path, core: Any) -> None:
        self.core = core
        doubts = {
            "crash_detection": 0,
            "runaway_detection": 0,
            "plausibility_detection": 0,
        }  # the aircraft does not obey
        self.reference = Reference(library, 1000, {"arming_delay_ms": BOOT_GRACE_MS, **doubts})
        self.ms, self.armed, self.throttle = 0, False, 0.0

    def run(self, ms: int, *ports: int, rate: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[bytes]:
        """What these ports say unasked meanwhile, looked at after each step."""
        said = [b""] * len(ports)
        for _ in range(ms):
            if self.ms % 10 == 0:
                channels = sticks.channels((0.3, -0.2, 0.1), self.throttle, armed=self.armed)
                self.reference.receiver(channels.tolist())
            force = np.array([0.0, 0.0, G + 0.01 * (self.ms % 2)])
            self.reference.sample(np.array(rate), force)
            self.ms += 1
            said = [before + self.reference.link(port) for before, port in zip(said, ports, strict=True)]
        return said

    def fly(self) -> None:
        self.run(1100)
        self.armed = True
        self.run(30)
        assert records.safety(self.answer(0, Msp.SAFETY, b"").payload).state is FlightState.ARMED
        self.throttle = 0.4
        self.run(20)

    def answer(self, port: int, command: Msp, payload: bytes) -> Message:
        (message,) = Decoder().feed(self.reference.link(port, encode(request(command, payload))))
        assert isinstance(message, Message)
        assert message.command == command
        return message

    def stream(self, port: int, rate_hz: int) -> int:
        """The granted rate."""
        answer = self.answer(port, Msp.STREAM, struct.pack("<H", rate_hz))
        assert answer.direction is Direction.REPLY
        return int.from_bytes(answer.payload, "little")


@pytest.fixture
def board(scripted_build: Path, scripted: Any) -> Board:
    scripted.lib.scripted_action = [0.0] * 4  # what its self-test expects
    made = Board(scripted_build / "libneuroflight.so", scripted)
    scripted.lib.scripted_action = [0.4, 0.3, 0.2, 0.1]
    return made


def frame(core: Any, stream: Any, record: Any) -> bytes:
    """Of a record that is due."""
    out = core.new("uint8_t[512]")
    count = core.lib.msp_stream_write(stream, record, out, 512)
    return bytes(core.ffi.buffer(out, count))


def one(said: bytes) -> Sample:
    (found,) = samples(said)
    return found


@pytest.mark.parametrize("asked", [0, 1, 3, 100, 300, 333, 400, 499, 500, 501, 1000, 65535])
def test_the_nearest_divisor_of_the_control_rate_is_granted_when_a_rate_is_asked(
    board: Board, asked: int
) -> None:
    wanted = max((rate for rate in DIVISORS if rate <= asked), default=0)
    assert board.stream(0, asked) == wanted
    (said,) = board.run(1000, 0)
    found = samples(said)
    assert len(found) == wanted
    assert gaps(found) == 0
    assert [sample.sequence for sample in found] == list(range(wanted))
    assert {b.step - a.step for a, b in itertools.pairwise(found)} <= {1000 // max(wanted, 1)}


def test_nothing_is_said_unasked_when_the_stream_was_stopped(board: Board) -> None:
    assert board.run(100, 0, 1) == [b"", b""]
    board.stream(0, 500)
    assert board.run(100, 0)[0]
    assert board.stream(0, 0) == 0
    assert board.run(100, 0) == [b""]


def test_a_record_tells_what_the_controller_was_given_and_answered_when_it_flies(board: Board) -> None:
    board.fly()
    board.stream(0, 500)
    lib = board.core.lib
    for step in range(20):
        lib.scripted_action = [0.1 + 0.01 * step] * 4
        rate = (0.01 * step, -0.02 * step, 0.5)
        said = board.run(1, 0, rate=rate)[0]
        trace = board.reference.trace()
        if not said:
            continue
        told = one(said)
        assert told.step == trace.step
        assert told.setpoint == tuple(trace.setpoint)
        assert told.gyro == tuple(trace.gyro)
        assert told.gyro == pytest.approx(rate, abs=2e-3)
        assert told.throttle == trace.throttle
        assert told.dshot == tuple(trace.dshot)[:4]
        assert told.action == (float(np.float32(0.1 + 0.01 * step)),) * 4
        assert told.observation == tuple(lib.scripted_observation)
        assert (told.armed, told.pid_flies, told.state) == (True, False, FlightState.ARMED)


def test_no_controller_is_told_when_none_was_asked(board: Board) -> None:
    board.run(50)
    board.stream(0, 100)
    told = one(board.run(10, 0)[0])
    assert (told.observation, told.action, told.dshot) == ((), (), (0, 0, 0, 0))
    assert (told.armed, told.state) == (False, FlightState.CALIBRATING)


def test_each_port_has_a_stream_of_its_own_when_both_ask(board: Board) -> None:
    assert (board.stream(0, 500), board.stream(1, 100)) == (500, 100)
    first, second = (samples(said) for said in board.run(200, 0, 1))
    assert (len(first), len(second)) == (100, 20)
    assert gaps(first) == gaps(second) == 0
    board.reference.link_reset(1)
    first, second = (samples(said) for said in board.run(200, 0, 1))
    assert (len(first), second) == (100, [])
    assert first[0].sequence == 100


def test_a_record_is_dropped_whole_and_counted_when_it_does_not_fit(board: Board) -> None:
    board.fly()
    board.stream(0, 500)
    size = len(board.run(2, 0)[0])
    first = samples(board.run(2, 0)[0])
    board.run(2)
    assert board.reference.link(0, capacity=size - 1) == b""
    assert board.reference.link(0, capacity=size) == b""  # it was dropped, not kept
    board.run(2)
    then = samples(board.reference.link(0, capacity=size))
    assert gaps(first + then) == 1
    assert then[0].step == board.reference.trace().step


@pytest.mark.slow
def test_those_that_were_due_are_counted_when_the_line_was_not_asked_for_long(board: Board) -> None:
    board.stream(0, 250)
    first = samples(board.run(4, 0)[0])
    board.run(4 * 70_000)
    then = samples(board.reference.link(0))
    assert len(then) == 1  # the newest alone
    assert (then[0].sequence - first[0].sequence) % 65536 == 70_000 % 65536
    assert then[0].step == board.reference.trace().step
    assert [sample.sequence - then[0].sequence for sample in samples(board.run(8, 0)[0])] == [1, 2]


def test_records_and_replies_are_whole_when_requests_come_between(board: Board) -> None:
    board.stream(0, 500)
    line = b""
    for _ in range(100):
        line += board.run(1, 0)[0]
        line += board.reference.link(0, encode(request(Msp.STATUS)))
    events = Decoder().feed(line)
    assert gaps(samples(events)) == 0
    assert len(samples(events)) == 50
    assert sum(isinstance(event, Message) and event.command == Msp.STATUS for event in events) == 100


@pytest.mark.parametrize("payload", [b"", b"\x01", b"\x01\x00\x00"])
def test_a_request_of_another_length_is_refused_and_the_stream_goes_on_when_it_comes(
    board: Board, payload: bytes
) -> None:
    board.stream(0, 500)
    answer = board.answer(0, Msp.STREAM, payload)
    assert (answer.direction, answer.payload) == (Direction.ERROR, bytes([Refusal.PAYLOAD, 0, 0]))
    assert len(samples(board.run(10, 0)[0])) == 5


def test_a_record_is_no_request_when_it_is_sent_as_one(board: Board) -> None:
    assert board.answer(0, Msp.STREAM_SAMPLE, b"\xf4\x01").direction is Direction.ERROR
    assert board.run(10, 0) == [b""]


@pytest.mark.parametrize("begun", [0xFFFFFFFF, 0xFFFFFFF0, 0x7FFFFFFF])
def test_records_keep_coming_when_the_number_of_the_step_wraps(scripted: Any, begun: int) -> None:
    lib, stream = scripted.lib, scripted.new("struct msp_stream *")
    assert lib.msp_stream_start(stream, 500, begun) == 500
    record = scripted.new("struct control_record *", {"trace": {"motor_count": 4}})
    found = []
    for passed in range(1, 101):
        step = (begun + passed) % 2**32
        if lib.msp_stream_due(stream, step):
            record.trace.step = step
            found += samples(frame(scripted, stream, record))
    assert [sample.step for sample in found] == [(begun + 1 + 2 * k) % 2**32 for k in range(50)]
    assert gaps(found) == 0


def test_numbers_are_told_as_they_are_when_some_are_none(scripted: Any) -> None:
    """A stream is for looking into what goes wrong: nothing is mended on the way."""
    lib, stream = scripted.lib, scripted.new("struct msp_stream *")
    lib.msp_stream_start(stream, 500, 0)
    record = scripted.new(
        "struct control_record *",
        {
            "trace": {"step": 1, "gyro": [math.nan, math.inf, -0.0], "motor_count": 4, "armed": 1},
            "cycles": 0xFFFFFFFF,
            "state": int(FlightState.CRASHED),
            "pid_flies": True,
            "action_count": 4,
            "action": [math.nan, -1.0, 2.0, 0.0],
        },
    )
    told = one(frame(scripted, stream, record))
    assert (told.cycles, told.state, told.armed, told.pid_flies) == (
        2**32 - 1,
        FlightState.CRASHED,
        True,
        True,
    )
    assert math.isnan(told.gyro[0]) and told.gyro[1] == math.inf and math.copysign(1, told.gyro[2]) == -1
    assert math.isnan(told.action[0]) and told.action[1:] == (-1.0, 2.0, 0.0)
    assert told.observation == ()
