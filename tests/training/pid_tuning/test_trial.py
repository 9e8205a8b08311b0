"""Trial flights of a PID tuning: commands and throttles, and what the figures are of."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest

from sim.aircraft.model import PidSettings, load_aircraft
from sim.analysis.metrics import effort, tracking
from sim.control.motors import motor_commands
from sim.control.pid import Pid, mixer, pid_settings
from toolchain.contract import Mix
from training.evaluation.evaluation import record
from training.pid_tuning.trial import (
    Limits,
    Loop,
    Pulses,
    Trials,
    held_commands,
    motor_values,
    throttles,
    training_commands,
)
from training.pid_tuning.ultimate_gain import Steps
from training.tasks.task import PulseTask

NF1 = load_aircraft("nf1")
SETTINGS = replace(
    pid_settings(NF1, "tuned"), idle=0.05, tpa_rate=0.0, mix=Mix.CENTRED, gyro_mean=True, nominal_voltage=None
)
COMMANDS = np.deg2rad([[60.0, -40.0, 30.0], [-80.0, 50.0, -20.0]])
THROTTLE = np.array([0.2, 0.6], np.float32)


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


@pytest.mark.parametrize("of_motors", [False, True])
def test_figures_are_those_of_its_evaluation_when_a_candidate_flies_with_mix_mean_and_throttle(
    of_motors: bool,
) -> None:
    loop = Loop(1000, Mix.CENTRED, gyro_mean=True, throttle_max=0.8)
    limits = Limits(0.12, 0.5, 0.05, of_motors)
    (trial,) = Trials(NF1, loop, limits, 4, COMMANDS, THROTTLE).fly([SETTINGS])

    def flown(task: Pulses | Steps, throttle: np.ndarray | float, count: int) -> tuple[np.ndarray, ...]:
        pid = Pid(mixer(NF1), SETTINGS, count, 1000)
        flights = record(
            pid,
            NF1,
            task,
            episodes=count,
            seed=4,
            control_rate_hz=1000,
            throttle=throttle,
            idle=SETTINGS.idle,
            mix=Mix.CENTRED,
            gyro_mean=True,
        )
        return flights.setpoint, flights.rate, flights.output

    setpoint, rate, output = flown(Pulses(COMMANDS, PulseTask()), THROTTLE, 2)
    assert trial.mae == pytest.approx(tracking(setpoint, rate, 1e-3).mae.mean(), rel=1e-3)
    assert trial.output == pytest.approx(effort(output, 1e-3).output, rel=1e-3)
    motors = motor_values(output, THROTTLE, SETTINGS.idle, Mix.CENTRED)
    changed = effort(motors if of_motors else output, 1e-3).change
    assert trial.change == pytest.approx(changed, rel=1e-3)
    assert effort(motors, 1e-3).change < 0.97 * effort(output, 1e-3).change, "one is not the other"
    held = held_commands()
    setpoint, rate, _ = flown(Steps(held, 1.0), 0.4, len(held))
    worst = np.rad2deg(np.abs(setpoint - rate)[:, -200:].max(axis=1))
    band = np.maximum(0.1 * np.abs(np.rad2deg(held)), 5.0)
    assert trial.held == pytest.approx((worst / (0.8 * band) - 1).clip(0, 1).mean(), abs=1e-3)


def test_motor_values_are_what_the_escs_get_but_for_the_rounding() -> None:
    output = np.random.default_rng(3).uniform(0, 1, (2, 5, 4)).astype(np.float32)
    for mix in Mix:
        values = motor_values(output, THROTTLE, 0.1, mix)
        each = [motor_commands(y, np.full(5, t), 0.1, mix) for y, t in zip(output, THROTTLE, strict=True)]
        assert values == pytest.approx(np.stack(each), abs=3e-4)


def test_quick_flights_have_the_noise_of_the_mean_at_the_control_rate() -> None:
    loop = Loop(1000, Mix.CENTRED, gyro_mean=True, throttle_max=0.8)
    full = Trials(NF1, loop, Limits(0.12, 0.0045, 0.05, of_motors=True), 4, COMMANDS, THROTTLE)
    quick = full.quick()
    assert quick.aircraft.gyro.noise == pytest.approx(np.array(NF1.gyro.noise) / 2)
    assert quick.loop == replace(loop, gyro_mean=False)
    (near,), (true,) = quick.fly([SETTINGS]), full.fly([SETTINGS])
    assert near.mae == pytest.approx(true.mae, rel=0.1)
    assert near.change == pytest.approx(true.change, rel=0.1)
    single = replace(full, loop=replace(loop, gyro_mean=False))
    assert single.quick().aircraft.gyro.noise == NF1.gyro.noise


def test_each_candidate_has_its_own_idle_when_they_fly_together() -> None:
    limits, loop = Limits(0.12, 0.012, 0.2), Loop(1000)
    trials = Trials(NF1, loop, limits, 4, COMMANDS, np.zeros(2, np.float32))
    plain: PidSettings = replace(SETTINGS, mix=Mix.ATTITUDE_FIRST, gyro_mean=False)
    low, high = trials.fly([plain, replace(plain, idle=0.2)])
    assert high.mae < 0.9 * low.mae, "rotors that turn answer sooner"
    assert high.change == pytest.approx(low.change, rel=0.01), "of the outputs, whatever the idle"
