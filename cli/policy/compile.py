"""`neuroflight policy compile POLICY.onnx`: the policy's C, and an account of its making."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.options import Json
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Argument, Option, Request
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.toolchain.codegen.compiler import CompiledPolicy
    from neuroflight.toolchain.codegen.explain import Explanation, NodeFacts
    from neuroflight.toolchain.passes import Saving
    from neuroflight.toolchain.passes.equivalence import Equivalence
    from neuroflight.toolchain.policy.model import PolicyModel


@dataclass(frozen=True, kw_only=True)
class Compile(Request):
    """A request for a policy's C."""

    policy: Annotated[Path, Argument("POLICY.onnx", "to compile")]
    out: Annotated[Path | None, Option("DIR", "gets policy.c, policy.h and policy.blob")] = None
    explain: Annotated[
        bool,
        Option(None, "check every pass in onnxruntime, and print what each did and saved; needs no --out"),
    ] = False
    json: Json = False

    def run(self) -> int:
        """Write DIR/policy.c, DIR/policy.h and DIR/policy.blob and print their contents."""
        from neuroflight.cli.output import check_output
        from neuroflight.toolchain.codegen.compiler import compile_policy
        from neuroflight.toolchain.files import write_bytes, write_text
        from neuroflight.toolchain.policy.model import read_policy

        if self.out is None and not self.explain:
            raise NeuroflightError(
                "--out is missing; expected a directory for what is compiled, or --explain to write nothing"
            )
        check_output(self.out and self.out / "policy.c", ".c")
        policy = read_policy(self.policy)
        explanation = _explain(self, policy) if self.explain else None
        compiled = explanation.compiled if explanation else compile_policy(policy)
        files = {}
        if self.out is not None:
            files = {
                "source": self.out / "policy.c",
                "header": self.out / "policy.h",
                "blob": self.out / "policy.blob",
            }
            write_text(files["source"], compiled.emission.source)
            write_text(files["header"], compiled.emission.header)
            write_bytes(files["blob"], compiled.emission.blob)
        if self.json:
            print_json(_document(compiled, explanation, files))
            return 0
        if explanation:
            _print(self.policy, explanation)
        if files:
            facts = f"{policy.network.text}, {compiled.plan.table.size} weights"
            print(f"{facts} -> {', '.join(map(str, files.values()))}")
        return 0


def _explain(args: Compile, policy: PolicyModel) -> Explanation:
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
    policy = explanation.compiled.policy
    print(f"{file.name}: {policy.network.text}, {policy.control_rate_hz} Hz\n")
    _print_passes(explanation)
    before, after = explanation.before, explanation.after
    if explanation.compiled.savings:
        _print_network(f"Network before, {len(before)} nodes", before)
    _print_network(f"Network that is compiled, {len(after)} nodes", after)
    memory = explanation.memory
    shared = f"values between; {memory.scratch_unshared:,} had each its own space"
    rows = [
        ("", "bytes", " "),
        ("weights", f"{memory.weights:,}", "one table, with the tables of functions and padding"),
        ("scratch", f"{memory.scratch:,}", shared),
        ("state", f"{memory.state:,}", "of recurrent cells"),
    ]
    print_table("Memory", rows, numbers=["bytes"])


def _print_passes(explanation: Explanation) -> None:
    from neuroflight.toolchain.passes import PASSES

    savings, proof = explanation.compiled.savings, explanation.proof
    if proof is None:
        print(f"Passes: none of {len(PASSES)} found anything to do.\n")
        return
    finds = {step.name: step.finds for step in PASSES}
    rows: list[tuple[str, ...]] = [
        ("pass", "what it finds", "nodes", "operations", "bytes", "difference", "beyond")
    ]
    for saving in savings:
        rows.append((saving.rewrite, finds[saving.rewrite], *_saved(saving), *_proof(saving.proof)))
    less, now = explanation.size_before, explanation.size_after
    sums = (less.nodes - now.nodes, less.operations - now.operations, less.bytes - now.bytes)
    rows.append(("together", "", *(f"{-value:+,}" for value in sums), *_proof(proof)))
    idle = [step.name for step in PASSES if step.name not in {saving.rewrite for saving in savings}]
    note = (
        f"{less.nodes} → {now.nodes} nodes, {less.operations:,} → {now.operations:,} operations, "
        f"{less.bytes:,} → {now.bytes:,} bytes of weights\n"
    )
    if idle:
        note += f"Nothing to do for: {', '.join(idle)}.\n"
    note += (
        "Difference: the worst of an action between before and after in onnxruntime, at unit scale;\n"
        f"beyond it, per unit of the largest observed value. Allowed is {proof.bound:g}, or a few times\n"
        f"what rounding does anyway. Of {proof.observations:,} observations "
        f"{proof.overflowing:,} overflow on\nthe way and are not compared.\n"
    )
    print_table("Passes", rows, note, numbers=rows[0][2:])


def _saved(saving: Saving) -> tuple[str, ...]:
    values = (saving.nodes, saving.operations, saving.bytes)
    return tuple(f"{-value:+,}" if value else "0" for value in values)


def _proof(proof: Equivalence | None) -> tuple[str, ...]:
    values = (proof.unit, proof.beyond) if proof else ()
    return tuple(f"{value:.1e}" if value else "0" for value in values) or ("", "")


def _print_network(title: str, nodes: Iterable[NodeFacts]) -> None:
    rows: list[tuple[str, ...]] = [("value", "operation", "takes", "width", "operations", "bytes", "node")]
    rows.append(("0", "observation", *[""] * 5))
    for node in nodes:
        takes, figures = " ".join(map(str, node.takes)), (node.width, node.operations, node.bytes)
        rows.append((str(node.value), node.operation, takes, *(f"{f:,}" for f in figures), node.name))
    print_table(title, rows, " ", numbers=("value", "width", "operations", "bytes"))
