"""A sweep on a real Ray session: a worker is killed, the sweep is stopped and resumed."""

import json
import os
import signal
import socket
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from neuroflight.training.runs.train import Callback
from neuroflight.training.sweeps.config import Sweep, load_sweep
from neuroflight.training.sweeps.jobs import SweepCallback, request_stop
from neuroflight.training.sweeps.ray_workers import LOCAL, ray_session
from neuroflight.training.sweeps.run import run_sweep
from neuroflight.training.sweeps.trial import run_trial

pytestmark = [
    pytest.mark.slow,  # five processes begin, one after the other
    # Not by importing it: what a session listens on is settled before that.
    pytest.mark.skipif(find_spec("ray") is None, reason="Ray Tune is not installed"),
]

CHECKPOINT_STEPS = 1024
FILE = f"""
aircraft = "nf1"
[set]
steps = 4096
checkpoint_steps = {CHECKPOINT_STEPS}
hidden = [8, 8]
algorithm.aircraft = 16
algorithm.horizon = 32
algorithm.minibatch = 128
algorithm.leg = 1
task.idle_s = 0.05
task.command_s = 0.1
task.rest_s = 0.1
[vary]
seed = [1, 2]
[validation]
task = "episodic"
episodes = 2
"""


@dataclass
class Story(SweepCallback):
    """Kills the first run's worker once it has a checkpoint, and stops the sweep when that run is done."""

    out: Path
    heard: list[tuple[int, int, int]] = field(default_factory=list)  # number, steps, process
    restarts: list[int] = field(default_factory=list)
    killed_at: int = 0  # steps; 0: not yet

    def progressed(self, number: int, steps: int, reward: float, pid: int) -> None:
        self.heard.append((number, steps, pid))
        if number == 1 and not self.killed_at and any(self.out.glob("trials/1-*/checkpoint.pt")):
            self.killed_at = steps
            os.kill(pid, signal.SIGKILL)

    def finished(self, number: int) -> None:
        request_stop(self.out)

    def restarted(self, number: int) -> None:
        self.restarts.append(number)


@dataclass
class Told:
    """The result of the disturbed sweep."""

    sweep: Sweep
    out: Path
    story: Story
    stopped: dict[str, Any]  # sweep.json after the stop
    resumed: list[int]  # runs that were at work afterwards
    first: dict[str, int]  # dates of the files of run 1 before it was resumed


class Heard(SweepCallback):
    """Records which runs are active."""

    def __init__(self) -> None:
        self.numbers: list[int] = []

    def progressed(self, number: int, steps: int, reward: float, pid: int) -> None:
        self.numbers.append(number)


def dates(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


def descendants(pid: int) -> set[int]:
    """All descendants of the process `pid`."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended meanwhile
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
    found: set[int] = set()
    while new := {child for child, parent in parents.items() if parent in {pid, *found}} - found:
        found |= new
    return found


def listening(pid: int) -> set[str]:
    """Addresses on which a process accepts TCP connections."""
    inodes, found = set(), set()
    with suppress(OSError):
        for entry in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):
                inodes.add(str(entry.readlink()).removeprefix("socket:[").removesuffix("]"))
        for name in ("tcp", "tcp6"):
            for line in Path(f"/proc/{pid}/net/{name}").read_text().splitlines()[1:]:
                fields = line.split()
                if fields[3] == "0A" and fields[9] in inodes:
                    digits = fields[1].partition(":")[0][-8:]  # of tcp6 the IPv4 address inside
                    found.add(socket.inet_ntoa(bytes.fromhex(digits)[::-1]))
    return found


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Told]:
    """One sweep of two runs in one Ray session, with a killed worker, a stop and a resumption."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "study.toml").write_text(FILE)
    sweep, out = load_sweep(folder / "study.toml"), folder / "out"
    with ray_session(LOCAL, 1):
        story = Story(out)
        with pytest.raises(KeyboardInterrupt):
            run_sweep(sweep, out, cpus=1, address=LOCAL, callback=story)
        stopped = json.loads((out / "sweep.json").read_text())
        first = dates(out / "trials" / sweep.trials[0].folder)
        heard = Heard()
        run_sweep(sweep, out, cpus=1, address=LOCAL, resume=True, callback=heard)
        yield Told(sweep, out, story, stopped, heard.numbers, first)


def test_run_continues_from_its_checkpoint_when_its_worker_is_killed(told: Told) -> None:
    assert told.story.killed_at
    assert told.story.restarts == [1]
    processes = [pid for number, _, pid in told.story.heard if number == 1]
    after = [steps for number, steps, pid in told.story.heard if number == 1 and pid == processes[-1]]
    assert processes[-1] != processes[0]
    assert after[0] > CHECKPOINT_STEPS


def test_result_is_that_of_an_undisturbed_run_when_a_worker_was_killed(told: Told, tmp_path: Path) -> None:
    trial = told.sweep.trials[0]
    outcome = run_trial(trial, told.sweep.aircraft, told.sweep.validation, tmp_path, Callback())
    folder = told.out / "trials" / trial.folder
    for name in ("checkpoint.pt", "policy.onnx"):
        assert (folder / name).read_bytes() == (tmp_path / name).read_bytes()
    result = json.loads((folder / "result.json").read_text())["outcome"]
    undisturbed = json.loads(json.dumps(asdict(replace(outcome, training_seconds=0))))
    assert {**result, "training_seconds": 0} == undisturbed
    assert outcome.instructions is None or outcome.instructions > 0


def test_record_says_what_is_open_when_the_sweep_was_stopped(told: Told) -> None:
    assert [run["state"] for run in told.stopped["runs"]] == ["done", "open"]
    assert told.stopped["complete"] is False
    assert not (told.out / "stop").exists()


def test_only_the_open_run_is_done_when_the_sweep_is_resumed(told: Told) -> None:
    assert set(told.resumed) == {2}
    assert dates(told.out / "trials" / told.sweep.trials[0].folder) == told.first
    record = json.loads((told.out / "sweep.json").read_text())
    assert record["complete"] is True
    assert [run["state"] for run in record["runs"]] == ["done", "done"]
    (configuration,) = record["configurations"]
    means = [run["outcome"]["mae"]["mean"] for run in record["runs"]]
    assert configuration["mae"]["mean"] == pytest.approx(sum(means) / 2)
    assert configuration["runs"] == [1, 2]
    assert (told.out / "sweep.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in told.out.iterdir()) == ["sweep.json", "sweep.png", "trials"]


def test_no_port_is_open_to_other_machines_when_the_session_is_local(told: Told) -> None:
    addresses = {address for pid in descendants(os.getpid()) for address in listening(pid)}
    assert addresses == {"127.0.0.1"}
