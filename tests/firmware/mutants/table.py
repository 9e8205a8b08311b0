"""All mutants of the core and the chip: the text files beside this one.

A paragraph is a mutant: its name, lines of C behind `-`, what stands there instead behind `+`; `in: FILE` if
they are found in several files, `argued: WHY` if no test can catch it. `tests: ...` holds for all below it.
"""

from __future__ import annotations

from pathlib import Path

from tests.firmware.mutants.mutant import Mutant


def read(text: str) -> list[Mutant]:
    """Return the mutants of a file."""
    found: list[Mutant] = []
    tests: tuple[str, ...] = ()
    for paragraph in text.split("\n\n"):
        name, *lines = [line for line in paragraph.strip().splitlines() if not line.startswith("#")] or [""]
        if name.startswith("tests: "):
            tests = tuple(name.split()[1:])
        elif name:
            old, new = ("\n".join(line[2:] for line in lines if line.startswith(mark)) for mark in "-+")
            told = dict(line.split(": ", 1) for line in lines if line[0] not in "-+")
            found.append(Mutant(name, old, new, tests, told.get("in", ""), told.get("argued", "")))
    return found


MUTANTS = tuple(
    mutant for path in sorted(Path(__file__).parent.glob("*.txt")) for mutant in read(path.read_text())
)
