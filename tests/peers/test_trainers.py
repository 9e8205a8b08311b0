"""docs/guides/policies.md's table of trainers: each line exports a policy that acts as the trainer's.

Trainers that the project does not bring are installed by pip for one test and removed after it.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.toolchain.ir.interpreter import replay
from neuroflight.toolchain.policy.model import read_policy
from tests.conftest import ROOT
from tests.peers.trainer_policies import POLICIES

PAGE = ROOT / "docs" / "guides" / "policies.md"
PROGRAM = Path(__file__).with_name("trainer_policies.py")
CONSTRAINTS = (ROOT / "constraints.txt").read_text().replace("_", "-").splitlines()
# Packages that each needs and this environment lacks: pip installs only these, and the trainer uses our
# torch, as pip would choose one with CUDA. None: no torch is needed, so pip resolves everything.
NEEDS: dict[str, list[str] | None] = {
    "cleanrl": ["gym", "gym-notices", "cloudpickle"],
    "skrl": ["tqdm"],
    "rsl-rl-lib": [
        "tensordict",
        "pyvers",
        "orjson",
        "importlib_metadata",
        "zipp",
        "GitPython",
        "gitdb",
        "smmap",
    ],
    "isaaclab": ["tqdm"],
    "rl-games": ["setproctitle", "psutil", "watchdog"],
    "tianshou": [
        *("tqdm", "h5py", "numba", "llvmlite", "overrides", "sensai-utils", "deepdiff", "orderly-set"),
        *("cachebox", "pettingzoo"),
    ],
    "brax": None,
    "keras": None,
    "scikit-learn": ["joblib", "threadpoolctl", "narwhals"],
}
INSTALL_SECONDS_MAX, RUN_SECONDS_MAX = 900, 900
TOLERANCE = 2e-6  # absolute, of actions: float32 sums in another order


def section() -> str:
    found = re.search(r"^## Trainers\n(.*?)^## ", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert found is not None
    return found[1]


def table() -> dict[str, tuple[str, str, list[str]]]:
    """Return the rows by first cell: packages it was tried with, the line that exports, options of freeze."""
    rows = re.findall(r"^\| ([^|]+) \| `([^`]+)` \| `([^`]+)` \| (?:`([^`]+)` )?\|$", section(), re.MULTILINE)
    return {name: (tried, line, options.split()) for name, tried, line, options in rows}


def groups() -> dict[str, list[str]]:
    """Return the names of the rows that need the same packages, by these packages."""
    found = defaultdict(list)
    for name, (tried, _, _) in table().items():
        found[tried].append(name)
    return found


def install(tried: str, folder: Path) -> None:
    """Install the packages that the project does not; skip the test where these cannot be installed."""
    wanted = [word for word in tried.split() if word not in CONSTRAINTS]
    needs = [NEEDS[word.partition("==")[0]] for word in wanted if word.partition("==")[0] in NEEDS]
    if not wanted:
        return
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--target", str(folder)]
    if None not in needs:
        command += ["--no-deps", "--ignore-requires-python", *(word for each in needs for word in each or ())]
    done = subprocess.run([*command, *wanted], capture_output=True, text=True, timeout=INSTALL_SECONDS_MAX)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
        pytest.skip(f"pip cannot install {tried}: {(lines or ['no reason given'])[-1]}")


def test_every_row_has_a_policy_that_tries_it() -> None:
    assert list(table()) == list(POLICIES)


@pytest.mark.slow
@pytest.mark.parametrize("tried", groups())
def test_a_frozen_policy_acts_as_its_trainer(tried: str, tmp_path: Path) -> None:
    packages, made = tmp_path / "packages", tmp_path / "made"
    made.mkdir()
    before = re.findall(r"^```python\n(.*?)^```$", section(), re.MULTILINE | re.DOTALL)
    lines = {name: table()[name][1] for name in groups()[tried]}
    (tmp_path / "lines.json").write_text(json.dumps({"before": "".join(before), "lines": lines}))
    try:
        install(tried, packages)
        done = subprocess.run(
            [sys.executable, str(PROGRAM), str(tmp_path / "lines.json"), str(made)],
            cwd=made,
            env=os.environ | {"PYTHONPATH": str(packages)},
            capture_output=True,
            text=True,
            timeout=RUN_SECONDS_MAX,
        )
    finally:
        shutil.rmtree(packages, ignore_errors=True)
    assert done.returncode == 0, done.stderr[-3000:]
    policies = sorted(made.iterdir())
    assert len(policies) >= len(lines)
    for folder in policies:
        check(folder)


def check(folder: Path) -> None:
    """Freeze what a trainer exported, compare all actions and compile it."""
    answers = np.load(folder / "answers.npz")
    *_, options = table()[str(answers["row"])]
    claims = ["--observation", "rate_error,rate_error_delta", "--rate", "1000", "--aircraft", "nf1"]
    frozen = folder / "policy.onnx"
    assert (
        main(["policy", "import", str(folder / "actor.onnx"), *claims, *options, "--out", str(frozen)]) == 0
    ), folder.name
    actions = replay(read_policy(frozen).network, answers["observations"])
    print(folder.name, "differs by", np.abs(actions - answers["actions"]).max(), "of", np.ptp(actions))
    between = (answers["actions"] > 0.0) & (answers["actions"] < 1.0)
    assert between.mean() > 0.2, f"{folder.name}: nearly all actions are limits, which tell little"
    np.testing.assert_allclose(actions, answers["actions"], rtol=0, atol=TOLERANCE, err_msg=folder.name)
    assert main(["policy", "compile", str(frozen), "--out", str(folder / "c")]) == 0, folder.name
