"""MSP over TCP at the host program: one peer at a time, and yamspy as an independent one."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import serial
from yamspy import MSPy

from toolchain import contract

WAIT_S = 5.0  # how long an answer may take before the test fails
API_REQUEST, API_REPLY = b"$M<\x00\x01\x01", b"$M>\x03\x01\x00\x01\x2e\x2d"
Start = Callable[..., Any]


def test_msp_is_answered_when_no_simulator_is_there(start: Start) -> None:
    p = start()
    with p.connect() as peer:
        for _ in range(3):
            peer.sendall(API_REQUEST)
            assert peer.recv(100) == API_REPLY


def test_a_second_peer_is_turned_away_and_the_first_served_when_both_call(start: Start) -> None:
    p = start("--gyro-hz=1000")
    with p.connect() as first, p.connect() as second:
        first.sendall(API_REQUEST)
        assert first.recv(100) == API_REPLY
        assert second.recv(100) == b""
        first.sendall(API_REQUEST)
        assert first.recv(100) == API_REPLY
        assert p.step() == (0, 0, 0, 0)
    with p.connect() as third:
        third.sendall(API_REQUEST)
        assert third.recv(100) == API_REPLY


def test_half_a_request_does_not_spoil_the_next_peer_when_its_sender_hangs_up(start: Start) -> None:
    p = start()
    with p.connect() as rude:
        rude.sendall(b"$X<\x00\x01\x00\xff\x01half")
    with p.connect() as polite:
        polite.sendall(API_REQUEST)
        assert polite.recv(100) == API_REPLY


def test_flight_goes_on_when_a_peer_never_reads_its_replies(start: Start) -> None:
    p = start("--gyro-hz=1000")
    with p.connect() as deaf:
        deaf.setblocking(False)
        with contextlib.suppress(BlockingIOError, ConnectionError):
            for _ in range(100_000):
                deaf.send(API_REQUEST * 40)
        for _ in range(20):
            assert p.step() == (0, 0, 0, 0)


def test_yamspy_reads_who_and_how_it_is_when_it_calls_over_tcp(start: Start, host_program: Path) -> None:
    p = start("--gyro-hz=1000", build=host_program.parent)
    for _ in range(contract.RECEIVER_RECOVERY_MS + 10):
        p.sticks(throttle=1234, roll=1777)
        p.step(np.radians([100.0, 50.0, -25.0]).tolist())
    peer = MSPy(device="", logfilename=None, loglevel="WARNING")
    with serial.serial_for_url(f"socket://127.0.0.1:{p.ports['msp']}", timeout=WAIT_S) as line:
        peer.conn = line
        peer.basic_info()
        for command in ("MSP_RC", "MSP_MOTOR", "MSP_RAW_IMU"):
            peer.send_RAW_msg(MSPy.MSPCodes[command], data=[])
            assert peer.process_recv_data(peer.receive_msg()) == 0
    assert peer.CONFIG["apiVersion"] == "1.46.0"
    assert peer.CONFIG["flightControllerIdentifier"] == "NRFL"
    assert peer.CONFIG["name"] == "nf1"
    assert peer.CONFIG["boardIdentifier"] == "HOST"
    assert peer.CONFIG["cycleTime"] == 1000
    names = ("BOOT_GRACE", "GYRO_NOT_CALIBRATED", "THROTTLE_HIGH", "NOT_LEVEL", "BATTERY_UNKNOWN")
    expected = sum(1 << contract.ArmingReason[name] for name in names)
    assert peer.CONFIG["armingDisableFlags"] == expected
    assert peer.RC["channels"][:5] == [1777, 1500, 1500, 1234, 1000]
    assert peer.MOTOR_DATA == [1000] * 4 + [0] * 4
