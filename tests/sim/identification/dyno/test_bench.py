"""The simulated bench against the published rotor, and what noise and uneven rows do to its log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import RPM, load_aircraft
from neuroflight.sim.identification.dyno.bench import (
    EXPERIMENTS,
    RAMP,
    STEPS,
    disturbed,
    duration,
    run,
    sample_times,
    steps,
    throttle_at,
)

NF1 = load_aircraft("nf1").propulsion


def test_steps_show_the_bench_figures_of_the_nf1_when_driven_without_noise() -> None:
    recording = run(NF1, STEPS, sample_times(duration(STEPS), 500))
    shown = steps(recording)
    assert [step.level for step in shown] == [0.25, 0.5, 0.75, 1.0]
    full = shown[-1]
    assert full.rise == pytest.approx(0.21, abs=0.01)  # published
    assert full.speed / RPM == pytest.approx(25042, rel=0.005)  # measured by Koch 2019
    assert full.thrust == pytest.approx(9.37e-7 * full.speed**2)
    assert full.torque == pytest.approx(8.64e-3 * full.thrust)
    assert [step.rise for step in shown] == sorted(step.rise for step in shown)


def test_ramp_takes_forty_seconds_and_rises_and_falls_evenly() -> None:
    time = np.array([0.5, 1.0, 6.0, 21.0, 36.0, 41.0, 42.0, 99.0])
    assert throttle_at(time, RAMP) == pytest.approx([0.0, 0.0, 0.25, 1.0, 0.25, 0.0, 0.0, 0.0])


def test_all_experiments_follow_each_other_when_asked_for_together() -> None:
    assert duration(EXPERIMENTS["all"]) == duration(STEPS) + duration(RAMP)
    time = np.linspace(0.0, duration(RAMP), 300)
    together = throttle_at(time + duration(STEPS), EXPERIMENTS["all"])
    assert together == pytest.approx(throttle_at(time, RAMP), abs=1e-9)


def test_rotor_waits_for_the_delay_when_throttle_jumps() -> None:
    time = sample_times(duration(STEPS), 1000)
    late = run(replace(NF1, delay=0.006), STEPS, time)
    early = run(replace(NF1, delay=0.0), STEPS, time)
    assert late.throttle == pytest.approx(early.throttle)
    assert late.speed[6:] == pytest.approx(early.speed[:-6], rel=1e-9)


def test_noise_has_the_size_asked_for_when_it_is_of_full_scale_or_of_reading() -> None:
    true = run(NF1, STEPS, sample_times(duration(STEPS), 500))
    held = true.throttle == 0.25
    held[: np.flatnonzero(held)[500]] = False  # settled
    for of_reading, size in ((False, 0.02 * true.thrust.max()), (True, 0.02 * true.thrust[held].mean())):
        noisy = disturbed(true, np.random.default_rng(5), noise=0.02, of_reading=of_reading)
        assert np.std((noisy.thrust - true.thrust)[held]) == pytest.approx(size, rel=0.1)
    assert noisy.time is true.time and noisy.throttle is true.throttle


def test_outliers_hit_each_channel_on_its_own_when_asked_for() -> None:
    true = run(NF1, STEPS, sample_times(duration(STEPS), 500))
    wild = disturbed(true, np.random.default_rng(6), outliers=0.01)
    hits = [getattr(wild, name) != getattr(true, name) for name in ("speed", "thrust", "torque")]
    for hit in hits:
        assert hit.mean() == pytest.approx(0.01, abs=0.004)
    assert not np.array_equal(hits[0], hits[1])
    assert wild.speed.max() > 1.5 * true.speed.max()


def test_rows_rise_unevenly_and_some_are_lost_when_uneven() -> None:
    even = sample_times(10.0, 500)
    uneven = sample_times(10.0, 500, np.random.default_rng(7))
    assert np.diff(even) == pytest.approx(np.full(4999, 0.002))
    assert 0.92 * 5000 < len(uneven) < 0.98 * 5000
    assert np.diff(uneven).min() > 0.0
    assert np.std(np.diff(uneven)) > 0.0004


def test_steps_survive_slips_of_the_logger_when_there_are_outliers() -> None:
    true = run(NF1, STEPS, sample_times(duration(STEPS), 500))
    poor = disturbed(true, np.random.default_rng(8), noise=0.02, outliers=0.01)
    for shown, known in zip(steps(poor), steps(true), strict=True):
        assert shown.speed == pytest.approx(known.speed, rel=0.02)
        assert shown.thrust == pytest.approx(known.thrust, rel=0.02)
        assert shown.rise == pytest.approx(known.rise, abs=0.02)
