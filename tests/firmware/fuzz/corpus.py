"""The inputs that fuzzing begins with: made from the contract, so that a new command brings its own.

An input of libFuzzer that broke a promise of the firmware becomes a seed, as bytes, in its target's file.
"""

from __future__ import annotations

from pathlib import Path

from tests.firmware.fuzz.command_line_seeds import command_line_seeds, words
from tests.firmware.fuzz.esc_answers_seeds import esc_answers_seeds
from tests.firmware.fuzz.msp_seeds import msp_seeds
from tests.firmware.fuzz.receiver_seeds import crsf_seeds, sbus_seeds
from tests.firmware.fuzz.usb_seeds import usb_disk_seeds, usb_serial_seeds

SEEDS = {
    "sbus": sbus_seeds,
    "crsf": crsf_seeds,
    "msp": msp_seeds,
    "command_line": command_line_seeds,
    "usb_serial": usb_serial_seeds,
    "usb_disk": usb_disk_seeds,
    "esc_answers": esc_answers_seeds,
}
WORDS = {"command_line": words}  # of a target, that libFuzzer is told


def write(target: str, folder: Path) -> list[Path]:
    """Write a target's inputs into a new folder, one file each. Returns the files, sorted."""
    folder.mkdir(parents=True)
    for name, data in SEEDS[target]().items():
        (folder / name).write_bytes(data)
    return sorted(folder.iterdir())
