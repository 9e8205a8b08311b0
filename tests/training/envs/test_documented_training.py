"""docs/guides/gymnasium.md's lines: Stable-Baselines3's PPO with its defaults learns a policy that flies."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.toolchain.policy.model import read_policy
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "guides" / "gymnasium.md"
MAE_MAX_DEG_S = 10.0  # mean of the axes, on 1000 unseen pulses; the first policy of a run has hundreds
SECONDS_MAX = 3600  # a busy machine has taken a quarter of it


def snippet() -> str:
    (found,) = map(str, re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL))
    return found


def run(code: str, folder: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=SECONDS_MAX,
    )
    assert done.returncode == 0, done.stderr[-3000:]


def test_the_lines_make_a_policy_of_the_environments_task(tmp_path: Path) -> None:
    run(re.sub(r"learn\([\d_]+\)", "learn(1)", snippet()).replace("seed=1", "seed=1, n_steps=64"), tmp_path)
    policy = read_policy(tmp_path / "policy.onnx")
    assert (policy.observation, policy.control_rate_hz) == ("rate_error,rate_error_delta", 1000)
    assert (policy.idle, policy.mix.text, policy.aircraft) == (0.055, "centred", "nf1")
    assert main(["policy", "compile", str(tmp_path / "policy.onnx"), "--out", str(tmp_path / "c")]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_lines_learn_to_fly(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "seed=1" in snippet()
    run(snippet().replace("seed=1", f"seed={seed}"), tmp_path)
    capsys.readouterr()
    assert (
        main(["evaluate", str(tmp_path / "policy.onnx"), "--task", "pulse", "--episodes", "1000", "--json"])
        == 0
    )
    errors = json.loads(capsys.readouterr().out)["mae"]
    print(f"seed {seed}: MAE {errors} deg/s")
    assert sum(errors) / len(errors) < MAE_MAX_DEG_S
