"""The choice of a checkpoint, in one run and among several, and the plot of the monitor."""

import json
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.plotting import png
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.checkpoints.metrics import CheckpointMetrics, Spread
from neuroflight.training.checkpoints.monitor_plot import Monitored, draw_monitored, read_monitor
from neuroflight.training.config.selection import SelectionLimits
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.runs.checkpoint import MonitorState
from neuroflight.training.runs.seeds import best_seed, plan

LIMITS = SelectionLimits(output=0.1, change=0.01)


def metrics(steps: int, mae: float, output: float = 0.05, change: float = 0.005) -> CheckpointMetrics:
    """Metrics with these means."""
    means = (mae, 10 * mae, output, change, -mae)
    return CheckpointMetrics(steps, *(Spread(mean, mean - 1.0, mean + 1.0) for mean in means))


@pytest.mark.parametrize(
    ("history", "chosen"),
    [
        ([metrics(1, 3.0), metrics(2, 2.0), metrics(3, 2.5)], 2),  # least MAE
        ([metrics(1, 3.0), metrics(2, 1.0, output=0.11)], 1),  # a limit counts more than any MAE
        ([metrics(1, 3.0), metrics(2, 1.0, change=0.011)], 1),
        ([metrics(1, 1.0, output=0.11), metrics(2, 9.0)], 2),
        ([metrics(1, 3.0, output=0.1, change=0.01), metrics(2, 3.5)], 1),  # at a limit is within it
        ([metrics(1, 4.0, output=0.2), metrics(2, 3.0, output=0.3)], 1),  # none within: 8 against 9
        ([metrics(1, 4.0, output=0.2), metrics(2, 3.0, output=0.2, change=0.02)], 1),  # 8 against 12
        ([metrics(1, 2.0), metrics(2, 2.0)], 1),  # of equals the earlier
    ],
)
def test_the_rule_chooses_among_checkpoints(history: list[CheckpointMetrics], chosen: int) -> None:
    state = MonitorState()
    for item in history:
        state = state.submitted(item.steps, {}).collected(item, LIMITS)
    assert state.best is not None
    assert state.best.steps == chosen
    assert state.history == tuple(history)
    assert state.pending == ()


def test_the_rule_chooses_among_seeds_the_first_of_equals() -> None:
    assert best_seed({4: metrics(9, 2.0), 5: metrics(7, 1.0), 6: metrics(8, 1.0)}, LIMITS) == 5
    assert best_seed({4: metrics(9, 2.0), 5: metrics(7, 1.0, output=0.2)}, LIMITS) == 4


def test_metrics_are_equal_after_json() -> None:
    before = metrics(5, 1.0 / 3.0)
    assert CheckpointMetrics.of(json.loads(json.dumps(before.document()))) == before


@pytest.mark.parametrize(
    "text", ["", "[]", '{"seed": 1}', '{"seed": 1, "readings": [{"steps": 3}]}', "{" * 5000]
)
def test_a_damaged_monitor_is_rejected_in_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "monitor.json"
    path.write_text(text)
    with pytest.raises(TrainingError, match=r"monitor\.json is no record of a monitor") as caught:
        read_monitor(path)
    assert "\n" not in str(caught.value)


def test_the_plot_has_a_panel_a_figure_and_marks_what_was_chosen() -> None:
    runs = [
        Monitored("seed 1", (metrics(1000, 3.0), metrics(2000, 2.0)), 2000, 0.1, 0.01),
        Monitored("seed 2", (metrics(1000, 4.0),), 1000, 0.1, 0.01),
        Monitored("seed 3", (), None, 0.1, 0.01),
    ]
    figure = draw_monitored(runs, "seed 1", "three seeds")
    assert len(figure.axes) == 4
    tracking = figure.axes[0]
    assert [np.asarray(line.get_xdata()).tolist() for line in tracking.lines] == [[1.0, 2.0], [1.0]]
    offsets = [np.asarray(mark.get_offsets()).tolist() for mark in tracking.collections]
    assert [[2.0, 2.0]] in offsets
    assert [[1.0, 4.0]] in offsets
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "seed 1",
        "seed 2",
        "policy.onnx",
        "chosen of its seed",
    ]
    assert png(figure).startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="no readings"):
        draw_monitored(runs[2:], "seed 3", "nothing")


def test_several_seeds_are_planned_into_folders_of_their_own(tmp_path: Path) -> None:
    config = TrainingConfig(seed=7)
    planned = plan(load_aircraft("nf1"), config, tmp_path, 3, resume=False, force=False)
    assert [item.config.seed for item in planned] == [7, 8, 9]
    assert [item.out.name for item in planned] == ["seed-7", "seed-8", "seed-9"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("seeds", "seed", "resume", "message"),
    [
        (0, 1, False, "0 seeds, expected 1 to 100"),
        (2, 2**32 - 1, False, "expected the last to be at most 4294967295"),
        (2, 1, True, "nothing to resume"),
        (1, 1, True, "nothing to resume"),
    ],
)
def test_an_invalid_plan_is_rejected(
    seeds: int, seed: int, resume: bool, message: str, tmp_path: Path
) -> None:
    with pytest.raises(TrainingError, match=message):
        plan(load_aircraft("nf1"), TrainingConfig(seed=seed), tmp_path, seeds, resume=resume, force=False)


def test_an_existing_seed_is_not_replaced_without_force(tmp_path: Path) -> None:
    (tmp_path / "seed-2").mkdir()
    (tmp_path / "seed-2" / "checkpoint.pt").write_bytes(b"kept")
    with pytest.raises(TrainingError, match="seed-2 already holds a checkpoint"):
        plan(load_aircraft("nf1"), TrainingConfig(seed=1), tmp_path, 3, resume=False, force=False)
    assert len(plan(load_aircraft("nf1"), TrainingConfig(seed=1), tmp_path, 3, resume=False, force=True)) == 3
