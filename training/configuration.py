"""Everything that decides what a training run produces, as plain frozen data that is kept with the result."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.aircraft import Aircraft
from sim.world import COUNT_MAX
from toolchain.contract import CONTROL_RATES_HZ, ObservationBlock, observation_blocks
from toolchain.errors import TrainingError
from training.reward import TrackingReward
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
}
ACTIVATIONS = ("relu", "tanh")
SEED_MAX = 2**32 - 1


@dataclass(frozen=True)
class OutputMap:
    """Network output a to motor fraction: clip(scale a + offset, 0, 1); folded into the last layer."""

    scale: float = 0.5
    offset: float = 0.5

    def bounds(self) -> tuple[float, float]:
        """Network outputs that make 0 and 1; what lies beyond changes nothing."""
        return -self.offset / self.scale, (1.0 - self.offset) / self.scale

    def motors(self, output: NDArray[np.float32]) -> NDArray[np.float32]:
        """Motor fractions, float32, any shape."""
        y = np.float32(self.scale) * output + np.float32(self.offset)
        bounded: NDArray[np.float32] = np.clip(y, np.float32(0.0), np.float32(1.0))
        return bounded


@dataclass(frozen=True)
class PpoConfig:
    """PPO's knobs (Schulman et al. 2017; names as in Stable-Baselines3)."""

    aircraft: int = 256
    horizon: int = 128  # control steps an aircraft between updates
    minibatch: int = 8192
    epochs: int = 4
    learning_rate: float = 7e-4  # annealed linearly to a tenth
    discount: float = 0.99  # at 1 kHz: a horizon of 100 ms
    gae_lambda: float = 0.98  # rotors answer over 40 ms: credit must reach back as far
    clip: float = 0.2
    log_std: tuple[float, float] = (-1.0, -2.5)  # exploration, network output units, first to last step
    smoothness: float = 0.45  # weight of the mean output's change under gyro noise, see smooth_ppo


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
    throttle_max: float = 0.0
    task: Task = field(default_factory=PulseTask)
    reward: TrackingReward = field(default_factory=TrackingReward)
    ppo: PpoConfig = field(default_factory=PpoConfig)

    def __post_init__(self) -> None:
        """Refuse what cannot be run, before anything is."""
        ppo = self.ppo
        batch = ppo.aircraft * ppo.horizon
        demands = {
            f"control rate {self.control_rate_hz} Hz, expected one of {list(CONTROL_RATES_HZ)}": (
                self.control_rate_hz in CONTROL_RATES_HZ
            ),
            f"{ppo.aircraft} aircraft, expected 1 to {COUNT_MAX}": 1 <= ppo.aircraft <= COUNT_MAX,
            f"horizon {ppo.horizon}, expected 1 or more control steps": ppo.horizon >= 1,
            f"minibatch {ppo.minibatch} does not divide the {batch} steps of a rollout "
            f"({ppo.aircraft} aircraft x {ppo.horizon}); choose a divisor": (
                ppo.minibatch > 0 and batch % ppo.minibatch == 0
            ),
            f"{self.steps} steps asked for, expected at least one rollout of {batch}": self.steps >= batch,
            f"seed {self.seed}, expected 0 to {SEED_MAX}": 0 <= self.seed <= SEED_MAX,
            f"hidden layers {list(self.hidden)}, expected one or more widths of at least 1": (
                len(self.hidden) > 0 and min(self.hidden) >= 1
            ),
            f"activation {self.activation!r}, expected one of: {', '.join(ACTIVATIONS)}": (
                self.activation in ACTIVATIONS
            ),
            f"throttle_max {self.throttle_max}, expected 0 to 1": 0.0 <= self.throttle_max <= 1.0,
        }
        for refusal, met in demands.items():
            if not met:
                raise TrainingError(refusal)
        self.blocks()

    def blocks(self) -> tuple[ObservationBlock, ...]:
        """The observation's blocks. Raises TrainingError naming an unknown one."""
        try:
            return observation_blocks(self.observation)
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
            **asdict(self),
        }
