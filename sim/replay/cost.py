"""The size of a log, by the groups of its fields."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.sim.blackbox.decoding import field_bytes
from neuroflight.sim.blackbox.headers import read_bytes
from neuroflight.sim.blackbox.log import Log, list_logs

REPLAY = ("gyroRaw", "accRaw", "sampleFlags", "lost", "inputCheck")  # of main frames
REPLAY_SLOW = ("slowStep", "edgeForbidden", "edgeGain", "edgeFlags", "dropped", "rxCount", "rxBytes")


@dataclass(frozen=True)
class Cost:
    """Bytes a second of the log, its header left out."""

    replay: float  # of the group REPLAY, and of what slow frames have for it
    all: float


def log_cost(log: Log) -> Cost:
    """Measure the groups of `log`. Its file is read again."""
    one = list_logs(log.path)[log.number - 1].extent
    data = read_bytes(log.path)[one.body : one.end]
    parts = field_bytes(data, log.headers)
    seconds = log.seconds or 1.0
    mine = sum(count for name, count in parts.items() if name.partition("[")[0] in (*REPLAY, *REPLAY_SLOW))
    return Cost(mine / seconds, len(data) / seconds)
