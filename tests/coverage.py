"""`python -m tests.coverage`: what the tests reach of the firmware's core, while the sanitizers watch.

Builds of the host target are compiled with gcov's counters, AddressSanitizer and UndefinedBehaviorSanitizer;
the tests of the core that call them run as ever; gcovr sums up. Fails below LINES or BRANCHES percent.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SCRATCH = ROOT / "build" / "coverage"
LINES, BRANCHES = 90, 80  # percent of the core
# -Og: gcov's lines are the source's. -w: the sanitizers' own code draws warnings that no other build has.
INSTRUMENT = "--coverage -Og -w -fsanitize=address,undefined -fno-sanitize-recover=all"
# What looks at objects or at ARM code instead of running the core.
LEFT_OUT = (
    "board",
    "mutants",
    "test_laws.py",
    "test_makefile.py",
    "test_same_bits*.py",
    "*_same_bits.py",
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the tests, then sum up. Returns the first exit code that is not 0."""
    parser = argparse.ArgumentParser(prog="tests.coverage", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="also write the sources with their counts")
    parser.add_argument("tests", nargs="*", help="default: all of tests/firmware")
    args = parser.parse_args(argv)
    if shutil.which("gcc") is None:
        print("tests.coverage: gcc is missing; install it from the system's packages", file=sys.stderr)
        return 1
    shutil.rmtree(SCRATCH, ignore_errors=True)
    SCRATCH.mkdir(parents=True)
    return run_tests(args.tests) or sum_up(args.html)


def run_tests(tests: Sequence[str]) -> int:
    """Pytest with instrumented builds; returns its exit code."""
    runtime = subprocess.run(
        ["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True
    )
    watched = {
        "INSTRUMENT": INSTRUMENT,
        "LD_PRELOAD": runtime.stdout.strip(),  # Python loads a library that has the sanitizer inside
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's own
    }
    folder = ROOT / "tests" / "firmware"
    ignored = [path for pattern in LEFT_OUT for path in folder.rglob(pattern)]
    command = [sys.executable, "-m", "pytest", "-q", f"--basetemp={SCRATCH / 'tests'}"]
    command += [f"--ignore={path}" for path in ignored]
    command += tests or [str(folder)]
    return subprocess.run(command, cwd=ROOT, env=os.environ | watched).returncode


def sum_up(html: Path | None) -> int:
    """Coverage of firmware/src over all builds of the run; returns gcovr's exit code."""
    command = [sys.executable, "-m", "gcovr", "--root", str(ROOT / "firmware"), "--filter", "src/"]
    command += [
        "--exclude",
        "src/main.c",
        "--exclude-unreachable-branches",
        "--print-summary",
        "--sort",
        "uncovered-percent",
    ]
    command += [f"--fail-under-line={LINES}", f"--fail-under-branch={BRANCHES}"]
    command += [] if html is None else ["--html-details", str(html)]
    return subprocess.run([*command, str(SCRATCH / "tests")], cwd=ROOT / "firmware").returncode


if __name__ == "__main__":
    raise SystemExit(main())
