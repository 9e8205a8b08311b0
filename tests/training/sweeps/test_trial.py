"""One run of a sweep in this process, and a sweep whose runs are all done, which needs no worker."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.toolchain.errors import BuildError, TrainingError
from neuroflight.training.runs.train import Callback, Progress
from neuroflight.training.sweeps import trial as sweep_trial
from neuroflight.training.sweeps.config import Sweep, load_sweep
from neuroflight.training.sweeps.run import run_sweep
from neuroflight.training.sweeps.trial import Outcome, read_outcome, run_trial

FILE = """
aircraft = "nf1"
[set]
steps = 512
checkpoint_steps = 512
hidden = [8]
algorithm.aircraft = 16
algorithm.horizon = 32
algorithm.minibatch = 128
task.idle_s = 0.05
task.command_s = 0.1
task.rest_s = 0.1
[vary]
seed = [5]
[validation]
task = "episodic"
episodes = 3
throttle = 0.3
"""


class Untrained(Callback):
    """Fails if anything is trained."""

    def progressed(self, progress: Progress) -> None:
        raise AssertionError("trained again")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Sweep, Path, Outcome]:
    """A sweep of one run, done; the folder holds study.toml and out."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "study.toml").write_text(FILE)
    sweep = load_sweep(folder / "study.toml")
    trial = sweep.trials[0]
    place = folder / "out" / "trials" / trial.folder
    return sweep, folder, run_trial(trial, sweep.aircraft, sweep.validation, place, Callback())


def test_result_is_read_back_when_a_run_is_done(done: tuple[Sweep, Path, Outcome]) -> None:
    sweep, folder, outcome = done
    trial = sweep.trials[0]
    place = folder / "out" / "trials" / trial.folder
    assert read_outcome(place, trial, sweep.aircraft, sweep.validation) == outcome
    assert outcome.steps == 512
    assert outcome.mae.mean > 0
    assert outcome.mae.margin > 0
    assert 0 <= outcome.output.mean <= 1
    assert read_outcome(folder, trial, sweep.aircraft, sweep.validation) is None


def test_nothing_is_trained_again_when_a_run_ended_before_its_result(
    done: tuple[Sweep, Path, Outcome],
) -> None:
    sweep, folder, outcome = done
    trial = sweep.trials[0]
    place = folder / "out" / "trials" / trial.folder
    (place / "result.json").unlink()
    assert run_trial(trial, sweep.aircraft, sweep.validation, place, Untrained()) == outcome


def test_counts_are_null_with_the_reason_when_there_is_no_compiler(
    done: tuple[Sweep, Path, Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(*_: object, **__: object) -> None:
        raise BuildError("arm-none-eabi-gcc is missing")

    monkeypatch.setattr(sweep_trial, "time_policy", missing)
    sweep, folder, outcome = done
    trial = sweep.trials[0]
    place = folder / "out" / "trials" / trial.folder
    result = (place / "result.json").read_bytes()
    found = run_trial(trial, sweep.aircraft, sweep.validation, place, Untrained())
    (place / "result.json").write_bytes(result)
    assert found == replace(
        outcome, instructions=None, predicted_cycles=None, no_cycles_reason="arm-none-eabi-gcc is missing"
    )


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"outcome": {"mae": 3}}', "\xff"])
def test_a_damaged_result_is_rejected_in_one_line(
    text: str, done: tuple[Sweep, Path, Outcome], tmp_path: Path
) -> None:
    (tmp_path / "result.json").write_bytes(text.encode("latin-1"))
    sweep = done[0]
    with pytest.raises(TrainingError, match=r"result.json is damaged .*; remove its folder") as caught:
        read_outcome(tmp_path, sweep.trials[0], sweep.aircraft, sweep.validation)
    assert "\n" not in str(caught.value)


def test_finished_sweep_needs_no_worker_when_it_is_resumed(
    done: tuple[Sweep, Path, Outcome], capsys: pytest.CaptureFixture[str]
) -> None:
    _, folder, outcome = done
    out = folder / "out"
    arguments = ["policy", "sweep", str(folder / "study.toml"), "--out", str(out), "--cpus", "1"]
    assert main([*arguments, "--resume", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record == json.loads((out / "sweep.json").read_text())
    assert record["complete"] is True
    assert record["runs"][0]["outcome"]["mae"]["mean"] == outcome.mae.mean
    assert (out / "sweep.png").read_bytes().startswith(b"\x89PNG")
    assert main([*arguments, "--resume"]) == 0
    table = capsys.readouterr().out
    assert f"{outcome.mae.mean:,.2f} ± {outcome.mae.margin:,.2f}" in table
    assert f"{outcome.instructions or '-'}" in table
    assert main(arguments) == 1
    assert "already holds a sweep; add --resume" in capsys.readouterr().err


def test_another_sweep_is_rejected_when_it_is_resumed(
    done: tuple[Sweep, Path, Outcome], tmp_path: Path
) -> None:
    _, folder, _ = done
    (tmp_path / "study.toml").write_text(FILE.replace("hidden = [8]", "hidden = [9]"))
    with pytest.raises(TrainingError, match="of another run than the sweep now asks for"):
        run_sweep(load_sweep(tmp_path / "study.toml"), folder / "out", cpus=1, resume=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--cpus", "0"], "--cpus 0, expected 1 to"),
        (["--out", "{file}"], "is no folder; give the name of one"),
        (["--address", "cluster"], "--address cluster, expected HOST:PORT"),
        (
            ["--address", "127.0.0.1:1"],
            "nothing answers at --address 127.0.0.1:1 (Connection refused); begin",
        ),
    ],
)
def test_invalid_options_are_rejected_in_one_line(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "study.toml"
    file.write_text(FILE)
    given = [option.format(file=file) for option in options]
    assert main(["policy", "sweep", str(file), "--out", str(tmp_path / "out"), *given]) == 1
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.out == ""
    assert not (tmp_path / "out" / "trials").exists()


def test_the_error_says_how_to_install_ray_when_it_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    (tmp_path / "study.toml").write_text(FILE)
    words = ["policy", "sweep", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out")]
    assert main([*words, "--address", "local"]) == 1
    assert "pip install 'neuroflight[sweep]'" in capsys.readouterr().err
