"""Evaluation of flights whose figures are known."""

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.controller import PolicyController
from neuroflight.sim.control.pid import aircraft_pid
from neuroflight.sim.control.pid_table import pid_settings
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.ir.interpreter import advance, clear_state
from neuroflight.toolchain.passes import optimize
from neuroflight.toolchain.policy.gyro_filters import MEAN, UNFILTERED
from neuroflight.toolchain.policy.model import read_policy
from neuroflight.training.config.training_config import TrainingConfig, WorldConfig
from neuroflight.training.envs.simulation import AttitudeSimulation
from neuroflight.training.evaluation.controllers import Conditions, load_controller
from neuroflight.training.evaluation.evaluation import Flights, figures, record, scores
from neuroflight.training.tasks.task import EnvelopeTask, EpisodicTask, PulseTask
from tests.given_task import Given

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


def test_power_and_current_are_those_of_the_rotors_and_the_electronics() -> None:
    flights = record(Still(3), NF1, EpisodicTask(), episodes=3, seed=4, control_rate_hz=1000, noise=False)
    assert flights.motors is not None
    assert flights.power is not None
    assert NF1.battery is not None
    found, idle = scores(flights), NF1.battery.electronics_power
    speed = target_speed(flights.motors[:, -1], NF1.propulsion)
    shaft = (speed * thrust_and_torque(speed, NF1.propulsion)[1]).sum(axis=1)
    assert flights.power[:, 0] == pytest.approx([idle] * 3)
    assert flights.power[:, -1] == pytest.approx(shaft / NF1.propulsion.efficiency + idle, rel=1e-3)
    assert found.power == pytest.approx(flights.power.mean(axis=1), rel=1e-4)
    assert found.current == pytest.approx(flights.power.mean(axis=1) / 16.0, rel=1e-4)  # [V], the bench


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
    idle = pid_settings(NF1, "tuned").idle
    controller = aircraft_pid(NF1, 10, name="tuned")
    pid = figures(record(controller, NF1, PulseTask(), episodes=10, seed=5, control_rate_hz=1000, idle=idle))
    still = figures(record(Still(10), NF1, PulseTask(), episodes=10, seed=5, control_rate_hz=1000))
    assert pid.tracking.mae.mean() < 0.2 * still.tracking.mae.mean()


def test_success_is_complete_when_the_pid_flies_and_rare_when_nothing_turns() -> None:
    task = EpisodicTask()
    controller, idle = aircraft_pid(NF1, 12, name="tuned"), pid_settings(NF1, "tuned").idle
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


@pytest.mark.slow
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


SHORT = PulseTask(idle_s=0.05, command_s=0.2, rest_s=0.05)


def flown(policy: Path, **options: Any) -> Flights:
    """Short flights of three aircraft by the policy of the file, as it asks to be flown."""
    model = read_policy(policy)
    own = {"idle": model.idle, "mix": model.mix, "gyro_filters": model.gyro_filters}
    asked = {"throttle": 0.3, **own, **options}
    return record(PolicyController(model, 3), NF1, SHORT, episodes=3, seed=7, control_rate_hz=1000, **asked)


def test_a_flight_is_another_when_mix_or_filter_are(estimating_policy: Path) -> None:
    asked = flown(estimating_policy)
    for change in ({"mix": Mix.ATTITUDE_FIRST}, {"gyro_filters": UNFILTERED}):
        other = flown(estimating_policy, **change)
        assert np.array_equal(other.setpoint, asked.setpoint)
        assert not np.array_equal(other.output, asked.output)


def test_the_gyros_mean_is_less_noisy_than_one_sample() -> None:
    class Watching(Still):
        def __init__(self, count: int) -> None:
            super().__init__(count)
            self.gyro: list[NDArray[np.float32]] = []

        def step(
            self, setpoint: NDArray[np.float32], gyro: NDArray[np.float32], throttle: NDArray[np.float32]
        ) -> NDArray[np.float32]:
            self.gyro.append(gyro.copy())
            return super().step(setpoint, gyro, throttle)

    noise = []
    for mean in (False, True):
        controller = Watching(4)
        record(
            controller,
            NF1,
            SHORT,
            episodes=4,
            seed=1,
            control_rate_hz=1000,
            gyro_filters=MEAN if mean else UNFILTERED,
        )
        noise.append(float(np.std(np.diff(np.array(controller.gyro)[50:], axis=0))))
    assert noise[1] < 0.7 * noise[0]


def test_a_loaded_policy_flies_with_its_own_mix_filter_and_idle(estimating_policy: Path) -> None:
    controller = load_controller(str(estimating_policy), NF1)
    assert (controller.mix, controller.gyro_filters, controller.idle) == (Mix.CENTRED, MEAN, 0.055)
    conditions = Conditions(aircraft=NF1, task=SHORT, episodes=3, seed=7)
    seen = conditions.fly(controller, 0.3)
    assert np.abs(seen.rate - flown(estimating_policy).rate).max() < 0.05


def test_an_estimating_policy_flies_the_same_in_training_and_evaluation(estimating_policy: Path) -> None:
    model = read_policy(estimating_policy)
    evaluated = flown(estimating_policy, noise=False, throttle=0.0)
    config = TrainingConfig(
        observation=model.observation,
        idle=model.idle,
        mix=model.mix.text,
        gyro_filter="mean",
        task=Given(evaluated.setpoint),
        world=WorldConfig(noise=False),
    )
    network, _ = optimize(model.network)
    rates, outputs = [], []
    with closing(AttitudeSimulation(NF1, 3, config=config, rng=np.random.default_rng(7))) as simulation:
        observation, state = simulation.reset(), clear_state(network, 3)
        for _ in range(simulation.steps):
            rates.append(simulation.rate.copy())
            action, state = advance(network, observation, state, exact=True)
            outputs.append(action)
            observation = simulation.step(action).observation
    assert np.array(outputs).swapaxes(0, 1).tobytes() == evaluated.output.tobytes()
    assert np.array_equal(np.array(rates, np.float32).swapaxes(0, 1), evaluated.rate)
