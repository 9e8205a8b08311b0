"""Fits activations by tables and writes them to activation_tables.json.

    python -m neuroflight.toolchain.ir.activation_tables_fit

The tables are part of every policy's bytes, so nothing here may differ from machine to machine. Reference
values and fits are in `decimal` (its exp is correctly rounded), the search uses float32 and float64
arithmetic element by element; no libm, no linear algebra library.

Each row begins as the cubic with the smallest largest relative error over its interval. What costs most is
then the rounding of c0: G(1.875) lies 0.48 units of the last place from the nearest float32, and nothing but
c0 acts at a row's centre. So c0's neighbours are tried, each with its excess taken back towards the ends of
the interval by c2, and with c1's last bits varied. Kept is the row with the smallest bound on the error of
the float32 evaluation: the cubic's own error, and half a unit of the last place for each of the two roundings
that count. (The last bits of c2 and c3 move the result by less than a hundredth of its own.)
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from itertools import groupby
from pathlib import Path

import numpy as np

from neuroflight.toolchain.files import write_text
from neuroflight.toolchain.ir.float32 import Float32

PATH = Path(__file__).with_name("activation_tables.json")
PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")
DIGITS = 50  # of the decimal arithmetic; differences of near values lose at most a few of them
GRID = 96  # points of an interval that the fit looks at
SAMPLES = 513  # inputs of an interval that the bound is taken over
ROUNDS = 30  # of the exchange; it settles after three or four


@dataclass(frozen=True)
class Function:
    """A function f to be tabulated: f(x) = x G(|x|) for `low` <= x <= `high`, constant beyond.

    An `even` one is G(|x|) itself, with all powers free. `step` is a power of two and `low` a multiple of it.
    `row_zero`: the powers of r that row 0 has beside c0 = G(0), so that tiny x come back unchanged where that
    is 1.
    """

    name: str
    low: float
    high: float
    step: float
    quotient: Callable[[Decimal], Decimal]
    row_zero: tuple[int, ...]
    even: bool = False

    @property
    def rows(self) -> int:
        return round(-self.low / self.step) + 1

    def interval(self, row: int) -> tuple[float, float]:
        """Return the range of |x| - row * step that row `row` serves; row 0 starts at a 128th of a step."""
        first = -self.step / 2 if row else 0.0 if self.even else self.step / 128
        return first, 0.0 if row == self.rows - 1 else self.step / 2


def _tanh_quotient(a: Decimal) -> Decimal:
    if not a:
        return Decimal(1)
    decay = (-2 * a).exp()
    return (1 - decay) / (1 + decay) / a


def _expm1_quotient(a: Decimal) -> Decimal:
    if not a:
        return Decimal(1)
    return (1 - (-a).exp()) / a


# Limits: the first multiple of the step whose float32 result is exactly 1 (or -1) and within 1 ulp of the
# function. Steps: the cubics are off by 0.26 ulp of G at most; at twice the step by almost 4.
def _erf_quotient(a: Decimal) -> Decimal:
    """Compute erf(a) / a by its series: terms grow to 1e6 at a = 4, so 40 of 50 digits remain."""
    term, total, n = Decimal(1), Decimal(1), 0
    while abs(term) > Decimal(10) ** -(DIGITS - 5):
        n += 1
        term *= -a * a / n
        total += term / (2 * n + 1)
    return 2 * total / PI.sqrt()


def _softplus_even(a: Decimal) -> Decimal:
    return (1 + (-a).exp()).ln()


TANH = Function("tanh", -8.875, 8.875, 1 / 16, _tanh_quotient, (2, 3))
EXPM1 = Function("expm1", -16.75, 0.0, 1 / 8, _expm1_quotient, (1, 2, 3))
ERF = Function("erf", -3.875, 3.875, 1 / 16, _erf_quotient, (2, 3))
# Nothing is above its constant beyond 20, 2e-9, which a factor x of Mish makes 2e-9 |x|.
SOFTPLUS = Function("softplus", -20.0, 20.0, 1 / 8, _softplus_even, (1, 2, 3), even=True)
FUNCTIONS = (TANH, EXPM1, ERF, SOFTPLUS)


def fit_row(function: Function, row: int) -> Float32:
    """Fit the coefficients c0, c1, c2, c3 of row `row`, shape (4,)."""
    with localcontext() as context:
        context.prec = DIGITS
        first, last = (Decimal(end) for end in function.interval(row))
        grid = [first + (last - first) * i / GRID for i in range(GRID + 1)]
        target = [function.quotient(Decimal(row * function.step) + r) for r in grid]
        if row == 0 and not function.even:
            at_zero = Decimal(float(np.float32(float(function.quotient(Decimal(0))))))
            c0, c1, c2, c3 = _minimax(grid, target, at_zero, function.row_zero)
        else:
            c0, c1, c2, c3 = _minimax(grid, target, Decimal(0), (0, 1, 2, 3))
        bound = _bound(function, row)
    rows = []
    for near_c0 in _neighbours(c0, 1) if row or function.even else [float(c0)]:
        bend = 1.5 * (near_c0 - float(c0)) / (function.step / 2) ** 2
        for near_c1 in _neighbours(c1, 2) if c1 else [0.0]:
            rows.append(np.array([near_c0, near_c1, float(c2) - bend, float(c3)], np.float32))
    return min(rows, key=bound)


def _neighbours(value: Decimal, count: int) -> list[float]:
    """Return the float32 nearest to `value` and `count` more on either side."""
    bits = np.float32(float(value)).view(np.int32) + np.arange(-count, count + 1, dtype=np.int32)
    return [float(c) for c in bits.view(np.float32)]


def _bound(function: Function, row: int) -> Callable[[Float32], float]:
    """Return a function that bounds the error of f [ulp] for given coefficients of row `row`."""
    centre = row * function.step
    r = np.linspace(*function.interval(row), SAMPLES)
    a = [Decimal(centre + float(v)) for v in r]
    quotient = np.array([float(function.quotient(v)) for v in a])
    result = quotient if function.even else np.array([float(v * function.quotient(v)) for v in a])
    quotient_ulp, result_ulp = (np.ldexp(1.0, np.frexp(v)[1] - 24) for v in (quotient, result))

    def bound(row: Float32) -> float:
        c0, c1, c2, c3 = row.astype(np.float64)
        error = np.abs(((c3 * r + c2) * r + c1) * r + c0 - quotient) + quotient_ulp / 2
        if function.even:
            return float((error / result_ulp).max())
        return float(((centre + r) * error / result_ulp).max() + 0.5)

    return bound


def _minimax(
    grid: Sequence[Decimal], target: Sequence[Decimal], constant: Decimal, powers: Sequence[int]
) -> list[Decimal]:
    """Fit c0 to c3 of the polynomial closest to `target` on `grid` in relative error.

    Only the coefficients of `powers` are free; where 0 is not among them, c0 is `constant`. Others are 0.
    """
    count = len(powers)
    terms = [[r**power if power else Decimal(1) for power in powers] for r in grid]
    chosen = [i * (len(grid) - 1) // count for i in range(count + 1)]
    for _ in range(ROUNDS):
        matrix = [
            [*(term / target[i] for term in terms[i]), Decimal((-1) ** j)] for j, i in enumerate(chosen)
        ]
        solution = _solve(matrix, [1 - constant / target[i] for i in chosen])[:-1]
        error = [
            (constant + sum(c * term for c, term in zip(solution, row, strict=True))) / g - 1
            for row, g in zip(terms, target, strict=True)
        ]
        lobes = [list(lobe) for _, lobe in groupby(range(len(grid)), key=lambda i: error[i] > 0)]
        peaks = [max(lobe, key=lambda i: abs(error[i])) for lobe in lobes]
        while len(peaks) > count + 1:
            peaks.pop(0 if abs(error[peaks[0]]) < abs(error[peaks[-1]]) else -1)
        if peaks == chosen:
            free = dict(zip(powers, solution, strict=True))
            return [free.get(power, constant if power == 0 else Decimal(0)) for power in range(4)]
        chosen = peaks
    raise ArithmeticError(f"the exchange did not settle in {ROUNDS} rounds")


def _solve(matrix: list[list[Decimal]], right: list[Decimal]) -> list[Decimal]:
    """Solve matrix x = right by elimination with the largest pivot."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for i in range(len(rows)):
        best = max(range(i, len(rows)), key=lambda j: abs(rows[j][i]))
        rows[i], rows[best] = rows[best], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for j, row in enumerate(rows):
            if j != i:
                rows[j] = [b - row[i] * a for a, b in zip(rows[i], row, strict=True)]
    return [row[-1] for row in rows]


def tables_json(functions: Sequence[Function] = FUNCTIONS) -> str:
    """Format the tables as the JSON text of activation_tables.json: floats in hexadecimal, one row a line."""
    blocks = []
    for function in functions:
        rows = (fit_row(function, row) for row in range(function.rows))
        lines = ",\n".join("   " + json.dumps([float(c).hex() for c in row]) for row in rows)
        limits = {"low": function.low, "high": function.high, "step": function.step}
        head = "".join(f'  "{key}": "{value.hex()}",\n' for key, value in limits.items())
        head += '  "even": true,\n' if function.even else ""
        blocks.append(f' "{function.name}": {{\n{head}  "rows": [\n{lines}\n  ]\n }}')
    return "{\n" + ",\n".join(blocks) + "\n}\n"


if __name__ == "__main__":
    write_text(PATH, tables_json())
