"""A controller whose outputs are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Constant:
    """The same output for every motor."""

    def __init__(self, count: int, level: float) -> None:
        self.action = np.full((count, 4), level, np.float32)

    def reset(self) -> None:
        """It has no state."""

    def step(
        self, setpoint: NDArray[np.float32], gyro: NDArray[np.float32], throttle: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        return self.action
