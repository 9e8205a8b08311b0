"""Many aircraft in one Gymnasium vector environment: `gymnasium.make_vec("neuroflight/Attitude-v0", 64)`."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.utils import EzPickle
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array32
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.envs.batch import METADATA, AttitudeBatch, check_render_mode
from neuroflight.training.envs.setup import make_setup

Flags = NDArray[np.bool_]
RESET_MASK = "reset_mask"  # Gymnasium's option: which aircraft begin an episode


class AttitudeVectorEnv(VectorEnv[Array32, Array32, NDArray[Any]], EzPickle):
    """N aircraft in one twin, each as `AttitudeEnv` has it.

    One random stream serves all: a seed repeats the flights of all aircraft together. A list of seeds, one
    an aircraft, makes that stream as well.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        **arguments: Any,  # noqa: ANN401
    ) -> None:
        """arguments: see `training.envs.setup.make_setup`.

        autoreset_mode: Gymnasium's, or its text: how the episode after an ended one begins.
        max_episode_steps: episodes end after so many at the latest.
        """
        EzPickle.__init__(
            self,
            num_envs,
            render_mode=render_mode,
            autoreset_mode=autoreset_mode,
            max_episode_steps=max_episode_steps,
            **arguments,
        )
        self.render_mode = check_render_mode(render_mode)
        self.autoreset_mode = _mode(autoreset_mode)
        self.metadata = METADATA | {"autoreset_mode": self.autoreset_mode}
        setup = make_setup(num_envs, **arguments)
        rng = np.random.default_rng()
        self.batch = AttitudeBatch(setup, num_envs, rng, steps_max=_steps_max(max_episode_steps))
        self.num_envs = num_envs
        self.single_observation_space = self.batch.observation_space
        self.single_action_space = self.batch.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, bool)  # in the last step, and not begun anew since
        self._observation = np.zeros(self.observation_space.shape or (), np.float32)  # the last one

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,  # type: ignore[override]
        options: dict[str, Any] | None = None,
    ) -> tuple[Array32, dict[str, Any]]:
        """Begin an episode on every aircraft, or on those of `options["reset_mask"]`, (N,) of bool."""
        mask = (options or {}).get(RESET_MASK)
        if mask is not None:
            return self._reset_some(np.asarray(mask), seed)
        if seed is not None or self.batch.closed:
            self._reseed(seed)
        self._ended[:] = False
        self._observation = self.batch.reset()
        return self._observation.copy(), self._infos()

    def step(self, actions: Array32) -> tuple[Array32, NDArray[np.float64], Flags, Flags, dict[str, Any]]:  # type: ignore[override]
        """Advance all aircraft by one control period."""
        over, mode = self._ended, self.autoreset_mode
        if mode is AutoresetMode.DISABLED and over.any():
            raise RuntimeError(f"episodes of {np.flatnonzero(over).tolist()} are over; reset them first")
        result = self.batch.step(np.asarray(actions))
        observation, reward = result.observation, result.reward.astype(np.float64)
        ended, final = result.ended.copy(), {}
        if mode is AutoresetMode.NEXT_STEP and over.any():
            observation[over] = self.batch.restart(np.flatnonzero(over))
            reward[over], ended[over] = 0.0, False
        if mode is AutoresetMode.SAME_STEP and ended.any():
            final = self._final(observation, ended)
            observation[ended] = self.batch.restart(np.flatnonzero(ended))
        self._ended = ended.copy()
        self._observation = observation
        return observation.copy(), reward, np.zeros(self.num_envs, bool), ended, self._infos() | final

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:  # type: ignore[override]
        """Return a picture of each aircraft, (H, W, 3); None without a render mode."""
        return None if self.render_mode is None else tuple(self.batch.frames(range(self.num_envs)))

    def close_extras(self, **_: Any) -> None:  # noqa: ANN401
        """Close the physics simulation."""
        self.batch.close()

    def _reset_some(self, mask: NDArray[Any], seed: object) -> tuple[Array32, dict[str, Any]]:
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f"options[{RESET_MASK!r}] is {mask.dtype} {mask.shape}, expected bool ({self.num_envs},) "
                f"with at least one True"
            )
        if seed is not None:
            raise ValueError(f"a seed with options[{RESET_MASK!r}]: all aircraft share one random stream")
        self._observation[mask] = self.batch.restart(np.flatnonzero(mask))
        self._ended[mask] = False
        return self._observation.copy(), self._infos(mask)

    def _reseed(self, seed: int | list[int | None] | None) -> None:
        """Begin the random stream of a seed, of one seed an aircraft, or a random one."""
        if isinstance(seed, list | tuple | np.ndarray):
            if len(seed) != self.num_envs:
                raise ValueError(f"{len(seed)} seeds, expected one for each of {self.num_envs} aircraft")
            numbers = [int(number) for number in seed if number is not None]
            self._np_random_seed = None
            self._np_random = np.random.default_rng(np.random.SeedSequence(numbers) if numbers else None)
        else:
            super().reset(seed=seed)
        self.batch.reseed(self.np_random)

    def _final(self, observation: Array32, ended: Flags) -> dict[str, Any]:
        """Return the infos of ended episodes' last steps, where the next episode begins in the same step."""
        last = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(ended):
            last[i] = observation[i].copy()
        return {
            "final_obs": last,
            "_final_obs": ended.copy(),
            "final_info": self._infos(ended),
            "_final_info": ended.copy(),
        }

    def _infos(self, mask: Flags | None = None) -> dict[str, Any]:
        """Return the rates and a mask of the aircraft that they belong to, in Gymnasium's form of infos."""
        told = np.ones(self.num_envs, bool) if mask is None else mask
        infos: dict[str, Any] = {}
        for name, value in self.batch.info().items():
            infos |= {name: value * told[:, None], f"_{name}": told.copy()}
        return infos


def _mode(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError:
        known = ", ".join(each.value for each in AutoresetMode)
        raise TrainingError(f"environment: autoreset_mode: got {mode!r}, expected one of: {known}") from None


def _steps_max(steps: int | None) -> int | None:
    if steps is None or (isinstance(steps, int) and not isinstance(steps, bool) and steps >= 1):
        return steps
    raise TrainingError(f"environment: max_episode_steps: got {steps!r}, expected at least 1")
