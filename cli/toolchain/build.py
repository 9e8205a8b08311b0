"""`neuroflight build --target MATEKF722 --policy POLICY.onnx`."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHIPPED_POLICY = ROOT / "training" / "policies" / "nf1" / "policy.onnx"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("--target", default="MATEKF722", help="MATEKF722 (default) or HOST")
    parser.add_argument(
        "--policy",
        type=Path,
        default=SHIPPED_POLICY,
        metavar="POLICY.onnx",
        help="default: the shipped policy of the NF1",
    )
    parser.add_argument(
        "--aircraft",
        metavar="NAME|FILE",
        help="whose PID stands beside the policy; default: the aircraft that the policy names",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="instead of build/ and firmware/generated/")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")


def run(args: argparse.Namespace) -> int:
    """Build and print the report; what the compiler said is shown only when it failed."""
    from rich.console import Console

    from cli.output import check_folder
    from sim.control.pid_table import named_pid_table, shipped_pid_table
    from toolchain.image.build import MakeError, build, find_target
    from toolchain.image.report import print_report
    from toolchain.policy.model import read_policy

    find_target(args.target)
    check_folder(args.out or ROOT / "build", "--out")
    if args.out is None:
        check_folder(ROOT / "firmware" / "generated", "--out")
    if args.aircraft is None:
        pid = shipped_pid_table(read_policy(args.policy).aircraft)
    else:
        pid = named_pid_table(args.aircraft)
    try:
        report = build(args.target, args.policy, ROOT, args.out, pid)
    except MakeError as error:
        print(error.output, file=sys.stderr)
        raise
    if args.json:
        print(json.dumps(report.document(), indent=2))
    else:
        print_report(report, Console())
    return 0
