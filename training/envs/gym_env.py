"""One aircraft as a Gymnasium environment: `gymnasium.make("neuroflight/Attitude-v0")`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from neuroflight.training.envs.batch import METADATA, AttitudeBatch, check_render_mode
from neuroflight.training.envs.setup import make_setup


class AttitudeEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]], EzPickle):
    """Track rate commands with one aircraft.

    Observation: the terms of `observation`, scaled, float32 (n,). Action: a network's outputs, -1..1,
    float32 (M,), limited to that; `output` makes motor fractions of them. Ends only by its clock, as a
    truncation. `info` holds `setpoint` and `rate`, (3,) [rad/s]. A copy or pickle of it is a new
    environment of the same arguments.
    """

    metadata = METADATA

    def __init__(self, *, render_mode: str | None = None, **arguments: Any) -> None:  # noqa: ANN401
        """arguments: see `training.envs.setup.make_setup`; render_mode: None or "rgb_array"."""
        EzPickle.__init__(self, render_mode=render_mode, **arguments)
        self.render_mode = check_render_mode(render_mode)
        self.batch = AttitudeBatch(make_setup(1, **arguments), 1, np.random.default_rng())
        self.observation_space = self.batch.observation_space
        self.action_space = self.batch.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode; a seed repeats commands and noise exactly. `options` has no use."""
        super().reset(seed=seed)
        if seed is not None or self.batch.closed:
            self.batch.reseed(self.np_random)
        observation = self.batch.reset()
        return observation[0], self._info()

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Advance one control period. Raises ValueError on an action of another shape or not finite."""
        action = np.asarray(action)
        if action.shape != self.action_space.shape:
            raise ValueError(f"an action of shape {action.shape}, expected {self.action_space.shape}")
        result = self.batch.step(action[None])
        return result.observation[0], float(result.reward[0]), False, bool(result.ended[0]), self._info()

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """Return a picture of the aircraft in its attitude, (H, W, 3); None without a render mode."""
        return None if self.render_mode is None else self.batch.frames([0])[0]

    def close(self) -> None:
        """Close the physics simulation."""
        self.batch.close()

    def _info(self) -> dict[str, Any]:
        return {name: value[0] for name, value in self.batch.info().items()}
