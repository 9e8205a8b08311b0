"""The messages that the gateway sends by itself: how often, and what of the firmware they tell."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink import telemetry
from neuroflight.flash.mavlink.firmware import Firmware

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT  # Session makes it, as it differs from peer to peer
ATTITUDE = mavlink.MAVLINK_MSG_ID_ATTITUDE
DEFAULT_HZ = {  # all messages that can be sent; 0: only on request
    HEARTBEAT: 1.0,
    ATTITUDE: 10.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10.0,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: 10.0,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: 2.0,
    mavlink.MAVLINK_MSG_ID_RAW_IMU: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 2.0,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 2.0,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: 0.0,
}
SAMPLED = (ATTITUDE, mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, *telemetry.IMU)  # they tell a sample's rates


def streamed(number: int, fw: Firmware) -> Any:  # noqa: ANN401 - pymavlink's are untyped
    """Ask the firmware for the content of a message of DEFAULT_HZ, by number, and return the message."""
    match number:
        case mavlink.MAVLINK_MSG_ID_ATTITUDE:
            told = fw.attitude()  # read before the time and rates that are sent with it
            return telemetry.attitude(fw.boot_ms, told, fw.gyro)
        case mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION:
            told = fw.attitude()
            return telemetry.attitude_quaternion(fw.boot_ms, told, fw.gyro)
        case _ if number in telemetry.IMU:
            measured = fw.inertial()
            return telemetry.IMU[number](fw.boot_ms, measured)
        case mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE:
            return telemetry.extended_sys_state(fw.safety, armed=fw.armed)
        case mavlink.MAVLINK_MSG_ID_SYS_STATUS:
            return telemetry.sys_status(fw.vehicle, fw.safety, fw.status, fw.battery)
        case mavlink.MAVLINK_MSG_ID_BATTERY_STATUS:
            return telemetry.battery_status(fw.vehicle, fw.battery)
        case mavlink.MAVLINK_MSG_ID_RC_CHANNELS:
            return telemetry.rc_channels(fw.boot_ms, fw.channels(), fw.safety.receiver_percent)
        case mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW:
            return telemetry.servo_output_raw(fw.boot_ms, fw.motors())
        case _:
            return telemetry.autopilot_version(fw.vehicle)


def default_period(message: int) -> float:
    """Return the seconds between two messages unless a peer sets another interval; 0: only on request."""
    hz = DEFAULT_HZ[message]
    return 1 / hz if hz else 0.0
