"""N aircraft on one task: what every environment flies.

One step is one control period: observe, act, mix, quantise to DShot, advance the twin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.control.estimator import observed_model
from neuroflight.sim.control.gyro_filter import GyroFilter, samples_per_step
from neuroflight.sim.control.motors import dshot_values, motor_fractions, throttle_mix
from neuroflight.sim.control.observation import Observer
from neuroflight.sim.physics.imu import quantised_rate
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.variation import Variation
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import ESC_BLOCKS, check_observation
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.policy.model_constants import ModelConstants
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.tasks.reward import Transition


@dataclass(frozen=True)
class StepResult:
    """The result of a control step, for each of N aircraft."""

    observation: NDArray[np.float32]  # (N, n), of the new sample
    reward: NDArray[np.float32]  # (N,)
    ended: NDArray[np.bool_]  # (N,), the episode's time is over (a truncation; nothing terminates)


class AttitudeSimulation:
    """N twins, their commands and their observations, advanced together at the control rate."""

    def __init__(
        self,
        aircraft: Aircraft,
        count: int,
        *,
        config: TrainingConfig,
        rng: np.random.Generator,
        steps_max: int | None = None,
        model: ModelConstants | None = None,
    ) -> None:
        """Create the aircraft. All random numbers come from `rng`.

        steps_max: the longest episode; model: that policies observe it by, None: its own.
        """
        self.count = count
        self.motor_count = aircraft.motor_count
        terms = config.blocks()
        try:
            check_observation(terms, self.motor_count)
        except ValueError as error:
            raise TrainingError(str(error)) from error
        self._task, self._reward, self._world = config.task, config.reward, config.world
        self._rate_hz = config.control_rate_hz
        self._idle, self._mix = config.idle, config.mixing
        self._randomization = config.world.randomization
        self._delay_s = aircraft.propulsion.delay
        self._rng = rng
        self.steps = round(self._task.duration_s * self._rate_hz)
        self._last = self.steps if steps_max is None else min(self.steps, steps_max)
        filters = config.gyro_filters
        self._samples = samples_per_step(filters, self._rate_hz)
        self._gyro = GyroFilter(filters, count, self.motor_count, self._rate_hz, self._samples)
        self._hears = filters.rpm is not None
        self._twin = Twin(
            aircraft,
            count,
            rate_hz=self._samples * self._rate_hz,
            mount=Mount(self._world.mount),
            gravity=self._world.gravity,
            noise=self._world.noise,
            wind=self._world.wind_m_s,
            gust=self._world.gust_m_s,
            variation=self._drawn(count),
            rng=rng,
        )
        model = observed_model(aircraft, terms, self._rate_hz) if model is None else model
        self._observer = Observer(
            terms, count, self.motor_count, self._rate_hz, model=model, idle=config.idle
        )
        self.width = self._observer.width
        self._everyone = np.arange(count)
        self._step = np.zeros(count, np.intp)
        self._setpoints = np.zeros((count, self.steps, 3), np.float32)
        self._throttle = np.zeros(count, np.float32)
        # Of each control step, where the throttle moves in some of the episodes.
        self._moving = np.zeros((count, self.steps), np.float32) if self._world.throttle_steps > 0.0 else None
        self._action = np.zeros((count, self.motor_count), np.float32)
        self._fractions = np.zeros((count, self.motor_count))  # of the motors, behind mix and idle

    def close(self) -> None:
        """Close the physics client."""
        self._twin.close()

    def reset(self, *, stagger: bool = False) -> NDArray[np.float32]:
        """Begin an episode on every aircraft; returns the observations (N, n).

        stagger: spread the aircraft over the episode's time, so that every batch contains all parts of it.
        """
        self._begin(self._everyone)
        if stagger:
            self._step = self._rng.integers(0, self._last, self.count)
            self._move_throttle()
        return self._observe(slice(None))

    def step(self, unclipped: NDArray[np.float32]) -> StepResult:
        """Advance one control period with motor fractions (N, M), which are clipped to 0..1.

        The observation of an aircraft whose episode ended is the last one of that episode; `restart` begins
        its next episode.
        """
        action = np.clip(unclipped, np.float32(0.0), np.float32(1.0))
        setpoint_before = self.setpoint
        error_before = setpoint_before - self._twin.rate
        fractions = throttle_mix(action, self._throttle, self._mix)
        self._observer.commanded(slice(None), fractions, self._throttle)
        self._fractions = command = motor_fractions(dshot_values(fractions, self._idle))
        for left in reversed(range(self._samples)):
            self._twin.step(command)
            if self._hears and left == 0:
                self._gyro.told(self._twin.told_speed)
            self._gyro.add(quantised_rate(self._twin.gyro))
        before, self._action = self._action, action
        self._step += 1
        self._move_throttle()
        setpoint = self.setpoint
        reward = self._reward(
            Transition(
                setpoint=setpoint,
                setpoint_before=setpoint_before,
                error=setpoint - self._twin.rate,
                error_before=error_before,
                unclipped=unclipped,
                action=action,
                action_before=before,
            )
        )
        return StepResult(self._observe(slice(None)), reward, self._step >= self._last)

    def restart(self, index: NDArray[np.intp]) -> NDArray[np.float32]:
        """Begin a new episode on the aircraft of `index`; returns their observations (len, n)."""
        self._begin(index)
        return self._observe(index)

    @property
    def setpoint(self) -> NDArray[np.float64]:
        """Commanded rate of the present sample [rad/s], (N, 3)."""
        now = np.minimum(self._step, self.steps - 1)  # after its last step an episode keeps its last setpoint
        return self._setpoints[self._everyone, now].astype(np.float64)

    @property
    def rotation(self) -> NDArray[np.float64]:
        """True attitude of the present sample as matrices from body to world, (N, 3, 3)."""
        return self._twin.rotation

    @property
    def motors(self) -> NDArray[np.float64]:
        """Motor fractions of the last step, behind mix and idle, (N, M); zeros on an episode's first."""
        return self._fractions.copy()

    @property
    def rate(self) -> NDArray[np.float64]:
        """True rate of the present sample [rad/s], (N, 3)."""
        return self._twin.rate

    def _begin(self, index: NDArray[np.intp]) -> None:
        variation = self._drawn(len(index))
        if variation is not None:
            self._twin.vary(index, variation)
        self._twin.reset(index)
        self._gyro.reset(index)
        self._gyro.add(quantised_rate(self._twin.gyro[index]), index)
        self._observer.reset(index)
        self._step[index] = 0
        self._setpoints[index] = self._task.episodes(len(index), self._rng, self._rate_hz)
        self._draw_throttle(index)
        self._action[index] = 0.0
        self._fractions[index] = 0.0

    def _draw_throttle(self, index: NDArray[np.intp]) -> None:
        """Draw the pilot's thrust of new episodes."""
        if self._moving is None:
            self._throttle[index] = self._world.draw_throttle(len(index), self._rng)
        else:
            self._moving[index] = self._world.draw_throttles(len(index), self.steps, self._rate_hz, self._rng)
            self._throttle[index] = self._moving[index, 0]

    def _move_throttle(self) -> None:
        """Bring the throttle to that of the present sample, where it moves."""
        if self._moving is not None:
            self._throttle = self._moving[self._everyone, np.minimum(self._step, self.steps - 1)]

    def _drawn(self, count: int) -> Variation | None:
        """Draw the aircraft of new episodes; None: as in the file."""
        if not self._randomization.active:
            return None
        return self._randomization.draw(count, self._rng, self._delay_s)

    def _observe(self, which: NDArray[np.intp] | slice) -> NDArray[np.float32]:
        return self._observer.observe(
            which,
            self.setpoint[which].astype(np.float32),
            self._gyro.read(which),
            self._action[which],
            self._throttle[which],
            **self._sensed(which),
        )

    def _sensed(self, which: NDArray[np.intp] | slice) -> dict[str, NDArray[np.float32]]:
        """Return observed values that neither gyro nor policy tells, float32."""
        twin, names = self._twin, self._observer.names
        sensed = {}
        if names & ESC_BLOCKS:
            sensed["rotor_speed"] = twin.told_speed[which]
        if "gravity" in names:
            sensed["gravity"] = -twin.rotation[which, 2].astype(np.float32)
        return sensed
