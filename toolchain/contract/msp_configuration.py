"""Configuration messages of MSP, and the setting behind each of their fields."""

from __future__ import annotations

from toolchain.contract.frame_time_sensors import AXES
from toolchain.contract.msp import Msp
from toolchain.contract.msp_layouts import (
    Configuration,
    MspField,
    MspSource,
    bound,
    choice,
    constant,
    reply,
    request,
    scaled,
    source,
    told,
    unused,
    zeros,
)
from toolchain.contract.receiver import (
    CHANNEL_MID_US,
    CHANNEL_MIN_US,
    CHANNEL_VALID_MAX_US,
    CHANNEL_VALID_MIN_US,
    RATE_MAX_DEG_S,
    STICK_HIGH_US,
    THROTTLE_LOW_US,
)
from toolchain.contract.safety import CALIBRATION_MOTION_DEG_S, CALIBRATION_MS

__all__ = ["CONFIGURATIONS"]
METER_ADC = 1  # where battery voltage and current come from: pins of the processor
METER_ID = 10  # of the only battery
CELL_FULL_CENTIVOLTS = 435  # above it there is one cell more: firmware/src/housekeeping/battery.c
GYRO_COUNTS_PER_DEG_S = 16.4
PRESENT, ABSENT_PART = 0, 1  # a sensor of whatever make; none
MULTIPLIER_OFF = 100  # of a slider that does nothing, %
MOTOR_POLES = 14  # the ecosystem's default; nothing here depends on it
RATE_LIMIT = int(RATE_MAX_DEG_S)


def _pair(
    get: Msp, set_: Msp, *fields: MspField, required: int = 1, read_first: bool = False
) -> Configuration:
    """A message whose SET brings what the GET tells."""
    return Configuration(reply(get, *fields), request(set_, *fields, required=required), read_first)


def _read_only(get: Msp, *fields: MspField) -> Configuration:
    return Configuration(reply(get, *fields))


def _lowpass(stage: int, name: str) -> MspField:
    return bound(
        "u16", name, source(MspSource.LOWPASS_HZ, stage), "Hz", f"filter{stage + 1} of the chain; 0: none"
    )


def _notch(stage: int, name: str, cutoff: str) -> tuple[MspField, MspField]:
    return (
        bound(
            "u16", name, source(MspSource.NOTCH_HZ, stage), "Hz", f"filter{stage + 1} of the chain; 0: none"
        ),
        bound("u16", cutoff, source(MspSource.NOTCH_CUTOFF, stage), "Hz", "its lower edge at -3 dB"),
    )


_D_LOWPASS = source(MspSource.D_LOWPASS_HZ)
_D_MEANING = "of the PID that stands by; built in"

# --- Power ---------------------------------------------------------------------------------------
_VOLTAGE_METER = (
    bound("u8", "id", constant(METER_ID)),
    bound("u8", "scale", source(MspSource.DIVIDER, 0), "", "of the voltage: scale / (divider x multiplier)"),
    bound("u8", "divider", source(MspSource.DIVIDER, 1)),
    bound("u8", "multiplier", source(MspSource.DIVIDER, 2)),
)
_CURRENT_METER = (
    bound("u8", "id", constant(METER_ID)),
    bound("i16", "scale", scaled("current_scale", 10), "0.1 mV/A"),
    bound("i16", "offset", constant(0), "mA"),
)
_POWER = (
    _pair(
        Msp.BATTERY_CONFIG,
        Msp.SET_BATTERY_CONFIG,
        told("u8", "cell_min_coarse", scaled("battery_low_v", 10), "0.1 V", "as below; the finer one counts"),
        told("u8", "cell_max_coarse", constant(round(CELL_FULL_CENTIVOLTS / 10)), "0.1 V"),
        told("u8", "cell_warning_coarse", scaled("battery_warn_v", 10), "0.1 V"),
        bound("u16", "capacity", scaled("battery_capacity_mah"), "mAh", "0: not told"),
        bound("u8", "voltage_source", constant(METER_ADC)),
        bound("u8", "current_source", constant(METER_ADC)),
        bound("u16", "cell_min", scaled("battery_low_v", 100), "0.01 V", "land now"),
        bound("u16", "cell_max", constant(CELL_FULL_CENTIVOLTS), "0.01 V"),
        bound("u16", "cell_warning", scaled("battery_warn_v", 100), "0.01 V"),
        required=9,
    ),
    Configuration(
        reply(
            Msp.CURRENT_METER_CONFIG,
            bound("u8", "meters", constant(1)),
            bound("u8", "bytes", constant(6), "", "of the meter's fields"),
            bound("u8", "id", constant(METER_ID)),
            bound("u8", "sensor", constant(METER_ADC)),
            *_CURRENT_METER[1:],
        ),
        request(Msp.SET_CURRENT_METER_CONFIG, *_CURRENT_METER),
    ),
    Configuration(
        reply(
            Msp.VOLTAGE_METER_CONFIG,
            bound("u8", "meters", constant(1)),
            bound("u8", "bytes", constant(5), "", "of the meter's fields"),
            bound("u8", "id", constant(METER_ID)),
            bound("u8", "sensor", constant(0), "", "a resistor divider"),
            *_VOLTAGE_METER[1:],
        ),
        request(Msp.SET_VOLTAGE_METER_CONFIG, *_VOLTAGE_METER),
    ),
)

# --- Receiver and failsafe -------------------------------------------------------------------------
_RECEIVER = (
    _pair(
        Msp.RX_CONFIG,
        Msp.SET_RX_CONFIG,
        bound("u8", "serial_provider", source(MspSource.PROVIDER), "", "0 none, 2 SBUS, 9 CRSF"),
        bound("u16", "stick_max", constant(STICK_HIGH_US), "us"),
        bound("u16", "stick_center", constant(CHANNEL_MID_US), "us"),
        bound("u16", "stick_min", constant(THROTTLE_LOW_US), "us", "arming needs the throttle at or below"),
        *zeros("u8", "spektrum_bind"),
        bound("u16", "rx_min", constant(CHANNEL_VALID_MIN_US), "us"),
        bound("u16", "rx_max", constant(CHANNEL_VALID_MAX_US), "us"),
        bound("u8", "interpolation_old", unused()),
        bound("u8", "interpolation_interval", unused()),
        bound("u16", "airmode_threshold", constant(CHANNEL_MIN_US), "us", "the attitude always comes first"),
        *zeros("u8", "spi_protocol"),
        *zeros("u32", "spi_id"),
        *zeros("u8", "spi_channels camera_angle"),
        bound("u8", "interpolation_channels", unused()),
        bound("u8", "smoothing_type", unused()),
        *zeros("u8", "smoothing_setpoint_hz smoothing_feedforward_hz"),
        bound("u8", "smoothing_setpoint_type", unused()),
        bound("u8", "smoothing_derivative_type", unused()),
        *zeros("u8", "usb_hid smoothing_auto_factor"),
        bound("u8", "smoothing", scaled("interpolation"), "", "a ramp between two frames"),
        bound("u8", "elrs_uid", constant(0), count=6),
    ),
    _pair(
        Msp.RX_MAP,
        Msp.SET_RX_MAP,
        *(
            bound("u8", name, scaled(f"map_{name}"), "channel", "of the receiver that is this one")
            for name in ("roll", "pitch", "yaw", "throttle", "aux1", "aux2", "aux3", "aux4")
        ),
        required=8,
    ),
    _pair(Msp.RSSI_CONFIG, Msp.SET_RSSI_CONFIG, *zeros("u8", "channel")),
    _pair(
        Msp.RC_DEADBAND,
        Msp.SET_RC_DEADBAND,
        bound("u8", "roll_pitch", scaled("deadband_us"), "us"),
        bound("u8", "yaw", scaled("yaw_deadband_us"), "us"),
        *zeros("u8", "altitude_hold"),
        bound("u16", "throttle_3d", constant(50), "us"),
    ),
    _pair(
        Msp.FAILSAFE_CONFIG,
        Msp.SET_FAILSAFE_CONFIG,
        bound("u8", "delay", scaled("failsafe_delay_ms", 0.01), "0.1 s", "from the last frame to the stage"),
        bound("u8", "off_delay", scaled("failsafe_descend_ms", 0.01), "0.1 s", "then the motors stop"),
        bound("u16", "throttle", scaled("failsafe_throttle", 1000, 1000), "us", "while descending"),
        *zeros("u8", "switch_mode"),
        *zeros("u16", "throttle_low_delay"),
        bound("u8", "procedure", choice("failsafe_stage", 1, 0), "", "0 land, 1 drop"),
    ),
)

# --- Configuration, ports, motors --------------------------------------------------------------------
_ADVANCED = (
    bound("u8", "gyro_denominator", constant(1)),
    bound("u8", "pid_denominator", source(MspSource.PROCESS_DENOMINATOR), "", "gyro samples a control step"),
    *zeros("u8", "unsynced_pwm"),
    bound("u8", "motor_protocol", choice("motor_protocol", 6, 7), "", "6 DShot300, 7 DShot600"),
    *zeros("u16", "pwm_rate"),
    bound("u16", "motor_idle", source(MspSource.IDLE), "0.01 %", "of the controller that flies"),
    bound("u8", "gyro_32khz", unused()),
    *zeros("u8", "pwm_inversion gyro_to_use gyro_high_range"),
    bound(
        "u8",
        "calibration_threshold",
        constant(round(CALIBRATION_MOTION_DEG_S * GYRO_COUNTS_PER_DEG_S)),
        "counts",
    ),
    bound("u16", "calibration_time", constant(CALIBRATION_MS // 10), "0.01 s"),
    *zeros("u16", "gyro_yaw_offset"),
    bound("u8", "gyro_overflow_check", constant(2), "", "all axes"),
    *zeros("u8", "debug_mode"),
)
_MOTOR = (
    *zeros("u16", "throttle_min"),
    bound("u16", "throttle_max", constant(2000), "us"),
    bound("u16", "command_min", constant(1000), "us"),
)
_MOTOR_REST = (bound("u8", "poles", constant(MOTOR_POLES)), *zeros("u8", "dshot_telemetry"))
_ALIGNMENT = (
    bound(
        "u8",
        "gyro_1_align",
        scaled("gyro_alignment"),
        "",
        "0 the board's, 1 to 4: turned by 0, 90, 180, 270 deg",
    ),
    *zeros("u8", "gyro_2_align"),
)
_OLD_ALIGNMENT = (
    told("u8", "gyro_align", scaled("gyro_alignment"), "", "as gyro_1_align, which counts"),
    *zeros("u8", "acc_align mag_align"),
)
_SENSORS = (
    bound("u8", "acc_hardware", constant(PRESENT), "", "0 any, 1 none"),
    bound("u8", "baro_hardware", constant(ABSENT_PART)),
    bound("u8", "mag_hardware", constant(ABSENT_PART)),
)
_GENERAL = (
    _pair(
        Msp.FEATURE_CONFIG,
        Msp.SET_FEATURE_CONFIG,
        bound(
            "u32",
            "features",
            source(MspSource.FEATURES),
            "bits",
            "3 serial receiver, 4 motors stop, 14 MSP receiver, 22 airmode",
        ),
    ),
    _pair(
        Msp.ARMING_CONFIG,
        Msp.SET_ARMING_CONFIG,
        *zeros("u8", "auto_disarm_delay"),
        bound("u8", "kill_switch", unused()),
        bound("u8", "small_angle", source(MspSource.SMALL_ANGLE), "deg", "tilt that arming allows; 180: any"),
    ),
    Configuration(
        reply(Msp.ADVANCED_CONFIG, *_ADVANCED, bound("u8", "debug_modes", constant(1))),
        request(Msp.SET_ADVANCED_CONFIG, *_ADVANCED, required=1),
    ),
    _pair(
        Msp.BEEPER_CONFIG,
        Msp.SET_BEEPER_CONFIG,
        bound("u32", "off", source(MspSource.BEEPERS), "bits", "conditions that do not beep"),
        *zeros("u8", "beacon_tone"),
        bound("u32", "beacon_off", constant(0x202), "bits", "conditions that make no motor beep"),
    ),
    _pair(
        Msp.MIXER_CONFIG,
        Msp.SET_MIXER_CONFIG,
        bound("u8", "mixer", source(MspSource.MIXER), "", "3 quad X, 10 hex X, 23 another"),
        bound("u8", "reversed", scaled("motors_reversed"), "", "propellers out"),
    ),
    Configuration(
        reply(
            Msp.MOTOR_CONFIG,
            *_MOTOR,
            bound("u8", "motors", source(MspSource.MOTOR_COUNT)),
            *_MOTOR_REST,
            *zeros("u8", "esc_sensor"),
        ),
        request(Msp.SET_MOTOR_CONFIG, *_MOTOR, *_MOTOR_REST, required=1),
    ),
    _pair(
        Msp.MOTOR_3D_CONFIG,
        Msp.SET_MOTOR_3D_CONFIG,
        bound("u16", "deadband_low", constant(1406), "us"),
        bound("u16", "deadband_high", constant(1514), "us"),
        bound("u16", "neutral", constant(1460), "us"),
    ),
    _pair(
        Msp.BOARD_ALIGNMENT_CONFIG,
        Msp.SET_BOARD_ALIGNMENT_CONFIG,
        *(bound("i16", axis, scaled(f"board_{axis}_deg"), "deg") for axis in AXES),
        read_first=True,
    ),
    Configuration(
        reply(
            Msp.SENSOR_ALIGNMENT,
            *_OLD_ALIGNMENT,
            bound("u8", "gyros_found", constant(1), "bits"),
            *zeros("u8", "gyro_to_use"),
            *_ALIGNMENT,
        ),
        request(
            Msp.SET_SENSOR_ALIGNMENT, *_OLD_ALIGNMENT, *zeros("u8", "gyro_to_use"), *_ALIGNMENT, required=1
        ),
        read_first=True,
    ),
    Configuration(
        reply(Msp.SENSOR_CONFIG, *_SENSORS, *zeros("u8", "sonar_hardware")),
        request(Msp.SET_SENSOR_CONFIG, *_SENSORS, *zeros("u8", "sonar_hardware"), required=1),
    ),
    _pair(Msp.COMPASS_CONFIG, Msp.SET_COMPASS_CONFIG, *zeros("i16", "declination")),
    _pair(Msp.ACC_TRIM, Msp.SET_ACC_TRIM, *zeros("i16", "pitch roll")),
    _read_only(
        Msp.SENSOR_CONFIG_ACTIVE,
        bound("u8", "gyro_hardware", constant(PRESENT)),
        *_SENSORS,
        *zeros("u8", "sonar_hardware"),
    ),
    _read_only(
        Msp.GYRO_SENSOR, bound("u8", "gyros", constant(1)), bound("u8", "gyro_hardware", constant(PRESENT))
    ),
    _read_only(Msp.DATAFLASH_SUMMARY, *zeros("u8", "flags"), *zeros("u32", "sectors total_size used_size")),
    _read_only(Msp.SDCARD_SUMMARY, *zeros("u8", "flags state last_error"), *zeros("u32", "free_kb total_kb")),
    _read_only(
        Msp.BLACKBOX_CONFIG,
        *zeros("u8", "supported device rate_numerator rate_denominator"),
        *zeros("u16", "p_denominator"),
        *zeros("u8", "sample_rate"),
        *zeros("u32", "fields_off"),
    ),
)

# --- PID tuning -------------------------------------------------------------------------------------------
_GYRO_FILTERS = (_lowpass(0, "gyro_lowpass_hz"), _lowpass(1, "gyro_lowpass2_hz"))
_FILTERS = (
    told(
        "u8", "gyro_lowpass_coarse", source(MspSource.LOWPASS_HZ, 0), "Hz", "as gyro_lowpass_hz, which counts"
    ),
    bound("u16", "d_lowpass_hz", _D_LOWPASS, "Hz", _D_MEANING),
    *zeros("u16", "yaw_lowpass_hz"),
    *_notch(2, "gyro_notch_hz", "gyro_notch_cutoff"),
    *zeros("u16", "d_notch_hz d_notch_cutoff"),
    *_notch(3, "gyro_notch2_hz", "gyro_notch2_cutoff"),
    *zeros("u8", "d_lowpass_type gyro_hardware_lowpass"),
    bound("u8", "gyro_32khz_lowpass", unused()),
    *_GYRO_FILTERS,
    bound("u8", "gyro_lowpass_type", source(MspSource.LOWPASS_TYPE, 0), "", "0 PT1, 1 biquad, 2 PT2, 3 PT3"),
    bound("u8", "gyro_lowpass2_type", source(MspSource.LOWPASS_TYPE, 1)),
    *zeros("u16", "d_lowpass2_hz"),
    *zeros("u8", "d_lowpass2_type"),
    *zeros(
        "u16", "gyro_lowpass_dynamic_min gyro_lowpass_dynamic_max d_lowpass_dynamic_min d_lowpass_dynamic_max"
    ),
    bound("u8", "dynamic_notch_range", unused()),
    bound("u8", "dynamic_notch_width", unused(), "%"),
    bound("u16", "dynamic_notch_q", scaled("dynamic_notch_q", 100), "0.01"),
    bound("u16", "dynamic_notch_min", scaled("dynamic_notch_low_hz"), "Hz"),
    *zeros("u8", "rpm_harmonics rpm_min"),
    bound("u16", "dynamic_notch_max", scaled("dynamic_notch_high_hz"), "Hz"),
    *zeros("u8", "dynamic_lowpass_expo"),
    bound("u8", "dynamic_notches", scaled("dynamic_notch_count")),
)
_PID_ADVANCED = (
    bound("u16", "i_ignore_rate", unused()),
    bound("u16", "yaw_i_ignore_rate", unused()),
    bound("u16", "yaw_p_limit", unused()),
    bound("u8", "delta_method", unused()),
    bound("u8", "voltage_compensation", unused()),
    *zeros("u8", "feedforward_transition"),
    bound("u8", "setpoint_weight_coarse", unused()),
    bound("u8", "tolerance_band", unused()),
    bound("u8", "tolerance_band_reduction", unused()),
    bound("u8", "i_throttle_gain", unused()),
    *zeros("u16", "max_velocity max_velocity_yaw"),
    *zeros("u8", "level_angle_limit level_sensitivity"),
    bound("u16", "i_throttle_threshold", unused()),
    *zeros("u16", "anti_gravity_gain"),
    bound("u16", "setpoint_weight", unused()),
    *zeros("u8", "i_rotation"),
    bound("u8", "smart_feedforward", unused()),
    *zeros("u8", "i_relax i_relax_type absolute_control throttle_boost trainer_angle"),
    *zeros("u16", "feedforward_roll feedforward_pitch feedforward_yaw"),
    bound("u8", "anti_gravity_mode", unused()),
    *zeros("u8", "d_max_roll d_max_pitch d_max_yaw d_max_gain d_max_advance"),
    *zeros("u8", "integrated_yaw integrated_yaw_relax i_relax_cutoff"),
    bound("u8", "motor_limit", scaled("motor_limit", 100), "%", "largest motor output"),
    *zeros("i8", "profile_cells"),
    *zeros("u8", "idle_min_rpm feedforward_averaging feedforward_smoothing feedforward_boost"),
    *zeros("u8", "feedforward_max_rate_limit feedforward_jitter voltage_sag_compensation thrust_linear"),
    bound("u8", "tpa_mode", constant(1), "", "the throttle attenuates D alone"),
    bound("u8", "tpa_rate", source(MspSource.TPA_RATE), "%", _D_MEANING),
    bound("u16", "tpa_breakpoint", source(MspSource.TPA_BREAKPOINT), "us", _D_MEANING),
)
_MULTIPLIERS = "master roll_pitch_ratio i_gain d_gain pi_gain d_max_gain feedforward_gain pitch_pi_gain"
_SLIDERS = (
    *zeros("u8", "pids_mode"),
    *(bound("u8", f"slider_{name}", constant(MULTIPLIER_OFF), "%") for name in _MULTIPLIERS.split()),
    bound("u32", "reserved1", unused()),
    bound("u32", "reserved2", unused()),
    *zeros("u8", "d_filter"),
    bound("u8", "d_filter_multiplier", constant(MULTIPLIER_OFF), "%"),
    bound("u16", "d_lowpass_hz", _D_LOWPASS, "Hz", _D_MEANING),
    *zeros("u16", "d_lowpass2_hz d_lowpass_dynamic_min d_lowpass_dynamic_max"),
    bound("u32", "reserved3", unused()),
    bound("u32", "reserved4", unused()),
    *zeros("u8", "gyro_filter"),
    bound("u8", "gyro_filter_multiplier", constant(MULTIPLIER_OFF), "%"),
    *_GYRO_FILTERS,
    *zeros("u16", "gyro_lowpass_dynamic_min gyro_lowpass_dynamic_max"),
    bound("u32", "reserved5", unused()),
    bound("u32", "reserved6", unused()),
)


def _rate(axis: int, part: int, name: str) -> MspField:
    return bound("u8", name, source(MspSource.RATE, 3 * axis + part), "of its type")


_TUNING = (
    _pair(
        Msp.PID,
        Msp.SET_PID,
        *(
            bound(
                "u8",
                f"{axis}_{term}",
                source(MspSource.PID, 3 * i + j),
                "the ecosystem's",
                _D_MEANING.split(";")[0],
            )
            for i, axis in enumerate(AXES)
            for j, term in enumerate("pid")
        ),
        *zeros("u8", "level_p level_i level_d mag_p mag_i mag_d"),
    ),
    _pair(Msp.PID_ADVANCED, Msp.SET_PID_ADVANCED, *_PID_ADVANCED),
    _pair(
        Msp.RC_TUNING,
        Msp.SET_RC_TUNING,
        _rate(0, 0, "roll_rate"),
        _rate(0, 2, "roll_expo"),
        _rate(0, 1, "roll_max"),
        _rate(1, 1, "pitch_max"),
        _rate(2, 1, "yaw_max"),
        bound("u8", "tpa_rate_old", unused()),
        bound("u8", "throttle_mid", constant(50), "%"),
        *zeros("u8", "throttle_expo"),
        bound("u16", "tpa_breakpoint_old", unused()),
        _rate(2, 2, "yaw_expo"),
        _rate(2, 0, "yaw_rate"),
        _rate(1, 0, "pitch_rate"),
        _rate(1, 2, "pitch_expo"),
        *zeros("u8", "throttle_limit"),
        bound("u8", "throttle_limit_percent", constant(100), "%"),
        *(bound("u16", f"{axis}_rate_limit", constant(RATE_LIMIT), "deg/s") for axis in AXES),
        bound("u8", "type", source(MspSource.RATES_TYPE), "", "0 Betaflight, 3 actual"),
    ),
    _pair(Msp.FILTER_CONFIG, Msp.SET_FILTER_CONFIG, *_FILTERS),
    _pair(Msp.SIMPLIFIED_TUNING, Msp.SET_SIMPLIFIED_TUNING, *_SLIDERS),
    _read_only(Msp.VALIDATE_SIMPLIFIED_TUNING, *zeros("u8", "pids_valid gyro_valid d_valid")),
)

CONFIGURATIONS = (*_POWER, *_RECEIVER, *_GENERAL, *_TUNING)
