"""`python -m tests.firmware.mutants`: do the tests notice mistakes in the core? Each is made and tested.

Fails when more than 5 % of all mutants survive, when one survives that nobody has argued for or is caught
although somebody has, and when one has no place in the sources of today or does not compile.
"""

from __future__ import annotations

import argparse
import os
import queue
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from tests.firmware.mutants.mutant import Mutant, MutantError
from tests.firmware.mutants.table import MUTANTS
from tests.firmware.mutants.workshop import ROOT, Verdict, Workshop

SURVIVORS_MAX = 0.05  # of all mutants


def main(argv: Sequence[str] | None = None) -> int:
    """Try out the mutants that are named, or all. Returns 0 if the tests are good enough."""
    parser = argparse.ArgumentParser(
        prog="tests.firmware.mutants", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="default: all; part of a name is enough")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="at once")
    parser.add_argument("--list", action="store_true", help="only tell what there is")
    args = parser.parse_args(argv)
    chosen = [m for m in MUTANTS if not args.names or any(name in m.name for name in args.names)]
    strange = [name for name in args.names if not any(name in m.name for m in MUTANTS)]
    if strange or args.jobs < 1:
        wrong = f"no mutant's name has {strange[0]!r}; see --list" if strange else "--jobs: 1 at least"
        print(f"tests.firmware.mutants: {wrong}", file=sys.stderr)
        return 1
    if args.list:
        for mutant in chosen:
            print(f"{where(mutant)}: {mutant.name}{' (argued)' if mutant.argued else ''}")
        return 0
    missing = [tool for tool in ("gcc", "make") if shutil.which(tool) is None]
    if missing:
        print(f"tests.firmware.mutants: {missing[0]} is missing; install it", file=sys.stderr)
        return 1
    return try_out(chosen, args.jobs)


def try_out(mutants: Sequence[Mutant], jobs: int) -> int:
    """Try them out, so many at once; tell of each. Returns the exit code."""
    verdicts: list[Verdict] = []
    errors = 0
    with workshops(min(jobs, len(mutants))) as free, ThreadPoolExecutor(jobs) as pool:

        def one(mutant: Mutant) -> Verdict | MutantError:
            workshop = free.get()
            try:
                return workshop.try_out(mutant)
            except MutantError as error:
                return error
            finally:
                free.put(workshop)

        first = free.get()
        unchanged = first.test(sorted({test for mutant in mutants for test in mutant.tests}))
        free.put(first)
        if unchanged:
            print(f"the tests fail without any mistake: {unchanged}", file=sys.stderr)
            return 1
        for mutant, said in zip(mutants, pool.map(one, mutants), strict=True):
            if isinstance(said, MutantError):
                errors += 1
                print(said, flush=True)
                continue
            verdicts.append(said)
            how = f"caught by {said.caught_by}" if said.caught_by else "SURVIVED"
            argued = f" (argued: {mutant.argued})" if mutant.argued else ""
            print(f"{where(mutant)}: {mutant.name}: {how}{argued}", flush=True)
    survived = [verdict for verdict in verdicts if not verdict.caught_by]
    untold = [verdict for verdict in verdicts if not verdict.as_told]
    print(
        f"{len(verdicts) - len(survived)} of {len(mutants)} caught, {len(survived)} survived, "
        f"{len(untold)} otherwise than told, {errors} without a verdict"
    )
    return int(bool(errors or untold or len(survived) > SURVIVORS_MAX * len(MUTANTS)))


def where(mutant: Mutant) -> str:
    """Return the path of its file below firmware/."""
    return str(mutant.source(ROOT / "firmware").relative_to(ROOT / "firmware"))


@contextmanager
def workshops(count: int) -> Iterator[queue.Queue[Workshop]]:
    """So many workshops, in a folder that goes with them."""
    free: queue.Queue[Workshop] = queue.Queue()
    with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as folder:
        for number in range(count):
            free.put(Workshop(Path(folder) / str(number)))
        yield free


if __name__ == "__main__":
    raise SystemExit(main())
