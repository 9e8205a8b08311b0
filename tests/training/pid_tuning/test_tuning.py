"""PID tuning in the twin: commands, limits, and the settings found for the aircraft."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import FOLDER, Aircraft, PidSettings, load_aircraft, shipped
from neuroflight.sim.control.pid_table import pid_settings
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import AXES, GRAVITY, Mix
from neuroflight.toolchain.policy.gyro_filters import MEAN
from neuroflight.training.evaluation.controllers import Conditions, load_controller
from neuroflight.training.evaluation.evaluation import Evaluation, figures
from neuroflight.training.pid_tuning.dissertation import DissertationTrials
from neuroflight.training.pid_tuning.flying import CHANGE, IDLE, FlyingTrials
from neuroflight.training.pid_tuning.trial import Limits, Trial, streams
from neuroflight.training.pid_tuning.tuner import POPULATION
from neuroflight.training.pid_tuning.tuning import PidTuning, idle_limit, tune
from neuroflight.training.tasks.task import EpisodicTask, PulseTask, Task
from tests.refusal import refused

NF1 = load_aircraft("nf1")
LIMITS = Limits(output=0.12, change=0.012, idle=0.2)


def evaluated(
    aircraft: Aircraft, pid: str, task: Task, episodes: int, *, seed: int, throttle: float = 0.0
) -> Evaluation:
    """Figures of a PID of the aircraft on unseen commands."""
    controller = load_controller(f"pid:{pid}", aircraft)
    return figures(Conditions(aircraft, task, episodes, seed).fly(controller, throttle))


@pytest.fixture(scope="module")
def tuning() -> PidTuning:
    """A search interrupted after two generations."""

    def progress(flown: int, best: Trial[PidSettings]) -> None:
        if flown >= 2 * POPULATION:
            raise KeyboardInterrupt

    draw, search = streams(3)
    trials = DissertationTrials.of(NF1, LIMITS, 3, draw, commands=2)
    return tune(trials, budget=1000, rng=search, progress=progress)


def test_best_so_far_is_kept_when_the_search_is_interrupted(tuning: PidTuning) -> None:
    assert tuning.interrupted
    assert len(tuning.trials) == 2 * POPULATION
    assert tuning.best.cost == min(trial.cost for trial in tuning.trials)


def weaker(gain: float) -> float:
    """Four fifths of a gain, with as many digits as the search keeps."""
    return float(f"{0.8 * gain:.4g}")


@pytest.mark.slow
def test_search_by_flying_terms_begins_with_given_settings_and_keeps_to_its_terms() -> None:
    good = pid_settings(NF1, "flying")
    roll, pitch, yaw = ((weaker(p), weaker(i), weaker(d)) for p, i, d in good.gains)
    given = dataclasses.replace(good, gains=(roll, pitch, yaw))
    draw, search = streams(1)
    trials = FlyingTrials(NF1, Limits(1.0, CHANGE, IDLE, of_motors=True), draw, pulses=1)
    found = tune(trials, budget=2 * POPULATION, rng=search, progress=lambda flown, best: None, begin=[given])
    start = found.start.settings
    assert np.array(start.gains) == pytest.approx(np.maximum(given.gains, (1e-3, 1e-2, 1e-4)), abs=1e-4)
    assert len(found.trials) == 2 * POPULATION
    assert {(t.settings.mix, t.settings.gyro_filters, t.settings.idle) for t in found.trials} == {
        (Mix.CENTRED, MEAN, IDLE)
    }
    assert found.best.cost < found.start.cost
    assert trials.fly([found.best.settings]) == [found.best]


def test_search_improves_on_every_rule(tuning: PidTuning) -> None:
    assert tuning.start.cost <= min(trial.cost for trial in tuning.rules.values())
    assert tuning.best.cost < tuning.start.cost
    assert all(trial.settings.idle <= LIMITS.idle for trial in tuning.trials)


def test_cost_is_more_than_the_error_when_a_limit_is_exceeded(tuning: PidTuning) -> None:
    busy = [trial for trial in tuning.trials if trial.change > LIMITS.change]
    calm = [trial for trial in tuning.trials if trial.change < 0.9 * LIMITS.change and trial.output < 0.1]
    assert busy
    assert calm
    assert all(trial.cost > trial.mae + 20 * trial.held for trial in busy)
    assert all(trial.cost == pytest.approx(trial.mae + 20 * trial.held) for trial in calm)


def test_figures_of_a_candidate_are_those_of_its_evaluation(tuning: PidTuning) -> None:
    best = tuning.best
    aircraft = dataclasses.replace(NF1, pids=(("best", best.settings),))
    result = evaluated(aircraft, "best", PulseTask(), 40, seed=1)
    assert best.mae == pytest.approx(result.tracking.mae.mean(), rel=0.4)  # of two commands against 40
    assert best.output == pytest.approx(result.effort.output, rel=0.3)
    assert best.change == pytest.approx(result.effort.change, rel=0.1)


@pytest.mark.parametrize("name", shipped())
def test_an_idling_aircraft_sinks_when_idle_is_at_its_limit(name: str) -> None:
    aircraft = load_aircraft(name)
    lifts = []
    for idle in (idle_limit(aircraft), idle_limit(aircraft) + 0.01):
        twin = Twin(aircraft, mount=Mount.CENTRE, noise=False, rng=np.random.default_rng(0))
        for _ in range(1000):
            twin.step(np.full((1, aircraft.motor_count), idle))
        lifts.append(float(twin.specific_force[0, 2]) / GRAVITY)
        twin.close()
    assert lifts[0] <= 0.75 < lifts[1]


@pytest.mark.parametrize(
    ("name", "pid", "throttle"),
    [
        pytest.param("nf1", "tuned", 0.0, marks=pytest.mark.slow),
        ("iris", "tuned", 0.0),
        pytest.param("nf1", "flying", 0.25, marks=pytest.mark.slow),
        pytest.param("nf1", "flying", 0.8, marks=pytest.mark.slow),
    ],
)
def test_every_command_is_reached_and_held_when_the_tuned_pid_flies_the_episodic_task(
    name: str, pid: str, throttle: float
) -> None:
    result = evaluated(load_aircraft(name), pid, EpisodicTask(), 200, seed=2, throttle=throttle)
    assert result.response is not None
    assert result.response.success.value.tolist() == [1.0, 1.0, 1.0]


@pytest.mark.slow
def test_tuned_pid_meets_its_bar_when_it_flies_unseen_pulses() -> None:
    result = evaluated(NF1, "tuned", PulseTask(), 1000, seed=11)
    assert result.tracking.mae.mean() <= 2.1
    assert result.tracking.mse.mean() <= 125
    assert result.effort.output <= 0.12
    assert result.effort.change <= 0.012


@pytest.mark.slow
def test_command_writes_the_settings_of_the_same_search_by_the_dissertations_terms(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target, plot = tmp_path / "new" / "nf1.toml", tmp_path / "plot.png"
    words = ["pid", "tune", "--terms", "dissertation", "--seed", "3", "--budget", "1", "--check", "2"]
    words += ["--max-idle", "0.2", "--write", str(target), "--plot", str(plot), "--name", "mine", "--json"]
    status = main(words)
    document = json.loads(capsys.readouterr().out)
    assert status == (0 if document["figures"]["tuned"]["change"] <= LIMITS.change else 1)
    draw, search = streams(3)
    trials = DissertationTrials.of(NF1, LIMITS, 3, draw)
    found = tune(trials, budget=1, rng=search, progress=lambda flown, best: None).best.settings
    settings = pid_settings(load_aircraft(target), "mine")
    assert settings == dataclasses.replace(found, nominal_voltage=NF1.propulsion.supply_voltage)
    assert [document["settings"][axis] for axis in AXES] == [list(gains) for gains in settings.gains]
    told = "neuroflight pid tune --aircraft nf1 --seed 3 --terms dissertation --candidates 1 --max-idle 0.2"
    assert told in document["command"]
    assert told in target.read_text()
    assert plot.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_command_writes_a_pid_to_fly_when_it_is_told_nothing_but_the_aircraft(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = FOLDER / "nf1.toml"
    target = tmp_path / "mine.toml"
    target.write_text(source.read_text().split("# Found by")[0])  # no PID
    words = ["pid", "tune", "--aircraft", str(target), "--write", str(target)]
    status = main([*words, "--budget", "1", "--check", "1", "--json"])
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    kept = all(figures["change"] <= CHANGE for figures in document["figures"].values())
    assert status == (0 if kept else 1)
    assert list(document["figures"]) == ["thrust 0.36", "thrust 1", "thrust 2", "thrust 4"]
    assert document["limits"] == {"output": 1.0, "change": CHANGE, "change_of": "motors", "idle": IDLE}
    mine = load_aircraft(target)
    settings = pid_settings(mine)
    assert next(iter(dict(mine.pids))) == "flying"
    assert (settings.mix, settings.gyro_filters, settings.idle) == (Mix.CENTRED, MEAN, IDLE)
    text = target.read_text()
    assert "# Found by `neuroflight pid tune --aircraft mine.toml --seed 1 --candidates 1`." in text
    assert (
        "1 unseen commands each, five in a flight and then a hover, at 0.36, 1, 2, 4 times the weight" in text
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--max-output", "0.2"], "--max-output: a limit of --terms dissertation"),
        (["--budget", "0"], "--candidates 0, expected 1 to 100000"),
        (["--max-idle", "0.6"], "--max-idle 0.6, expected 0 to 0.5"),
        (["--name", "a.b"], "--name 'a.b', expected 1 to 32 letters"),
        (["--write", "x.txt"], "x.txt: expected a name that ends in .toml"),
        (["--build", "elsewhere"], "--build: of Betaflight; add --of betaflight"),
        (["--of", "betaflight", "--terms", "dissertation"], "--terms dissertation: of a PID's search"),
        (["--of", "betaflight", "--max-idle", "0.1"], "--max-idle: of a PID's search; leave it out"),
        (["--of", "betaflight", "--write", "x.toml"], "x.toml: expected a name that ends in .txt"),
        (["--of", "betaflight", "--check", "501"], "--unseen 501, expected 1 to 500"),
    ],
)
def test_command_rejects_an_invalid_argument_in_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in refused(capsys, ["pid", "tune", *arguments])
