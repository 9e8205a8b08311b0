"""The emulated fused multiply-add against the processor's."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.toolchain.ir.float32 import fma

SOURCE = """
void fma_all(unsigned n, const float *a, const float *b, const float *c, float *out)
{
    for (unsigned i = 0; i < n; ++i) out[i] = __builtin_fmaf(a[i], b[i], c[i]);
}
"""
Float32 = NDArray[np.float32]


@pytest.fixture(scope="module")
def processor(tmp_path_factory: pytest.TempPathFactory) -> Any:
    directory: Path = tmp_path_factory.mktemp("fma")
    (directory / "fma.c").write_text(SOURCE)
    library = directory / "fma.so"
    subprocess.run(
        ["gcc", "-O2", "-mfma", "-shared", "-fPIC", directory / "fma.c", "-o", library], check=True
    )
    return ctypes.CDLL(str(library))


def processor_fma(processor: Any, a: Float32, b: Float32, c: Float32) -> Float32:
    out = np.empty_like(a)
    processor.fma_all(len(a), *(ctypes.c_void_p(v.ctypes.data) for v in (a, b, c, out)))
    return out


def assert_same_bits(got: Float32, expected: Float32) -> None:
    nan = np.isnan(expected)
    np.testing.assert_array_equal(np.isnan(got), nan)
    np.testing.assert_array_equal(got[~nan].view(np.uint32), expected[~nan].view(np.uint32))


def test_fma_gives_the_processors_bits_when_operands_are_any_bits(processor: Any) -> None:
    rng = np.random.default_rng(1)
    a, b, c = rng.integers(0, 1 << 32, (3, 500_000), dtype=np.uint32).view(np.float32)
    assert_same_bits(fma(a, b, c), processor_fma(processor, a, b, c))


def test_fma_gives_the_processors_bits_when_terms_nearly_cancel(processor: Any) -> None:
    rng = np.random.default_rng(2)
    a, b = (
        (rng.normal(size=500_000) * 2.0 ** rng.integers(-70, 20, 500_000)).astype(np.float32).reshape(2, -1)
    )
    c = np.nextafter(-a * b, np.float32(rng.choice([-9e9, 9e9])))
    assert_same_bits(fma(a, b, c), processor_fma(processor, a, b, c))


def test_fma_rounds_once_when_rounding_twice_would_differ() -> None:
    # a b + c = c + 2^-24 - 2^-70: a hair below the middle between c and its even neighbour. float64 cannot
    # hold the hair; what it holds is the middle, which would go to the neighbour.
    a, b = np.float32(2.0**-12 * (1 + 2.0**-23)), np.float32(2.0**-12 * (1 - 2.0**-23))
    c = np.float32(1 + 2.0**-23)
    assert np.float32(float(a) * float(b) + float(c)) == 1 + 2.0**-22
    assert fma(a, b, c) == c
