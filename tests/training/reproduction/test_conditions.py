"""A row says in what it was made otherwise than the dissertation's experiment, also when it wins."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from neuroflight.cli import main as command_line
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.training.dissertation.conditions import FILE, ConditionsError, conditions
from neuroflight.training.reproduction.conditions import differences
from neuroflight.training.reproduction.experiments import (
    ExperimentRow,
    Experiments,
    Source,
    command,
    experiments,
    parse,
)
from neuroflight.training.reproduction.page import differing
from neuroflight.training.reproduction.steps import StepOutputs
from neuroflight.training.reproduction.stored import Result, read_stored, row_result
from neuroflight.training.reproduction.verdict import bar
from neuroflight.training.tasks.registry import TASKS

ROOT = Path(__file__).resolve().parents[3]
STORED = ROOT / "docs" / "results" / "dissertation"
RECIPES = ROOT / "training" / "recipes"
FLOWN = ("compare", "compare --one --all")
TERMS = {"aircraft", "mount", "length", "training"}


def held(known: Experiments) -> Iterator[tuple[ExperimentRow, Result]]:
    """Rows with each of their figures that has a bar."""
    kept = read_stored(STORED)
    for row in known.rows:
        for result in row_result(row, kept).results:
            if bar(result.figure) is not None:
                yield row, result


def printed(row: str) -> dict[str, Any]:
    """The dissertation's conditions as they stand in the file."""
    found: dict[str, Any] = {}
    for rows, entry in read(FILE)["experiment"].items():
        if any(fnmatchcase(row, pattern) for pattern in rows.split()):
            found |= entry
    return found


def arguments(known: Experiments, name: str, result: Result) -> Any:
    """What the command line makes of a step's words."""
    outputs = StepOutputs(ROOT, Path("out"), result.budget or "full")
    return _parsed(tuple(outputs.words(known.steps[name])))


@cache
def read(file: Path) -> dict[str, Any]:
    return tomllib.loads(file.read_text())


@cache
def _parsed(words: tuple[str, ...]) -> Any:
    return command_line.parse(words)


def trained(known: Experiments, name: str, result: Result) -> float:
    """Steps of a training: those of its words, or of its recipe."""
    args = arguments(known, name, result)
    return float(args.steps or read(RECIPES / f"{args.config}.toml")["steps"])


def expected(known: Experiments, row: ExperimentRow, result: Result) -> set[str]:
    """Terms in which the command lines of a flown figure are not as the file of conditions has it."""
    args, his = arguments(known, result.figure.ours.step, result), printed(row.name)
    found = set()
    aircraft = read(FILE)["aircraft"][Path(args.aircraft).stem]
    if aircraft.get("differs") or aircraft["of"] != his["aircraft"]:
        found.add("aircraft")
    length = args.length or (60.0 if args.commands else TASKS[args.task or "flight"]().duration_s)
    if length != his.get("length_s", length):
        found.add("length")
    steps, mounts = learnt(known, result)
    if {args.mount or "centre"} | mounts != {his["mount"]}:
        found.add("mount")
    if steps - {float(his["steps"])}:
        found.add("training")
    return found


def learnt(known: Experiments, result: Result) -> tuple[set[float], set[str]]:
    """Steps and mounts of the trainings behind a figure and what it is compared with; none behind a PID's."""
    figure = result.figure
    sources = [source for source in (figure.ours, figure.per, figure.against) if source is not None]
    found = [learnt_by(known, result, source) for source in sources]
    return set().union(*(steps for steps, _ in found)), set().union(*(mounts for _, mounts in found))


def learnt_by(known: Experiments, result: Result, source: Source) -> tuple[set[float], set[str]]:
    """The same of one of them."""
    path = source.path
    if "comparison[0]" in path:
        return set(), set()
    trainings = [name for name in known.steps[source.step].needs if name in training_steps()]
    if not trainings or "controllers[1]" in path or "comparison[2]" in path:
        told = json.loads((ROOT / "training" / "policies" / "nf1" / "training.json").read_text())["config"]
        return {float(told["steps"])}, {told["world"]["mount"]}
    recipes = [read(RECIPES / f"{arguments(known, name, result).config}.toml") for name in trainings]
    mounts = {recipe.get("world", {}).get("mount", "centre") for recipe in recipes}
    return {trained(known, name, result) for name in trainings}, mounts


@cache
def training_steps() -> set[str]:
    """Steps that train."""
    steps = experiments().steps.items()
    return {name for name, step in steps if command(step.words("full"))[0] == "policy train"}


def test_a_row_says_what_differs_whatever_its_verdict() -> None:
    known = experiments()
    seen: dict[str, int] = dict.fromkeys(TERMS, 0)
    verdicts = set()
    for row, result in held(known):
        if command(known.steps[result.figure.ours.step].words("full"))[0] not in FLOWN:
            continue
        told = {part.split()[0] for part in differing(result, row, known).split("; ") if part}
        wanted = expected(known, row, result)
        assert told & TERMS == wanted, (row.name, result.figure.what)
        for term in wanted:
            seen[term] += 1
        if wanted and result.judged:
            verdicts.add(str(result.judged.verdict.value))
    assert min(seen[term] for term in ("aircraft", "mount", "training")) > 0
    assert {"surpassed", "reached", "not reached"} <= verdicts


def test_every_row_with_a_bar_stands_beside_conditions_with_a_place_of_the_dissertation() -> None:
    rows = {row.name for row, _ in held(experiments())}
    assert len(rows) >= 30
    assert {name for name in rows if not conditions().of(name)} == set()
    heads = [line for line in FILE.read_text().splitlines() if line.startswith("[experiment.")]
    assert all(re.fullmatch(r'\[experiment\.".+"\] # (sec|tab|fig):.+', line) for line in heads)


CHAPTER_5 = """
[steps]
nf5 = '''
policy train --aircraft nf1 --config dissertation-5 --set hidden=[32,32] world.mount=rig <--steps 9000|>
--out {out}'''
flown = '''
compare pid {nf5}/policy.onnx --aircraft <hexa|nf1> --mount <centre|rig> --task pulse --episodes <7|100>'''
[rows."5.6-x"]
title = "Table 5.6: Errors"
"network" = { quote = "5.6/mae", ours = "flown comparison[1].mae", aim = "lower" }
"PID" = { quote = "5.7/mae", ours = "flown comparison[0].mae", aim = "lower" }
"""


def test_differences_are_those_of_the_budget_that_was_run() -> None:
    known = parse(CHAPTER_5, "test")
    (row,) = known.rows
    network, pid = row.figures
    assert list(map(str, differences(row.name, pid, known, "full"))) == ["aircraft nf1 (NF1)"]
    assert list(map(str, differences(row.name, network, known, "full"))) == [
        "aircraft nf1 (NF1)",
        "network 32, 32 tanh (64, 64 tanh)",
        "recipe dissertation-5",
    ]
    with pytest.raises(ConditionsError, match=r"no \[aircraft.hexa\]"):
        differences(row.name, pid, known, "quick")
    known = parse(CHAPTER_5.replace("<hexa|nf1>", "nf1"), "test")
    assert list(map(str, differences(row.name, pid, known, "quick"))) == [
        "commands 7 (100)",
        "mount centre (rig)",
        "aircraft nf1 (NF1)",
    ]
    assert list(map(str, differences(row.name, network, known, "quick"))) == [
        "commands 7 (100)",
        "mount centre, trained rig (rig)",
        "aircraft nf1 (NF1)",
        "training 9,000 steps (10,000,000 steps)",
        "network 32, 32 tanh (64, 64 tanh)",
        "recipe dissertation-5",
    ]


SHORTER = """
[steps]
nf4 = '''
policy train --aircraft training/reproduction/iris-4.toml --config dissertation-4 --seeds 2 --out {out}'''
flown = '''
compare --one --all {nf4}/policy.onnx --aircraft training/reproduction/iris-4.toml --task continuous
--length 10 --episodes 5'''
minute = "fly --on library --build x --scenario freestyle --seed 3 --trace {out}/flight.npz"
played = '''
compare pid {nf4}/policy.onnx --aircraft training/reproduction/iris-4.toml --commands {minute}/flight.npz
--piece 0'''
[rows."4.3"]
title = "Table 4.3: Errors"
"MAE" = { quote = "4.3/mae", ours = "flown mae", aim = "lower" }
[rows."4.9"]
title = "Table 4.9: Errors"
"MAE" = { quote = "4.9/mae", ours = "played comparison[0].mae", aim = "lower" }
"""


def test_another_length_number_of_agents_or_pilot_is_told() -> None:
    known = parse(SHORTER, "test")
    flown, played = (
        list(map(str, differences(row.name, row.figures[0], known, "full"))) for row in known.rows
    )
    assert {"length 10 s (30 s)", "agents 2 (3)"} <= set(flown)
    assert "length 60 s (124 s)" in played
    assert "task the commands of scenario freestyle (the commands of a real flight)" in played


def test_aircraft_of_the_file_are_ours() -> None:
    for name in conditions().aircraft:
        path = ROOT / "training" / "reproduction" / f"{name}.toml"
        assert load_aircraft(str(path) if path.is_file() else name)
