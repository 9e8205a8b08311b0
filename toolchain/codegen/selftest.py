"""Self-test vectors: observations, extremes among them, with the exact actions that firmware must repeat."""

from __future__ import annotations

import hashlib

import numpy as np

from neuroflight.toolchain.contract import SELFTEST_COUNT
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.interpreter import replay
from neuroflight.toolchain.ir.network import Network

# Every value of one observation: zero, the smallest magnitudes of float32, rates beyond a gyro's range, and
# far beyond; random ones of growing scale follow. All actions are numbers: their bits may be compared.
EXTREMES = (0.0, 1e-45, 1.1754944e-38, 1e-6, 1e3, -1e3, 1e6, -1e6, 1e9, -1e9)
SCALES = (0.05, 0.2, 0.5, 1.0, 2.0, 5.0, 15.0, 40.0)


def selftest_vectors(network: Network) -> tuple[Float32, Float32]:
    """Return observations (SELFTEST_COUNT, inputs) and actions (SELFTEST_COUNT, outputs), the same in every
    run.

    The random bits come from SHAKE-128, because no library promises to keep its generator's numbers for ever.
    """
    count = SELFTEST_COUNT - len(EXTREMES)
    bits = hashlib.shake_128(b"neuroflight self-test").digest(4 * count * network.inputs)
    unit = np.frombuffer(bits, "<u4").reshape(count, network.inputs) / 2.0**31 - 1
    random = unit * np.resize(SCALES, count)[:, None]
    extremes = np.repeat(np.array(EXTREMES)[:, None], network.inputs, axis=1)
    observation = np.concatenate([extremes, random]).astype(np.float32)
    return observation, replay(network, observation)
