"""Everything that decides what a training run produces, as plain frozen data that is kept with the result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.aircraft import Aircraft
from sim.mass import Vector
from sim.world import Mount
from toolchain.contract import CONTROL_RATES_HZ, ObservationTerm, check_cutoffs, observation_blocks
from toolchain.errors import TrainingError
from training.algorithm import Algorithm, PpoConfig
from training.randomization import Randomization
from training.reward import Reward, TrackingReward
from training.selection import Selection
from training.task import PulseTask, Task

# Raw observation values are brought to about unit size by these factors, folded into the first layer at
# freeze. Errors of interest are up to some hundred deg/s (3 rad/s); the gyro's noise makes a delta of
# about 2 deg/s (0.03 rad/s) a step.
OBSERVATION_SCALES = {
    "rate": 0.3,
    "rate_error": 0.3,
    "rate_error_delta": 10.0,
    "rate_error_integral": 3.0,
    "previous_action": 1.0,
    "throttle": 1.0,
    "rotor_speed": 0.001,
    "gravity": 1.0,
}
ACTIVATIONS = ("relu", "tanh")
SEED_MAX = 2**32 - 1
IDLE_MAX = 0.5
WIND_MAX = 30.0  # [m/s], a storm; nobody flies a small multirotor in more


@dataclass(frozen=True)
class OutputMap:
    """Network output a to motor fraction: clip(scale a + offset, 0, 1); folded into the last layer.

    With `squash` a = tanh(last sum), which stays in the frozen network.
    """

    scale: float = 0.5
    offset: float = 0.5
    squash: bool = False  # a is tanh of the network's last sum: bounded outputs, whose gradient never ends

    def bounds(self) -> tuple[float, float]:
        """Network outputs that make 0 and 1; what lies beyond changes nothing."""
        return -self.offset / self.scale, (1.0 - self.offset) / self.scale

    def asked(self, output: NDArray[np.float32]) -> NDArray[np.float32]:
        """What an output asks of the motors before it is clipped to 0..1, float32, any shape."""
        asked: NDArray[np.float32] = np.float32(self.scale) * output + np.float32(self.offset)
        return asked


@dataclass(frozen=True)
class WorldConfig:
    """Where the episodes take place."""

    mount: str = "centre"  # sim.world.Mount: turning about the centre of mass, on the rig, or free
    gravity: bool | None = None  # None: in free flight only
    noise: bool = True  # of gyro and accelerometer
    wind_m_s: Vector = (0.0, 0.0, 0.0)  # world axes
    gust_m_s: float = 0.0  # of the wind 20 feet above the ground that sets the turbulence
    throttle_max: float = 0.0  # the pilot's thrust is drawn for each episode from 0 to this
    throttle_share: float = 1.0  # of the episodes that have any
    randomization: Randomization = field(default_factory=Randomization)

    def refusals(self) -> Iterator[str]:
        """What is no world, one line each."""
        mounts = [mount.value for mount in Mount]
        if self.mount not in mounts:
            yield f"mount {self.mount!r}, expected one of: {', '.join(mounts)}"
        if not all(abs(speed) <= WIND_MAX for speed in self.wind_m_s):
            yield f"wind_m_s {list(self.wind_m_s)}, expected at most {WIND_MAX:g} m/s each way"
        if not 0.0 <= self.gust_m_s <= WIND_MAX:
            yield f"gust_m_s {self.gust_m_s}, expected 0 to {WIND_MAX:g} m/s"
        if not 0.0 <= self.throttle_max <= 1.0:
            yield f"throttle_max {self.throttle_max}, expected 0 to 1"
        if not 0.0 <= self.throttle_share <= 1.0:
            yield f"throttle_share {self.throttle_share}, expected 0 to 1"
        yield from self.randomization.refusals()


@dataclass(frozen=True)
class TrainingConfig:
    """One run of synthesis."""

    steps: int = 8_000_000  # control steps, all aircraft together
    seed: int = 1
    observation: str = "rate_error,rate_error_delta"
    control_rate_hz: int = 1000
    hidden: tuple[int, ...] = (64, 64)
    activation: str = "tanh"
    output: OutputMap = field(default_factory=OutputMap)
    idle: float = 0.0  # motor fraction that armed motors turn at without thrust; part of the policy
    task: Task = field(default_factory=PulseTask)
    reward: Reward = field(default_factory=TrackingReward)
    world: WorldConfig = field(default_factory=WorldConfig)
    algorithm: Algorithm = field(default_factory=PpoConfig)
    checkpoint_steps: int = 1_000_000  # a checkpoint at the end of the leg that passes each multiple of it
    selection: Selection = field(default_factory=Selection)  # which of them becomes policy.onnx

    def __post_init__(self) -> None:
        """Refuse what cannot be run, before anything is."""
        demands = {
            f"control rate {self.control_rate_hz} Hz, expected one of {list(CONTROL_RATES_HZ)}": (
                self.control_rate_hz in CONTROL_RATES_HZ
            ),
            f"{self.steps} steps asked for, expected at least 1": self.steps >= 1,
            f"checkpoint_steps {self.checkpoint_steps}, expected at least 1": self.checkpoint_steps >= 1,
            f"seed {self.seed}, expected 0 to {SEED_MAX}": 0 <= self.seed <= SEED_MAX,
            f"hidden layers {list(self.hidden)}, expected one or more widths of at least 1": (
                len(self.hidden) > 0 and min(self.hidden) >= 1
            ),
            f"activation {self.activation!r}, expected one of: {', '.join(ACTIVATIONS)}": (
                self.activation in ACTIVATIONS
            ),
            f"idle {self.idle}, expected 0 to {IDLE_MAX}": 0.0 <= self.idle <= IDLE_MAX,
        }
        for refusal, met in demands.items():
            if not met:
                raise TrainingError(refusal)
        episode_steps = round(self.task.duration_s * self.control_rate_hz)
        for refusal in (
            *self.world.refusals(),
            *self.algorithm.refusals(episode_steps),
            *self.selection.refusals(),
        ):
            raise TrainingError(refusal)
        self.blocks()

    def blocks(self) -> tuple[ObservationTerm, ...]:
        """The observation's terms. Raises TrainingError naming one that is unknown or cannot be had."""
        try:
            terms = observation_blocks(self.observation)
            check_cutoffs(terms, self.control_rate_hz)
            return terms
        except ValueError as error:
            raise TrainingError(f"observation {self.observation!r}: {error}") from error

    def observation_scale(self, motors: int) -> list[float]:
        """Factor onto each raw observation value."""
        return [OBSERVATION_SCALES[b.name] for b in self.blocks() for _ in range(b.count(motors))]

    def document(self, aircraft: Aircraft) -> dict[str, Any]:
        """The run as JSON data, with what `toolchain.freeze` needs to rebuild the network."""
        return {
            "aircraft": {"name": aircraft.name, "sha256": aircraft.sha256},
            "motors": aircraft.motor_count,
            "observation_scale": self.observation_scale(aircraft.motor_count),
            "filters": [],
            **{field.name: _plain(getattr(self, field.name)) for field in fields(self)},
        }


def _plain(value: object) -> Any:  # noqa: ANN401
    """JSON data of a field; what comes in several kinds says which it is."""
    if not is_dataclass(value) or isinstance(value, type):
        return value
    kind = {"name": value.name} if hasattr(value, "name") else {}
    return {**kind, **{field.name: _plain(getattr(value, field.name)) for field in fields(value)}}
