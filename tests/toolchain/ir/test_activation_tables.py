"""The tabulated activations against float64's, against a second machine, and against the script behind them.

"ulp" is the last place of the exact result's binade, also where the result rounds up to the next one.
"""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.toolchain.ir import activation_tables_fit as lookup_fit
from neuroflight.toolchain.ir.activation_tables import ERF, EXPM1, SOFTPLUS, TANH, ActivationTable, apply
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.float64_functions import erf, softplus
from tests.sampling import PROVES, sampled

INFINITY_BITS = 0x7F800000
NAMES = (EXPM1, TANH, ERF)  # `function` of activation_tables_every.c
SOURCE = Path(__file__).with_name("activation_tables_every.c")


@dataclass(frozen=True)
class Case:
    """A table, the function it stands for, and the bounds that toolchain/ir/activation_tables.py states."""

    lookup: ActivationTable
    exact: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    fit: lookup_fit.Function
    ulp: float
    absolute: float
    fall_ulp: float  # below the largest result so far, as |x| grows


CASES = (
    Case(TANH, np.tanh, lookup_fit.TANH, 2.33, 1.39e-7, 3),
    Case(EXPM1, lambda x: np.expm1(np.minimum(x, 0)), lookup_fit.EXPM1, 2.23, 1.33e-7, 3),
    Case(ERF, erf, lookup_fit.ERF, 2.46, 1.33e-7, 3),
)
SOFT = Case(SOFTPLUS, lambda x: softplus(-np.abs(x)), lookup_fit.SOFTPLUS, 2.05, 5.03e-8, 3)
each = pytest.mark.parametrize("case", CASES, ids=lambda case: case.lookup.name)
every = pytest.mark.parametrize("case", (*CASES, SOFT), ids=lambda case: case.lookup.name)


def assert_bounds(case: Case, x: Float32) -> None:
    """Hold the results at `x` to the case's bounds."""
    result, exact = apply(case.lookup, x), case.exact(x.astype(np.float64))
    error = np.abs(result - exact)
    assert np.abs(result).max() <= 1
    assert error.max() <= case.absolute
    assert (error / ulp(exact)).max() <= case.ulp


def ulp(exact: NDArray[np.float64]) -> NDArray[np.float64]:
    """The last place of float32 in the binade of each value; subnormals share one."""
    place: NDArray[np.float64] = np.ldexp(1.0, np.maximum(np.frexp(exact)[1] - 24, -149))
    return place


def floats(first: float, last: float, stride: int = 1) -> Float32:
    """Every `stride`-th float32 from `first` to `last`, both positive."""
    ends = np.array([first, last], np.float32).view(np.uint32)
    return np.arange(ends[0], ends[1] + 1, stride, dtype=np.uint32).view(np.float32)


@each
def test_results_keep_their_bounds_when_x_is_any_float(case: Case) -> None:
    x = np.arange(0, INFINITY_BITS + 1, 9973, dtype=np.uint32).view(np.float32)
    assert_bounds(case, -x)
    assert_bounds(case, x)


@each
def test_results_keep_their_bounds_when_x_is_where_a_row_begins_ends_or_has_its_centre(case: Case) -> None:
    halves = np.arange(1, 2 * len(case.lookup.rows)) * case.lookup.step / 2
    near = halves.astype(np.float32).view(np.int32)[:, None] + np.arange(-400, 401, dtype=np.int32)
    x = near.view(np.float32).ravel()
    assert_bounds(case, -x)
    assert_bounds(case, x)


@each
@pytest.mark.parametrize("first", sampled([0.25, 1.75, 3.0, 7.25, 14.5], 0.25, 7.25))
def test_results_keep_their_bounds_when_x_is_every_float_of_a_stretch(case: Case, first: float) -> None:
    assert_bounds(case, -floats(first, first * 1.12))


@each
def test_results_are_one_from_the_limit_on_when_x_grows(case: Case) -> None:
    x = np.array([case.lookup.low, -20, -1e9, -3.4e38], np.float32)
    np.testing.assert_array_equal(apply(case.lookup, x), np.full(len(x), -1, np.float32))


@each
def test_results_are_those_of_the_upper_limit_when_x_is_above_it(case: Case) -> None:
    x = np.array([case.lookup.high, 20, 3.4e38], np.float32)
    np.testing.assert_array_equal(apply(case.lookup, x), np.full(len(x), float(case.lookup is not EXPM1)))


@every
def test_results_are_nan_when_x_is_no_number_or_infinite(case: Case) -> None:
    assert np.isnan(apply(case.lookup, np.array([np.nan, np.inf, -np.inf], np.float32))).all()


@pytest.mark.parametrize(("lookup", "largest"), [(TANH, 2**-12), (EXPM1, 2**-24)])
def test_results_are_x_when_x_is_tiny(lookup: ActivationTable, largest: float) -> None:
    special = np.array([0.0, 1e-45, 1e-40, 1.2e-38, largest], np.float32)
    x = -np.concatenate([special, floats(0, largest, 997), floats(largest / 2, largest, 11)])
    np.testing.assert_array_equal(apply(lookup, x).view(np.uint32), x.view(np.uint32))


@pytest.mark.parametrize("lookup", [TANH, ERF])
def test_function_is_odd_to_the_bit_when_x_changes_its_sign(lookup: ActivationTable) -> None:
    x = np.arange(0, INFINITY_BITS + 1, 9973, dtype=np.uint32).view(np.float32)
    np.testing.assert_array_equal(apply(lookup, -x).view(np.uint32), (-apply(lookup, x)).view(np.uint32))


def test_softplus_keeps_its_bounds_when_x_is_any_float() -> None:
    x = np.concatenate(
        [np.arange(0, INFINITY_BITS, 9973, dtype=np.uint32).view(np.float32), floats(2**-12, 24, 997)]
    )
    result = apply(SOFTPLUS, x)
    np.testing.assert_array_equal(apply(SOFTPLUS, -x).view(np.uint32), result.view(np.uint32))
    exact = SOFT.exact(x.astype(np.float64))
    error = np.abs(result - exact)
    assert error.max() <= SOFT.absolute
    inside = x <= SOFTPLUS.high
    assert (error[inside] / ulp(exact[inside])).max() <= SOFT.ulp
    assert np.unique(result[~inside]).size == 1
    assert 0 < result[-1] < 2.1e-9


@every
def test_results_keep_the_shape_when_x_is_a_matrix(case: Case) -> None:
    x = np.array([[-3.0, -0.5, -0.25], [-1.0, 0.0, -9.0]], np.float32)
    result = apply(case.lookup, x)
    assert result.dtype == np.float32
    np.testing.assert_array_equal(result.ravel(), apply(case.lookup, x.ravel()))


@each
def test_rows_end_at_the_limit_and_cannot_be_written_when_loaded(case: Case) -> None:
    lookup = case.lookup
    assert lookup.rows.dtype == np.float32
    assert lookup.rows.shape == (-lookup.low / lookup.step + 1, 4)
    assert lookup.rows[0, 0] == (1 if lookup is not ERF else np.float32(2 / np.sqrt(np.pi)))
    assert not lookup.rows.flags.writeable


def test_tanh_has_no_even_part_near_zero_when_loaded() -> None:
    assert TANH.rows[0, 1] == 0


@every
@pytest.mark.parametrize("row", [0, 1, 30, 60, -1])
def test_fit_gives_the_committed_row_when_run_again(case: Case, row: int) -> None:
    again = lookup_fit.fit_row(case.fit, range(case.fit.rows)[row])
    np.testing.assert_array_equal(again.view(np.uint32), case.lookup.rows[row].view(np.uint32))


@pytest.mark.slow
def test_script_writes_the_committed_file_when_run_again() -> None:
    assert lookup_fit.tables_json() == lookup_fit.PATH.read_text()


class Worst(ctypes.Structure):
    """`struct worst` of activation_tables_every.c."""

    _fields_ = (
        ("ulp", ctypes.c_double),
        ("absolute", ctypes.c_double),
        ("largest", ctypes.c_double),
        ("fall_ulp", ctypes.c_double),
        ("step_back_ulp", ctypes.c_double),
        ("at", ctypes.c_float),
    )


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """activation_tables_every.c: the same arithmetic as this machine's compiler makes it."""
    library = tmp_path_factory.mktemp("lookup") / "every.so"
    flags = (
        "-std=c11",
        "-O2",
        "-mfma",
        "-ffp-contract=off",
        "-fno-math-errno",
        "-Wall",
        "-Wextra",
        "-Werror",
    )
    subprocess.run(["gcc", *flags, "-shared", "-fPIC", SOURCE, "-lm", "-o", library], check=True)
    return ctypes.CDLL(str(library))


def described(
    lookup: ActivationTable,
) -> tuple[ctypes.c_void_p, ctypes.c_float, ctypes.c_float, ctypes.c_float, ctypes.c_int]:
    """`lookup` as the first arguments of the functions of activation_tables_every.c."""
    values = (lookup.low, lookup.high, lookup.step)
    low, high, step = map(ctypes.c_float, values)
    return ctypes.c_void_p(lookup.rows.ctypes.data), low, high, step, ctypes.c_int(lookup.even)


@every
def test_results_have_the_bits_of_compiled_c_when_x_is_any_float(case: Case, machine: ctypes.CDLL) -> None:
    stride, closer = (1009, 97) if PROVES else (30011, 3001)
    bits = np.arange(0, 2**32, stride, dtype=np.uint64).astype(np.uint32)
    x = np.concatenate([bits.view(np.float32), -floats(2**-12, 20, closer), floats(2**-12, 20, closer)])
    result = np.empty_like(x)
    machine.lookup_all(
        *described(case.lookup), *(ctypes.c_void_p(a.ctypes.data) for a in (x, result)), len(x)
    )
    expected = apply(case.lookup, x)
    numbers = ~np.isnan(expected)
    np.testing.assert_array_equal(np.isnan(result), ~numbers)
    np.testing.assert_array_equal(expected[numbers].view(np.uint32), result[numbers].view(np.uint32))


@pytest.mark.slow
@each
@pytest.mark.parametrize("negative", [False, True])
def test_results_keep_their_bounds_when_x_is_every_float(
    case: Case, negative: bool, machine: ctypes.CDLL
) -> None:
    worst = Worst()
    machine.lookup_every(*described(case.lookup), NAMES.index(case.lookup), negative, ctypes.byref(worst))
    print(case.lookup.name, {name: getattr(worst, name) for name, _ in Worst._fields_})
    assert worst.largest == (1 if case.lookup is not EXPM1 or negative else 0)
    assert worst.absolute <= case.absolute
    assert worst.ulp <= case.ulp
    assert worst.fall_ulp <= case.fall_ulp
