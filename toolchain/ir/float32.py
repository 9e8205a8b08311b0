"""Float32 arithmetic that rounds exactly as the compiled C does.

numpy has no fused multiply-add; this one gives the bits of C's `fmaf` on every input, so that
`toolchain.ir.interpreter` and the firmware can be compared bit by bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float32 = NDArray[np.float32]


def fma(a: ArrayLike, b: ArrayLike, c: ArrayLike) -> Float32:
    """Compute a b + c with a single rounding to float32, element by element; shapes broadcast.

    The product of two float32 values has at most 48 significant bits, so it is exact in float64. Only
    the sum rounds, and rounding it to float64 and then to float32 would round twice. TwoSum recovers
    what the sum lost; where something was lost, the sum is rounded to odd instead (its last bit is made
    1 on the side of the exact value). A value rounded to odd at 53 bits rounds to any format of at most
    51 bits as the exact value does (Boldo and Melquiond 2008), float32's subnormals included.
    Infinities and NaN follow IEEE 754; the payload of a NaN means nothing.
    """
    with np.errstate(all="ignore"):
        product = np.asarray(a, np.float32).astype(np.float64) * np.asarray(b, np.float32)
        addend = np.asarray(c, np.float32).astype(np.float64)
        total = np.atleast_1d(product + addend)
        back = total - product
        lost = (product - (total - back)) + (addend - back)
        bits = total.view(np.int64)
        to_odd = np.isfinite(total) & (lost != 0) & (bits & 1 == 0)
        # Sign and magnitude: the next integer is the next float64 away from zero.
        bits += np.where(to_odd, np.where((lost > 0) == (total > 0), 1, -1), 0)
        return total.astype(np.float32).reshape(np.broadcast_shapes(product.shape, addend.shape))
