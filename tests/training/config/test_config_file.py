"""Configurations from recipes, files and overrides, and the errors of invalid ones."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.config.algorithms import PpoConfig
from neuroflight.training.config.config_file import load_config, recipes
from neuroflight.training.config.randomization import Randomization
from neuroflight.training.config.training_config import OutputMap, TrainingConfig, WorldConfig
from neuroflight.training.tasks.reward import TrackingReward
from neuroflight.training.tasks.task import EnvelopeTask, PulseTask

NF1 = load_aircraft("nf1")
OTHER = TrainingConfig(
    steps=12_345,
    seed=7,
    observation="rate_error,throttle,previous_action",
    control_rate_hz=2000,
    hidden=(32,),
    activation="relu",
    output=OutputMap(0.25, 0.2, squash=True),
    idle=0.23,
    mix="centred",
    gyro_filter="mean",
    task=EnvelopeTask(hold_s=0.7, sigma_deg_s=200.0),
    reward=TrackingReward(change=0.5),
    world=WorldConfig(
        mount="rig",
        gravity=True,
        wind_m_s=(1.0, -2.0, 0.0),
        throttle_max=0.8,
        randomization=Randomization(mass=(0.8, 1.2), delay_s=(0.001, 0.004)),
    ),
    algorithm=PpoConfig(aircraft=16, horizon=32, minibatch=64, log_std=(-2.0, -3.0)),
    checkpoint_steps=500,
)


def test_a_file_gives_each_field_when_it_names_them_all(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("""
        steps = 12345
        seed = 7
        observation = "rate_error,throttle,previous_action"
        control_rate_hz = 2000
        hidden = [32]
        activation = "relu"
        idle = 0.23
        mix = "centred"
        gyro_filter = "mean"
        checkpoint_steps = 500
        [output]
        scale = 0.25
        offset = 0.2
        squash = true
        [task]
        name = "envelope"
        hold_s = 0.7
        sigma_deg_s = 200
        [reward]
        name = "tracking"
        change = 0.5
        [world]
        mount = "rig"
        gravity = true
        wind_m_s = [1, -2, 0]
        throttle_max = 0.8
        [world.randomization]
        mass = [0.8, 1.2]
        delay_s = [0.001, 0.004]
        [algorithm]
        name = "ppo"
        aircraft = 16
        horizon = 32
        minibatch = 64
        log_std = [-2, -3]
    """)
    assert load_config(file) == OTHER


ESTIMATING = replace(OTHER, observation="rate_estimate_error,rotor_estimate@1,previous_motors")


@pytest.mark.parametrize("config", [TrainingConfig(), OTHER, ESTIMATING])
def test_a_record_repeats_its_run_when_it_is_the_source(config: TrainingConfig, tmp_path: Path) -> None:
    file = tmp_path / "training.json"
    file.write_text(json.dumps({"config": config.document(NF1), "steps": 99, "complete": True}))
    assert load_config(file) == config
    file.write_text(json.dumps(config.document(NF1)))
    again = load_config(str(file))
    assert again == config
    assert json.dumps(again.document(NF1)) == json.dumps(config.document(NF1))


def test_the_ppo_recipe_is_the_default() -> None:
    assert load_config("ppo") == load_config(None) == TrainingConfig()


@pytest.mark.parametrize("name", recipes())
def test_every_recipe_is_read_and_its_document_repeats_it(name: str, tmp_path: Path) -> None:
    config = load_config(name)
    file = tmp_path / "training.json"
    file.write_text(json.dumps({"config": config.document(NF1)}))
    assert load_config(file) == config


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["steps=5_000", "seed = 3"], replace(TrainingConfig(), steps=5000, seed=3)),
        (["observation=rate,rate_error"], replace(TrainingConfig(), observation="rate,rate_error")),
        (['activation="relu"', "hidden=[8, 9]"], replace(TrainingConfig(), activation="relu", hidden=(8, 9))),
        (["task=envelope"], replace(TrainingConfig(), task=EnvelopeTask())),
        (["task.sigma_deg_s=50"], replace(TrainingConfig(), task=PulseTask(sigma_deg_s=50.0))),
        (
            ["task.hold_s=2", "task.name=envelope"],
            replace(TrainingConfig(), task=EnvelopeTask(hold_s=2.0)),
        ),
        (["seed=2", "seed=3"], replace(TrainingConfig(), seed=3)),
        (["mix=centred", "gyro_filter=mean"], replace(TrainingConfig(), mix="centred", gyro_filter="mean")),
        (
            ["world.randomization.lag=[1,2]", "world.gravity=false", "world.randomization={mass=[0.9,1.1]}"],
            replace(
                TrainingConfig(),
                world=WorldConfig(gravity=False, randomization=Randomization(mass=(0.9, 1.1), lag=(1, 2))),
            ),
        ),
        (["world.randomization.delay_s=none"], TrainingConfig()),
    ],
)  # fmt: skip
def test_an_override_replaces_the_recipes_value(overrides: list[str], expected: TrainingConfig) -> None:
    assert load_config("ppo", overrides) == expected


def test_a_table_is_replaced_when_an_override_names_another_kind(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('[task]\nidle_s = 0.1\nsigma_deg_s = 50\n[reward]\nname = "tracking"\nerror = 2\n')
    assert load_config(file).task == PulseTask(idle_s=0.1, sigma_deg_s=50.0)  # the default's kind
    assert load_config(file, ["task.name=pulse", "reward=tracking"]) == load_config(file)
    assert load_config(file, ["task.name=envelope"]).task == EnvelopeTask()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["sede=1"], "override 'sede=1': sede: unknown key; nearest: seed"),
        (["world.throtle_max=1"], "world.throtle_max: unknown key; nearest: throttle_max, throttle_share"),
        (["zzz=1"], "zzz: unknown key; known here: steps, seed, observation"),
        (["task.name=envelope", "task.idle_s=1"], "task.idle_s: unknown key; known here: distribution"),
        (["task=ballet"], "task.name: got 'ballet', expected one of: pulse, flight, pilot"),
        (["algorithm=3"], "algorithm: got 3, expected a table with a name, or the name alone"),
        (["steps=1.5"], "override 'steps=1.5': steps: got 1.5, expected a whole number"),
        (["idle=nan"], "idle: got nan, expected a finite number"),
        ([f"idle={'9' * 400}"], "idle: got 999"),
        (["world=3"], "world: got 3, expected a table"),
        (["world.gravity=maybe"], "world.gravity: got 'maybe', expected true or false"),
        (["world.randomization.mass=[0.5]"], "mass: got [0.5], expected a list of 2"),
        (["algorithm.log_std=['a', 0]"], "0]\": algorithm.log_std[0]: got 'a'"),
        (["activation=1"], "activation: got 1, expected one line of at most 200 characters"),
        (["seed"], "override 'seed': expected KEY=VALUE, such as"),
        (["a..b=1"], "override 'a..b=1': expected KEY=VALUE"),
        (["seed="], "override 'seed=': the value is not TOML"),
        (["hidden=[1,"], "override 'hidden=[1,': the value is not TOML"),
        (["seed=1\nsteps=2"], "override 'seed=1\\nsteps=2': expected one value"),
        (["steps.x=1"], "override 'steps.x=1': steps is no table"),
        (["hidden=" + "[" * 5000], "the value is not TOML: "),
    ],
)  # fmt: skip
def test_an_invalid_key_or_value_is_rejected_in_one_line(overrides: list[str], message: str) -> None:
    with pytest.raises(TrainingError) as error:
        load_config("ppo", overrides)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.toml", b"steps = ", "a.toml: not TOML: Invalid value"),
        ("a.json", b"{", "a.json: not JSON: "),
        ("a.json", b'{"seed": 1, "seed": 2}', "a.json: not JSON: 'seed' stands twice"),
        ("a.json", b"[1]", "a.json: got [1], expected keys and values"),
        ("a.json", b"[" * 100_000, "a.json: not JSON: "),
        ("a.json", b'{"idle": NaN}', "a.json: idle: got nan, expected a finite number"),
        ("a.toml", b"steps = 1\nsteps = 2", "a.toml: not TOML: Cannot overwrite"),
        ("a.toml", b"\xff", "a.toml: not UTF-8: byte 0xff at 0; save it as UTF-8"),
        ("a.yaml", b"", "a.yaml: expected a name that ends in .toml or .json"),
        ("a.toml", b"#" * (1 << 20) + b"#", "a.toml: 1048577 bytes, expected at most 1048576"),
        ("a.toml", b'"a\\u001bb" = 4', "a.toml: 'a\\x1bb': unknown key"),
        ("a.toml", b"[task]\nsigma = 1", "a.toml: task.sigma: unknown key; nearest: sigma_deg_s"),
        ("a.json", b'{"filters": ["lowpass"]}', "a.json: filters: got ['lowpass'], expected []"),
        ("a.json", b'{"gyro_filter": "mean", "filters": []}', "filters: got [], expected [['mean']]: gyro"),
        ("a.json", b'{"motors": 900, "observation_scale": []}', "motors: got 900, expected 1 to 8"),
        ("a.json", b'{"motors": 4, "observation_scale": [1]}', "observation_scale: that run scaled its"),
    ],
)  # fmt: skip
def test_an_invalid_file_is_rejected_in_one_line(
    name: str, content: bytes, message: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(TrainingError) as error:
        load_config(tmp_path / name)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("source", ["no-such-recipe", "", "a\0b"])
def test_a_missing_source_is_rejected_with_the_names_of_the_recipes(source: str) -> None:
    with pytest.raises(TrainingError, match=r"no such file; give the path .* one of the recipes: .*ppo"):
        load_config(source)
