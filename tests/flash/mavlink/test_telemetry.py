"""MSP's values as MAVLink's: signs of frames, units, what is not known."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.link.messages import Attitude, BatteryLevel, BatteryState, Status, StatusEx
from neuroflight.flash.link.records import Safety
from neuroflight.flash.mavlink import telemetry
from neuroflight.flash.mavlink.customs import MODE_OFFBOARD, MODE_RECEIVER
from neuroflight.flash.mavlink.frames import euler_frd, quaternion_frd, swap_frame
from neuroflight.flash.mavlink.telemetry import UNKNOWN, Inertial, Vehicle
from neuroflight.toolchain.contract import FallbackCause, FlightState, GyroHealth, StopCause

NF1 = Vehicle(4, (1, 2, 3), "00112233445566778899aabb", 0)
FULL = BatteryState(4, BatteryLevel.GOOD, 16.8, 250, 1.25)
ROUGH = Inertial((1000.0, -1000.0, 35.0), (40.0, -40.0, 1.0), -300.0)  # more than 16 bits of thousandths hold
STATUS = StatusEx(Status(1000, 0, 0, 0, 0, 16), 32, 0)
SAFE = Safety(
    FlightState.DISARMED,
    StopCause.NONE,
    FallbackCause.NONE,
    GyroHealth.GOOD,
    arming_flags=0,
    policy_good=True,
    pid_built_in=True,
    pid_flies=False,
    receiver_percent=100,
    temperature_deg_c=25.0,
    idle=0.2,
    refused_cause=FallbackCause.NONE,
    gyro_identity=None,
    gyro=None,
    brown_out_level=None,
    airborne=False,
)


def test_rates_change_sides_when_y_points_right_and_z_down() -> None:
    assert swap_frame((1.0, 2.0, 3.0)) == (1.0, -2.0, -3.0)
    assert swap_frame(swap_frame((1.0, 2.0, 3.0))) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("told", "roll_deg", "pitch_deg", "yaw_deg"),
    [
        (Attitude(10.0, 0.0, 0.0), 10, 0, 0),  # right side down
        (Attitude(0.0, 20.0, 0.0), 0, -20, 0),  # MSP's pitch is positive nose down, MAVLink's nose up
        (Attitude(0.0, 0.0, 90.0), 0, 0, 90),  # to the right
        (Attitude(0.0, 0.0, 270.0), 0, 0, -90),
        (Attitude(-179.9, -89.9, 359.0), -179.9, 89.9, -1),
    ],
)
def test_angles_have_mavlinks_signs(
    told: Attitude, roll_deg: float, pitch_deg: float, yaw_deg: float
) -> None:
    assert [math.degrees(angle) for angle in euler_frd(told)] == pytest.approx([roll_deg, pitch_deg, yaw_deg])


def test_attitude_tells_rates_about_forward_right_and_down() -> None:
    message = telemetry.attitude(1234, Attitude(0, 0, 0), (0.1, 0.2, 0.3))
    assert message.time_boot_ms == 1234
    assert (message.rollspeed, message.pitchspeed, message.yawspeed) == (0.1, -0.2, -0.3)


@pytest.mark.parametrize("roll_deg", [-170.0, -30.0, 0.0, 45.0])
@pytest.mark.parametrize("pitch_deg", [-80.0, 0.0, 30.0])
@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 200.0])
def test_the_quaternion_is_the_same_attitude_as_the_angles(
    roll_deg: float, pitch_deg: float, heading_deg: float
) -> None:
    told = Attitude(roll_deg, pitch_deg, heading_deg)
    w, x, y, z = quaternion_frd(told)
    assert w * w + x * x + y * y + z * z == pytest.approx(1.0)
    angles = (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(2 * (w * y - z * x)),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
    assert angles == pytest.approx(euler_frd(told))
    message = telemetry.attitude_quaternion(7, told, (0.1, 0.2, 0.3))
    assert (message.rollspeed, message.pitchspeed, message.yawspeed) == (0.1, -0.2, -0.3)


@pytest.mark.parametrize(
    ("armed", "airborne", "landed"),
    [
        (False, False, mavlink.MAV_LANDED_STATE_ON_GROUND),
        (False, True, mavlink.MAV_LANDED_STATE_ON_GROUND),  # it was stopped
        (True, False, mavlink.MAV_LANDED_STATE_ON_GROUND),
        (True, True, mavlink.MAV_LANDED_STATE_IN_AIR),
        (True, None, mavlink.MAV_LANDED_STATE_UNDEFINED),  # a firmware that does not tell
    ],
)
def test_it_is_in_the_air_once_it_has_taken_off(armed: bool, airborne: bool | None, landed: int) -> None:
    message = telemetry.extended_sys_state(replace(SAFE, airborne=airborne), armed=armed)
    assert message.landed_state == landed


def test_inertial_sensors_have_mavlinks_axes_and_units() -> None:
    told = Inertial((0.1, 0.2, 0.3), (0.0, 0.5, 1.0), 30.0)  # rests on its right side, almost
    precise = telemetry.highres_imu(2000, told)
    assert (precise.xacc, precise.yacc, precise.zacc) == pytest.approx((0, -4.903325, -9.80665))
    assert (precise.xgyro, precise.ygyro, precise.zgyro) == (0.1, -0.2, -0.3)
    assert (precise.time_usec, precise.temperature) == (2_000_000, 30.0)
    for message in (telemetry.scaled_imu(2000, told), telemetry.raw_imu(2000, told)):
        assert (message.xacc, message.yacc, message.zacc) == (0, -500, -1000)
        assert (message.xgyro, message.ygyro, message.zgyro, message.temperature) == (100, -200, -300, 3000)


@pytest.mark.parametrize(
    ("motors", "kind"),
    [(4, mavlink.MAV_TYPE_QUADROTOR), (6, mavlink.MAV_TYPE_HEXAROTOR), (5, mavlink.MAV_TYPE_GENERIC)],
)
def test_the_type_of_aircraft_follows_from_its_motors(motors: int, kind: int) -> None:
    vehicle = replace(NF1, motor_count=motors)
    message = telemetry.heartbeat(vehicle, SAFE, armed=False, mode=MODE_RECEIVER)
    assert (message.type, message.autopilot) == (kind, mavlink.MAV_AUTOPILOT_GENERIC)


@pytest.mark.parametrize("armed", [False, True])
@pytest.mark.parametrize("mode", [MODE_RECEIVER, MODE_OFFBOARD, 4, 6 << 16])
def test_the_heartbeat_tells_who_steers_and_whether_it_is_armed(armed: bool, mode: int) -> None:
    message = telemetry.heartbeat(NF1, SAFE, armed=armed, mode=mode)
    assert bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED) == armed
    assert bool(message.base_mode & mavlink.MAV_MODE_FLAG_GUIDED_ENABLED) == (mode != MODE_RECEIVER)
    assert message.custom_mode == mode


@pytest.mark.parametrize("state", FlightState)
def test_every_state_has_one_of_mavlinks(state: FlightState) -> None:
    assert telemetry.system_status(replace(SAFE, state=state)) == telemetry.STATES[state]


def test_a_pid_that_took_over_is_critical_and_one_that_was_chosen_is_not() -> None:
    flies = replace(SAFE, state=FlightState.ARMED, pid_flies=True)
    took_over = replace(flies, fallback_cause=FallbackCause.OSCILLATION)
    chosen = replace(flies, fallback_cause=FallbackCause.SWITCH)
    assert telemetry.system_status(took_over) == mavlink.MAV_STATE_CRITICAL
    assert telemetry.system_status(chosen) == mavlink.MAV_STATE_ACTIVE


def test_system_status_tells_units_and_what_is_wrong() -> None:
    message = telemetry.sys_status(NF1, SAFE, STATUS, FULL)
    assert (message.load, message.voltage_battery, message.current_battery) == (160, 16800, 125)
    assert message.onboard_control_sensors_health == message.onboard_control_sensors_present
    stuck = replace(SAFE, gyro_health=GyroHealth.STUCK, receiver_percent=0)
    message = telemetry.sys_status(NF1, stuck, STATUS, replace(FULL, level=BatteryLevel.WARNING))
    assert telemetry.SENSORS & ~message.onboard_control_sensors_health == (
        mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
        | mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    )


def test_what_is_left_of_a_battery_is_told_only_when_its_capacity_is_known() -> None:
    message = telemetry.battery_status(NF1, FULL)
    assert (message.battery_remaining, message.current_consumed) == (-1, 250)
    known = replace(NF1, capacity_mah=1000)
    assert telemetry.battery_status(known, FULL).battery_remaining == 75
    assert telemetry.battery_status(known, replace(FULL, drawn_mah=2000)).battery_remaining == 0


def test_the_packs_voltage_stands_in_the_first_cell_and_no_cell_is_made_up() -> None:
    assert telemetry.battery_status(NF1, FULL).voltages == [16800] + [UNKNOWN] * 9
    absent = BatteryState(0, BatteryLevel.ABSENT, 0.0, 0, 0.0)
    assert telemetry.battery_status(NF1, absent).voltages == [UNKNOWN] * 10
    high = replace(FULL, voltage_v=90.0)
    assert telemetry.battery_status(NF1, high).voltages[0] == UNKNOWN - 1


def test_channels_come_in_mavlinks_order_and_those_that_are_none_are_told_so() -> None:
    message = telemetry.rc_channels(0, [1, 2, 3, 4, 5, 6], 50)
    told = [getattr(message, f"chan{n}_raw") for n in range(1, 19)]
    assert told == [1, 2, 4, 3, 5, 6] + [UNKNOWN] * 12
    assert (message.chancount, message.rssi) == (6, 127)


def test_motors_are_servo_outputs() -> None:
    message = telemetry.servo_output_raw(5_000_000, [1100, 1200, 1300, 1400])
    assert [getattr(message, f"servo{n}_raw") for n in (1, 2, 3, 4, 5, 16)] == [1100, 1200, 1300, 1400, 0, 0]
    assert message.time_usec == 5_000_000_000 % 2**32


def test_the_version_says_how_parameters_are_encoded_and_who_it_is() -> None:
    message = telemetry.autopilot_version(NF1)
    assert message.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    assert not message.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    assert message.flight_sw_version >> 8 == 0x010203
    assert bytes(message.uid2[:12]).hex() == NF1.uid
    assert message.uid == 0x445566778899AABB


def test_every_message_fits_its_packet() -> None:
    encoder = mavlink.MAVLink(None, 1, 1)
    for message in (
        telemetry.heartbeat(NF1, SAFE, armed=True, mode=2**32 - 1),
        telemetry.attitude(2**32 - 1, Attitude(-180, 90, 359), (1, 2, 3)),
        telemetry.attitude_quaternion(2**32 - 1, Attitude(-180, 90, 359), (1, 2, 3)),
        telemetry.extended_sys_state(SAFE, armed=True),
        *(message(2**32 - 1, ROUGH) for message in telemetry.IMU.values()),
        telemetry.sys_status(NF1, SAFE, STATUS, replace(FULL, voltage_v=1e3)),
        telemetry.battery_status(NF1, FULL),
        telemetry.rc_channels(2**32 - 1, [2250] * 16, 100),
        telemetry.servo_output_raw(2**32 - 1, [2000] * 8),
        telemetry.autopilot_version(NF1),
    ):
        (read,) = mavlink.MAVLink(None).parse_buffer(bytes(message.pack(encoder)))
        assert read.get_type() == message.get_type()
