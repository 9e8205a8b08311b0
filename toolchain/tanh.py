"""The project's tanh: one division, no branch, no libm, the same bits on every IEEE 754 machine.

tanh x = 2 t / (1 + t^2) with t = tanh(x/2) = n / 2d, so tanh x = n d / (d^2 + n^2 / 4), where
n = x + x s (N1 + N2 s), d = 1 + D1 s + D2 s^2 + D3 s^3 and s = x^2, for |x| <= LIMIT; beyond it the value
at LIMIT, which is 1 to float32. Doubling the argument pays twice: t needs few coefficients, and near
|t| = 1 the formula is flat, so that the rounding errors of n and d vanish just where tanh x is largest.

The coefficients are a minimax fit in relative error (4e-9 and below 1e-8 before rounding), then a search
over their last bits for the smallest largest error of the float32 evaluation: 1.81e-7 absolute over every
float32, and never beyond 1 (tests/toolchain/test_tanh.py). Tiny x, subnormals included, come back
unchanged; NaN stays NaN.
"""

from __future__ import annotations

import numpy as np

from toolchain.float32 import Float32, fma

LIMIT = 9.0
N1, N2 = (float.fromhex(c) for c in ("0x1.e7e2p-6", "0x1.df99c2p-14"))
D1, D2, D3 = (float.fromhex(c) for c in ("0x1.cf4dcap-4", "0x1.3c67cep-10", "0x1.4a6e82p-20"))


def tanh(x: Float32) -> Float32:
    """tanh of each float32 value of `x`, rounded at each step as the C of `policy_tanh` is."""
    f = np.float32
    with np.errstate(invalid="ignore", under="ignore"):
        x = np.where(x > f(LIMIT), f(LIMIT), x)
        x = np.where(x < f(-LIMIT), f(-LIMIT), x)
        s = x * x
        n = fma(x * s, fma(f(N2), s, f(N1)), x)
        d = fma(fma(fma(f(D3), s, f(D2)), s, f(D1)), s, f(1))
        return n * d / fma(n, n * f(0.25), d * d)
