"""The port of a board that may be in the USB boot loader of its chip's ROM."""

from __future__ import annotations

import os

from neuroflight.cli.options import PORT_VARIABLE, find_port, told
from neuroflight.toolchain.errors import LinkError


def find_rescue_port() -> str:
    """Return NEUROFLIGHT_PORT, the only board in its ROM's USB boot loader, or what `find_port` finds.

    Raises LinkError.
    """
    from neuroflight.flash.rom.dfu_board import PORT, dfu_places

    if not os.environ.get(PORT_VARIABLE, ""):
        places = dfu_places()
        if len(places) == 1:
            return told(f"{PORT}:{places[0]}", "the only board in the USB boot loader of its ROM")
        if places:
            names = ", ".join(f"{PORT}:{place}" for place in places)
            raise LinkError(f"--port is missing, and got several: {names}; name one with --port")
    try:
        return find_port()
    except LinkError as error:
        raise LinkError(f"{error}; a board without a firmware: hold BOOT while you plug it in") from None


def find_flash_port() -> str:
    """Return what `find_port` finds, or the only board in its ROM's USB boot loader. Raises LinkError."""
    from neuroflight.flash.rom.dfu_board import dfu_places

    try:
        return find_port()
    except LinkError:
        if len(dfu_places()) != 1:
            raise
    return find_rescue_port()
