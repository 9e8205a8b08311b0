"""The firmware's PID (firmware/src/control/pid.c) as a library that steps one for each of N aircraft.

The number of motors is a constant of the firmware: each has a library of its own.
"""

from __future__ import annotations

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
FILES = (HEADER, HEADER.with_suffix(".c"), *(FIRMWARE / "common" / name for name in ("held.h", "limit.h")))
_GAINS = re.compile(r"struct pid_gains \{.*?\n\};", re.DOTALL)


@cache
def library(motors: int) -> compiled.Library:
    """Return the PIDs of aircraft with so many motors. Raises BuildError, one line."""
    if missing := next((path for path in FILES if not path.is_file()), None):
        raise BuildError(f"the PID is the firmware's, and {missing} is missing: run from a whole checkout")
    contract = compiled.CACHE / "contract" / "nf_contract.h"
    write_text_if_changed(contract, render_contract())
    return compiled.load(
        compiled.Source(
            name=f"pid-{motors}",
            what="the firmware's PID",
            parts=(C,),
            files=(*FILES, contract),
            flags=(f"-DPOLICY_ACTION_COUNT={motors}",),
            includes=(C, FIRMWARE, contract.parent),
            declares=_gains(motors),
        )
    )


def _gains(motors: int) -> str:
    """Return the declaration of struct pid_gains as cffi reads it."""
    found = _GAINS.search(HEADER.read_text())
    assert found is not None, HEADER
    return found.group().replace("enum nf_mix", "unsigned").replace("POLICY_ACTION_COUNT", str(motors))
