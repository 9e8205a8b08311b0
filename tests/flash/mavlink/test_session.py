"""The gateway against the host program in lockstep, with pymavlink as the ground station."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import LineGoneError, TcpPort, TcpTransport, Transport, open_transport
from neuroflight.flash.mavlink.commands import CANCELLED
from neuroflight.flash.mavlink.endpoint import UdpPeer, parse_address
from neuroflight.flash.mavlink.ground import REFUSALS_MAX
from neuroflight.flash.mavlink.parameter_names import parameter_name
from neuroflight.flash.mavlink.parameter_server import TYPE_MISMATCH
from neuroflight.flash.mavlink.session import LOOK_S, Options, Session
from neuroflight.flash.settings.text import BY_NAME
from neuroflight.toolchain.contract import SETTINGS, FlightState, Mode, ModeRange, Msp
from neuroflight.toolchain.errors import LinkError
from tests.flash.mavlink.conftest import FLYING, GYRO_HZ, LOOPBACK, READY_MS, MakeLockstep, Station
from tests.flash.peers import answering

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
WATCHING = Options()
ESC_STATUS = 291  # the dialect of pymavlink that is used here does not know it either
PARAMETERS = [setting for setting in SETTINGS if setting.kind != "text"]
ATTITUDE = mavlink.MAVLINK_MSG_ID_ATTITUDE


def number(message: Any) -> float:
    """The value in a PARAM_VALUE."""
    if message.param_type == mavlink.MAV_PARAM_TYPE_REAL32:
        return float(message.param_value)
    return float(struct.unpack("<I", struct.pack("<f", message.param_value))[0])


def field(value: float, kind: int) -> float:
    """The float of a PARAM_SET."""
    if kind == mavlink.MAV_PARAM_TYPE_REAL32:
        return value
    return float(struct.unpack("<f", struct.pack("<I", int(value)))[0])


def set_parameter(station: Station, name: str, value: float) -> None:
    kind = BY_NAME[next(s.name for s in SETTINGS if parameter_name(s.name) == name.lower())][1].kind
    told = mavlink.MAV_PARAM_TYPE_REAL32 if kind == "float" else mavlink.MAV_PARAM_TYPE_INT32
    station.link.mav.param_set_send(1, 1, name.encode(), field(value, told), told)


# --- Telemetry -------------------------------------------------------------------------------------
def test_the_heartbeat_tells_type_state_and_mode_once_a_second(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    gateway.run(3000)
    beats = gateway.station.got("HEARTBEAT")
    assert 3 <= len(beats) <= 4
    assert {(b.type, b.autopilot) for b in beats} == {
        (mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_GENERIC)
    }
    assert beats[0].system_status in (mavlink.MAV_STATE_BOOT, mavlink.MAV_STATE_CALIBRATING)
    assert beats[-1].system_status == mavlink.MAV_STATE_STANDBY
    assert not any(beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED for beat in beats)
    assert {beat.get_srcSystem() for beat in beats} == {1}


def test_every_message_comes_at_its_rate_and_at_another_when_asked(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    station = gateway.station
    gateway.run(500)
    station.forget()
    gateway.run(2000)
    counts = {
        kind: len(station.got(kind)) for kind in ("ATTITUDE", "SYS_STATUS", "RC_CHANNELS", "SERVO_OUTPUT_RAW")
    }
    hz = {"ATTITUDE": 10, "SYS_STATUS": 1, "RC_CHANNELS": 2, "SERVO_OUTPUT_RAW": 2}
    assert all(abs(counts[kind] - 2 * rate) <= 1 for kind, rate in hz.items()), counts
    assert not station.got("ESC_STATUS")  # the firmware hears nothing of its ESCs
    station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, ATTITUDE, 20_000)
    gateway.settle()
    station.forget()
    gateway.run(1000)
    assert abs(len(station.got("ATTITUDE")) - 50) <= 1
    times = [message.time_boot_ms for message in station.got("ATTITUDE")]
    assert len(set(times)) > 40, "samples come as often"
    station.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, ATTITUDE)
    station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, ATTITUDE, -1)
    gateway.settle()
    assert station.got("MESSAGE_INTERVAL")[-1].interval_us == 20_000
    station.forget()
    gateway.run(500)
    assert not station.got("ATTITUDE")


def test_a_message_is_told_once_when_it_is_requested(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    gateway.station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    gateway.settle()
    (version,) = gateway.station.got("AUTOPILOT_VERSION")
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    assert gateway.station.acks(mavlink.MAV_CMD_REQUEST_MESSAGE) == [ACCEPTED]


def test_what_it_measures_is_told_in_mavlinks_units(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    gateway.run(1000)
    rests = 0, 0, -9.80665  # m/s^2, of what holds it up: down is positive
    (*_, imu) = gateway.station.got("HIGHRES_IMU")
    assert (imu.xacc, imu.yacc, imu.zacc) == pytest.approx(rests, abs=0.05)
    assert (imu.xgyro, imu.ygyro, imu.zgyro) == pytest.approx((0, 0, 0), abs=0.1)
    for kind in ("SCALED_IMU", "RAW_IMU"):
        (*_, scaled) = gateway.station.got(kind)
        assert (scaled.xacc, scaled.yacc, scaled.zacc) == pytest.approx((0, 0, -1000), abs=5)
    (*_, turned) = gateway.station.got("ATTITUDE_QUATERNION")
    assert (turned.q1, turned.q2, turned.q3, turned.q4) == pytest.approx((1, 0, 0, 0), abs=0.02)
    (*_, landed) = gateway.station.got("EXTENDED_SYS_STATE")
    assert landed.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND


RESULTS: list[tuple[int, tuple[float, ...], int]] = [
    (mavlink.MAV_CMD_NAV_TAKEOFF, (), UNSUPPORTED),
    (65535, (), UNSUPPORTED),
    (mavlink.MAV_CMD_REQUEST_MESSAGE, (ESC_STATUS,), UNSUPPORTED),
    (mavlink.MAV_CMD_REQUEST_MESSAGE, (math.nan,), DENIED),
    (mavlink.MAV_CMD_REQUEST_MESSAGE, (1e30,), DENIED),
    (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (0, 1e6), DENIED),  # the heartbeat's
    (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (ATTITUDE, 1), DENIED),
    (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (ATTITUDE, math.inf), DENIED),
    (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (999, 1e6), UNSUPPORTED),
    (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (ATTITUDE, 0), ACCEPTED),
    (mavlink.MAV_CMD_PREFLIGHT_STORAGE, (0,), DENIED),
    (mavlink.MAV_CMD_PREFLIGHT_STORAGE, (math.nan,), DENIED),
    (mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (2,), DENIED),
    (mavlink.MAV_CMD_DO_SET_MODE, (0, 1), DENIED),  # no custom mode
    (mavlink.MAV_CMD_DO_SET_MODE, (1, 2), DENIED),
    (mavlink.MAV_CMD_DO_SET_MODE, (1, math.nan), DENIED),
    (mavlink.MAV_CMD_DO_SET_MODE, (1, 4, 5), DENIED),  # PX4's RTL
    (mavlink.MAV_CMD_DO_SET_MODE, (1, 4, 0.5), DENIED),
    (mavlink.MAV_CMD_DO_SET_MODE, (1, 6), REJECTED),  # no setpoints come
    (mavlink.MAV_CMD_DO_SET_MODE, (1, 4, 3), ACCEPTED),  # MAVSDK's offboard.stop()
    (mavlink.MAV_CMD_DO_SET_MODE, (1, 0), ACCEPTED),
    (mavlink.MAV_CMD_NAV_GUIDED_ENABLE, (math.nan,), DENIED),
    (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (2,), DENIED),
    (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (math.nan,), DENIED),
]


def test_every_command_is_answered(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    for command, params, result in RESULTS:
        gateway.station.forget()
        gateway.station.command(command, *params)
        values = [*params, 0, 0, 0, 0][:4]
        gateway.station.link.mav.command_int_send(1, 1, 0, command, 0, 0, *values, 0, 0, 0)
        gateway.settle()
        assert gateway.station.acks(command) == [result, result], (command, params)


def test_what_is_meant_for_others_is_passed_over(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    mav = gateway.station.link.mav
    mav.command_long_send(2, 1, mavlink.MAV_CMD_NAV_TAKEOFF, 0, *[0] * 7)
    mav.command_long_send(1, 154, mavlink.MAV_CMD_NAV_TAKEOFF, 0, *[0] * 7)
    mav.param_request_list_send(2, 1)
    mav.set_attitude_target_send(0, 2, 1, 0x80, [1, 0, 0, 0], 0, 0, 0, 0)
    gateway.settle()
    assert not gateway.station.got("COMMAND_ACK") and not gateway.station.got("PARAM_VALUE")
    gateway.station.command(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1)
    gateway.settle()
    assert gateway.station.acks(mavlink.MAV_CMD_NAV_GUIDED_ENABLE) == [REJECTED]


def test_a_ground_station_learns_that_there_is_no_mission(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    gateway.station.link.mav.mission_request_list_send(1, 1)
    gateway.settle()
    assert [message.count for message in gateway.station.got("MISSION_COUNT")] == [0]


def test_states_and_reasons_are_told_as_texts(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    gateway.run(READY_MS)
    texts = gateway.station.texts()
    assert texts[0].startswith("Neuroflight 0.1.0, policy nf1 ")
    assert "State: disarmed" in texts
    assert any(text.startswith("Not ready: receiver lost: switch the transmitter on") for text in texts)
    assert texts == gateway.lines


# --- Parameters ------------------------------------------------------------------------------------
def test_all_settings_go_round_as_parameters(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    station = gateway.station
    station.link.mav.param_request_list_send(1, 1)
    gateway.settle()
    told = station.got("PARAM_VALUE")
    assert [message.param_id for message in told] == [parameter_name(s.name).upper() for s in PARAMETERS]
    assert [message.param_index for message in told] == list(range(len(PARAMETERS)))
    assert {message.param_count for message in told} == {len(PARAMETERS)}
    values = {message.param_id: number(message) for message in told}
    assert values["RX_PROTOCOL"] == 2 and values["MODE1"] == BY_NAME["mode1"][1].default
    for setting in PARAMETERS:
        name = parameter_name(setting.name).upper()
        wanted = setting.low if values[name] != setting.low else setting.high
        if setting.kind == "mode":
            wanted = ModeRange(Mode.BEEPER, 12, 900, 1300, and_others=True).packed
        for value in (wanted, values[name]):
            station.forget()
            set_parameter(station, name, value)
            gateway.settle()
            got = next(m for m in station.got("PARAM_VALUE") if m.param_id == name)
            assert number(got) == pytest.approx(value, rel=1e-6), name


def test_a_parameter_is_read_by_name_and_by_number(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    mav = gateway.station.link.mav
    mav.param_request_read_send(1, 1, b"roll_rate", -1)
    mav.param_request_read_send(1, 1, b"", 0)
    mav.param_request_read_send(1, 1, b"nothing", -1)
    mav.param_request_read_send(1, 1, b"", 9999)
    mav.param_request_read_send(1, 1, b"", -2)
    mav.param_request_read_send(1, 1, b"craft_name", -1)  # a text is no parameter
    gateway.settle()
    assert sorted((m.param_id, number(m)) for m in gateway.station.got("PARAM_VALUE")) == [
        ("GYRO_RATE_HZ", 4000.0),
        ("roll_rate", 70.0),
    ]


def test_a_parameter_is_told_by_the_name_it_was_asked_for(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING, stations=2)
    station, other = gateway.stations
    for name in ("roll_max", "ROLL_MAX", "Roll_Max"):
        for station_ in gateway.stations:
            station_.forget()
        station.link.mav.param_request_read_send(1, 1, name.encode(), -1)
        gateway.settle()
        station.link.mav.param_set_send(1, 1, name.encode(), 700.0, 9)
        gateway.settle()
        assert [(m.param_id, m.param_value) for m in station.got("PARAM_VALUE")][-1] == (name, 700.0)
        assert {m.param_id for m in station.got("PARAM_VALUE")} == {name}
        assert {m.param_id for m in other.got("PARAM_VALUE")} == {"ROLL_MAX"}, "as it was told before"


REAL32, INT32, UINT16 = 9, 6, 3  # MAV_PARAM_TYPE


def listed(gateway: Any, station: Station) -> dict[str, Any]:
    """Return PARAM_VALUE by name, as told to a station that asks for all."""
    station.forget()
    station.link.mav.param_request_list_send(1, 1)
    gateway.settle()
    return {message.param_id: message for message in station.got("PARAM_VALUE")}


def test_whole_numbers_are_told_to_each_client_as_it_reads_them(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING, stations=3)
    px4, ardupilot, script = gateway.stations
    listed(gateway, ardupilot)
    for station in (px4, ardupilot):  # as MAVSDK does; and MAVProxy, whose user types `version`
        station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    gateway.settle()
    truth = {one.param_id: number(one) for one in listed(gateway, script).values()}
    whole = {parameter_name(s.name).upper() for s in PARAMETERS if s.kind != "float"}
    in_bytes = listed(gateway, px4)
    assert {name for name, one in in_bytes.items() if one.param_type == INT32} == whole
    assert {name: number(one) for name, one in in_bytes.items()} == truth
    for station in (ardupilot, script):
        told = listed(gateway, station)
        assert {one.param_type for one in told.values()} == {REAL32}
        assert {name: one.param_value for name, one in told.items()} == pytest.approx(truth)
    px4.forget()
    ardupilot.link.mav.param_set_send(1, 1, b"DEADBAND_US", 7.0, REAL32)
    gateway.settle()
    (heard,) = px4.got("PARAM_VALUE")
    assert (heard.param_type, number(heard)) == (INT32, 7), "what others change is told in its custom, too"


@pytest.mark.parametrize("kind", [UINT16, INT32])
@pytest.mark.parametrize("in_bytes", [True, False])
def test_what_is_set_is_told_as_it_came(lockstep: MakeLockstep, kind: int, in_bytes: bool) -> None:
    gateway = lockstep(WATCHING)
    sent = field(9, kind) if in_bytes else 9.0
    gateway.station.link.mav.param_set_send(1, 1, b"deadband_us", sent, kind)
    gateway.settle()
    (told,) = gateway.station.got("PARAM_VALUE")
    assert (told.param_value, told.param_type) == ((sent, INT32) if in_bytes else (9.0, REAL32))


def test_a_mode_range_that_no_float_holds_is_told_in_bytes_and_not_set_from_a_float(
    lockstep: MakeLockstep,
) -> None:
    gateway = lockstep(WATCHING)
    mav = gateway.station.link.mav
    packed = ModeRange(Mode.BEEPER, 12, 900, 1300, and_others=True).packed
    mav.param_set_send(1, 1, b"MODE20", field(packed, INT32), INT32)
    gateway.settle()
    told = listed(gateway, gateway.station)["MODE20"]
    assert (number(told), told.param_type) == (packed, INT32)
    gateway.station.forget()
    mav.param_set_send(1, 1, b"MODE20", told.param_value, REAL32)  # a file of floats, loaded again
    mav.param_set_send(1, 1, b"MODE20", float(packed), REAL32)  # which float32 rounds to another mode
    gateway.settle()
    assert {number(one) for one in gateway.station.got("PARAM_VALUE")} == {packed}
    assert len(gateway.station.got("PARAM_ERROR")) == 2


def test_a_refusal_says_why_in_the_way_that_newer_clients_wait_for(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    errors = []
    for name, value, kind in (
        ("NOTHING", 1.0, REAL32),
        ("DEADBAND_US", 5000.0, REAL32),
        ("ROLL_MAX", field(700, INT32), INT32),
    ):
        gateway.station.link.mav.param_set_send(1, 1, name.encode(), value, kind)
        gateway.settle()
        errors.append((name, gateway.station.got("PARAM_ERROR")[-1]))
    assert gateway.arm() == ACCEPTED
    set_parameter(gateway.station, "DEADBAND_US", 3)
    gateway.settle()
    errors.append(("DEADBAND_US", gateway.station.got("PARAM_ERROR")[-1]))
    assert [(name, one.param_id, one.error) for name, one in errors] == [
        ("NOTHING", "NOTHING", mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST),
        ("DEADBAND_US", "DEADBAND_US", mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE),
        ("ROLL_MAX", "ROLL_MAX", TYPE_MISMATCH),
        ("DEADBAND_US", "DEADBAND_US", mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED),
    ]


def test_the_old_value_is_the_answer_when_a_new_one_is_refused(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    for name, value, kind in [
        ("roll_expo", 1.5, 9),
        ("roll_expo", math.nan, 9),
        ("roll_expo", 0.5, 5),
        ("deadband_us", field(101, 5), 5),
        ("deadband_us", 0.5, 9),
        ("deadband_us", 1.0, 8),
    ]:
        gateway.station.forget()
        gateway.station.link.mav.param_set_send(1, 1, name.encode(), value, kind)
        gateway.settle()
        (told,) = gateway.station.got("PARAM_VALUE")
        assert (told.param_id, number(told)) == (name, 0.0)
        assert [text for text in gateway.station.texts() if text.startswith(f"{name.upper()}: ")], (
            name,
            value,
        )


def test_no_parameter_changes_while_armed(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    assert gateway.arm() == ACCEPTED
    set_parameter(gateway.station, "roll_expo", 0.5)
    gateway.station.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1)
    gateway.station.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    gateway.settle()
    assert number(gateway.station.got("PARAM_VALUE")[-1]) == 0.0
    assert "ROLL_EXPO: the motors are armed; disarm first" in gateway.station.texts()
    assert gateway.station.acks(mavlink.MAV_CMD_PREFLIGHT_STORAGE) == [REJECTED]
    assert gateway.station.acks(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN) == [REJECTED]
    assert gateway.reply.armed


def test_all_rates_are_told_when_their_style_changes(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    set_parameter(gateway.station, "rates_style", 1)
    gateway.settle()
    told = {m.param_id: number(m) for m in gateway.station.got("PARAM_VALUE")}
    assert len(told) == 10
    assert [told[name] for name in ("rates_style", "ROLL_RATE", "ROLL_MAX")] == pytest.approx([1, 1, 0.7])


def test_what_is_stored_is_there_after_a_restart_and_defaults_too(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    station = gateway.station
    set_parameter(station, "roll_expo", 0.5)
    station.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1)
    gateway.settle()
    assert station.acks(mavlink.MAV_CMD_PREFLIGHT_STORAGE) == [ACCEPTED]
    station.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    gateway.settle()
    assert station.acks(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN) == [ACCEPTED]
    again = lockstep.again()
    again.station.link.mav.param_request_read_send(1, 1, b"roll_expo", -1)
    again.settle()
    assert number(again.station.got("PARAM_VALUE")[-1]) == 0.5
    again.station.forget()
    again.station.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 2)
    again.settle()
    told = {m.param_id: number(m) for m in again.station.got("PARAM_VALUE")}
    assert len(told) == len(PARAMETERS) and (told["ROLL_EXPO"], told["RX_PROTOCOL"]) == (0.0, 0.0)


def test_settings_that_contradict_each_other_are_not_stored_and_told(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    set_parameter(gateway.station, "map_roll", 1)
    gateway.station.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1)
    gateway.settle()
    assert gateway.station.acks(mavlink.MAV_CMD_PREFLIGHT_STORAGE) == [FAILED]
    assert any("does not fit" in text for text in gateway.station.texts())


# --- Interlocks ------------------------------------------------------------------------------------
def test_the_line_is_left_alone_when_the_receiver_is_another(lockstep: MakeLockstep) -> None:
    with pytest.raises(LinkError, match=r"receiver_protocol is crsf, .* expected msp; no channel was taken"):
        lockstep(stored={"receiver_protocol": 1.0})


def steer(gateway: Any) -> None:
    """All that a companion may try."""
    mav = gateway.station.link.mav
    gateway.station.rates(1.0, 0.0, 0.0, 0.0)
    mav.manual_control_send(1, 500, 500, 0, 500, 0)
    mav.rc_channels_override_send(1, 1, 1600, 1600, 1000, 1600, 1900, 1900, 1900, 1900, *[1900] * 10)
    gateway.station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, 21196)


@pytest.mark.parametrize("options", [WATCHING, FLYING], ids=["not allowed", "not enabled"])
def test_no_channel_is_sent_unless_offboard_is_allowed_and_enabled(
    lockstep: MakeLockstep, options: Options, monkeypatch: pytest.MonkeyPatch
) -> None:
    from neuroflight.flash.link import requests

    sent: list[object] = []

    def note(frame: object) -> bytes:
        sent.append(frame)
        return b""

    monkeypatch.setattr(requests, "set_raw_rc", note)
    gateway = lockstep(options)
    gateway.run(READY_MS + 500, lambda: steer(gateway))
    if options is WATCHING:
        gateway.station.command(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1)
        gateway.station.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 1)
        gateway.run(200, lambda: steer(gateway))
        assert gateway.station.acks(mavlink.MAV_CMD_NAV_GUIDED_ENABLE) == [DENIED]
        assert gateway.station.acks(mavlink.MAV_CMD_DO_SET_MODE) == [DENIED]
    assert not sent
    assert gateway.session.firmware.safety.receiver_percent == 0
    assert set(gateway.station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)) <= {DENIED, REJECTED}
    assert not gateway.reply.armed


PX4_OFFBOARD, PX4_HOLD = 6 << 16, 4 << 16 | 3 << 24
SET_MODE = mavlink.MAVLINK_MSG_ID_SET_MODE
DO_SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def choose(station: Station, main: int, sub: int = 0) -> None:
    """Ask for offboard by both messages that set modes, as clients of all customs do."""
    station.command(DO_SET_MODE, 1, main, sub)
    station.link.mav.set_mode_send(1, 1, main << 16 | sub << 24 if main == 6 or sub else main)


@pytest.mark.parametrize(("main", "told"), [(1, 1), (6, PX4_OFFBOARD)])  # all numbers: test_customs.py
def test_each_custom_has_its_number_of_offboard_and_hears_it_in_the_heartbeat(
    lockstep: MakeLockstep, main: int, told: int
) -> None:
    gateway = lockstep()
    station = gateway.station
    choose(station, main)
    gateway.settle()
    assert (station.acks(DO_SET_MODE), station.acks(SET_MODE)) == ([REJECTED], [REJECTED])
    assert "Offboard denied: send setpoints first, then enable" in station.texts()
    gateway.run(1100, lambda: station.rates(0, 0, 0, 0))
    assert not gateway.session.steered
    assert station.got("HEARTBEAT")[-1].custom_mode == 0
    choose(station, main)
    gateway.run(1100, lambda: station.rates(0, 0, 0, 0))
    assert gateway.session.steered and not gateway.reply.armed
    assert (station.acks(DO_SET_MODE)[-1], station.acks(SET_MODE)[-1]) == (ACCEPTED, ACCEPTED)
    assert station.got("HEARTBEAT")[-1].custom_mode == told
    station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    gateway.run(1000, lambda: station.rates(0, 0, 0, 0))
    assert station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)[-1] == ACCEPTED
    gateway.run(400)
    assert not gateway.session.steered, "silence ends it"
    gateway.run(1100, lambda: station.rates(0, 0, 0, 0))
    assert station.got("HEARTBEAT")[-1].custom_mode == 0


def test_who_watches_is_told_a_mode_that_it_knows(lockstep: MakeLockstep) -> None:
    gateway = lockstep(stations=4)
    first, ardupilot, px4, script = gateway.stations
    ardupilot.link.mav.request_data_stream_send(0, 0, 0, 4, 1)
    px4.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    first.rates(0, 0, 0, 0)
    choose(first, 20)
    gateway.run(1100, lambda: first.rates(0, 0, 0, 0))
    modes = [station.got("HEARTBEAT")[-1].custom_mode for station in (first, ardupilot, px4, script)]
    assert modes == [20, 4, PX4_OFFBOARD, 1]
    gateway.run(1500)
    assert {station.got("HEARTBEAT")[-1].custom_mode for station in gateway.stations} == {0}


@pytest.mark.parametrize("options", [WATCHING, Options(offboard=True)], ids=["no offboard", "no arming"])
def test_no_mode_arms_and_none_steers_without_permission(lockstep: MakeLockstep, options: Options) -> None:
    gateway = lockstep(options)
    station = gateway.station
    gateway.run(READY_MS, lambda: station.rates(0, 0, 0, 0))

    def attempts() -> None:
        station.rates(0, 0, 0, 0)
        for main in (1, 4, 6, 20):
            for base in (1, 1 | ARMED, 0xFF):
                station.command(DO_SET_MODE, base, main)
                station.link.mav.set_mode_send(1, base, main << 16 if main == 6 else main)
        station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, 21196)
        station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    gateway.run(600, attempts)
    gateway.run(400, lambda: station.rates(0, 0, 0, 0))
    assert not gateway.reply.armed and not gateway.reply.dshot.any()
    assert gateway.session.steered == options.offboard
    assert set(station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)) == {DENIED}
    if not options.offboard:
        assert {*station.acks(DO_SET_MODE), *station.acks(SET_MODE)} == {DENIED}
        assert (
            "Offboard denied: start the gateway with --offboard to let a companion steer" in station.texts()
        )


def test_a_mode_that_is_chosen_while_it_may_fly_does_not_arm(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    station = gateway.station
    gateway.run(READY_MS, lambda: station.rates(0, 0, 0, 0))

    def attempts() -> None:
        station.rates(0, 0, 0, 0.3)
        station.command(DO_SET_MODE, 1 | ARMED, 6)
        station.link.mav.set_mode_send(1, 1 | ARMED, PX4_OFFBOARD)
        station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, 21196)  # with thrust: whatever forces

    gateway.run(1000, attempts)
    assert gateway.session.steered
    assert set(station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)) == {REJECTED}
    assert not gateway.reply.armed and not gateway.reply.dshot.any()


def test_others_neither_take_over_by_any_mode_nor_end_it_by_hold(lockstep: MakeLockstep) -> None:
    gateway = lockstep(stations=2)
    first, second = gateway.stations
    assert gateway.arm() == ACCEPTED

    def both() -> None:
        first.rates(0, 0, 0, 0.3)
        second.rates(0, 0, 0, 0.3)
        for main in (1, 4, 6, 20):
            choose(second, main)
        choose(second, 4, 3)
        first.link.mav.srcComponent = 7  # another component of the same system
        choose(first, 6)
        choose(first, 4, 3)
        first.link.mav.srcComponent = 191

    gateway.run(400, both)
    assert gateway.session.steered and gateway.reply.armed
    assert set(second.acks(DO_SET_MODE)) == {REJECTED, DENIED}
    assert gateway.station.got("HEARTBEAT")[-1].custom_mode in (0, 1)
    choose(first, 4, 3)
    gateway.settle()
    assert not gateway.session.steered
    assert "Offboard ends: no more channels are sent" in first.texts()


def test_return_to_launch_of_an_ardupilot_client_is_denied(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    station = gateway.station
    station.link.mav.request_data_stream_send(0, 0, 0, 4, 1)
    station.rates(0, 0, 0, 0)
    station.command(DO_SET_MODE, 1, 6)
    station.link.mav.set_mode_send(1, 1, 6)
    gateway.settle()
    assert (station.acks(DO_SET_MODE), station.acks(SET_MODE)) == ([DENIED], [DENIED])
    assert any(text.startswith("Mode denied: there is no mode 6") for text in station.texts())
    assert not gateway.session.steered


def test_arming_is_refused_without_permission_whatever_is_tried(lockstep: MakeLockstep) -> None:
    gateway = lockstep(Options(offboard=True))
    gateway.run(READY_MS)
    assert gateway.enable() == ACCEPTED
    gateway.run(1500, lambda: steer(gateway))
    assert gateway.session.firmware.safety.receiver_percent > 50, "channels come"
    assert set(gateway.station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)) == {DENIED}
    assert not gateway.reply.armed
    assert any("--allow-arm" in text for text in gateway.station.texts())


def test_a_flood_of_what_is_refused_reaches_nobody_else(lockstep: MakeLockstep) -> None:
    gateway = lockstep(stations=2)
    watcher, flooder = gateway.stations
    gateway.run(READY_MS)
    watcher.forget()
    questions = gateway.session.firmware.look
    asked: list[None] = []

    def look() -> None:
        asked.append(None)
        questions()

    def flood() -> None:
        for value in range(20):
            flooder.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
            flooder.command(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1)
            flooder.link.mav.param_set_send(1, 1, b"ROLL_MAX", 1e6 + value, mavlink.MAV_PARAM_TYPE_REAL32)
            gateway.settle()

    gateway.session.firmware.look = look  # type: ignore[method-assign]
    gateway.run(2000, flood, every_ms=50)
    assert len(watcher.texts()) <= 3 * REFUSALS_MAX
    assert any(text.startswith("Arming denied: ") for text in watcher.texts())
    assert any(text.startswith("Offboard denied: ") for text in watcher.texts())
    assert len(asked) <= 2.0 / LOOK_S + 2, "nobody who is refused anyway costs a question to the firmware"
    assert len(watcher.got("HEARTBEAT")) >= 2
    assert len(watcher.got("ATTITUDE")) >= 18
    flooder.forget()
    flooder.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    gateway.settle()
    assert flooder.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM) == [REJECTED], "each is answered"


def test_arming_is_refused_with_thrust_and_from_others(lockstep: MakeLockstep) -> None:
    gateway = lockstep(stations=2)
    first, second = gateway.stations
    gateway.run(READY_MS)
    assert gateway.enable() == ACCEPTED
    gateway.run(400, lambda: first.rates(0, 0, 0, 0.0))
    gateway.run(40, lambda: second.rates(0, 0, 0, 0.0))
    second.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    second.command(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1)
    gateway.settle()
    assert second.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM) == [REJECTED]
    assert second.acks(mavlink.MAV_CMD_NAV_GUIDED_ENABLE) == [REJECTED]
    first.rates(0, 0, 0, 0.3)
    first.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    gateway.run(200, lambda: first.rates(0, 0, 0, 0.3))
    assert first.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM) == [REJECTED]
    assert not gateway.reply.armed


def test_the_switch_goes_off_again_when_the_firmware_does_not_arm(lockstep: MakeLockstep) -> None:
    gateway = lockstep(flown={"arming_delay_ms": 3000})
    station = gateway.station
    assert gateway.enable() == ACCEPTED
    station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    gateway.run(1200, lambda: station.rates(0, 0, 0, 0))
    assert station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM) == [IN_PROGRESS, FAILED]
    assert station.texts()[-1].startswith("Not ready: boot grace: it has just started")
    gateway.run(2200, lambda: station.rates(0, 0, 0, 0))
    assert not gateway.session.firmware.safety.arming_flags, "it could arm now"
    assert not gateway.reply.armed
    station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    gateway.run(200, lambda: station.rates(0, 0, 0, 0))
    assert station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)[-1] == ACCEPTED
    assert gateway.reply.armed


def test_a_command_to_arm_waits_until_the_firmware_is_ready(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    gateway.run(700, lambda: gateway.station.rates(0, 0, 0, 0))
    assert gateway.enable() == ACCEPTED
    gateway.station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    gateway.run(900, lambda: gateway.station.rates(0, 0, 0, 0))
    assert gateway.station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM) == [IN_PROGRESS, ACCEPTED]


def test_arming_goes_on_at_once_after_disarming(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    assert gateway.arm() == ACCEPTED
    gateway.station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    gateway.station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    gateway.run(500, lambda: gateway.station.rates(0, 0, 0, 0))
    acks = gateway.station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
    assert acks[-4:] == [IN_PROGRESS, CANCELLED, IN_PROGRESS, ACCEPTED]
    assert gateway.reply.armed


def test_arming_is_refused_when_the_rates_flown_are_not_those_of_the_settings(lockstep: MakeLockstep) -> None:
    gateway = lockstep(flown={"roll_max": 200.0, "roll_rate": 200.0})
    gateway.run(READY_MS)
    assert gateway.enable() == ACCEPTED
    gateway.run(1500, lambda: gateway.station.rates(2.0, 0, 0, 0))
    assert "Rates flown are not those of the settings: disarm, reboot" in gateway.station.texts()
    gateway.station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    gateway.run(200, lambda: gateway.station.rates(0, 0, 0, 0))
    assert gateway.station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM) == [REJECTED]
    assert not gateway.reply.armed


def test_offboard_ends_when_the_receiver_flown_is_another(lockstep: MakeLockstep) -> None:
    gateway = lockstep(flown={"receiver_protocol": 0})
    assert gateway.enable() == ACCEPTED
    gateway.run(100, lambda: gateway.station.rates(0, 0, 0, 0))
    assert "No channels taken: receiver_protocol msp is not flown yet, reboot" in gateway.station.texts()
    assert gateway.station.got("HEARTBEAT") and not gateway.session.steered


def test_garbage_changes_nothing(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    chance = random.Random(19)
    packet = bytes(
        mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(gateway.station.link.mav)
    )

    def garbage() -> None:
        noise = bytearray(packet * chance.randrange(1, 10))
        for _ in range(chance.randrange(1, 20)):
            noise[chance.randrange(len(noise))] = chance.randrange(256)
        gateway.station.raw(bytes(noise[: chance.randrange(len(noise))]))
        gateway.station.raw(chance.randbytes(chance.randrange(1500)))
        gateway.station.rates(math.nan, math.inf, -math.inf, math.nan)

    gateway.run(1000, garbage, every_ms=2)
    assert gateway.session.firmware.safety.state in (FlightState.CALIBRATING, FlightState.DISARMED)
    assert len(gateway.station.got("HEARTBEAT")) >= 1
    gateway.station.link.mav.param_request_read_send(1, 1, b"roll_rate", -1)
    gateway.settle()
    assert [number(m) for m in gateway.station.got("PARAM_VALUE")] == [70.0]


def test_nothing_arms_and_nothing_is_raised_whatever_good_packets_hold(lockstep: MakeLockstep) -> None:
    gateway = lockstep()
    chance = random.Random(19)
    mav = gateway.station.link.mav
    numbers = [mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT, *mavlink.mavlink_map]
    commands = [row[0] for row in RESULTS]

    def packets() -> None:
        for number in (*numbers[:2] * 4, *numbers):
            kind = mavlink.mavlink_map[number]
            payload = bytearray(chance.randbytes(kind.unpacker.size))
            if number in numbers[:2]:  # meant for the aircraft, of a command that it knows, one parameter
                payload = bytearray(struct.pack("<7f", *[chance.choice((0, 1, 2, math.nan))] * 7))
                command = chance.choice(commands)
                if command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
                    continue
                payload += struct.pack("<HBBBBB", command, 1, 1, 0, 0, 0)[: kind.unpacker.size - 28]
            message = mavlink.MAVLink_message(number, kind.msgname)
            gateway.station.raw(bytes(message._pack(mav, kind.crc_extra, bytes(payload))))
            gateway.settle()

    gateway.run(400, packets, every_ms=100)
    assert not gateway.reply.armed
    assert gateway.station.got("COMMAND_ACK")
    gateway.station.forget()
    gateway.run(1100)
    assert gateway.station.got("HEARTBEAT")


# --- A firmware that goes --------------------------------------------------------------------------
class Mutable:
    """A line to a firmware whose answers may stay away, with a clock that only waiting moves."""

    def __init__(self, port: int) -> None:
        self._inner = TcpTransport(TcpPort(LOOPBACK, port))
        self.name = "tcp"
        self.muted = False
        self.now = 0.0

    def read(self, timeout: float) -> bytes:
        if self.muted:
            self.now += timeout
            return b""
        return self._inner.read(timeout)

    def write(self, data: bytes) -> None:
        if not self.muted:
            self._inner.write(data)

    def close(self) -> None:
        self._inner.close()

    def clock(self) -> float:
        return self.now


def test_no_heartbeat_comes_while_the_firmware_is_silent_and_nobody_steers_after_it(
    resting_host: str,
) -> None:
    line = Mutable(int(resting_host.rpartition(":")[2]))
    station = Station(201)
    with Client(line, line.clock) as client:
        session = Session(client, [UdpPeer(parse_address(station.address))], Options(), line.clock)

        def run(seconds: float) -> None:
            end = line.now + seconds
            while line.now < end:
                line.now += min(session.step(), 0.05) or 0.001

        run(3.0)
        assert len(station.got("HEARTBEAT")) >= 3
        line.muted = True
        run(3.0)
        assert "The flight controller does not answer" in station.texts()
        station.forget()
        station.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 1)
        run(5.0)
        assert not station.got("HEARTBEAT")
        assert station.acks(mavlink.MAV_CMD_DO_SET_MODE) == [REJECTED]
        line.muted = False
        run(3.0)
        assert station.got("HEARTBEAT")
        assert station.texts()[0].startswith("Neuroflight 0.1.0")
    station.close()


class Cut:
    """A line that can be cut, and then does not open again before it may."""

    def __init__(self, line: Transport) -> None:
        self._line, self.name, self.cut = line, line.name, False

    def read(self, timeout: float) -> bytes:
        self._check()
        return self._line.read(timeout)

    def write(self, data: bytes) -> None:
        self._check()
        self._line.write(data)

    def close(self) -> None:
        self._line.close()

    def _check(self) -> None:
        if self.cut:
            raise LineGoneError("the line is gone")


class Opener:
    """Opens lines while it may."""

    def __init__(self) -> None:
        self.may, self.opened = True, list[Cut]()

    def __call__(self, line: Transport) -> Cut:
        if not self.may:
            line.close()
            raise LinkError("nobody listens")
        self.opened.append(Cut(line))
        return self.opened[-1]


def test_a_line_that_goes_is_opened_again_and_nobody_steers_then(lockstep: MakeLockstep) -> None:
    opener = Opener()
    gateway = lockstep(through=opener)
    station = gateway.station
    assert gateway.arm() == ACCEPTED
    gateway.run(400, lambda: station.rates(0, 0, 0, 0.3))
    opener.may, opener.opened[-1].cut = False, True
    gateway.run(200, lambda: station.rates(0, 0, 0, 0.3))
    assert not gateway.session.steered
    assert "The line to the flight controller is gone; it has 60 s to come back" in station.texts()
    station.forget()
    station.command(DO_SET_MODE, 1, 6)
    gateway.run(1000, lambda: station.rates(0, 0, 0, 0.3))
    assert station.acks(DO_SET_MODE) == [REJECTED] and not station.got("HEARTBEAT")
    assert gateway.session.firmware.armed, "as far as it knows"
    opener.may = True
    gateway.run(1500, lambda: station.rates(0, 0, 0, 0.3))
    assert not gateway.reply.dshot.any() and not gateway.session.steered, "the failsafe has acted"
    assert station.got("HEARTBEAT") and len(station.got("ATTITUDE")) >= 8
    assert any(text.startswith("Neuroflight 0.1.0") for text in station.texts())
    assert gateway.enable() == ACCEPTED
    gateway.run(100, lambda: station.rates(0, 0, 0, 0))
    assert not gateway.reply.armed


def test_a_line_that_does_not_come_back_ends_the_gateway_after_a_minute(lockstep: MakeLockstep) -> None:
    opener = Opener()
    gateway = lockstep(WATCHING, through=opener)
    opener.may, opener.opened[-1].cut = False, True
    gateway.run(200)
    gateway.samples += 59 * GYRO_HZ  # the clock alone goes on
    gateway.settle()
    gateway.samples += 2 * GYRO_HZ
    with pytest.raises(LinkError, match="nobody listens"):
        gateway.settle()
    assert gateway.lines.count("The line to the flight controller is gone; it has 60 s to come back") == 1


def test_a_firmware_of_another_make_is_refused(tcp_server: Callable[[Callable[[bytes], bytes]], str]) -> None:
    with (
        Client(open_transport(tcp_server(answering({Msp.API_VERSION: bytes([0, 1, 47])})))) as client,
        pytest.raises(LinkError, match="another make"),
    ):
        Session(client, [], Options(), lambda: 0.0)
