"""docs/guides/gateway.md: its tables are true, and its example flies."""

from __future__ import annotations

import re
import select
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink.endpoint import UdpPeer
from neuroflight.flash.mavlink.streams import DEFAULT_HZ
from neuroflight.toolchain.contract import SETTINGS
from tests.flash.mavlink.conftest import LOOPBACK, MakeLockstep

PAGE = Path(__file__).resolve().parents[3] / "docs" / "guides" / "gateway.md"
ANSWER_S = 10.0  # how long the example may take for one setpoint before the test fails
SETPOINT = mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET.to_bytes(3, "little")  # where a packet has its number


def test_the_page_has_every_message_with_its_rate() -> None:
    rows = dict(re.findall(r"^\| ([A-Z_]+) \| ([\d.]+|asked) \|", PAGE.read_text(), re.MULTILINE))
    told = {mavlink.mavlink_map[message].msgname: hz for message, hz in DEFAULT_HZ.items()}
    assert {name: 0.0 if hz == "asked" else float(hz) for name, hz in rows.items()} == told


def test_the_page_names_the_settings_that_are_no_parameters() -> None:
    assert all(f"`{setting.name}`" in PAGE.read_text() for setting in SETTINGS if setting.kind == "text")


def count_setpoints(peer: UdpPeer, monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """The setpoints that come from there from now on."""
    found: list[bytes] = []
    receive = peer.receive

    def counted() -> bytes | None:
        packet = receive()
        if packet is not None and packet[7:10] == SETPOINT:
            found.append(packet)
        return packet

    monkeypatch.setattr(peer, "receive", counted)
    return found


def test_the_example_flies_the_host_build(
    lockstep: MakeLockstep, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    script = tmp_path / "companion.py"
    script.write_text(example)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind((LOOPBACK, 0))
        number = free.getsockname()[1]
    command = [sys.executable, str(script), f"udpin:{LOOPBACK}:{number}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as companion:
        assert companion.stdout is not None
        assert companion.stdout.readline() == "waiting for the aircraft\n"
        gateway = lockstep(also=(f"udp:{LOOPBACK}:{number}",))
        answers = count_setpoints(gateway.peers[-1], monkeypatch)
        gateway.station.forget()
        rates = []
        for _ in range(20_000):
            gateway.run(1)
            deadline = time.monotonic() + ANSWER_S
            while len(answers) < len(gateway.station.got("ATTITUDE")) and companion.poll() is None:
                assert time.monotonic() < deadline
                select.select([gateway.peers[-1]], [], [], 0.02)
                gateway.settle()
            rates.append(float(gateway.reply.setpoint[0]))
            if companion.poll() is not None:
                break
        output = companion.stdout.read()
        assert companion.wait(ANSWER_S) == 0, output
    assert "Offboard: system 42 steers" in output
    turned = re.search(r"asked for 1\.00 rad/s, turned at ([\d.]+) rad/s", output)
    assert turned is not None and abs(float(turned[1]) - 1.0) < 0.1, output
    assert abs(max(rates) - 1.0) < 0.02
    assert not gateway.reply.armed and not gateway.reply.dshot.any()
