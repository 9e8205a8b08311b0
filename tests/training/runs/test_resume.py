"""A run in its own process is interrupted or killed and resumed: the same bytes in the end."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.toolchain.policy.model import read_policy

ROOT = Path(__file__).resolve().parents[3]
Capture = pytest.CaptureFixture[str]

SAME = ("checkpoint.pt", "policy.onnx", "monitor.json", "rewards.csv")
SHORT = ["selection.fit=false", "hidden=[8,8]", "task=episodic", "task.hold_s=0.05"]
RUNS = {  # eight segments each, a checkpoint every second
    "ppo": [
        *("steps=1024", "checkpoint_steps=256", "algorithm=ppo", "algorithm.aircraft=8"),
        *("algorithm.horizon=16", "algorithm.minibatch=64", "algorithm.leg=1", "world.throttle_steps=0"),
    ],
    "ppo1": [
        *("steps=1024", "checkpoint_steps=256", "algorithm=ppo1", "algorithm.aircraft=8"),
        *("algorithm.horizon=16", "algorithm.minibatch=50", "algorithm.leg=1", "world.throttle_steps=0"),
    ],
    "ddpg1": [
        *("steps=1280", "checkpoint_steps=320", "algorithm=ddpg1", "algorithm.aircraft=8"),
        *("algorithm.horizon=5", "algorithm.updates=5", "algorithm.buffer=700", "algorithm.leg=4"),
        *("output.squash=true", "world.throttle_steps=0"),
    ],
    "pathwise": [
        *("steps=1600", "checkpoint_steps=400", "algorithm=pathwise", "algorithm.aircraft=4"),
        *("algorithm.leg_steps=200", "algorithm.warm_up=5"),
    ],
}
STOPPED_AT = 0.7  # of the run: within the sixth segment
# The command in a process that sends itself a signal when it has come that far.
SCRIPT = """
import os, signal, sys
from neuroflight.cli.policy import train_display
from neuroflight.cli.main import main

class Stopped(train_display.Display):
    def progressed(self, progress):
        super().progressed(progress)
        if progress.steps >= STOPPED_AT * progress.steps_wanted:
            os.kill(os.getpid(), SIGNAL)

train_display.Display = Stopped
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs begin without it
if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
"""


def train(algorithm: str, out: Path, *options: str) -> list[str]:
    """Arguments of the command."""
    settings = [word for key in (*SHORT, *RUNS[algorithm]) for word in ("--set", key)]
    return ["policy", "train", "--out", str(out), *settings, *options]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder of a run without interruption, by algorithm."""

    @cache
    def folder(algorithm: str) -> Path:
        out = tmp_path_factory.mktemp("undisturbed") / algorithm
        assert main(train(algorithm, out)) == 0
        return out

    return folder


@pytest.mark.parametrize(
    ("algorithm", "stop"),
    [
        ("pathwise", signal.SIGKILL),
        pytest.param("ppo", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("ppo", signal.SIGKILL, marks=pytest.mark.slow),
        pytest.param("ppo1", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("ddpg1", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("pathwise", signal.SIGINT, marks=pytest.mark.slow),
    ],
)
def test_the_bytes_are_those_of_an_undisturbed_run_when_it_was_stopped_and_resumed(
    algorithm: str, stop: signal.Signals, undisturbed: Callable[[str], Path], tmp_path: Path
) -> None:
    whole, parted = undisturbed(algorithm), tmp_path / "parted"
    script = tmp_path / "stopped.py"
    script.write_text(SCRIPT.replace("STOPPED_AT", str(STOPPED_AT)).replace("SIGNAL", str(int(stop))))
    # Ends only when nobody holds its pipes any more: the monitor's process is gone too.
    done = subprocess.run(
        [sys.executable, str(script), *train(algorithm, parted)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=300,
    )
    interrupted = stop == signal.SIGINT
    assert done.returncode == (130 if interrupted else -signal.SIGKILL)
    assert "Traceback" not in done.stdout + done.stderr
    assert ("--resume goes on" in done.stderr) == interrupted
    record = json.loads((parted / "training.json").read_text())
    assert record["complete"] is False
    # Five whole segments are done; a process that is killed keeps its last checkpoint alone.
    assert record["steps"] == record["config"]["steps"] // 8 * (5 if interrupted else 4)
    assert read_policy(parted / "policy.onnx").action_count == 4
    (parted / ".checkpoint.pt.torn.pt").write_bytes(b"half of")  # as if killed while it wrote
    assert main(train(algorithm, parted, "--resume")) == 0
    assert [(parted / name).read_bytes() for name in SAME] == [(whole / name).read_bytes() for name in SAME]
    assert sorted(path.name for path in parted.iterdir()) == sorted(path.name for path in whole.iterdir())
    assert json.loads((parted / "training.json").read_text())["complete"] is True


@pytest.fixture(scope="module")
def complete(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The words of a run that is over."""
    words = train("ppo", tmp_path_factory.mktemp("complete"), "--set", "steps=128")
    assert main(words) == 0
    return words


def test_a_run_that_is_complete_says_so_when_resumed(complete: list[str], capsys: Capture) -> None:
    words, out = complete, Path(complete[3])
    made = {path.name: path.read_bytes() for path in out.iterdir()}
    assert main([*words, "--resume"]) == 0
    assert "was complete: 128 steps; nothing was left to train" in capsys.readouterr().out
    assert {path.name: path.read_bytes() for path in out.iterdir()} == made


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--set", "reward.output=0.7"], "was trained with reward"),
        (["--seed", "9"], "was trained with seed 1, got 9"),
        (["--aircraft", "hexa"], "was trained with aircraft"),
    ],
)
def test_resuming_is_rejected_when_the_configuration_is_another(
    options: list[str], message: str, complete: list[str], capsys: Capture
) -> None:
    words, out = complete, Path(complete[3])
    made = {path.name: path.read_bytes() for path in out.iterdir()}
    assert main([*words, *options, "--resume"]) == 1
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert {path.name: path.read_bytes() for path in out.iterdir()} == made
