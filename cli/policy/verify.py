"""`neuroflight policy verify POLICY.onnx`: run one policy on every machine and compare them."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from rich.table import Table

    from neuroflight.toolchain.codegen.compiler import CompiledPolicy
    from neuroflight.toolchain.verification.tolerance import GroupFigures
    from neuroflight.toolchain.verification.verify import Verification

NOTHING = "-"
ULP_SHOWN, SHARE_SHOWN = 1e6, 10.0  # beyond, digits say no more
COUNT, COUNT_MAX = 2000, 100_000
CHECKPOINT = "checkpoint.pt"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", type=Path, metavar="POLICY.onnx")
    torch = parser.add_mutually_exclusive_group()
    torch.add_argument(
        "--checkpoint",
        type=Path,
        metavar="FILE",
        help="run torch on it; default: checkpoint.pt beside the policy",
    )
    torch.add_argument("--no-torch", action="store_true", help="leave torch out")
    parser.add_argument(
        "--count", type=int, default=COUNT, metavar="N", help=f"observations of each kind; default: {COUNT}"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the random observations")
    parser.add_argument(
        "--allow-missing", action="store_true", help="exit 0 although a machine's tool is not installed"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def run(args: argparse.Namespace) -> int:
    """Run the policy on all machines and print the results. Raises NeuroflightError if one differs."""
    from rich.console import Console
    from rich.progress import Progress, TaskID

    from neuroflight.toolchain.codegen.compiler import compile_policy
    from neuroflight.toolchain.policy.model import read_policy
    from neuroflight.toolchain.verification.inputs import make_inputs
    from neuroflight.toolchain.verification.verify import all_candidates, verify

    if not 1 <= args.count <= COUNT_MAX:
        raise NeuroflightError(f"--count {args.count}, expected 1 to {COUNT_MAX}")
    if args.seed < 0:
        raise NeuroflightError(f"--seed {args.seed}, expected 0 or more")
    beside = args.policy.with_name(CHECKPOINT)
    checkpoint = args.checkpoint or (beside if beside.is_file() and not args.no_torch else None)
    compiled = compile_policy(read_policy(args.policy))
    quiet = args.json or not sys.stderr.isatty()
    with (
        tempfile.TemporaryDirectory(prefix="neuroflight-") as folder,
        Progress(console=Console(stderr=True), transient=True, disable=quiet) as bar,
    ):
        candidates = all_candidates(compiled, args.policy.read_bytes(), Path(folder), checkpoint)
        tasks: dict[str, TaskID] = {}

        def show(machine: str, done: int, total: int) -> None:
            if machine not in tasks:
                tasks[machine] = bar.add_task(machine, total=total)
            bar.update(tasks[machine], completed=done)

        seen = verify(
            compiled,
            candidates,
            make_inputs(compiled.policy.observation_count, args.count, args.seed),
            seed=args.seed,
            progress=show,
        )
    if args.json:
        print(json.dumps(_document(args, compiled, seen), indent=2))
    else:
        _print(args, compiled, seen)
    if seen.finding:
        raise NeuroflightError(f"{args.policy}: {seen.finding.message}")
    if seen.missing and not args.allow_missing:
        reasons = "; ".join(f"{machine.name} not run: {machine.not_run}" for machine in seen.missing)
        raise NeuroflightError(f"{args.policy}: incomplete: {reasons}; or allow it with --allow-missing")
    return 0


def _document(args: argparse.Namespace, compiled: CompiledPolicy, seen: Verification) -> dict[str, Any]:
    from neuroflight.cli.output import command_line
    from neuroflight.toolchain.verification.tolerance import ROUNDING, TOLERANCE

    options = {
        "count": args.count,
        "seed": args.seed,
        "checkpoint": args.checkpoint,
        "no_torch": args.no_torch,
    }
    return {
        "command": command_line("policy verify", str(args.policy), **options),
        "policy_sha256": compiled.policy.source_sha256,
        "network": compiled.policy.network.text,
        "count": args.count,
        "seed": args.seed,
        "verdict": seen.verdict,
        "tolerance": TOLERANCE,
        "rounding": ROUNDING,
        "recovery": seen.recovery,
        "first_failure": asdict(seen.finding) if seen.finding else None,
        "machines": [
            {
                "name": machine.name,
                "required": machine.required,
                "verdict": machine.verdict,
                "not_run": machine.not_run,
                "observations": machine.count,
                "finding": asdict(machine.finding) if machine.finding else None,
                "inputs": [_finite(asdict(group)) for group in machine.figures],
            }
            for machine in seen.machines
        ],
    }


def _finite(figures: dict[str, Any]) -> dict[str, Any]:
    """Replace infinity (the distance of a NaN from anything), which JSON lacks, by a text."""
    return {name: "infinite" if value == float("inf") else value for name, value in figures.items()}


def _print(args: argparse.Namespace, compiled: CompiledPolicy, seen: Verification) -> None:
    from rich.console import Console

    policy = compiled.policy
    title = f"{args.policy.name}: {policy.network.text}, {policy.control_rate_hz} Hz"
    machines = _table(title, "machine", "inputs", "worst error", "ulp", "of allowed", "verdict")
    for machine in seen.machines:
        figures = [_worst(machine.figures, name) for name in ("error", "ulp", "share")]
        count = f"{machine.count:,}" if machine.count else NOTHING
        law = f": {machine.finding.law}" if machine.finding else ""
        machines.add_row(machine.name, count, *_cells(*figures), machine.verdict + law)
    groups = _table(
        "The compiled policy by kind of input",
        *("inputs", "number", "compared", "worst error", "ulp", "of allowed", "onnxruntime"),
    )
    ours = next(machine for machine in seen.machines if machine.name == "evaluator")
    for group in ours.figures:
        numbers = (f"{group.count:,}", f"{group.compared:,}")
        errors = _cells(group.error, group.ulp, group.share)
        groups.add_row(group.inputs, *numbers, *errors, _cells(group.difference)[0])
    console = Console(highlight=False)
    console.print(machines)
    for machine in seen.machines:
        if machine.not_run:
            console.print(f"{machine.name} not run: {machine.not_run}", style="dim")
    console.print()
    console.print(groups)
    console.print(f"\n{_closing(seen)}")


def _table(title: str, *headings: str) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for number, heading in enumerate(headings):
        table.add_column(
            heading, justify="right" if number and heading != "verdict" else "left", no_wrap=True
        )
    return table


def _cells(error: float | None, ulp: float | None = None, share: float | None = None) -> list[str]:
    return [
        NOTHING if error is None else f"{error:.1e}",
        NOTHING if ulp is None else f"{ulp:,.0f}" if ulp < ULP_SHOWN else f"{ulp:.1e}",
        NOTHING if share is None else f"{100 * share:.0f} %" if share < SHARE_SHOWN else "far over",
    ]


def _worst(figures: Sequence[GroupFigures], name: str) -> float | None:
    values = [getattr(group, name) for group in figures]
    return max((value for value in values if value is not None), default=None)


def _closing(seen: Verification) -> str:
    text = {
        "holds": "Holds: every machine is within what is allowed, host and Cortex-M7 give the same bits.",
        "fails": "Fails: the first law that is broken is said below.",
        "incomplete": "Incomplete: what ran holds, but not every machine ran.",
    }[seen.verdict]
    if seen.recovery is not None:
        text += f"\nA hundred steps after faults, actions are within {seen.recovery:.2g} of undisturbed ones."
    return text
