"""msp.c, msp_port.c and msp_replies.c: bytes in, reply bytes out."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import reduce
from operator import xor
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link import layouts, messages, records
from neuroflight.flash.link.messages import PolicyInfo, PolicySource
from neuroflight.toolchain.contract import (
    MSP_PAYLOAD_MAX,
    ArmingReason,
    FlightState,
    Mix,
    Msp,
    Refusal,
    layout_of,
)
from tests.firmware.receiver.test_crsf import crc as crc8

IDENTITY = {"board": b"BRD1", "target": b"TARGETNAME", "maker": b"MAKR", "mcu": b"CHIP"}
UNIQUE_ID = (0x01020304, 0x11121314, 0x21222324)


def v1(command: int, payload: bytes = b"", direction: bytes = b"<") -> bytes:
    body = bytes([len(payload), command]) + payload
    return b"$M" + direction + body + bytes([reduce(xor, body)])


def jumbo(command: int, payload: bytes) -> bytes:
    body = struct.pack("<BBH", 255, command, len(payload)) + payload
    return b"$M<" + body + bytes([reduce(xor, body)])


def v2(command: int, payload: bytes = b"", direction: bytes = b"<") -> bytes:
    body = struct.pack("<BHH", 0, command, len(payload)) + payload
    return b"$X" + direction + body + bytes([crc8(body)])


class Server:
    def __init__(self, core: Any, **status: object) -> None:
        self.core = core
        self._texts = {name: core.new("char[]", text) for name, text in IDENTITY.items()}
        self._identity = core.new("struct board_identity *", {**self._texts, "unique_id": UNIQUE_ID})
        self._port = core.new("struct msp_port *")
        self._status = core.new("struct firmware_status *", {"gyro_rate_hz": 4000, **status})
        self._settings, self._pid = core.new("struct nf_settings *"), core.new("struct pid_gains *")
        core.lib.settings_default(self._settings)
        self._settings.msp_variant = 1  # nrfl
        found = [core.lib.NF_ERR_BLOB_MAGIC] * 2
        slots = {"found": found, "flown": core.lib.POLICY_SOURCE_COUNT}
        self._slots = core.new("struct policy_slots *", slots)
        self._calls = {
            "session": core.ffi.callback("uint8_t(void *, bool)", lambda _, on: Refusal.ARMED),
            "arming": core.ffi.callback("uint8_t(void *, struct msp_peer *, bool, bool)", lambda *_: 0),
            "heard": core.ffi.callback("void(void *, const struct msp_peer *)", lambda *_: None),
        }
        parts = {"identity": self._identity, "settings": self._settings, "slots": self._slots}
        self._services = core.new("struct services *", {**parts, "pid": self._pid, **self._calls})
        core.lib.msp_port_init(self._port, self._services)

    def send(self, data: bytes, capacity: int = 4096) -> bytes:
        out = self.core.new("uint8_t[]", b"\xa5" * (capacity + 16))
        count = self.core.lib.msp_port_serve(self._port, self._status, data, len(data), out, capacity)
        reply = bytes(out)
        assert count <= capacity
        assert set(reply[capacity : capacity + 16]) == {0xA5}, "written past the end"
        return reply[:count]

    def ask(self, command: int) -> bytes:
        """Payload of the reply, asked in v2."""
        reply = self.send(v2(command))
        payload = reply[8:-1]
        assert reply == v2(command, payload, b">")
        return payload

    def reset(self) -> None:
        self.core.lib.msp_port_reset(self._port)


MakeServer = Callable[..., Server]


@pytest.fixture
def make_server(scripted: Any) -> MakeServer:
    return lambda **status: Server(scripted, **status)


@pytest.fixture
def server(make_server: MakeServer) -> Server:
    return make_server()


# What reads no more than status, identity and settings; the others are in test_msp_commands.py.
READING = {
    *(Msp.API_VERSION, Msp.FC_VARIANT, Msp.FC_VERSION, Msp.BOARD_INFO, Msp.BUILD_INFO, Msp.NAME, Msp.STATUS),
    *(Msp.RAW_IMU, Msp.MOTOR, Msp.RC, Msp.ATTITUDE, Msp.ANALOG, Msp.BATTERY_STATE, Msp.STATUS_EX, Msp.UID),
    *(Msp.VOLTAGE_METERS, Msp.CURRENT_METERS, Msp.BOXNAMES, Msp.BOXIDS, Msp.PIDNAMES, Msp.MCU_INFO),
    *(Msp.IDENTITY, Msp.POLICY_INFO, Msp.SAFETY),
}
VERSION_REPLY = v1(Msp.API_VERSION, bytes([0, 1, 47]), b">")


# --- Frames -----------------------------------------------------------------------------------


def test_the_reply_is_known_when_the_request_is_of_either_version(server: Server) -> None:
    assert server.send(b"$M<\x00\x01\x01") == b"$M>\x03\x01\x00\x01\x2f\x2c"
    assert server.send(v2(Msp.API_VERSION)) == v2(Msp.API_VERSION, bytes([0, 1, 47]), b">")


@pytest.mark.parametrize("command", sorted(READING))
def test_each_command_is_answered_in_the_version_it_was_asked(make_server: MakeServer, command: Msp) -> None:
    payload = make_server().ask(command)
    assert payload
    if command < 255:
        assert make_server().send(v1(command)) == v1(command, payload, b">")


def test_unknown_commands_are_refused_when_they_are_asked(server: Server) -> None:
    for command in range(255):
        if command not in set(Msp):
            assert server.send(v1(command)) == v1(command, b"", b"!")
    for command in (0x1000, 0x4E00, 0xFFFF):
        assert server.send(v2(command, b"some payload")) == v2(command, b"", b"!")


@pytest.mark.parametrize(
    "request_bytes", [v1(1), v1(1, b"12345"), v2(1), v2(1, b"x" * 300), jumbo(1, b"y" * 300)]
)
def test_a_request_is_answered_once_when_it_is_cut_anywhere(server: Server, request_bytes: bytes) -> None:
    whole = server.send(request_bytes)
    assert whole[3:] == VERSION_REPLY[3:] or whole == v2(1, bytes([0, 1, 47]), b">")
    for cut in range(1, len(request_bytes)):
        assert server.send(request_bytes[:cut]) == b""
        assert server.send(request_bytes[cut:]) == whole
    assert b"".join(server.send(request_bytes[i : i + 1]) for i in range(len(request_bytes))) == whole


def test_requests_are_found_when_they_stand_among_noise(server: Server) -> None:
    assert server.send(b"\x00$$M<\xff" + b"garbage") == b""
    server.reset()
    assert (
        server.send(b"$" + v1(1) + b"$X" + b"noise" + v1(1) + b"$M>\x00\x01\x01" + v1(1)) == VERSION_REPLY * 3
    )


@pytest.mark.parametrize("size", [MSP_PAYLOAD_MAX + 1, 0xFFFF])
def test_the_line_is_free_again_when_a_request_claims_too_much(server: Server, size: int) -> None:
    assert server.send(b"$X<" + struct.pack("<BHH", 0, 1, size) + v1(1)) == VERSION_REPLY
    assert server.send(b"$M<" + struct.pack("<BBH", 255, 1, size) + v1(1)) == VERSION_REPLY
    assert len(server.send(v2(1, b"z" * MSP_PAYLOAD_MAX))) > 0


def test_a_reply_is_dropped_whole_when_there_is_no_room_for_it(server: Server) -> None:
    length = len(VERSION_REPLY)
    for capacity in range(3 * length + 1):
        assert server.send(v1(1) * 3, capacity) == VERSION_REPLY * (capacity // length)


def test_any_bytes_are_survived_when_they_are_random(server: Server) -> None:
    rng = np.random.default_rng(13)
    alphabet = np.frombuffer(b"$MX<>\x00\x01\x02\x65\xff", np.uint8)
    for _ in range(500):
        server.send(rng.choice(alphabet, 300).tobytes(), int(rng.integers(0, 200)))
        server.send(rng.integers(0, 256, 300, np.uint8).tobytes(), int(rng.integers(0, 200)))
    server.reset()
    assert server.send(v1(1)) == VERSION_REPLY


# --- Replies ----------------------------------------------------------------------------------
def test_who_it_is_comes_from_identity_and_contract_when_asked(server: Server) -> None:
    assert server.ask(Msp.FC_VARIANT) == b"NRFL"
    assert server.ask(Msp.FC_VERSION) == bytes([25, 12, 0, 9]) + b"2025.12.0"
    assert server.ask(Msp.UID) == struct.pack("<3I", *UNIQUE_ID)
    assert server.ask(Msp.NAME) == b"none"
    board = messages.board_info(server.ask(Msp.BOARD_INFO))
    assert (board.identifier, board.target, board.manufacturer) == ("BRD1", "TARGETNAME", "MAKR")
    assert board.name == "Neuroflight 0.1.0 none"
    assert server.ask(Msp.BUILD_INFO)[26:] == struct.pack("<4H", 4103, 4097, 8231, 0)
    told = layouts.decode(layout_of(Msp.IDENTITY), server.ask(Msp.IDENTITY), whole=True)
    assert told == {
        **{"firmware": "Neuroflight", "major": 0, "minor": 1, "patch": 0, "api_major": 1, "api_minor": 47},
        **{"target": "TARGETNAME", "variant": "NRFL", "policy": "none"},
        "policy_sha256": bytes(32),
    }


@pytest.mark.parametrize(("chip", "board_type"), [(False, 0), (True, 2)])
def test_the_board_type_tells_an_osd_chip_when_there_is_one(
    server: Server, chip: bool, board_type: int
) -> None:
    server._identity.osd_chip = chip
    assert server.ask(Msp.BOARD_INFO)[6] == board_type


def test_policy_info_tells_what_the_code_is_for_when_no_policy_is_there(make_server: MakeServer) -> None:
    assert messages.policy_info(make_server(policy_good=True).ask(Msp.POLICY_INFO)) == PolicyInfo(
        name="none",
        sha256="00" * 32,
        architecture_hash=0x01234567,
        observation_count=17,
        action_count=4,
        weight_count=2,
        control_rate_hz=1000,
        gyro_rate_hz=4000,
        good=True,
        idle=0.0,
        source=PolicySource.NONE,
        sequence=0,
        found=(-7, -7),
        mix=Mix.ATTITUDE_FIRST,
    )
    assert not messages.policy_info(make_server(policy_good=False).ask(Msp.POLICY_INFO)).good


@pytest.mark.parametrize("armed", [False, True])
def test_status_tells_arming_and_its_reasons_when_asked(make_server: MakeServer, armed: bool) -> None:
    flags = 1 << ArmingReason.POLICY_BAD | 1 << ArmingReason.BOOT_GRACE
    s = make_server(trace={"armed": armed}, arming_reasons=flags, load_percent=37)
    extended = messages.status_ex(s.ask(Msp.STATUS_EX))
    assert extended.status == messages.status(s.ask(Msp.STATUS))
    assert extended.status.armed is armed
    assert extended.status.cycle_time_us == 1000
    assert extended.status.load_percent == 37
    assert extended.arming_flag_count == 32
    assert extended.arming_flags == 1 << 9 | 1 << 30  # BOOT_GRACE_TIME, and none of the ecosystem's
    assert messages.arming_reasons(records.safety(s.ask(Msp.SAFETY)).arming_flags) == (
        "BOOT_GRACE",
        "POLICY_BAD",
    )


@pytest.mark.parametrize(
    ("reason", "bit"),
    [
        *((ArmingReason.BOOT_GRACE, 9), (ArmingReason.GYRO_NOT_CALIBRATED, 12), (ArmingReason.MSP, 16)),
        *((ArmingReason.RECEIVER_LOST, 2), (ArmingReason.THROTTLE_HIGH, 7), (ArmingReason.NOT_LEVEL, 8)),
        *((ArmingReason.SWITCH_NOT_CYCLED, 3), (ArmingReason.GYRO_BAD, 0), (ArmingReason.CRASHED, 6)),
        *((ArmingReason.LOAD, 11), (ArmingReason.MOTOR_TEST, 16), (ArmingReason.CLI, 13)),
        *((ArmingReason.POLICY_BAD, 30), (ArmingReason.POLICY_REFUSED, 30), (ArmingReason.PID_MISSING, 30)),
        *((ArmingReason.BATTERY_UNKNOWN, 29), (ArmingReason.FAULT, 28), (ArmingReason.STORING, 9)),
        *((ArmingReason.GYRO_ALIGNMENT, 29), (ArmingReason.CLOCK, 28), (ArmingReason.SETTINGS, 29)),
        *((ArmingReason.PROBATION, 9), (ArmingReason.IMAGE_BAD, 28)),
    ],
)
def test_each_reason_has_the_ecosystems_number_when_status_is_asked(
    make_server: MakeServer, reason: ArmingReason, bit: int
) -> None:
    assert (
        messages.status_ex(make_server(arming_reasons=1 << reason).ask(Msp.STATUS_EX)).arming_flags
        == 1 << bit
    )
    both = make_server(arming_reasons=1 << reason, modes=1).ask(Msp.STATUS_EX)
    assert messages.status_ex(both).arming_flags == 1 << bit | 1 << 31, "the arm switch is on"


@pytest.mark.parametrize("state", FlightState)
def test_failsafe_is_told_when_the_state_is_one_of_it(make_server: MakeServer, state: FlightState) -> None:
    flags = messages.status_ex(make_server(state=state).ask(Msp.STATUS_EX)).arming_flags
    assert flags == (2 if state in (FlightState.FAILSAFE_HOLD, FlightState.FAILSAFE_DROP) else 0)


@pytest.mark.parametrize(
    ("switches", "armed", "modes"), [(0, 0, 0), (1, 0, 0), (1, 1, 1), (63, 0, 62), (6, 1, 7)]
)
def test_modes_are_told_in_the_order_of_their_names_when_switched(
    make_server: MakeServer, switches: int, armed: int, modes: int
) -> None:
    s = make_server(modes=switches, trace={"armed": armed})
    assert s.ask(Msp.BOXNAMES) == b"ARM;BEEPER;BLACKBOX;PID;TRIAL;CHIRP;"
    assert s.ask(Msp.BOXIDS) == bytes([0, 13, 26, 40, 41, 55])
    assert messages.status(s.ask(Msp.STATUS)).modes == modes


BATTERY = {"volts": 15.672, "amps": 23.456, "drawn_mah": 812.4, "cells": 4, "battery_level": 2}


def test_the_battery_is_told_alike_when_asked_either_way(make_server: MakeServer) -> None:
    s = make_server(**BATTERY)
    assert s.ask(Msp.ANALOG) == struct.pack("<BHHhH", 157, 812, 0, 2346, 1567)
    assert s.ask(Msp.BATTERY_STATE) == struct.pack("<BHBHhBH", 4, 0, 157, 812, 2346, 1, 1567)
    assert messages.battery_state(s.ask(Msp.BATTERY_STATE)) == messages.BatteryState(
        cells=4, level=messages.BatteryLevel.WARNING, voltage_v=15.67, drawn_mah=812, current_a=23.46
    )


@pytest.mark.parametrize(("level", "state"), [(0, 3), (1, 0), (2, 1), (3, 2), (4, 3), (255, 3)])
def test_the_batterys_state_is_the_ecosystems_when_asked(
    make_server: MakeServer, level: int, state: int
) -> None:
    assert make_server(battery_level=level).ask(Msp.BATTERY_STATE)[8] == state


def test_reasons_are_told_when_no_gyro_sample_ever_came(scripted: Any) -> None:
    memory = scripted.new("uint64_t[]", scripted.lib.reference_size() // 8 + 1)
    scripted.lib.scripted_action = [0.0] * 4
    assert scripted.lib.reference_init(memory, 4000, scripted.ffi.NULL, 0) == 0
    out = scripted.new("uint8_t[256]")
    ask = v2(Msp.SAFETY)
    count = scripted.lib.reference_link(memory, 0, ask, len(ask), out, len(out))
    safety = records.safety(bytes(out)[8 : count - 1])
    assert set(messages.arming_reasons(safety.arming_flags)) == {
        "BOOT_GRACE",
        "GYRO_NOT_CALIBRATED",
        "RECEIVER_LOST",
        "SWITCH_NOT_CYCLED",
        "NOT_LEVEL",
        "BATTERY_UNKNOWN",
    }
