"""Networks in C (`c/`) for the learners that are in C: their build, and arrays that Python and C share."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from cffi import FFI
from numpy.typing import NDArray

from neuroflight.sim import compiled
from neuroflight.sim.physics.library import fused

LEARNERS = Path(__file__).parents[1]
C = Path(__file__).parent / "c"
# Branches may become selections, and square roots are the processor's: no value depends on it.
FLAGS = ("-O3", "-fno-trapping-math", "-fno-math-errno", "-Wno-psabi", "-Wno-unknown-pragmas")
CACHE_LINE = 64  # bytes
_FFI = FFI()  # arrays of numbers are of the same types in every library
_KINDS = {"float64": "double[]", "float32": "float[]", "int32": "int32_t[]"}


@cache
def load(learner: str, number: str) -> compiled.Library:
    """Load the C of a `learner` (a folder beside this one) with the networks. Raises BuildError, one line.

    number: float32 for training, float64 for tests.
    """
    wide = ("-DFLOAT64",) if number == "float64" else ()
    return compiled.load(
        compiled.Source(
            name=f"{learner}-{number}",
            what=f"the {learner} learner",
            parts=(C / number, C, LEARNERS / learner / "c"),
            flags=(*FLAGS, *fused(), *wide),
            includes=(LEARNERS,),
        )
    )


def pointer(array: NDArray[Any] | None) -> Any:  # noqa: ANN401 - of cffi
    """Return a pointer to the first element of an array in C order, kept by the caller; NULL for None."""
    return _FFI.NULL if array is None else _FFI.from_buffer(_KINDS[array.dtype.name], array)


def aligned(count: int, number: str) -> NDArray[np.floating]:
    """Allocate `count` numbers, not initialized, at the start of a cache line."""
    raw = np.empty(count * np.dtype(number).itemsize + CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE
    return raw[start : start + count * np.dtype(number).itemsize].view(number)
