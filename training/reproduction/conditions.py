"""Conditions of a row, read from the commands of its steps and their recipes, beside the dissertation's."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from neuroflight.sim.flight.scenario import load_scenario
from neuroflight.training.config.config_file import load_config
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.dissertation.conditions import conditions
from neuroflight.training.reproduction.experiments import FOLDER, Budget, Experiments, Figure, Step, command
from neuroflight.training.tasks.registry import TASKS

TERMS_SHOWN = 3
ROOT = Path(__file__).resolve().parents[2]
FLOWN = ("compare", "compare --one --all")  # commands that fly controllers on a task
WITH_CONTROLLERS = (*FLOWN, "compare --suite power", "policy curves")
SHIPPED = "training/policies/nf1/policy.onnx"
MACHINES = {  # what takes the place of the dissertation's, by command
    "image time": "the emulated board",
    "policy time": "the emulated board",
    "compare --suite power": "the twin's model of power",
    "image build": "an image for a MATEKF722",
    "aircraft stability": "Bullet",
}
CHOSEN = re.compile(r"(?:comparison|controllers)\[(?:best )?(-?\d+)")  # the controller that a path is of
COLUMNS = {  # of the page's table, with the terms that each is of
    "aircraft": ("aircraft", "machine"),
    "mount": ("mount",),
    "task": ("task", "length_s", "commands", "reward"),
    "budget": ("steps", "agents", "recipe"),
    "network": ("inputs", "network"),
}
NAMES = {"length_s": "length", "steps": "training"}
UNITS = {"length_s": " s", "steps": " steps"}


@dataclass(frozen=True)
class Difference:
    """A condition that differs from the dissertation's."""

    term: str
    ours: str
    theirs: str  # empty: no one word

    def __str__(self) -> str:
        """Return the text that is printed: our value, the dissertation's in brackets."""
        told = f"{NAMES.get(self.term, self.term)} {self.ours}"
        return f"{told} ({self.theirs})" if self.theirs else told


def ours(figure: Figure, known: Experiments, budget: Budget) -> Mapping[str, str | float]:
    """Return the conditions of a figure of ours, by term."""
    words = known.steps[figure.ours.step].words(budget)
    found: dict[str, str | float] = {}
    name, _ = command(words)
    if name in MACHINES:
        found["machine"] = MACHINES[name]
    if name in FLOWN:
        found |= _task(words, known, budget)
        found["mount"] = _option(words, "--mount") or "centre"
    aircraft = _option(words, "--aircraft")
    policy = _policy(figure, words, known, budget)
    named = FOLDER.match(policy)
    if named:
        aircraft = aircraft or _option(known.steps[named[1]].words(budget), "--aircraft")
    if aircraft:
        found["aircraft"] = Path(aircraft).stem
    if policy:
        config, agents = _of_step(known.steps[named[1]], budget) if named else (_of_file(policy), 1)
        found |= _training(config, agents)
        if named and (recipe := _option(known.steps[named[1]].words(budget), "--config")):
            found["recipe"] = recipe
        if "mount" in found and config.world.mount != found["mount"]:
            found["mount"] = f"{found['mount']}, trained {config.world.mount}"
    return found


def _policy(figure: Figure, words: Sequence[str], known: Experiments, budget: Budget) -> str:
    """Return the path of the policy that a figure is of; empty if it is of none."""
    name, rest = command(words)
    if name == "image build":
        return _option(words, "--policy") or SHIPPED
    if name.endswith(" time") and (image := FOLDER.match(rest[0])):
        return _policy(figure, known.steps[image[1]].words(budget), known, budget)
    if name not in WITH_CONTROLLERS:
        return ""
    controllers = rest[: next((i for i, word in enumerate(rest) if word.startswith("--")), None)]
    chosen = CHOSEN.search(figure.ours.path)
    controller = controllers[int(chosen[1]) if chosen else 0]
    return controller if FOLDER.match(controller) or controller.endswith(".onnx") else ""


def differences(row: str, figure: Figure, known: Experiments, budget: Budget) -> Sequence[Difference]:
    """Return what is not as in the dissertation: of ours first, then of what ours is compared with."""
    found: dict[str, Difference] = {}
    for source in (figure.ours, figure.per, figure.against):
        for each in () if source is None else _of_source(row, replace(figure, ours=source), known, budget):
            found.setdefault(each.term, each)
    return list(found.values())


def _of_source(row: str, figure: Figure, known: Experiments, budget: Budget) -> Iterator[Difference]:
    theirs = conditions().of(row)
    for term, own in ours(figure, known, budget).items():
        if term == "recipe" and str(own) in conditions().recipes:
            yield Difference(term, str(own), "")
        if term not in theirs:
            continue
        if term == "aircraft":
            stands = conditions().stands_for(str(own))
            own = stands.of if not stands.differs else own
        if own != theirs[term]:
            yield Difference(term, _shown(term, own), _shown(term, theirs[term]))


def _shown(term: str, value: str | float) -> str:
    text = value if isinstance(value, str) else f"{value:,.6g}" if value < 1e6 else f"{value:,.0f}"
    return text + UNITS.get(term, "")


def _option(words: Sequence[str], name: str) -> str | None:
    return words[words.index(name) + 1] if name in words else None


def _task(words: Sequence[str], known: Experiments, budget: Budget) -> dict[str, str | float]:
    """Return the task that is flown, its length and how often."""
    episodes = _option(words, "--episodes")
    if log := _option(words, "--commands"):
        named = FOLDER.match(log)
        return _flight(known.steps[named[1]], budget) if named else {"task": f"the commands of {log}"}
    name = _option(words, "--task") or "flight"
    length = float(_option(words, "--length") or TASKS[name]().duration_s)
    count = float(episodes or 1) if "--command" in words or episodes else 1000.0
    if "--sigma" in words:
        name = "a pilot's normal commands"
    return {"task": name, "length_s": length, "commands": count}


@cache
def _flight(step: Step, budget: Budget) -> dict[str, str | float]:
    """Return the commands of a flight that is played to a controller."""
    words = step.words(budget)
    scenario = load_scenario(str(_option(words, "--scenario")), int(_option(words, "--seed") or 0))
    return {
        "task": f"the commands of scenario {scenario.name}",
        "length_s": round(scenario.duration_s, 1),
    }


def _training(config: TrainingConfig, agents: int) -> dict[str, str | float]:
    """Return the conditions that a policy was trained in."""
    terms = dict.fromkeys(term.partition("@")[0] for term in config.observation.split(","))
    return {
        "steps": config.steps,
        "agents": agents,
        "reward": config.reward.name,
        "inputs": ", ".join(terms) if len(terms) <= TERMS_SHOWN else f"{len(terms)} terms",
        "network": f"{', '.join(map(str, config.hidden))} {config.activation}",
    }


@cache
def _of_step(step: Step, budget: Budget) -> tuple[TrainingConfig, int]:
    """Return the configuration that a step trains, and the number of its agents."""
    words = step.words(budget)
    overrides: list[str] = []
    if "--set" in words:
        rest = words[words.index("--set") + 1 :]
        overrides = rest[: next((i for i, word in enumerate(rest) if word.startswith("--")), None)]
    if steps := _option(words, "--steps"):
        overrides.append(f"steps={steps}")
    return load_config(_option(words, "--config"), overrides), int(_option(words, "--seeds") or 1)


@cache
def _of_file(policy: str) -> TrainingConfig:
    """Return the training configuration of a policy that comes with the project."""
    return load_config(ROOT / Path(policy).with_name("training.json"))
