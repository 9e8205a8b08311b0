"""Packets to and from Betaflight, and errors when the program is not Betaflight."""

from __future__ import annotations

import os
import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.ports.betaflight import build as betaflight_build
from neuroflight.sim.ports.betaflight import port as betaflight_port
from neuroflight.sim.ports.betaflight import process as betaflight_process
from neuroflight.sim.ports.betaflight.build import Betaflight
from neuroflight.sim.ports.betaflight.port import BetaflightPort
from neuroflight.sim.ports.betaflight.process import BetaflightProcess
from neuroflight.sim.ports.port import Sample
from neuroflight.toolchain.errors import AircraftError, LinkError

STILL = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
REST = bytes(4 * 12)  # the motors of a servo packet that are not there
# As Betaflight 4.6 sent them: disarmed; armed at zero throttle; full roll to the right.
DISARMED = bytes.fromhex("04000000 00007a44 00007a44 00007a44 00007a44") + REST
IDLING = bytes.fromhex("04000000 00e08344 00e08344 00e08344 00e08344") + REST
ROLLING = bytes.fromhex("04000000 00e08344 00e08344 0000fa44 0000fa44") + REST

# A program that serves what Betaflight serves: on its command line it refuses one setting.
SERVING = """
import socket, time
kinds = (socket.SOCK_DGRAM, 9003), (socket.SOCK_DGRAM, 9004), (socket.SOCK_STREAM, 5761)
servers = [socket.socket(socket.AF_INET, kind) for kind, _ in kinds]
for server, (_, port) in zip(servers, kinds):
    server.bind(("", port))
line = servers[2]
line.listen()
line.setblocking(False)
client = None
while True:
    time.monotonic()
    try:
        if client is None:
            client, _ = line.accept()
            client.setblocking(False)
        said = client.recv(4096)
        client.sendall(b"###ERROR: NO SUCH THING###\\r\\n# " if b"small_angle" in said else b"\\r\\n# ")
    except BlockingIOError:
        pass
"""


@pytest.fixture(scope="session")
def clock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library around Betaflight's clock."""
    path = tmp_path_factory.mktemp("clock") / "clock.so"
    betaflight_build.build_clock(path)
    return path


@pytest.fixture
def impostor(clock: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Betaflight]:
    """Makes a program that runs the given Python lines instead of Betaflight; its start is cut short."""
    monkeypatch.setattr(betaflight_process, "START_NS", 50_000_000)
    monkeypatch.setattr(betaflight_process, "ANSWER_S", 30.0)  # for a busy computer

    def make(lines: str) -> Betaflight:
        path = tmp_path / "impostor"
        path.write_text(f"#!{sys.executable} -IS\n{lines}\n")
        path.chmod(0o755)
        return Betaflight(path, clock)

    return make


def children() -> set[str]:
    return set(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())


def test_betaflight_counts_what_the_chip_counts_when_it_drops_fractions() -> None:
    wanted = np.unique(np.r_[np.arange(-40, 41), np.arange(-32767, 32768, 137), 32767, -32767])
    for number in wanted.tolist():
        raw = np.array([number, -number, number], np.int16)
        rates = np.array(struct.unpack("<18d", betaflight_port.state_packet(0.0, raw, STILL))[1:4])
        # Its way: y and z change sign, deg/s times 16.4, C's conversion to whole numbers.
        read = np.trunc(np.rad2deg(rates * [1, -1, -1]) * 16.4)
        assert read.tolist() == raw.tolist()


def test_a_state_packet_speaks_betaflights_axes_when_the_aircraft_moves() -> None:
    yaw_left = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moving = Sample(
        time_s=9.0,
        gyro=np.zeros(3),
        rotation=yaw_left,
        velocity=np.array([4.0, 5.0, 6.0]),  # north, west, up
        position=np.array([7.0, 8.0, 9.0]),
        specific_force=np.array([0.1, 0.2, 9.8]),
    )
    packet = betaflight_port.state_packet(1.5, np.array([0, 0, 0], np.int16), moving)
    time_s, *rest = struct.unpack("<18d", packet)
    assert (time_s, rest[:3]) == (1.5, [0, 0, 0])
    assert rest[3:6] == [-0.1, -0.2, -9.8]  # Betaflight negates all three
    assert rest[6:10] == pytest.approx([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    assert rest[10:16] == [-5.0, 4.0, 6.0, -8.0, 7.0, 9.0]


@pytest.mark.parametrize(
    ("packet", "values"),
    [
        (DISARMED, [0, 0, 0, 0]),
        (IDLING, [158, 158, 158, 158]),
        (ROLLING, [158, 158, 2047, 2047]),
        (b"\6" + IDLING[1:20] + ROLLING[12:20] + IDLING[28:], [158, 158, 158, 158, 2047, 2047]),
    ],
)
def test_motors_decode_in_our_order_when_betaflight_sends_them(packet: bytes, values: list[int]) -> None:
    assert betaflight_port.dshot_values(packet, len(values)).tolist() == values


@pytest.mark.parametrize(
    ("packet", "message"),
    [
        (DISARMED[:-1], "67 bytes, expected 68"),
        (b"\6" + DISARMED[1:], "6 motors, expected 4"),
        (DISARMED[:4] + b"\0\0\xc0\x7f" + DISARMED[8:], "pulse widths .nan"),
    ],
)
def test_a_servo_packet_is_refused_when_it_is_damaged(packet: bytes, message: str) -> None:
    with pytest.raises(LinkError, match=message):
        betaflight_port.dshot_values(packet, 4)


def test_yaw_is_reversed_when_the_motors_turn_the_other_way() -> None:
    nf1 = load_aircraft("nf1")
    other = replace(nf1, rotors=tuple(replace(rotor, spin=-rotor.spin) for rotor in nf1.rotors))
    assert betaflight_port.aircraft_settings(nf1) == betaflight_port.SETTINGS
    assert betaflight_port.aircraft_settings(other)[-1] == "set yaw_motors_reversed = ON"


def test_the_mixer_is_set_when_the_aircraft_is_a_hexacopter() -> None:
    settings = betaflight_port.aircraft_settings(load_aircraft("hexa"))
    assert settings == (*betaflight_port.SETTINGS, "mixer HEX6X")


def test_an_aircraft_is_refused_when_its_motors_stand_otherwise() -> None:
    nf1, hexa = load_aircraft("nf1"), load_aircraft("hexa")
    mirrored = replace(nf1, rotors=(*nf1.rotors[2:], *nf1.rotors[:2]))
    swapped = replace(hexa, rotors=(*hexa.rotors[:4], hexa.rotors[5], hexa.rotors[4]))
    for aircraft in (mirrored, replace(nf1, rotors=nf1.rotors[:3]), swapped):
        with pytest.raises(AircraftError, match="otherwise than Betaflight's quad in X"):
            betaflight_port.aircraft_settings(aircraft)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("import sys; sys.exit('out of luck')", "it is gone; it ended with 1: out of luck"),
        ("import time\nwhile True: time.monotonic()", "its servers do not stand 0.05 s after its start"),
        ("import select; select.select([], [], [])", "it does not come back within 1 s"),
    ],
)
def test_it_gives_up_and_ends_the_program_when_it_is_not_betaflight(
    impostor: Callable[[str], Betaflight], lines: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "come back" in message:
        monkeypatch.setattr(betaflight_process, "ANSWER_S", 1.0)
    before = children()
    with pytest.raises(LinkError) as refused:
        BetaflightPort(impostor(lines))
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
    assert children() <= before


def test_the_line_is_named_when_its_command_line_refuses_it(impostor: Callable[[str], Betaflight]) -> None:
    before = children()
    with pytest.raises(LinkError, match=r"'###ERROR: NO SUCH THING### #' to 'set small_angle = 180'"):
        BetaflightPort(impostor(SERVING))
    assert children() <= before


def test_ports_do_not_collide_when_two_programs_serve(impostor: Callable[[str], Betaflight]) -> None:
    serving = impostor(SERVING)
    with BetaflightProcess(serving) as first, BetaflightProcess(serving) as second:
        assert set(first.ports) == set(second.ports) == {9003, 9004, 5761}
        assert not set(first.ports.values()) & set(second.ports.values())


def test_the_link_fails_clearly_when_packets_are_not_taken_in(
    impostor: Callable[[str], Betaflight], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(betaflight_process, "ANSWER_S", 5.0)  # of which it needs a part to start
    with BetaflightProcess(impostor(SERVING)) as process:
        process.send_state(betaflight_port.state_packet(0.0, np.zeros(3, np.int16), STILL))
        with pytest.raises(LinkError, match=r"it does not come back within 5 s"):
            process.run(1_000_000)


def test_it_says_so_when_the_file_is_no_program(clock: Path, tmp_path: Path) -> None:
    (tmp_path / "betaflight").write_text("no program")
    with pytest.raises(LinkError, match=r"cannot be started .*to have it built anew"):
        BetaflightPort(Betaflight(tmp_path / "betaflight", clock))
