"""The choice of the checkpoint that becomes policy.onnx: a ranking by the monitor's metrics.

The least MAE wins among the checkpoints within both limits. If none is within them, the least product of
MAE and excess wins. The excess is how many times the mean output exceeds its limit, times how many times the
mean change does; within the limits it is 1. Of equals the earlier is taken.
"""

from __future__ import annotations

from neuroflight.training.checkpoints.metrics import CheckpointMetrics
from neuroflight.training.config.selection import SelectionLimits


def rule(limits: SelectionLimits) -> str:
    """Describe the rule for records and plots."""
    return (
        f"least MAE among the checkpoints with mean output at most {limits.output:g} and mean change at "
        f"most {limits.change:g}; if there is none, least MAE times the excesses of these two"
    )


def within(metrics: CheckpointMetrics, limits: SelectionLimits) -> bool:
    """Return True if a checkpoint keeps both limits."""
    return _excess(metrics, limits) <= 1.0


def better(one: CheckpointMetrics, earlier: CheckpointMetrics, limits: SelectionLimits) -> bool:
    """Return True if `one` is chosen before a checkpoint that is earlier than it."""
    return rank(one, limits) < rank(earlier, limits)


def rank(metrics: CheckpointMetrics, limits: SelectionLimits) -> tuple[bool, float]:
    """Return the key by which checkpoints are ranked, the least first."""
    return not within(metrics, limits), metrics.mae.mean * _excess(metrics, limits)


def _excess(metrics: CheckpointMetrics, limits: SelectionLimits) -> float:
    return max(1.0, metrics.output.mean / limits.output) * max(1.0, metrics.change.mean / limits.change)
