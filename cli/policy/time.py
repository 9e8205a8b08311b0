"""`neuroflight policy time`: instructions, predicted cycles and memory of a policy on the board."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.options import Json
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Argument, Option, Request

if TYPE_CHECKING:
    from rich.table import Table

    from neuroflight.toolchain.codegen.compiler import CompiledPolicy
    from neuroflight.toolchain.cortex_m7.cycles import BlockCost
    from neuroflight.toolchain.cortex_m7.timing import Timing

INPUTS_MAX = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Time(Request):
    """A request to count a policy's instructions and cycles."""

    policy: Annotated[Path, Argument("POLICY.onnx", "whose step is counted")]
    inputs: Annotated[int, Option("N", "observations to try; default: 300", low=1, high=INPUTS_MAX)] = 300
    unoptimized: Annotated[
        bool, Option(None, "a policy as it stands too, before optimization, and what that saves")
    ] = False
    blocks: Annotated[bool, Option(None, "where the worst case spends its cycles")] = False
    json: Json = False

    def run(self) -> int:
        """Build the policy for the Cortex-M7, run it there on many observations and print its cost."""
        from neuroflight.toolchain.codegen.compiler import compile_network, compile_policy
        from neuroflight.toolchain.cortex_m7.timing import mixed_observations, time_policy
        from neuroflight.toolchain.errors import NeuroflightError
        from neuroflight.toolchain.policy.model import read_policy

        if self.policy.suffix == ".bin":
            raise NeuroflightError(f"{self.policy}: is an image; run: neuroflight image time {self.policy}")
        compiled = [compile_policy(read_policy(self.policy))]
        if self.unoptimized:
            compiled.append(compile_network(compiled[0].policy, compiled[0].policy.network))
        with tempfile.TemporaryDirectory(prefix="neuroflight-") as folder, progress_bars(self.json) as bar:
            shown, whole = bar("observations"), self.inputs * len(compiled)
            timings = []
            for number, each in enumerate(compiled):

                def show(done: int, _: int, before: int = number * self.inputs) -> None:
                    shown(before + done, whole)

                observations = mixed_observations(self.inputs, each.network.inputs)
                timings.append(time_policy(each, Path(folder), observations, progress=show))
        timing = timings[0]
        effect = _effect(compiled, timings) if self.unoptimized else None
        if self.json:
            print_json(_document(self, timing) | ({"optimization": effect} if effect else {}))
        else:
            _print(self, timing)
            if effect:
                _print_effect(effect)
        return 0


def _effect(compiled: Sequence[CompiledPolicy], timings: Sequence[Timing]) -> dict[str, Any]:
    """Return the effect of optimization; compiled and timings: of the policy after it and before it."""
    after, before = map(_figures, compiled, timings)
    saved = {name: None if value is None else value - after[name] for name, value in before.items()}
    return {"before": before, "after": after, "saved": saved}


def _figures(compiled: CompiledPolicy, timing: Timing) -> dict[str, Any]:
    from neuroflight.toolchain.passes import size

    cycles = None if timing.cost.cycles is None else timing.cost.cycles[1]
    return {
        "nodes": len(compiled.network.nodes),
        "operations": size(compiled.network).operations,
        "source_bytes": len(compiled.emission.source.encode()),
        "code_bytes": timing.code_bytes,
        "weight_bytes": timing.weight_bytes,
        "instructions": timing.cost.instructions[1],
        "microseconds": None if cycles is None else timing.microseconds(cycles),
    }


def _print_effect(effect: dict[str, Any]) -> None:
    rows: list[tuple[str, ...]] = [("optimization", *effect)]
    for name, value in effect["before"].items():
        if value is not None:
            cells = (effect[column][name] for column in effect)
            told = (f"{n:,.1f}" if isinstance(n, float) else f"{n:,}" for n in cells)
            rows.append((name.replace("_", " "), *told))
    print_table("", rows)


def _document(args: Time, timing: Timing) -> dict[str, Any]:
    from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ

    fewest, most = timing.cost.instructions
    worst = timing.cost.worst
    document: dict[str, Any] = {
        "policy": str(args.policy),
        "network": timing.network,
        "control_rate_hz": timing.control_rate_hz,
        "core_hz": CORE_HZ,
        "observations": timing.observations,
        "routes": len(timing.cost.routes),
        "instructions": {"worst": most, "best": fewest},
        "predicted_cycles": _cycles(timing),
        "predicted_cycles_reason": timing.cost.no_cycles_reason,
        "multiply_accumulates": timing.multiply_accumulates,
        "conditional_instructions": worst.conditional,
        "stack_bytes": timing.cost.stack_bytes,
        "state_bytes": timing.state_bytes,
        "code_bytes": timing.code_bytes,
        "constant_bytes": timing.constant_bytes,
        "weight_bytes": timing.weight_bytes,
        "compiler": timing.compiler,
        "model": timing.cost.pricer or None,
    }
    if args.blocks:
        document["blocks"] = [_block(block) for block in worst.blocks]
    return document


def _cycles(timing: Timing) -> dict[str, dict[str, float]] | None:
    if timing.cost.cycles is None:
        return None
    return {
        name: {
            "cycles": cycles,
            "microseconds": timing.microseconds(cycles),
            "share_of_period": timing.share(cycles),
            "cycles_per_multiply_accumulate": timing.limit_ratio(cycles),
        }
        for name, cycles in zip(("best", "worst"), timing.cost.cycles, strict=True)
    }


def _block(block: BlockCost) -> dict[str, Any]:
    first = block.instructions[0]
    return {
        "address": first.address,
        "function": first.function,
        "line": first.line or None,
        "times": block.times,
        "instructions": len(block.instructions),
        "cycles": block.cycles,
        "listing": [instruction.text for instruction in block.instructions],
    }


def _print(args: Time, timing: Timing) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False)
    cost = timing.cost
    console.print(
        f"{args.policy.name}: {timing.network} at {timing.control_rate_hz} Hz, "
        f"{timing.multiply_accumulates:,} multiply-accumulates"
    )
    table = Table(box=None, pad_edge=False)
    for heading in ("policy_step on the Cortex-M7", "worst", "best"):
        table.add_column(heading, justify="right" if table.columns else "left", no_wrap=True)
    for name, values in _rows(timing):
        table.add_row(name, *values)
    console.print(table)
    same = "all on one route" if len(cost.routes) == 1 else f"on {len(cost.routes)} routes"
    console.print(f"{timing.observations:,} observations, {same}. {_provenance(timing)}", style="dim")
    if args.blocks:
        console.print()
        console.print(_account(timing))


def _provenance(timing: Timing) -> str:
    if timing.cost.no_cycles_reason:
        return f"No predicted cycles: {timing.cost.no_cycles_reason}"
    return f"Instructions are exact, cycles predicted by {timing.cost.pricer} (docs/explanation/timing.md)."


def _rows(timing: Timing) -> Sequence[tuple[str, tuple[str, ...]]]:
    """Return names with the worst and the best value."""
    from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ

    fewest, most = timing.cost.instructions
    rows: list[tuple[str, tuple[str, ...]]] = [("instructions", (f"{most:,}", f"{fewest:,}"))]
    if timing.cost.cycles is not None:
        cycles = timing.cost.cycles[::-1]
        rows += [
            ("predicted cycles", tuple(f"{count:,.0f}" for count in cycles)),
            (f"  µs at {CORE_HZ / 1e6:g} MHz", tuple(f"{timing.microseconds(n):.1f}" for n in cycles)),
            ("  % of the control period", tuple(f"{100 * timing.share(n):.1f}" for n in cycles)),
            ("  for a multiply-accumulate", tuple(f"{timing.limit_ratio(n):.2f}" for n in cycles)),
        ]
    return rows + [
        (name, (f"{count:,}",))
        for name, count in (
            ("conditional instructions", timing.cost.worst.conditional),
            ("stack, bytes", timing.cost.stack_bytes),
            ("struct policy, bytes", timing.state_bytes),
            ("code, bytes", timing.code_bytes),
            ("weights, bytes", timing.weight_bytes),
            ("other constants, bytes", timing.constant_bytes),
        )
    ]


def _account(timing: Timing) -> Table:
    """Return a table of the worst route's blocks, dearest first; by instructions where cycles are unknown."""
    from rich.markup import escape
    from rich.table import Table

    priced = timing.cost.cycles is not None
    worst = timing.cost.worst
    whole = (worst.cycles if priced else None) or worst.instructions
    table = Table(box=None, pad_edge=False)
    for heading in ("%", "cycles", "times", "each", "instr."):
        if priced or heading not in ("cycles", "each"):
            table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("address", no_wrap=True)
    table.add_column("function:line")
    table.add_column("begins with")
    for block in sorted(
        worst.blocks, key=lambda b: (b.total_cycles or 0, b.total_instructions), reverse=True
    ):
        first, total = block.instructions[0], block.total_cycles
        part = block.total_instructions if total is None else total
        cells = [f"{100 * part / whole:.1f}"]
        cells += (
            [f"{block.times}"] if total is None else [f"{total:,.0f}", f"{block.times}", f"{block.cycles:g}"]
        )
        function = first.function.partition(".")[0]  # without what gcc adds to the name of a clone
        place = ":".join(filter(None, (function, first.line.rpartition(":")[2])))
        table.add_row(*cells, f"{len(block.instructions)}", f"{first.address:x}", place, escape(first.text))
    return table
