"""Plans, what stands in a folder, and runs that become one recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.identification.bench.plan import (
    BenchPlan,
    begin_folder,
    check_folder,
    joined,
    missing_runs,
    recording_file,
)
from neuroflight.sim.identification.bench.summary import figure, peak, repeats, step_figures
from neuroflight.sim.identification.dyno.bench import (
    KINDS,
    disturbed,
    duration,
    run,
    sample_times,
    throttle_at,
)
from neuroflight.sim.identification.dyno.recording import Recording, read_recordings, write_recording
from neuroflight.toolchain.errors import DynoError

PLAN = BenchPlan(KINDS, 3, 0.8, 1.0, 40.0, 1, 3, 0.02, ("time_us", "thrust_n"), {})


def measured(plan: BenchPlan, kind: str, seed: int, noise: float = 0.02) -> Recording:
    experiment = plan.experiment(kind)
    time = sample_times(duration(experiment), 200.0)
    clean = run(load_aircraft("nf1").propulsion, experiment, time)
    return disturbed(clean, np.random.default_rng(seed), noise=noise)


def test_experiments_are_the_dissertations_when_nothing_else_is_asked_for() -> None:
    full = replace(PLAN, limit=1.0)
    steps, ramp = (full.experiment(kind) for kind in KINDS)
    assert [phase.first for phase in steps if phase.first] == [0.25, 0.5, 0.75, 1.0]
    assert {phase.duration for phase in steps} == {1.0}
    assert throttle_at(np.array([0.5, 1.0, 11.0, 21.0, 31.0, 41.5]), ramp) == pytest.approx(
        [0, 0, 0.5, 1, 0.5, 0]
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("limit", [0.1, 0.3, 0.5, 0.7, 1.0])
def test_no_command_is_above_the_limit_and_both_ends_are_at_rest(kind: str, limit: float) -> None:
    experiment = replace(PLAN, limit=limit).experiment(kind)
    throttle = throttle_at(np.arange(0.0, duration(experiment) + 1.0, 0.001), experiment)
    assert throttle.max() <= limit and throttle.min() >= 0.0
    assert throttle[0] == throttle[-1] == throttle_at(np.array(1e9), experiment) == 0.0


def test_experiments_take_turns_and_only_what_lacks_is_made(tmp_path: Path) -> None:
    names = [item.name for item in PLAN.runs()]
    assert names == ["steps-01", "ramp-01", "steps-02", "ramp-02", "steps-03", "ramp-03"]
    begin_folder(PLAN, tmp_path)
    write_recording(recording_file(tmp_path, PLAN.runs()[2]), measured(PLAN, "steps", 0))
    assert [item.name for item in missing_runs(PLAN, tmp_path)] == [*names[:2], *names[3:]]
    check_folder(replace(PLAN, repeats=20), tmp_path, resume=True)
    for change in ({"limit": 0.7}, {"motor": 2}, {"blades": 2}, {"columns": ("rpm",)}, {"window_s": 0.04}):
        with pytest.raises(DynoError, match=f"{next(iter(change))} was"):
            check_folder(replace(PLAN, **change), tmp_path, resume=True)  # type: ignore[arg-type]


@pytest.mark.parametrize("text", ["", "[]", "{", "\xff", "x" * 70_000])
def test_a_damaged_plan_is_one_line_when_it_is_resumed(tmp_path: Path, text: str) -> None:
    (tmp_path / "plan.json").write_text(text, "latin-1")
    with pytest.raises(DynoError, match="damaged"):
        check_folder(PLAN, tmp_path, resume=True)


def test_runs_stay_apart_when_they_are_joined_and_written(tmp_path: Path) -> None:
    recordings = [measured(PLAN, "steps", seed) for seed in range(3)]
    whole = joined(recordings)
    write_recording(tmp_path / "a.csv", whole)
    again = read_recordings([tmp_path / "a.csv"])
    assert again.starts == whole.starts == (0, 1800, 3600)
    assert again.thrust[3600:] == pytest.approx(recordings[2].thrust, abs=1e-5)


def test_intervals_hold_the_truth_in_95_of_100_experiments() -> None:
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(1000):
        found = figure(list(rng.normal(5.0, 2.0, 6)))
        held += abs(found.mean - 5.0) <= found.margin
    assert 930 <= held <= 970


def test_figures_of_repeats_stand_beside_each_level() -> None:
    figures = step_figures([measured(PLAN, "steps", seed) for seed in range(4)])
    assert [item.level for item in figures] == pytest.approx([0.2, 0.4, 0.6, 0.8])
    assert all(item.count == 4 and item.rpm.margin > 0 for item in figures)
    top = peak([measured(PLAN, "ramp", seed) for seed in range(3)])
    clean = peak([measured(PLAN, "ramp", 0, noise=0.0)])
    assert top.thrust_n.mean == pytest.approx(clean.thrust_n.mean, rel=0.01)
    assert clean.thrust_n.mean == pytest.approx(figures[-1].thrust_n.mean, rel=0.015)
    assert clean.rpm.margin == 0.0


def test_repeats_in_one_recording_are_told_by_their_kind_and_one_run_has_none() -> None:
    runs = [measured(PLAN, kind, seed) for seed in range(3) for kind in KINDS]
    found = repeats(joined(runs))
    assert found is not None and found.runs == 6
    assert [(item.level, item.count) for item in found.steps] == [(0.2, 3), (0.4, 3), (0.6, 3), (0.8, 3)]
    assert found.ramp_top == peak(runs[1::2]), "no step counts as a ramp"
    assert found.ramp_top.thrust_coefficient.mean == pytest.approx(9.37e-7, rel=0.01)
    assert found.ramp_top.torque_ratio_m.mean == pytest.approx(8.64e-3, rel=0.01)
    assert 0.0 < found.ramp_top.thrust_coefficient.margin < 1e-8
    assert repeats(joined(runs[:1])) is None
    stepped = repeats(joined(runs[::2]))
    assert stepped is not None and stepped.ramp_top is None


def test_a_sensor_that_shows_nothing_gives_no_constant_and_no_error() -> None:
    ramp = measured(PLAN, "ramp", 0)
    top = peak([replace(ramp, thrust=np.zeros_like(ramp.thrust))])
    assert top.thrust_coefficient.mean == 0.0 and top.torque_ratio_m.mean == 0.0
