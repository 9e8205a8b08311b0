"""Runs one policy on every machine and checks that they agree and keep the output's bounds.

Laws, each with the machines that must keep it:
- error: on finite observations torch, onnxruntime and our machines lie within what is allowed of the float64
  reference, and ours within as much of onnxruntime (toolchain.verification.tolerance);
- bounds: whatever comes in, our actions are within the bounds of the policy's last Clip, or NaN where a sum
  leaves float32's range;
- door (the NaN gate): an observation that holds a NaN or an infinity gives NaN on every motor;
- state: recurrent state stays finite;
- bits: this machine's C and the Cortex-M7 give the evaluator's actions bit for bit;
- selftest: the vectors in policy.c are repeated exactly, by the evaluator too;
- sanitizer: no access outside an object, no undefined behaviour;
- runs: the program compiles, loads and comes back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.codegen.compiler import CompiledPolicy
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.interpreter import replay
from neuroflight.toolchain.ir.network import Network
from neuroflight.toolchain.ir.operations import Clip
from neuroflight.toolchain.verification.inputs import Inputs
from neuroflight.toolchain.verification.machines import (
    Machine,
    MachineError,
    NotRunError,
    open_arm,
    open_evaluator,
    open_host,
    open_onnxruntime,
    open_torch,
)
from neuroflight.toolchain.verification.tolerance import GroupFigures, Standard, distance, figures, standard

Progress = Callable[[str, int, int], None]  # machine, groups done, groups in all


@dataclass(frozen=True)
class Finding:
    """A law that a machine breaks, and the first input that shows it."""

    machine: str
    law: str
    message: str
    inputs: str | None = None  # the group
    index: int | None = None  # of the sequence, or of the self-test vector
    step: int | None = None  # within the sequence
    motor: int | None = None
    observation: tuple[str, ...] = ()  # as float32 bits in hexadecimal
    got: str | None = None
    expected: str | None = None


@dataclass(frozen=True)
class MachineReport:
    """The result of one machine."""

    name: str
    required: bool  # without it the verdict is incomplete
    figures: tuple[GroupFigures, ...] = ()
    finding: Finding | None = None
    not_run: str | None = None  # the reason

    @property
    def count(self) -> int:
        """Observations that it was given."""
        return sum(group.count for group in self.figures)

    @property
    def verdict(self) -> str:
        """holds, fails or not run."""
        return "not run" if self.not_run else "fails" if self.finding else "holds"


@dataclass(frozen=True)
class Verification:
    """All that was seen of one policy."""

    machines: tuple[MachineReport, ...]
    recovery: float | None  # recurrent: largest distance to the undisturbed path 100 steps after faults

    @property
    def finding(self) -> Finding | None:
        """The first law that is broken."""
        return next((machine.finding for machine in self.machines if machine.finding), None)

    @property
    def missing(self) -> tuple[MachineReport, ...]:
        """The machines that should have run and did not."""
        return tuple(machine for machine in self.machines if machine.required and machine.not_run)

    @property
    def verdict(self) -> str:
        """holds, fails or incomplete."""
        return "fails" if self.finding else "incomplete" if self.missing else "holds"


@dataclass(frozen=True)
class Candidate:
    """A machine that can be opened."""

    name: str
    required: bool
    open: Callable[[], Machine]


@dataclass
class _Bench:
    """The state of a verification while machines run one after the other: actions by group."""

    last: Clip
    network: Network
    onnxruntime: dict[str, Float32] = field(default_factory=dict)
    evaluator: dict[str, Float32] = field(default_factory=dict)


def verify(
    compiled: CompiledPolicy,
    candidates: Sequence[Candidate],
    inputs: Sequence[Inputs],
    *,
    seed: int = 0,
    progress: Progress = lambda _machine, _done, _total: None,
) -> Verification:
    """Run all `candidates` on `inputs`, one after the other; a policy at fault raises nothing.

    seed: of the disturbances that say what is allowed.
    """
    rng = np.random.default_rng(seed)
    standards = [standard(compiled.policy.network, group, rng) for group in inputs]
    last = compiled.network.nodes[-1].operation
    assert isinstance(last, Clip)
    bench = _Bench(last, compiled.network)
    reports = [
        _examine(candidate, standards, bench, partial(progress, candidate.name)) for candidate in candidates
    ]
    return Verification(tuple(reports), _recovery(bench) if compiled.network.recurrent else None)


def all_candidates(
    compiled: CompiledPolicy, data: bytes, directory: Path, checkpoint: Path | None
) -> tuple[Candidate, ...]:
    """Return every machine for the policy whose file is `data`; programs are built in `directory`.

    Later ones are compared with onnxruntime and the evaluator, so these come first.
    """
    policy = compiled.policy

    def torch() -> Machine:
        if checkpoint is None:
            raise NotRunError("no checkpoint; name one with --checkpoint")
        return open_torch(checkpoint, policy.observation_count, policy.action_count)

    def host(compiler: str, sanitize: bool) -> Callable[[], Machine]:
        folder = directory / (compiler + "-sanitized" * sanitize)
        return lambda: open_host(compiled, folder, compiler, sanitize=sanitize)

    return (
        Candidate("onnxruntime", True, lambda: open_onnxruntime(data)),
        Candidate("torch", False, torch),
        Candidate("evaluator", True, lambda: open_evaluator(compiled.network)),
        Candidate("host C, gcc", True, host("gcc", False)),
        Candidate("host C, sanitized", True, host("gcc", True)),
        Candidate("host C, clang", False, host("clang", False)),
        Candidate("Cortex-M7, emulated", True, lambda: open_arm(compiled, directory / "arm")),
    )


def _examine(
    candidate: Candidate, standards: Sequence[Standard], bench: _Bench, progress: Callable[[int, int], None]
) -> MachineReport:
    name, required = candidate.name, candidate.required
    measured: list[GroupFigures] = []
    finding: Finding | None = None
    progress(0, len(standards))
    try:
        machine = candidate.open()
        for done, expected in enumerate(standards):
            actions = machine.actions(expected.inputs.observation)
            group = expected.inputs.name
            if name in ("onnxruntime", "evaluator"):
                getattr(bench, name)[group] = actions
            finding = finding or next(_broken(name, machine, actions, expected, bench), None)
            measured.append(figures(actions, expected, bench.onnxruntime.get(group)))
            progress(done + 1, len(standards))
        finding = finding or _selftest(name, machine, bench.network)
    except NotRunError as error:
        return MachineReport(name, required, not_run=str(error))
    except MachineError as error:
        finding = finding or Finding(name, error.law, f"{name}: {error}")
    return MachineReport(name, required, tuple(measured), finding)


def _broken(
    name: str, machine: Machine, actions: Float32, expected: Standard, bench: _Bench
) -> Iterator[Finding]:
    """Yield the laws that the machine's actions break, the first input for each."""
    group, observation = expected.inputs.name, expected.inputs.observation
    found = partial(_found, name, actions, expected)
    if machine.is_ours:
        low, high = np.float32(bench.last.low), np.float32(bench.last.high)
        with np.errstate(invalid="ignore"):
            outside = (actions < low) | (actions > high)
        yield from found("bounds", outside, None, f"leaves the bounds {low:g} to {high:g}")
        leaks = ~np.isfinite(observation).all(axis=2, keepdims=True) & ~np.isnan(actions)
        yield from found("door", leaks, None, "answers NaN or infinity with a number")
        if name != "evaluator" and group in bench.evaluator:
            same = bench.evaluator[group]
            differ = (actions.view(np.uint32) != same.view(np.uint32)) & ~(np.isnan(actions) & np.isnan(same))
            yield from found("bits", differ, same, "has not the evaluator's bits")
    peers: list[tuple[str, NDArray[np.floating]]] = [("the float64 reference", expected.reference)]
    if machine.is_ours and group in bench.onnxruntime:
        peers.append(("onnxruntime", bench.onnxruntime[group]))
    for peer_name, peer in peers:
        far = expected.comparable[..., None] & (distance(actions, peer) > expected.allowed[..., None])
        yield from found("error", far, peer, f"is further from {peer_name} than allowed")


def _found(
    name: str,
    actions: Float32,
    expected: Standard,
    law: str,
    wrong: NDArray[np.bool_],
    peer: NDArray[np.floating] | None,
    said: str,
) -> Iterator[Finding]:
    """Yield the first of the actions that are `wrong` (S, T, outputs), if any; `peer`: expected ones."""
    if not wrong.any():
        return
    sequence, step, motor = np.argwhere(wrong)[0].tolist()
    group, observation = expected.inputs.name, expected.inputs.observation
    got = _text(actions[sequence, step, motor])
    wanted = None if peer is None else _text(peer[sequence, step, motor])
    message = f"{name} {said}: {group} {sequence}"
    message += f", step {step}" if observation.shape[1] > 1 else ""
    message += f", motor {motor + 1}: got {got}"
    message += f", expected {wanted}" if wanted else ""
    message += f" within {expected.allowed[sequence, step]:.2g}" if law == "error" else ""
    if name == "torch":
        message += "; is the checkpoint the one it was frozen from? Leave torch out with --no-torch"
    row = _words(observation[sequence, step])
    yield Finding(name, law, message, group, sequence, step, motor, row, got, wanted)


def _selftest(machine_name: str, machine: Machine, network: Network) -> Finding | None:
    if machine.selftest is None:
        return None
    test = machine.selftest()
    for name, actions in ((machine_name, test.given), ("evaluator", replay(network, test.observation))):
        wrong = actions.view(np.uint32) != test.promised.view(np.uint32)
        if wrong.any():
            vector, motor = np.argwhere(wrong)[0].tolist()
            got, promised = _text(actions[vector, motor]), _text(test.promised[vector, motor])
            message = f"{name} does not repeat self-test vector {vector} of policy.c: motor {motor + 1}: "
            message += f"got {got}, expected {promised}"
            row = _words(test.observation[vector])
            return Finding(name, "selftest", message, None, vector, None, motor, row, got, promised)
    return None


def _recovery(bench: _Bench) -> float | None:
    """Return how far paths with faults end from the same paths without."""
    calm, faulty = (bench.evaluator.get(name) for name in ("paths", "paths with faults"))
    if calm is None or faulty is None:
        return None
    return float(distance(calm[:, -1], faulty[:, -1]).max())


def _words(observation: Float32) -> tuple[str, ...]:
    return tuple(f"0x{word:08X}" for word in observation.view(np.uint32))


def _text(value: np.floating) -> str:
    """Format nine digits, which identify every float32, and for a float32 its bits."""
    bits = f" (0x{value.view(np.uint32):08X})" if isinstance(value, np.float32) else ""
    return f"{value:.9g}{bits}"
