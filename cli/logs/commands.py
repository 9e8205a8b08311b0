"""`neuroflight log commands`: how a pilot's commands are distributed, in one flight or in several."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from cli.logs.reading import (
    add_choice_arguments,
    add_part_arguments,
    open_log,
    part,
    tell_damage,
)
from cli.output import print_table
from toolchain.contract import AXES

if TYPE_CHECKING:
    from sim.blackbox.commands import Commands

BAR = 12  # characters of the longest bar


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", type=Path, nargs="+", metavar="FILE", help="logs, counted together")
    add_choice_arguments(parser)
    add_part_arguments(parser, "the first armed row, in each")


def run(args: argparse.Namespace) -> int:
    """Decode, count, print."""
    from cli.output import plain
    from sim.blackbox.commands import EDGES_DEG_S, QUANTILES, commands, log_sticks

    chosen = part(args)
    logs = [open_log(args, path) for path in args.file]
    told = commands([log_sticks(log, chosen) for log in logs])
    for log in logs:
        tell_damage(log)
    if args.json:
        document = {
            "files": [str(path) for path in args.file],
            **asdict(told),
            "quantiles_percent": QUANTILES,
            "histogram_edges_deg_s": EDGES_DEG_S,
        }
        print(json.dumps(plain(document), indent=2, default=plain))
        return 0
    _print(" ".join(path.name for path in args.file), told)
    return 0


def _print(title: str, told: Commands) -> None:
    from sim.blackbox.commands import ASKED_DEG_S, EDGES_DEG_S, QUANTILES

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
    heading = f"{title}: {told.samples:,} samples in {told.seconds:,.1f} s, sigma {told.sigma:.1f} deg/s"
    print_table(heading, rows, note)
    most = max(1, int(told.histogram.max()))
    bars: list[tuple[str, ...]] = [("size, deg/s", *AXES)]
    for low, high, counts in zip(EDGES_DEG_S, EDGES_DEG_S[1:], told.histogram.tolist(), strict=False):
        words = f"from {low}" if high == EDGES_DEG_S[-1] else f"{low} to {high}"
        bars.append((words, *(_bar(count, most, told.samples) for count in counts)))
    print_table("", bars, left=True)


def _bar(count: int, most: int, samples: int) -> str:
    """A part of the samples as a bar and in percent; "" for none."""
    return f"{'▆' * -(-BAR * count // most):<{BAR}} {100 * count / samples:.3g} %" if count else ""
