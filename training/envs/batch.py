"""N aircraft as a learner sees them; all environments are views of this batch.

Observations are scaled to about unit size (`OBSERVATION_SCALES`), actions are a network's outputs, which
`OutputMap` makes motor fractions of, and rewards are scaled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array32
from neuroflight.sim.control.observation import limits
from neuroflight.training.envs.setup import Setup
from neuroflight.training.envs.simulation import AttitudeSimulation, StepResult

FRAME_PIXELS = 400  # of a picture's side
METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}  # 1 s of flight lasts 20 s


class AttitudeBatch:
    """An `AttitudeSimulation` between the scales of a `Setup`."""

    def __init__(
        self, setup: Setup, count: int, rng: np.random.Generator, *, steps_max: int | None = None
    ) -> None:
        """Create the aircraft. All random numbers come from `rng`; steps_max: the longest episode."""
        self.setup, self.count, self._steps_max = setup, count, steps_max
        config, motors = setup.config, setup.aircraft.motor_count
        self.scale = np.array(config.observation_scale(motors), np.float32)  # of each observation, (n,)
        self._reward_scale = np.float32(setup.reward_scale)
        low, high = limits(config.blocks(), motors)
        self.observation_space = spaces.Box(low * self.scale, high * self.scale, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (motors,), np.float32)
        self._simulation: AttitudeSimulation | None = self._build(rng)

    @property
    def simulation(self) -> AttitudeSimulation:
        """The aircraft. Raises RuntimeError when they are closed."""
        if self._simulation is None:
            raise RuntimeError("the environment is closed; reset it with a seed, or make a new one")
        return self._simulation

    @property
    def closed(self) -> bool:
        """True after the physics client was closed."""
        return self._simulation is None

    def close(self) -> None:
        """Close the physics simulation."""
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None

    def reseed(self, rng: np.random.Generator) -> None:
        """Replace the aircraft by new ones with the random stream `rng`; call `reset` next."""
        self.close()
        self._simulation = self._build(rng)

    def reset(self, *, stagger: bool = False) -> Array32:
        """Begin an episode on every aircraft, see `AttitudeSimulation.reset`; returns observations (N, n)."""
        return self.simulation.reset(stagger=stagger) * self.scale

    def restart(self, index: NDArray[np.intp]) -> Array32:
        """Begin a new episode on the aircraft of `index`; returns their observations (len, n)."""
        return self.simulation.restart(index) * self.scale

    def step(self, actions: Array32, limit: float | None = 1.0) -> StepResult:
        """Advance one control period with actions (N, M), limited to +-limit; None: to nothing.

        Raises ValueError on actions that are not finite or of another shape.
        """
        simulation = self.simulation
        if actions.shape != (self.count, simulation.motor_count):
            expected = self.count, simulation.motor_count
            raise ValueError(f"actions of shape {actions.shape}, expected {expected}: aircraft, motors")
        if not np.isfinite(actions).all():
            raise ValueError("an action is not finite, expected numbers from -1 to 1")
        actions = np.asarray(actions, np.float32)
        if limit is not None:
            actions = np.clip(actions, np.float32(-limit), np.float32(limit))
        result = simulation.step(self.setup.config.output.unclipped(actions))
        return StepResult(result.observation * self.scale, result.reward * self._reward_scale, result.ended)

    def info(self) -> dict[str, NDArray[np.float64]]:
        """Return commanded and true rates of the present sample [rad/s], (N, 3) each."""
        return {"setpoint": self.simulation.setpoint, "rate": self.simulation.rate}

    def frames(self, index: Sequence[int]) -> list[NDArray[np.uint8]]:
        """Draw pictures (H, W, 3), red, green, blue, of the aircraft of `index`."""
        from neuroflight.sim.viewing.pictures import pose_picture

        simulation = self.simulation
        rotation, motors = simulation.rotation, simulation.motors
        return [
            pose_picture(self.setup.aircraft, rotation[i], motors[i].tolist(), FRAME_PIXELS) for i in index
        ]

    def _build(self, rng: np.random.Generator) -> AttitudeSimulation:
        setup = self.setup
        return AttitudeSimulation(
            setup.aircraft, self.count, config=setup.config, rng=rng, steps_max=self._steps_max
        )


def check_render_mode(mode: str | None) -> str | None:
    """Return the mode. Raises ValueError on an unknown one."""
    if mode is not None and mode not in METADATA["render_modes"]:
        raise ValueError(f"render_mode {mode!r}, expected one of: {', '.join(METADATA['render_modes'])}")
    return mode
