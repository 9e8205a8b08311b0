"""Configuration messages of the ecosystem's PID tuning: gains, rates, filters."""

from __future__ import annotations

from neuroflight.toolchain.contract.frame_time_sensors import AXES
from neuroflight.toolchain.contract.msp_fields import (
    MspField,
    MspSource,
    bound,
    ignored,
    scaled,
    source,
    told,
    unused,
    zeros,
)
from neuroflight.toolchain.contract.msp_layouts import pair, read_only
from neuroflight.toolchain.contract.msp_table import Msp
from neuroflight.toolchain.contract.receiver import RATE_MAX_DEG_S

__all__ = ["TUNING"]
MULTIPLIER_OFF = 100  # of a slider that does nothing, %
RATE_LIMIT = int(RATE_MAX_DEG_S)


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


_D_LOWPASS = MspSource.D_LOWPASS_HZ
_D_MEANING = "of the PID that stands by; built in"

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
    *ignored("u8", "gyro_32khz_lowpass"),
    *_GYRO_FILTERS,
    bound("u8", "gyro_lowpass_type", source(MspSource.LOWPASS_TYPE, 0), "", "0 PT1, 1 biquad, 2 PT2, 3 PT3"),
    bound("u8", "gyro_lowpass2_type", source(MspSource.LOWPASS_TYPE, 1)),
    *zeros("u16", "d_lowpass2_hz"),
    *zeros("u8", "d_lowpass2_type"),
    *zeros(
        "u16", "gyro_lowpass_dynamic_min gyro_lowpass_dynamic_max d_lowpass_dynamic_min d_lowpass_dynamic_max"
    ),
    *ignored("u8", "dynamic_notch_range"),
    bound("u8", "dynamic_notch_width", unused(), "%"),
    bound("u16", "dynamic_notch_q", scaled("dynamic_notch_q", 100), "0.01"),
    bound("u16", "dynamic_notch_min", scaled("dynamic_notch_low_hz"), "Hz"),
    bound("u8", "rpm_harmonics", scaled("rpm_filter_harmonics")),
    bound("u8", "rpm_min", scaled("rpm_filter_min_hz"), "Hz"),
    bound("u16", "dynamic_notch_max", scaled("dynamic_notch_high_hz"), "Hz"),
    *zeros("u8", "dynamic_lowpass_expo"),
    bound("u8", "dynamic_notches", scaled("dynamic_notch_count")),
)
_PID_ADVANCED = (
    *ignored("u16", "i_ignore_rate yaw_i_ignore_rate yaw_p_limit"),
    *ignored("u8", "delta_method voltage_compensation"),
    *zeros("u8", "feedforward_transition"),
    *ignored("u8", "setpoint_weight_coarse tolerance_band tolerance_band_reduction i_throttle_gain"),
    *zeros("u16", "max_velocity max_velocity_yaw"),
    *zeros("u8", "level_angle_limit level_sensitivity"),
    *ignored("u16", "i_throttle_threshold"),
    *zeros("u16", "anti_gravity_gain"),
    *ignored("u16", "setpoint_weight"),
    *zeros("u8", "i_rotation"),
    *ignored("u8", "smart_feedforward"),
    *zeros("u8", "i_relax i_relax_type absolute_control throttle_boost trainer_angle"),
    *zeros("u16", "feedforward_roll feedforward_pitch feedforward_yaw"),
    *ignored("u8", "anti_gravity_mode"),
    *zeros("u8", "d_max_roll d_max_pitch d_max_yaw d_max_gain d_max_advance"),
    *zeros("u8", "integrated_yaw integrated_yaw_relax i_relax_cutoff"),
    bound("u8", "motor_limit", scaled("motor_limit", 100), "%", "largest motor output"),
    *zeros("i8", "profile_cells"),
    bound("u8", "idle_min_rpm", scaled("dynamic_idle_rpm", 0.01), "100 rpm"),
    *zeros("u8", "feedforward_averaging feedforward_smoothing feedforward_boost"),
    *zeros("u8", "feedforward_max_rate_limit feedforward_jitter voltage_sag_compensation thrust_linear"),
    bound("u8", "tpa_mode", 1, "", "the throttle attenuates D alone"),
    bound("u8", "tpa_rate", MspSource.TPA_RATE, "%", _D_MEANING),
    bound("u16", "tpa_breakpoint", MspSource.TPA_BREAKPOINT, "us", _D_MEANING),
)
_MULTIPLIERS = "master roll_pitch_ratio i_gain d_gain pi_gain d_max_gain feedforward_gain pitch_pi_gain"
_SLIDERS = (
    *zeros("u8", "pids_mode"),
    *(bound("u8", f"slider_{name}", MULTIPLIER_OFF, "%") for name in _MULTIPLIERS.split()),
    *ignored("u32", "reserved1 reserved2"),
    *zeros("u8", "d_filter"),
    bound("u8", "d_filter_multiplier", MULTIPLIER_OFF, "%"),
    bound("u16", "d_lowpass_hz", _D_LOWPASS, "Hz", _D_MEANING),
    *zeros("u16", "d_lowpass2_hz d_lowpass_dynamic_min d_lowpass_dynamic_max"),
    *ignored("u32", "reserved3 reserved4"),
    *zeros("u8", "gyro_filter"),
    bound("u8", "gyro_filter_multiplier", MULTIPLIER_OFF, "%"),
    *_GYRO_FILTERS,
    *zeros("u16", "gyro_lowpass_dynamic_min gyro_lowpass_dynamic_max"),
    *ignored("u32", "reserved5 reserved6"),
)


def _rate(axis: int, part: int, name: str) -> MspField:
    return bound("u8", name, source(MspSource.RATE, 3 * axis + part), "of its type")


TUNING = (
    pair(
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
    pair(Msp.PID_ADVANCED, Msp.SET_PID_ADVANCED, *_PID_ADVANCED),
    pair(
        Msp.RC_TUNING,
        Msp.SET_RC_TUNING,
        _rate(0, 0, "roll_rate"),
        _rate(0, 2, "roll_expo"),
        _rate(0, 1, "roll_max"),
        _rate(1, 1, "pitch_max"),
        _rate(2, 1, "yaw_max"),
        *ignored("u8", "tpa_rate_old"),
        bound("u8", "throttle_mid", 50, "%"),
        *zeros("u8", "throttle_expo"),
        *ignored("u16", "tpa_breakpoint_old"),
        _rate(2, 2, "yaw_expo"),
        _rate(2, 0, "yaw_rate"),
        _rate(1, 0, "pitch_rate"),
        _rate(1, 2, "pitch_expo"),
        *zeros("u8", "throttle_limit"),
        bound("u8", "throttle_limit_percent", 100, "%"),
        *(bound("u16", f"{axis}_rate_limit", RATE_LIMIT, "deg/s") for axis in AXES),
        bound("u8", "type", MspSource.RATES_TYPE, "", "0 Betaflight, 3 actual"),
        bound("u8", "throttle_hover", 50, "%"),
    ),
    pair(Msp.FILTER_CONFIG, Msp.SET_FILTER_CONFIG, *_FILTERS),
    pair(Msp.SIMPLIFIED_TUNING, Msp.SET_SIMPLIFIED_TUNING, *_SLIDERS),
    read_only(Msp.VALIDATE_SIMPLIFIED_TUNING, *zeros("u8", "pids_valid gyro_valid d_valid")),
)
