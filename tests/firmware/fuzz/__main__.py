"""`python -m tests.firmware.fuzz`: libFuzzer looks for bytes that break a promise of the firmware.

Each target runs under the address and undefined-behaviour sanitizers, from its seeds on. What it
finds is kept, with the words of the sanitizer, in build/fuzz/findings. Returns 1 if it found something.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from neuroflight.toolchain.errors import BuildError
from tests.firmware.fuzz.build import TARGETS, Workbench
from tests.firmware.fuzz.fuzzer import fuzz

SCRATCH = Path(__file__).resolve().parents[3] / "build" / "fuzz"


def main(argv: Sequence[str] | None = None) -> int:
    """Fuzz the targets that are named, or all, one after another."""
    parser = argparse.ArgumentParser(prog="tests.firmware.fuzz", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"default: all of {', '.join(TARGETS)}")
    parser.add_argument("--seconds", type=int, default=30, metavar="N", help="of each target (30)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes of each target (1)")
    args = parser.parse_args(argv)
    strange = [name for name in args.targets if name not in TARGETS]
    if strange or args.seconds < 1 or args.jobs < 1:
        wrong = f"got {strange[0]!r}, expected some of {', '.join(TARGETS)}" if strange else ""
        print(f"tests.firmware.fuzz: {wrong or '--seconds and --jobs: 1 at least'}", file=sys.stderr)
        return 1
    chosen = args.targets or list(TARGETS)
    found = 0
    try:
        bench = Workbench(SCRATCH / "clang", "clang")
        bench.make()
        for name in chosen:
            run = fuzz(bench.program(name), name, args.seconds, args.jobs, SCRATCH)
            print(run, flush=True)
            found += len(run.findings)
    except BuildError as error:
        print(f"tests.firmware.fuzz: {error}", file=sys.stderr)
        return 1
    return int(found > 0)


if __name__ == "__main__":
    raise SystemExit(main())
