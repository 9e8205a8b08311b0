"""`neuroflight board info` and an independent client against the running host program."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator

import pytest
import serial
from yamspy import MSPy

from neuroflight.cli.main import main
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.messages import DECODERS
from neuroflight.flash.link.msp import Decoder, Direction, Message, Version, encode
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain.contract import (
    ARMING_FLAG_COUNT,
    ARMING_FLAGS,
    GYRO_RATES_HZ,
    MSP_VARIANT_BETAFLIGHT,
    VERSION,
    ArmingReason,
    Msp,
)
from tests.flash.lockstep import (
    BOOT_SAMPLES,
    GYRO_HZ,
    LINK_SAMPLES,
    STICKS_DOWN,
    SWITCH_ON,
    THROTTLE_UP,
    Host,
)


def test_json_tells_firmware_policy_and_reasons_when_the_host_program_is_asked(
    host: Host, capsys: pytest.CaptureFixture[str]
) -> None:
    host.fly(LINK_SAMPLES, STICKS_DOWN)
    assert main(["board", "info", "--port", host.port, "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["variant"] == MSP_VARIANT_BETAFLIGHT
    assert info["version"] == ".".join(map(str, VERSION))
    assert info["api"] == {"protocol": 0, "major": 1, "minor": 47}
    assert info["board"]["target"] == "HOST"
    assert len(info["uid"]) == 24
    assert info["armed"] is False
    assert info["arming_reasons"] == ["BOOT_GRACE", "GYRO_NOT_CALIBRATED", "NOT_LEVEL", "BATTERY_UNKNOWN"]
    policy = info["policy"]
    assert policy["good"] is True
    assert policy["gyro_rate_hz"] == GYRO_HZ
    assert policy["control_rate_hz"] in GYRO_RATES_HZ
    assert info["control_period_us"] * policy["control_rate_hz"] == 1_000_000
    assert policy["action_count"] == 4
    assert policy["weight_count"] > policy["observation_count"] > 0
    assert int(policy["sha256"], 16) > 0


def test_table_has_the_same_facts_when_json_is_not_asked_for(
    host: Host, capsys: pytest.CaptureFixture[str]
) -> None:
    info = host.info()
    assert info.policy is not None
    assert main(["board", "info", "--port", host.port]) == 0
    table = "".join(capsys.readouterr().out.split())
    for fact in (info.version, info.uid, info.policy.sha256, info.policy.name, *info.arming_reasons):
        assert fact in table
    assert f"control{info.policy.control_rate_hz}Hz,gyro{GYRO_HZ}Hz" in table


def test_every_reason_but_throttle_and_policy_stands_when_no_sample_has_come(host: Host) -> None:
    info = host.info()
    assert not info.armed
    assert info.arming_reasons == (
        *("BOOT_GRACE", "GYRO_NOT_CALIBRATED", "RECEIVER_LOST", "SWITCH_NOT_CYCLED"),
        *("NOT_LEVEL", "BATTERY_UNKNOWN"),
    )
    assert info.policy is not None and info.policy.good


def test_reasons_go_one_by_one_and_armed_comes_when_the_aircraft_boots(host: Host) -> None:
    host.fly(BOOT_SAMPLES, THROTTLE_UP)
    assert (host.info().arming_reasons, host.info().armed) == (("THROTTLE_HIGH",), False)
    host.fly(10, STICKS_DOWN)
    assert (host.info().arming_reasons, host.info().armed) == ((), False)
    host.fly(10, SWITCH_ON)
    assert (host.info().arming_reasons, host.info().armed) == ((), True)
    host.fly(10, STICKS_DOWN)
    assert host.info().armed is False


def test_switch_must_be_cycled_when_it_was_on_at_boot(host: Host) -> None:
    host.fly(BOOT_SAMPLES, SWITCH_ON)
    assert host.info().arming_reasons == (ArmingReason.SWITCH_NOT_CYCLED.name,)
    host.fly(10, STICKS_DOWN)
    host.fly(10, SWITCH_ON)
    assert host.info().armed


@pytest.fixture
def connect_yamspy(yamspy_peer: MSPy) -> Iterator[Callable[[Host], MSPy]]:
    """Give it a host: yamspy connects over TCP and asks what it always asks first."""

    def connect(host: Host) -> MSPy:
        yamspy_peer.conn = serial.serial_for_url(f"socket://127.0.0.1:{host.program.ports['msp']}", timeout=5)
        yamspy_peer.basic_info()
        return yamspy_peer

    yield connect
    yamspy_peer.conn.close()


def test_yamspy_and_we_read_the_same_when_both_ask_the_host_program(
    host: Host, connect_yamspy: Callable[[Host], MSPy]
) -> None:
    host.fly(LINK_SAMPLES, THROTTLE_UP)
    info = host.info()
    heard = connect_yamspy(host)
    assert heard.CONFIG["flightControllerIdentifier"] == info.variant == MSP_VARIANT_BETAFLIGHT
    assert heard.CONFIG["flightControllerVersion"] == "25.12.0", "it takes the numbers; ours is in IDENTITY"
    assert heard.CONFIG["apiVersion"] == f"{info.api.major}.{info.api.minor}.0"
    assert heard.CONFIG["boardIdentifier"] == info.board.identifier
    assert heard.CONFIG["targetName"] == info.board.target
    assert heard.CONFIG["buildInfo"] == f"{info.build.date} {info.build.time}"
    assert heard.CONFIG["name"] == info.name
    assert "".join(f"{word:08x}" for word in heard.CONFIG["uid"]) == info.uid
    assert heard.CONFIG["cycleTime"] == info.control_period_us
    flags = {ARMING_FLAGS[ArmingReason[name]] for name in info.arming_reasons}
    assert heard.CONFIG["armingDisableFlags"] == sum(1 << flag for flag in flags)
    assert "THROTTLE_HIGH" in info.arming_reasons
    assert heard.CONFIG["armingDisableCount"] == ARMING_FLAG_COUNT


def test_yamspy_reads_sticks_and_motors_when_it_asks_the_host_program(
    host: Host, connect_yamspy: Callable[[Host], MSPy]
) -> None:
    host.fly(LINK_SAMPLES, (1100, 1200, 1300, 1400, 1000, 1600, *[1000] * 10))
    heard = connect_yamspy(host)
    for command in ("MSP_RC", "MSP_MOTOR", "MSP_ATTITUDE", "MSP_ANALOG", "MSP_RAW_IMU"):
        heard.send_RAW_msg(MSPy.MSPCodes[command])
        assert heard.process_recv_data(heard.receive_msg()) >= 0
    # On this wire yaw comes before throttle.
    assert heard.RC["channels"][:6] == [1100, 1200, 1400, 1300, 1000, 1600]
    assert len(heard.RC["channels"]) == 16
    assert heard.MOTOR_DATA == [1000, 1000, 1000, 1000, 0, 0, 0, 0]
    assert heard.SENSOR_DATA["gyroscope"] == [0, 0, 0]


NEED_PAYLOAD = {Msp.SETTING_INFO, Msp.SETTING_GET, Msp.POLICY_SLOT_BEGIN}
TIMED = {Msp.TASKS}  # what it says changes by the asking


def test_both_versions_get_the_same_answer_when_the_contract_names_the_command(host: Host) -> None:
    host.fly(1, STICKS_DOWN)
    line = open_transport(host.port)
    client, decoder = Client(line), Decoder()
    for command in sorted(set(DECODERS) - NEED_PAYLOAD - TIMED):
        line.write(encode(Message(Version.V2, Direction.REQUEST, command)))
        heard = decoder.feed(line.read(5.0))
        assert heard == [Message(Version.V2, Direction.REPLY, command, client.request(command, retries=0))]
    client.close()


def test_a_command_that_would_write_is_refused_when_sent(host: Host) -> None:
    host.fly(1, STICKS_DOWN)
    line, decoder = open_transport(host.port), Decoder()
    # set name, reboot, set raw RC, set PID, set motor, save
    for command, payload in {
        11: b"",
        68: b"\1",
        200: bytes(8),
        202: bytes(8),
        214: b"\x4c\4",
        250: b"\1",
    }.items():
        for version in Version:
            line.write(encode(Message(version, Direction.REQUEST, command, payload)))
            (answer,) = decoder.feed(line.read(5.0))
            assert isinstance(answer, Message)
            assert (answer.direction, answer.command) == (Direction.ERROR, command)
    line.close()


@pytest.mark.parametrize("as_json", [[], ["--json"]], ids=["table", "json"])
def test_one_line_and_status_1_when_nobody_listens(
    free_tcp_port: int, as_json: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["board", "info", "--port", f"tcp:127.0.0.1:{free_tcp_port}", *as_json]) == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.count("\n") == 1
    assert output.err.startswith(f"neuroflight: tcp:127.0.0.1:{free_tcp_port}: nobody listens there")


def test_nothing_is_acknowledged_when_nothing_is_the_matter(
    host: Host, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["board", "acknowledge", "--port", host.port]) == 0
    assert capsys.readouterr().out == "there was nothing to acknowledge\n"
