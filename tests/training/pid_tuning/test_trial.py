"""Trial flights of a PID tuning by the dissertation's terms: commands, and what the figures are of."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import PidSettings, load_aircraft
from neuroflight.sim.analysis.metrics import effort, tracking
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.control.pid_table import mixer, pid_settings
from neuroflight.training.evaluation.evaluation import Flights, record
from neuroflight.training.pid_tuning.dissertation import DissertationTrials
from neuroflight.training.pid_tuning.trial import Limits, held_commands, throttles, training_commands
from neuroflight.training.tasks.task import EpisodicTask, GivenCommands, PulseTask

NF1 = load_aircraft("nf1")
SETTINGS: PidSettings = replace(
    pid_settings(NF1, "tuned"), idle=0.05, tpa_rate=0.0, tpa_breakpoint=0.0, nominal_voltage=None
)
COMMANDS = np.deg2rad([[60.0, -40.0, 30.0], [-80.0, 50.0, -20.0]])


def test_training_commands_are_stratified() -> None:
    commands = np.rad2deg(training_commands(20, np.random.default_rng(0)))
    parts = np.vectorize(NormalDist(0, 100).cdf)(np.sort(commands, axis=0))
    assert parts == pytest.approx(np.tile((np.arange(20)[:, None] + 0.5) / 20, 3))
    assert not np.array_equal(commands[:, 0], commands[:, 1])


def test_throttles_are_the_middles_of_equal_parts_in_any_order() -> None:
    drawn = throttles(8, 0.8, np.random.default_rng(0))
    assert drawn.dtype == np.float32
    assert np.sort(drawn) == pytest.approx(0.05 + 0.1 * np.arange(8))
    assert not np.array_equal(drawn, np.sort(drawn))
    assert not throttles(8, 0.0, np.random.default_rng(0)).any()


def test_figures_are_those_of_its_evaluation() -> None:
    (trial,) = DissertationTrials(NF1, Limits(0.12, 0.5, 0.05), 4, COMMANDS).fly([SETTINGS])

    def flown(task: GivenCommands, count: int) -> Flights:
        pid = Pid(mixer(NF1), SETTINGS, count, 1000)
        return record(pid, NF1, task, episodes=count, seed=4, control_rate_hz=1000, idle=SETTINGS.idle)

    flights = flown(GivenCommands(PulseTask(), COMMANDS), 2)
    assert trial.mae == pytest.approx(tracking(flights.setpoint, flights.rate, 1e-3).mae.mean(), rel=1e-3)
    assert trial.output == pytest.approx(effort(flights.output, 1e-3).output, rel=1e-3)
    assert trial.change == pytest.approx(effort(flights.output, 1e-3).change, rel=1e-3)
    held = held_commands()
    flights = flown(GivenCommands(EpisodicTask(), held), len(held))
    worst = np.rad2deg(np.abs(flights.setpoint - flights.rate)[:, -200:].max(axis=1))
    band = np.maximum(0.1 * np.abs(np.rad2deg(held)), 5.0)
    assert trial.held == pytest.approx((worst / (0.8 * band) - 1).clip(0, 1).mean(), abs=1e-3)


def test_each_candidate_has_its_own_idle_when_they_fly_together() -> None:
    trials = DissertationTrials(NF1, Limits(0.12, 0.012, 0.2), 4, COMMANDS)
    low, high = trials.fly([SETTINGS, replace(SETTINGS, idle=0.2)])
    assert high.mae < 0.9 * low.mae, "rotors that turn answer sooner"
    assert high.change == pytest.approx(low.change, rel=0.01), "of the outputs, whatever the idle"
