"""The observations that a policy is verified on: sequences, each of which begins with policy_init.

Where carried state is not the question, a sequence is one observation long.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.ir.float32 import Float32

GYRO_RANGE = 35.0  # rad/s: 2000 deg/s
SCALES = {"unit": 1.0, "gyro range": GYRO_RANGE, "1e3": 1e3, "1e6": 1e6}  # of normally distributed values
STEPS = 200  # of a path
SMOOTHNESS = 0.95  # share of a path's value that the next step keeps
FAULT_SHARE = 0.05  # of the steps in the first half of a path with faults
FLOAT32 = np.finfo(np.float32)
ODD = (  # every finite kind of number that random ones hardly meet
    *(0.0, -0.0, 1.0, -1.0, GYRO_RANGE, -GYRO_RANGE, 1e-6, 1e-20, 1e3, -1e6, 1e20, -1e30),
    *(float(FLOAT32.tiny), -float(FLOAT32.tiny), float(FLOAT32.smallest_subnormal)),
    *(-float(FLOAT32.smallest_subnormal), 1e-40, float(FLOAT32.max), -float(FLOAT32.max)),
)
NOT_FINITE = (  # infinities, then NaN: quiet, with a payload, all ones, negative, signalling
    *(0x7F800000, 0xFF800000, 0x7FC00000, 0x7FC12345, 0x7FFFFFFF, 0xFFC00000),
    *(0x7F800001, 0x7FA00000, 0xFF800001, 0xFFBFFFFF),
)


@dataclass(frozen=True, eq=False)
class Inputs:
    """A group of sequences of one kind."""

    name: str
    observation: Float32  # (sequences, steps, values)

    @property
    def count(self) -> int:
        """Number of observations."""
        return int(np.prod(self.observation.shape[:2]))


def make_inputs(width: int, count: int, seed: int, steps: int = STEPS) -> tuple[Inputs, ...]:
    """Make all groups for a policy that observes `width` values, about `count` observations each.

    steps: of a path. A group's numbers depend on the seed and on its place, not on those before it.
    """
    generators = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(7)]
    groups = [
        _singles(name, rng.normal(size=(count, width)) * scale)
        for (name, scale), rng in zip(SCALES.items(), generators[:4], strict=True)
    ]
    groups.append(_singles("grid", _grid(generators[4], width, count)))
    groups.append(_singles("adversarial", _adversarial(generators[5], width, count)))
    paths = smooth_paths(generators[6], width, max(2, count // steps), steps)
    groups.append(Inputs("paths", paths))
    groups.append(Inputs("paths with faults", _with_faults(generators[6], paths)))
    return tuple(groups)


def smooth_paths(rng: np.random.Generator, width: int, sequences: int, steps: int) -> Float32:
    """Draw smooth paths (sequences, steps, width) from rest, alternating unit and half the gyro's scale."""
    paths = np.zeros((sequences, steps, width))
    innovation = np.sqrt(1 - SMOOTHNESS**2)
    for step in range(1, steps):
        paths[:, step] = SMOOTHNESS * paths[:, step - 1] + innovation * rng.normal(size=(sequences, width))
    paths[1::2] *= GYRO_RANGE / 2
    return paths.astype(np.float32)


def _singles(name: str, rows: NDArray[np.floating]) -> Inputs:
    return Inputs(name, rows.astype(np.float32)[:, None])


def _grid(rng: np.random.Generator, width: int, count: int) -> Float32:
    """Move each axis alone across the gyro's range, then every pair of axes: as finely as `count` allows."""
    fine = np.linspace(-GYRO_RANGE, GYRO_RANGE, max(3, count // (2 * width) | 1), dtype=np.float32)
    rows = np.zeros((width, fine.size, width), np.float32)
    for axis in range(width):
        rows[axis, :, axis] = fine
    pairs = np.array(list(combinations(range(width), 2)), int).reshape(-1, 2)
    side = int(np.sqrt(max(9, count / 2 / max(1, len(pairs)))))
    pairs = rng.permutation(pairs)[: max(1, count // (2 * side * side))]
    coarse = np.linspace(-GYRO_RANGE, GYRO_RANGE, side, dtype=np.float32)
    plane = np.stack(np.meshgrid(coarse, coarse), axis=-1).reshape(-1, 2)
    crossed = np.zeros((len(pairs), len(plane), width), np.float32)
    for index, pair in enumerate(pairs):
        crossed[index][:, pair] = plane
    return np.concatenate([rows.reshape(-1, width), crossed.reshape(-1, width)])


def _adversarial(rng: np.random.Generator, width: int, count: int) -> Float32:
    """Put each odd number everywhere and in each place alone, then mixtures of them and random bits."""
    odd = _odd()
    everywhere = np.repeat(odd[:, None], width, axis=1)
    alone = rng.normal(size=(odd.size * width, width)).astype(np.float32)
    alone[np.arange(len(alone)), np.tile(np.arange(width), odd.size)] = np.repeat(odd, width)
    rest = max(100, count - len(everywhere) - len(alone))
    bits = rng.integers(0, 1 << 32, (rest, width), dtype=np.uint32).view(np.float32)
    mixed = np.where(rng.random((rest, width)) < 0.3, rng.choice(odd, (rest, width)), bits)
    finite = rng.random((rest, 1)) < 0.5
    mixed = np.where(finite & ~np.isfinite(mixed), FLOAT32.max, mixed)
    return np.concatenate([everywhere, alone, mixed])


def _with_faults(rng: np.random.Generator, paths: Float32) -> Float32:
    """Replace some values in the first half of the paths by odd ones, infinities and NaN."""
    odd = _odd()
    sequences, steps, width = paths.shape
    faulty = rng.random((sequences, steps)) < FAULT_SHARE
    faulty[:, steps // 2 :] = False
    struck = faulty[..., None] & (rng.random(paths.shape) < 1.5 / width)
    return np.where(struck, rng.choice(odd, paths.shape), paths)


def _odd() -> Float32:
    return np.concatenate([np.array(ODD, np.float32), np.array(NOT_FINITE, np.uint32).view(np.float32)])
