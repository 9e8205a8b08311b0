"""`neuroflight log quality`: the questions that a log can answer, and those that it cannot."""

from __future__ import annotations

import argparse
import json

from neuroflight.cli.log.reading import add_file_arguments, open_log, tell_damage
from neuroflight.cli.report import print_table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_file_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Decode, judge, print."""
    from neuroflight.sim.blackbox.quality import quality

    log = open_log(args)
    told = quality(log)
    tell_damage(log)
    if args.json:
        document = {
            "file": str(args.file),
            "log": log.number,
            "firmware": log.maker.value,
            "rows": told.rows,
            "seconds": told.seconds,
            "rate_hz": told.rate_hz,
            "control_rate_hz": told.control_rate_hz,
            "lost_rows": told.lost,
            "longest_gap_s": told.longest_gap_s,
            "gyro_saturated": list(told.gyro_saturated),
            "motors_full": told.motors_full,
            "motors_idle": told.motors_idle,
            "questions": [
                {"name": one.name, "answer": one.answer.value, "why": one.why} for one in told.questions
            ],
            "warnings": list(told.warnings),
        }
        print(json.dumps(document, indent=2))
        return 0
    rows = [("question", "answer", "")]
    rows += [(one.name, one.answer.value, one.why) for one in told.questions]
    title = (
        f"{args.file.name}: log {log.number}, {log.maker.value}, {told.rows:,} rows in {told.seconds:.1f} s"
    )
    print_table(title, rows, left=True)
    for warning in told.warnings:
        print(f"warning: {warning}")
    return 0
