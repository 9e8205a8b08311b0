"""The physics in C (`c/`), and the arrays that Python and C share.

C is the one source of the twin's formulas: the twin steps N aircraft with it, and the functions of this
package call the same C for arrays of any shape. Sums run in a fixed order there, so that an aircraft alone
gets the bits that it gets among others, on every machine.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neuroflight.sim import compiled
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.errors import BuildError

C = Path(__file__).parent / "c"
CPU_INFO = Path("/proc/cpuinfo")
_KINDS = {
    np.dtype(kind): words
    for kind, words in (
        (np.float64, "double[]"),
        (np.int64, "int64_t[]"),
        (np.int32, "int32_t[]"),
        (np.bool_, "bool[]"),
    )
}


@cache
def library() -> compiled.Library:
    """Load the physics. Raises BuildError, one line."""
    numpy = Path(np.__file__).parent
    source = compiled.Source(
        name="physics",
        what="the twin",
        parts=(C,),
        flags=fused(),
        linked=(numpy / "random" / "lib" / "libnpyrandom.a",),
        versions=(np.__version__,),
    )
    if not source.linked[0].is_file():
        raise BuildError(
            f"the numpy package at {numpy} has no {source.linked[0].name}; install numpy's wheel"
        )
    return compiled.load(source)


def fused() -> tuple[str, ...]:
    """Return flags for a processor that has fused multiply-adds; on others a function gives the same bits."""
    words = set(CPU_INFO.read_text().split()) if CPU_INFO.is_file() else set()
    return ("-march=x86-64-v3",) if {"fma", "avx2", "bmi2"} <= words else ()


def pointer(array: NDArray[Any]) -> Any:  # noqa: ANN401 - a pointer of cffi
    """Return a pointer to the first element of an array in C order, which the caller keeps alive."""
    return library().ffi.from_buffer(_KINDS[array.dtype], array)


def struct(name: str, **values: Any) -> Any:  # noqa: ANN401 - a struct of cffi
    """Create a struct of C, zero but for `values`; it points to arrays, which the caller keeps alive."""
    made = library().ffi.new(f"struct {name} *")
    assign(made, **values)
    return made


def assign(made: Any, **values: Any) -> None:  # noqa: ANN401 - a struct of cffi
    """Set members of a struct; arrays as `struct` does."""
    for name, value in values.items():
        setattr(made, name, pointer(value) if isinstance(value, np.ndarray) else value)


def elements(*values: ArrayLike) -> list[Array]:
    """Broadcast the values to arrays of one shape, in C order."""
    return [np.asarray(value, np.float64, order="C") for value in np.broadcast_arrays(*values)]


def random_source(rng: np.random.Generator) -> Any:  # noqa: ANN401 - a pointer of cffi
    """Return the pointer by which C draws the generator's numbers; the caller keeps `rng` alive."""
    return library().ffi.cast("void *", rng.bit_generator.ctypes.bit_generator.value)
