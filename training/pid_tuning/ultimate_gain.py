"""Ultimate gains: Ziegler and Nichols' experiment in the twin, and gains by their rules."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.mass import Vector
from neuroflight.sim.aircraft.model import Aircraft, PidSettings
from neuroflight.sim.arrays import Array
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.control.pid_table import mixer
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.rendering.pid_table import SCALE
from neuroflight.training.evaluation.evaluation import record
from neuroflight.training.tasks.task import EpisodicTask, GivenCommands

STEP_MAX_DEG_S = 100.0  # of the axis; the other two rest without control
STEP_OUTPUT = 0.3  # greatest first output; larger gains get smaller steps, so that no motor saturates
SETTLE_S, WINDOW_S = 0.5, 0.5  # start of the first of two compared windows, and their length
GAIN_MIN, GAIN_MAX = 0.02, 200.0  # searched for the ultimate gain
GAINS = 33  # tried at a time
ROUNDS = 2  # each between the greatest gain with a decaying oscillation and the least with a sustained one
SUSTAINED = 0.95  # least ratio of the amplitudes in second and first window
AMPLITUDE_MIN = 0.02  # least standard deviation of an oscillation, in parts of the step
CYCLES_MIN = 2  # in a window; fewer are a drift
RULES = {  # K_P / K_u, K_I T_u / K_u, K_D / (K_u T_u)
    "Ziegler-Nichols": (0.6, 1.2, 0.075),
    "some overshoot": (0.33, 0.66, 0.11),
    "no overshoot": (0.2, 0.4, 0.066),
}


@dataclass(frozen=True)
class UltimateGain:
    """The least proportional gain at which an axis keeps oscillating."""

    gain: float  # K_u, as K_P of PidSettings
    period: float  # T_u [s]

    def gains(self, rule: str) -> Vector:
        """Compute K_P, K_I, K_D by a rule of `RULES`."""
        return self.scaled(RULES[rule])

    def scaled(self, parts: Vector) -> Vector:
        """Compute K_P, K_I, K_D: `parts` times K_u, K_u / T_u and K_u T_u."""
        p, i, d = parts
        return p * self.gain, i * self.gain / self.period, d * self.gain * self.period


def ultimate_gains(
    aircraft: Aircraft, idle: float, control_rate_hz: int
) -> tuple[UltimateGain, UltimateGain, UltimateGain]:
    """Find K_u and T_u of each axis alone, without noise. Raises TrainingError without one."""
    roll, pitch, yaw = (_of_axis(aircraft, axis, idle, control_rate_hz) for axis in range(3))
    return roll, pitch, yaw


def _of_axis(aircraft: Aircraft, axis: int, idle: float, control_rate_hz: int) -> UltimateGain:
    low, high = GAIN_MIN, GAIN_MAX
    for _ in range(ROUNDS):
        gains = np.geomspace(low, high, GAINS)
        steps = np.minimum(STEP_MAX_DEG_S, STEP_OUTPUT / (gains * SCALE))
        rate = _oscillations(aircraft, axis, gains, steps, idle, control_rate_hz)
        window = round(WINDOW_S * control_rate_hz)
        before, after = rate[:, -2 * window : -window].std(axis=1), rate[:, -window:].std(axis=1)
        cycles = np.array([len(_crossings(row[-window:])) for row in rate]) - 1
        sustained = (after >= SUSTAINED * before) & (after >= AMPLITUDE_MIN * steps) & (cycles >= CYCLES_MIN)
        if not sustained.any():
            raise TrainingError(
                f"aircraft {aircraft.name}: {AXES[axis]} does not oscillate by itself at any proportional "
                f"gain from {GAIN_MIN:g} to {GAIN_MAX:g}; check inertia, thrust and delay in its file"
            )
        first = int(np.argmax(sustained))
        low, high = gains[max(first - 1, 0)], gains[first]
    crossings = _crossings(rate[first, -window:])
    period = float(crossings[-1] - crossings[0]) / (len(crossings) - 1) / control_rate_hz
    return UltimateGain(float(gains[first]), period)


def _oscillations(
    aircraft: Aircraft, axis: int, gains: Array, steps: Array, idle: float, control_rate_hz: int
) -> Array:
    """Fly each gain and its step; return the rate of `axis` [deg/s] over time, (G, T)."""
    nothing: Vector = (0.0, 0.0, 0.0)
    settings = []
    for gain in gains.tolist():
        own = [nothing, nothing, nothing]
        own[axis] = (gain, 0.0, 0.0)
        settings.append(PidSettings((own[0], own[1], own[2]), None, idle))
    command = np.zeros((len(gains), 3))
    command[:, axis] = np.deg2rad(steps)
    recording = record(
        Pid(mixer(aircraft), settings, len(gains), control_rate_hz),
        aircraft,
        GivenCommands(EpisodicTask(hold_s=SETTLE_S + 2 * WINDOW_S), command),
        episodes=len(gains),
        seed=0,
        control_rate_hz=control_rate_hz,
        noise=False,
        idle=idle,
    )
    return np.rad2deg(recording.rate[:, :, axis].astype(np.float64))


def _crossings(rate: Array) -> NDArray[np.intp]:
    """Return the indices at which `rate` (T,) crosses its mean upwards."""
    above = rate > rate.mean()
    return np.flatnonzero(~above[:-1] & above[1:])
