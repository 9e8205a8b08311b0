"""Quaternions against the matrices that they stand for."""

import numpy as np
import pytest

from neuroflight.sim.physics.rotation import quaternion


@pytest.mark.parametrize("seed", range(40))
def test_the_quaternion_turns_like_the_matrix_when_drawn_at_random(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.normal(size=4) * rng.choice([1, 1e-3], 4)  # near the half turns, too
    w, x, y, z = q / np.linalg.norm(q)
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    found = np.array(quaternion(matrix))
    assert np.abs(found * np.sign(found @ (w, x, y, z)) - (w, x, y, z)).max() < 1e-9
