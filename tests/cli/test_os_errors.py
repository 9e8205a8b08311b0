"""What the operating system refuses reaches the user as one line, and leaves nothing half written."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import neuroflight.cli.policy.train
from neuroflight.cli.main import main
from tests.cli.test_train import TINY as TRAINING
from tests.refusal import refused
from tests.sampling import sampled

ROOT = Path(__file__).resolve().parents[2]
Capture = pytest.CaptureFixture[str]
TINY = [*TRAINING, "selection.fit=false", "--algorithm", "ppo", "--steps", "128"]
SLOW = 600  # s; a command ends in a few, on a busy machine in a minute, unless it waits for ever
CHECK = [sys.executable, "-m", "neuroflight.cli.main", "aircraft", "check", "nf1"]


@pytest.fixture(autouse=True)
def ends() -> Iterator[None]:
    """Fail a test whose command waits for ever."""

    def late(*_: object) -> None:
        pytest.fail(f"the command has not ended after {SLOW} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SLOW)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def no_large_files(size: int) -> Iterator[None]:
    """Give this process what is to a command the same as a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_the_command_says_so_when_stdout_is_full() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(CHECK, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1 and "No space left on device; make room there" in done.stderr


def test_the_command_says_so_before_the_work_when_stdout_is_closed() -> None:
    done = subprocess.run(CHECK, stderr=subprocess.PIPE, text=True, preexec_fn=lambda: os.close(1))
    assert done.returncode == 1 and "stdout is closed" in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ["dyno", "run", "--out", "{out}.csv"],
        ["fly", "--trace", "{out}.npz"],
        ["fly", "--report", "{out}.html"],
        ["policy", "train", "--out", "{out}", *TINY],
        ["image", "build", "--target", "HOST", "--out", "{out}"],
        ["policy", "compile", "training/policies/nf1/policy.onnx", "--out", "{out}"],
        ["policy", "import", "training/policies/nf1/checkpoint.pt", "--out", "{out}.onnx"],
    ],
)
@pytest.mark.parametrize("why", sampled(["no room", "long name"], "no room"))
def test_a_place_that_takes_no_file_is_told_before_the_work(
    words: list[str], why: str, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / ("x" * 5000 if why == "long name" else "result")
    with no_large_files(4096) if why == "no room" else contextlib.nullcontext():
        line = refused(capsys, [word.format(out=out) for word in words])
    told = {"no room": "File too large", "long name": "File name too long; choose a shorter name"}
    assert told[why] in line
    assert str(tmp_path) in line
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_when_the_room_ends_while_a_file_is_written(tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "data.csv"
    with no_large_files(100_000):
        line = refused(capsys, ["dyno", "run", "--out", out])
    assert line.startswith(f"neuroflight: {out}: File too large; ")
    assert list(tmp_path.iterdir()) == []


def test_the_figures_of_a_flight_are_told_when_the_room_ends_while_it_is_kept(
    host_program: Path, tmp_path: Path, capsys: Capture
) -> None:
    trace, story = tmp_path / "trace.npz", tmp_path.with_name("story.toml")
    story.write_text("[[segment]]\nduration_s = 2.5\nsetpoint_deg_s = [50, 0, 0]\n")
    words = ["fly", "--scenario", str(story), "--build", str(host_program.parent), "--trace", str(trace)]
    with no_large_files(100_000):
        assert main(words) == 1
    told = capsys.readouterr()
    assert told.err.startswith(f"neuroflight: {trace}: File too large; ") and told.err.count("\n") == 1
    assert "MAE, deg/s" in told.out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ["policy", "verify", "{pipe}"],
        ["policy", "compile", "{pipe}", "--explain"],
        ["policy", "import", "{pipe}", "--out", "policy.onnx"],
        ["policy", "time", "{pipe}"],
        ["image", "build", "--target", "HOST", "--policy", "{pipe}", "--out", "build-of-a-pipe"],
        ["image", "emulate", "--image", "{pipe}"],
        ["image", "emulate", "--flash", "{pipe}"],
        ["compare", "{pipe}"],
        ["aircraft", "check", "{pipe}"],
        ["dyno", "fit", "{pipe}"],
        ["aircraft", "noise", "{pipe}"],
        ["policy", "train", "--config", "{pipe}", "--out", "out-of-a-pipe"],
        ["fly", "--scenario", "{pipe}"],
    ],
)
@pytest.mark.parametrize("kind", sampled(["pipe", "device"], "pipe"))
def test_a_command_ends_at_once_when_its_input_never_does(
    words: list[str], kind: str, tmp_path: Path, capsys: Capture
) -> None:
    pipe = Path("/dev/zero")
    if kind == "pipe":
        pipe = tmp_path / "pipe"
        os.mkfifo(pipe)
    refused(capsys, [word.format(pipe=pipe) for word in words])


@pytest.mark.slow
def test_a_second_training_is_refused_when_the_first_runs(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second begins where the first has planned and not yet written anything."""
    words = ["policy", "train", "--out", str(tmp_path / "out"), *TINY]
    train = neuroflight.cli.policy.train._train
    codes: list[int | None] = []

    def interrupted_by_another(*args: object) -> object:
        if not codes:
            codes.append(None)
            codes[0] = main(words)
        return train(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(neuroflight.cli.policy.train, "_train", interrupted_by_another)
    assert main(words) == 0
    assert codes == [1]
    error = capsys.readouterr().err
    assert f"neuroflight: {tmp_path / 'out'} is in use by another training; wait" in error


@pytest.fixture
def read_only(tmp_path: Path) -> Path:
    """A folder that nobody may write in, not even the superuser."""
    folder = tmp_path / "read-only"
    folder.mkdir()
    folder.chmod(0o555)
    with contextlib.suppress(PermissionError):
        (folder / "probe").touch()
        pytest.skip("the superuser writes anywhere")
    return folder


def test_a_read_only_place_is_told_before_the_work(read_only: Path, capsys: Capture) -> None:
    assert "choose another place" in refused(capsys, ["dyno", "run", "--out", read_only / "data.csv"])


@pytest.mark.parametrize(
    "words",
    [
        ["aircraft", "check", "nf1", "--draw", "a\0b.png"],
        ["fly", "--trace", "a\0b.npz"],
        ["image", "build", "--policy", "a\0b"],
        ["image", "build", "--target", "HOST", "--out", "a\0b"],
        ["policy", "compile", "training/policies/nf1/policy.onnx", "--out", "a\0b"],
        ["policy", "import", "training/policies/nf1/checkpoint.pt", "--out", "a\0b.onnx"],
        ["policy", "import", "a\0b", "--out", "policy.onnx"],
        ["policy", "verify", "a\0b"],
        ["policy", "time", "a\0b"],
        ["policy", "train", "--out", "a\0b"],
        ["image", "emulate", "--flash", "a\0b"],
    ],
)
def test_a_name_that_no_file_can_have_is_one_line(words: list[str], capsys: Capture) -> None:
    refused(capsys, words)


def test_an_error_is_cut_when_it_quotes_at_length(capsys: Capture) -> None:
    model = str(ROOT / "training/policies/nf1/policy.onnx")
    claims = ["--observation", "x" * 100_000, "--rate", "1000", "--aircraft", "nf1"]
    assert main(["policy", "import", model, *claims, "--out", "unused.onnx"]) == 1
    error = capsys.readouterr().err
    assert "unknown observation block 'xxx" in error
    assert len(error) < 3000
