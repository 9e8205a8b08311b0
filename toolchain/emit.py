"""Writes a plan as C: policy.h and policy.c, which compile alone and give the bits of `toolchain.evaluate`.

This stage knows C and nothing of ONNX; the text itself is in templates/policy.h.j2 and policy.c.j2.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from toolchain import tanh
from toolchain.float32 import Float32
from toolchain.network import PolicyModel
from toolchain.operations import Activation, Clip, Relu, Tanh
from toolchain.plan import Plan, Step
from toolchain.templating import render

FLOATS_PER_LINE = 6
FUNCTIONS = ("policy_tanh", "policy_at_least", "policy_at_most", "policy_bound")


@dataclass(frozen=True)
class Emission:
    """The two generated files."""

    source: str
    header: str


@dataclass(frozen=True)
class Kernel:
    """One C function that computes a block of `width` outputs of a linear layer."""

    name: str
    width: int
    results: tuple[str, ...]  # the C expression of each output, of its sum s0, s1, ...
    limits: tuple[int, ...]  # which of the limits the expressions name


@dataclass(frozen=True)
class Call:
    """The C of one step: what it reads, where it writes, and how."""

    step: Step
    source: str
    target: str
    kernels: tuple[Kernel, ...]  # one for each of the step's groups of blocks
    strides: tuple[int, ...]  # of a block of each group in the table
    starts: tuple[int, ...]  # of each group in the table
    result: str  # affine and copy steps: the C expression of output i


def emit(policy: PolicyModel, plan: Plan, observation: Float32, action: Float32) -> Emission:
    """The C of `plan` with the self-test vectors `observation` (T, inputs) and `action` (T, outputs)."""
    limits = _limits(plan.steps)
    calls = tuple(_calls(plan.steps, limits))
    kernels = _distinct(kernel for call in calls for kernel in call.kernels)
    results = [*(call.result for call in calls), *(text for kernel in kernels for text in kernel.results)]
    values = {
        "policy": policy,
        "plan": plan,
        "selftest_count": len(observation),
        "calls": calls,
        "kernels": kernels,
        "limits": [literal(limit) for limit in limits],
        "own_limits": sorted({i for c in calls if c.step.kind != "linear" for i in _used(c.step, limits)}),
        "functions": {name for name in FUNCTIONS if any(name in text for text in results)},
        "scratch": {
            name: max((c.step.outputs for c in calls if c.target == name), default=0) for name in ("a", "b")
        },
        "tanh": {name: literal(getattr(tanh, name)) for name in ("N1", "N2", "D1", "D2", "D3")},
        "weights": list(_lines(plan.table)),
        "selftest_observation": [list(_lines(row)) for row in observation],
        "selftest_action": [list(_lines(row)) for row in action],
    }
    return Emission(render("policy.c.j2", **values), render("policy.h.j2", **values))


def literal(value: float | np.float32) -> str:
    """A float32 as C writes it exactly, in hexadecimal."""
    mantissa, _, exponent = float(np.float32(value)).hex().partition("p")
    mantissa = mantissa.rstrip("0").removesuffix(".") if "." in mantissa else mantissa
    return f"{mantissa}p{exponent}f"


def _limits(steps: Sequence[Step]) -> tuple[float, ...]:
    """Every value that an activation compares with, once each, in order of first use."""
    return tuple(dict.fromkeys(v for step in steps for a in step.activations for v in _compared(a)))


def _compared(activation: Activation) -> tuple[float, ...]:
    match activation:
        case Tanh():
            return (tanh.LIMIT,)
        case Relu():
            return (0.0,)
        case Clip(low, high):
            return tuple(bound for bound in (low, high) if bound is not None)
    raise TypeError(f"{activation} is not emitted")


def _used(step: Step, limits: Sequence[float]) -> tuple[int, ...]:
    return tuple(sorted({limits.index(value) for a in step.activations for value in _compared(a)}))


def _calls(steps: Sequence[Step], limits: Sequence[float]) -> Iterator[Call]:
    source, names = "observation", _Names()
    for index, step in enumerate(steps):
        last = index == len(steps) - 1
        target = "action" if last else ("a", "b")[index % 2]
        kernels, starts, strides, start = [], [], [], step.offset
        for group in step.blocks:
            stride = (step.inputs + 1) * group.width
            stride += stride % 2
            results = tuple(_expression(step.activations, limits, f"s{i}", last) for i in range(group.width))
            name = names.of(group.width, step.activations, last)
            kernels.append(Kernel(name, group.width, results, _used(step, limits)))
            starts.append(start)
            strides.append(stride)
            start += stride * group.count
        value = f"{source}[i]"
        if step.kind == "affine":
            value = f"__builtin_fmaf({value}, w[{step.offset} + i], w[{step.offset + step.inputs} + i])"
        result = _expression(step.activations, limits, value, last)
        yield Call(step, source, target, tuple(kernels), tuple(strides), tuple(starts), result)
        source = target


def _expression(activations: Sequence[Activation], limits: Sequence[float], value: str, last: bool) -> str:
    """C that applies `activations` to `value`; the last one of the network is the door that stops NaN."""
    for index, activation in enumerate(activations):
        names = [f"limit{limits.index(limit)}" for limit in _compared(activation)]
        match activation:
            case Tanh():
                value = f"policy_tanh({value}, {names[0]})"
            case Relu():
                value = f"policy_at_least({value}, {names[0]})"
            case Clip() if last and index == len(activations) - 1:
                value = f"policy_bound({value}, {names[0]}, {names[1]})"
            case Clip(low, high):
                value = value if low is None else f"policy_at_least({value}, {names[0]})"
                value = value if high is None else f"policy_at_most({value}, {names[-1]})"
    return value


class _Names:
    """Names of kernels: one for each width and chain of activations."""

    def __init__(self) -> None:
        self._taken: dict[str, tuple[object, ...]] = {}

    def of(self, width: int, activations: Sequence[Activation], last: bool) -> str:
        chain = "".join(f"_{type(activation).__name__.lower()}" for activation in activations)
        key = (width, tuple(activations), last)
        base = name = f"linear_{width}{chain}"
        number = 2
        while self._taken.setdefault(name, key) != key:
            name, number = f"{base}_{number}", number + 1
        return name


def _distinct(kernels: Iterable[Kernel]) -> list[Kernel]:
    return list({kernel.name: kernel for kernel in kernels}.values())


def _lines(values: Float32) -> Iterator[str]:
    for start in range(0, values.size, FLOATS_PER_LINE):
        yield ", ".join(literal(value) for value in values[start : start + FLOATS_PER_LINE])
