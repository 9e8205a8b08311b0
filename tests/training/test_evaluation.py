"""Evaluation against flights whose figures are known beforehand."""

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.aircraft import load_aircraft
from sim.pid import aircraft_pid
from training.evaluation import evaluate
from training.task import PulseTask

NF1 = load_aircraft("nf1")


class Still:
    """Asks every motor for the same small constant: the aircraft never turns."""

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
    result = evaluate(controller, NF1, episodes=20, seed=4, control_rate_hz=1000, noise=False)
    setpoints = np.rad2deg(np.array(controller.seen))
    commands = np.abs(setpoints[1000])
    assert commands.std() > 20
    assert result.tracking.mae == pytest.approx(commands.mean(axis=0) * 2.0 / 4.5, rel=1e-4)
    assert result.tracking.mse == pytest.approx((commands**2).mean(axis=0) * 2.0 / 4.5, rel=1e-4)
    assert result.worst_mae == pytest.approx(commands.max() * 2.0 / 4.5, rel=1e-4)
    assert result.effort.output == pytest.approx(0.25)
    assert result.effort.change == 0.0


def test_every_controller_meets_the_same_commands_when_the_seed_is_the_same() -> None:
    task = PulseTask(idle_s=0.01, command_s=0.02, rest_s=0.01)
    seen = []
    for seed in (1, 1, 2):
        controller = Still(3)
        evaluate(controller, NF1, episodes=3, seed=seed, control_rate_hz=1000, task=task)
        seen.append(np.array(controller.seen))
    assert np.array_equal(seen[0], seen[1])
    assert not np.array_equal(seen[0], seen[2])


def test_the_pid_tracks_an_order_better_than_standing_still() -> None:
    pid = evaluate(aircraft_pid(NF1, 10), NF1, episodes=10, seed=5, control_rate_hz=1000)
    still = evaluate(Still(10), NF1, episodes=10, seed=5, control_rate_hz=1000)
    assert pid.tracking.mae.mean() < 0.2 * still.tracking.mae.mean()


def test_progress_counts_every_step() -> None:
    task = PulseTask(idle_s=0.01, command_s=0.01, rest_s=0.01)
    calls: list[tuple[int, int]] = []
    evaluate(
        Still(2),
        NF1,
        episodes=2,
        seed=1,
        control_rate_hz=1000,
        task=task,
        progress=lambda done, total: calls.append((done, total)),
    )
    assert calls == [(k, 30) for k in range(1, 31)]
