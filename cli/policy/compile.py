"""`neuroflight policy compile POLICY.onnx`: the policy's C, and an account of its making."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from neuroflight.toolchain.codegen.compiler import CompiledPolicy
    from neuroflight.toolchain.codegen.explain import Explanation, NodeFacts
    from neuroflight.toolchain.passes import Saving
    from neuroflight.toolchain.passes.equivalence import Equivalence
    from neuroflight.toolchain.policy.model import PolicyModel

FINDS = "what it finds"  # the one column that may wrap


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", type=Path, metavar="POLICY.onnx")
    parser.add_argument("--out", type=Path, metavar="DIR", help="gets policy.c, policy.h and policy.blob")
    parser.add_argument(
        "--explain",
        action="store_true",
        help="check every pass in onnxruntime, and print what each did and saved; needs no --out",
    )
    parser.add_argument("--json", action="store_true", help="print what was done as JSON")


def run(args: argparse.Namespace) -> int:
    """Write DIR/policy.c, DIR/policy.h and DIR/policy.blob and print their contents."""
    from neuroflight.cli.output import check_output
    from neuroflight.toolchain.codegen.compiler import compile_policy
    from neuroflight.toolchain.files import write_bytes, write_text
    from neuroflight.toolchain.policy.model import read_policy

    if args.out is None and not args.explain:
        raise NeuroflightError(
            "--out is missing; expected a directory for what is compiled, or --explain to write nothing"
        )
    check_output(args.out and args.out / "policy.c", ".c")
    policy = read_policy(args.policy)
    explanation = _explain(args, policy) if args.explain else None
    compiled = explanation.compiled if explanation else compile_policy(policy)
    files = {}
    if args.out is not None:
        files = {
            "source": args.out / "policy.c",
            "header": args.out / "policy.h",
            "blob": args.out / "policy.blob",
        }
        write_text(files["source"], compiled.emission.source)
        write_text(files["header"], compiled.emission.header)
        write_bytes(files["blob"], compiled.emission.blob)
    if args.json:
        print(json.dumps(_document(compiled, explanation, files), indent=2))
        return 0
    if explanation:
        _print(args.policy, explanation)
    if files:
        facts = f"{policy.network.text}, {compiled.plan.table.size} weights"
        print(f"{facts} -> {', '.join(map(str, files.values()))}")
    return 0


def _explain(args: argparse.Namespace, policy: PolicyModel) -> Explanation:
    from rich.console import Console

    from neuroflight.toolchain.codegen.explain import explain_policy

    console = Console(stderr=True, quiet=args.json or not sys.stderr.isatty())
    with console.status("checking every pass in onnxruntime"):
        return explain_policy(policy)


def _document(
    compiled: CompiledPolicy, explanation: Explanation | None, files: dict[str, Path]
) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "network": compiled.policy.network.text,
        "weights": int(compiled.plan.table.size),
        "architecture_hash": f"{compiled.plan.architecture_hash:08x}",
        "policy_sha256": compiled.policy.source_sha256,
        "savings": [asdict(saving) for saving in compiled.savings],
        **{name: str(path) for name, path in files.items()},
    }
    if explanation:
        facts |= {
            "proof": asdict(explanation.proof) if explanation.proof else None,
            "memory": asdict(explanation.memory),
            "before": {**asdict(explanation.size_before), "network": _nodes(explanation.before)},
            "after": {**asdict(explanation.size_after), "network": _nodes(explanation.after)},
        }
    return facts


def _nodes(nodes: Iterable[NodeFacts]) -> list[dict[str, Any]]:
    return [asdict(node) for node in nodes]


def _print(file: Path, explanation: Explanation) -> None:
    from rich.console import Console

    policy = explanation.compiled.policy
    console = Console(highlight=False)
    console.print(f"{file.name}: {policy.network.text}, {policy.control_rate_hz} Hz\n", markup=False)
    _print_passes(console, explanation)
    before, after = explanation.before, explanation.after
    if explanation.compiled.savings:
        console.print(_network(f"Network before, {len(before)} nodes", before), "")
    console.print(_network(f"Network that is compiled, {len(after)} nodes", after), "")
    memory = explanation.memory
    table = _table("Memory", "", "bytes", "")
    table.add_row("weights", f"{memory.weights:,}", "one table, with the tables of functions and padding")
    shared = f"values between; {memory.scratch_unshared:,} had each its own space"
    table.add_row("scratch", f"{memory.scratch:,}", shared)
    table.add_row("state", f"{memory.state:,}", "of recurrent cells")
    console.print(table)


def _print_passes(console: Console, explanation: Explanation) -> None:
    from neuroflight.toolchain.passes import PASSES

    savings, proof = explanation.compiled.savings, explanation.proof
    if proof is None:
        console.print(f"Passes: none of {len(PASSES)} found anything to do.\n")
        return
    table = _table("Passes", "pass", FINDS, "nodes", "operations", "bytes", "difference", "beyond")
    finds = {step.name: step.finds for step in PASSES}
    for saving in savings:
        table.add_row(saving.rewrite, finds[saving.rewrite], *_saved(saving), *_proof(saving.proof))
    less, now = explanation.size_before, explanation.size_after
    sums = (less.nodes - now.nodes, less.operations - now.operations, less.bytes - now.bytes)
    table.add_row("together", "", *(f"{-value:+,}" for value in sums), *_proof(proof), style="bold")
    console.print(table)
    console.print(
        f"{less.nodes} → {now.nodes} nodes, {less.operations:,} → {now.operations:,} operations, "
        f"{less.bytes:,} → {now.bytes:,} bytes of weights\n"
    )
    idle = [step.name for step in PASSES if step.name not in {saving.rewrite for saving in savings}]
    if idle:
        console.print(f"Nothing to do for: {', '.join(idle)}.", style="dim")
    console.print(
        "Difference: the worst of an action between before and after in onnxruntime, at unit scale;\n"
        f"beyond it, per unit of the largest observed value. Allowed is {proof.bound:g}, or a few times\n"
        f"what rounding does anyway. Of {proof.observations:,} observations "
        f"{proof.overflowing:,} overflow on\nthe way and are not compared.\n",
        style="dim",
    )


def _saved(saving: Saving) -> list[str]:
    return [f"{-value:+,}" if value else "0" for value in (saving.nodes, saving.operations, saving.bytes)]


def _proof(proof: Equivalence | None) -> list[str]:
    return [f"{value:.1e}" if value else "0" for value in (proof.unit, proof.beyond)] if proof else []


def _network(title: str, nodes: Iterable[NodeFacts]) -> Table:
    table = _table(title, "value", "operation", "takes", "width", "operations", "bytes", "node")
    table.add_row("0", "observation", style="dim")
    for node in nodes:
        takes, figures = " ".join(map(str, node.takes)), (node.width, node.operations, node.bytes)
        table.add_row(str(node.value), node.operation, takes, *(f"{f:,}" for f in figures), node.name)
    return table


def _table(title: str, *headings: str) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=None, padding=(0, 2, 0, 0))
    words = ("", "pass", FINDS, "operation", "takes", "node")
    for heading in headings:
        table.add_column(heading, justify="left" if heading in words else "right", no_wrap=heading != FINDS)
    return table
