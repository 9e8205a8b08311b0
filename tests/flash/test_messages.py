"""Reply layouts against bytes written out by hand and against yamspy's reading of the same bytes."""

from __future__ import annotations

import struct

import pytest
from yamspy import MSPy

from flash import messages
from flash.messages import DECODERS, Analog, ApiVersion, Attitude, BoardInfo, BuildInfo, PolicyInfo, RawImu
from flash.msp import Direction, Message, Version, encode
from toolchain.contract import ArmingReason, Msp
from toolchain.errors import LinkError

BOARD = (
    b"S7X2" + b"\x01\x00" + b"\x02" + b"\x37" + b"\x09MATEKF722" + b"\x08F722-STD" + b"\x04MTKS"
    + bytes(32) + b"\x07" + b"\x02" + b"\xa0\x0f" + bytes(4) + b"\x01\x00"
)  # fmt: skip
BUILD = b"Nov 21 2025" + b"07:37:00" + b"1a89016" + b"\x00\x00"
STATUS = b"\xe8\x03" + b"\x02\x00" + b"\x21\x00" + b"\x01\x00\x00\x00" + b"\x00" + b"\x2a\x00" + b"\x00\x00"
STATUS_EX = (
    STATUS[:13] + b"\x03\x01" + b"\x02\xee\xff" + b"\x06" + b"\x24\x00\x00\x00" + b"\x00" + b"\x00\x00"
)
ANALOG = b"\xa8" + b"\x7b\x00" + b"\xff\x03" + b"\x85\xff" + b"\x8e\x06"
RAW_IMU = struct.pack("<9h", 1, -2, 2048, 164, -32768, 32767, 7, 8, -9)
POLICY = (
    b"\xef\xbe\xad\xde" + b"\x06\x00" + b"\x04\x00" + b"\x04\x13\x00\x00" + b"\xe8\x03" + b"\xa0\x0f"
    + b"\x01" + b"\x03nf1" + bytes(range(32))
)  # fmt: skip
PAYLOADS = {
    Msp.API_VERSION: b"\x00\x01\x2e",
    Msp.FC_VARIANT: b"NRFL",
    Msp.FC_VERSION: b"\x00\x01\x02",
    Msp.BOARD_INFO: BOARD,
    Msp.BUILD_INFO: BUILD,
    Msp.NAME: b"bench one",
    Msp.STATUS: STATUS,
    Msp.STATUS_EX: STATUS_EX,
    Msp.UID: b"\x78\x56\x34\x12" + b"\x0d\x0c\x0b\x0a" + b"\x01\x00\x00\x00",
    Msp.RC: struct.pack("<16H", *range(1000, 2600, 100)),
    Msp.MOTOR: struct.pack("<8H", 1000, 1250, 1500, 2000, 0, 0, 0, 0),
    Msp.RAW_IMU: RAW_IMU,
    Msp.ATTITUDE: struct.pack("<3h", -450, 123, 271),
    Msp.ANALOG: ANALOG,
    Msp.POLICY_INFO: POLICY,
}
# How many leading bytes each layout needs; NAME, RC and MOTOR are as long as they are.
NEEDED = {
    Msp.API_VERSION: 3,
    Msp.FC_VARIANT: 4,
    Msp.FC_VERSION: 3,
    Msp.BOARD_INFO: 32,
    Msp.BUILD_INFO: 26,
    Msp.STATUS: 13,
    Msp.STATUS_EX: 23,
    Msp.UID: 12,
    Msp.RAW_IMU: 18,
    Msp.ATTITUDE: 6,
    Msp.ANALOG: 9,
    Msp.POLICY_INFO: 53,
}


def test_every_command_has_a_decoder_when_the_contract_names_it() -> None:
    assert set(DECODERS) == set(PAYLOADS) == set(Msp)


@pytest.mark.parametrize(
    ("command", "meaning"),
    [
        (Msp.API_VERSION, ApiVersion(0, 1, 46)),
        (Msp.FC_VARIANT, "NRFL"),
        (Msp.FC_VERSION, "0.1.2"),
        (Msp.BOARD_INFO, BoardInfo("S7X2", 1, "MATEKF722", "F722-STD", "MTKS")),
        (Msp.BUILD_INFO, BuildInfo("Nov 21 2025", "07:37:00", "1a89016")),
        (Msp.NAME, "bench one"),
        (Msp.UID, "123456780a0b0c0d00000001"),
        (Msp.MOTOR, (1000, 1250, 1500, 2000, 0, 0, 0, 0)),
        (Msp.RC, tuple(range(1000, 2600, 100))),
        (Msp.RAW_IMU, RawImu((1, -2, 2048), (164, -32768, 32767), (7, 8, -9))),
        (Msp.ATTITUDE, Attitude(-45.0, 12.3, 271.0)),
        (Msp.ANALOG, Analog(voltage_v=16.78, drawn_mah=123, rssi=1023, current_a=-1.23)),
        (
            Msp.POLICY_INFO,
            PolicyInfo("nf1", bytes(range(32)).hex(), 0xDEADBEEF, 6, 4, 4868, 1000, 4000, True),
        ),
    ],
)
def test_fields_have_their_values_when_the_layout_is_written_by_hand(command: Msp, meaning: object) -> None:
    assert DECODERS[command](PAYLOADS[command]) == meaning


def test_status_tells_load_and_armed_when_read() -> None:
    status = messages.status(STATUS)
    assert (status.cycle_time_us, status.i2c_errors, status.load_percent, status.armed) == (1000, 2, 42, True)
    assert not messages.status(STATUS[:6] + b"\xfe\xff\xff\xff" + STATUS[10:]).armed


def test_arming_reasons_are_found_when_further_mode_bytes_stand_before_them() -> None:
    extended = messages.status_ex(STATUS_EX)
    assert extended.status == messages.status(STATUS)
    assert extended.arming_flag_count == 6
    assert messages.arming_reasons(extended.arming_flags) == ("RECEIVER_LOST", "POLICY_BAD")


def test_each_reason_has_its_name_when_alone() -> None:
    for reason in ArmingReason:
        assert messages.arming_reasons(1 << reason) == (reason.name,)
    assert messages.arming_reasons(0) == ()
    assert messages.arming_reasons(1 << 31 | 1) == ("BOOT_GRACE", "BIT_31")
    assert messages.bit_names(0b101) == ("BIT_0", "BIT_2")


@pytest.mark.parametrize("command", NEEDED)
def test_reply_is_refused_when_one_byte_short(command: Msp) -> None:
    needed = NEEDED[command]
    DECODERS[command](PAYLOADS[command][:needed])
    with pytest.raises(
        LinkError, match=rf"{command.name} reply has {needed - 1} bytes, expected at least"
    ) as caught:
        DECODERS[command](PAYLOADS[command][: needed - 1])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("command", [command for command in Msp if command is not Msp.NAME])
def test_only_link_errors_come_when_a_reply_is_cut_anywhere(command: Msp) -> None:
    refused = 0
    for end in range(len(PAYLOADS[command])):
        try:
            DECODERS[command](PAYLOADS[command][:end])
        except LinkError:
            refused += 1
    assert refused > 0


def test_half_a_channel_is_refused_when_rc_is_odd() -> None:
    with pytest.raises(LinkError, match="RC reply has 3 bytes, expected at least 4"):
        messages.rc(b"\xdc\x05\xdc")


def test_text_is_safe_to_print_when_it_holds_control_bytes() -> None:
    assert messages.name(b"\x1b[31mred\xff\n") == "?[31mred??"


# --- yamspy reads the same bytes -------------------------------------------------------------
@pytest.fixture
def heard(yamspy_peer: MSPy) -> MSPy:
    """yamspy after it has read every reply of PAYLOADS that the ecosystem knows."""
    for command in sorted(set(Msp) - {Msp.POLICY_INFO}):
        yamspy_peer.conn.incoming = encode(Message(Version.V1, Direction.REPLY, command, PAYLOADS[command]))
        assert yamspy_peer.process_recv_data(yamspy_peer.receive_msg()) >= 0
    return yamspy_peer


def test_yamspy_reads_the_same_identity_when_given_the_same_bytes(heard: MSPy) -> None:
    config, board, build = heard.CONFIG, messages.board_info(BOARD), messages.build_info(BUILD)
    assert config["flightControllerIdentifier"] == messages.fc_variant(PAYLOADS[Msp.FC_VARIANT])
    assert config["flightControllerVersion"] == messages.fc_version(PAYLOADS[Msp.FC_VERSION])
    assert config["apiVersion"] == "1.46.0"
    assert (config["boardIdentifier"], config["boardVersion"]) == (board.identifier, board.hardware_revision)
    assert (config["targetName"], config["boardName"]) == (board.target, board.name)
    assert config["manufacturerId"] == board.manufacturer
    assert config["buildInfo"] == f"{build.date} {build.time}"
    assert config["name"] == messages.name(PAYLOADS[Msp.NAME])
    assert "".join(f"{word:08x}" for word in config["uid"]) == messages.uid(PAYLOADS[Msp.UID])


def test_yamspy_reads_the_same_state_when_given_the_same_bytes(heard: MSPy) -> None:
    status, analog = messages.status_ex(STATUS_EX), messages.analog(ANALOG)
    assert heard.CONFIG["cycleTime"] == status.status.cycle_time_us
    assert heard.CONFIG["cpuload"] == status.status.load_percent
    assert heard.CONFIG["armingDisableCount"] == status.arming_flag_count
    assert heard.CONFIG["armingDisableFlags"] == status.arming_flags
    assert tuple(heard.RC["channels"]) == messages.rc(PAYLOADS[Msp.RC])
    assert tuple(heard.MOTOR_DATA) == messages.motor(PAYLOADS[Msp.MOTOR])
    assert tuple(heard.SENSOR_DATA["gyroscope"]) == messages.raw_imu(RAW_IMU).gyro
    attitude = messages.attitude(PAYLOADS[Msp.ATTITUDE])
    assert heard.SENSOR_DATA["kinematics"] == [attitude.roll_deg, attitude.pitch_deg, attitude.heading_deg]
    assert heard.ANALOG["voltage"] == analog.voltage_v
    assert heard.ANALOG["amperage"] == analog.current_a
    assert (heard.ANALOG["mAhdrawn"], heard.ANALOG["rssi"]) == (analog.drawn_mah, analog.rssi)
