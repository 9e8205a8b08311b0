"""`neuroflight log commands`: the distribution of a pilot's commands, in one flight or in several."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.log.reading import OfLogs, since, tell_damage
from neuroflight.cli.options import OfPart, picture
from neuroflight.cli.report import print_table
from neuroflight.cli.requests import Argument
from neuroflight.toolchain.contract import AXES

if TYPE_CHECKING:
    from neuroflight.sim.blackbox.commands import Commands, Sticks
    from neuroflight.sim.blackbox.flight import Part

BAR = 12  # characters of the longest bar


@dataclass(frozen=True, kw_only=True)
class Distribution(OfPart, OfLogs):
    """A request for the distribution of a pilot's commands."""

    file: Annotated[tuple[Path, ...], Argument("FILE", "logs or traces (.npz), counted together")]
    start: Annotated[float | None, since("the first armed row, in each")] = None
    plot: Annotated[Path | None, picture("draw histograms, fitted normals")] = None

    def run(self) -> int:
        """Decode, count, draw, print."""
        from neuroflight.cli.output import plain
        from neuroflight.sim.blackbox.commands import EDGES_DEG_S, QUANTILES, commands

        chosen = self.part
        told = commands([self._sticks(path, chosen) for path in self.file])
        names = " ".join(path.name for path in self.file)
        if self.plot:
            from neuroflight.sim.blackbox.commands_plot import draw_commands
            from neuroflight.sim.plotting import save_png

            all_axes = f"mean {told.overall.mean:.1f}, sigma {told.overall.sigma:.1f} deg/s"
            save_png(self.plot, draw_commands(told, f"{names}: {told.samples:,} samples, {all_axes}"))
        if self.json:
            document = {
                "files": [str(path) for path in self.file],
                "plot": None if self.plot is None else str(self.plot),
                "sigma": told.overall.sigma,
                **asdict(told),
                "quantiles_percent": QUANTILES,
                "histogram_edges_deg_s": EDGES_DEG_S,
            }
            print(json.dumps(plain(document), indent=2, default=plain))
            return 0
        _print(names, told)
        if self.plot:
            print(self.plot)
        return 0

    def _sticks(self, path: Path, chosen: Part) -> Sticks:
        """Read the sticks of a file, a trace by its suffix; damage of a log is told."""
        from neuroflight.sim.blackbox.commands import log_sticks, trace_sticks

        if path.suffix == ".npz":
            from neuroflight.sim.flight.trace import load_trace

            return trace_sticks(load_trace(path), chosen)
        log = self.read(path)
        sticks = log_sticks(log, chosen)
        tell_damage(log)
        return sticks


def _print(title: str, told: Commands) -> None:
    from neuroflight.sim.blackbox.commands import ASKED_DEG_S, EDGES_DEG_S, QUANTILES

    rows: list[tuple[str, ...]] = [("deg/s", *AXES)]

    def add(label: str, values: list[float], digits: int = 1) -> None:
        rows.append((label, *(f"{value:,.{digits}f}" for value in values)))

    add("sigma", told.axis_sigma.tolist())
    add("mean", told.mean.tolist())
    for level, sizes in zip(QUANTILES, told.quantiles.tolist(), strict=True):
        add(f"{level:g} % are at most", sizes)
    add("largest", told.largest.tolist())
    add("sigma of the change, deg/s²", told.change_sigma.tolist(), 0)
    add(f"asked to turn, % of the time (from {ASKED_DEG_S:g})", (100 * told.asked).tolist())
    none, one, two, three = (100 * told.together).tolist()
    mean, least, largest = (100 * told.throttle).tolist()
    note = (
        f"none of the axes {none:.1f} % of the time, one {one:.1f} %, two {two:.1f} %, three {three:.1f} %; "
        f"throttle {mean:.0f} % ({least:.0f} to {largest:.0f})"
    )
    overall = f"mean {told.overall.mean:.1f}, sigma {told.overall.sigma:.1f} deg/s"
    heading = f"{title}: {told.samples:,} samples in {told.seconds:,.1f} s, {overall}"
    print_table(heading, rows, note)
    most = max(1, int(told.histogram.max()))
    bars: list[tuple[str, ...]] = [("size, deg/s", *AXES)]
    for low, high, counts in zip(EDGES_DEG_S, EDGES_DEG_S[1:], told.histogram.tolist(), strict=False):
        words = f"from {low}" if high == EDGES_DEG_S[-1] else f"{low} to {high}"
        bars.append((words, *(_bar(count, most, told.samples) for count in counts)))
    print_table("", bars, numbers=())


def _bar(count: int, most: int, samples: int) -> str:
    """Return a part of the samples as a bar and in percent; "" for none."""
    return f"{'▆' * -(-BAR * count // most):<{BAR}} {100 * count / samples:.3g} %" if count else ""
