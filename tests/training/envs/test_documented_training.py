"""docs/guides/gymnasium.md's lines: Stable-Baselines3's PPO with its defaults learns a policy that flies."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.toolchain.policy.model import read_policy
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "guides" / "gymnasium.md"
MAE_MAX_DEG_S = 10.0  # mean of the axes, on 1000 unseen pulses; the first policy of a run has hundreds


def snippet() -> str:
    (found,) = map(str, re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL))
    return found


def run(code: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the lines in `folder`, as a program of their own would."""
    monkeypatch.chdir(folder)
    exec(compile(code, str(PAGE), "exec"), {"__name__": "__main__"})


@pytest.mark.slow
def test_the_lines_make_a_policy_of_the_environments_task(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = re.sub(r"learn\([\d_]+\)", "learn(1)", snippet()).replace("seed=1", "seed=1, n_steps=64")
    run(short, tmp_path, monkeypatch)
    policy = read_policy(tmp_path / "policy.onnx")
    assert (policy.observation, policy.control_rate_hz) == ("rate_error,rate_error_delta", 1000)
    assert (policy.idle, policy.mix.text, policy.aircraft) == (0.055, "centred", "nf1")
    assert main(["policy", "compile", str(tmp_path / "policy.onnx"), "--out", str(tmp_path / "c")]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_lines_learn_to_fly(
    seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "seed=1" in snippet()
    run(snippet().replace("seed=1", f"seed={seed}"), tmp_path, monkeypatch)
    capsys.readouterr()
    assert (
        main(["evaluate", str(tmp_path / "policy.onnx"), "--task", "pulse", "--episodes", "1000", "--json"])
        == 0
    )
    errors = json.loads(capsys.readouterr().out)["mae"]
    print(f"seed {seed}: MAE {errors} deg/s")
    assert sum(errors) / len(errors) < MAE_MAX_DEG_S
