"""A companion flies the host program in its twin over MAVLink, and is lost."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink.session import Options
from neuroflight.toolchain.contract import (
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
    FlightState,
    StopCause,
)
from tests.flash.mavlink.conftest import FLYING, GYRO_HZ, Lockstep, MakeLockstep

ACCEPTED, REJECTED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED
IN_PROGRESS = mavlink.MAV_RESULT_IN_PROGRESS
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
SETTLED_MS = 400  # of the aircraft, to a new rate
SENT_MS = 20  # between two frames
STEPS = [(2.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, -1.5), (-1.0, -2.0, 1.0), (0.0, 0.0, 0.0)]


def rate_at(us: float) -> float:
    """Default rate so many microseconds from a stick's centre [rad/s]: 70 x + (670 - 70) x^2 deg/s."""
    return math.copysign(math.radians(70 * abs(us / 500) + 600 * (us / 500) ** 2), us)


def armed(lockstep: MakeLockstep, options: Options = FLYING, **more: Any) -> Lockstep:
    gateway = lockstep(options, **more)
    assert gateway.arm() == ACCEPTED
    assert gateway.reply.armed
    return gateway


def steady(gateway: Lockstep, rates: tuple[float, float, float]) -> Callable[[], None]:
    """A companion that asks for the same again and again."""
    return lambda: gateway.station.rates(*rates, 0.3)


def until_stopped(gateway: Lockstep, limit_ms: int = 3000) -> int:
    """Milliseconds until no motor is commanded."""
    for ms in range(1, limit_ms + 1):
        gateway.run(1)
        if not gateway.reply.dshot.any():
            return ms
    raise AssertionError(f"motors turn after {limit_ms} ms")


@pytest.mark.parametrize(
    "stored",
    [
        {},
        {
            "roll_rate": 100.0,
            "roll_max": 600.0,
            "roll_expo": 0.5,
            "deadband_us": 20.0,
            "map_roll": 3.0,
            "map_yaw": 0.0,
        },
        {"rates_style": 1.0},
    ],
    ids=["default", "expo, dead band, mapped", "betaflight"],
)
def test_rates_that_a_companion_asks_for_are_flown(lockstep: MakeLockstep, stored: dict[str, float]) -> None:
    gateway = armed(lockstep, stored=stored)
    gateway.station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, 20_000)
    for asked in STEPS:
        gateway.run(SETTLED_MS, steady(gateway, asked))
        x, y, z = gateway.reply.setpoint.tolist()
        curve = gateway.session.firmware.sticks.curves
        room = [max(np.diff(one)) for one in curve]  # the largest step of one microsecond
        assert all(abs(got - want) <= step for got, want, step in zip((x, -y, -z), asked, room, strict=True))
        assert gateway.reply.throttle == pytest.approx(0.3)
        assert gateway.rate == pytest.approx(asked, abs=0.12)
        told = gateway.station.got("ATTITUDE")[-1]
        assert (told.rollspeed, told.pitchspeed, told.yawspeed) == pytest.approx(asked, abs=0.15)
    beat = gateway.station.got("HEARTBEAT")[-1]
    assert beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert (beat.custom_mode, beat.system_status) == (1, mavlink.MAV_STATE_ACTIVE)
    landed = [message.landed_state for message in gateway.station.got("EXTENDED_SYS_STATE")]
    assert (landed[0], landed[-1]) == (mavlink.MAV_LANDED_STATE_ON_GROUND, mavlink.MAV_LANDED_STATE_IN_AIR)
    assert "Rates flown are not those of the settings: disarm, reboot" not in gateway.station.texts()


def test_a_rate_beyond_full_stick_is_flown_at_its_end_and_told(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep, stored={"yaw_rate": 200.0, "yaw_max": 200.0})
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(0, 0, 100.0, 0.3))
    assert gateway.reply.setpoint.tolist() == pytest.approx([0, 0, -math.radians(200)])
    assert "Setpoint beyond full stick: its end is flown" in gateway.station.texts()


def test_a_joystick_and_channels_fly_too(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    mav = gateway.station.link.mav
    gateway.run(100, lambda: mav.manual_control_send(1, 0, 100, 250, -60, 0))
    assert gateway.reply.setpoint.tolist() == pytest.approx([rate_at(50), 0, rate_at(30)])
    assert gateway.reply.throttle == pytest.approx(0.25)
    gateway.run(100, lambda: mav.rc_channels_override_send(1, 1, 1450, 1500, 1300, 1500, 1000, *[0] * 13))
    assert gateway.reply.setpoint.tolist() == pytest.approx([rate_at(-50), 0, 0])
    assert gateway.reply.armed, "the arm switch is not the companion's channel"
    gateway.run(100, lambda: mav.rc_channels_override_send(1, 1, 1500, 1500, 1300, 1500, 0, 1900, *[0] * 12))
    gateway.run(100, lambda: mav.rc_channels_override_send(1, 1, 1500, 1500, 1300, 1500, 0, 1900, *[0] * 12))
    assert gateway.session.firmware.safety.pid_flies


@pytest.mark.parametrize("timeout_s", [0.1, 0.3])
def test_the_failsafe_acts_in_time_when_the_companion_is_lost(
    lockstep: MakeLockstep, timeout_s: float
) -> None:
    gateway = armed(lockstep, Options(offboard=True, allow_arm=True, timeout_s=timeout_s))
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(1.0, 0, 0, 0.3))
    gateway.station.rates(1.0, 0, 0, 0.3)  # its last
    lost_ms = round(1000 * timeout_s)
    gateway.run(lost_ms + RECEIVER_HOLD_MS - SENT_MS - 2)
    assert gateway.reply.setpoint[0] > 0.9, "until then the last setpoint is flown"
    gateway.run(SENT_MS + 2)
    assert gateway.reply.setpoint.tolist() == [0, 0, 0], "held: centred, throttle kept"
    assert gateway.reply.throttle == pytest.approx(0.3)
    rest_ms = until_stopped(gateway)
    assert RECEIVER_LOST_MS - RECEIVER_HOLD_MS - SENT_MS - 2 <= rest_ms <= RECEIVER_LOST_MS - RECEIVER_HOLD_MS
    gateway.run(200)
    safety = gateway.session.firmware.safety
    assert safety.state is FlightState.FAILSAFE_DROP and safety.stop_cause is StopCause.RECEIVER
    texts = gateway.station.texts()
    assert f"Companion silent for {timeout_s:g} s: offboard ends, failsafe acts" in texts
    assert texts.index("State: failsafe hold") < texts.index("State: failsafe drop")


def test_setpoints_that_waited_while_the_gateway_could_not_run_are_not_flown(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(0, 0, 0, 0.3))
    for _ in range(350 * GYRO_HZ // 1000):
        gateway.step()
    for _ in range(10):
        gateway.station.rates(2.0, 0, 0, 0.3)
    gateway.settle()
    assert not gateway.session.steered
    assert "Companion silent for 0.3 s: offboard ends, failsafe acts" in gateway.station.texts()
    gateway.run(100, lambda: gateway.station.rates(2.0, 0, 0, 0.3))
    assert gateway.reply.setpoint.tolist() == [0, 0, 0]


def test_nobody_steers_after_the_firmware_has_started_anew(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    gateway.session.firmware.boots -= 1  # as if it had been the start before
    gateway.run(1500, lambda: gateway.station.rates(0, 0, 0, 0.3))
    assert len([text for text in gateway.station.texts() if text.startswith("Neuroflight")]) == 2
    assert not gateway.session.steered and not gateway.reply.dshot.any()


def test_a_companion_that_sends_no_numbers_is_a_lost_one(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(0, 0, 0, 0.3))
    gateway.run(500, lambda: gateway.station.rates(math.nan, 0, 0, 0.3))
    assert "Companion silent for 0.3 s: offboard ends, failsafe acts" in gateway.station.texts()
    assert until_stopped(gateway) < RECEIVER_LOST_MS


def test_a_companion_that_comes_back_is_not_obeyed_before_it_enables_again(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(0, 0, 0, 0.3))
    gateway.run(350)
    gateway.run(1100, lambda: gateway.station.rates(1.0, 0, 0, 0.3))
    assert gateway.reply.setpoint.tolist() == [0, 0, 0]
    assert not gateway.reply.dshot.any(), "the failsafe has stopped the motors"
    gateway.station.command(ARM, 1)
    gateway.settle()
    assert gateway.station.acks(ARM)[-1] == REJECTED


def test_the_flight_goes_on_when_it_enables_again_in_time(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(0, 0, 0, 0.3))
    gateway.run(700)
    assert gateway.session.firmware.safety.state is FlightState.FAILSAFE_HOLD
    assert gateway.enable() == ACCEPTED
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(1.0, 0, 0, 0.3))
    assert gateway.reply.armed and gateway.reply.setpoint[0] > 0.9
    assert gateway.reply.dshot.all()


def test_another_gateway_takes_over_what_flies(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(0, 0, 0, 0.3))
    gateway.restart_gateway()
    gateway.run(500, lambda: gateway.station.rates(0, 0, 0, 0.3))
    assert gateway.session.firmware.safety.state is FlightState.FAILSAFE_HOLD
    assert gateway.enable() == ACCEPTED
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(1.0, 0, 0, 0.3))
    assert gateway.reply.armed and gateway.reply.dshot.all() and gateway.reply.setpoint[0] > 0.9


def test_it_takes_a_new_command_to_arm_after_a_crash(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(0, 0, 0, 0.3))
    gateway.tumbling = 20.0, 0.0, 0.0
    gateway.run(600, lambda: gateway.station.rates(0, 0, 0, 0.3))
    assert not gateway.reply.dshot.any()
    assert {"State: crashed", "Motors stopped: crash"} & set(gateway.station.texts())
    gateway.tumbling = None
    gateway.run(2000, lambda: gateway.station.rates(0, 0, 0, 0))
    assert gateway.session.firmware.safety.state is FlightState.DISARMED
    assert not gateway.reply.armed


def test_after_the_failsafe_it_takes_enabling_and_arming_to_fly_again(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    gateway.run(SETTLED_MS)
    until_stopped(gateway)
    assert gateway.enable() == ACCEPTED
    gateway.run(800, lambda: gateway.station.rates(0, 0, 0, 0))
    assert gateway.session.firmware.safety.state is FlightState.DISARMED
    assert not gateway.reply.dshot.any()
    gateway.station.command(ARM, 1)
    gateway.run(200, lambda: gateway.station.rates(0, 0, 0, 0))
    assert gateway.station.acks(ARM)[-1] == ACCEPTED and gateway.reply.armed


def test_anybody_disarms_at_once(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep, stations=2)
    other = gateway.stations[1]
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(0, 0, 0, 0.3))
    other.command(ARM, 0)
    gateway.run(2 * SENT_MS + 2, lambda: gateway.station.rates(0, 0, 0, 0.3))
    assert not gateway.reply.dshot.any()
    gateway.run(200, lambda: gateway.station.rates(0, 0, 0, 0.3))
    assert other.acks(ARM) == [IN_PROGRESS, ACCEPTED]
    assert not gateway.reply.armed


def test_disarming_works_after_the_companion_is_lost(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    gateway.run(SETTLED_MS)
    assert gateway.reply.dshot.all() and not gateway.session.steered
    gateway.station.command(ARM, 0)
    assert until_stopped(gateway) <= 2 * SENT_MS + 2
    gateway.run(1000)
    assert gateway.station.acks(ARM)[-1] == ACCEPTED
    assert not gateway.reply.armed


def test_another_station_changes_no_setpoint(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep, stations=2)
    first, second = gateway.stations

    def both() -> None:
        first.rates(0, 0, 0, 0.3)
        second.rates(3.0, 0, 0, 0.9)

    gateway.run(SETTLED_MS, both)
    assert gateway.reply.setpoint.tolist() == [0, 0, 0]
    assert gateway.reply.throttle == pytest.approx(0.3)
    assert "Setpoints of system 202 are not taken: another steers" in second.texts()
    gateway.run(500, lambda: second.rates(0, 0, 0, 0.3))
    assert "Companion silent for 0.3 s: offboard ends, failsafe acts" in first.texts(), (
        "the other's do not count"
    )


def test_leaving_offboard_is_a_failsafe_and_not_a_stop_at_once(lockstep: MakeLockstep) -> None:
    gateway = armed(lockstep)
    gateway.run(SETTLED_MS, lambda: gateway.station.rates(0, 0, 0, 0.3))
    gateway.station.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 0)
    gateway.run(500, lambda: gateway.station.rates(0, 0, 0, 0.3))
    assert gateway.session.firmware.safety.state is FlightState.FAILSAFE_HOLD
    assert gateway.reply.dshot.all()
    assert until_stopped(gateway) <= RECEIVER_LOST_MS - 200
