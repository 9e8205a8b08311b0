"""Flights of commands one after another, flown by controllers whose drift is known."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.pid import aircraft_pid
from neuroflight.sim.control.pid_table import pid_settings
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.evaluation.comparison import by_axis, differences, values
from neuroflight.training.evaluation.evaluation import Flights, record, scores
from neuroflight.training.tasks.flight import FlightTask, PilotTask
from neuroflight.training.tasks.sticks import OnSticks
from neuroflight.training.tasks.task import PulseTask

NF1 = load_aircraft("nf1")
RATE_HZ = 500
SHORT = FlightTask(pulses=5, idle_s=0.3, command_s=1.0, rest_s=0.9, hover_s=10.5)


class Deaf:
    """The aircraft's PID, with a gyro that says a constant less than the aircraft turns."""

    def __init__(self, count: int, roll_deg_s: float, *, after_s: float) -> None:
        self._pid = aircraft_pid(NF1, count, RATE_HZ, "flying")
        self._bias = np.deg2rad(np.array([roll_deg_s, 0.0, 0.0], np.float32))
        self._after, self._step = round(RATE_HZ * after_s), 0

    def reset(self) -> None:
        self._pid.reset()
        self._step = 0

    def step(
        self, setpoint: NDArray[np.float32], gyro: NDArray[np.float32], throttle: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        self._step += 1
        return self._pid.step(setpoint, gyro - self._bias * (self._step > self._after), throttle)


@cache
def fly(roll_deg_s: float, *, after_s: float = 0.0) -> Flights:
    settings = pid_settings(NF1, "flying")
    return record(
        Deaf(3, roll_deg_s, after_s=after_s),
        NF1,
        SHORT,
        episodes=3,
        seed=9,
        control_rate_hz=RATE_HZ,
        noise=False,
        throttle=0.3,
        idle=settings.idle,
        mix=settings.mix,
    )


def test_a_flight_has_the_commands_of_as_many_pulses_and_ends_with_a_hover() -> None:
    flights = FlightTask().episodes(3, np.random.default_rng(4), 1000)
    pulses = PulseTask().episodes(30, np.random.default_rng(4), 1000)
    assert flights.shape == (3, 60_000, 3)
    assert np.array_equal(flights[:, :45_000].reshape(30, 4500, 3), pulses)
    assert not flights[:, 45_000:].any()


@pytest.mark.parametrize(("length_s", "pulses"), [(20.0, 1), (60.0, 10), (61.0, 10), (600.0, 130)])
def test_a_longer_flight_has_more_pulses(length_s: float, pulses: int) -> None:
    task = FlightTask().of_length(length_s)
    assert task.pulses == pulses and task.duration_s == pytest.approx(length_s)
    assert task.hover_s >= 15.0


def test_a_pilots_minute_moves_as_hands_do_and_ends_with_centred_sticks() -> None:
    flown = np.rad2deg(PilotTask().episodes(2, np.random.default_rng(4), 500))
    assert flown.shape == (2, 37_500, 3)
    assert not flown[:, 30_000:].any()
    assert not np.array_equal(flown[0], flown[1])
    assert 150.0 < np.abs(flown).max() <= 1000.0
    changes = np.flatnonzero(np.diff(flown[0, :30_000], axis=0).any(axis=1)) + 1
    assert np.all(changes % 10 == 0)  # the receiver's 50 Hz
    assert len(changes) > 2900


@pytest.mark.slow
def test_a_pilots_flight_is_told_by_its_fifths(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--task", "pilot", "--sigma", "12", "--length", "5", "--episodes", "2", "--json"]
    assert main(["evaluate", "pid:tuned", *words]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["task"], told["episodes"], told["throttle"]) == ("pilot", 2, 0.3)
    assert len(told["holding"]["mae"]["value"]) == 5
    assert np.mean(told["holding"]["mae"]["value"]) == pytest.approx(np.mean(told["mae"]))
    assert told["response"] is None


def test_a_hover_too_short_for_the_drift_is_refused() -> None:
    with pytest.raises(TrainingError, match=r"hover_s 9\.0, expected 10 to 600"):
        FlightTask(hover_s=9.0)


def test_drift_and_late_rest_are_those_of_a_gyro_that_errs() -> None:
    """The PID holds what its gyro says: it turns by the error, in roll alone."""
    bias = 4.0
    flights = fly(bias)
    found = scores(flights).holding
    assert found is not None
    assert found.drift[:, 0] == pytest.approx(np.full(3, 10.0 * bias), rel=0.02)
    assert found.hover[:, 0] == pytest.approx(np.full(3, bias), rel=0.02)
    assert np.abs(found.drift[:, 1:]).max() < 1.0
    turned = Rotation.identity(3)
    for rate in flights.rate[:, -10 * RATE_HZ :].astype(np.float64).swapaxes(0, 1):
        turned = turned * Rotation.from_rotvec(rate * flights.step_s)
    assert found.drift == pytest.approx(np.rad2deg(turned.as_rotvec()), abs=0.3)


def test_the_rest_is_worse_late_than_early_when_the_gyro_errs_late() -> None:
    good, late = (scores(fly(bias, after_s=6.6)) for bias in (0.0, 4.0))
    rest = late.holding.rest[:, :, 0].mean(axis=0) if late.holding else np.empty(0)
    assert rest[:3].max() < 1.0
    assert rest[3:] == pytest.approx([4.0, 4.0], rel=0.05)
    assert late.holding is not None
    assert good.holding is not None
    more = (late.holding.mae - good.holding.mae)[:, :, 0].mean(axis=0)
    assert more[:3].tolist() == [0.0, 0.0, 0.0]
    assert more[4] > 2.0
    found = differences(good, late)
    assert found["drift"].low > 0.0
    assert found["rest_late"].low > 0.0
    assert found["rest_early"].value == pytest.approx(0.0, abs=1e-6)
    assert by_axis(late)["rest_late"].value[0] == pytest.approx(4.0, rel=0.05)


def test_a_flight_counts_once_however_many_commands_it_has() -> None:
    each = scores(fly(0.0))
    assert each.response is not None
    assert each.response.success.shape == (15, 3)
    assert {name: len(rows) for name, rows in values(each).items()} == dict.fromkeys(values(each), 3)
    peak = np.where(each.response.large, each.response.peak, np.nan).reshape(3, 5, 3)
    assert values(each)["peak"] == pytest.approx(np.nanmean(peak, axis=1))


def test_figures_of_commands_leave_the_hover_out() -> None:
    flights = fly(0.0)
    still = replace(flights, rate=flights.rate.copy())
    still.rate[:, -10 * RATE_HZ :] += 1.0
    before, after = scores(flights), scores(still)
    assert np.array_equal(before.tracking.mae, after.tracking.mae)
    assert before.holding is not None
    assert after.holding is not None
    assert np.abs(after.holding.drift - before.holding.drift) == pytest.approx(np.rad2deg(10.0), rel=1e-3)


def test_flights_are_told_behind_sticks_too() -> None:
    settings = pid_settings(NF1, "flying")
    task = OnSticks(replace(SHORT, pulses=1))
    flown = record(
        aircraft_pid(NF1, 1, name="flying"),
        NF1,
        task,
        episodes=1,
        seed=9,
        control_rate_hz=RATE_HZ,
        noise=False,
        throttle=0.3,
        idle=settings.idle,
        mix=settings.mix,
    )
    assert flown.course is not None
    assert scores(flown).holding is not None


def test_a_calm_pilots_commands_are_normal_of_the_sigma_and_for_the_time_asked_for() -> None:
    flown = np.rad2deg(
        PilotTask(length_s=124.0, sigma_deg_s=12.4).episodes(20, np.random.default_rng(4), 500)
    )
    assert flown.shape == (20, 69_500, 3)
    sticks = flown[:, :62_000]
    assert not flown[:, 62_000:].any() and sticks[:, -50:].any()
    assert sticks.std(axis=(0, 1)) == pytest.approx([12.4] * 3, rel=0.05)
    # Normal: 68.3 % within one sigma, 95.4 % within two.
    within = [(np.abs(sticks) < sigmas * 12.4).mean() for sigmas in (1.0, 2.0)]
    assert within == pytest.approx([0.683, 0.954], abs=0.01)
    with pytest.raises(TrainingError, match="length_s 124, expected 60: a freestyle is a minute"):
        PilotTask(length_s=124.0)
