"""The gyro: noise, bias and the 16-bit numbers that a chip makes of a rate. Pure and vectorised."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.aircraft import Gyro
from toolchain.contract import GYRO_COUNTS, GYRO_FULL_SCALE_DEG_S

Array = NDArray[np.float64]


def draw_bias(noise: Gyro, count: int, rng: np.random.Generator) -> Array:
    """Constant offset of each aircraft's gyro for one episode [rad/s], (count, 3)."""
    return rng.normal(0.0, noise.bias, (count, 3))


def measured_rate(rate: Array, bias: Array, noise: Gyro, rng: np.random.Generator) -> Array:
    """What an ideal converter would read [rad/s], (N, 3): the true rate with bias and white noise."""
    return np.asarray(rate + bias + rng.standard_normal(rate.shape) * np.array(noise.noise))


def counts(rate: Array) -> NDArray[np.int16]:
    """Rate [rad/s] as the chip's 16-bit counts at +-2000 deg/s: round half to even, then saturate."""
    scaled = np.rint(np.rad2deg(rate) * (GYRO_COUNTS / GYRO_FULL_SCALE_DEG_S))
    return np.clip(scaled, -GYRO_COUNTS, GYRO_COUNTS - 1).astype(np.int16)


def quantised_rate(rate: Array) -> NDArray[np.float32]:
    """Rate [rad/s] after the chip and the firmware's conversion back, float32."""
    scale = np.float32(np.deg2rad(GYRO_FULL_SCALE_DEG_S / GYRO_COUNTS))
    return counts(rate).astype(np.float32) * scale
