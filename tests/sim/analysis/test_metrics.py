"""Figures against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.analysis.metrics import controller_output, effort, figures, tracking
from neuroflight.sim.control.motors import throttle_mix
from neuroflight.toolchain.contract import Mix
from tests.sim.flight.traces import trace_of

STEP_S = 0.001


def test_every_figure_has_its_closed_form_when_the_error_is_constant() -> None:
    error = np.array([1.0, -2.0, 5.0])  # deg/s
    steps, seconds = 2000, 2.0
    result = tracking(np.deg2rad(np.tile(error, (steps, 1))), np.zeros((steps, 3)), STEP_S)
    size, square = np.abs(error), error**2
    mean_t = (seconds - STEP_S) / 2
    assert result.mae == pytest.approx(size)
    assert result.mse == pytest.approx(square)
    assert result.iae == pytest.approx(1000 * size)
    assert result.ise == pytest.approx(1000 * square)
    assert result.itae == pytest.approx(1000 * size * mean_t)
    assert result.itse == pytest.approx(1000 * square * mean_t)


def test_figures_are_the_integrals_when_the_error_decays() -> None:
    # e = A exp(-t / tau): integrals A tau, A^2 tau / 2, A tau^2, A^2 tau^2 / 4 over a long episode T.
    amplitude, tau, seconds, step = 100.0, 0.05, 4.0, 1e-4
    t = np.arange(round(seconds / step)) * step
    rate = np.deg2rad(-amplitude * np.exp(-t / tau))[:, None] * np.ones(3)
    result = tracking(np.zeros_like(rate), rate, step)
    assert result.mae == pytest.approx(np.full(3, amplitude * tau / seconds), rel=2e-3)
    assert result.mse == pytest.approx(np.full(3, amplitude**2 * tau / 2 / seconds), rel=5e-3)
    assert result.itae == pytest.approx(np.full(3, 1000 * amplitude * tau**2 / seconds), rel=2e-3)
    assert result.itse == pytest.approx(np.full(3, 1000 * amplitude**2 * tau**2 / 4 / seconds), rel=2e-3)


def test_sums_stand_for_millisecond_samples_when_the_rate_is_another() -> None:
    coarse = tracking(np.ones((1000, 3)), np.zeros((1000, 3)), 0.001)
    fine = tracking(np.ones((4000, 3)), np.zeros((4000, 3)), 0.00025)
    assert fine.iae == pytest.approx(coarse.iae)
    assert fine.itae == pytest.approx(coarse.itae, rel=1e-3)


def test_episodes_are_independent_when_batched() -> None:
    rng = np.random.default_rng(1)
    setpoint, rate = rng.normal(size=(2, 4, 5, 300, 3))
    batched = tracking(setpoint, rate, STEP_S)
    assert batched.itse.shape == (4, 5, 3)
    assert batched.itse[2, 3] == pytest.approx(tracking(setpoint[2, 3], rate[2, 3], STEP_S).itse)
    assert batched.mean().mse == pytest.approx(np.rad2deg(np.rad2deg((setpoint - rate) ** 2)).mean((0, 1, 2)))


@pytest.mark.parametrize(
    ("first", "second"), [((5, 3), (4, 3)), ((5, 2), (5, 2)), ((3,), (3,)), ((0, 3), (0, 3))]
)
def test_tracking_refuses_when_shapes_do_not_fit(first: tuple[int, ...], second: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected equal"):
        tracking(np.zeros(first), np.zeros(second), STEP_S)


@pytest.mark.parametrize("idle", [0.0, 0.12])
def test_output_is_recovered_when_throttle_and_idle_were_mixed_in(idle: float) -> None:
    rng = np.random.default_rng(2)
    y = rng.uniform(0, 1, (1000, 4)).astype(np.float32)
    throttle = rng.uniform(0, 0.9, 1000).astype(np.float32)
    mixed = idle + (1 - idle) * throttle_mix(y, throttle).astype(np.float64)
    assert np.abs(controller_output(mixed, throttle, idle) - y).max() < 1e-5


def test_output_is_the_motors_when_the_throttle_is_low() -> None:
    motors = np.random.default_rng(3).uniform(0, 1, (10, 4))
    assert controller_output(motors, np.zeros(10)) == pytest.approx(motors)


def test_output_keeps_the_differences_when_the_throttle_is_full() -> None:
    y = np.array([[0.1, 0.2, 0.3, 0.4]], np.float32)
    recovered = controller_output(throttle_mix(y, np.ones(1, np.float32)), np.ones(1))
    assert np.diff(recovered) == pytest.approx(np.diff(y))


@pytest.mark.parametrize("mix", [Mix.CENTRED, None])
def test_output_is_the_motors_above_the_idle_when_the_mix_cannot_be_undone(mix: Mix | None) -> None:
    rng = np.random.default_rng(4)
    y, throttle = rng.random((50, 4), np.float32), rng.random(50, np.float32)
    u = throttle_mix(y, throttle, Mix.CENTRED).astype(np.float64)
    told = controller_output(0.055 + 0.945 * u, throttle, 0.055, mix)
    assert told == pytest.approx(u, abs=1e-12)
    assert told != pytest.approx(controller_output(0.055 + 0.945 * u, throttle, 0.055), abs=0.01)


def test_effort_has_its_closed_form_when_one_motor_of_four_alternates() -> None:
    y = np.zeros((1001, 4))
    y[1::2, 2] = 0.4
    result = effort(y, STEP_S)
    assert result.change == pytest.approx(0.1)
    assert result.output == pytest.approx(0.4 * 500 / 1001 / 4)


def test_effort_takes_changes_over_a_millisecond_when_the_rate_is_higher() -> None:
    ramp = np.linspace(0, 1, 4001)[:, None] * np.ones(4)  # 1 in one second
    assert effort(ramp, 0.00025).change == pytest.approx(0.001)


def test_figures_begin_each_episode_at_zero_when_a_flight_has_many() -> None:
    zeros = np.zeros((300, 3))
    trace = trace_of(zeros, zeros + np.deg2rad(2.0), zeros + np.deg2rad(3.0))
    whole, parts = figures(trace), figures(trace, episodes=3)
    assert whole.tracking.mae == pytest.approx(np.full(3, 2.0))
    assert parts.tracking.itae == pytest.approx(np.full(3, 2000 * 0.0495))
    assert whole.tracking.itae == pytest.approx(np.full(3, 2000 * 0.1495))
    assert parts.gyro_mae == pytest.approx(np.full(3, 3.0))
    assert (parts.effort.output, parts.effort.change) == (0.25, 0.0)
    assert parts.smoothness == pytest.approx(0.0, abs=1e-12)


def test_smoothness_is_the_mean_of_the_episodes_when_a_flight_has_many() -> None:
    zeros = np.zeros((3000, 3))
    flight = trace_of(zeros, zeros, zeros)
    t = np.arange(1000) / 1000
    flight.motors[:1000] += (0.1 * np.sin(2 * np.pi * 50 * t))[:, None]
    # 2 / (500 * 1000) * 0.1 * 50 in one of three
    assert figures(flight, episodes=3).smoothness == pytest.approx(2e-5 / 3)


def test_figures_refuse_when_the_episodes_do_not_divide_the_flight() -> None:
    with pytest.raises(ValueError, match="do not divide"):
        figures(trace_of(*np.zeros((3, 10, 3))), episodes=3)


def test_figures_include_the_response_when_a_flight_holds_its_commands() -> None:
    setpoint = np.zeros((2, 2000, 3))
    setpoint[0, 500:1500], setpoint[1, 500:1500] = np.deg2rad(100.0), np.deg2rad(-40.0)
    rate = setpoint.copy()
    rate[:, 500] = 0.0
    rate[1, 501:1500, 2] = 0.0  # does not answer
    trace = trace_of(*(array.reshape(-1, 3) for array in (setpoint, rate, rate)))
    judged = figures(trace, episodes=2).response
    assert judged is not None
    assert judged.success.value.tolist() == [1.0, 1.0, 0.5]
    assert judged.failure.value == pytest.approx([0.0, 0.0, 100.0])
    assert judged.rise_ms.count.tolist() == [2, 2, 1]


def test_figures_leave_the_response_out_when_no_command_is_held() -> None:
    assert figures(trace_of(*np.zeros((3, 900, 3)))).response is None
