"""Names of settings as MAVLink has room for them: 16 characters.

Most settings keep their names. The longer ones have a short name in this table, for good: ground stations
store parameters in files by name. Parameters are told in capitals, as MAVProxy and dronekit ask for nothing
else, and are found whatever the case; no two differ in it alone.
"""

from __future__ import annotations

import zlib

NAME_MAX = 16  # characters of param_id

SHORT = {
    "dynamic_notch_count": "dyn_notch_count",
    "dynamic_notch_low_hz": "dyn_notch_low_hz",
    "dynamic_notch_high_hz": "dyn_notch_hi_hz",
    "receiver_protocol": "rx_protocol",
    "failsafe_throttle": "fs_throttle",
    "failsafe_descend_ms": "fs_descend_ms",
    "failsafe_delay_ms": "fs_delay_ms",
    "battery_capacity_mah": "bat_capacity_mah",
    "blackbox_disabled_mask": "blackbox_off",
    "beep_receiver_lost": "beep_rx_lost",
    "beep_policy_refused": "beep_pol_refused",
    "beep_battery_warn": "beep_bat_warn",
    "runaway_detection": "runaway_detect",
    "plausibility_detection": "plausible_detect",
}


def parameter_name(setting: str) -> str:
    """Return the parameter's name for a setting. A long name that is not in the table, as of a newer
    firmware, becomes the beginning of its name and a checksum."""
    if len(setting) <= NAME_MAX:
        return setting
    return SHORT.get(setting) or f"{setting[:11]}_{zlib.crc32(setting.encode()) & 0xFFFF:04x}"
