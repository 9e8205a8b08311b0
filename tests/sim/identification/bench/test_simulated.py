"""The simulated sensor of the bench: what its calibration and its counts find beside the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.identification.bench import simulated
from neuroflight.sim.identification.bench.simulated import (
    CELLS,
    Measured,
    Noise,
    calibrated,
    measured,
    scale_errors,
    speed_found,
)
from neuroflight.sim.identification.dyno.bench import RAMP, Phase, duration, sample_times, steps, steps_held

NF1 = load_aircraft("nf1").propulsion


def measure(experiment: tuple[Phase, ...], noise: Noise, seed: int = 1) -> Measured:
    rng = np.random.default_rng(seed)
    rig = calibrated(NF1, noise, rng)
    return measured(NF1, experiment, sample_times(duration(experiment), 250.0), rig, noise, rng)


def test_scales_are_found_within_their_cells_bend_when_nothing_disturbs() -> None:
    rig = calibrated(NF1, Noise(), np.random.default_rng(0))
    assert set(rig.cells) == set(CELLS)
    for name, error in scale_errors(rig.cells).items():
        assert 0.0 < abs(error) < 2 * simulated.BEND, name
    thrust, left = rig.cells["thrust_raw"], rig.cells["torque_left_raw"]
    assert (thrust.loads, left.loads) == (21, 13), "each mass, and none before and after it"
    assert thrust.load_max == pytest.approx(2.0 * 9.80665)
    assert left.load_max == pytest.approx(0.6 * 9.80665 * 0.13)
    assert left.scale > 0.0 > rig.cells["torque_right_raw"].scale


def test_a_scale_that_is_wrong_shows_when_it_is_held_against_the_truth() -> None:
    rig = calibrated(NF1, Noise(), np.random.default_rng(0))
    off = {**rig.cells, "thrust_raw": replace(rig.cells["thrust_raw"], scale=1.02 / 21_000.0)}
    assert scale_errors(off)["thrust_raw"] == pytest.approx(0.02)


def test_hysteresis_shows_in_the_calibration_and_not_in_the_zero_of_a_run() -> None:
    cell = calibrated(NF1, Noise(), np.random.default_rng(0)).cells["thrust_raw"]
    assert cell.hysteresis == pytest.approx(simulated.HYSTERESIS * cell.load_max, rel=0.01)
    found = measure(steps_held(1.0), Noise()).found
    assert np.median(found.thrust[found.time < 0.9]) == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("noise", [Noise(), Noise(0.02), Noise(0.02, of_reading=True)])
def test_a_run_is_what_it_was_within_its_sensors_when_it_has_steps_or_a_ramp(noise: Noise) -> None:
    for experiment in (steps_held(1.0), RAMP):
        one = measure(experiment, noise)
        assert len(one.found.time) == len(one.true.time)
        late = one.found.time - one.true.time
        assert late == pytest.approx(late[0], abs=1e-4) and 0.0 <= late[0] < 0.001, "the clocks are one"
        top = one.true.throttle > 0.9
        settled = slice(-100, -10)
        for name, close in (("speed", 0.001), ("thrust", 0.01), ("torque", 0.01)):
            found, true = (getattr(run, name)[top][settled].mean() for run in (one.found, one.true))
            assert found == pytest.approx(true, rel=close), name


def test_settled_speed_from_pulses_is_the_true_one_and_one_blade_more_would_show() -> None:
    one = measure(RAMP, Noise())
    good = speed_found([one])
    assert abs(good.mean) < 1e-4 and good.rms < 3e-4 and good.rms <= good.largest < 0.01
    wrong = Measured(replace(one.found, speed=one.found.speed * 4 / 3), one.true)
    assert speed_found([wrong]).mean > 0.1


def test_figures_of_a_step_are_those_of_the_rotor_when_levels_are_held_for_one_second() -> None:
    one = measure(steps_held(1.0), Noise(0.01))
    for found, true in zip(steps(one.found), steps(one.true), strict=True):
        assert found.speed == pytest.approx(true.speed, rel=1e-3)
        assert found.rise == pytest.approx(true.rise, abs=0.02)
        assert found.thrust == pytest.approx(true.thrust, rel=0.02)


def test_slips_of_the_logger_pass_through_the_cells_when_asked_for() -> None:
    one = measure(steps_held(1.0), Noise(outliers=0.02))
    off = np.abs(one.found.thrust - one.true.thrust) > 0.5
    assert off.mean() == pytest.approx(0.02, abs=0.01)
