"""pydfuutil 0.11 as its users run it, as a program: it takes each alternate setting of a device for another
device, once for every one of them, and is shown one of those here."""

from __future__ import annotations

from typing import Any

from pydfuutil import __main__ as program
from pydfuutil.dfu_util import DfuUtil

_probe = program.probe_devices


def _probe_once(devices: Any) -> None:
    _probe(devices)
    if DfuUtil.dfu_root is not None:
        DfuUtil.dfu_root.next = None


def main() -> None:
    """Run it with the words of the command line."""
    program.probe_devices = _probe_once
    program.main()
