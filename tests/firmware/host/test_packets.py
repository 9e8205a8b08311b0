"""The host program's packets when they are lost, repeated, overtaken, late, or come before it is ready."""

from __future__ import annotations

import math
import random
import select
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from neuroflight.toolchain import contract
from tests.firmware.host.app import connected
from tests.sampling import sampled

Start = Callable[..., Any]
ON, OFF = 2000, 1000
BOOT_MS = 2500  # until nothing but the switch stands against arming: calibration and recovery of the link
STILL = (0, 0, 0, 0)


class Flight:
    """A simulator of a board at rest, a millisecond a state packet; the pilot sends each 10 ms."""

    def __init__(self, program: Any) -> None:
        self.program, self.ms = program, 0

    def step(self) -> bool:
        """Advance by 1 ms; return whether it is armed."""
        self.program.state(time_s=self.ms / 1000)
        self.program.motors()
        self.ms += 1
        return armed(self.program)

    def run(self, ms: int, arm: int | None = None, **sticks: int) -> bool:
        """Advance; return whether it was ever armed. `arm` None: the pilot sends nothing."""
        ever = False
        for _ in range(ms):
            if arm is not None and self.ms % 10 == 0:
                self.program.sticks(arm, time_s=self.ms / 1000, **sticks)
            ever |= self.step()
        return ever


def armed(program: Any) -> bool:
    """Return whether it is armed in the oldest control step not looked at yet."""
    return bool(program.last_trace()[10] & contract.SIM_TRACE_FLAG_ARMED)


@pytest.fixture(params=["sbus", "crsf"])
def flight(start: Start, request: pytest.FixtureRequest) -> Flight:
    return Flight(start("--gyro-hz=1000", f"--set=receiver_protocol={request.param}"))


def test_packets_that_came_while_it_booted_neither_arm_nor_deafen_it(start: Start) -> None:
    p = start("--gyro-hz=1000")
    for k in range(2000):  # more than a socket holds
        p.sticks(OFF if k % 2 else ON, time_s=k / 100)
    p.sticks(ON, time_s=20.0)
    flight = Flight(p)
    flight.ms = 20_000
    assert not flight.run(BOOT_MS, ON), "the switch has stood at on since before"
    assert not flight.run(100, OFF)
    assert flight.run(100, ON)


def test_it_arms_by_the_set_protocol_and_only_after_an_off(flight: Flight) -> None:
    assert not flight.run(BOOT_MS, ON)
    assert not flight.run(100, OFF)
    assert flight.run(50, ON)


RX_CONFIG, SET_RX_CONFIG, SET_RAW_RC, SAVE, REBOOT = 44, 45, 200, 250, 68
CRSF, SBUS = 9, 2  # providers, by the app's numbers


def test_the_receiver_that_the_app_chose_is_flown_after_the_restart(start: Start, tmp_path: Path) -> None:
    options = ("--gyro-hz=1000", f"--settings={tmp_path / 'flash.bin'}")
    for provider in (CRSF, SBUS):
        flight = Flight(start(*options))
        flight.run(BOOT_MS, OFF)
        assert flight.run(50, ON), "by the one before"
        flight.run(50, OFF)
        with connected(flight.program) as app:
            app.ask(SET_RX_CONFIG, app.payload(SET_RX_CONFIG, serial_provider=provider))
            app.ask(SAVE)
            assert not flight.run(50, OFF), "what the receiver speaks changes with the restart"
            app.ask(REBOOT)
        assert flight.program.process.wait(5.0) == 0
    flight = Flight(start(*options))
    with connected(flight.program) as app:
        assert app.get(RX_CONFIG)["serial_provider"] == SBUS
    flight.run(BOOT_MS, OFF)
    assert flight.run(50, ON)


def test_an_overtaken_on_does_not_arm_and_an_overtaken_off_does_not_disarm(flight: Flight) -> None:
    p = flight.program
    flight.run(BOOT_MS, ON)
    for back_ms in (11, 30, 900):
        flight.run(100, OFF)
        p.sticks(ON, time_s=(flight.ms - back_ms) / 1000)
        assert not flight.run(9), back_ms
    assert flight.run(100, ON)
    for back_ms in (11, 30, 900):
        for _ in range(contract.RECEIVER_OFF_FRAMES + 1):
            p.sticks(OFF, time_s=(flight.ms - back_ms) / 1000)
        assert flight.step(), back_ms
    told = p.end()
    assert f"dropped {3 + 3 * (contract.RECEIVER_OFF_FRAMES + 1)} receiver packets" in told


@pytest.mark.parametrize("stands", [True, False])
@pytest.mark.parametrize("ahead_s", sampled([0.05, 0.99, 1.5, 1e6, math.inf, math.nan], 0.99, math.inf))
def test_a_packet_from_the_future_does_not_keep_the_pilot_from_disarming(
    flight: Flight, ahead_s: float, stands: bool
) -> None:
    """A clock that was put back; one that stands as well never catches up with what came from it before."""
    flight.run(BOOT_MS, OFF)
    assert flight.run(100, ON)
    began = flight.ms
    flight.program.sticks(ON, time_s=began / 1000 + ahead_s)
    for _ in range(200):
        if flight.ms % 10 == 0:
            flight.program.sticks(OFF, time_s=(began if stands else flight.ms) / 1000)
        if not flight.step():
            break
    assert flight.ms - began < 200 < contract.RECEIVER_LOST_MS


def test_a_pilot_whose_clock_began_anew_is_heard_and_repeated_packets_are_no_news(flight: Flight) -> None:
    p = flight.program
    flight.run(BOOT_MS, OFF)
    assert flight.run(50, ON)
    for _ in range(20):
        p.sticks(ON, time_s=flight.ms / 1000)
    assert flight.run(20)
    for _ in range(contract.RECEIVER_OFF_FRAMES):
        p.sticks(OFF, time_s=0.0)
        flight.step()
    assert not flight.step()


def test_the_newest_counts_when_nobody_asked_for_long(start: Start) -> None:
    """A socket keeps the oldest packets: what stood in it when the simulator paused is not flown later."""
    flight = Flight(start("--gyro-hz=1000"))
    flight.run(BOOT_MS, OFF)
    p = flight.program
    for k in range(3000):
        p.sticks(ON, time_s=(flight.ms + k) / 1000)
        if k % 50 == 0:
            assert p.silent(), "it has seen to them"
    for k in range(20):
        p.sticks(OFF, time_s=(flight.ms + 3000 + k) / 1000)
    assert p.silent()
    assert not flight.run(100)


@pytest.mark.parametrize("seed", range(3))
def test_it_answers_what_comes_and_never_arms_when_packets_are_lost_and_repeated(
    start: Start, seed: int
) -> None:
    chance = random.Random(seed)
    p = start("--gyro-hz=1000")
    for ms in range(BOOT_MS + 1000):
        if ms % 10 == 0:
            for _ in range(chance.choice((0, 1, 1, 1, 3))):
                p.sticks(ON, time_s=(ms - chance.choice((0, 0, 15))) / 1000)
        count = chance.choice((0, 1, 1, 1, 1, 2))
        for _ in range(count):
            p.state(time_s=ms / 1000)
        assert [p.motors() for _ in range(count)] == [STILL] * count
        assert not any(armed(p) for _ in range(count))
    assert p.silent()


def test_a_dead_link_holds_no_throttle_and_arms_nothing(flight: Flight) -> None:
    flight.run(BOOT_MS, OFF)
    assert flight.run(100, ON)
    assert flight.run(200, ON, throttle=1600)
    flight.run(10_000)
    assert not flight.run(1000), "failsafe has stopped the motors"
    assert not flight.run(2000, ON), "the link is back, with the switch as it was"
    flight.run(100, OFF)
    assert flight.run(50, ON)


def test_a_pilot_of_packets_is_told_once_when_channels_come_over_msp(start: Start) -> None:
    flight = Flight(start("--gyro-hz=1000", "--set=receiver_protocol=msp"))
    assert not flight.run(100, OFF)
    told = flight.program.end()
    assert told.count("receiver packets are ignored: receiver_protocol is msp, expected sbus or crsf") == 1


def test_what_a_companion_said_last_neither_arms_nor_flies_on_when_it_falls_silent(start: Start) -> None:
    flight = Flight(start("--gyro-hz=1000", "--set=receiver_protocol=msp"))

    def steer(ms: int, arm: int, throttle: int = 1000, count: int = 16) -> bool:
        """Send a companion's channels `count` times, 20 ms apart; return whether it was ever armed."""
        channels = [1500, 1500, throttle, 1500, arm, *[1500] * 11][:count]
        ever = False
        for _ in range(ms // 20):
            app.ask(SET_RAW_RC, struct.pack(f"<{count}H", *channels))
            ever |= flight.run(20)
        return ever

    with connected(flight.program) as app:
        assert not steer(BOOT_MS, ON), "it has said on from the beginning"
        steer(100, OFF)
        assert not flight.run(2000), "silence after an off"
        assert not steer(2000, ON), "and on when it speaks again: no off was heard since"
        steer(100, OFF)
        assert steer(100, ON)
        assert steer(100, ON, throttle=1600)
        flight.run(10_000)
        assert not flight.run(500), "its throttle is not held for ever"
        assert not steer(2000, ON)
        steer(100, OFF)
        assert steer(100, ON)
        steer(60, ON, count=4)
        assert not flight.run(1), "a frame that ends before the switch does not tell that it is on"


# --- A simulator that waits for the motors --------------------------------------------------------
def test_motors_come_first_and_again_when_the_simulator_waits_for_them(start: Start) -> None:
    """As Gazebo's ArduCopterPlugin does: it tells its state after motors, and waits again after a loss."""
    p = start("--gyro-hz=1000", "--motor-ms=20")
    assert p.motors() == STILL
    for _ in range(30):
        p.state()  # and the answer is lost
    while select.select([p.motor], [], [], 0)[0]:
        p.motors()
    assert p.motors() == STILL, "told again"
    assert [p.last_trace()[1] for _ in range(30)] == list(range(30)), "time stood still meanwhile"


def test_the_first_malformed_packet_is_told_at_once(start: Start) -> None:
    p = start("--gyro-hz=1000")
    p.send("state", bytes(100))
    assert select.select([p.process.stderr], [], [], 5.0)[0]
    assert p.process.stderr.readline() == (
        "neuroflight: a state packet of 100 bytes, expected 144: ignored, as all such will be\n"
    )
