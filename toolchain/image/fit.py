"""The policy's part of the chip's memories, and its functions that run from ITCM.

image.ld keeps the rest of the image to what is left, so that a policy that fits its parts links whatever it
consists of. Functions of the policy that find no room in its part of ITCM run from flash: the same bits, but
more slowly.
Make calls this module for the linker's list of the others:

    python -m neuroflight.toolchain.image.fit policy.o policy.ld
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from neuroflight.toolchain import contract
from neuroflight.toolchain.codegen.plan import CodePlan
from neuroflight.toolchain.errors import BuildError, PolicyError
from neuroflight.toolchain.image.elf import Section, read_image

POLICY_ITCM_BYTES = 2816  # image.ld: POLICY_ITCM
POLICY_CALLS_MAX, CALL_BYTES = 800, 32  # of kernels in a step; code that one takes in policy_step, about
CODE = ".text."  # begins the name of each function's section
# What a step runs through most often for its size comes first; what goes through its code once, last.
INNER_LOOPS = ("linear8", "linear4", "look_up")
ONCE = ("policy_step", "policy_init")
ALIGNMENT, VENEER_BYTES = 8, 8  # of a function; what leads from ITCM to one in flash


def check_memories(plan: CodePlan) -> None:
    """Raise PolicyError naming the first memory that the policy is too large for."""
    weights, memory = plan.table.size, plan.memory
    narrower = "train one with narrower layers or fewer recurrent units"
    for region, what, count, most, size, advice in (
        ("DTCM", "weights", weights, contract.POLICY_WEIGHT_COUNT_MAX, 4, "train a smaller network"),
        ("DTCM", "floats to work on", memory, contract.POLICY_MEMORY_COUNT_MAX, 4, narrower),
        ("the bank", "kernel calls", len(plan.calls), POLICY_CALLS_MAX, CALL_BYTES, "train fewer layers"),
    ):
        if count > most:
            raise PolicyError(
                f"the policy has {count:,} {what}, {region} has room for {most:,}: "
                f"{size * (count - most):,} bytes too many; {advice}"
            )


def split(code: Iterable[Section]) -> tuple[list[Section], list[Section]]:
    """Split a policy's functions into those that run from ITCM and those that do not fit there."""
    fast: list[Section] = []
    slow: list[Section] = []
    room = POLICY_ITCM_BYTES
    for section in sorted(code, key=_rank):
        size = -(-section.size // ALIGNMENT) * ALIGNMENT
        fits = size <= room
        (fast if fits else slow).append(section)
        room -= size if fits else VENEER_BYTES
    return fast, slow


def policy_code(policy_object: Path) -> list[Section]:
    """Return the functions of a compiled policy, a section each. Raises BuildError."""
    return [s for s in read_image(policy_object).sections if s.name.startswith(CODE)]


def _rank(section: Section) -> tuple[int, int, str]:
    name = section.name.removeprefix(CODE).partition(".")[0]
    if name in INNER_LOOPS:
        return 0, INNER_LOOPS.index(name), section.name
    return (2 if name in ONCE else 1), section.size, section.name


def main(policy_object: Path, script: Path) -> None:
    """Write the linker's list of the functions in ITCM."""
    fast, _ = split(policy_code(policy_object))
    names = " ".join(section.name for section in fast)
    script.write_text(f"*obj/policy.o({names})\n")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]), Path(sys.argv[2]))
    except BuildError as error:
        sys.exit(str(error))
