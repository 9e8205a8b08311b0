"""Steps as processes, several at a time; a finished step is not repeated.

A step's folder is OUT/BUDGET/NAME with what its command writes, OUT/BUDGET/NAME.json holds what it printed
and OUT/BUDGET/NAME.png its picture. A result is kept as long as the command has the same words and the files
that they name have the same content. A training that was interrupted goes on from its last checkpoint.
"""

from __future__ import annotations

import json
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

from neuroflight.toolchain.files import file_size, write_text
from neuroflight.training.reproduction.experiments import (
    FOLDER,
    OUT,
    PLOT,
    Budget,
    ReproduceError,
    Step,
    command,
)
from neuroflight.training.reproduction.inputs import changed, inputs

OUTPUT_BYTES_MAX = 64 << 20
PICTURES = ("view",)  # commands that draw and print no JSON
RESUMED = ("policy train", "policy sweep")  # commands that go on with what their --out holds
LAST_SAID = 300  # characters of a failed command's last line
POLL_S = 0.2  # between looks at a process and at the wish to stop


@dataclass(frozen=True)
class Done:
    """A step that has been run."""

    step: Step
    budget: Budget
    command: str  # as a user would type it
    seconds: float
    output: Any  # the JSON that it printed
    picture: Path | None


@dataclass(frozen=True)
class StepOutputs:
    """The folder of the results of a budget's steps."""

    root: Path  # the project's folder, in which commands run
    out: Path
    budget: Budget
    renewed: Callable[[Sequence[str]], list[str]] = list  # today's words for those that a kept result has

    def folder(self, name: str) -> Path:
        """Return the folder that the step's command writes into."""
        return self.out / self.budget / name

    def output(self, name: str) -> Path:
        """Return the file of what the step printed, with its command."""
        return self.out / self.budget / f"{name}.json"

    def picture(self, name: str) -> Path:
        """Return the picture that the step drew."""
        return self.out / self.budget / f"{name}.png"

    def words(self, step: Step) -> list[str]:
        """Return the words of a step's command, after `neuroflight`."""

        def filled(word: str) -> str:
            return FOLDER.sub(lambda found: self._path(step, found[1]), word)

        return [filled(word) for word in step.words(self.budget)]

    def inputs(self, step: Step) -> dict[str, str]:
        """Return digests of the files that the command reads, see `inputs`; not of those it writes."""
        pairs = zip(step.words(self.budget), self.words(step), strict=True)
        read = [word for raw, word in pairs if not {OUT, PLOT} & set(FOLDER.findall(raw))]
        return inputs(read, self.root)

    def _path(self, step: Step, name: str) -> str:
        path = self.picture(step.name) if name == PLOT else self.folder(step.name if name == OUT else name)
        # Commands run in `root`: what is inside it has the same name wherever the project lies.
        return str(path.relative_to(self.root) if path.is_relative_to(self.root) else path)


class Watcher:
    """Called while steps run, from one thread; a subclass overrides what it needs."""

    def started(self, step: Step) -> None:
        """Hear that a step's command has begun."""

    def finished(self, done: Done, *, again: bool) -> None:
        """Hear that a step has its result; `again` is False if it was there already."""

    def outdated(self, step: Step, name: str) -> None:
        """Hear that a result is outdated, because the input `name` has changed; the step is run again."""

    def failed(self, step: Step, reason: str) -> None:
        """Hear that a step failed; steps that need it are left out."""


Execute = Callable[[Sequence[str], Path, Callable[[], bool]], str]  # words, folder, stop? -> stdout


def run_steps(
    plan: Sequence[Step],
    outputs: StepOutputs,
    *,
    jobs: int,
    force: bool = False,
    execute: Execute | None = None,
    watcher: Watcher | None = None,
) -> Mapping[str, Done]:
    """Run what has no result yet, at most `jobs` at a time; the results by the steps' names.

    plan: each step after those that it needs. force: repeat finished ones too. execute: runs one command;
    None: in a process of this machine. A step that fails is reported to `watcher` and left out, with all that
    need it. On KeyboardInterrupt the commands are asked to stop, so that trainings keep their state.
    """
    watcher, execute = watcher or Watcher(), execute or execute_here
    done: dict[str, Done] = {}
    lost: set[str] = set()
    if not force:
        for step in plan:
            kept = (
                None if any(name not in done for name in step.needs) else kept_result(step, outputs, watcher)
            )
            if kept is not None:
                done[step.name] = kept
                watcher.finished(kept, again=False)
    open_steps = [step for step in plan if step.name not in done]
    stop = Event()
    active: dict[Future[Done], Step] = {}
    with ThreadPoolExecutor(jobs, "step") as pool:
        try:
            while open_steps or active:
                for step in list(open_steps):
                    if any(name in lost for name in step.needs):
                        open_steps.remove(step)
                        lost.add(step.name)
                        watcher.failed(step, f"needs {', '.join(n for n in step.needs if n in lost)}")
                    elif len(active) < jobs and all(name in done for name in step.needs):
                        open_steps.remove(step)
                        active[pool.submit(_run, step, outputs, execute, stop)] = step
                        watcher.started(step)
                for future in wait(active, return_when=FIRST_COMPLETED).done if active else ():
                    step = active.pop(future)
                    try:
                        done[step.name] = future.result()
                        watcher.finished(done[step.name], again=True)
                    except ReproduceError as error:
                        lost.add(step.name)
                        watcher.failed(step, str(error))
        except BaseException:
            stop.set()
            raise
    return done


def kept_result(step: Step, outputs: StepOutputs, watcher: Watcher) -> Done | None:
    """Return the stored result of a step, if it is of the same command and inputs."""
    path = outputs.output(step.name)
    if not path.is_file() or file_size(path) > OUTPUT_BYTES_MAX:
        return None
    try:
        record = json.loads(path.read_text())
        if outputs.renewed(record["words"]) != outputs.words(step):
            return None
        if other := changed(record["inputs"], outputs.inputs(step)):
            watcher.outdated(step, other)
            return None
        picture = outputs.picture(step.name) if step.draws else None
        if picture is not None and not picture.is_file():
            return None
        return Done(
            step, outputs.budget, _typed(record["words"]), float(record["seconds"]), record["output"], picture
        )
    except (ValueError, KeyError, TypeError, AttributeError, OSError):
        return None


def _run(step: Step, outputs: StepOutputs, execute: Execute, stop: Event) -> Done:
    words = outputs.words(step)
    read = outputs.inputs(step)
    folder = outputs.folder(step.name)
    started = folder.with_suffix(".started")
    now = {"words": words, "inputs": read}
    folder.parent.mkdir(parents=True, exist_ok=True)
    more: list[str] = []
    if command(words)[0] not in RESUMED:
        folder.mkdir(parents=True, exist_ok=True)
    elif folder.exists():
        if _started(started, outputs) == now and _begun(folder):
            more = ["--resume"]
        else:
            shutil.rmtree(folder)
    write_text(started, json.dumps(now))
    began = time.monotonic()
    plain = words[0] in PICTURES
    text = execute([*words, *more, *(() if plain else ("--json",))], outputs.root, stop.is_set)
    seconds = time.monotonic() - began
    try:
        output = {} if plain else json.loads(text)
    except ValueError as error:
        raise ReproduceError(f"{_typed(words)}: printed no JSON ({error})") from error
    record = {"words": words, "inputs": read, "seconds": round(seconds, 1), "output": output}
    write_text(outputs.output(step.name), json.dumps(record, indent=1) + "\n")
    picture = outputs.picture(step.name) if step.draws else None
    return Done(step, outputs.budget, _typed(words), seconds, output, picture)


def _started(path: Path, outputs: StepOutputs) -> object:
    """Return the words and inputs of the command that began last; None if that is unknown."""
    try:
        before = json.loads(path.read_text())
        return {**before, "words": outputs.renewed(before["words"])}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _begun(folder: Path) -> bool:
    """Return True if a training or a sweep has left something to go on with."""
    return (
        any(folder.glob("checkpoint.pt"))
        or any(folder.glob("seed-*/checkpoint.pt"))
        or (folder / "trials").is_dir()
    )


def _typed(words: Sequence[str]) -> str:
    return shlex.join(["neuroflight", *words])


def execute_here(words: Sequence[str], folder: Path, stop: Callable[[], bool]) -> str:
    """Run a command in a process of its own. Raises ReproduceError with its last message if it fails."""
    process = subprocess.Popen(
        [sys.executable, "-m", "neuroflight.cli.main", *words],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C is for us: we ask it to stop
    )
    while True:
        try:
            printed, said = process.communicate(timeout=POLL_S)
            break
        except subprocess.TimeoutExpired:
            if stop():
                process.send_signal(signal.SIGINT)
                process.communicate()
                raise ReproduceError(f"{_typed(words)}: stopped") from None
    if process.returncode:
        last = (said.strip().splitlines() or ["it said nothing"])[-1][:LAST_SAID]
        raise ReproduceError(f"`{_typed(words)}` ended with {process.returncode}: {last}")
    return printed
