"""The time of a policy's step on the board's Cortex-M7, over many observations, and its memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroflight.toolchain.codegen.compiler import CompiledPolicy
from neuroflight.toolchain.cortex_m7.arm_policy import (
    ArmPolicy,
    build_policy_elf,
    compiler_version,
    state_bytes,
)
from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ, Route, RouteCost, price_routes, route_of
from neuroflight.toolchain.cortex_m7.disassembly import disassemble
from neuroflight.toolchain.cortex_m7.emulator import CortexM7, load_program
from neuroflight.toolchain.ir.float32 import Float32

STACK_ROUTES = 100  # whose stack is measured
ONE_OF = 3  # observations in so many are of unit scale; as many of any scale, as many hold an extreme value
EXTREMES = np.array(
    [0, -0.0, 1e-45, -1e-40, 1e-38, 1, -1, 1e6, -1e6, 3.4e38, -3.4e38, np.inf, -np.inf, np.nan], np.float32
)

Progress = Callable[[int, int], None]  # observations done, of how many


@dataclass(frozen=True)
class Cost:
    """A function over its inputs."""

    routes: tuple[RouteCost, ...]  # distinct ones, in the order met
    stack_bytes: int  # at the deepest, of the first STACK_ROUTES routes
    pricer: str  # which model priced cycles; "" for none
    no_cycles_reason: str | None  # why there are none

    @property
    def instructions(self) -> tuple[int, int]:
        """Fewest and most."""
        counts = [route.instructions for route in self.routes]
        return min(counts), max(counts)

    @property
    def cycles(self) -> tuple[float, float] | None:
        """Fewest and most, predicted; None without a model."""
        counts = [route.cycles for route in self.routes if route.cycles is not None]
        return (min(counts), max(counts)) if counts else None

    @property
    def worst(self) -> RouteCost:
        """The route that takes longest; without cycles, the one of most instructions."""
        return max(self.routes, key=lambda route: (route.cycles or 0, route.instructions))


@dataclass(frozen=True)
class Timing:
    """All that is known of a policy's step on the board."""

    network: str
    control_rate_hz: int
    observations: int  # tried
    multiply_accumulates: int  # of its matrices: at one a cycle, the arithmetic limit
    cost: Cost
    code_bytes: int  # .text: instructions and the literals between them
    weight_bytes: int
    constant_bytes: int  # beside the weights: self-test vectors, blocks of the observation
    state_bytes: int  # sizeof(struct policy)
    compiler: str

    def microseconds(self, cycles: float) -> float:
        """Time of `cycles` at the board's clock [us]."""
        return 1e6 * cycles / CORE_HZ

    def share(self, cycles: float) -> float:
        """Return the share of a control period that `cycles` take, 0..1."""
        return cycles * self.control_rate_hz / CORE_HZ

    def limit_ratio(self, cycles: float) -> float:
        """Return `cycles` relative to the arithmetic limit, one multiply-accumulate a cycle."""
        return cycles / max(self.multiply_accumulates, 1)


def time_policy(
    compiled: CompiledPolicy,
    directory: Path,
    observations: Float32,
    *,
    optimization: str = "-O2",
    progress: Progress | None = None,
) -> Timing:
    """Build the policy alone in `directory` and run it on `observations` (N, inputs).

    Raises BuildError when a tool of the ARM compiler is missing, FaultError when the policy fails.
    """
    file = build_policy_elf(compiled.emission, directory, optimization=optimization)
    program = load_program(file)
    network = compiled.network
    policy = ArmPolicy(program, network.inputs, network.outputs)
    weights = program.symbol("policy_weights").size
    return Timing(
        network=compiled.policy.network.text,
        control_rate_hz=compiled.policy.control_rate_hz,
        observations=len(observations),
        multiply_accumulates=network.multiply_adds,
        cost=step_cost(policy, observations, progress=progress),
        code_bytes=program.sections[".text"],
        weight_bytes=weights,
        constant_bytes=program.sections[".rodata"] - weights,
        state_bytes=state_bytes(file),
        compiler=f"{compiler_version()} {optimization}",
    )


def step_cost(policy: ArmPolicy, observations: Float32, *, progress: Progress | None = None) -> Cost:
    """Measure the cost of policy_step over `observations` (N, inputs), one after the other."""
    return call_cost(policy.machine, policy.step, policy.observation, observations, progress=progress)


def call_cost(
    machine: CortexM7,
    call: tuple[str, *tuple[int, ...]],
    place: int,
    values: Float32,
    *,
    progress: Progress | None = None,
) -> Cost:
    """Measure `call`, a function and its arguments, with each row of `values` in turn at address `place`.

    If llvm-mca is missing or lacks an instruction, cycles are left out and the reason is given.
    """
    seen: dict[Route, int] = {}
    with machine.recording() as runs:
        for number, row in enumerate(values):
            runs.clear()
            machine.write(place, row.tobytes())
            machine.call(*call)
            seen.setdefault(route_of(runs), number)
            if progress:
                progress(number + 1, len(values))
    stack = 0
    for number in list(seen.values())[:STACK_ROUTES]:
        machine.write(place, values[number].tobytes())
        stack = max(stack, machine.stack_bytes(*call))
    code = disassemble(machine.program.path, lines=True)
    priced = price_routes(list(seen), code)
    return Cost(priced.costs, stack, priced.pricer, priced.no_cycles_reason)


def mixed_observations(count: int, inputs: int, seed: int = 0) -> Float32:
    """Draw observations (count, inputs), in turn of unit scale, of any scale from 1e-6 to 1e6, and with
    extremes.

    Every third holds extreme values among those of unit scale: zero, denormal, huge, infinite and NaN.
    """
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(count, inputs))
    values[1::ONE_OF] *= 10 ** rng.uniform(-6, 6, (len(values[1::ONE_OF]), 1))
    extreme = values[2::ONE_OF]
    values[2::ONE_OF] = np.where(
        rng.random(extreme.shape) < 0.5, rng.choice(EXTREMES, extreme.shape), extreme
    )
    return values.astype(np.float32)
