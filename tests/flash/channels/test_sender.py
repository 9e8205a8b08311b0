"""Channels to the host program: the begin at rest, the end disarmed, and what goes wrong between."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.channels.layout import NAMES, REST, Channels
from neuroflight.flash.channels.script import parse_script
from neuroflight.flash.channels.sender import ENDING_FRAMES, LOST_S, Sender
from neuroflight.flash.channels.source import Instead, Source, SourceLostError
from neuroflight.flash.channels.timeline import Timeline
from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.toolchain.contract import FlightState, Msp, Refusal, StopCause
from neuroflight.toolchain.errors import LinkError
from tests.flash.channels.test_layout import layout, with_aux
from tests.flash.lockstep import Lockstep, lockstep

ARMED = with_aux(aux1=2000)
FLYING = with_aux(aux1=2000, throttle=1500)


@pytest.fixture
def flown(host_program: Path) -> Iterator[Lockstep]:
    """A program that takes its channels over MSP."""
    with lockstep(host_program, "--set=receiver_protocol=msp", receiver=False) as one:
        yield one


class Told:
    """A Source that tells what a function says, and raises what it raises."""

    def __init__(self, tell: Callable[[float], Channels | Instead]) -> None:
        self.at = tell


def sender(flown: Lockstep, client: Client, **options: Any) -> Sender:
    return Sender(client, layout(), **({"clock": flown.clock, "sleep": flown.sleep} | options))


def safety(client: Client) -> records.Safety:
    return records.safety(client.request(Msp.SAFETY))


def fly(flown: Lockstep, source: Source, **options: Any) -> tuple[Sender, list[str]]:
    """Begin, wait for rest, run, end."""
    warned: list[str] = []
    with flown.client() as client, sender(flown, client, tell=warned.append, **options) as one:
        one.begin()
        one.await_rest(source)
        one.run(source)
    return one, warned


def test_a_script_arms_flies_and_ends_disarmed(flown: Lockstep) -> None:
    script = parse_script(b"t_s,throttle,aux1\n0,1000,1000\n0.5,1000,2000\n1,1300,\n2,,\n", "it", ".csv")
    one, warned = fly(flown, script, may_arm=True)
    assert warned == [] and one.disarmed
    assert max(flown.most) > 0.1
    assert flown.run(1) == (0, 0, 0, 0)
    with flown.client() as client:
        assert safety(client).stop_cause is StopCause.SWITCH  # not the failsafe
    count = one.count
    assert (count.late, count.unanswered, count.passed_over) == (0, 0, 0)
    assert count.taken == pytest.approx(50 * 2.0 + ENDING_FRAMES + 50 * 0.25, abs=12)


def test_no_armed_frame_goes_out_without_leave(flown: Lockstep) -> None:
    def tell(elapsed_s: float) -> Channels:
        return ARMED if elapsed_s > 0.5 else REST

    with pytest.raises(
        LinkError, match="the arm switch is on, expected off without --allow-arm; it was not sent"
    ):
        fly(flown, Told(tell))
    assert flown.most == (0, 0, 0, 0)
    with flown.client() as client:
        assert messages.rc(client.request(Msp.RC))[4] == 1000
        assert safety(client).stop_cause is StopCause.NONE


def test_it_waits_at_rest_while_the_source_has_throttle_or_switch_up(flown: Lockstep) -> None:
    def tell(elapsed_s: float) -> Channels | Instead:
        if flown.clock() < 4.0:
            return FLYING
        return REST if flown.clock() < 4.5 else Instead.END

    _, warned = fly(flown, Told(tell), may_arm=True)
    assert warned == ["put the throttle down and the arm switch off; rest is sent until then"]
    assert flown.most == (0, 0, 0, 0) and flown.clock() > 4.5


@pytest.mark.parametrize(
    "raised", [SourceLostError("the gamepad is gone"), KeyboardInterrupt(), RuntimeError()]
)
def test_it_disarms_first_when_the_source_is_lost_or_it_is_interrupted(
    flown: Lockstep, raised: BaseException
) -> None:
    def tell(elapsed_s: float) -> Channels:
        if elapsed_s > 1.5:
            raise raised
        return FLYING if elapsed_s > 1.0 else ARMED if elapsed_s > 0.5 else REST

    before = 0
    with pytest.raises(type(raised)):
        fly(flown, Told(tell), may_arm=True)
    assert max(flown.most) > 0.1
    with flown.client() as client:
        told = safety(client)
        assert (told.state, told.stop_cause) == (FlightState.DISARMED, StopCause.SWITCH)
        assert messages.rc(client.request(Msp.RC))[3:5] == (1000, 1000)
        before = told.receiver_percent
        flown.run(1500)  # silence
        assert safety(client).receiver_percent < before or "RECEIVER_LOST" in messages.arming_reasons(
            safety(client).arming_flags
        )


def test_the_boards_failsafe_stops_the_motors_when_the_line_is_gone(flown: Lockstep) -> None:
    def tell(elapsed_s: float) -> Channels:
        if elapsed_s > 1.5:
            client.close()
        return FLYING if elapsed_s > 1.0 else ARMED if elapsed_s > 0.5 else REST

    with (
        flown.client() as client,
        pytest.raises(LinkError, match="the line is gone"),
        sender(flown, client, may_arm=True) as one,
    ):
        one.begin()
        one.run(Told(tell))
    assert not one.disarmed
    assert any(flown.turned[-1])
    flown.run(5000)
    assert flown.turned[-1] == (0, 0, 0, 0)
    with flown.client() as client:
        assert safety(client).stop_cause is StopCause.RECEIVER


def test_silence_of_a_scenario_is_the_boards_failsafe_and_its_end_disarms(flown: Lockstep) -> None:
    rows: list[Channels | None] = [FLYING] * 50 + [None] * 50 + [REST]
    one, _ = fly(flown, Timeline(REST, 0.5, ARMED, 0.5, 50, rows), may_arm=True)
    assert one.disarmed
    with flown.client() as client:
        assert safety(client).stop_cause in (StopCause.RECEIVER, StopCause.SWITCH)


def test_an_armed_board_gets_no_frame(flown: Lockstep) -> None:
    with flown.client() as client, sender(flown, client, may_arm=True) as pilot:
        pilot.begin()
        pilot.run(Told(lambda s: Instead.END if s > 0.3 else ARMED if s > 0.1 else REST))
        assert messages.status(client.request(Msp.STATUS)).armed
        with flown.client() as other, sender(flown, other) as second:
            with pytest.raises(LinkError, match="the board is armed, expected disarmed"):
                second.begin()
            assert not second.began
        assert messages.status(client.request(Msp.STATUS)).armed


def test_it_disarms_when_the_board_arms_by_a_switch_that_its_settings_do_not_tell(host_program: Path) -> None:
    """Settings are told as they are stored: what is flown since the last start may be another."""
    options = ("--set=receiver_protocol=msp", "--set=mode1=arm aux5 1700 2100")
    with lockstep(host_program, *options, receiver=False) as one:
        switched = with_aux(aux5=2000)
        with pytest.raises(LinkError, match="the board armed though no channel that its settings name is on"):
            fly(one, Told(lambda elapsed_s: switched if elapsed_s > 0.5 else REST))
        armed = [motors for motors in one.turned if any(motors)]
        assert armed and one.clock() < 1.3 + 0.5 + 1.5
        assert one.run(1) == (0, 0, 0, 0)


def test_it_says_so_once_a_second_when_sending_falls_behind(flown: Lockstep) -> None:
    def slow(seconds: float) -> None:
        flown.sleep(seconds + 0.05)

    one, warned = fly(flown, Told(lambda elapsed_s: Instead.END if elapsed_s > 3.0 else REST), sleep=slow)
    assert 2 <= len(warned) <= 5
    assert all("sending falls behind: " in line and "use a faster line" in line for line in warned)
    assert one.count.late > one.count.taken
    assert one.disarmed


def test_it_ends_when_the_board_takes_no_frame_any_more(flown: Lockstep) -> None:
    """A firmware whose gyro is silent takes up no channels; here nobody steps it."""
    now = [0.0]

    def wait(seconds: float) -> None:
        now[0] += seconds

    with flown.client() as client:
        one = sender(flown, client, clock=lambda: now[0], sleep=wait)
        with pytest.raises(LinkError, match="no frame was taken for 1 s, expected 50 a second"), one:
            one.run(Told(lambda elapsed_s: REST))
    assert now[0] == pytest.approx(LOST_S + ENDING_FRAMES / 50, abs=0.05)  # it tried to disarm all the same
    assert one.count.taken == 1 and one.count.passed_over >= 50 + ENDING_FRAMES - 1
    assert one.disarmed  # as the board, which never armed, says


def test_the_receiver_must_be_msp(booted: Lockstep) -> None:
    with booted.client() as client, pytest.raises(LinkError) as error, sender(booted, client) as one:
        one.begin()
    assert getattr(error.value, "reason", None) is Refusal.ABSENT


def test_names_are_as_many_as_channels() -> None:
    assert len(NAMES) == len(REST) == 16
