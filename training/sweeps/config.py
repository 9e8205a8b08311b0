"""Reads a sweep file: its training runs, each with its own checked configuration.

A sweep file is TOML:

    aircraft = "nf1"           # shipped name or file
    config = "ppo"             # recipe or file that all runs start from; default: `TrainingConfig()`
    samples = 8                # draws from the ranges below, if there are any
    seed = 1                   # of these draws

    [set]                      # for all runs, over the recipe
    steps = 2_000_000

    [vary]                     # a list is a grid axis, {low, high} a range to draw from
    seed = [1, 2, 3]
    hidden = [[32, 32], [64, 64]]
    reward.output = {low = 0.1, high = 1.0, log = true}

    [[variant]]                # configurations one by one instead of, or beside, [vary]
    name = "no memory"
    set = {observation = "rate_error,rate"}

    [validation]               # flown by every trained policy
    episodes = 100

Each draw of all ranges is combined with each point of the grid, and with each variant. Paths are relative to
the sweep file.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from inspect import Parameter, signature
from pathlib import Path
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft, shipped
from neuroflight.sim.aircraft.props_out import SUFFIX
from neuroflight.sim.physics.world import COUNT_MAX
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.files import read_limited
from neuroflight.toolchain.strict_toml import StrictTable, parse_toml
from neuroflight.training.config.config_file import load_config, recipes
from neuroflight.training.config.training_config import SEED_MAX, TrainingConfig
from neuroflight.training.sweeps.axes import (
    VARIANT,
    Range,
    Varied,
    combinations,
    flat,
    read_axes,
    read_variants,
)
from neuroflight.training.tasks.flight import HOVER_THROTTLE, FlightTask
from neuroflight.training.tasks.registry import TASKS

FILE_BYTES_MAX = 100_000
TRIALS_MAX = 1000
SLUG_MAX = 60  # characters of a folder's name after its number
SEED = "seed"  # the axis whose values are repetitions, not configurations
CONFIG = "config"  # the axis of recipes and files
THRUST_MIN, THRUST_MAX, THRUSTS_MAX = 0.05, 10.0, 8  # times the weight; how many of them
CYCLES_MAX = 1_000_000


@dataclass(frozen=True)
class Validation:
    """The flights of every trained policy, about the centre of mass and with noise."""

    task: str = FlightTask.name
    episodes: int = 100  # commands, in flights ten each
    seed: int = 10_000
    throttle: float = HOVER_THROTTLE  # 0 with another task, unless the file says
    thrust: tuple[float, ...] = ()  # at rest, times the weight: each in place of `throttle`, and throttle 0


@dataclass(frozen=True)
class Board:
    """The time that the board has for a policy."""

    control_task_cycles: int  # at most
    other_cycles: int  # of them, what is not policy_step: `neuroflight policy time` of an image tells


@dataclass(frozen=True)
class Trial:
    """One training run of a sweep."""

    number: int  # from 1
    folder: str  # its name
    varied: Varied  # its values of the varied keys
    config: TrainingConfig

    @property
    def configuration(self) -> Varied:
        """The values that it shares with its repetitions with other seeds."""
        return {key: value for key, value in self.varied.items() if key != SEED}


@dataclass(frozen=True)
class Sweep:
    """The content of a sweep file, checked."""

    name: str
    aircraft: Aircraft
    trials: tuple[Trial, ...]
    validation: Validation
    baseline: str | None = None  # the variant that the others are compared with
    board: Board | None = None  # None: not asked for


def load_sweep(path: Path) -> Sweep:
    """Load the sweep of a file.

    Raises TrainingError, one line, for an error of the file or of the first invalid run.
    """
    where = f"sweep {path.name}"
    if not path.is_file():
        raise TrainingError(f"{where}: {path} is no file; give the path of a sweep in TOML")
    document = parse_toml(read_limited(path, where, FILE_BYTES_MAX, TrainingError), where, TrainingError)
    table = StrictTable(document, where, TrainingError)
    aircraft = load_aircraft(_beside(path, table.text("aircraft"), shipped()))
    base = table.text(CONFIG, "")
    common = flat(document["set"]) if table.has("set") and table.table("set") else {}
    axes = read_axes(document["vary"] if table.has("vary") and table.table("vary") else {}, where)
    draws = {key: axis for key, axis in axes.items() if isinstance(axis, Range)}
    if bool(draws) != table.has("samples"):
        wrong = "missing; say how often to draw from the ranges of [vary]"
        raise table.error("samples", wrong if draws else "nothing to draw: [vary] has no range {low, high}")
    samples = table.integer("samples", 1, TRIALS_MAX, 1)
    rng = np.random.default_rng(table.integer("seed", 0, SEED_MAX, 0))
    variants = read_variants(table, document)
    # What the others are compared with: the first, unless the file names one.
    names = {name: name for name in variants}
    baseline = table.choice("baseline", names, next(iter(variants))) if variants else None
    validation = table.optional_part("validation", _validation) or Validation()
    board = table.optional_part("board", _board)
    table.finish()
    for place, values in (("", common), *((f"variant {name!r}: ", own) for name, own in variants.items())):
        if both := sorted({*values} & {*axes}):
            raise table.error(f"{place}set.{both[0]}", "stands in [vary] too; give it once")
    every: dict[str, list[Any] | Range] = {VARIANT: [*variants], **axes} if variants else axes
    if not every:
        raise TrainingError(
            f"{where}: nothing varies; add [vary] with a key, such as seed = [1, 2, 3], or a [[variant]]"
        )
    total = samples * math.prod(len(axis) for axis in every.values() if isinstance(axis, list))
    if total > TRIALS_MAX:
        raise table.error("vary", f"makes {total} runs, expected at most {TRIALS_MAX}")
    trials = []
    for number, varied in enumerate(combinations(every, samples, rng), 1):
        own = {key: value for key, value in varied.items() if key not in (CONFIG, VARIANT)}
        source = str(varied.get(CONFIG, base))
        chosen = {**common, **variants.get(str(varied.get(VARIANT)), {}), **own}
        try:
            config = load_config(
                _beside(path, source, recipes()) if source else None,
                [f"{key}={_toml(value)}" for key, value in chosen.items()],
            )
            config.document(aircraft)
        except TrainingError as error:
            raise TrainingError(f"{where}, run {number} ({described(varied)}): {error}") from error
        trials.append(Trial(number, _folder(number, total, varied), varied, config))
    return Sweep(path.stem, aircraft, tuple(trials), validation, baseline, board)


def described(varied: Varied) -> str:
    """Format varied values on one line: "hidden [64, 64], seed 2"."""
    return ", ".join(f"{key} {shown(value)}" for key, value in varied.items())


def shown(value: object) -> str:
    """Format a varied value for tables."""
    if isinstance(value, dict):
        return described(value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _beside(path: Path, name: str, known: Sequence[str]) -> str:
    """Return a known name as it is; any other as a path relative to the sweep file's folder."""
    return name if name.removesuffix(SUFFIX) in known else str(path.parent / name)


def _validation(table: StrictTable) -> Validation:
    usual = Validation()
    flights = table.text("task", usual.task) == usual.task
    # Only tasks without required fields: `recorded`, say, needs a file.
    tasks = {
        name: name
        for name, task in TASKS.items()
        if all(each.default is not Parameter.empty for each in signature(task).parameters.values())
    }
    validation = Validation(
        task=table.choice("task", tasks, usual.task),
        episodes=table.integer("episodes", 2, COUNT_MAX, usual.episodes),
        seed=table.integer("seed", 0, SEED_MAX, usual.seed),
        throttle=table.number("throttle", 0.0, 1.0, usual.throttle if flights else 0.0),
        thrust=table.numbers("thrust", 1, THRUSTS_MAX, THRUST_MIN, THRUST_MAX) if table.has("thrust") else (),
    )
    if validation.thrust and table.has("throttle"):
        raise table.error("throttle", "stands beside thrust, which finds it; give one of the two")
    return validation


def _board(table: StrictTable) -> Board:
    return Board(*(table.integer(key, 1, CYCLES_MAX) for key in ("control_task_cycles", "other_cycles")))


def _folder(number: int, total: int, varied: Varied) -> str:
    """Return the name of a run's folder: "07-hidden-64-64-seed-2"."""
    words: list[str] = []
    for key, value in varied.items():
        words += [key.rpartition(".")[2]] if key != VARIANT else []
        words.append(Path(str(value)).stem if key == CONFIG else shown(value))
    text = "-".join(words)
    slug = re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.").lower()
    return f"{number:0{len(str(total))}d}-{slug[:SLUG_MAX].rstrip('-.')}"


def _toml(value: object) -> str:
    """Format a value of a TOML file as TOML."""
    if isinstance(value, list):
        return f"[{', '.join(_toml(item) for item in value)}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(key)} = {_toml(item)}' for key, item in value.items())}}}"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, bool | str) else str(value)
