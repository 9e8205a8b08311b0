"""The flights and their derivatives in C (`c/`), and the arrays that Python and C share."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim import compiled
from sim.physics.library import fused

C = Path(__file__).parent / "c"
# Branches may become selections, and square roots are the processor's: no value depends on it.
FLAGS = ("-O3", "-fno-trapping-math", "-fno-math-errno", "-Wno-psabi", "-Wno-unknown-pragmas")
_KINDS = {"float64": "double[]", "float32": "float[]", "int32": "int32_t[]"}


@cache
def library(number: str = "float32") -> compiled.Library:
    """The flights in C; number: float32 for training, float64 for tests. Raises BuildError, one line."""
    wide = ("-DFLOAT64",) if number == "float64" else ()
    return compiled.load(
        compiled.Source(
            name=f"pathwise-{number}",
            what="the pathwise learner",
            parts=(C / number, C),
            flags=(*FLAGS, *fused(), *wide),
        )
    )


def pointer(array: NDArray[Any] | None) -> Any:  # noqa: ANN401 - a pointer of cffi
    """Pointer to the first element of an array in C order, which the caller keeps alive; NULL for None."""
    ffi = library().ffi
    return ffi.NULL if array is None else ffi.from_buffer(_KINDS[array.dtype.name], array)


def aligned(count: int, number: str) -> NDArray[np.floating]:
    """`count` numbers, not initialized, at the start of a cache line."""
    line = 64
    raw = np.empty(count * np.dtype(number).itemsize + line, np.uint8)
    start = -raw.ctypes.data % line
    return raw[start : start + count * np.dtype(number).itemsize].view(number)
