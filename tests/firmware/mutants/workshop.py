"""A copy of the checkout in which the core's mistakes are made, built and tested, one after another."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from neuroflight.toolchain.errors import BuildError
from tests.firmware.conftest import SCRIPTED_BUILD, make_scripted
from tests.firmware.mutants.mutant import Mutant, MutantError

ROOT = Path(__file__).resolve().parents[3]
COPIED = (
    "cli",
    "firmware",
    "flash",
    "neuroflight.py",
    "sim",
    "tests",
    "toolchain",
    "training",
    "build/engine",
    "pyproject.toml",
)
LEFT_OUT = shutil.ignore_patterns("generated", ".*")
LIMIT_S = 120.0  # an endless loop is a mistake that is caught
PASSED, FAILED = 0, 1  # exit codes of pytest


@dataclass(frozen=True)
class Verdict:
    """What the tests said of a mutant."""

    mutant: Mutant
    caught_by: str  # the first test that failed; empty: none did

    @property
    def as_told(self) -> bool:
        """Was it caught if it must be, and did it survive if that is argued?"""
        return bool(self.caught_by) != bool(self.mutant.argued)


class Workshop:
    """The copy. Whoever makes one removes its folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in COPIED:
            source, target = ROOT / name, folder / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=LEFT_OUT)
            elif source.is_file():
                shutil.copy2(source, target)
        self._scripted = folder / "scripted"
        self.build()

    def build(self) -> None:
        """Compiles what has changed, with the project's own makefile. Raises BuildError."""
        make_scripted(self._scripted, motors=4, firmware=self.folder / "firmware")

    def test(self, tests: Sequence[str]) -> str:
        """The first test that fails, or how the run ended; empty: all pass."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-p", "no:cacheprovider"]
        command += [f"--basetemp={self.folder / 'basetemp'}"]
        command += [f"tests/firmware/{test}" for test in tests]
        # Those around us, if any, are for another run.
        told = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
        told |= {
            "PYTHONPATH": str(self.folder),
            SCRIPTED_BUILD: str(self._scripted),
            "NEUROFLIGHT_PROVES": "1",
        }
        told["PYTHON"] = sys.executable  # with which make stamps an image: the copy has no environment
        process = subprocess.Popen(
            command,
            cwd=self.folder,
            env=told,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        try:
            words = process.communicate(timeout=LIMIT_S)[0]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # with the programs that a test has started
            process.communicate()
            return f"no end within {LIMIT_S:g} s"
        if process.returncode == PASSED:
            return ""
        if process.returncode < 0:
            return f"the end of the run by {signal.Signals(-process.returncode).name}"
        failed = re.search(r"^FAILED tests/firmware/(.+?)(?: - .*)?$", words, re.MULTILINE)
        if process.returncode != FAILED or failed is None:
            raise MutantError(f"its tests do not run:\n{words}")
        return failed[1]

    def try_out(self, mutant: Mutant) -> Verdict:
        """What the mutant's tests say of it. Raises MutantError."""
        try:
            with mutated(mutant.source(self.folder / "firmware"), mutant):
                self.build()
                return Verdict(mutant, self.test(mutant.tests))
        except BuildError as error:
            raise MutantError(f"mutant {mutant.name}: it does not compile:\n{error}") from None
        except MutantError as error:
            raise MutantError(f"mutant {mutant.name}: {error}") from None


@contextmanager
def mutated(source: Path, mutant: Mutant) -> Iterator[None]:
    """Let the mistake stand in `source` for a while."""
    text = source.read_text()
    source.write_text(mutant.made(text))
    try:
        yield
    finally:
        source.write_text(text)
