"""The motors' wires on the emulated pins: pulses while other lines are busy, and what ESCs answer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link import requests
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.variables import Variable, read_variables
from neuroflight.sim.board.devices.esc import AnswerFaults, Esc, Frame
from neuroflight.sim.board.serial.idle_board import IdleBoard, configured
from neuroflight.toolchain.contract import (
    DSHOT_ALL_MOTORS,
    ESC_DAMAGED,
    ESC_SILENT,
    MOTOR_TEST_MAGIC,
    DshotCommand,
    Msp,
)
from neuroflight.toolchain.image.elf import read_flashable
from tests.sampling import sampled

MOTORS = 4
SPEEDS = (600, 300, 150)
SETTING = {300: 0.0, 600: 1.0, 150: 2.0}  # motor_protocol
WORDS = (0x123, 0xFFF, 0x800, 0x7A5)


@dataclass
class Bench:
    """A board that answers MSP and whose motors stand."""

    idle: IdleBoard
    variables: tuple[Variable, ...]

    @property
    def escs(self) -> tuple[Esc, ...]:
        return tuple(self.idle.board.hardware.escs[:MOTORS])

    def run(self, seconds: float) -> None:
        self.idle.run_to(self.idle.board.cycle + round(seconds * TIME_HZ))

    def words(self) -> list[int]:
        """What the control step was given."""
        return self._read(0)[:MOTORS]

    @property
    def restarts(self) -> int:
        return self._read(1)[0]

    def _read(self, number: int) -> list[int]:
        variable = self.variables[number]
        data = self.idle.board.engine.memory(variable.address, variable.size)
        values: list[int] = np.frombuffer(data, variable.dtype.base).tolist()
        return values


Benches = Callable[..., Any]


@pytest.fixture
def bench(board_image: Path) -> Benches:
    """Makes benches."""

    @contextmanager
    def make(
        speed: int = 600, gyro_hz: int = 4000, telemetry: bool = True, **others: float
    ) -> Iterator[Bench]:
        settings: Mapping[str, float] = {
            "motor_protocol": SETTING[speed],
            "motor_telemetry": float(telemetry),
            "gyro_rate_hz": float(gyro_hz),
            **others,
        }
        flash = configured(read_flashable(board_image.with_suffix(".bin")), board_image, settings)
        found = read_variables(board_image, "firmware.rotors.words", "restarts")
        made = Bench(IdleBoard(flash, elf=board_image), found)
        try:
            made.idle.boot()
            yield made
        finally:
            made.idle.close()

    return make


def frames_of(bench: Bench, seconds: float, motor: int = 0) -> list[Frame]:
    """Frames that a motor's ESC takes."""
    frames: list[Frame] = []
    bench.idle.board.hardware.hear_frames(frames.append)
    bench.run(seconds)
    return [frame for frame in frames if frame.motor == motor + 1]


@pytest.mark.parametrize("gyro_hz", sampled((8000, 4000, 1000), 8000))
@pytest.mark.parametrize("speed", SPEEDS)
def test_words_of_the_escs_reach_the_control_step(bench: Benches, speed: int, gyro_hz: int) -> None:
    with bench(speed, gyro_hz) as board:
        for esc, word in zip(board.escs, WORDS, strict=True):
            esc.answer = word
        board.run(0.02)
        assert board.words() == list(WORDS)
        before = [esc.answers for esc in board.escs]
        board.run(0.1)
        assert board.words() == list(WORDS) and board.restarts == 0
        sent = {esc.answers - earlier for esc, earlier in zip(board.escs, before, strict=True)}
        least = {(600, 8000): 690, (300, 8000): 390, (150, 8000): 260, (150, 4000): 195}.get(
            (speed, gyro_hz), gyro_hz / 10 - 5
        )
        assert len(sent) == 1 and min(sent) >= least


FAULTS: dict[str, tuple[AnswerFaults, int]] = {  # and how many of 100 answers are read at least
    "slow": (AnswerFaults(clock=0.07), 100),
    "quick": (AnswerFaults(clock=-0.07), 100),
    "early": (AnswerFaults(delay_s=18e-6), 100),
    "late": (AnswerFaults(delay_s=37e-6), 100),
    "jitter": (AnswerFaults(jitter_s=0.08e-6), 100),
    "too slow": (AnswerFaults(clock=0.12), 0),
    "too late": (AnswerFaults(delay_s=60e-6), 0),
    "noise": (AnswerFaults(noise=0.003), 40),
    "all noise": (AnswerFaults(noise=0.5), 0),
    "every tenth is missing": (AnswerFaults(silence=0.1), 80),
    "stuck low": (AnswerFaults(stuck=False), 0),
    "stuck high": (AnswerFaults(stuck=True), 0),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_an_esc_that_answers_badly_holds_up_no_frame_and_no_other_motor(bench: Benches, fault: str) -> None:
    spoilt, least = FAULTS[fault]
    with bench() as board:
        for esc, word in zip(board.escs, WORDS, strict=True):
            esc.answer = word
        board.escs[2].spoil(spoilt)
        board.run(0.01)
        frames = [esc.frames for esc in board.escs]
        read = 0
        for _ in range(100):
            board.run(0.001)
            words = board.words()
            assert [words[motor] for motor in (0, 1, 3)] == [WORDS[motor] for motor in (0, 1, 3)]
            assert words[2] in (WORDS[2], ESC_SILENT, ESC_DAMAGED)
            read += words[2] == WORDS[2]
        assert read >= least and (least > 0 or read == 0)
        assert all(399 <= esc.frames - before <= 401 for esc, before in zip(board.escs, frames, strict=True))
        assert board.restarts == 0


def test_an_esc_that_never_answers_gets_its_frames(bench: Benches) -> None:
    with bench() as board:
        board.run(0.1)
        assert board.words() == [ESC_SILENT] * MOTORS
        assert min(esc.frames for esc in board.escs) > 400 and board.restarts == 0


@pytest.mark.parametrize("speed", SPEEDS)
def test_a_command_is_told_as_often_as_needed_where_answers_leave_room_for_few_frames(
    bench: Benches, speed: int
) -> None:
    with bench(speed, 8000) as board:
        for command, times in ((DshotCommand.BEACON_1, 1), (DshotCommand.SAVE, 10)):
            board.idle.client().request(
                Msp.DSHOT_COMMAND, requests.dshot_command(int(command), DSHOT_ALL_MOTORS)
            )
            frames = frames_of(board, 0.4)
            told = [frame for frame in frames if frame.value]
            assert [(frame.value, frame.telemetry) for frame in told] == [(int(command), True)] * times


def test_a_motor_turns_when_it_is_tested_and_answers(bench: Benches) -> None:
    with bench() as board:
        for esc, word in zip(board.escs, WORDS, strict=True):
            esc.answer = word
        client = board.idle.client()
        board.run(1.5)
        client.request(Msp.MOTOR_TEST, requests.motor_test(MOTOR_TEST_MAGIC))
        client.request(Msp.SET_MOTOR, requests.set_motor([1000, 1080, 1000, 1000]))
        board.run(0.01)
        assert [esc.last is not None and esc.last.value > 0 for esc in board.escs] == [
            False,
            True,
            False,
            False,
        ]
        assert board.words() == list(WORDS)


@pytest.mark.parametrize("telemetry", [False, True])
@pytest.mark.parametrize("speed", SPEEDS)
def test_pulses_are_thirds_of_a_bit_while_other_lines_are_busy(
    bench: Benches, speed: int, telemetry: bool
) -> None:
    """MSP on two UARTs, the gyro at 8 kHz: all of DMA2's other streams move. Cycles of 216 MHz."""
    bit = TIME_HZ // (1000 * speed)
    with bench(speed, 8000, telemetry, uart3_function=1.0) as board:
        clients = [board.idle.client(), board.idle.client(uart="USART3")]
        ends = set()
        for _ in range(60):
            for client in clients:
                client.request(Msp.STATUS)
            while not all(esc.edges for esc in board.escs):
                board.run(20e-6)  # a frame is on the wire
            edges = [esc.edges for esc in board.escs]
            assert len({tuple(seen[::2]) for seen in edges}) == 1, "all begin together"
            for seen in edges:
                assert {after - before for before, after in pairwise(seen[::2])} == {bit}
                assert {end - begin for begin, end in zip(seen[::2], seen[1::2], strict=True)} <= {
                    bit // 3,
                    bit // 3 * 2,
                }
            ends.add(edges[0][0])
        assert len(ends) > 50, "another frame each time"
