"""Names of settings as MAVLink has room for them: 16 characters.

Parameters are told in capitals, as MAVProxy and dronekit ask for nothing else, and are found whatever the
case; no two differ in it alone.
"""

from __future__ import annotations

import zlib

from neuroflight.toolchain.contract import SETTINGS

NAME_MAX = 16  # characters of param_id
_NAMES = {setting.name: setting.parameter for setting in SETTINGS}


def parameter_name(setting: str) -> str:
    """Return the parameter that the setting called `setting` is.

    A long one that this tool does not know gets the beginning of its name and a checksum of it."""
    if len(setting) <= NAME_MAX:
        return setting
    return _NAMES.get(setting) or f"{setting[:11]}_{zlib.crc32(setting.encode()) & 0xFFFF:04x}"
