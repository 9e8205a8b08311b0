"""Trial flights by the dissertation's terms, in the twin: from rest, without throttle, the gyro as it is.

Cost of a candidate: its MAE [deg/s], averaged over axes and training pulses, plus 20 deg/s for each time
that the mean output or its mean change exceeds its limit (less a margin) by itself, plus 20 deg/s times the
mean excess over the 10 % band, none counted above 1, at the end of a second of large commands from rest.
The large commands are there for the integral: pulses alone need none in roll and pitch, but fast rotation
about two axes disturbs the third. Candidates of a generation fly side by side in one world, and every
generation flies the same commands and noise, so that costs differ by the settings alone. The gyro's constant
bias is set to 0: no controller can observe it, and the firmware calibrates it away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft, PidSettings
from neuroflight.sim.analysis.metrics import effort, tracking
from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.control.motors import throttle_mix
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.control.pid_table import mixer
from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.policy.gyro_filters import UNFILTERED
from neuroflight.training.evaluation.evaluation import Flights, record
from neuroflight.training.pid_tuning.trial import (
    MARGIN,
    PENALTY,
    RATE_HZ,
    Limits,
    Trial,
    Trials,
    held_commands,
    missed,
    training_commands,
    without_bias,
)
from neuroflight.training.tasks.task import EpisodicTask, GivenCommands, PulseTask

OUTPUT, CHANGE = 0.12, 0.012  # limits of the mean output and of its mean |change| in 1 ms
COMMANDS = 12  # pulses that each candidate flies


@dataclass(frozen=True, eq=False)
class DissertationTrials(Trials):
    """The flights that every candidate of a search makes."""

    mix, gyro_filters, idle = Mix.ATTITUDE_FIRST, UNFILTERED, None

    aircraft: Aircraft  # its gyro without bias
    limits: Limits
    seed: int  # of the gyro's noise
    commands: Array  # (n, 3) [rad/s], of the pulses

    @staticmethod
    def of(
        aircraft: Aircraft, limits: Limits, seed: int, rng: np.random.Generator, commands: int = COMMANDS
    ) -> DissertationTrials:
        """Make the trials of a seed; rng: of the commands."""
        return DissertationTrials(without_bias(aircraft), limits, seed, training_commands(commands, rng))

    def fly(self, candidates: Sequence[PidSettings]) -> list[Trial[PidSettings]]:
        """See Trials."""
        pulsed = self._flown(candidates, self.commands, PulseTask())
        held = self._flown(candidates, held_commands(), EpisodicTask())
        return [self._trial(*flown) for flown in zip(candidates, pulsed, held, strict=True)]

    def _flown(
        self, candidates: Sequence[PidSettings], commands: Array, task: PulseTask | EpisodicTask
    ) -> list[Flights]:
        """Fly each candidate through `commands` (m, 3); return the flights with the controllers' outputs."""
        count, each = len(candidates), len(commands)
        crowd = [settings for settings in candidates for _ in commands]
        pid = Pid(mixer(self.aircraft), crowd, len(crowd), RATE_HZ)
        motors = _Motors(pid, np.array([settings.idle for settings in crowd], np.float32))
        flown = record(
            motors,
            self.aircraft,
            GivenCommands(task, np.tile(commands, (count, 1))),
            episodes=len(crowd),
            seed=self.seed,
            control_rate_hz=RATE_HZ,
        )
        output = np.stack(motors.outputs, axis=1)
        rows = [slice(start, start + each) for start in range(0, len(crowd), each)]
        return [Flights(flown.setpoint[r], flown.rate[r], output[r], flown.step_s) for r in rows]

    def _trial(self, settings: PidSettings, pulsed: Flights, held: Flights) -> Trial[PidSettings]:
        limits = self.limits
        mae = float(tracking(pulsed.setpoint, pulsed.rate, pulsed.step_s).mae.mean())
        outputs = effort(pulsed.output, pulsed.step_s)
        excess = max(0.0, outputs.output / (MARGIN * limits.output) - 1.0)
        excess += max(0.0, outputs.change / (MARGIN * limits.change) - 1.0)
        beyond = missed(held)
        cost = mae + PENALTY * (excess + beyond)
        return Trial(settings, mae, outputs.change, cost, outputs.output, beyond)


class _Motors:
    """PIDs, each with its idle, as one controller whose outputs are the motor values."""

    def __init__(self, pid: Pid, idle: Array32) -> None:
        """idle: (N,), fractions."""
        self.outputs: list[Array32] = []  # (N, M) of each step, before idle
        self._pid, self._idle = pid, idle[:, None]

    def reset(self) -> None:
        """See Controller."""
        self._pid.reset()
        self.outputs.clear()

    def step(self, setpoint: Array32, gyro: Array32, throttle: Array32) -> Array32:
        """See Controller."""
        y = self._pid.step(setpoint, gyro, throttle)
        self.outputs.append(y)
        above = np.float32(1.0) - self._idle
        return self._idle + above * throttle_mix(y, throttle, Mix.ATTITUDE_FIRST)
