"""How much of what can be tried is tried: the ordinary run takes a sample, `make prove` takes all."""

from __future__ import annotations

import os
from collections.abc import Iterable

import pytest

PROVES = "NEUROFLIGHT_PROVES" in os.environ  # set by `make prove`, and where tests try mutants
SHARE = 8  # of random examples, one is ordinary


def sampled(cases: Iterable[object], *ordinary: object) -> list[object]:
    """Return all cases as values of one parameter; those that are not ordinary are slow."""
    return sampled_rows(((case,) for case in cases), *((case,) for case in ordinary))


def sampled_rows(cases: Iterable[tuple[object, ...]], *ordinary: tuple[object, ...]) -> list[object]:
    """Return all cases as values of several parameters; those that are not ordinary are slow."""
    found = list(cases)
    assert all(case in found for case in ordinary)
    return [
        pytest.param(*case, marks=() if PROVES or case in ordinary else pytest.mark.slow) for case in found
    ]


def examples(count: int) -> int:
    """Return how many random examples to try, of `count` in all."""
    return count if PROVES else count // SHARE
