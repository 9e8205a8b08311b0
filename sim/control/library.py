"""The firmware's PID and its notches at rotors' turns as a library that steps one for each of N aircraft.

The number of motors is a constant of the firmware: each has a library of its own.
"""

from __future__ import annotations

import platform
import re
from functools import cache
from pathlib import Path

from neuroflight.sim import compiled
from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.files import write_text_if_changed
from neuroflight.toolchain.rendering.contract_header import render_contract

C = Path(__file__).parent / "c"
FIRMWARE = Path(__file__).resolve().parents[2] / "firmware" / "src"
HEADER = FIRMWARE / "control" / "pid.h"
_COMPILED = ("control/pid", "sensing/rpm_filter", "common/nf_math")
_INCLUDED = ("common/held", "common/limit", "sensing/rotors", "sensing/svf", "sensing/svf_step")
FILES = (
    *(FIRMWARE / f"{name}.{kind}" for name in _COMPILED for kind in "hc"),
    *(FIRMWARE / f"{name}.h" for name in _INCLUDED),
)
# An instruction, as in the firmware's host builds, that is a function of the same bits without it.
FUSED = ("-mfma",) if platform.machine() in ("x86_64", "AMD64") else ()
_GAINS = re.compile(r"struct pid_gains \{.*?\n\};", re.DOTALL)


@cache
def library(motors: int) -> compiled.Library:
    """Return the library for aircraft with so many motors. Raises BuildError, one line."""
    if missing := next((path for path in FILES if not path.is_file()), None):
        raise BuildError(
            f"PID and filters are the firmware's, and {missing} is missing: run from a whole checkout"
        )
    contract = compiled.CACHE / "contract" / "nf_contract.h"
    write_text_if_changed(contract, render_contract())
    return compiled.load(
        compiled.Source(
            name=f"control-{motors}",
            what="the firmware's PID and RPM filter",
            parts=(C,),
            files=(*FILES, contract),
            flags=(f"-DPOLICY_ACTION_COUNT={motors}", *FUSED),
            includes=(C, FIRMWARE, contract.parent),
            declares=_gains(motors),
        )
    )


def _gains(motors: int) -> str:
    """Return the declaration of struct pid_gains as cffi reads it."""
    found = _GAINS.search(HEADER.read_text())
    assert found is not None, HEADER
    return found.group().replace("enum nf_mix", "unsigned").replace("POLICY_ACTION_COUNT", str(motors))
