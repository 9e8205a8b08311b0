"""dshot_command.c: what the motors' controllers hear, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import pytest

from neuroflight.toolchain.contract import DSHOT_ALL_MOTORS, DshotCommand, Refusal

STOPPED = [0, 0, 0, 0]
BEACONS = {1: 260, 2: 260, 3: 280, 4: 280, 5: 1020}  # ms that they sound
REPEATED = (7, 8, 12, 20, 21)
KNOWN = {int(command) for command in DshotCommand}


class Commander:
    def __init__(self, core: Any, gyro_hz: int = 8000, motors: int = 4, outputs: Sequence[int] = ()) -> None:
        """outputs: of each motor; in their order unless told otherwise."""
        self.lib, self.motors = core.lib, motors
        self._outputs = core.new("uint8_t[]", list(outputs or range(motors)))
        self.self, self.out = core.new("struct dshot_command *"), core.new("uint16_t[8]")
        self.lib.dshot_command_init(self.self, gyro_hz, motors, self._outputs)

    def ask(self, command: int, motor: int = DSHOT_ALL_MOTORS, stopped: bool = True) -> Refusal:
        return Refusal(self.lib.dshot_command_ask(self.self, command, motor, stopped))

    def step(self, stopped: bool = True) -> tuple[list[int], bool]:
        """Values and telemetry bit of one gyro sample; what the core would have sent is 99."""
        for motor in range(8):
            self.out[motor] = 99
        telemetry = self.lib.dshot_command_step(self.self, stopped, self.out)
        assert set(list(self.out)[self.motors :]) <= {99}
        return list(self.out)[: self.motors], telemetry

    def run(self) -> list[tuple[tuple[list[int], bool], int]]:
        """Frames until the sequence is over, with how often each was repeated."""
        frames = []
        while self.busy():
            frames.append(self.step())
        return [(frame, len(list(run))) for frame, run in groupby(frames)]

    def busy(self) -> bool:
        return bool(self.lib.dshot_command_busy(self.self))


@pytest.fixture
def commander(scripted: Any) -> Commander:
    return Commander(scripted)


@pytest.mark.parametrize("gyro_hz", [1000, 8000])
@pytest.mark.parametrize("command", BEACONS)
def test_a_beacon_is_told_once_and_let_sound_when_asked_for(
    scripted: Any, gyro_hz: int, command: int
) -> None:
    ms = gyro_hz // 1000
    commander = Commander(scripted, gyro_hz)
    assert commander.ask(command) == Refusal.NONE
    before, told, after = commander.run()
    assert before == ((STOPPED, False), 10 * ms)
    assert told == (([command] * 4, True), 1)
    assert after == ((STOPPED, False), BEACONS[command] * ms)
    assert commander.step() == ([99] * 4, False)


@pytest.mark.parametrize("command", REPEATED)
def test_a_setting_is_told_often_enough_when_asked_for(commander: Commander, command: int) -> None:
    """At least 6 times in a row, 9 for the first controllers; 35 ms to save."""
    assert commander.ask(command) == Refusal.NONE
    before, (told, repeats), after = commander.run()
    assert before == ((STOPPED, False), 80)
    assert told == ([command] * 4, True)
    assert 9 <= repeats <= 10
    assert after == ((STOPPED, False), 8 * (35 if command == DshotCommand.SAVE else 1))


@pytest.mark.parametrize("every", [2, 3])
@pytest.mark.parametrize("command", [1, DshotCommand.SAVE])
def test_as_many_frames_are_sent_when_the_wire_is_busy_at_some_samples(
    commander: Commander, command: int, every: int
) -> None:
    """With answers on the wire each second or third frame is sent."""
    assert commander.ask(command) == Refusal.NONE
    sent = []
    for sample in range(20_000):
        if not commander.busy():
            break
        values, telemetry = commander.step()
        if sample % every == 0:
            sent.append((values, telemetry))
        elif telemetry:
            commander.lib.dshot_command_unsent(commander.self)
    assert not commander.busy()
    told = [frame for frame in sent if frame == ([command] * 4, True)]
    assert len(told) == (1 if command in BEACONS else 10)
    assert all(frame in (([command] * 4, True), (STOPPED, False)) for frame in sent)


@pytest.mark.parametrize("motor", range(4))
def test_one_motor_is_told_and_the_others_stand_when_it_is_named(commander: Commander, motor: int) -> None:
    assert commander.ask(DshotCommand.DIRECTION_REVERSED, motor) == Refusal.NONE
    told = [(values, repeats) for (values, telemetry), repeats in commander.run() if telemetry]
    assert told == [([21 if index == motor else 0 for index in range(4)], 10)]


def test_all_motors_are_told_when_there_are_eight(scripted: Any) -> None:
    commander = Commander(scripted, motors=8)
    assert commander.ask(1) == Refusal.NONE
    assert (([1] * 8, True), 1) in commander.run()
    assert commander.ask(1, 7) == Refusal.NONE
    assert (([0] * 7 + [1], True), 1) in commander.run()


def test_nothing_is_sent_when_the_command_is_not_one_of_ours(commander: Commander) -> None:
    for command in {*range(2100), 1 << 16, 1 << 20, 0xFFFFFFFF} - KNOWN:
        assert commander.ask(command) == Refusal.PAYLOAD
        assert not commander.busy()
        assert commander.step() == ([99] * 4, False)


@pytest.mark.parametrize("motor", [4, 5, 8, 31, 32, 254, 256, 1 << 20])
def test_nothing_is_sent_when_there_is_no_such_motor(commander: Commander, motor: int) -> None:
    assert commander.ask(1, motor) == Refusal.INDEX
    assert commander.step() == ([99] * 4, False)


@pytest.mark.parametrize("command", sorted(KNOWN - {0}))
def test_nothing_is_sent_when_the_motors_are_not_stopped(commander: Commander, command: int) -> None:
    assert commander.ask(command, stopped=False) == Refusal.ARMED
    assert not commander.busy()
    assert commander.step(stopped=False) == ([99] * 4, False)


@pytest.mark.parametrize("sent", [0, 1, 79, 80, 85, 90, 95])
def test_the_sequence_is_over_at_once_when_the_motors_arm(commander: Commander, sent: int) -> None:
    commander.ask(DshotCommand.SAVE)
    for _ in range(sent):
        commander.step()
    assert commander.step(stopped=False) == ([99] * 4, False)
    assert not commander.busy()
    assert commander.step() == ([99] * 4, False)


def test_a_request_is_dropped_when_the_motors_arm_before_it_is_taken(commander: Commander) -> None:
    commander.ask(DshotCommand.DIRECTION_REVERSED)
    assert commander.step(stopped=False) == ([99] * 4, False)
    assert commander.step() == ([99] * 4, False)


def test_the_next_command_waits_when_one_is_under_way(commander: Commander) -> None:
    assert commander.ask(7) == Refusal.NONE
    assert commander.ask(12) == Refusal.ORDER
    while commander.busy():
        assert commander.ask(12) == Refusal.ORDER
        assert 12 not in commander.step()[0]
    assert commander.ask(12) == Refusal.NONE


@pytest.mark.parametrize("stopped", [True, False])
def test_a_sequence_ends_when_a_stop_is_asked_for(commander: Commander, stopped: bool) -> None:
    assert commander.ask(5) == Refusal.NONE
    commander.step()
    assert commander.ask(DshotCommand.STOP, stopped=stopped) == Refusal.NONE
    assert commander.step() == ([99] * 4, False)
    assert not commander.busy()


def test_the_frames_are_the_protocols_when_a_command_is_sent(scripted: Any) -> None:
    """Save, 12 with the telemetry bit: 0b00000001100_1 and its checksum, as the protocol is published."""
    both = DshotCommand.SAVE | DshotCommand.BEACON_1 << 16
    assert scripted.lib.dshot_frames(both, True, False) == 0b0000000110011000 | 0x0033 << 16
