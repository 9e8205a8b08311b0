"""Configuration messages of MSP, and the setting behind each of their fields."""

from __future__ import annotations

from neuroflight.toolchain.contract.frame_time_sensors import AXES
from neuroflight.toolchain.contract.msp_fields import (
    MspSource,
    bound,
    choice,
    ignored,
    scaled,
    source,
    told,
    unused,
    zeros,
)
from neuroflight.toolchain.contract.msp_layouts import Configuration, pair, read_only, reply, request
from neuroflight.toolchain.contract.msp_table import Msp
from neuroflight.toolchain.contract.msp_tuning import TUNING
from neuroflight.toolchain.contract.receiver import (
    CHANNEL_MID_US,
    CHANNEL_MIN_US,
    CHANNEL_VALID_MAX_US,
    CHANNEL_VALID_MIN_US,
    STICK_HIGH_US,
    THROTTLE_LOW_US,
)
from neuroflight.toolchain.contract.safety import CALIBRATION_MOTION_DEG_S, CALIBRATION_MS

__all__ = ["CONFIGURATIONS"]
METER_ADC = 1  # battery voltage and current are measured at the processor's pins
METER_ID = 10  # of the only battery
CELL_FULL_CENTIVOLTS = 435  # above it there is one cell more: firmware/src/housekeeping/battery.c
GYRO_COUNTS_PER_DEG_S = 16.4
PRESENT, ABSENT_PART = 0, 1  # a sensor of whatever make; none


# --- Power ---------------------------------------------------------------------------------------
_VOLTAGE_METER = (
    bound("u8", "id", METER_ID),
    bound("u8", "scale", source(MspSource.DIVIDER, 0), "", "of the voltage: scale / (divider x multiplier)"),
    bound("u8", "divider", source(MspSource.DIVIDER, 1)),
    bound("u8", "multiplier", source(MspSource.DIVIDER, 2)),
)
_CURRENT_METER = (
    bound("u8", "id", METER_ID),
    bound("i16", "scale", source(MspSource.CURRENT), "0.1 mV/A"),
    bound("i16", "offset", 0, "mA"),
)
_POWER = (
    pair(
        Msp.BATTERY_CONFIG,
        Msp.SET_BATTERY_CONFIG,
        told("u8", "cell_min_coarse", scaled("battery_low_v", 10), "0.1 V", "as below; the finer one counts"),
        told("u8", "cell_max_coarse", round(CELL_FULL_CENTIVOLTS / 10), "0.1 V"),
        told("u8", "cell_warning_coarse", scaled("battery_warn_v", 10), "0.1 V"),
        bound("u16", "capacity", scaled("battery_capacity_mah"), "mAh", "0: not told"),
        bound("u8", "voltage_source", METER_ADC),
        bound("u8", "current_source", METER_ADC),
        bound("u16", "cell_min", scaled("battery_low_v", 100), "0.01 V", "land now"),
        bound("u16", "cell_max", CELL_FULL_CENTIVOLTS, "0.01 V"),
        bound("u16", "cell_warning", scaled("battery_warn_v", 100), "0.01 V"),
        required=9,
    ),
    Configuration(
        reply(
            Msp.CURRENT_METER_CONFIG,
            bound("u8", "meters", 1),
            bound("u8", "bytes", 6, "", "of the meter's fields"),
            bound("u8", "id", METER_ID),
            bound("u8", "sensor", METER_ADC),
            *_CURRENT_METER[1:],
        ),
        request(Msp.SET_CURRENT_METER_CONFIG, *_CURRENT_METER),
    ),
    Configuration(
        reply(
            Msp.VOLTAGE_METER_CONFIG,
            bound("u8", "meters", 1),
            bound("u8", "bytes", 5, "", "of the meter's fields"),
            bound("u8", "id", METER_ID),
            bound("u8", "sensor", 0, "", "a resistor divider"),
            *_VOLTAGE_METER[1:],
        ),
        request(Msp.SET_VOLTAGE_METER_CONFIG, *_VOLTAGE_METER),
    ),
)

# --- Receiver and failsafe -------------------------------------------------------------------------
_RECEIVER = (
    pair(
        Msp.RX_CONFIG,
        Msp.SET_RX_CONFIG,
        bound("u8", "serial_provider", MspSource.PROVIDER, "", "0 none, 2 SBUS, 9 CRSF"),
        bound("u16", "stick_max", STICK_HIGH_US, "us"),
        bound("u16", "stick_center", CHANNEL_MID_US, "us"),
        bound("u16", "stick_min", THROTTLE_LOW_US, "us", "arming needs the throttle at or below"),
        *zeros("u8", "spektrum_bind"),
        bound("u16", "rx_min", CHANNEL_VALID_MIN_US, "us"),
        bound("u16", "rx_max", CHANNEL_VALID_MAX_US, "us"),
        *ignored("u8", "interpolation_old interpolation_interval"),
        bound("u16", "airmode_threshold", CHANNEL_MIN_US, "us", "the attitude always comes first"),
        *zeros("u8", "spi_protocol"),
        *zeros("u32", "spi_id"),
        *zeros("u8", "spi_channels camera_angle"),
        *ignored("u8", "interpolation_channels smoothing_type"),
        *zeros("u8", "smoothing_setpoint_hz smoothing_throttle_hz smoothing_throttle_auto_factor"),
        *ignored("u8", "smoothing_derivative_type"),
        *zeros("u8", "usb_hid smoothing_auto_factor"),
        bound("u8", "smoothing", scaled("interpolation"), "", "a ramp between two frames"),
        bound("u8", "elrs_uid", 0, count=6),
        *zeros("u8", "elrs_model"),
    ),
    pair(
        Msp.RX_MAP,
        Msp.SET_RX_MAP,
        *(
            bound("u8", name, scaled(f"map_{name}"), "channel", "of the receiver that is this one")
            for name in ("roll", "pitch", "yaw", "throttle", "aux1", "aux2", "aux3", "aux4")
        ),
        required=8,
    ),
    pair(Msp.RSSI_CONFIG, Msp.SET_RSSI_CONFIG, *zeros("u8", "channel")),
    pair(
        Msp.RC_DEADBAND,
        Msp.SET_RC_DEADBAND,
        bound("u8", "roll_pitch", scaled("deadband_us"), "us"),
        bound("u8", "yaw", scaled("yaw_deadband_us"), "us"),
        *zeros("u8", "altitude_hold"),
        bound("u16", "throttle_3d", 50, "us"),
    ),
    pair(
        Msp.FAILSAFE_CONFIG,
        Msp.SET_FAILSAFE_CONFIG,
        bound("u8", "delay", scaled("failsafe_delay_ms", 0.01), "0.1 s", "from the last frame to the stage"),
        bound("u8", "off_delay", scaled("failsafe_descend_ms", 0.001), "s", "then the motors stop"),
        bound("u16", "throttle", scaled("failsafe_throttle", 1000, 1000), "us", "while descending"),
        *zeros("u8", "switch_mode"),
        *zeros("u16", "throttle_low_delay"),
        bound("u8", "procedure", choice("failsafe_stage", 1, 0), "", "0 land, 1 drop"),
    ),
)

# --- Configuration, ports, motors --------------------------------------------------------------------
_ADVANCED = (
    bound("u8", "gyro_denominator", 1),
    bound("u8", "pid_denominator", MspSource.PROCESS_DENOMINATOR, "", "gyro samples a control step"),
    *zeros("u8", "unsynced_pwm"),
    bound(
        "u8",
        "motor_protocol",
        choice("motor_protocol", 6, 7, 5),
        "",
        "5 DShot150, 6 DShot300, 7 DShot600",
    ),
    *zeros("u16", "pwm_rate"),
    bound("u16", "motor_idle", MspSource.IDLE, "0.01 %", "of the controller that flies"),
    *ignored("u8", "gyro_32khz"),
    *zeros("u8", "pwm_inversion"),
    bound("u8", "gyro_to_use", scaled("gyro_select"), "", "0 first, 1 second"),
    *zeros("u8", "gyro_high_range"),
    bound("u8", "calibration_threshold", round(CALIBRATION_MOTION_DEG_S * GYRO_COUNTS_PER_DEG_S), "counts"),
    bound("u16", "calibration_time", CALIBRATION_MS // 10, "0.01 s"),
    *zeros("u16", "gyro_yaw_offset"),
    bound("u8", "gyro_overflow_check", 2, "", "all axes"),
    *zeros("u8", "debug_mode"),
)
_MOTOR = (
    *zeros("u16", "throttle_min"),
    bound("u16", "throttle_max", 2000, "us"),
    bound("u16", "command_min", 1000, "us"),
)
_MOTOR_REST = (
    bound("u8", "poles", scaled("motor_poles")),
    bound("u8", "dshot_telemetry", scaled("motor_telemetry"), "", "1: bidirectional DShot"),
)
_ALIGNMENT = (
    bound(
        "u8",
        "gyro_align",
        scaled("gyro_alignment"),
        "",
        "0 the board's, 1 to 4: turned by 0, 90, 180, 270 deg, 5 to 8: flipped besides",
    ),
    told("u8", "acc_align", scaled("gyro_alignment"), "", "as gyro_align: one chip has both"),
    *zeros("u8", "mag_align"),
)
# Up to API 1.46 a SET had three bytes behind these, which say nothing here.
_ALIGNMENT_REST = (
    bound("u8", "gyros_enabled", unused(1), "bits"),
    bound("i16", "mag_roll", unused(), "0.1 deg"),
    bound("i16", "mag_pitch", unused(), "0.1 deg"),
    bound("i16", "mag_yaw", unused(), "0.1 deg"),
)
_GYRO = bound(
    "u8",
    "gyro_hardware",
    MspSource.GYRO_HARDWARE,
    "",
    "4 MPU6000, 5 MPU6500, 6 MPU9250, 7 ICM20601, 8 ICM20602, 9 ICM20608G, 11 ICM20689, 12 ICM42605, "
    "13 ICM42688P, 15 BMI270, 17 LSM6DSV16X, 23 LSM6DSK320X, 0 another",
)
_SENSORS = (
    bound("u8", "acc_hardware", PRESENT, "", "0 any, 1 none"),
    bound("u8", "baro_hardware", ABSENT_PART),
    bound("u8", "mag_hardware", ABSENT_PART),
    *zeros("u8", "range_finder_hardware optical_flow_hardware"),
)
_BLACKBOX = (
    bound(
        "u8", "device", choice("blackbox_device", 0, 3, 2), "", "0 none, 2 SD card or flash chip, 3 serial"
    ),
    bound("u8", "rate_numerator", 1),
    told("u8", "rate_denominator", scaled("blackbox_divider"), "", "as sample_rate, which counts"),
    told("u16", "p_denominator", MspSource.LOG_INTRA, "frames", "the same, from one I frame to the next"),
    bound("u8", "sample_rate", MspSource.LOG_RATE, "", "every 2^n-th control step is logged"),
    bound("u32", "fields_off", MspSource.LOG_FIELDS_OFF, "bits", "the setting's bits 0 to 15"),
)
_GENERAL = (
    pair(
        Msp.FEATURE_CONFIG,
        Msp.SET_FEATURE_CONFIG,
        bound(
            "u32",
            "features",
            MspSource.FEATURES,
            "bits",
            "3 serial receiver, 4 motors stop, 14 MSP receiver, 22 airmode",
        ),
    ),
    pair(
        Msp.ARMING_CONFIG,
        Msp.SET_ARMING_CONFIG,
        *zeros("u8", "auto_disarm_delay"),
        *ignored("u8", "kill_switch"),
        bound("u8", "small_angle", MspSource.SMALL_ANGLE, "deg", "tilt that arming allows; 180: any"),
        *zeros("u8", "calibrate_on_first_arm"),
    ),
    Configuration(
        reply(Msp.ADVANCED_CONFIG, *_ADVANCED, bound("u8", "debug_modes", 1)),
        request(Msp.SET_ADVANCED_CONFIG, *_ADVANCED, required=1),
    ),
    pair(
        Msp.BEEPER_CONFIG,
        Msp.SET_BEEPER_CONFIG,
        bound("u32", "off", MspSource.BEEPERS, "bits", "conditions that do not beep"),
        *zeros("u8", "beacon_tone"),
        bound("u32", "beacon_off", 0x202, "bits", "conditions that make no motor beep"),
    ),
    pair(
        Msp.MIXER_CONFIG,
        Msp.SET_MIXER_CONFIG,
        bound("u8", "mixer", MspSource.MIXER, "", "3 quad X, 10 hex X, 23 another"),
        bound("u8", "reversed", scaled("motors_reversed"), "", "propellers out"),
    ),
    Configuration(
        reply(
            Msp.MOTOR_CONFIG,
            *_MOTOR,
            bound("u8", "motors", MspSource.MOTOR_COUNT),
            *_MOTOR_REST,
            *zeros("u8", "esc_sensor"),
        ),
        request(Msp.SET_MOTOR_CONFIG, *_MOTOR, *_MOTOR_REST, required=1),
    ),
    pair(
        Msp.MOTOR_3D_CONFIG,
        Msp.SET_MOTOR_3D_CONFIG,
        bound("u16", "deadband_low", 1406, "us"),
        bound("u16", "deadband_high", 1514, "us"),
        bound("u16", "neutral", 1460, "us"),
    ),
    pair(
        Msp.BOARD_ALIGNMENT_CONFIG,
        Msp.SET_BOARD_ALIGNMENT_CONFIG,
        *(bound("i16", axis, scaled(f"board_{axis}_deg"), "deg") for axis in AXES),
        read_first=True,
    ),
    Configuration(
        reply(Msp.SENSOR_ALIGNMENT, *_ALIGNMENT, bound("u8", "gyros_found", 1, "bits"), *_ALIGNMENT_REST),
        request(Msp.SET_SENSOR_ALIGNMENT, *_ALIGNMENT, *_ALIGNMENT_REST, required=1),
        read_first=True,
    ),
    pair(Msp.SENSOR_CONFIG, Msp.SET_SENSOR_CONFIG, *_SENSORS),
    pair(Msp.COMPASS_CONFIG, Msp.SET_COMPASS_CONFIG, *zeros("i16", "declination")),
    pair(Msp.ACC_TRIM, Msp.SET_ACC_TRIM, *zeros("i16", "pitch roll")),
    read_only(Msp.SONAR, bound("i32", "distance", -1, "cm", "-1: there is no range finder")),
    read_only(
        Msp.ALTITUDE,
        bound("i32", "altitude", 0, "cm", "there is no barometer"),
        bound("i16", "climb", 0, "cm/s"),
    ),
    read_only(Msp.PID_CONTROLLER, *zeros("u8", "controller")),
    read_only(Msp.DEBUG, bound("u16", "values", 0, count=8)),
    read_only(Msp.SENSOR_CONFIG_ACTIVE, _GYRO, *_SENSORS),
    read_only(Msp.GYRO_SENSOR, bound("u8", "gyros", 1), _GYRO),
    read_only(Msp.DATAFLASH_SUMMARY, *zeros("u8", "flags"), *zeros("u32", "sectors total_size used_size")),
    read_only(
        Msp.SDCARD_SUMMARY,
        bound("u8", "flags", 1, "bits", "0 there can be one"),
        bound("u8", "state", source(MspSource.LOG_CARD, 0), "", "0 no card, 1 fault, 2 starting, 4 ready"),
        bound("u8", "last_error", source(MspSource.LOG_CARD, 1), "", "0 none, 1 any, 3 of the file system"),
        bound("u32", "free", source(MspSource.LOG_CARD, 2), "KB", "of files that can take a log"),
        bound("u32", "total", source(MspSource.LOG_CARD, 3), "KB", "of files for logs"),
    ),
    Configuration(
        reply(Msp.BLACKBOX_CONFIG, bound("u8", "supported", 1), *_BLACKBOX),
        request(Msp.SET_BLACKBOX_CONFIG, *_BLACKBOX, required=5),
        read_first=True,
    ),
)

CONFIGURATIONS = (*_POWER, *_RECEIVER, *_GENERAL, *TUNING)
