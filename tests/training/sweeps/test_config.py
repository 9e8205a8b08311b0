"""Sweep files: their runs, and the errors of invalid ones."""

from pathlib import Path

import pytest

from neuroflight.toolchain.errors import NeuroflightError, TrainingError
from neuroflight.training.sweeps.config import TRIALS_MAX, Sweep, load_sweep


def load(folder: Path, text: str) -> Sweep:
    path = folder / "study.toml"
    path.write_text('aircraft = "nf1"\n' + text)
    return load_sweep(path)


def test_runs_are_all_points_of_the_grid_when_axes_are_lists(tmp_path: Path) -> None:
    sweep = load(tmp_path, "[set]\nsteps = 1000\n[vary]\nhidden = [[8, 8], [16]]\nseed = [1, 2, 3]\n")
    assert [(trial.config.hidden, trial.config.seed) for trial in sweep.trials] == [
        ((8, 8), 1),
        ((8, 8), 2),
        ((8, 8), 3),
        ((16,), 1),
        ((16,), 2),
        ((16,), 3),
    ]
    assert {trial.config.steps for trial in sweep.trials} == {1000}
    assert [trial.number for trial in sweep.trials] == [1, 2, 3, 4, 5, 6]
    assert sweep.trials[1].folder == "2-hidden-8-8-seed-2"
    assert sweep.trials[4].configuration == {"hidden": [16]}


def test_each_draw_is_combined_with_the_whole_grid_when_there_are_ranges(tmp_path: Path) -> None:
    text = (
        "samples = 4\nseed = 7\n[vary]\nseed = [1, 2]\n"
        "reward.output = {low = 0.1, high = 1.0, log = true}\n"
        "algorithm.epochs = {low = 2, high = 5, whole = true}\n"
    )
    sweep, again = load(tmp_path, text), load(tmp_path, text)
    assert len(sweep.trials) == 8
    outputs = [trial.varied["reward.output"] for trial in sweep.trials]
    assert outputs[0::2] == outputs[1::2]
    assert len(set(outputs)) == 4
    assert all(0.1 <= output <= 1.0 for output in outputs)
    assert {trial.varied["algorithm.epochs"] for trial in sweep.trials} <= {2, 3, 4, 5}
    assert again.trials == sweep.trials
    other = load(tmp_path, text.replace("seed = 7", "seed = 8"))
    assert [trial.varied["reward.output"] for trial in other.trials] != outputs


def test_whole_tables_vary_when_values_are_names_or_ranges_of_randomization(tmp_path: Path) -> None:
    sweep = load(
        tmp_path,
        "[vary]\nworld.randomization.mass = [[1.0, 1.0], [0.8, 1.25]]\ntask = ['pulse', 'envelope']\n",
    )
    assert [trial.config.world.randomization.mass for trial in sweep.trials] == [(1.0, 1.0)] * 2 + [
        (0.8, 1.25)
    ] * 2
    assert [trial.config.task.name for trial in sweep.trials] == ["pulse", "envelope"] * 2


def test_recipes_vary_and_files_are_found_beside_the_sweep_when_the_key_is_config(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text("hidden = [7]\n")
    sweep = load(tmp_path, "[vary]\nconfig = ['ppo', 'own.toml']\n")
    assert [trial.config.hidden for trial in sweep.trials] == [(64, 64), (7,)]
    assert [trial.folder for trial in sweep.trials] == ["1-config-ppo", "2-config-own"]


def test_folders_are_safe_names_when_values_are_not(tmp_path: Path) -> None:
    sweep = load(tmp_path, "[vary]\nobservation = ['rate_error,rate', 'rate~15Hz,rate_error@1']\n")
    assert [trial.folder for trial in sweep.trials] == [
        "1-observation-rate-error-rate",
        "2-observation-rate-15hz-rate-error-1",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "sweep study.toml: nothing varies"),
        ("[vary]\nseed = []\n", "vary.seed: expected a list of values, or a range"),
        ("[vary]\nseed = [1, 2, 1]\n", "vary.seed: has a value twice"),
        ("[vary]\nhiden = [[8]]\n", r"study.toml, run 1 \(hiden \[8\]\): .*hiden"),
        ("[vary]\nhidden = [[8], [0]]\n", r"study.toml, run 2 \(hidden \[0\]\): .*hidden layers \[0\]"),
        ("[vary]\nreward = ['traking']\n", "run 1 .*traking.* tracking"),
        ("[vary]\nworld.randomization.mass = [[0.8, 1.2], [2, 1]]\n", "run 2 .*mass"),
        ("config = 'pppo'\n[vary]\nseed = [1]\n", "pppo: no such file"),
        ("[vary]\nidle = {low = 0.0, high = 0.2}\n", "samples: missing"),
        ("samples = 3\n[vary]\nseed = [1]\n", "samples: nothing to draw"),
        ("samples = 3\n[vary]\nidle = {low = 0.2, high = 0.1}\n", "vary.idle: high 0.1, expected more than"),
        ("samples = 3\n[vary]\nidle = {low = 0, high = 1, log = true}\n", "vary.idle: low 0, expected more"),
        ("samples = 3\n[vary]\nseed = {low = 1.1, high = 1.9, whole = true}\n", "vary.seed: high .* whole"),
        ("samples = 3\n[vary]\nidle = {low = 0, high = 1, log = 1}\n", "vary.idle.log: got 1, expected true"),
        ("samples = 3\n[vary]\nidle = {low = 0}\n", "vary.idle.high: missing"),
        ("[set]\nseed = 1\n[vary]\nseed = [1]\n", r"set.seed: stands in \[vary\] too"),
        ("sample = 3\n[vary]\nseed = [1]\n", "sample: unknown key"),
        (
            "[vary]\nseed = [1]\n[validation]\nepisodes = 1\n",
            "validation.episodes: got 1, expected a whole number",
        ),
        (
            "[vary]\nseed = [1]\n[validation]\ntask = 'pulses'\n",
            "validation.task: got 'pulses', expected one of",
        ),
        (f"[vary]\nseed = {list(range(TRIALS_MAX + 1))}\n", f"makes {TRIALS_MAX + 1} runs, expected at most"),
        ("x = '" + "y" * 100_000 + "'", "expected at most 100000"),
    ],
)
def test_an_invalid_sweep_is_rejected_in_one_line(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=message) as caught:
        load(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_a_missing_file_or_aircraft_is_rejected_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"none.toml is no file; give the path of a sweep"):
        load_sweep(tmp_path / "none.toml")
    path = tmp_path / "study.toml"
    path.write_text("[vary]\nseed = [1]\n")
    with pytest.raises(TrainingError, match="aircraft: missing"):
        load_sweep(path)
    path.write_text("aircraft = 'nf9'\n[vary]\nseed = [1]\n")
    with pytest.raises(NeuroflightError, match="nf9"):
        load_sweep(path)
