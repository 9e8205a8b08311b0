"""Reply layouts against bytes written out by hand and against yamspy's reading of the same bytes."""

from __future__ import annotations

import struct

import pytest
from yamspy import MSPy

from neuroflight.flash.link import messages, records
from neuroflight.flash.link.messages import (
    DECODERS,
    Analog,
    ApiVersion,
    Attitude,
    BatteryLevel,
    BatteryState,
    BoardInfo,
    BuildInfo,
    EscReport,
    PolicyInfo,
    PolicySource,
    RawImu,
)
from neuroflight.flash.link.msp import Direction, Message, Version, encode
from neuroflight.flash.link.records import Fault, Faults, Safety, TaskLoad, Tasks
from neuroflight.flash.link.requests import SettingInfo
from neuroflight.toolchain.contract import (
    FAULT_REGISTERS,
    LAYOUTS,
    ArmingReason,
    FallbackCause,
    FaultKind,
    FlightState,
    GyroChip,
    GyroHealth,
    Mix,
    Msp,
    StopCause,
    Task,
)
from neuroflight.toolchain.errors import LinkError

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
    + b"\x00\x00\x80\x3e" + b"\x01" + b"\x07\x00\x00\x00" + b"\xf6\x00" + b"\x01"
)  # fmt: skip
BATTERY = b"\x04" + b"\x14\x05" + b"\xa8" + b"\x7b\x00" + b"\x85\xff" + b"\x01" + b"\x8e\x06"
SAFETY = (
    b"\x06" + b"\x07" + b"\x03" + b"\x02" + b"\x40\x04\x00\x00" + b"\x01\x01\x00" + b"\x57" + b"\x2e\xfb"
    + b"\x00\x00\x00\x3e" + b"\x02" + b"\x12\x01" + b"\x01" + b"\x03"
)  # fmt: skip
TASKS = struct.pack("<IB", 216_000_000, 2) + struct.pack("<H5I", 3000, 9, 0, 500, 300, 400) + struct.pack(
    "<H5I", 1000, 3, 1, 16000, 15000, 15500
)  # fmt: skip
FAULT_WORDS = range(0x100, 0x100 + 13)
FAULTS = (
    struct.pack("<IBII", 12, 1, 11, 2) + struct.pack("<13I", *FAULT_WORDS) + struct.pack("<I", 345)
    + b"src/sensing/gyro.c".ljust(24, b"\0") + struct.pack("<I", 60_000)
)  # fmt: skip
SETTING = struct.pack("<HBfff", 67, 1, 0.5, 20.0, 3.0) + b"\x0fdynamic_notch_q" + b"\x011"
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
    Msp.MOTOR_TELEMETRY: struct.pack(
        "<BIHBHHHIHBHHH", 2, 21043, 125, 61, 1625, 1200, 0, 0, 10_000, 0, 0, 0, 0
    ),
    Msp.RAW_IMU: RAW_IMU,
    Msp.ATTITUDE: struct.pack("<3h", -450, 123, 271),
    Msp.ANALOG: ANALOG,
    Msp.BATTERY_STATE: BATTERY,
    Msp.POLICY_INFO: POLICY,
    Msp.SAFETY: SAFETY,
    Msp.TASKS: TASKS,
    Msp.FAULTS: FAULTS,
    Msp.SETTING_INFO: SETTING,
    Msp.SETTING_GET: b"\x00\xa0\x0f\x00\x00",
    Msp.POLICY_SLOT_BEGIN: b"\x08\x00\x00\x00",
}
# Replies of these say nothing but that it is done.
SILENT = {
    *(Msp.SET_RAW_RC, Msp.SET_MOTOR, Msp.MOTOR_TEST, Msp.DSHOT_COMMAND, Msp.SETTING_SET, Msp.EEPROM_WRITE),
    *(Msp.POLICY_SLOT_WRITE, Msp.POLICY_SLOT_END, Msp.REBOOT, Msp.ACKNOWLEDGE),
    *(Msp.STREAM, Msp.STREAM_SAMPLE),
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
    Msp.BATTERY_STATE: 11,
    Msp.POLICY_INFO: 65,
    Msp.SAFETY: 19,
    Msp.TASKS: 49,
    Msp.FAULTS: 97,
    Msp.SETTING_INFO: 33,
    Msp.SETTING_GET: 5,
    Msp.POLICY_SLOT_BEGIN: 4,
}


def test_every_command_has_a_decoder_when_the_contract_names_it() -> None:
    assert set(DECODERS) == set(PAYLOADS)
    assert set(Msp) == set(DECODERS) | SILENT | {layout.message for layout in LAYOUTS}


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
        (
            Msp.MOTOR_TELEMETRY,
            (EscReport(21043, 0.0125, 61, 16.25, 12.0), EscReport(0, 1.0, 0, 0.0, 0.0)),
        ),
        (Msp.RC, tuple(range(1000, 2600, 100))),
        (Msp.RAW_IMU, RawImu((1, -2, 2048), (164, -32768, 32767), (7, 8, -9))),
        (Msp.ATTITUDE, Attitude(-45.0, 12.3, 271.0)),
        (Msp.ANALOG, Analog(voltage_v=16.78, drawn_mah=123, rssi=1023, current_a=-1.23)),
        (
            Msp.POLICY_INFO,
            PolicyInfo(
                *("nf1", bytes(range(32)).hex(), 0xDEADBEEF, 6, 4, 4868, 1000, 4000, True),
                *(0.25, PolicySource.SLOT_B, 7, (-10, 0), Mix.CENTRED),
            ),
        ),
        (
            Msp.BATTERY_STATE,
            BatteryState(4, BatteryLevel.WARNING, voltage_v=16.78, drawn_mah=123, current_a=-1.23),
        ),
        (
            Msp.SAFETY,
            Safety(
                state=FlightState.CRASHED,
                stop_cause=StopCause.CRASH,
                fallback_cause=FallbackCause.DEADLINE,
                gyro_health=GyroHealth.STUCK,
                arming_flags=1 << ArmingReason.CRASHED | 1 << ArmingReason.GYRO_BAD,
                policy_good=True,
                pid_built_in=True,
                pid_flies=False,
                receiver_percent=87,
                temperature_deg_c=-12.34,
                idle=0.125,
                refused_cause=FallbackCause.POLICY_OUTPUT,
                gyro_identity=0x12,
                gyro=GyroChip.ICM20602,
                brown_out_level=0,
                airborne=True,
            ),
        ),
        (
            Msp.TASKS,
            Tasks(
                216_000_000,
                (
                    TaskLoad(Task.GYRO, 3000, 9, 0, 500, 300, 400),
                    TaskLoad(Task.CONTROL, 1000, 3, 1, 16000, 15000, 15500),
                ),
            ),
        ),
        (
            Msp.FAULTS,
            Faults(
                12,
                Fault(
                    *(11, FaultKind.ASSERT, dict(zip(FAULT_REGISTERS, FAULT_WORDS, strict=True))),
                    *("src/sensing/gyro.c", 345, 60_000),
                ),
            ),
        ),
        (Msp.SETTING_INFO, SettingInfo(67, "dynamic_notch_q", "1", 0.5, 20.0, 3.0, kind="float")),
        (Msp.SETTING_GET, 4000),
        (Msp.POLICY_SLOT_BEGIN, 8),
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


@pytest.mark.parametrize("command", sorted(set(PAYLOADS) - {Msp.NAME}))
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
    """yamspy after it has read every reply of PAYLOADS that it knows."""
    for command in sorted({command for command in PAYLOADS if command < 255} - {Msp.MOTOR_TELEMETRY}):
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


# --- Ours --------------------------------------------------------------------------------------
def test_no_fault_is_told_when_none_is_pending() -> None:
    assert records.faults(b"\x05\x00\x00\x00\x00") == Faults(5, None)


def test_tasks_without_a_name_are_left_out_when_a_firmware_has_more() -> None:
    row = struct.pack("<H5I", 1, 2, 3, 4, 5, 6)
    many = records.tasks(struct.pack("<IB", 1, len(Task) + 2) + row * (len(Task) + 2))
    assert [load.task for load in many.loads] == list(Task)


def test_variability_is_the_window_over_the_worst_when_a_task_ran() -> None:
    gyro, control = records.tasks(TASKS).loads
    assert (gyro.variability, control.variability) == (0.4, 0.0625)
    assert TaskLoad(Task.MSP, 0, 0, 0, 0, 0, 0).variability == 0.0


@pytest.mark.parametrize(("command", "at"), [(Msp.SAFETY, 0), (Msp.FAULTS, 9), (Msp.POLICY_INFO, 57)])
def test_a_name_that_no_table_has_is_refused_when_a_firmware_is_newer(command: Msp, at: int) -> None:
    payload = PAYLOADS[command][:at] + b"\x63" + PAYLOADS[command][at + 1 :]
    with pytest.raises(LinkError, match=rf"{command.name} reply names \w+ 99, expected 0, 1, 2"):
        DECODERS[command](payload)
