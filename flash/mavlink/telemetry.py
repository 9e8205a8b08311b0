"""MAVLink messages from what a firmware reports over MSP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.link.messages import Attitude, BatteryLevel, BatteryState, StatusEx
from neuroflight.flash.link.records import Safety
from neuroflight.flash.mavlink.customs import MODE_RECEIVER
from neuroflight.flash.mavlink.frames import Vector, euler_frd, quaternion_frd, swap_frame
from neuroflight.toolchain.contract import GRAVITY, FallbackCause, FlightState, GyroHealth

Msg = Any  # a message of pymavlink, which has no types

TYPES = {
    3: mavlink.MAV_TYPE_TRICOPTER,
    4: mavlink.MAV_TYPE_QUADROTOR,
    6: mavlink.MAV_TYPE_HEXAROTOR,
    8: mavlink.MAV_TYPE_OCTOROTOR,
}
STATES = {
    FlightState.BOOT: mavlink.MAV_STATE_BOOT,
    FlightState.CALIBRATING: mavlink.MAV_STATE_CALIBRATING,
    FlightState.DISARMED: mavlink.MAV_STATE_STANDBY,
    FlightState.ARMED: mavlink.MAV_STATE_ACTIVE,
    FlightState.FAILSAFE_HOLD: mavlink.MAV_STATE_CRITICAL,
    FlightState.FAILSAFE_DROP: mavlink.MAV_STATE_EMERGENCY,
    FlightState.CRASHED: mavlink.MAV_STATE_EMERGENCY,
    FlightState.FAULT: mavlink.MAV_STATE_EMERGENCY,
}
SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
)
CHARGES = {
    BatteryLevel.GOOD: mavlink.MAV_BATTERY_CHARGE_STATE_OK,
    BatteryLevel.WARNING: mavlink.MAV_BATTERY_CHARGE_STATE_LOW,
    BatteryLevel.CRITICAL: mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL,
}
LANDED = {
    None: mavlink.MAV_LANDED_STATE_UNDEFINED,
    False: mavlink.MAV_LANDED_STATE_ON_GROUND,
    True: mavlink.MAV_LANDED_STATE_IN_AIR,
}
SHORT_MAX = 0x7FFF
# Bits of HIGHRES_IMU.fields_updated: accelerometer, gyro, temperature.
IMU_FIELDS = 0b1_0000_0011_1111
CELLS, CELLS_LATER = 10, 4  # fields of BATTERY_STATUS
SERVOS = 16
UNKNOWN = 0xFFFF  # of voltages and channels
MILLIVOLTS_MAX = UNKNOWN - 1
CHANNELS = 18  # fields of RC_CHANNELS
RSSI_MAX = 254


@dataclass(frozen=True)
class Vehicle:
    """The properties of the vehicle that do not change while its firmware runs."""

    motor_count: int
    version: tuple[int, int, int]
    uid: str  # 24 hexadecimal digits
    capacity_mah: int  # of the pack; 0: not told


def heartbeat(vehicle: Vehicle, safety: Safety, *, armed: bool, mode: int) -> Msg:
    """Return HEARTBEAT of a firmware that has just answered. mode: MODE_RECEIVER, or a number of offboard."""
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    base |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED if mode != MODE_RECEIVER else 0
    return mavlink.MAVLink_heartbeat_message(
        type=TYPES.get(vehicle.motor_count, mavlink.MAV_TYPE_GENERIC),
        autopilot=mavlink.MAV_AUTOPILOT_GENERIC,
        base_mode=base,
        custom_mode=mode,
        system_status=system_status(safety),
        mavlink_version=3,
    )


def system_status(safety: Safety) -> int:
    """Return MAV_STATE: CRITICAL if the PID took over in flight, as the aircraft can still be flown home."""
    fell_back = safety.pid_flies and safety.fallback_cause not in (FallbackCause.NONE, FallbackCause.SWITCH)
    if safety.state is FlightState.ARMED and fell_back:
        return int(mavlink.MAV_STATE_CRITICAL)
    return int(STATES[safety.state])


def attitude(boot_ms: int, told: Attitude, gyro: tuple[float, ...]) -> Msg:
    """Return ATTITUDE. gyro: rates [rad/s] about the house's axes."""
    roll, pitch, yaw = euler_frd(told)
    rollspeed, pitchspeed, yawspeed = swap_frame((gyro[0], gyro[1], gyro[2]))
    return mavlink.MAVLink_attitude_message(boot_ms, roll, pitch, yaw, rollspeed, pitchspeed, yawspeed)


def attitude_quaternion(boot_ms: int, told: Attitude, gyro: tuple[float, ...]) -> Msg:
    """Return ATTITUDE_QUATERNION: the same attitude as a rotation from the body to the ground."""
    rates = swap_frame((gyro[0], gyro[1], gyro[2]))
    return mavlink.MAVLink_attitude_quaternion_message(boot_ms, *quaternion_frd(told), *rates)


def extended_sys_state(safety: Safety, *, armed: bool) -> Msg:
    """Return EXTENDED_SYS_STATE. An aircraft that has taken off is in the air until its motors stop."""
    landed = LANDED[safety.airborne] if armed else mavlink.MAV_LANDED_STATE_ON_GROUND
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed)


@dataclass(frozen=True)
class Inertial:
    """Measurements of gyro and accelerometer, axes forward, left, up."""

    rates: tuple[float, ...]  # [rad/s]
    force_g: tuple[float, ...]  # specific force [g]
    temperature_deg_c: float

    def scaled(self, rate: float, force: float) -> tuple[Vector, Vector]:
        """Return force and rates about forward, right, down; `force` counts for 1 g, `rate` for 1 rad/s."""
        (fx, fy, fz), (rx, ry, rz) = self.force_g, self.rates
        return swap_frame((fx * force, fy * force, fz * force)), swap_frame((rx * rate, ry * rate, rz * rate))


def highres_imu(boot_ms: int, told: Inertial) -> Msg:
    """Return HIGHRES_IMU [m/s^2, rad/s, deg C]; there is no magnetometer and no pressure."""
    force, rates = told.scaled(1.0, GRAVITY)
    return mavlink.MAVLink_highres_imu_message(
        boot_ms * 1000, *force, *rates, *[0.0] * 6, told.temperature_deg_c, IMU_FIELDS
    )


def scaled_imu(boot_ms: int, told: Inertial) -> Msg:
    """Return SCALED_IMU [1/1000 g, 1/1000 rad/s, 1/100 deg C]."""
    return mavlink.MAVLink_scaled_imu_message(boot_ms, *_thousandths(told), 0, 0, 0, _centidegrees(told))


def raw_imu(boot_ms: int, told: Inertial) -> Msg:
    """Return RAW_IMU in SCALED_IMU's units. MAVLink leaves its scale open; ArduPilot's tools expect these."""
    return mavlink.MAVLink_raw_imu_message(
        boot_ms * 1000, *_thousandths(told), 0, 0, 0, 0, _centidegrees(told)
    )


IMU = {
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: highres_imu,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: scaled_imu,
    mavlink.MAVLINK_MSG_ID_RAW_IMU: raw_imu,
}


def _thousandths(told: Inertial) -> list[int]:
    force, rates = told.scaled(1000.0, 1000.0)
    return [_short(value) for value in (*force, *rates)]


def _centidegrees(told: Inertial) -> int:
    return _short(100 * told.temperature_deg_c) or 1  # 0: not told


def _short(value: float) -> int:
    return round(min(max(value, -SHORT_MAX), SHORT_MAX))


def sys_status(vehicle: Vehicle, safety: Safety, status: StatusEx, battery: BatteryState) -> Msg:
    """Return SYS_STATUS. The firmware does not know the link's losses: they are 0."""
    wrong = 0
    if safety.gyro_health is not GyroHealth.GOOD:
        wrong |= mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    if safety.receiver_percent == 0:
        wrong |= mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    if battery.level is not BatteryLevel.GOOD:
        wrong |= mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    if not (safety.policy_good or safety.pid_built_in):
        wrong |= mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    return mavlink.MAVLink_sys_status_message(
        onboard_control_sensors_present=SENSORS,
        onboard_control_sensors_enabled=SENSORS,
        onboard_control_sensors_health=SENSORS & ~wrong,
        load=min(1000, 10 * status.status.load_percent),
        voltage_battery=millivolts(battery),
        current_battery=round(100 * battery.current_a),
        battery_remaining=remaining(vehicle, battery),
        drop_rate_comm=0,
        errors_comm=0,
        errors_count1=0,
        errors_count2=0,
        errors_count3=0,
        errors_count4=0,
    )


def millivolts(battery: BatteryState) -> int:
    """Return the pack's voltage [mV], UNKNOWN if none is measured."""
    absent = battery.level is BatteryLevel.ABSENT and battery.voltage_v == 0
    return UNKNOWN if absent else min(round(1000 * battery.voltage_v), MILLIVOLTS_MAX)


def remaining(vehicle: Vehicle, battery: BatteryState) -> int:
    """Return the remaining charge [%], -1 if the pack's capacity is unknown."""
    if vehicle.capacity_mah == 0:
        return -1
    return min(max(round(100 * (1 - battery.drawn_mah / vehicle.capacity_mah)), 0), 100)


def battery_status(vehicle: Vehicle, battery: BatteryState) -> Msg:
    """Return BATTERY_STATUS with the pack's voltage as its first cell, as cells are not measured."""
    return mavlink.MAVLink_battery_status_message(
        id=0,
        battery_function=mavlink.MAV_BATTERY_FUNCTION_ALL,
        type=mavlink.MAV_BATTERY_TYPE_UNKNOWN,
        temperature=0x7FFF,
        voltages=[millivolts(battery)] + [UNKNOWN] * (CELLS - 1),
        current_battery=round(100 * battery.current_a),
        current_consumed=battery.drawn_mah,
        energy_consumed=-1,
        battery_remaining=remaining(vehicle, battery),
        time_remaining=0,
        charge_state=CHARGES.get(battery.level, mavlink.MAV_BATTERY_CHARGE_STATE_UNDEFINED),
        voltages_ext=[0] * CELLS_LATER,
    )


def rc_channels(boot_ms: int, told: Sequence[int], percent: int) -> Msg:
    """Return RC_CHANNELS. told: channels in the order of MSP's RC; percent: the link's quality."""
    roll, pitch, yaw, throttle, *aux = told
    channels = [roll, pitch, throttle, yaw, *aux][:CHANNELS]
    fields = channels + [UNKNOWN] * (CHANNELS - len(channels))
    rssi = round(percent * RSSI_MAX / 100)
    return mavlink.MAVLink_rc_channels_message(boot_ms, len(channels), *fields, rssi)


def servo_output_raw(boot_ms: int, motors_us: Sequence[int]) -> Msg:
    """Return SERVO_OUTPUT_RAW: the motors' outputs, 1000 stopped, 2000 full; 0 for a missing motor."""
    fields = [*motors_us, *[0] * SERVOS][:SERVOS]
    return mavlink.MAVLink_servo_output_raw_message(boot_ms * 1000 & 0xFFFFFFFF, 0, *fields)


def autopilot_version(vehicle: Vehicle) -> Msg:
    """Return AUTOPILOT_VERSION. Builds are reproducible and know no revision: custom versions are zeros."""
    capabilities = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT  # else MAVSDK asks for no mission at all
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    )
    major, minor, patch = vehicle.version
    uid = bytes.fromhex(vehicle.uid)
    return mavlink.MAVLink_autopilot_version_message(
        capabilities=capabilities,
        flight_sw_version=major << 24 | minor << 16 | patch << 8 | mavlink.FIRMWARE_VERSION_TYPE_DEV,
        middleware_sw_version=0,
        os_sw_version=0,
        board_version=0,
        flight_custom_version=[0] * 8,
        middleware_custom_version=[0] * 8,
        os_custom_version=[0] * 8,
        vendor_id=0,
        product_id=0,
        uid=int.from_bytes(uid[-8:], "big"),
        uid2=[*uid, *[0] * (18 - len(uid))],
    )
