"""Evaluation of flights whose figures are known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.aircraft.model import load_aircraft
from sim.control.pid import aircraft_pid, pid_settings
from training.evaluation.evaluation import figures, record
from training.tasks.task import EnvelopeTask, EpisodicTask, PulseTask

NF1 = load_aircraft("nf1")


class Still:
    """The same small constant for every motor: the aircraft never turns."""

    def __init__(self, count: int) -> None:
        self.action = np.full((count, 4), 0.25, np.float32)
        self.seen: list[NDArray[np.float32]] = []

    def reset(self) -> None:
        self.seen.clear()

    def step(
        self, setpoint: NDArray[np.float32], gyro: NDArray[np.float32], throttle: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        self.seen.append(setpoint.copy())
        return self.action


def test_errors_are_the_commands_when_nothing_turns() -> None:
    controller = Still(20)
    result = figures(
        record(controller, NF1, PulseTask(), episodes=20, seed=4, control_rate_hz=1000, noise=False)
    )
    setpoints = np.rad2deg(np.array(controller.seen))
    commands = np.abs(setpoints[1000])
    assert commands.std() > 20
    assert result.tracking.mae == pytest.approx(commands.mean(axis=0) * 2.0 / 4.5, rel=1e-4)
    assert result.tracking.mse == pytest.approx((commands**2).mean(axis=0) * 2.0 / 4.5, rel=1e-4)
    assert result.worst_mae == pytest.approx(commands.max() * 2.0 / 4.5, rel=1e-4)
    assert result.effort.output == pytest.approx(0.25)
    assert result.effort.change == 0.0


def test_every_controller_flies_the_same_commands_when_the_seed_is_the_same() -> None:
    task = PulseTask(idle_s=0.01, command_s=0.02, rest_s=0.01)
    seen = []
    for seed in (1, 1, 2):
        controller = Still(3)
        figures(record(controller, NF1, task, episodes=3, seed=seed, control_rate_hz=1000))
        seen.append(np.array(controller.seen))
    assert np.array_equal(seen[0], seen[1])
    assert not np.array_equal(seen[0], seen[2])


def test_the_pid_tracks_an_order_better_than_standing_still() -> None:
    idle = pid_settings(NF1).idle
    pid = figures(
        record(aircraft_pid(NF1, 10), NF1, PulseTask(), episodes=10, seed=5, control_rate_hz=1000, idle=idle)
    )
    still = figures(record(Still(10), NF1, PulseTask(), episodes=10, seed=5, control_rate_hz=1000))
    assert pid.tracking.mae.mean() < 0.2 * still.tracking.mae.mean()


def test_progress_counts_every_step() -> None:
    task = PulseTask(idle_s=0.01, command_s=0.01, rest_s=0.01)
    calls: list[tuple[int, int]] = []
    figures(
        record(
            Still(2),
            NF1,
            task,
            episodes=2,
            seed=1,
            control_rate_hz=1000,
            progress=lambda done, total: calls.append((done, total)),
        )
    )
    assert calls == [(k, 30) for k in range(1, 31)]


def test_success_is_complete_when_the_pid_flies_and_rare_when_nothing_turns() -> None:
    task = EpisodicTask()
    controller, idle = aircraft_pid(NF1, 12), pid_settings(NF1).idle
    pid = figures(record(controller, NF1, task, episodes=12, seed=3, control_rate_hz=1000, idle=idle))
    still = figures(record(Still(12), NF1, task, episodes=12, seed=3, control_rate_hz=1000))
    assert pid.response is not None
    assert still.response is not None
    assert pid.response.success.value.tolist() == [1.0, 1.0, 1.0]
    assert still.response.success.value.max() < 0.2
    assert still.response.failure.value == pytest.approx([100.0] * 3, abs=0.1)
    assert still.response.rise_ms.count.tolist() == [0, 0, 0]


def test_a_task_without_held_commands_has_no_response() -> None:
    task = PulseTask(idle_s=0.01, command_s=0.02, rest_s=0.01)
    assert figures(record(Still(2), NF1, task, episodes=2, seed=1, control_rate_hz=1000)).response is None


def test_margin_shrinks_when_there_are_more_episodes() -> None:
    task = EnvelopeTask()
    few, many = (
        figures(record(Still(count), NF1, task, episodes=count, seed=2, control_rate_hz=1000))
        for count in (40, 640)
    )
    assert few.tracking_margin.mae == pytest.approx(4 * many.tracking_margin.mae, rel=0.35)


def test_figures_are_of_every_flight_when_there_are_many() -> None:
    task = PulseTask(idle_s=0.0, command_s=1.0, rest_s=0.0)
    flown = record(Still(600), NF1, task, episodes=600, seed=2, control_rate_hz=500, noise=False)
    assert flown.rate.shape == (600, 500, 3)
    assert flown.output.shape == (600, 500, 4)
    result = figures(flown)
    assert result.tracking.mae == pytest.approx(
        np.rad2deg(np.abs(flown.setpoint.astype(np.float64))).mean(axis=(0, 1)), rel=1e-4
    )
    assert result.effort_margin.output == pytest.approx(0.0, abs=1e-12)
