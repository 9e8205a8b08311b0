"""The committed inputs of the fuzz targets, as files: corpus/TARGET/NAME.

Most are made here from the contract, so that a new command brings its own; `found_...` are inputs that once
broke a promise of the firmware and stay.
"""

from __future__ import annotations

from pathlib import Path

from tests.firmware.fuzz.command_line_seeds import command_line_seeds, words
from tests.firmware.fuzz.msp_seeds import msp_seeds
from tests.firmware.fuzz.receiver_seeds import crsf_seeds, sbus_seeds

CORPUS = Path(__file__).parent / "corpus"
FOUND = "found_"
SEEDS = {"sbus": sbus_seeds, "crsf": crsf_seeds, "msp": msp_seeds, "command_line": command_line_seeds}

WORDS = {"command_line": words}  # of a target, that libFuzzer is told


def write(target: str) -> None:
    """Make the files of a target anew, but for what was found."""
    folder = CORPUS / target
    folder.mkdir(parents=True, exist_ok=True)
    seeds = SEEDS[target]()
    for path in folder.iterdir():
        if path.name not in seeds and not path.name.startswith(FOUND):
            path.unlink()
    for name, data in seeds.items():
        (folder / name).write_bytes(data)


def stale(target: str) -> list[str]:
    """Names of files that are missing, differ from what the contract makes, or have no maker."""
    kept = {path.name: path.read_bytes() for path in (CORPUS / target).iterdir()}
    made = SEEDS[target]()
    strange = {name for name in kept if not name.startswith(FOUND)} - made.keys()
    return sorted(strange | {name for name, data in made.items() if kept.get(name) != data})
