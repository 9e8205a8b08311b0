"""MSP over TCP at the host program: three peers at a time, and yamspy as an independent one."""

from __future__ import annotations

import contextlib
import select
import socket
import subprocess
from collections.abc import Callable
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from yamspy import MSPy

from neuroflight.flash.board.info import read_info
from neuroflight.flash.link import messages, records, requests
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.msp import Decoder, Message, encode, request
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import SETTINGS, Msp
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.policy.blob import PolicyBlob, pack
from tests.firmware.telemetry import gaps, samples

WAIT_S = 5.0  # how long an answer may take before the test fails
API_REQUEST, API_REPLY = b"$M<\x00\x01\x01", b"$M>\x03\x01\x00\x01\x2f\x2c"
Start = Callable[..., Any]


def test_msp_is_answered_when_no_simulator_is_there(start: Start) -> None:
    p = start()
    with p.connect() as peer:
        for _ in range(3):
            peer.sendall(API_REQUEST)
            assert peer.recv(100) == API_REPLY


def readable(peer: socket.socket) -> bool:
    return bool(select.select([peer], [], [], 0)[0])


def test_each_of_two_peers_gets_its_own_answers_when_they_take_turns_byte_by_byte(start: Start) -> None:
    p = start("--gyro-hz=1000")
    questions = {Msp.API_VERSION: API_REQUEST, Msp.FC_VARIANT: encode(request(Msp.FC_VARIANT))}
    with p.connect() as first, p.connect() as second:
        for _ in range(20):
            for pair in zip_longest(questions[Msp.API_VERSION], questions[Msp.FC_VARIANT]):
                for peer, byte in zip((first, second), pair, strict=True):
                    if byte is not None:
                        peer.sendall(bytes([byte]))
            assert p.step() == (0, 0, 0, 0)
            assert first.recv(100) == API_REPLY
            (answer,) = Decoder().feed(second.recv(100))
            assert isinstance(answer, Message)
            assert (answer.command, answer.payload) == (
                Msp.FC_VARIANT,
                contract.MSP_VARIANT_BETAFLIGHT.encode(),
            )


def test_a_fourth_peer_is_turned_away_and_the_others_served_when_it_calls(start: Start) -> None:
    p = start("--gyro-hz=1000")
    with p.connect() as first, p.connect() as second, p.connect() as third, p.connect() as fourth:
        for peer in (first, second, third):
            peer.sendall(API_REQUEST)
            assert peer.recv(100) == API_REPLY
        assert fourth.recv(100) == b""
        for peer in (first, second, third):
            peer.sendall(API_REQUEST)
            assert peer.recv(100) == API_REPLY
        assert p.step() == (0, 0, 0, 0)
    with p.connect() as fifth, p.connect() as sixth, p.connect() as seventh:
        for peer in (fifth, sixth, seventh):
            peer.sendall(API_REQUEST)
            assert peer.recv(100) == API_REPLY


@pytest.mark.parametrize(
    "rude",
    [
        pytest.param(b"$X<\x00\x01\x00\xff\x01half", id="half a frame"),
        pytest.param(b"$M<\xff\xff\xff\xff\xff" + bytes(range(256)) * 40, id="garbage"),
        pytest.param(b"$M<\x00\x01\x02" * 1000, id="wrong checksums"),
    ],
)
def test_one_peer_is_served_when_the_other_sends_what_is_none(start: Start, rude: bytes) -> None:
    p = start()
    with p.connect() as polite, p.connect() as other:
        for _ in range(10):
            other.sendall(rude)
            polite.sendall(API_REQUEST)
            assert polite.recv(100) == API_REPLY


def test_one_peer_is_served_when_the_other_never_reads(start: Start) -> None:
    p = start("--gyro-hz=1000")
    with p.connect() as deaf, p.connect() as polite:
        deaf.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            for _ in range(100_000):
                deaf.send(API_REQUEST * 40)
        for _ in range(20):
            polite.sendall(API_REQUEST)
            assert polite.recv(100) == API_REPLY
            assert p.step() == (0, 0, 0, 0)
        # It reads at last: no reply was cut, and the line goes on.
        deaf.setblocking(True)
        head = b""
        while len(head) < 1000 * len(API_REPLY):
            head += deaf.recv(1 << 16)
        assert head[: 1000 * len(API_REPLY)] == API_REPLY * 1000


def test_half_a_request_does_not_spoil_the_next_peer_when_its_sender_hangs_up(start: Start) -> None:
    p = start()
    with p.connect() as rude:
        rude.sendall(b"$X<\x00\x01\x00\xff\x01half")
    with p.connect() as polite:
        polite.sendall(API_REQUEST)
        assert polite.recv(100) == API_REPLY


@pytest.mark.slow
def test_a_stream_has_gaps_but_no_broken_record_when_its_peer_reads_late(start: Start) -> None:
    p = start("--gyro-hz=1000")
    late = socket.socket()
    late.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    late.settimeout(WAIT_S)
    late.connect(("127.0.0.1", p.ports["msp"]))
    ask_for_stream = encode(request(Msp.STREAM, (500).to_bytes(2, "little")))
    with late, p.connect() as other:
        late.sendall(ask_for_stream)
        other.sendall(ask_for_stream)
        read = b""
        for _ in range(20_000):
            p.step()
            read += other.recv(1 << 16, socket.MSG_DONTWAIT) if readable(other) else b""
        told = late.recv(1 << 16)
        while readable(late):
            told += late.recv(1 << 16)
            p.step()
        late.sendall(API_REQUEST)
        while not told.endswith(API_REPLY):
            told += late.recv(1 << 16)
    found = samples(told)
    assert gaps(found) > 1000
    assert gaps(samples(read)) == 0
    assert found[-1].step >= 20_000


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
    assert peer.CONFIG["apiVersion"] == "1.47.0"
    assert peer.CONFIG["flightControllerIdentifier"] == "BTFL"
    assert peer.CONFIG["name"] == "nf1"
    assert peer.CONFIG["boardIdentifier"] == "HOST"
    assert peer.CONFIG["cycleTime"] == 1000
    names = ("BOOT_GRACE", "GYRO_NOT_CALIBRATED", "THROTTLE_HIGH", "NOT_LEVEL", "BATTERY_UNKNOWN")
    expected = sum(1 << contract.ARMING_FLAGS[contract.ArmingReason[name]] for name in names)
    assert peer.CONFIG["armingDisableFlags"] == expected
    assert peer.RC["channels"][:5] == [1777, 1500, 1500, 1234, 1000]
    assert peer.MOTOR_DATA == [1000] * 4 + [0] * 4


# --- What it changes ----------------------------------------------------------------------------
INDEX = {setting.name: index for index, setting in enumerate(SETTINGS)}


def ask(p: Any) -> Client:
    """A client of the program."""
    return Client(open_transport(f"tcp:127.0.0.1:{p.ports['msp']}"))


def boot(p: Any) -> None:
    """Samples and frames until nothing forbids arming."""
    for _ in range(1300):
        p.sticks()
        p.step()
    with ask(p) as client:
        told = messages.status_ex(client.request(Msp.STATUS_EX))
    assert told.arming_flags == 0


def arm(p: Any) -> None:
    boot(p)
    p.sticks(arm=2000)
    p.step()
    with ask(p) as client:
        assert messages.status(client.request(Msp.STATUS)).armed


def test_a_setting_is_flown_from_the_next_start_on_when_it_was_saved(start: Start, tmp_path: Path) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    p = start(option)
    with ask(p) as client:
        client.request(Msp.SETTING_SET, requests.setting_set(INDEX["gyro_rate_hz"], 2000, kind="uint32_t"))
        assert messages.policy_info(client.request(Msp.POLICY_INFO)).gyro_rate_hz == 4000
        client.request(Msp.EEPROM_WRITE)
    p.end()
    with ask(start(option)) as client:
        assert messages.policy_info(client.request(Msp.POLICY_INFO)).gyro_rate_hz == 2000
        told = client.request(Msp.SETTING_GET, requests.setting_index(INDEX["gyro_rate_hz"]))
        assert requests.setting_value(told) == 2000


def test_the_reply_comes_before_the_end_when_it_is_told_to_start_anew(start: Start) -> None:
    p = start()
    with ask(p) as client:
        assert client.request(Msp.REBOOT, retries=0) == b""
    assert p.process.wait(WAIT_S) == 0


def test_it_goes_on_when_it_is_told_to_start_a_boot_loader_that_it_has_not(start: Start) -> None:
    with ask(start()) as client:
        with pytest.raises(
            LinkError, match="refuses MSP REBOOT: this firmware or its settings have no such thing"
        ):
            client.request(Msp.REBOOT, bytes([contract.Reboot.ROM]))
        assert "STORING" not in read_info(client).arming_reasons


def test_a_setting_is_forgotten_when_it_was_not_saved(start: Start, tmp_path: Path) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    p = start(option)
    with ask(p) as client:
        client.request(Msp.SETTING_SET, requests.setting_set(INDEX["gyro_rate_hz"], 2000, kind="uint32_t"))
    p.end()
    with ask(start(option)) as client:
        assert messages.policy_info(client.request(Msp.POLICY_INFO)).gyro_rate_hz == 4000


def test_boots_are_counted_when_the_program_starts_over(start: Start, tmp_path: Path) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    for boots in (1, 2, 3):
        p = start(option)
        with ask(p) as client:
            assert records.faults(client.request(Msp.FAULTS)) == records.Faults(boots, None)
        p.end()


def test_a_policy_is_flown_from_the_next_start_on_when_it_was_sent(
    start: Start, tmp_path: Path, scripted_policy_blob: PolicyBlob
) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    p = start(option)
    with ask(p) as client:
        data = pack(
            PolicyBlob(**(vars(scripted_policy_blob) | {"sequence": 1, "aircraft": "sent", "idle": 0.125}))
        )
        assert requests.slot_begun(client.request(Msp.POLICY_SLOT_BEGIN, requests.slot_begin(len(data)))) == 1
        for offset in range(0, len(data), 200):
            client.request(Msp.POLICY_SLOT_WRITE, requests.slot_write(offset, data[offset : offset + 200]))
        client.request(Msp.POLICY_SLOT_END)
        now = messages.policy_info(client.request(Msp.POLICY_INFO))
        assert (now.name, now.source) == ("scripted", messages.PolicySource.SLOT_A)
    p.end()
    with ask(start(option)) as client:
        then = messages.policy_info(client.request(Msp.POLICY_INFO))
    assert (then.name, then.source, then.sequence) == ("sent", messages.PolicySource.SLOT_B, 1)
    assert (then.idle, then.good) == (0.125, True)


def test_nothing_is_changed_when_the_motors_are_armed(start: Start, tmp_path: Path) -> None:
    flash = tmp_path / "flash.bin"
    p = start("--gyro-hz=1000", f"--settings={flash}")
    arm(p)
    before = flash.read_bytes()
    with ask(p) as client:
        for command, payload in (
            (Msp.SETTING_SET, requests.setting_set(0, 2000, kind="uint32_t")),
            (Msp.EEPROM_WRITE, b""),
            (Msp.POLICY_SLOT_BEGIN, requests.slot_begin(608)),
            (Msp.MOTOR_TEST, requests.motor_test(contract.MOTOR_TEST_MAGIC)),
            (Msp.SET_MOTOR, requests.set_motor([1100] * 4)),
            (Msp.DSHOT_COMMAND, requests.dshot_command(1)),
            (Msp.REBOOT, b""),
        ):
            with pytest.raises(LinkError, match=rf"refuses MSP {command.name}: the motors are armed"):
                client.request(command, payload)
        safety = records.safety(client.request(Msp.SAFETY))
        assert safety.state == contract.FlightState.ARMED
    assert flash.read_bytes() == before


def test_safety_and_tasks_are_told_when_the_program_flies(start: Start) -> None:
    p = start("--gyro-hz=1000")
    arm(p)
    with ask(p) as client:
        safety = records.safety(client.request(Msp.SAFETY))
        tasks = records.tasks(client.request(Msp.TASKS))
        battery = messages.battery_state(client.request(Msp.BATTERY_STATE))
        imu = messages.raw_imu(client.request(Msp.RAW_IMU))
    assert (safety.arming_flags, safety.policy_good, safety.receiver_percent) == (0, True, 100)
    control = tasks.loads[contract.Task.CONTROL]
    assert (control.rate_hz, control.runs) == (1000, 1301)
    assert control.best_cycles <= control.mean_cycles <= control.worst_cycles
    assert (battery.level, battery.cells) == (messages.BatteryLevel.GOOD, 4)
    assert battery.voltage_v == pytest.approx(16.8, abs=0.05)
    assert imu.acceleration[:2] == (0, 0)
    assert imu.acceleration[2] == pytest.approx(2048, abs=8)


# --- The file that flash lies in ----------------------------------------------------------------
def refusal_of(build: Path, option: str) -> str:
    """What the program says on stderr when it does not start."""
    done = subprocess.run([build / "neuroflight", option, "--msp-port=0"], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stdout == ""
    return done.stderr


def test_the_file_is_flash_as_installed_when_it_is_new(
    start: Start, tmp_path: Path, scripted_policy_blob: PolicyBlob
) -> None:
    flash = tmp_path / "flash.bin"
    start(f"--settings={flash}").end()
    content = flash.read_bytes()
    assert len(content) == contract.FLASH_BYTES
    log = contract.FLASH_FAULT_RECORD.address - contract.FLASH_BASE
    assert content[log : log + 4] == b"NFFL", "a boot was logged"
    slot = contract.FLASH_POLICY_SLOTS[0].address - contract.FLASH_BASE
    policy = pack(scripted_policy_blob)
    assert content[slot:].startswith(policy), "as a board's installation leaves it"
    assert set(content[:log]) == set(content[slot + len(policy) :]) == {0xFF}


@pytest.mark.parametrize("size", [1, contract.FLASH_BYTES - 1, contract.FLASH_BYTES + 1])
def test_a_file_of_another_size_is_left_alone_when_given(
    scripted_build: Path, tmp_path: Path, size: int
) -> None:
    flash = tmp_path / "photo.jpg"
    flash.write_bytes(b"x" * size)
    words = refusal_of(scripted_build, f"--settings={flash}")
    assert f"flash file {flash}: it has another size" in words
    assert words.count("\n") == 1
    assert flash.read_bytes() == b"x" * size


def test_the_program_says_why_when_the_file_cannot_be_opened(scripted_build: Path, tmp_path: Path) -> None:
    words = refusal_of(scripted_build, f"--settings={tmp_path}/nowhere/flash.bin")
    assert "No such file or directory" in words
    assert words.count("\n") == 1
