"""Activations as tables of cubics: no division, no branch, no libm, the same bits on every IEEE 754 machine.

f(x) = x G(|x|), or G(|x|) of an even table, for low <= x <= high and constant beyond, G one cubic on each
interval of width `step` around the multiples of `step`. Adding 1.5 * 2^23 * step, whose last bit is worth
`step`, rounds |x| to a multiple of it: the sum's low bits are the number of the row, and what is left of |x|
is exact.

Measured over every float32 against float64's functions (tests/toolchain/ir/test_activation_tables.py, `make
prove`):

          bytes   worst ulp         worst absolute   at the limits                falls by
    TANH  2288    2.33 (x = 1.874)  1.39e-7          1 from 8.875 on, exactly     3 ulp
    EXPM1 2160    2.23 (x = -3.63)  1.33e-7          -1 from -16.75 on, exactly   3 ulp
    ERF   1008    2.46 (x = 0.0017) 1.33e-7          1 from 3.875 on, exactly     3 ulp
    SOFTPLUS 2576 2.05 (x = 14.63)  5.03e-8          2.1e-9 from 20 on            (an even one)

No result lies beyond 1. As |x| grows, a result may lie below the largest so far by as much as the last column
says, and below the float before by 2 ulp. Up to |x| = 2^-12 (TANH) and 2^-24 (EXPM1), subnormals and -0
included, x comes back unchanged. TANH and ERF are odd to the bit. NaN and infinity give NaN.

The ulp is that of the exact result's binade. Where f ends a binade that G begins, half a unit each of c0, of
the sum and of the product can add up to 2.5. Smaller steps do not help: G(1.875) stays a row, and its c0 is
0.48 units off.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroflight.toolchain.ir.float32 import Float32, fma


@dataclass(frozen=True, eq=False)
class ActivationTable:
    """A function as a table of cubics: x G(|x|), or G(|x|) where it is `even`.

    `step` is a power of two. Row k of `rows`, float32 (n, 4), holds c0, c1, c2, c3 of
    G(k step + r) = c0 + c1 r + c2 r^2 + c3 r^3, |r| <= step / 2.
    """

    name: str
    low: float
    high: float
    step: float
    rows: Float32
    even: bool = False

    @property
    def magic(self) -> float:
        """Number added to |x| to round it to a multiple of `step`; exact in float32."""
        return 1.5 * 2.0**23 * self.step


def apply(table: ActivationTable, x: Float32) -> Float32:
    """Compute the tabulated function of each float32 value of `x`, rounded at each step as the compiled C is.

    NaN takes the row of `high`, as it does by the processor's own minimum; 0 x makes the result NaN, as of an
    infinity.
    """
    f = np.float32
    with np.errstate(invalid="ignore", under="ignore"):
        finite = np.isfinite(x)
        x = np.where(x <= f(table.high), x, f(table.high))
        x = np.where(x > f(table.low), x, f(table.low))
        a = np.abs(x)
        total = a + f(table.magic)
        r = a - (total - f(table.magic))
        row = total.view(np.int32) - f(table.magic).view(np.int32)
        c0, c1, c2, c3 = np.moveaxis(table.rows[row], -1, 0)
        quotient = fma(fma(fma(c3, r, c2), r, c1), r, c0)
        return np.where(finite, quotient if table.even else x * quotient, f(np.nan))


def _load(name: str) -> ActivationTable:
    table = json.loads(Path(__file__).with_name("activation_tables.json").read_text())[name]
    rows = np.array([[float.fromhex(c) for c in row] for row in table["rows"]], np.float32)
    rows.flags.writeable = False
    low, high, step = (float.fromhex(table[key]) for key in ("low", "high", "step"))
    return ActivationTable(name, low, high, step, rows, table.get("even", False))


TANH = _load("tanh")
EXPM1 = _load("expm1")
ERF = _load("erf")
SOFTPLUS = _load("softplus")  # its even part: log(1 + e^-|x|)
