"""Rewards and tasks of a user's own file, from a folder outside the repository."""

from __future__ import annotations

import hashlib
import json
import pickle
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.config.config_file import load_config
from neuroflight.training.plugins import REGISTRIES, load_plugin, plugins_of, users_own
from neuroflight.training.tasks.registry import TASKS
from neuroflight.training.tasks.reward import REWARDS, Transition
from neuroflight.training.tasks.task import PulseTask
from tests.conftest import ROOT

Capture = pytest.CaptureFixture[str]
Write = Callable[..., tuple[Path, str]]  # parts of a file to its path, and the name in it

HEAD = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from neuroflight.training.plugins import register
from neuroflight.training.tasks.limits import check_limits
"""
REWARD = """
@register
@dataclass(frozen=True)
class Worst:
    name: ClassVar[str] = "NAME"
    change: float = 2.0

    def __post_init__(self):
        check_limits(f"reward {self.name}", self, change=(0.0, 10.0))

    def __call__(self, step):
        changed = np.abs(step.action - step.action_before).mean(axis=1)
        return -np.abs(step.error).max(axis=1) - self.change * changed
"""
TASK = """
@register
@dataclass(frozen=True)
class Sines:
    name: ClassVar[str] = "NAME"
    duration_s: float = 0.5
    most_deg_s: float = 200.0

    def episodes(self, count, rng, rate_hz):
        time = np.arange(round(self.duration_s * rate_hz)) / rate_hz
        hz = rng.uniform(0.5, 3.0, (count, 1, 3))
        return np.deg2rad(self.most_deg_s) * np.sin(2 * np.pi * hz * time[:, None])
"""
TINY = ["hidden=[8,8]", "algorithm.aircraft=8", "algorithm.leg=1", "algorithm.horizon=16"]
TINY += ["algorithm.minibatch=64", "selection.fit=false", "checkpoint_steps=128"]


@pytest.fixture
def write(tmp_path: Path) -> Iterator[Write]:
    """Return what writes a user's file; what it registers is forgotten after the test."""
    name = f"test-{hashlib.sha256(str(tmp_path).encode()).hexdigest()[:16]}"

    def written(*parts: str) -> tuple[Path, str]:
        path = tmp_path / "mine.py"
        path.write_text((HEAD + "".join(parts)).replace("NAME", name))
        return path, name

    yield written
    forget()


def forget() -> None:
    """Know of no user's file, as another process begins."""
    for registry in REGISTRIES.values():
        for name in [name for name, kind in registry.items() if users_own(kind)]:
            del registry[name]
    for name in [name for name in sys.modules if name.startswith("neuroflight_plugin_")]:
        del sys.modules[name]


def transition(aircraft: int = 5) -> Transition:
    rng = np.random.default_rng(1)
    rate = [rng.normal(size=(aircraft, 3)) for _ in range(4)]
    output = [rng.uniform(size=(aircraft, 4)).astype(np.float32) for _ in range(3)]
    return Transition(rate[0], rate[1], rate[2], rate[3], output[0], output[1], output[2])


def test_a_reward_is_a_key_of_the_configuration_with_its_limits(write: Write) -> None:
    path, name = write(REWARD)
    load_plugin(path)
    config = load_config("ppo", [f"reward={name}", "reward.change=3"])
    step = transition()
    changed = np.abs(step.action - step.action_before).mean(axis=1)
    wanted = -np.abs(step.error).max(axis=1) - 3.0 * changed
    assert np.allclose(config.reward(step), wanted, rtol=1e-6)
    assert config.reward(step).dtype == np.float32
    with pytest.raises(TrainingError, match=r"reward\.chnge: unknown key; nearest: change"):
        load_config("ppo", [f"reward={name}", "reward.chnge=3"])
    with pytest.raises(TrainingError, match=r"change 11\.0, expected 0 to 10"):
        load_config("ppo", [f"reward={name}", "reward.change=11"])
    with pytest.raises(TrainingError, match=r"needs its --plugin FILE\.py"):
        load_config("ppo", ["reward=nobodys"])


def test_a_run_stores_its_files_and_asks_for_the_same(
    write: Write, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "neuroflight.training.checkpoints.monitor.FLIGHT", PulseTask(idle_s=0.0, command_s=0.1, rest_s=0.1)
    )
    path, name = write(REWARD, TASK)
    own = ["--plugin", str(path)]
    words = ["policy", "train", "--algorithm", "ppo", "--steps", "128"]
    words += ["--set", f"reward={name}", f"task={name}", *TINY]
    out = ["--out", str(tmp_path / "run")]
    assert main([*words, *own, *out, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    [kept] = record["config"]["plugins"]
    assert kept["file"] == "mine.py"
    assert f"--plugin {path.name}" in record["command"]
    assert len(record["monitor"]) == 1

    again = [*words, *out, "--resume"]
    run, frozen = tmp_path / "run", tmp_path / "frozen.onnx"
    anew = ["policy", "train", "--config", str(run / "training.json"), "--out", str(tmp_path / "anew")]
    freeze = ["policy", "import", str(run / "checkpoint.pt"), "--out", str(frozen)]
    forget()
    assert [main(each) for each in (anew, again, [*again, *own], freeze)] == [1, 1, 0, 0]
    told = capsys.readouterr().err
    assert f"was trained with the plug-in mine.py, SHA-256 {kept['sha256'][:12]}" in told
    assert f"task.name: got '{name}', expected one of" in told
    assert frozen.read_bytes() == (run / "policy.onnx").read_bytes()  # and needs no file of the user's

    path.write_text(path.read_text() + "\n# another\n")
    assert main([*words, *own, *out, "--resume"]) == 1
    assert f"trained with the plug-in mine.py, SHA-256 {kept['sha256'][:12]}" in capsys.readouterr().err


def test_a_task_is_evaluated_by_name(write: Write, capsys: Capture) -> None:
    path, name = write(TASK)
    words = ["compare", "pid", "pid:tuned", "--task", name, "--episodes", "3", "--json"]
    assert main(words) == 1
    assert "one of a file of yours needs its --plugin" in capsys.readouterr().err
    assert main([*words, "--plugin", str(path)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["task"] == name
    assert "--plugin mine.py" in told["command"]
    setpoint = TASKS[name]().episodes(3, np.random.default_rng(0), 1000)
    assert setpoint.dtype == np.float32
    assert setpoint.shape == (3, 500, 3)


def test_an_object_is_known_in_another_process(write: Write) -> None:
    path, name = write(REWARD)
    load_plugin(path)
    config = load_config("ppo", [f"reward={name}", "reward.change=3"])
    data = pickle.dumps(config)
    forget()
    other = pickle.loads(data)
    assert (other.reward.name, other.reward.change) == (name, 3.0)
    assert type(other.reward) is not type(config.reward)
    assert plugins_of(config.task, config.reward) == [
        {"file": "mine.py", "sha256": REWARDS[name].plugin.sha256}  # type: ignore[attr-defined]
    ]


def test_a_room_is_told_by_its_name_when_it_is_imported_without_the_package(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, _ = write("from training.plugins import register\n")
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if Path(folder).resolve() != ROOT])
    with pytest.raises(TrainingError, match=r"named 'training'; it is imported as neuroflight\.training$"):
        load_plugin(path)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (["import nothing_of_that_name\n"], r"mine\.py: line 9: ModuleNotFoundError: No module named"),
        (["def f(:\n"], r"mine\.py: line 9: SyntaxError"),
        (["import sys\nsys.exit(3)\n"], r"mine\.py: line 10: SystemExit: 3"),
        (["x = 1\n"], r"mine\.py: registers nothing; put neuroflight"),
        (
            [REWARD.replace('"NAME"', '"tracking"')],
            "reward tracking: the name is taken by this program's own",
        ),
        (
            [REWARD.replace("frozen=True", "frozen=False")],
            r"Worst: expected a class under @dataclass\(frozen",
        ),
        ([REWARD.replace("change: float = 2.0", "change: float")], "change needs a default"),
        ([REWARD.replace("change: float = 2.0", "change: float = 20")], "change 20, expected 0 to 10"),
        ([REWARD.replace("__call__", "rewarded")], "neither a reward, which has __call__"),
        ([TASK.replace("0.5\n", "0.0\n", 1)], "duration_s 0, expected above 0 to 600"),
    ],
)
def test_a_file_is_refused_in_one_line(write: Write, parts: list[str], message: str) -> None:
    path, _ = write(*parts)
    with pytest.raises(TrainingError, match=message) as caught:
        load_plugin(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return step.error", r"returned shape \(5, 3\), expected \(5,\): one number for each aircraft"),
        ("return [1, [2]]", "expected numbers of shape"),
        ("return np.log(-np.abs(step.error[:, 0]))", "returned nan, expected finite numbers"),
        ("return 1 / 0", r"mine\.py, line 20: ZeroDivisionError: division by zero"),
        (
            "step.error[:] = 0; return step.error[:, 0]",
            r"line 20: ValueError: assignment destination is read-only",
        ),
    ],
)
def test_what_a_reward_returns_is_checked(write: Write, body: str, message: str) -> None:
    head, _, _ = REWARD.partition("        changed =")
    path, name = write(head + f"        {body}\n")
    load_plugin(path)
    step = transition()
    before = step.error.copy()
    with pytest.raises(TrainingError, match=f"reward {name}: .*{message}"), np.errstate(invalid="ignore"):
        REWARDS[name]()(step)
    assert (step.error == before).all()


@pytest.mark.parametrize(
    ("of", "to", "message"),
    [
        ("np.deg2rad(self.most_deg_s)", "self.most_deg_s", r"commands 200 rad/s, expected at most 17\.45"),
        ("time[:, None]", "time[:-1, None]", r"returned shape \(2, 499, 3\), expected \(2, 500, 3\)"),
    ],
)
def test_what_a_task_commands_is_checked(write: Write, of: str, to: str, message: str) -> None:
    path, name = write(TASK.replace(of, to))
    load_plugin(path)
    with pytest.raises(TrainingError, match=f"task {name}: {message}"):
        TASKS[name]().episodes(2, np.random.default_rng(1), 1000)


def test_a_reward_is_refused_where_none_is_asked(write: Write) -> None:
    path, name = write(REWARD)
    load_plugin(path)
    with pytest.raises(TrainingError, match="algorithm pathwise follows the gradient of its own loss"):
        load_config("nf1", [f"reward={name}"])


@pytest.mark.slow
def test_a_sweep_varies_a_users_reward_and_flies_his_task(
    write: Write, tmp_path: Path, capsys: Capture
) -> None:
    path, name = write(REWARD)
    other = tmp_path / "other.py"
    other.write_text((HEAD + TASK).replace("NAME", f"{name}-flown"))
    sweep = tmp_path / "sweep.toml"
    sets = "\n".join(
        [*TINY, 'task = {name = "episodic", hold_s = 0.05}', f'reward = "{name}"', "steps = 128"]
    )
    sweep.write_text(
        f'aircraft = "nf1"\nconfig = "ppo"\n[set]\n{sets}\n[vary]\nreward.change = [3.0]\n'
        f'[validation]\ntask = "{name}-flown"\nepisodes = 2\n'
    )
    words = ["policy", "sweep", str(sweep), "--out", str(tmp_path / "out"), "--cpus", "1", "--json"]
    assert main([*words, "--plugin", str(path), "--plugin", str(other)]) == 0
    told = json.loads(capsys.readouterr().out)
    [run] = told["runs"]
    assert run["outcome"] and run["varied"] == {"reward.change": 3.0}
