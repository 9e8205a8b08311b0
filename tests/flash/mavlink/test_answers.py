"""Answers that every client waits for: pings, times, and refusals of missions and files."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink.session import Options
from tests.flash.mavlink.conftest import GYRO_HZ, Lockstep, MakeLockstep

WATCHING = Options()
OWN = (201, 191)  # system and component of the station
ACK, NAK, UNKNOWN_COMMAND = 128, 129, 7
ACCEPTED, UNSUPPORTED, NO_SUCH = 0, 3, 13  # MAV_MISSION_RESULT


def asked(gateway: Lockstep, kind: str) -> list[Any]:
    """Return the answers of that type to a message."""
    gateway.settle()
    return gateway.station.got(kind)


def test_a_ping_comes_back_to_who_sent_it(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    gateway.station.link.mav.ping_send(123_456, 7, 0, 0)
    gateway.station.link.mav.ping_send(1, 8, 1, 1)  # an answer to one of ours, which we never sent
    (back,) = asked(gateway, "PING")
    assert (back.time_usec, back.seq, back.target_system, back.target_component) == (123_456, 7, *OWN)


def test_time_is_told_as_telemetry_has_it(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    # A sample is seen beside an answer: the more is asked the less it has waited.
    gateway.run(1007, lambda: gateway.station.link.mav.param_request_read_send(1, 1, b"", 0), every_ms=7)
    gateway.station.link.mav.timesync_send(0, 42)
    gateway.station.link.mav.timesync_send(99, 43)  # an answer
    (told,) = asked(gateway, "TIMESYNC")
    assert told.ts1 == 42
    assert told.tc1 == pytest.approx(1e9 * gateway.samples / GYRO_HZ, abs=8e6)
    attitude = gateway.station.got("ATTITUDE")[-1]
    assert 0 <= told.tc1 / 1e6 - attitude.time_boot_ms < 150


def test_there_are_no_files(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    for opcode in (*range(16), 77):
        payload = [0xFF, 0xFF, 5, opcode, 200, 0, 0, 0, 1, 2, 3, 4, *b"@PARAM/param.pck", *[9] * 223]
        gateway.station.forget()
        gateway.station.link.mav.file_transfer_protocol_send(0, 1, 1, payload)
        (told,) = asked(gateway, "FILE_TRANSFER_PROTOCOL")
        answer, size = (NAK, 1) if opcode > 2 else (ACK, 0)  # there is no session to end
        assert told.payload[:6] == [0, 0, 5, answer, size, opcode]  # the number after its own
        assert told.payload[12 : 12 + size] == [UNKNOWN_COMMAND][:size]
        assert (told.target_system, told.target_component) == OWN


def test_an_answer_about_files_is_not_answered(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    for opcode in (ACK, NAK):
        gateway.station.link.mav.file_transfer_protocol_send(0, 1, 1, [0, 0, 0, opcode, *[0] * 247])
    assert not asked(gateway, "FILE_TRANSFER_PROTOCOL")


FENCE = mavlink.MAV_MISSION_TYPE_FENCE
ITEM = (0, 6, 16, 0, 1, 0, 0, 0, 0)  # number, frame, command ..
MISSIONS = [
    (mavlink.MAVLink_mission_count_message(1, 1, 3, FENCE), UNSUPPORTED, FENCE),
    (mavlink.MAVLink_mission_count_message(1, 1, 0, 0), ACCEPTED, 0),
    (mavlink.MAVLink_mission_clear_all_message(1, 1, 255), ACCEPTED, 255),
    (mavlink.MAVLink_mission_item_int_message(1, 1, *ITEM, 1, 2, 3, 0), UNSUPPORTED, 0),
    (mavlink.MAVLink_mission_item_message(1, 1, *ITEM, 1, 2, 3, 0), UNSUPPORTED, 0),
    (mavlink.MAVLink_mission_request_int_message(1, 1, 0, 0), NO_SUCH, 0),
    (mavlink.MAVLink_mission_request_message(1, 1, 0, 0), NO_SUCH, 0),
    (mavlink.MAVLink_mission_set_current_message(1, 1, 2), NO_SUCH, 0),
    (mavlink.MAVLink_mission_write_partial_list_message(1, 1, 0, 1, 0), UNSUPPORTED, 0),
]


def test_there_are_no_missions(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    for message, result, kind in MISSIONS:
        gateway.station.forget()
        gateway.station.link.mav.send(message)
        (told,) = asked(gateway, "MISSION_ACK")
        assert (told.target_system, told.target_component) == OWN
        assert (told.type, told.mission_type) == (result, kind), message


def test_what_is_meant_for_others_is_not_answered(lockstep: MakeLockstep) -> None:
    gateway = lockstep(WATCHING)
    mav = gateway.station.link.mav
    mav.mission_count_send(2, 1, 3)
    mav.file_transfer_protocol_send(0, 2, 1, [0, 0, 0, 4, *[0] * 247])
    mav.set_mode_send(2, 1, 1)
    gateway.settle()
    gateway.station.read()
    kinds = {message.get_type() for message in gateway.station.inbox}
    assert not kinds & {"MISSION_ACK", "FILE_TRANSFER_PROTOCOL", "COMMAND_ACK"}
