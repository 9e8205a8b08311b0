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
from neuroflight.flash.link.messages import motor_telemetry
from neuroflight.flash.link.msp import encode, request
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.variables import Variable, read_variables
from neuroflight.sim.board.devices.esc import AnswerFaults, Esc, Frame
from neuroflight.sim.board.devices.sd_card.card import SdCard
from neuroflight.sim.board.serial.bridge import UartLine
from neuroflight.sim.board.serial.idle_board import IdleBoard, configured
from neuroflight.sim.board.serial.usb_peer import UsbPeer, plug
from neuroflight.sim.ports.receiver_frames import RECEIVERS
from neuroflight.toolchain.contract import (
    CHANNEL_COUNT,
    DSHOT_ALL_MOTORS,
    ESC_DAMAGED,
    ESC_SILENT,
    MOTOR_TEST_MAGIC,
    DshotCommand,
    EscTold,
    Msp,
)
from neuroflight.toolchain.image.elf import read_flashable
from tests.flights.test_blackbox_cycle import new_card
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
        speed: int = 600,
        gyro_hz: int = 4000,
        telemetry: bool = True,
        card: SdCard | None = None,
        **others: float,
    ) -> Iterator[Bench]:
        settings: Mapping[str, float] = {
            "motor_protocol": SETTING[speed],
            "motor_telemetry": float(telemetry),
            "gyro_rate_hz": float(gyro_hz),
            **others,
        }
        flash = configured(read_flashable(board_image.with_suffix(".bin")), board_image, settings)
        found = read_variables(board_image, "firmware.rotors.words", "restarts")
        made = Bench(IdleBoard(flash, elf=board_image, card=card), found)
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
@pytest.mark.parametrize("speed", sampled(SPEEDS, 600))
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


FAULTS: dict[str, tuple[AnswerFaults, int]] = {  # and how many of 50 answers are read at least
    "slow": (AnswerFaults(clock=0.09), 50),  # AM32 on an STM32G071
    "quick": (AnswerFaults(clock=-0.04), 50),
    "early": (AnswerFaults(delay_s=18e-6), 50),
    "late": (AnswerFaults(delay_s=37e-6), 50),
    "jitter": (AnswerFaults(jitter_s=0.08e-6), 50),
    "too slow": (AnswerFaults(clock=0.15), 0),
    "too late": (AnswerFaults(delay_s=60e-6), 0),
    "noise": (AnswerFaults(noise=0.003), 20),
    "all noise": (AnswerFaults(noise=0.5), 0),
    "every tenth is missing": (AnswerFaults(silence=0.1), 40),
    "stuck low": (AnswerFaults(stuck=False), 0),
    "stuck high": (AnswerFaults(stuck=True), 0),
}


@pytest.mark.slow
def test_an_esc_that_answers_badly_holds_up_no_frame_and_no_other_motor(bench: Benches) -> None:
    with bench() as board:
        for esc, word in zip(board.escs, WORDS, strict=True):
            esc.answer = word
        board.run(0.01)
        for fault, (spoilt, least) in FAULTS.items():
            board.escs[2].spoil(spoilt)
            board.run(0.03)  # its clock is learned
            frames = [esc.frames for esc in board.escs]
            read = 0
            for _ in range(50):
                board.run(0.001)
                words = board.words()
                assert [words[motor] for motor in (0, 1, 3)] == [WORDS[motor] for motor in (0, 1, 3)], fault
                assert words[2] in (WORDS[2], ESC_SILENT, ESC_DAMAGED), fault
                read += words[2] == WORDS[2]
            assert read >= least and (least > 0 or read == 0), fault
            sent = {esc.frames - before for esc, before in zip(board.escs, frames, strict=True)}
            assert sent <= {199, 200, 201}, fault
        assert board.restarts == 0


def test_an_esc_that_never_answers_gets_its_frames(bench: Benches) -> None:
    with bench() as board:
        board.run(0.1)
        assert board.words() == [ESC_SILENT] * MOTORS
        assert min(esc.frames for esc in board.escs) > 400 and board.restarts == 0


@pytest.mark.parametrize("speed", sampled(SPEEDS, 300))
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


@pytest.mark.slow
def test_escs_tell_their_temperature_once_they_are_asked_to_before_arming(bench: Benches) -> None:
    with bench() as board:
        for esc in board.escs:
            esc.answer = 0x123
            esc.tell({EscTold.TEMPERATURE: 41, EscTold.VOLTAGE: 66, EscTold.CURRENT: 7})
        client = board.idle.client()
        board.run(0.1)
        assert not any(esc.extended for esc in board.escs)
        told = motor_telemetry(client.request(Msp.MOTOR_TELEMETRY))
        assert [(esc.temperature_c, esc.volts, esc.amps) for esc in told] == [(0, 0.0, 0.0)] * MOTORS
        values = {frame.value for frame in frames_of(board, 2.3)}
        assert values == {0, DshotCommand.EXTENDED_TELEMETRY}
        assert all(esc.extended for esc in board.escs)
        assert {frame.value for frame in frames_of(board, 2.2)} == {0}, "they are not asked again"
        told = motor_telemetry(client.request(Msp.MOTOR_TELEMETRY))
        assert [(esc.temperature_c, esc.volts, esc.amps) for esc in told] == [(41, 16.5, 7.0)] * MOTORS
        assert max(esc.errors for esc in told) == 0.0


def test_a_motor_turns_when_it_is_tested_and_answers(bench: Benches) -> None:
    with bench() as board:
        for esc, word in zip(board.escs, WORDS, strict=True):
            esc.answer = word
            esc.tell({EscTold.TEMPERATURE: 30})
        client = board.idle.client()
        board.run(2.4)  # they have been asked for more
        client.request(Msp.MOTOR_TEST, requests.motor_test(MOTOR_TEST_MAGIC))
        client.request(Msp.SET_MOTOR, requests.set_motor([1000, 1080, 1000, 1000]))
        board.run(0.01)
        assert [esc.last is not None and esc.last.value > 0 for esc in board.escs] == [
            False,
            True,
            False,
            False,
        ]
        words = board.words()
        assert all(got in (word, 0x200 + 30) for got, word in zip(words, WORDS, strict=True))


class Traffic:
    """What moves on a board beside its motors: MSP on two UARTs and USB, a receiver, a log to the card."""

    def __init__(self, bench: Bench, card: SdCard) -> None:
        board = bench.idle.board
        self._lines = [UartLine(board), UartLine(board, "USART3")]
        self._receiver, self._sbus = board.hardware.usarts["USART2"], RECEIVERS["sbus"]
        self._usb, self._card = UsbPeer(bench.idle, plug(bench.idle)), card
        self._board = bench.idle.board
        self.moved = dict.fromkeys(("USART1", "USART3", "USB", "card"), 0)  # bytes from the board, blocks
        self._written = card.writes

    def go_on(self) -> None:
        """Keep each line busy for some milliseconds, and count what has come."""
        asked = encode(request(Msp.BOXNAMES)) * 4
        for line in self._lines:
            if line.pending < len(asked):
                line.send(asked)
            self.moved[line.uart] += len(line.take())
        if self._receiver.arriving == 0:
            self._receiver.feed(self._sbus.frame([1500] * CHANNEL_COUNT), self._sbus.format)
        self._usb.write(asked)
        self.moved["USB"] += len(self._usb.take())
        self.moved["card"] = self._card.writes - self._written


@pytest.mark.slow
@pytest.mark.parametrize("telemetry", sampled((False, True), True))
@pytest.mark.parametrize("speed", sampled(SPEEDS, 600))
def test_pulses_are_thirds_of_a_bit_and_answers_read_while_all_other_lines_are_busy(
    bench: Benches, tmp_path: Path, speed: int, telemetry: bool
) -> None:
    """The gyro at 8 kHz, three UARTs, USB, and the log on the card: all of DMA's other streams move.

    Cycles of 216 MHz. On the emulated board a transfer of DMA takes no time. On a real one a motor's word
    waits for the one transfer that DMA2's arbiter has granted before it, as the motors' streams alone are of
    very high priority (RM0431 8.3.4), and behind the motors' other ports in the same order each time. A
    transfer of the others moves a byte from or to a register of APB2, 4 to 8 cycles (AN4031, as remembered).
    So an edge is at most 8 cycles late, and a zero of DShot600 128 cycles long, 0.356 of a bit, where Bluejay
    takes less than 0.392 and AM32 less than 0.48 (sim/board/devices/esc.py).
    """
    bit = TIME_HZ // (1000 * speed)
    card = SdCard(new_card(tmp_path / "card.img"))
    with bench(speed, 8000, telemetry, uart3_function=1.0, blackbox_mode=1.0, card=card) as board:
        for esc, word in zip(board.escs, WORDS, strict=True):
            esc.answer = word
        traffic, ends = Traffic(board, card), set()
        while card.writes == 0:
            board.run(0.05)  # the log begins
        for _ in range(60):
            traffic.go_on()
            board.run(1e-3)
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
            assert board.words() == (list(WORDS) if telemetry else [ESC_SILENT] * MOTORS)
        assert len(ends) > 50, "another frame each time"
        assert board.restarts == 0
        assert min(traffic.moved["USART1"], traffic.moved["USART3"]) > 500, traffic.moved
        assert traffic.moved["USB"] > 8000 and traffic.moved["card"] > 10, traffic.moved
