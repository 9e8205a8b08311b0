"""`neuroflight log decode`: the frames of a log as CSV or NumPy's .npz."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from neuroflight.cli.log.reading import add_file_arguments, open_log, tell_damage
from neuroflight.cli.report import print_table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_file_arguments(parser)
    parser.add_argument(
        "--csv",
        type=Path,
        metavar="FILE.csv",
        help="a row each frame, as the format's tools write it; header lines go into FILE.headers.csv, GPS "
        "frames into FILE.gps.csv",
    )
    parser.add_argument(
        "--npz", type=Path, metavar="FILE.npz", help="columns, and what they are in rad/s, s, V"
    )


def run(args: argparse.Namespace) -> int:
    """Decode, write, tell what there is."""
    from neuroflight.cli.output import check_output
    from neuroflight.sim.blackbox.export import save_csv, save_gps_csv, save_headers, save_npz

    check_output(args.csv, ".csv")
    check_output(args.npz, ".npz")
    log = open_log(args)
    if args.csv:
        save_csv(args.csv, log)
        save_headers(args.csv, log)
        if log.positions:
            save_gps_csv(args.csv.with_suffix(".gps.csv"), log)
    if args.npz:
        save_npz(args.npz, log)
    tell_damage(log)
    fields = {
        name: {"least": int(column.min()), "largest": int(column.max()), "mean": float(column.mean())}
        for name, column in {
            **log.columns,
            **log.slow,
            **{f"gps/{name}": column for name, column in log.gps.items()},
        }.items()
        if len(column)
    }
    if args.json:
        told = {
            "file": str(args.file),
            "log": log.number,
            "firmware": log.maker.value,
            "rows": len(log),
            "gps_rows": log.positions,
            "seconds": log.seconds,
            "rate_hz": log.rate_hz,
            "lost_rows": log.lost,
            "notes": list(log.notes),
            "events": [{"name": one.name, "row": one.row, **one.values} for one in log.events],
            "headers": log.header,
            "fields": fields,
        }
        print(json.dumps(told, indent=2))
        return 0
    rows = [("field", "least", "largest", "mean")]
    rows += [(n, str(f["least"]), str(f["largest"]), f"{f['mean']:.1f}") for n, f in fields.items()]
    note = f"{len(log)} rows, {log.seconds:.3f} s, {log.rate_hz:,.0f} rows a second, {log.lost} lost"
    if log.positions:
        note += f", {log.positions} GPS rows" + (f" in {args.csv.stem}.gps.csv" if args.csv else "")
    print_table(f"{args.file.name}: log {log.number}, {log.maker.value}", rows, note)
    return 0
