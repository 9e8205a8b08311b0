"""The configuration of a training run: all that decides its result, as frozen data kept with the result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.mass import Vector
from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.control.estimator import observed_model
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import (
    CONTROL_RATES_HZ,
    Mix,
    ObservationTerm,
    check_cutoffs,
    check_observation,
    observation_blocks,
)
from neuroflight.toolchain.errors import AircraftError, TrainingError
from neuroflight.toolchain.policy.gyro_filters import GyroFilters
from neuroflight.toolchain.policy.model_constants import ModelConstants
from neuroflight.toolchain.strict_toml import shown
from neuroflight.training.config.algorithms import ENDS_IN_TANH, Algorithm, PpoConfig
from neuroflight.training.config.pathwise_config import PathwiseConfig
from neuroflight.training.config.randomization import SAME, Randomization
from neuroflight.training.config.selection import SelectionLimits
from neuroflight.training.config.throttle import moving_throttle
from neuroflight.training.plugins import plugins_of
from neuroflight.training.tasks.limits import Limits, OneOf, Share, value_errors
from neuroflight.training.tasks.reward import Reward, TrackingReward
from neuroflight.training.tasks.task import PulseTask, Task

# Factors that bring raw observation values to about unit size; freezing folds them into the first layer.
# Errors of interest are up to some hundred deg/s (3 rad/s); the gyro's noise makes a delta of
# about 2 deg/s (0.03 rad/s) a step. Rotors steer by differences of some hundred rad/s.
OBSERVATION_SCALES = {
    "rate": 0.3,
    "rate_error": 0.3,
    "rate_error_delta": 10.0,
    "rate_error_integral": 3.0,
    "previous_action": 1.0,
    "throttle": 1.0,
    "rotor_speed": 0.004,
    "gravity": 1.0,
    "previous_motors": 1.0,
    "rotor_estimate": 0.004,
    "rotor_measured": 0.004,
    "rate_estimate": 0.3,
    "rate_estimate_error": 0.3,
}
SEED_MAX = 2**32 - 1
STEPS_MAX = 10**12  # months of computing time
LAYERS_MAX, WIDTH_MAX = 8, 1024  # of a policy; the board has memory for far less
EPISODE_STEPS_MAX = 1_000_000
TABLE_STEPS_MAX = 64_000_000  # setpoints of all aircraft's episodes, kept in memory: 768 MB
IDLE_MAX = 0.5
SCALE_MAX = 1e3  # of an output
WIND_MAX = 30.0  # [m/s], a storm


@dataclass(frozen=True)
class OutputMap:
    """Network output a to motor fraction: clip(scale a + offset, 0, 1); folded into the last layer.

    With `squash` a = tanh(last sum), which stays in the frozen network.
    """

    scale: Annotated[float, Limits(1e-3, SCALE_MAX)] = 0.5
    offset: Annotated[float, Limits(-SCALE_MAX, SCALE_MAX)] = 0.5
    squash: bool = False  # a is tanh of the last sum: bounded outputs with a gradient everywhere

    def errors(self) -> Iterator[str]:
        """Yield errors of the values, one line each."""
        yield from value_errors(self, "output.")
        low, high = self.offset - self.scale, self.offset + self.scale
        if self.squash and not (low < 1.0 and high > 0.0):
            yield f"output reaches from {low:g} to {high:g}, expected some of it within 0 to 1"

    def unclipped(self, output: NDArray[np.float32]) -> NDArray[np.float32]:
        """Compute the motor fractions of outputs before they are clipped to 0..1, float32, any shape."""
        unclipped: NDArray[np.float32] = np.float32(self.scale) * output + np.float32(self.offset)
        return unclipped


@dataclass(frozen=True)
class WorldConfig:
    """The world that the episodes are flown in."""

    # Of mass; "rig": a ball joint at the centre of thrust; "free": flying.
    mount: Annotated[str, OneOf([mount.value for mount in Mount])] = "centre"
    gravity: bool | None = None  # none: in free flight only
    noise: bool = True  # of gyro and accelerometer
    # World axes, each at most 30.
    wind_m_s: Annotated[Vector, Limits(-WIND_MAX, WIND_MAX)] = (0.0, 0.0, 0.0)
    # Of the wind 20 feet above the ground that sets the turbulence.
    gust_m_s: Annotated[float, Limits(0.0, WIND_MAX)] = 0.0
    throttle_max: Share = 0.0  # the pilot's thrust is drawn for each episode from 0 to this
    throttle_share: Share = 1.0  # share of the episodes that have any
    throttle_steps: Share = 0.0  # share of those in which it changes on the way, at random times
    # "any": each 16 episodes fly a quadcopter of their own, drawn from all that fly; a policy is told of it.
    aircraft: Annotated[str, OneOf(("file", "any"))] = "file"
    randomization: Randomization = field(default_factory=Randomization)

    def draw_throttles(
        self, count: int, steps: int, rate_hz: int, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Draw the pilot's thrust at each control step of `count` new episodes, (count, steps)."""
        throttle = np.repeat(self.draw_throttle(count, rng)[:, None], steps, axis=1)
        if self.throttle_steps > 0.0:
            moved = np.flatnonzero((rng.random(count) < self.throttle_steps) & (throttle[:, 0] > 0.0))
            throttle[moved] = moving_throttle(throttle[moved, 0], self.throttle_max, steps, rate_hz, rng)
        return throttle

    def draw_throttle(self, count: int, rng: np.random.Generator) -> NDArray[np.float32]:
        """Draw the pilot's thrust in each of `count` new episodes, (count,)."""
        throttle = rng.uniform(0.0, self.throttle_max, count)
        throttle[rng.random(count) >= self.throttle_share] = 0.0
        return throttle.astype(np.float32)

    def errors(self) -> Iterator[str]:
        """Yield errors of the values, one line each."""
        yield from value_errors(self)
        if self.gravity and self.mount == Mount.CENTRE.value:
            yield "gravity = true with mount 'centre', where it has no effect; expected mount 'rig' or 'free'"
        if self.randomization.noise != SAME and not self.noise:
            yield "randomization noise with noise = false, so nothing to vary; leave one of them out"
        if self.randomization.vibration_deg_s is not None and not self.noise:
            yield "randomization vibration_deg_s with noise = false, which leaves it out; give one of them"
        yield from self.randomization.errors()


@dataclass(frozen=True)
class TrainingConfig:
    """One training run."""

    steps: Annotated[int, Limits(1, STEPS_MAX)] = 8_000_000  # control steps, all aircraft together
    seed: Annotated[int, Limits(0, SEED_MAX)] = 1
    observation: str = "rate_error,rate_error_delta"  # terms NAME[~fHz][@k]
    # Or 2000, 4000; part of the policy.
    control_rate_hz: Annotated[int, OneOf(CONTROL_RATES_HZ)] = 1000
    hidden: tuple[int, ...] = (64, 64)  # widths of the hidden layers
    activation: Annotated[str, OneOf(("relu", "tanh"))] = "tanh"  # or "relu"
    # Or "gru", "lstm": the first of the hidden layers, with memory; pathwise only.
    recurrent: Annotated[str, OneOf(("none", "gru", "lstm"))] = "none"
    output: OutputMap = field(default_factory=OutputMap)
    # Motor fraction of armed motors at no thrust; part of the policy, as the next two.
    idle: Annotated[float, Limits(0.0, IDLE_MAX)] = 0.0
    # Of outputs and throttle; or "centred".
    mix: Annotated[str, OneOf([mix.text for mix in Mix])] = Mix.ATTITUDE_FIRST.text
    # Or "mean", of the gyro's samples of a control period; "rpm,mean", behind notches at the rotors' turns.
    gyro_filter: str = "none"
    task: Task = field(default_factory=PulseTask)
    reward: Reward = field(default_factory=TrackingReward)
    world: WorldConfig = field(default_factory=WorldConfig)
    algorithm: Algorithm = field(default_factory=PpoConfig)
    # Checkpoint at the end of the segment that passes each multiple.
    checkpoint_steps: Annotated[int, Limits(1)] = 1_000_000
    selection: SelectionLimits = field(default_factory=SelectionLimits)  # of what becomes policy.onnx
    # SHA-256 of the checkpoint whose policy the run begins with, as `--from` sets it; none: random weights.
    start: str | None = None

    def __post_init__(self) -> None:
        """Reject a configuration that cannot be run."""
        for error in self._errors():
            raise TrainingError(error)
        self.blocks()

    def _errors(self) -> Iterator[str]:
        """Yield errors of the values, one line each."""
        yield from value_errors(self)
        if not 1 <= len(self.hidden) <= LAYERS_MAX or not all(1 <= w <= WIDTH_MAX for w in self.hidden):
            yield (
                f"hidden layers {shown(list(self.hidden))}, expected 1 to {LAYERS_MAX} widths of at least 1 "
                f"and at most {WIDTH_MAX}"
            )
        if self.recurrent != "none" and not isinstance(self.algorithm, PathwiseConfig):
            yield f"recurrent {self.recurrent!r}: {self.algorithm.name} trains no memory; choose pathwise"
        try:
            GyroFilters.parse(self.gyro_filter)
        except ValueError as error:
            yield str(error)
        yield from self.output.errors()
        if not self.output.squash and isinstance(self.algorithm, ENDS_IN_TANH):
            yield f"output.squash false, expected true: {self.algorithm.name}'s policies end in tanh"
        if not self.output.squash and self.drawn_bounded and isinstance(self.algorithm, PpoConfig):
            yield "output.squash false, expected true: a beta distribution has its mode at tanh of a sum"
        episode_steps = round(self.task.duration_s * self.control_rate_hz)
        if not 2 <= episode_steps <= EPISODE_STEPS_MAX:
            yield (
                f"an episode of task {self.task.name} is {self.task.duration_s:g} s, {episode_steps} control "
                f"steps; expected 2 to {EPISODE_STEPS_MAX}"
            )
        yield from self.world.errors()
        yield from self.algorithm.errors(episode_steps)
        table = self.algorithm.aircraft * episode_steps
        if table > TABLE_STEPS_MAX:
            yield (
                f"{self.algorithm.aircraft} aircraft with episodes of {episode_steps} control steps make "
                f"{table} setpoints, expected at most {TABLE_STEPS_MAX}; shorten the task or fly fewer"
            )
        yield from self.selection.errors()
        if isinstance(self.algorithm, PathwiseConfig) and not isinstance(self.reward, TrackingReward):
            yield (
                f"reward {self.reward.name}: algorithm {self.algorithm.name} follows the gradient of its own "
                f"loss and asks no reward; choose another, such as --algorithm ppo, or leave the reward out"
            )

    def check(self, aircraft: Aircraft) -> None:
        """Raise TrainingError if this aircraft cannot be trained with the configuration."""
        where = f"aircraft {aircraft.name}"
        try:
            check_observation(self.blocks(), aircraft.motor_count)
            self.gyro_filters.check(aircraft.motor_count, self.control_rate_hz)
        except ValueError as error:
            raise TrainingError(f"{where}: {error}") from None
        try:
            self._model(aircraft)
        except AircraftError as error:
            raise TrainingError(str(error)) from None
        varied = self.world.randomization
        battery, supply = aircraft.battery, aircraft.propulsion.supply_voltage
        if varied.charge is not None and (battery is None or supply is None):
            lacks = "[battery] table" if battery is None else "propulsion.supply_voltage_v"
            raise TrainingError(
                f"{where} has no {lacks}, so randomization charge has nothing to vary; leave it out"
            )
        gyro = aircraft.gyro
        if varied.noise != SAME and not (gyro.bias or any((*gyro.noise, *gyro.vibration))):
            raise TrainingError(
                f"{where} has an ideal gyro, so randomization noise has nothing to vary; leave it out"
            )

    def _model(self, aircraft: Aircraft) -> ModelConstants | None:
        """Compute the constants of the model that the policy observes by; None without a model."""
        return observed_model(aircraft, self.blocks(), self.control_rate_hz)

    @property
    def mixing(self) -> Mix:
        """Mix of outputs and throttle to motor fractions."""
        return Mix.of(self.mix)

    @property
    def drawn_bounded(self) -> bool:
        """True if the algorithm's own outputs lie in -1..1, after the tanh of `OutputMap.squash`."""
        match self.algorithm:
            case PpoConfig(distribution=distribution):
                return distribution == "beta"
            case algorithm:
                return isinstance(algorithm, ENDS_IN_TANH)

    @property
    def gyro_filters(self) -> GyroFilters:
        """The gyro filters that the policy is trained behind."""
        return GyroFilters.parse(self.gyro_filter)

    def blocks(self) -> tuple[ObservationTerm, ...]:
        """Parse the observation's terms. Raises TrainingError naming one that is unknown or impossible."""
        try:
            terms = observation_blocks(self.observation)
            check_cutoffs(terms, self.control_rate_hz)
            return terms
        except ValueError as error:
            own = "; for one of your own see docs/guides/own-modules.md" if "unknown" in str(error) else ""
            raise TrainingError(f"observation {self.observation!r}: {error}{own}") from None

    def observation_scale(self, motors: int) -> list[float]:
        """Return the factor for each raw observation value."""
        return [OBSERVATION_SCALES[b.name] for b in self.blocks() for _ in range(b.count(motors))]

    def document(self, aircraft: Aircraft) -> dict[str, Any]:
        """Return the configuration as JSON data, with what `toolchain.policy.freeze` needs to rebuild the
        network.

        Raises TrainingError if the aircraft cannot be trained with this, see `check`.
        """
        self.check(aircraft)
        model = self._model(aircraft)
        plugins = plugins_of(self.task, self.reward)
        return {
            "aircraft": {"name": aircraft.name, "sha256": aircraft.sha256},
            "motors": aircraft.motor_count,
            "observation_scale": self.observation_scale(aircraft.motor_count),
            "filters": self.gyro_filters.chain,
            **({} if model is None else {"model": model.document()}),
            **({"plugins": plugins} if plugins else {}),
            **{field.name: _plain(getattr(self, field.name)) for field in fields(self)},
        }


def _plain(value: object) -> Any:  # noqa: ANN401
    """Return JSON data of a field: tasks, rewards and algorithms with their name, without derived fields."""
    if not is_dataclass(value) or isinstance(value, type):
        return value
    kind = {"name": value.name} if hasattr(value, "name") else {}
    return {
        **kind,
        **{field.name: _plain(getattr(value, field.name)) for field in fields(value) if field.init},
    }
