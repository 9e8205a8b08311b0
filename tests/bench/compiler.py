"""What compiled networks take on the Cortex-M7: ours beside emx-onnx-cgen's, same flags, same counting."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.contract import observation_blocks
from neuroflight.toolchain.cortex_m7.timing import Cost, mixed_observations, time_policy
from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.ir.network import Network, chain
from neuroflight.toolchain.ir.operations import Clip, Linear, Operation, Tanh
from neuroflight.toolchain.policy.model import PolicyModel
from tests.bench import emx

OURS, THEIRS = "neuroflight", f"emx-onnx-cgen {emx.VERSION}"
OPTIMIZATIONS = ("-O2", "-O3")
THEIR_INPUTS = 300  # of unit scale: each takes another route, and each route its time
TOLERANCE = 1e-5  # absolute, of their actions from ours: they compute the same network


@dataclass(frozen=True)
class Bar:
    """What a network may take at most."""

    widths: tuple[int, ...]
    instructions: int
    cycles: int

    @property
    def name(self) -> str:
        """The widths, such as 6-32-32-4."""
        return "-".join(map(str, self.widths))


BARS = (Bar((6, 32, 32, 4), 3_300, 5_200), Bar((6, 64, 64, 4), 9_500, 14_500))


@dataclass(frozen=True)
class Row:
    """One network through one compiler."""

    network: str
    compiler: str
    optimization: str
    observations: int
    instructions: tuple[int, int]  # fewest, most
    cycles: tuple[float, float] | None
    no_cycles_reason: str | None
    stack_bytes: int
    instructions_bar: int | None
    cycles_bar: int | None


def rows(inputs: int) -> tuple[list[Row], list[str]]:
    """Every row, and notes on what is missing. inputs: observations that our code is run on."""
    notes: list[str] = []
    if reason := emx.fetch():
        notes.append(f"without emx-onnx-cgen: {reason}")
    measured: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="neuroflight-bench-") as folder:
        try:
            for bar in BARS:
                measured += _rows(bar, inputs, Path(folder), with_theirs=reason is None)
        except BuildError as error:
            notes.append(f"not counted: {error}")
    notes += dict.fromkeys(row.no_cycles_reason for row in measured if row.no_cycles_reason)
    return measured, notes


def print_table(measured: Sequence[Row], notes: Sequence[str]) -> None:
    """The rows, with bars and the variation of the number of instructions."""
    print(f"{'policy_step on the Cortex-M7':36}{'instructions':>16}{'varies':>8}{'cycles':>18}{'stack':>7}")
    for row in measured:
        fewest, most = row.instructions
        cycles = "" if row.cycles is None else _span(*map(round, row.cycles))
        name = f"{row.network} {row.optimization} {row.compiler}"
        print(f"{name:36}{_span(fewest, most):>16}{most / fewest - 1:>8.1%}{cycles:>18}{row.stack_bytes:>7,}")
        if row.instructions_bar and row.cycles_bar:
            print(f"{'  at most':36}{row.instructions_bar:>16,}{1 / 100:>8.1%}{row.cycles_bar:>18,}")
    counts = {row.compiler: row.observations for row in measured}
    for line in (*(f"{name}: {count:,} observations" for name, count in counts.items()), *notes):
        print(line)


def _span(least: int, most: int) -> str:
    return f"{most:,}" if least == most else f"{least:,}..{most:,}"


def _rows(bar: Bar, inputs: int, folder: Path, *, with_theirs: bool) -> Iterator[Row]:
    for optimization in OPTIMIZATIONS:
        yield our_row(bar, inputs, folder, optimization)
        if with_theirs:
            yield their_row(bar, folder, optimization)


def our_row(bar: Bar, inputs: int, folder: Path, optimization: str) -> Row:
    """Measure our code for the network of `bar` over `inputs` observations."""
    compiled = compile_policy(_policy(random_network(bar.widths)))
    observations = mixed_observations(inputs, compiled.network.inputs)
    cost = time_policy(compiled, folder, observations, optimization=optimization).cost
    return _row(bar.name, OURS, optimization, inputs, cost, bar)


def their_row(bar: Bar, folder: Path, optimization: str) -> Row:
    """Measure emx-onnx-cgen's code for it; `emx.fetch` must have installed the program."""
    network = random_network(bar.widths)
    unit = np.random.default_rng(1).normal(size=(THEIR_INPUTS, network.inputs)).astype(np.float32)
    emx.generate(network, folder)
    cost, action = emx.cost(network, folder, optimization, unit)
    _check(action, evaluate(compile_policy(_policy(network)).network, unit[-1:])[0])
    return _row(bar.name, THEIRS, optimization, len(unit), cost, None)


def _row(
    network: str, compiler: str, optimization: str, observations: int, cost: Cost, bar: Bar | None
) -> Row:
    return Row(
        network=network,
        compiler=compiler,
        optimization=optimization,
        observations=observations,
        instructions=cost.instructions,
        cycles=cost.cycles,
        no_cycles_reason=cost.no_cycles_reason,
        stack_bytes=cost.stack_bytes,
        instructions_bar=bar.instructions if bar else None,
        cycles_bar=bar.cycles if bar else None,
    )


def _check(theirs: Float32, ours: Float32) -> None:
    if not np.allclose(theirs, ours, rtol=0, atol=TOLERANCE):
        raise AssertionError(f"emx-onnx-cgen gives {theirs}, we {ours}: not the same network")


def random_network(widths: Sequence[int], seed: int = 0) -> Network:
    """A tanh perceptron with the weights that torch begins with: uniform within 1 / sqrt(inputs)."""
    rng = np.random.default_rng(seed)
    operations: list[Operation] = []
    for inputs, outputs in pairwise(widths):
        weight, bias = (
            rng.uniform(-(inputs**-0.5), inputs**-0.5, shape).astype(np.float32)
            for shape in ((outputs, inputs), outputs)
        )
        operations += [Linear(weight, bias), Tanh()]
    return chain(widths[0], [*operations[:-1], Clip(0.0, 1.0)])


def _policy(network: Network) -> PolicyModel:
    return PolicyModel(
        blocks=observation_blocks("rate_error,rate_error_delta"),
        control_rate_hz=1000,
        filters=(),
        aircraft="bench",
        aircraft_sha256="0" * 64,
        training={},
        source_sha256="0" * 64,
        network=network,
    )
