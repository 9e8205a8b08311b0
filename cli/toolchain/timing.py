"""`neuroflight timing POLICY.onnx`: instructions, predicted cycles and memory of a policy on the board.

Of an image, `neuroflight timing IMAGE.bin`, the control tasks: `timing_image.py`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

    from neuroflight.toolchain.codegen.compiler import CompiledPolicy
    from neuroflight.toolchain.cortex_m7.cycles import BlockCost
    from neuroflight.toolchain.cortex_m7.timing import Timing

INPUTS_MAX = 1_000_000
DEFAULTS = {"inputs": 300, "aircraft": "nf1", "count": 3, "seed": 1, "disarmed": 0, "serial": 0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "policy",
        type=Path,
        metavar="POLICY.onnx|IMAGE.bin",
        help="a policy, of which the step is counted, or an image, whose control tasks are counted in flight",
    )
    parser.add_argument(
        "--inputs", type=int, metavar="N", help=f"observations to try; default: {DEFAULTS['inputs']}"
    )
    parser.add_argument(
        "--unoptimized",
        action="store_true",
        help="a policy as it stands too, before optimization, and what that saves",
    )
    parser.add_argument("--blocks", action="store_true", help="where the worst case spends its cycles")
    parser.add_argument(
        "--aircraft", metavar="NAME|FILE", help=f"whose twin an image flies; default: {DEFAULTS['aircraft']}"
    )
    parser.add_argument(
        "--count", type=int, metavar="N", help=f"commands that it flies; default: {DEFAULTS['count']}"
    )
    parser.add_argument(
        "--seed", type=int, metavar="S", help=f"of commands and noise; default: {DEFAULTS['seed']}"
    )
    parser.add_argument(
        "--disarmed",
        type=int,
        metavar="N",
        help="control steps of another board that stays disarmed; default: 0, those before arming alone",
    )
    parser.add_argument(
        "--serial",
        type=int,
        metavar="N",
        help="ask the firmware over its UART how long N control tasks of an idle board and those of the "
        "flights took; default: 0, do not ask",
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw how long an image's runs took")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Print what a policy or an image takes on the board."""
    from neuroflight.cli.toolchain import timing_image

    of_image = args.policy.suffix == ".bin"
    _reject(
        args,
        ("inputs", "blocks", "unoptimized")
        if of_image
        else ("aircraft", "count", "seed", "disarmed", "serial", "plot"),
        of_image,
    )
    for name, default in DEFAULTS.items():
        if getattr(args, name) is None:
            setattr(args, name, default)
    return timing_image.run(args) if of_image else _time_policy(args)


def _reject(args: argparse.Namespace, names: Sequence[str], of_image: bool) -> None:
    """Say which option has no meaning for what was given."""
    from neuroflight.toolchain.errors import NeuroflightError

    for name in names:
        if getattr(args, name) not in (None, False):
            other = "a policy, and this is an image" if of_image else "an image, and this is a policy"
            raise NeuroflightError(f"--{name}: is about {other}; leave it out")


def _time_policy(args: argparse.Namespace) -> int:
    """Build the policy for the Cortex-M7, run it there on many observations and print what it takes."""
    from rich.console import Console
    from rich.progress import Progress

    from neuroflight.toolchain.codegen.compiler import compile_network, compile_policy
    from neuroflight.toolchain.cortex_m7.timing import mixed_observations, time_policy
    from neuroflight.toolchain.errors import NeuroflightError
    from neuroflight.toolchain.policy.model import read_policy

    if not 1 <= args.inputs <= INPUTS_MAX:
        raise NeuroflightError(f"--inputs {args.inputs}, expected 1 to {INPUTS_MAX}")
    compiled = [compile_policy(read_policy(args.policy))]
    if args.unoptimized:
        compiled.append(compile_network(compiled[0].policy, compiled[0].policy.network))
    quiet = args.json or not sys.stderr.isatty()
    with (
        tempfile.TemporaryDirectory(prefix="neuroflight-") as folder,
        Progress(console=Console(stderr=True), transient=True, disable=quiet) as bar,
    ):
        task = bar.add_task("observations", total=args.inputs * len(compiled))
        timings = []
        for number, each in enumerate(compiled):

            def show(done: int, _: int, before: int = number * args.inputs) -> None:
                bar.update(task, completed=before + done)

            observations = mixed_observations(args.inputs, each.network.inputs)
            timings.append(time_policy(each, Path(folder), observations, progress=show))
    timing = timings[0]
    effect = _effect(compiled, timings) if args.unoptimized else None
    if args.json:
        print(json.dumps(_document(args, timing) | ({"optimization": effect} if effect else {}), indent=2))
    else:
        _print(args, timing)
        if effect:
            _print_effect(effect)
    return 0


def _effect(compiled: Sequence[CompiledPolicy], timings: Sequence[Timing]) -> dict[str, Any]:
    """What optimization changes; compiled and timings: of the policy after it and before it."""
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
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("optimization", *effect):
        table.add_column(heading, justify="right" if table.columns else "left", no_wrap=True)
    for name, value in effect["before"].items():
        if value is not None:
            cells = (effect[column][name] for column in effect)
            table.add_row(
                name.replace("_", " "), *(f"{n:,.1f}" if isinstance(n, float) else f"{n:,}" for n in cells)
            )
    Console(highlight=False).print(table)


def _document(args: argparse.Namespace, timing: Timing) -> dict[str, Any]:
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


def _print(args: argparse.Namespace, timing: Timing) -> None:
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
    """Names with the worst and the best value."""
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
    """The blocks of the worst route, the dearest first; by instructions where there are no cycles."""
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
