"""Plot of a PID tuning: step responses at its start and of its result, and all candidates."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft, PidSettings
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.control.pid_table import mixer
from neuroflight.sim.plotting import FLIGHT_COLOURS, GRID, INK, dress, log_numbers, titled_figure
from neuroflight.toolchain.contract import AXES
from neuroflight.training.evaluation.evaluation import record
from neuroflight.training.pid_tuning.trial import RATE_HZ, Limits, Trial
from neuroflight.training.pid_tuning.tuning import PidTuning
from neuroflight.training.tasks.task import GivenCommands, PulseTask

STEP_DEG_S = 100.0  # drawn step, on one axis at a time
SHOWN_S = 0.5
START_COLOUR, BEST_COLOUR = FLIGHT_COLOURS[1], FLIGHT_COLOURS[0]
OUTSIDE = "#b3bac4"  # candidates that exceed a limit


def draw_tuning(tuning: PidTuning, aircraft: Aircraft, limits: Limits, throttle: float, title: str) -> Figure:
    """Draw steps with the gains of the start and the best at `throttle`; below, all candidates."""
    figure = titled_figure((12, 7.5), title)
    grid = figure.add_gridspec(2, 3)
    panels = [figure.add_subplot(grid[0, axis]) for axis in range(3)]
    top = 1.15 * STEP_DEG_S
    for label, trial, colour in (("start", tuning.start, START_COLOUR), ("tuned", tuning.best, BEST_COLOUR)):
        t, rate = _responses(aircraft, trial.settings, throttle)
        top = max(top, float(rate.max()))
        for axis, panel in enumerate(panels):
            panel.plot(t, rate[axis], color=colour, lw=1.5, label=label)
    for axis, panel in enumerate(panels):
        panel.axhline(STEP_DEG_S, color=INK, lw=1.0, ls=(0, (4, 2)), zorder=1, label="setpoint")
        found = tuning.ultimate_gains[axis]
        dress(panel, f"{AXES[axis]}:  $K_u$ {found.gain:.3g},  $T_u$ {1e3 * found.period:.0f} ms")
        panel.set_xlim(0, 1e3 * SHOWN_S)
        panel.set_ylim(-0.08 * top, 1.05 * top)
        panel.set_xlabel("time since the command, ms", color=INK)
    panels[0].set_ylabel("rate, deg/s", color=INK)
    panels[0].legend(loc="lower right", frameon=False, fontsize=9)
    _draw_search(figure.add_subplot(grid[1, :2]), tuning, limits)
    _draw_limit(figure.add_subplot(grid[1, 2]), tuning, limits)
    return figure


def _responses(
    aircraft: Aircraft, settings: PidSettings, throttle: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fly the steps; return time [ms] (T,) and rate [deg/s] (3, T), with the gyro's noise."""
    task = PulseTask(command_s=SHOWN_S, rest_s=0.0)
    flights = record(
        Pid(mixer(aircraft), settings, 3, RATE_HZ),
        aircraft,
        GivenCommands(task, np.deg2rad(STEP_DEG_S) * np.eye(3)),
        episodes=3,
        seed=0,
        control_rate_hz=RATE_HZ,
        throttle=throttle,
        idle=settings.idle,
        mix=settings.mix,
        gyro_filters=settings.gyro_filters,
    )
    start = round(task.idle_s * RATE_HZ)
    stepped = np.stack([flights.rate[axis, start:, axis] for axis in range(3)])
    t = 1e3 * flights.step_s * np.arange(stepped.shape[1], dtype=np.float64)
    return t, np.rad2deg(stepped.astype(np.float64))


def _draw_search(panel: Axes, tuning: PidTuning, limits: Limits) -> None:
    """Draw the MAE of every candidate, and the least so far among those within the limits."""
    mae = np.array([trial.mae for trial in tuning.trials])
    kept = np.array([_keeps(trial, limits) for trial in tuning.trials], bool)
    number = np.arange(1, len(mae) + 1)
    panel.scatter(number[~kept], mae[~kept], s=7, color=OUTSIDE, lw=0, label="exceeds a limit")
    panel.scatter(number[kept], mae[kept], s=7, color=BEST_COLOUR, lw=0, label="candidate")
    if kept.any():
        best = np.minimum.accumulate(np.where(kept, mae, np.inf))
        panel.plot(number, best, color=INK, lw=1.2, label="least so far")
        panel.set_ylim(0.9 * mae[kept].min(), 8 * mae[kept].min())
    panel.set_yscale("log")
    log_numbers(panel.yaxis)
    dress(panel, "search")
    panel.set_xlabel("candidate", color=INK)
    panel.set_ylabel("MAE, deg/s", color=INK)
    panel.set_xlim(0, len(mae) + 1)
    panel.legend(loc="upper right", fontsize=9, facecolor="white", edgecolor=GRID, markerscale=2)


def _draw_limit(panel: Axes, tuning: PidTuning, limits: Limits) -> None:
    """Draw the MAE of the candidates against the change of their outputs."""
    kept = [trial for trial in tuning.trials if _keeps(trial, limits)]
    outside = [trial for trial in tuning.trials if not _keeps(trial, limits)]
    for trials, colour in ((outside, OUTSIDE), (kept, BEST_COLOUR)):
        x, y = [1e2 * trial.change for trial in trials], [trial.mae for trial in trials]
        panel.scatter(x, y, s=7, color=colour, lw=0)
    best = tuning.best
    panel.scatter([1e2 * best.change], [best.mae], s=60, facecolor="none", edgecolor=INK, lw=1.4, zorder=4)
    panel.axvline(1e2 * limits.change, color=INK, lw=1.0, ls=(0, (4, 2)))
    panel.set_yscale("log")
    panel.set_ylim(0.9 * best.mae, 8 * best.mae)
    panel.set_xlim(0, 2e2 * limits.change)
    log_numbers(panel.yaxis)
    dress(panel, "MAE against |Δu|; dashed: its limit")
    of = "motor values" if limits.of_motors else "outputs"
    panel.set_xlabel(f"mean |Δu| of the {of} in 1 ms, % of the range", color=INK)


def _keeps(trial: Trial[PidSettings], limits: Limits) -> bool:
    return trial.output <= limits.output and trial.change <= limits.change
