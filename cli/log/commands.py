"""`neuroflight log commands`: the distribution of a pilot's commands, in one flight or in several."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.log.reading import (
    add_choice_arguments,
    add_part_arguments,
    open_log,
    part,
    tell_damage,
)
from neuroflight.cli.report import print_table
from neuroflight.toolchain.contract import AXES

if TYPE_CHECKING:
    from neuroflight.sim.blackbox.commands import Commands, Sticks
    from neuroflight.sim.blackbox.flight import Part

BAR = 12  # characters of the longest bar


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", type=Path, nargs="+", metavar="FILE", help="logs or traces (.npz), counted together"
    )
    add_choice_arguments(parser)
    add_part_arguments(parser, "the first armed row, in each")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw histograms, fitted normals")


def run(args: argparse.Namespace) -> int:
    """Decode, count, draw, print."""
    from neuroflight.cli.output import check_output, plain
    from neuroflight.sim.blackbox.commands import EDGES_DEG_S, QUANTILES, commands

    check_output(args.plot, ".png")
    chosen = part(args)
    told = commands([_sticks(args, path, chosen) for path in args.file])
    names = " ".join(path.name for path in args.file)
    if args.plot:
        from neuroflight.sim.blackbox.commands_plot import draw_commands
        from neuroflight.sim.plotting import save_png

        all_axes = f"mean {told.overall.mean:.1f}, sigma {told.overall.sigma:.1f} deg/s"
        save_png(args.plot, draw_commands(told, f"{names}: {told.samples:,} samples, {all_axes}"))
    if args.json:
        document = {
            "files": [str(path) for path in args.file],
            "plot": None if args.plot is None else str(args.plot),
            "sigma": told.overall.sigma,
            **asdict(told),
            "quantiles_percent": QUANTILES,
            "histogram_edges_deg_s": EDGES_DEG_S,
        }
        print(json.dumps(plain(document), indent=2, default=plain))
        return 0
    _print(names, told)
    if args.plot:
        print(args.plot)
    return 0


def _sticks(args: argparse.Namespace, path: Path, chosen: Part) -> Sticks:
    """Read the sticks of a file, a trace by its suffix; damage of a log is told."""
    from neuroflight.sim.blackbox.commands import log_sticks, trace_sticks

    if path.suffix == ".npz":
        from neuroflight.sim.flight.trace import load_trace

        return trace_sticks(load_trace(path), chosen)
    log = open_log(args, path)
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
    print_table("", bars, left=True)


def _bar(count: int, most: int, samples: int) -> str:
    """Return a part of the samples as a bar and in percent; "" for none."""
    return f"{'▆' * -(-BAR * count // most):<{BAR}} {100 * count / samples:.3g} %" if count else ""
