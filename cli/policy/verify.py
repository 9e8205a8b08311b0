"""`neuroflight policy verify POLICY.onnx`: run one policy on every machine and compare them."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.options import Json
from neuroflight.cli.progress import step_bars
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Argument, Either, Option, Request
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.toolchain.codegen.compiler import CompiledPolicy
    from neuroflight.toolchain.verification.tolerance import GroupFigures
    from neuroflight.toolchain.verification.verify import Verification

NOTHING = "-"
ULP_SHOWN, SHARE_SHOWN = 1e6, 10.0  # beyond, digits say no more
TORCH = Either()
CHECKPOINT = "checkpoint.pt"


@dataclass(frozen=True, kw_only=True)
class Verify(Request):
    """A request to compare all machines on one policy."""

    policy: Annotated[Path, Argument("POLICY.onnx", "to run")]
    checkpoint: Annotated[
        Path | None, Option("FILE", "run torch on it; default: checkpoint.pt beside the policy", either=TORCH)
    ] = None
    no_torch: Annotated[bool, Option(None, "leave torch out", either=TORCH)] = False
    count: Annotated[int, Option("N", "observations of each kind; default: 2000", low=1, high=100_000)] = 2000
    seed: Annotated[int, Option("S", "of the random observations", low=0)] = 0
    allow_missing: Annotated[
        bool, Option(None, "exit 0 although a machine's tool is not installed", recorded=False)
    ] = False
    json: Json = False

    def run(self) -> int:
        """Run the policy on all machines and print the results. Raises NeuroflightError if one differs."""
        from neuroflight.toolchain.codegen.compiler import compile_policy
        from neuroflight.toolchain.policy.model import read_policy
        from neuroflight.toolchain.verification.inputs import make_inputs
        from neuroflight.toolchain.verification.verify import all_candidates, verify

        beside = self.policy.with_name(CHECKPOINT)
        checkpoint = self.checkpoint or (beside if beside.is_file() and not self.no_torch else None)
        compiled = compile_policy(read_policy(self.policy))
        with tempfile.TemporaryDirectory(prefix="neuroflight-") as folder, step_bars({}, self.json) as show:
            candidates = all_candidates(compiled, self.policy.read_bytes(), Path(folder), checkpoint)
            seen = verify(
                compiled,
                candidates,
                make_inputs(compiled.policy.observation_count, self.count, self.seed),
                seed=self.seed,
                progress=show,
            )
        if self.json:
            print_json(_document(self, compiled, seen))
        else:
            _print(self, compiled, seen)
        if seen.finding:
            raise NeuroflightError(f"{self.policy}: {seen.finding.message}")
        if seen.missing and not self.allow_missing:
            reasons = "; ".join(f"{machine.name} not run: {machine.not_run}" for machine in seen.missing)
            raise NeuroflightError(f"{self.policy}: incomplete: {reasons}; or allow it with --allow-missing")
        return 0


def _document(args: Verify, compiled: CompiledPolicy, seen: Verification) -> dict[str, Any]:
    from neuroflight.toolchain.verification.tolerance import ROUNDING, TOLERANCE

    return {
        "command": args.command,
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


def _print(args: Verify, compiled: CompiledPolicy, seen: Verification) -> None:
    policy = compiled.policy
    machines = [("machine", "inputs", "worst error", "ulp", "of allowed", "verdict")]
    for machine in seen.machines:
        figures = [_worst(machine.figures, name) for name in ("error", "ulp", "share")]
        count = f"{machine.count:,}" if machine.count else NOTHING
        law = f": {machine.finding.law}" if machine.finding else ""
        machines.append((machine.name, count, *_cells(*figures), machine.verdict + law))
    groups = [("inputs", "number", "compared", "worst error", "ulp", "of allowed", "onnxruntime")]
    ours = next(machine for machine in seen.machines if machine.name == "evaluator")
    for group in ours.figures:
        numbers = (f"{group.count:,}", f"{group.compared:,}")
        errors = _cells(group.error, group.ulp, group.share)
        groups.append((group.inputs, *numbers, *errors, _cells(group.difference)[0]))
    not_run = [f"{machine.name} not run: {machine.not_run}\n" for machine in seen.machines if machine.not_run]
    title = f"{args.policy.name}: {policy.network.text}, {policy.control_rate_hz} Hz"
    print_table(title, machines, "".join(not_run), numbers=machines[0][1:-1])
    print_table("\nThe compiled policy by kind of input", groups)
    print(f"\n{_closing(seen)}")


def _cells(error: float | None, ulp: float | None = None, share: float | None = None) -> tuple[str, str, str]:
    return (
        NOTHING if error is None else f"{error:.1e}",
        NOTHING if ulp is None else f"{ulp:,.0f}" if ulp < ULP_SHOWN else f"{ulp:.1e}",
        NOTHING if share is None else f"{100 * share:.0f} %" if share < SHARE_SHOWN else "far over",
    )


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
