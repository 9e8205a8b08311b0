"""PID tuning in the twin: commands, limits, and the settings found for the aircraft."""

import dataclasses
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli.main import main
from sim.aircraft.model import load_aircraft, shipped
from sim.control.pid import aircraft_pid, pid_settings
from sim.physics.twin import Twin
from sim.physics.world import Mount
from toolchain.contract import AXES, GRAVITY, Mix
from training.evaluation.evaluation import figures, record
from training.pid_tuning.trial import Limits, Loop, Trial, Trials, throttles, training_commands
from training.pid_tuning.tuning import POPULATION, Tuning, idle_limit, tune
from training.tasks.task import EpisodicTask, PulseTask

NF1 = load_aircraft("nf1")
LIMITS = Limits(output=0.12, change=0.012, idle=0.2)


@pytest.fixture(scope="module")
def tuning() -> Tuning:
    """A search interrupted after two generations."""

    def progress(flown: int, best: Trial) -> None:
        if flown >= 2 * POPULATION:
            raise KeyboardInterrupt

    return tune(NF1, LIMITS, Loop(1000), seed=3, commands=2, budget=1000, progress=progress)


def test_best_so_far_is_kept_when_the_search_is_interrupted(tuning: Tuning) -> None:
    assert tuning.interrupted
    assert len(tuning.trials) == 2 * POPULATION
    assert tuning.best.cost == min(trial.cost for trial in tuning.trials)


def test_search_begins_with_given_settings_and_ends_in_full_flights_when_the_gyro_is_averaged() -> None:
    given = pid_settings(NF1, "tuned")
    loop = Loop(1000, Mix.CENTRED, gyro_mean=True, throttle_max=0.8)
    limits = Limits(0.12, 0.0045, 0.055, of_motors=True)
    best_of: list[Trial] = []
    found = tune(
        NF1,
        limits,
        loop,
        seed=1,
        commands=2,
        budget=2 * POPULATION,
        progress=lambda flown, best: best_of.append(best),
        start=given,
    )
    dressed = replace(given, idle=0.055, tpa_rate=0.0, tpa_breakpoint=0.0, nominal_voltage=None)
    dressed = replace(dressed, mix=Mix.CENTRED, gyro_mean=True)
    start = found.start.settings
    assert replace(start, gains=dressed.gains) == dressed
    gains = np.array(start.gains)
    assert gains == pytest.approx(np.maximum(given.gains, (1e-3, 1e-2, 1e-4)), abs=1e-4)
    assert len(found.trials) == 2 * POPULATION
    assert {(t.settings.mix, t.settings.gyro_mean) for t in found.trials} == {(Mix.CENTRED, True)}
    draw, _, thrust = (np.random.default_rng(s) for s in np.random.SeedSequence([1, 1]).spawn(3))
    still = replace(NF1, gyro=replace(NF1.gyro, bias=0.0))
    full = Trials(still, loop, limits, 1, training_commands(2, draw), throttles(2, 0.8, thrust))
    (again,) = full.fly([found.best.settings])
    assert again.mae == pytest.approx(found.best.mae, rel=0.02)  # other noise in a world of its own
    assert best_of[0].cost != best_of[1].cost


def test_search_improves_on_every_rule(tuning: Tuning) -> None:
    assert tuning.start.cost <= min(trial.cost for trial in tuning.rules.values())
    assert tuning.best.cost < tuning.start.cost
    assert all(trial.settings.idle <= LIMITS.idle for trial in tuning.trials)


def test_cost_is_more_than_the_error_when_a_limit_is_exceeded(tuning: Tuning) -> None:
    busy = [trial for trial in tuning.trials if trial.change > LIMITS.change]
    calm = [trial for trial in tuning.trials if trial.change < 0.9 * LIMITS.change and trial.output < 0.1]
    assert busy
    assert calm
    assert all(trial.cost > trial.mae + 20 * trial.held for trial in busy)
    assert all(trial.cost == pytest.approx(trial.mae + 20 * trial.held) for trial in calm)


def test_figures_of_a_candidate_are_those_of_its_evaluation(tuning: Tuning) -> None:
    best = tuning.best
    aircraft = dataclasses.replace(NF1, pids=(("best", best.settings),))
    pid = aircraft_pid(aircraft, 40)
    result = figures(
        record(pid, aircraft, PulseTask(), episodes=40, seed=1, control_rate_hz=1000, idle=best.settings.idle)
    )
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
    [("nf1", "tuned", 0.0), ("iris", "tuned", 0.0), ("nf1", "flying", 0.25), ("nf1", "flying", 0.8)],
)
def test_every_command_is_reached_and_held_when_the_tuned_pid_flies_the_episodic_task(
    name: str, pid: str, throttle: float
) -> None:
    aircraft = load_aircraft(name)
    settings = pid_settings(aircraft, pid)
    result = figures(
        record(
            aircraft_pid(aircraft, 200, name=pid),
            aircraft,
            EpisodicTask(),
            episodes=200,
            seed=2,
            control_rate_hz=1000,
            throttle=throttle,
            idle=settings.idle,
            mix=settings.mix,
            gyro_mean=settings.gyro_mean,
        )
    )
    assert result.response is not None
    assert result.response.success.value.tolist() == [1.0, 1.0, 1.0]


@pytest.mark.slow
def test_tuned_pid_meets_its_bar_when_it_flies_unseen_pulses() -> None:
    result = figures(
        record(
            aircraft_pid(NF1, 1000, name="tuned"),
            NF1,
            PulseTask(),
            episodes=1000,
            seed=11,
            control_rate_hz=1000,
            idle=pid_settings(NF1, "tuned").idle,
        )
    )
    assert result.tracking.mae.mean() <= 2.1
    assert result.tracking.mse.mean() <= 125
    assert result.effort.output <= 0.12
    assert result.effort.change <= 0.012


def test_command_writes_the_settings_of_the_same_search(
    tuning: Tuning, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target, plot = tmp_path / "new" / "nf1.toml", tmp_path / "plot.png"
    words = [
        "tune-pid",
        "--seed",
        "3",
        "--budget",
        "16",
        "--commands",
        "2",
        "--check",
        "2",
        "--max-idle",
        "0.2",
    ]
    status = main([*words, "--write", str(target), "--plot", str(plot), "--name", "mine", "--json"])
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert status == (0 if document["figures"]["tuned"]["change"] <= LIMITS.change else 1)
    assert document["candidates"] == POPULATION
    first = [tuning.start, *tuning.trials[:POPULATION]]
    settings = pid_settings(load_aircraft(target), "mine")
    found = min(first, key=lambda trial: trial.cost).settings
    assert settings == dataclasses.replace(found, nominal_voltage=NF1.propulsion.supply_voltage)
    assert [document["settings"][axis] for axis in AXES] == [list(gains) for gains in settings.gains]
    assert "neuroflight tune-pid --aircraft nf1 --seed 3 --commands 2 --budget 16" in target.read_text()
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_command_writes_mix_and_filter_when_it_is_told_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "nf1.toml"
    words = ["tune-pid", "--budget", "1", "--commands", "2", "--check", "2", "--max-idle", "0.05"]
    words += ["--mix", "centred", "--gyro-filter", "mean", "--throttle-max", "0.6", "--start", "tuned"]
    status = main([*words, "--max-motor-change", "0.006", "--write", str(target), "--json"])
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert status == (0 if document["figures"]["tuned"]["change"] <= 0.006 else 1)
    assert document["limits"]["change_of"] == "motors"
    assert (document["mix"], document["gyro_filter"], document["throttle_max"]) == ("centred", "mean", 0.6)
    settings = pid_settings(load_aircraft(target), "tuned")
    assert (settings.mix, settings.gyro_mean, settings.idle <= 0.05) == (Mix.CENTRED, True, True)
    text = target.read_text()
    assert document["command"] in text
    for option in ("--mix centred", "--gyro-filter mean", "--throttle-max 0.6", "--start tuned"):
        assert option in document["command"]
    assert "at throttles from 0 to 0.6: MAE" in text
    assert "mean change of the motor values in 1 ms" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--throttle-max", "1.5"], "--throttle-max 1.5, expected 0 to 1"),
        (["--max-motor-change", "0"], "--max-motor-change 0"),
        (["--start", "none"], "no PID 'none'; it has: "),
        (["--budget", "0"], "--budget 0, expected 1 to 100000"),
        (["--commands", "1"], "--commands 1, expected 2 to 341"),
        (["--seed", "-1"], "--seed -1"),
        (["--max-idle", "0.6"], "--max-idle 0.6, expected 0 to 0.5"),
        (["--max-change", "nan"], "--max-change nan"),
        (["--name", "a.b"], "--name 'a.b', expected 1 to 32 letters"),
        (["--write", "x.txt"], "x.txt: expected a name that ends in .toml"),
        (["--plot", "/dev/null/x.png"], "/dev/null/x.png: /dev/null is no directory"),
        (["--aircraft", "none"], "aircraft 'none': no such file"),
    ],
)
def test_command_rejects_an_invalid_argument_in_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tune-pid", *arguments]) == 1
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
