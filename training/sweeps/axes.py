"""The variations of a sweep: grid axes, ranges to draw from, and variants that are listed one by one."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.strict_toml import StrictTable
from neuroflight.training.config.config_table import ConfigReader
from neuroflight.training.tasks.limits import Limits, value_errors

VARIANTS_MAX = 100
End = Annotated[float, Limits(-1e12, 1e12)]  # of a range
VARIANT = "variant"  # the axis of variants: its values are their names

Varied = dict[str, Any]  # dotted key -> value


@dataclass(frozen=True)
class Range:
    """Numbers to draw from."""

    low: End
    high: End
    log: bool = False  # log-uniform
    whole: bool = False  # whole numbers

    def __post_init__(self) -> None:
        """Raise TrainingError if there is nothing between the ends."""
        low, high = self.low, self.high
        wrong = list(value_errors(self))
        if not low < high:
            wrong.append(f"high {high:g}, expected more than low, {low:g}")
        if self.log and low <= 0:
            wrong.append(f"low {low:g}, expected more than 0, since log = true")
        if self.whole and math.ceil(low) > math.floor(high):
            wrong.append(f"high {high:g}, expected a whole number between low, {low:g}, and it")
        if wrong:
            raise TrainingError(wrong[0])

    def draw(self, rng: np.random.Generator) -> float | int:
        """Draw a number; unless whole, it has four significant digits."""
        if self.log:
            value = math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
        else:
            value = rng.uniform(self.low, self.high)
        if self.whole:
            return min(max(round(value), math.ceil(self.low)), math.floor(self.high))
        return float(f"{value:.4g}")  # so that tables show the exact value


def read_axes(vary: Mapping[str, Any], where: str) -> dict[str, list[Any] | Range]:
    """Read grid axes and ranges of [vary], by dotted key."""
    table = StrictTable(vary, where, TrainingError, "vary.")
    axes: dict[str, list[Any] | Range] = {}
    for key, value in flat(vary).items():
        if isinstance(value, dict):
            axes[key] = ConfigReader(where, {}).table(Range, value, f"vary.{key}")
        elif not isinstance(value, list) or not value:
            raise table.error(key, "expected a list of values, or a range {low = ..., high = ...}")
        elif any(value.index(item) < i for i, item in enumerate(value)):
            raise table.error(key, "has a value twice; give each once")
        else:
            axes[key] = value
    return axes


def read_variants(table: StrictTable, document: Mapping[str, Any]) -> dict[str, Varied]:
    """Read the values that each [[variant]] of a sweep file sets, by its name, in the file's order.

    table: of the file's content, `document`. Raises TrainingError for a name that is given twice.
    """
    if not table.has(VARIANT):
        return {}
    found: dict[str, Varied] = {}
    for own, values in zip(table.tables(VARIANT, 1, VARIANTS_MAX), document[VARIANT], strict=True):
        name = own.text("name")
        if name in found:
            raise own.error("name", f"{name!r} for a second time; give each variant a name of its own")
        found[name] = flat(values["set"]) if own.has("set") and own.table("set") else {}
        own.finish()
    return found


def flat(values: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return dotted keys and their values; a table with the key `low` is a range, and so a value."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, dict) and "low" not in value:
            found |= flat(value, f"{path}{key}.")
        else:
            found[f"{path}{key}"] = value
    return found


def combinations(
    axes: Mapping[str, list[Any] | Range], samples: int, rng: np.random.Generator
) -> Iterator[Varied]:
    """Yield every point of the grid with each draw of the ranges, the last axis fastest."""
    for _ in range(samples):
        drawn = {key: [axis.draw(rng)] if isinstance(axis, Range) else axis for key, axis in axes.items()}
        for values in itertools.product(*drawn.values()):
            yield dict(zip(drawn, values, strict=True))
