"""Running moments of observations are those of the samples."""

import numpy as np

from neuroflight.training.learners.network.normalization import ObservedMoments


def test_moments_are_those_of_all_observations_when_they_come_in_parts() -> None:
    rng = np.random.default_rng(2)
    rows = (rng.standard_normal((300, 3)) * [1.0, 5.0, 1e-3] + [100.0, -2.0, 0.0]).astype(np.float32)
    moments = ObservedMoments.none(3)
    assert moments.factor.tolist() == [1.0, 1.0, 1.0]
    for part in np.split(rows, [10, 11, 120]):
        moments = moments.with_more(part)
    np.testing.assert_allclose(moments.mean, rows.mean(axis=0, dtype=np.float64), rtol=1e-12, atol=1e-12)
    spread = rows.astype(np.float64).std(axis=0)
    np.testing.assert_allclose(moments.factor, [1.0 / spread[0], 1.0 / spread[1], 10.0], rtol=1e-9)
