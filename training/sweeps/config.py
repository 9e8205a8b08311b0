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

    [validation]               # flown by every trained policy
    episodes = 100

Each draw of all ranges is combined with each point of the grid. Paths are relative to the sweep file.
"""

from __future__ import annotations

import itertools
import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from inspect import Parameter, signature
from pathlib import Path
from typing import Any

import numpy as np

from sim.aircraft.model import Aircraft, load_aircraft, shipped
from sim.physics.world import COUNT_MAX
from sim.strict_toml import StrictTable
from toolchain.errors import TrainingError
from toolchain.files import file_size
from training.config.config_file import load_config, recipes
from training.config.training_config import SEED_MAX, TrainingConfig
from training.tasks.registry import TASKS
from training.tasks.task import Task

FILE_BYTES_MAX = 100_000
TRIALS_MAX = 1000
SLUG_MAX = 60  # characters of a folder's name after its number
NUMBER_MAX = 1e12  # of a range's ends
SEED = "seed"  # the axis whose values are repetitions, not configurations
CONFIG = "config"  # the axis of recipes and files
RANGE_KEYS = ("low", "high", "log", "whole")

Varied = dict[str, Any]  # dotted key -> value


@dataclass(frozen=True)
class Validation:
    """The flights of every trained policy, about the centre of mass and with noise."""

    task: str = "pulse"
    episodes: int = 100
    seed: int = 10_000
    throttle: float = 0.0


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


@dataclass(frozen=True)
class Range:
    """Numbers to draw from."""

    low: float
    high: float
    log: bool  # log-uniform
    whole: bool  # whole numbers

    def draw(self, rng: np.random.Generator) -> float | int:
        """Draw a number; unless whole, it has four significant digits."""
        if self.log:
            value = math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
        else:
            value = rng.uniform(self.low, self.high)
        if self.whole:
            return min(max(round(value), math.ceil(self.low)), math.floor(self.high))
        return float(f"{value:.4g}")  # so that tables show the exact value


def load_sweep(path: Path) -> Sweep:
    """The sweep of a file.

    Raises TrainingError, one line, on an error of the file or of the first invalid run.
    """
    where = f"sweep {path.name}"
    document = _read(path, where)
    table = StrictTable(document, where, TrainingError)
    aircraft = load_aircraft(_beside(path, table.text("aircraft"), shipped()))
    base = table.text(CONFIG, "")
    common = _flat(document["set"]) if table.has("set") and table.table("set") else {}
    axes = _axes(document["vary"] if table.has("vary") and table.table("vary") else {}, where)
    draws = {key: axis for key, axis in axes.items() if isinstance(axis, Range)}
    if bool(draws) != table.has("samples"):
        wrong = "missing; say how often to draw from the ranges of [vary]"
        raise table.error("samples", wrong if draws else "nothing to draw: [vary] has no range {low, high}")
    samples = table.integer("samples", 1, TRIALS_MAX, 1)
    rng = np.random.default_rng(table.integer("seed", 0, SEED_MAX, 0))
    validation = _validation(table.table("validation")) if table.has("validation") else Validation()
    table.finish()
    if both := sorted({*common} & {*axes}):
        raise table.error(f"set.{both[0]}", "stands in [vary] too; give it once")
    total = samples * math.prod(len(axis) for axis in axes.values() if isinstance(axis, list))
    if total > TRIALS_MAX:
        raise table.error("vary", f"makes {total} runs, expected at most {TRIALS_MAX}")
    trials = []
    for number, varied in enumerate(_combinations(axes, samples, rng), 1):
        own = {key: value for key, value in varied.items() if key != CONFIG}
        source = str(varied.get(CONFIG, base))
        try:
            config = load_config(
                _beside(path, source, recipes()) if source else None,
                [f"{key}={_toml(value)}" for key, value in {**common, **own}.items()],
            )
            config.document(aircraft)
        except TrainingError as error:
            raise TrainingError(f"{where}, run {number} ({described(varied)}): {error}") from error
        trials.append(Trial(number, _folder(number, total, varied), varied, config))
    return Sweep(path.stem, aircraft, tuple(trials), validation)


def described(varied: Varied) -> str:
    """Varied values on one line: "hidden [64, 64], seed 2"."""
    return ", ".join(f"{key} {shown(value)}" for key, value in varied.items())


def shown(value: object) -> str:
    """A varied value as text for tables."""
    if isinstance(value, dict):
        return described(value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _read(path: Path, where: str) -> dict[str, Any]:
    try:
        if not path.is_file():
            raise TrainingError(f"{where}: {path} is no file; give the path of a sweep in TOML")
        if (size := file_size(path)) > FILE_BYTES_MAX:
            raise TrainingError(f"{where}: {size} bytes, expected at most {FILE_BYTES_MAX}")
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise TrainingError(f"{where}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # ValueError: not UTF-8, not TOML, a number without end
        raise TrainingError(f"{where}: not TOML: {' '.join(str(error).split())}") from error


def _beside(path: Path, name: str, known: Sequence[str]) -> str:
    """A known name as it is; any other as a path relative to the sweep file's folder."""
    return name if name in known else str(path.parent / name)


def _axes(vary: dict[str, Any], where: str) -> dict[str, list[Any] | Range]:
    """Grid axes and ranges of [vary], by dotted key."""
    table = StrictTable(vary, where, TrainingError, "vary.")
    axes: dict[str, list[Any] | Range] = {}
    for key, value in _flat(vary).items():
        if isinstance(value, dict):
            axes[key] = _range(value, where, f"vary.{key}.")
        elif not isinstance(value, list) or not value:
            raise table.error(key, "expected a list of values, or a range {low = ..., high = ...}")
        elif any(value.index(item) < i for i, item in enumerate(value)):
            raise table.error(key, "has a value twice; give each once")
        else:
            axes[key] = value
    if not axes:
        raise TrainingError(f"{where}: nothing varies; add [vary] with a key, such as seed = [1, 2, 3]")
    return axes


def _range(values: dict[str, Any], where: str, path: str) -> Range:
    ends = StrictTable(values, where, TrainingError, path)
    low, high = (ends.number(key, -NUMBER_MAX, NUMBER_MAX) for key in ("low", "high"))
    for key, value in values.items():
        if key not in RANGE_KEYS:
            raise ends.error(key, f"unknown key; known here: {', '.join(RANGE_KEYS)}")
        if key in ("log", "whole") and not isinstance(value, bool):
            raise ends.error(key, "expected true or false")
    log, whole = values.get("log", False), values.get("whole", False)
    if not low < high:
        raise ends.error("high", f"got {high:g}, expected more than low, {low:g}")
    if log and low <= 0:
        raise ends.error("low", f"got {low:g}, expected more than 0, since log = true")
    if whole and math.ceil(low) > math.floor(high):
        raise ends.error("high", f"got {high:g}, expected a whole number between low, {low:g}, and it")
    return Range(low, high, log, whole)


def _validation(table: StrictTable) -> Validation:
    usual = Validation()
    # Only tasks without required fields: `recorded`, say, needs a file.
    tasks = {name: name for name, task in TASKS.items() if _complete(task)}
    validation = Validation(
        task=table.choice("task", tasks, usual.task),
        episodes=table.integer("episodes", 2, COUNT_MAX, usual.episodes),
        seed=table.integer("seed", 0, SEED_MAX, usual.seed),
        throttle=table.number("throttle", 0.0, 1.0, usual.throttle),
    )
    table.finish()
    return validation


def _complete(task: type[Task]) -> bool:
    return all(p.default is not Parameter.empty for p in signature(task).parameters.values())


def _flat(values: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Dotted keys and their values; a table with the key `low` is a range, and so a value."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, dict) and "low" not in value:
            flat |= _flat(value, f"{path}{key}.")
        else:
            flat[f"{path}{key}"] = value
    return flat


def _combinations(
    axes: Mapping[str, list[Any] | Range], samples: int, rng: np.random.Generator
) -> Iterator[Varied]:
    """Every point of the grid with each draw of all ranges, in the file's order, the last axis fastest."""
    for _ in range(samples):
        drawn = {key: [axis.draw(rng)] if isinstance(axis, Range) else axis for key, axis in axes.items()}
        for values in itertools.product(*drawn.values()):
            yield dict(zip(drawn, values, strict=True))


def _folder(number: int, total: int, varied: Varied) -> str:
    """Name of a run's folder: "07-hidden-64-64-seed-2"."""
    words = (
        (key.rpartition(".")[2], Path(str(value)).stem if key == CONFIG else shown(value))
        for key, value in varied.items()
    )
    text = "-".join("-".join(word) for word in words)
    slug = re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.").lower()
    return f"{number:0{len(str(total))}d}-{slug[:SLUG_MAX].rstrip('-.')}"


def _toml(value: object) -> str:
    """A value of a TOML file as TOML."""
    if isinstance(value, list):
        return f"[{', '.join(_toml(item) for item in value)}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(key)} = {_toml(item)}' for key, item in value.items())}}}"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, bool | str) else str(value)
