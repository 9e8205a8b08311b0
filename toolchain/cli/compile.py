"""`neuroflight compile POLICY.onnx --out DIR`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("policy", type=Path, metavar="POLICY.onnx")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="gets policy.c and policy.h")
    parser.add_argument("--json", action="store_true", help="print what was done as JSON")


def run(args: argparse.Namespace) -> int:
    """Write DIR/policy.c and DIR/policy.h and say what they hold."""
    from toolchain.compiler import compile_policy
    from toolchain.files import write_text
    from toolchain.network import read_policy

    compiled = compile_policy(read_policy(args.policy))
    paths = {"source": args.out / "policy.c", "header": args.out / "policy.h"}
    write_text(paths["source"], compiled.emission.source)
    write_text(paths["header"], compiled.emission.header)
    facts = {
        "network": compiled.policy.network.text,
        "weights": int(compiled.plan.table.size),
        "architecture_hash": f"{compiled.plan.architecture_hash:08x}",
        "policy_sha256": compiled.policy.source_sha256,
        "savings": [vars(saving) for saving in compiled.savings],
        **{name: str(path) for name, path in paths.items()},
    }
    if args.json:
        print(json.dumps(facts, indent=2))
    else:
        print(f"{facts['network']}, {facts['weights']} weights -> {paths['source']}, {paths['header']}")
    return 0
