"""What the operating system refuses reaches the user as one line, and leaves nothing half written."""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import neuroflight.cli.policy.train
from neuroflight.cli.main import main
from tests.sampling import sampled

ROOT = Path(__file__).resolve().parents[2]
Capture = pytest.CaptureFixture[str]
TINY = [
    *(
        "--set",
        "selection.fit=false",
        "task=episodic",
        "task.hold_s=0.05",
        "hidden=[8,8]",
        "algorithm.aircraft=8",
        "algorithm.leg=1",
    ),
    *("algorithm.horizon=16", "algorithm.minibatch=64", "--algorithm", "ppo", "--steps", "128"),
]
SLOW = 120  # s; a command ends in a few, unless it waits for ever


def command(
    *words: str | Path, stdout: object = subprocess.PIPE, **how: object
) -> subprocess.CompletedProcess[str]:
    """A `neuroflight` of its own: limits and standard streams are those of a process."""
    line = [sys.executable, "-m", "neuroflight.cli.main", *map(str, words)]
    return subprocess.run(  # type: ignore[call-overload, no-any-return]
        line, cwd=ROOT, stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=SLOW, **how
    )


def one_line(done: subprocess.CompletedProcess[str]) -> str:
    """What a command that failed said."""
    assert done.returncode == 1
    assert done.stderr.startswith("neuroflight: ")
    assert done.stderr.count("\n") == 1
    return done.stderr


def no_large_files(size: int) -> Callable[[], None]:
    """To a command the same as a full disk."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def test_the_command_says_so_when_stdout_is_full() -> None:
    with Path("/dev/full").open("w") as full:
        line = one_line(command("aircraft", "check", "nf1", stdout=full))
    assert "No space left on device; make room there" in line


def test_the_command_says_so_before_the_work_when_stdout_is_closed() -> None:
    line = one_line(command("aircraft", "check", "nf1", stdout=None, preexec_fn=lambda: os.close(1)))
    assert "stdout is closed" in line


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
    words: list[str], why: str, tmp_path: Path
) -> None:
    out = tmp_path / ("x" * 5000 if why == "long name" else "result")
    limit = no_large_files(4096) if why == "no room" else None
    line = one_line(command(*(word.format(out=out) for word in words), preexec_fn=limit))
    assert ("File too large" if limit else "File name too long; choose a shorter name") in line
    assert str(tmp_path) in line
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_when_the_room_ends_while_a_file_is_written(tmp_path: Path) -> None:
    out = tmp_path / "data.csv"
    line = one_line(command("dyno", "run", "--out", out, preexec_fn=no_large_files(100_000)))
    assert line.startswith(f"neuroflight: {out}: File too large; ")
    assert list(tmp_path.iterdir()) == []


def test_the_figures_of_a_flight_are_told_when_the_room_ends_while_it_is_kept(
    host_program: Path, tmp_path: Path
) -> None:
    trace, story = tmp_path / "trace.npz", tmp_path.with_name("story.toml")
    story.write_text("[[segment]]\nduration_s = 2.5\nsetpoint_deg_s = [50, 0, 0]\n")
    words: list[str | Path] = ["fly", "--scenario", story, "--build", host_program.parent, "--trace", trace]
    done = command(*words, preexec_fn=no_large_files(100_000))
    assert one_line(done).startswith(f"neuroflight: {trace}: File too large; ")
    assert "MAE, deg/s" in done.stdout
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
    words: list[str], kind: str, tmp_path: Path
) -> None:
    pipe = Path("/dev/zero")
    if kind == "pipe":
        pipe = tmp_path / "pipe"
        os.mkfifo(pipe)
    one_line(command(*(word.format(pipe=pipe) for word in words)))


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


def test_a_read_only_place_is_told_before_the_work(read_only: Path) -> None:
    line = one_line(command("dyno", "run", "--out", read_only / "data.csv"))
    assert "choose another place" in line


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
    assert main(words) == 1
    error = capsys.readouterr().err
    assert error.startswith("neuroflight: ")
    assert error.count("\n") == 1


def test_an_error_is_cut_when_it_quotes_at_length(capsys: Capture) -> None:
    model = str(ROOT / "training/policies/nf1/policy.onnx")
    claims = ["--observation", "x" * 100_000, "--rate", "1000", "--aircraft", "nf1"]
    assert main(["policy", "import", model, *claims, "--out", "unused.onnx"]) == 1
    error = capsys.readouterr().err
    assert "unknown observation block 'xxx" in error
    assert len(error) < 3000
