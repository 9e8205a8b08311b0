"""`neuroflight freeze CHECKPOINT --out POLICY.onnx`."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("checkpoint", type=Path, metavar="CHECKPOINT", help="checkpoint.pt of a training")
    parser.add_argument("--out", type=Path, required=True, metavar="POLICY.onnx")


def run(args: argparse.Namespace) -> int:
    """Write POLICY.onnx and say what it holds."""
    from toolchain.freeze import freeze
    from toolchain.network import read_policy

    freeze(args.checkpoint, args.out)
    policy = read_policy(args.out)
    print(
        f"{args.checkpoint} -> {args.out}: {policy.network.text}, {policy.aircraft}, "
        f"{policy.control_rate_hz} Hz"
    )
    return 0
