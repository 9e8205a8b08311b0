"""`neuroflight log plot`: a flight as a picture."""

from __future__ import annotations

import argparse
import json

from neuroflight.cli.log.reading import (
    add_file_arguments,
    add_part_arguments,
    check_part,
    open_log,
    tell_damage,
)
from neuroflight.cli.options import add_plot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_file_arguments(parser)
    add_plot(parser, "where the picture goes", old="--out", required=True)
    add_part_arguments(parser, "the log's first row")


def run(args: argparse.Namespace) -> int:
    """Decode and draw."""
    from neuroflight.cli.output import check_output
    from neuroflight.sim.blackbox.plot import draw_log
    from neuroflight.sim.plotting import save_png

    check_output(args.plot, ".png")
    check_part(args)
    log = open_log(args)
    title = f"{args.file.name}: log {log.number}, {log.maker.value}"
    save_png(args.plot, draw_log(log, title, args.start, args.stop))
    tell_damage(log)
    if args.json:
        print(
            json.dumps(
                {"file": str(args.file), "log": log.number, "out": str(args.plot), "notes": list(log.notes)}
            )
        )
    else:
        print(args.plot)
    return 0
