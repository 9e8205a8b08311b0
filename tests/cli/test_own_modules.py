"""docs/guides/own-modules.md: its very files, in a folder outside the repository, by its very commands."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.policy.model import read_policy
from neuroflight.training.plugins import REGISTRIES
from tests.conftest import ROOT

Capture = pytest.CaptureFixture[str]

PAGE = (ROOT / "docs" / "guides" / "own-modules.md").read_text()
TINY = "hidden=[8,8] algorithm.aircraft=16 algorithm.horizon=64 algorithm.minibatch=256 algorithm.leg=1"
SHORT = {"2000000": "4096", "300000": "1", "reward=worst-axis": f"reward=worst-axis {TINY}", "100": "4"}
SECONDS_MAX = 1800


def files() -> dict[str, str]:
    """The page's files by name."""
    return dict(re.findall(r"^`(\w+\.\w+)`:\n\n```\w+\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))


def section(heading: str) -> list[str]:
    """The commands of a section, in order."""
    found = re.search(rf"^##+ {re.escape(heading)}\n(.*?)(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert found is not None, heading
    return [line.strip() for line in re.findall(r"^ *(neuroflight .*|python .*)$", found[1], re.MULTILINE)]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The user's folder, in which he types; what his files register is forgotten after the test."""
    for name, text in files().items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    with contextlib.ExitStack() as undo:
        for registry in REGISTRIES.values():
            before = dict(registry)
            undo.callback(registry.update, before)
            undo.callback(registry.clear)
        yield tmp_path


def typed(line: str, folder: Path) -> str:
    """Run a command as it is printed; returns what it prints. A program of his has a process of its own."""
    words = shlex.split(line)
    if words[0] == "neuroflight":
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            assert main(words[1:]) == 0, line
        return printed.getvalue()
    done = subprocess.run(
        [sys.executable, *words[1:]],
        cwd=folder,
        env=os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=SECONDS_MAX,
    )
    assert done.returncode == 0, f"{line}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
    return done.stdout


def shortened(line: str) -> str:
    for long, short in SHORT.items():
        line = line.replace(long, short)
    return line


def test_the_page_has_a_file_of_each_kind() -> None:
    wanted = [
        "my_reward.py",
        "my_task.py",
        "my_controller.py",
        "my_tuner.py",
        "my_training.py",
        "my_quad.urdf",
    ]
    assert list(files()) == wanted


@pytest.mark.slow
def test_the_whole_way_from_the_users_folder(folder: Path) -> None:
    """A reward, a controller and an aircraft from outside the repository, trained and compared."""
    lines = section("The whole way")
    assert [line.split()[1] for line in lines] == ["aircraft", "policy", "pid", "compare", "image"]
    imported, trained, _, compared, _ = map(shortened, lines)
    assert "assumed: rotor.spin" in typed(imported, folder)
    typed(trained, folder)
    aircraft = load_aircraft(folder / "my_quad.toml")
    record = json.loads((folder / "runs" / "own" / "training.json").read_text())
    assert record["config"]["reward"] == {"name": "worst-axis", "change": 3.0}
    assert [each["file"] for each in record["config"]["plugins"]] == ["my_reward.py"]
    policy = read_policy(folder / "runs" / "own" / "policy.onnx")
    assert (policy.aircraft, policy.aircraft_sha256) == ("my_quad", aircraft.sha256)
    (folder / "my_gains.toml").write_text("p = 0.0008\n")
    told = json.loads(typed(compared + " --json", folder))
    assert [each["controller"] for each in told["comparison"]] == [
        "runs/own/policy.onnx",
        "my_controller.py:Rates",
        "my_controller.py:Rates:my_gains.toml",
    ]
    first, _, tuned = (np.mean(each["mae"]) for each in told["comparison"])
    assert tuned < first  # the policy has learned next to nothing


@pytest.mark.slow
def test_the_whole_way_as_printed_ends_in_an_image(folder: Path) -> None:
    for line in section("The whole way"):
        told = typed(line + (" --out image --json" if line.split()[1] == "build" else ""), folder)
    assert json.loads(told)["policy"]["aircraft"] == "my_quad"


@pytest.mark.slow
def test_an_observation_of_the_users_is_part_of_the_compiled_policy(folder: Path) -> None:
    [run, _] = section("An observation")
    typed(section("The whole way")[0], folder)
    program = folder / "my_training.py"
    program.write_text(program.read_text().replace("seed=1", "seed=1, n_steps=16"))
    typed(shortened(run), folder)
    policy = read_policy(folder / "observed.onnx")
    assert (policy.observation, policy.aircraft) == ("rate_error,rate_error_delta", "my_quad")
    weights = [
        array.shape
        for array in map(numpy_helper.to_array, onnx.load(folder / "observed.onnx").graph.initializer)
    ]
    assert policy.observation_count == 6
    assert (64, 9) in weights or (9, 64) in weights  # the first layer sees three values more
    assert main(["policy", "compile", str(folder / "observed.onnx"), "--out", str(folder / "c")]) == 0


def test_gymnasium_takes_the_same_objects(folder: Path) -> None:
    program = (
        "import gymnasium, numpy as np\n"
        "from my_reward import WorstAxis\nfrom my_task import Sines\n"
        "name, own = 'neuroflight/Attitude-v0', {'reward': WorstAxis(), 'task': Sines(duration_s=0.1)}\n"
        "one, many = gymnasium.make(name, **own), gymnasium.make_vec(name, 2, 'async', **own)\n"
        "two = gymnasium.make(name, reward='worst-axis', task={'name': 'sines', 'duration_s': 0.1})\n"
        "rewards = []\n"
        "for env in (one, two):\n"
        "    env.reset(seed=1)\n"
        "    rewards.append([env.step(np.full(4, 0.1, np.float32))[1] for _ in range(100)])\n"
        "many.reset(seed=1); many.step(many.action_space.sample()); many.close()\n"
        "assert rewards[0] == rewards[1] and len(set(rewards[0])) > 90\n"
    )
    (folder / "program.py").write_text(program)
    typed("python program.py", folder)
