from __future__ import annotations

import os
import socket
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.control import sticks
from neuroflight.sim.physics.imu import rotation_by
from neuroflight.sim.physics.rotation import quaternion
from neuroflight.sim.ports import host as host_port
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.port import Sample
from neuroflight.sim.ports.simulator_link import load_link
from neuroflight.toolchain.contract import RECEIVER_RECOVERY_MS
from neuroflight.toolchain.errors import LinkError

STILL = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))


@pytest.fixture
def impostor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Makes a program that runs the given Python lines instead of a firmware; waits are cut short."""
    monkeypatch.setattr(host_port, "START_S", 1.5)
    monkeypatch.setattr(host_port, "REPLY_S", 0.2)

    def make(lines: str) -> Path:
        path = tmp_path / "impostor"
        path.write_text(f"#!{sys.executable}\n{lines}\n")
        path.chmod(0o755)
        return path

    return make


def children() -> set[str]:
    return set(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())


def test_the_port_knows_the_policy_when_started(host_program: Path) -> None:
    port = HostPort(host_program, 8000)
    assert (port.motor_count, port.gyro_rate_hz, port.control_rate_hz) == (4, 8000, 1000)
    port.close()


def test_a_reply_carries_the_control_step_when_samples_are_exchanged(host_program: Path) -> None:
    port = HostPort(host_program, 2000)
    turning = sticks.channels((0.0, 200.0, -300.0), 0.25, armed=False).tolist()
    spinning = Sample(0.0, np.deg2rad([10.0, 20.0, -30.0]), np.eye(3), *np.zeros((3, 3)))
    before = 2 * RECEIVER_RECOVERY_MS  # samples until the receiver is believed
    replies = [port.exchange(spinning, turning if k % 2 == 0 else None) for k in range(before + 6)][
        before + 2 :
    ]
    port.close()
    first = before // 2 + 1
    assert [reply.step for reply in replies] == [first, first, first + 1, first + 1]
    assert np.rad2deg(replies[0].setpoint) == pytest.approx([0, 200, -300])
    assert np.rad2deg(replies[0].gyro) == pytest.approx([10, 20, -30], abs=0.05)
    assert replies[0].throttle == pytest.approx(0.25)
    assert not replies[0].armed
    assert replies[0].dshot.tolist() == [0, 0, 0, 0]


def test_the_reasons_are_named_when_it_has_just_booted(host_program: Path) -> None:
    port = HostPort(host_program)
    port.exchange(STILL, None)
    assert "GYRO_NOT_CALIBRATED" in port.arming_reasons()
    port.close()


def test_the_program_ends_when_the_port_is_closed(host_program: Path) -> None:
    before = children()
    port = HostPort(host_program)
    assert len(children() - before) == 1
    port.close()
    port.close()
    assert children() <= before


def test_ports_do_not_collide_when_two_programs_run(host_program: Path) -> None:
    first, second = HostPort(host_program, 1000), HostPort(host_program, 1000)
    first.exchange(STILL, None)
    assert first.exchange(STILL, None).step == 1
    assert second.exchange(STILL, None).step == 0
    first.close()
    second.close()


def test_the_link_fails_clearly_when_the_program_dies_in_flight(
    host_program: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(host_port, "REPLY_S", 0.2)
    port = HostPort(host_program)
    port.exchange(STILL, None)
    assert port._child._process is not None
    port._child._process.kill()
    port._child._process.wait()
    with pytest.raises(LinkError, match=r"host program neuroflight: .*it ended with -9"):
        port.exchange(STILL, None)
    port.close()


def test_the_programs_own_message_is_passed_on_when_it_refuses_to_start(host_program: Path) -> None:
    before = children()
    with pytest.raises(LinkError, match=r"it ended with 1: .*gyro-hz got 3000"):
        HostPort(host_program, 3000)
    assert children() <= before


def test_it_says_how_to_build_when_the_program_is_missing(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="not built yet; build it with `make host`"):
        HostPort(tmp_path / "neuroflight")


def test_it_says_so_when_the_file_is_no_program(tmp_path: Path) -> None:
    (tmp_path / "neuroflight").write_text("no program")
    with pytest.raises(LinkError, match="cannot be started"):
        HostPort(tmp_path / "neuroflight")


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("import sys; sys.exit('out of luck')", "it ended with 1: out of luck"),
        ("import time; time.sleep(60)", "not ready within 1.5 s"),
        ("print('hello', flush=True); input()", "it said 'hello', expected its `ready` line"),
        ("print('ready state=1', flush=True); input()", "it said 'ready state=1'"),
        (
            "print('ready state=99999 receiver=1 msp=1', flush=True); input()",
            "expected ports of 1 to 65535, not state=99999",
        ),
        (
            "import time; print('ready state=1', end='', flush=True); time.sleep(60)",
            "not ready within 1.5 s, it said 'ready state=1'",
        ),
        ("while True: print('x' * 1000, end='')", f"it said '{'x' * 200}', expected its `ready` line"),
        (
            "import time\nwhile True: print('x', end='', flush=True), time.sleep(0.1)",
            "not ready within 1.5 s, it said 'xxxx",
        ),
    ],
)
def test_it_gives_up_and_ends_the_program_when_it_is_not_the_firmware(
    impostor: Callable[[str], Path], lines: str, message: str
) -> None:
    before = children()
    with pytest.raises(LinkError) as refused:
        HostPort(impostor(lines))
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
    assert children() <= before


def test_the_link_times_out_when_the_program_does_not_answer(
    host_program: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(host_port, "REPLY_S", 0.2)
    port = HostPort(host_program)
    deaf = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    deaf.bind(("127.0.0.1", 0))
    port._state.connect(deaf.getsockname())
    with pytest.raises(LinkError, match=r"no motor packet within 0.2 s of a state packet"):
        port.exchange(STILL, None)
    packet = struct.unpack("<18d", deaf.recv(2048))
    port.close()
    deaf.close()
    assert packet[7:11] == (1, 0, 0, 0)


def test_a_state_packet_speaks_the_wires_axes_when_the_aircraft_moves() -> None:
    yaw_left = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moving = Sample(
        time_s=1.5,
        gyro=np.array([1.0, 2.0, 3.0]),
        rotation=yaw_left,
        velocity=np.array([4.0, 5.0, 6.0]),  # north, west, up
        position=np.array([7.0, 8.0, 100.0]),
        specific_force=np.array([0.1, 0.2, 9.8]),
    )
    link = load_link()
    packet = link.ffi.new("double[]", link.lib.LINK_STATE_VALUES)
    link.lib.link_host_state(moving.time_s, link.ffi.from_buffer("double[]", moving.values), packet)
    time_s, *rest = packet
    assert (time_s, rest[:3], rest[3:6]) == (1.5, [1.0, -2.0, -3.0], [0.1, -0.2, -9.8])
    assert rest[6:10] == pytest.approx([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    assert rest[10:16] == [-5.0, 4.0, 6.0, -8.0, 7.0, 100.0]
    assert rest[16] == pytest.approx(100129, abs=20)  # Pa at 100 m in the standard atmosphere


def test_a_state_packet_has_the_quaternion_of_the_twin_to_the_bit_when_the_aircraft_turns() -> None:
    link = load_link()
    packet = link.ffi.new("double[]", link.lib.LINK_STATE_VALUES)
    axes = np.array([[0.1, 0.2, 0.3], [1.0, -2.0, 2.9], [3.1, 0.1, 0.0], [0.0, 3.1, 0.2], [-0.1, 0.3, 3.1]])
    largest = set()
    for axis in axes:
        turned = Sample(0.0, np.zeros(3), rotation_by(axis), *np.zeros((3, 3)))
        link.lib.link_host_state(0.0, link.ffi.from_buffer("double[]", turned.values), packet)
        assert tuple(packet[7:11]) == quaternion(turned.rotation)
        largest.add(int(np.argmax(np.abs(list(packet[7:11])))))
    assert largest == {0, 1, 2, 3}


def test_the_program_sleeps_when_the_simulator_pauses(host_program: Path) -> None:
    port = HostPort(host_program)
    for _ in range(1000):
        port.exchange(STILL, None)
    assert port._child._process is not None
    on_processor = Path(f"/proc/{port._child._process.pid}/schedstat")
    began = int(on_processor.read_text().split()[0])
    time.sleep(0.3)
    spent_ns = int(on_processor.read_text().split()[0]) - began
    port.close()
    assert spent_ns < 30_000_000  # of 300,000,000
