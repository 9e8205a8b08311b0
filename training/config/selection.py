"""Which checkpoint of a run becomes policy.onnx: a stated rule over the monitor's readings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from training.checkpoints.metrics import Reading


@dataclass(frozen=True)
class Selection:
    """Least MAE among the checkpoints within both limits; where none is, least MAE times its excess.

    The excess is how many times the mean output exceeds its limit, times how many times the mean change
    does; within the limits it is 1. Of equals the earlier is taken.
    """

    output: float = 0.12  # limit of the mean control output: what the dissertation's policy takes
    change: float = 0.012  # limit of mean |change| of an output in 1 ms, as `tune-pid` keeps it

    def refusals(self) -> Iterator[str]:
        """Limits that are none, one line each."""
        for name, limit in (("output", self.output), ("change", self.change)):
            if not 0.0 < limit <= 1.0:
                yield f"selection {name} {limit}, expected more than 0 to 1"

    @property
    def rule(self) -> str:
        """The rule in words, for whoever reads a result."""
        return (
            f"least MAE among the checkpoints with mean output at most {self.output:g} and mean change at "
            f"most {self.change:g}; if there is none, least MAE times the excesses of these two"
        )

    def within(self, reading: Reading) -> bool:
        """Whether a checkpoint keeps both limits."""
        return self._excess(reading) <= 1.0

    def better(self, one: Reading, other: Reading) -> bool:
        """Whether `one` is chosen before `other`, its elder."""
        return self._rank(one) < self._rank(other)

    def _rank(self, reading: Reading) -> tuple[bool, float]:
        return not self.within(reading), reading.mae.mean * self._excess(reading)

    def _excess(self, reading: Reading) -> float:
        return max(1.0, reading.output.mean / self.output) * max(1.0, reading.change.mean / self.change)
