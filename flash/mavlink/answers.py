"""Answers to what clients ask of every autopilot: whether it hears them, its time; and refusals of what this
one has not, which they wait for otherwise: missions and files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink.offboard import Source

Msg = Any  # a message of pymavlink, which has no types
Answer = Callable[[Source, Msg, int], Msg | None]  # the last: nanoseconds since the firmware's start

ACCEPTED, UNSUPPORTED, NO_SUCH = (
    mavlink.MAV_MISSION_ACCEPTED,
    mavlink.MAV_MISSION_UNSUPPORTED,
    mavlink.MAV_MISSION_INVALID_SEQUENCE,
)
EVERYBODY = (0, 0)  # system and component

# The head of FILE_TRANSFER_PROTOCOL's payload, and what of it is used.
FTP_BYTES, FTP_HEAD = 251, 12
FTP_OPCODE, FTP_SIZE, FTP_REQUEST = 3, 4, 5
# Requests to end a session succeed, because there is none.
FTP_ENDS = frozenset(
    {
        mavlink.MAV_FTP_OPCODE_NONE,
        mavlink.MAV_FTP_OPCODE_TERMINATESESSION,
        mavlink.MAV_FTP_OPCODE_RESETSESSION,
    }
)


def ping(source: Source, message: Msg, now_ns: int) -> Msg | None:
    """Return the answer to a PING; None for a message that is itself an answer."""
    if (message.target_system, message.target_component) != EVERYBODY:
        return None
    return mavlink.MAVLink_ping_message(message.time_usec, message.seq, *source[1:])


def timesync(source: Source, message: Msg, now_ns: int) -> Msg | None:
    """Return TIMESYNC with telemetry's time; None for a message that is itself an answer."""
    return mavlink.MAVLink_timesync_message(max(now_ns, 1), message.ts1) if message.tc1 == 0 else None


def file_transfer(source: Source, message: Msg, now_ns: int) -> Msg | None:
    """Return the refusal of a FILE_TRANSFER_PROTOCOL request, as there are no files; None for an answer."""
    asked = bytes(message.payload)
    opcode = asked[FTP_OPCODE]
    if opcode in (mavlink.MAV_FTP_OPCODE_ACK, mavlink.MAV_FTP_OPCODE_NAK):
        return None
    ends = opcode in FTP_ENDS
    head = bytearray(asked[:FTP_HEAD])
    head[0:2] = ((int.from_bytes(asked[0:2], "little") + 1) & 0xFFFF).to_bytes(2, "little")  # its number
    head[FTP_OPCODE] = mavlink.MAV_FTP_OPCODE_ACK if ends else mavlink.MAV_FTP_OPCODE_NAK
    head[FTP_SIZE], head[FTP_REQUEST] = int(not ends), opcode
    error = b"" if ends else bytes([mavlink.MAV_FTP_ERR_UNKNOWNCOMMAND])
    payload = (bytes(head) + error).ljust(FTP_BYTES, b"\0")
    return mavlink.MAVLink_file_transfer_protocol_message(0, *source[1:], list(payload))


def _mission(result: int) -> Answer:
    """Return a function that answers by MISSION_ACK with `result`."""

    def answer(source: Source, message: Msg, now_ns: int) -> Msg:
        kind = getattr(message, "mission_type", mavlink.MAV_MISSION_TYPE_MISSION)
        return mavlink.MAVLink_mission_ack_message(*source[1:], result, kind)

    return answer


def mission_count(source: Source, message: Msg, now_ns: int) -> Msg:
    """Return MISSION_ACK: only an empty mission may be uploaded."""
    return _mission(UNSUPPORTED if message.count else ACCEPTED)(source, message, now_ns)


def mission_list(source: Source, message: Msg, now_ns: int) -> Msg:
    """Return MISSION_COUNT: there are no items."""
    return mavlink.MAVLink_mission_count_message(*source[1:], 0, message.mission_type)


ANSWERS: dict[str, Answer] = {
    "PING": ping,
    "TIMESYNC": timesync,
    "FILE_TRANSFER_PROTOCOL": file_transfer,
    "MISSION_REQUEST_LIST": mission_list,
    "MISSION_REQUEST_PARTIAL_LIST": _mission(NO_SUCH),
    "MISSION_REQUEST": _mission(NO_SUCH),
    "MISSION_REQUEST_INT": _mission(NO_SUCH),
    "MISSION_COUNT": mission_count,
    "MISSION_CLEAR_ALL": _mission(ACCEPTED),
    "MISSION_SET_CURRENT": _mission(NO_SUCH),
    "MISSION_WRITE_PARTIAL_LIST": _mission(UNSUPPORTED),
    "MISSION_ITEM": _mission(UNSUPPORTED),
    "MISSION_ITEM_INT": _mission(UNSUPPORTED),
}
