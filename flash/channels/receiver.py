"""The error for a board that takes no channels over MSP, with the settings to change."""

from __future__ import annotations

from collections.abc import Callable

from neuroflight.flash.settings.text import Value, value_text
from neuroflight.toolchain.errors import LinkError

SETTING, MSP = "receiver_protocol", "msp"


def not_listening(name: str, get: Callable[[str], Value]) -> LinkError:
    """Return the error for a board that refused a frame as ABSENT. name: of the port; get: a setting's value
    by name.

    The stored settings are reported; those in use since the last start may differ.
    """
    told = value_text(SETTING, get(SETTING))
    why = "and not flown before a restart" if told == MSP else "so the board listens to its receiver"
    return LinkError(
        f"{name}: receiver_protocol is {told}, {why}, expected {MSP}; no channel was taken; run: "
        f"neuroflight board settings set --port {name} {SETTING}={MSP} --save --reboot"
    )
