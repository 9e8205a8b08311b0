"""Runs cppcheck over the firmware's C, a policy's included.

    python -m neuroflight.toolchain.image.cppcheck POLICY.onnx

What it may not say stands in firmware/cppcheck.txt, with the reason for each.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.errors import BuildError, NeuroflightError
from neuroflight.toolchain.files import write_text
from neuroflight.toolchain.image.build import BOARD_FAMILY
from neuroflight.toolchain.policy.model import read_policy
from neuroflight.toolchain.rendering.contract_header import render_contract

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
ANALYSER = "cppcheck"
SOURCES = ("src", "hal/stm32f7", "hal/host")
OPTIONS = (
    *("--std=c11", "--platform=unix64", "--quiet", "--error-exitcode=1"),
    *("--enable=warning,style,performance,portability", "--inline-suppr"),
    "--template={file}:{line}: {severity}: {message} [{id}]",
)


def analyse(policy: Path, firmware: Path = FIRMWARE) -> str:
    """Run cppcheck on the firmware with `policy`: its findings, one a line; empty without any.

    Raises PolicyError or BuildError if it cannot run.
    """
    if shutil.which(ANALYSER) is None:
        raise BuildError(f"{ANALYSER} is not installed; run: sudo apt-get install {ANALYSER}")
    emission = compile_policy(read_policy(policy)).emission
    with tempfile.TemporaryDirectory(prefix="neuroflight-lint-") as folder:
        generated = Path(folder)
        write_text(generated / "nf_contract.h", render_contract())
        write_text(generated / "policy.h", emission.header)
        write_text(generated / "policy.c", emission.source)
        include = [
            f"-I{path}"
            for path in (firmware, firmware / "src", firmware / "targets" / BOARD_FAMILY, generated)
        ]
        sources = [str(firmware / source) for source in SOURCES] + [str(generated / "policy.c")]
        suppressed = f"--suppressions-list={firmware / 'cppcheck.txt'}"
        command = [ANALYSER, *OPTIONS, suppressed, *include, *sources]
        done = subprocess.run(command, capture_output=True, text=True)
    return done.stdout + done.stderr


def main(argv: Sequence[str]) -> int:
    """Run the check and print its findings. Returns 0 if there are none."""
    try:
        found = analyse(Path(argv[0]))
    except NeuroflightError as error:
        print(f"lint: {error}", file=sys.stderr)
        return 1
    print(found or f"{ANALYSER}: nothing found in the firmware")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
