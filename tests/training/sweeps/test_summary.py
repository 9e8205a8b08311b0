"""Configurations averaged over seeds, their Pareto front, and the plot."""

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.plotting import png
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.sweeps.config import Trial, Validation
from neuroflight.training.sweeps.plot import draw_sweep
from neuroflight.training.sweeps.summary import Run, configurations, pareto
from neuroflight.training.sweeps.trial import Figure, Outcome

CONFIG = TrainingConfig()


def run(number: int, width: int, seed: int, mae: float, change: float, cycles: float | None = 100.0) -> Run:
    outcome = Outcome(
        mae=Figure(mae, 0.1),
        mse=Figure(100.0, 1.0),
        output=Figure(0.1, 0.01),
        change=Figure(change, 0.001),
        thrusts=(),
        instructions=None if cycles is None else 50,
        predicted_cycles=cycles,
        no_cycles_reason="no compiler" if cycles is None else None,
        weights=100,
        training_seconds=10.0,
        steps=1000,
        policy_sha256="0" * 64,
    )
    return Run(Trial(number, f"{number}", {"hidden": [width], "seed": seed}, CONFIG), outcome)


def test_front_is_what_no_point_dominates_when_points_tie_or_trade() -> None:
    points = np.array([[1.0, 3.0], [2.0, 2.0], [3.0, 1.0], [2.0, 3.0], [1.0, 3.0], [3.0, 3.0]])
    assert pareto(points).tolist() == [True, True, True, False, True, False]


def test_seeds_are_averaged_with_students_t_when_a_configuration_has_several() -> None:
    runs = [run(1, 8, 1, 1.0, 0.02), run(2, 16, 1, 5.0, 0.01), run(3, 8, 2, 3.0, 0.04)]
    narrow, wide = configurations(runs)
    assert narrow.varied == {"hidden": [8]}
    assert [item.trial.number for item in narrow.runs] == [1, 3]
    assert narrow.mae.mean == 2.0
    assert narrow.mae.margin == pytest.approx(12.706)  # of two values that differ by 2
    assert narrow.change.mean == pytest.approx(0.03)
    assert wide.mae == Figure(5.0, 0.1)  # one seed: the run's own, over its commands


def test_a_cheaper_network_is_on_the_front_when_it_is_worse_in_all_else() -> None:
    runs = [run(1, 64, 1, 1.0, 0.01, 900.0), run(2, 8, 1, 2.0, 0.02, 100.0), run(3, 32, 1, 2.0, 0.02, 500.0)]
    assert [found.front for found in configurations(runs)] == [True, True, False]
    unpriced = [run(1, 64, 1, 1.0, 0.01, None), run(2, 8, 1, 2.0, 0.02, None)]
    assert [found.front for found in configurations(unpriced)] == [True, False]


def test_runs_that_are_open_or_failed_are_left_out_when_configurations_are_formed() -> None:
    done = run(1, 8, 1, 1.0, 0.02)
    trial = Trial(2, "2", {"hidden": [8], "seed": 2}, CONFIG)
    (found,) = configurations([done, Run(trial), Run(trial, reason="diverged")])
    assert found.runs == (done,)
    assert configurations([Run(trial)]) == ()
    assert [Run(trial).state, Run(trial, reason="diverged").state, done.state] == ["open", "failed", "done"]


@pytest.mark.parametrize("cycles", [None, 100.0])
def test_picture_names_every_configuration_when_cycles_are_known_and_when_not(cycles: float | None) -> None:
    runs = [
        run(1, 8, 1, 1.0, 0.02, cycles),
        run(2, 8, 2, 20.0, 0.03, cycles),
        run(3, 32, 1, 2.0, 0.2, cycles),
    ]
    figure = draw_sweep(configurations(runs), "title", Validation())
    texts = {text.get_text() for axes in figure.axes for text in axes.texts}
    assert {"hidden [8]", "hidden [32]", "1", "2"} <= texts
    assert png(figure).startswith(b"\x89PNG")


def test_picture_is_drawn_when_there_are_more_configurations_than_lines(tmp_path: Path) -> None:
    runs = [run(n, n, 1, 1.0 + n, 0.5 / n, 100.0 * n) for n in range(1, 61)]
    figure = draw_sweep(configurations(runs), "title", Validation())
    assert "and 34 more, in sweep.json" in {text.get_text() for axes in figure.axes for text in axes.texts}
    (tmp_path / "many.png").write_bytes(png(figure))
