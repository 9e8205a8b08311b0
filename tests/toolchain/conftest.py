"""Policies made for a test, and the two machines that run their C: this one and an emulated Cortex-M7."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
import pytest
from numpy.typing import ArrayLike, NDArray
from onnx import TensorProto, helper, numpy_helper

from neuroflight.toolchain.codegen.compiler import CompiledPolicy, compile_policy
from neuroflight.toolchain.codegen.emit import ARITHMETIC
from neuroflight.toolchain.cortex_m7.arm_policy import COMPILER, CORE, ArmPolicy, build_policy_elf
from neuroflight.toolchain.cortex_m7.emulator import load_program
from neuroflight.toolchain.policy.model import parse_policy

Float32 = NDArray[np.float32]

WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-pedantic", "-Werror")
HOST = ("gcc", "-O2", "-mfma", *ARITHMETIC, *WARNINGS)
ARM = (COMPILER, "-O2", *CORE, *ARITHMETIC, *WARNINGS)

METADATA = {
    "neuroflight.version": "1",
    "neuroflight.observation": "rate_error,rate_error_delta",
    "neuroflight.control_rate_hz": "1000",
    "neuroflight.filters": "[]",
    "neuroflight.aircraft": "nf1",
    "neuroflight.aircraft_sha256": "0" * 64,
    "neuroflight.training": "{}",
}


@dataclass
class Chain:
    """An ONNX model under construction: a chain of nodes from `observation` to `action`."""

    inputs: int = 6
    outputs: int = 4
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    tensors: list[onnx.TensorProto] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=lambda: dict(METADATA))
    opset: int = 17

    def add(
        self,
        operator: str,
        *operands: ArrayLike | None,
        first: bool = True,
        name: str = "",
        **attributes: float,
    ) -> Chain:
        """Append a node that takes the chain's value and constant `operands` (None leaves one out)."""
        index = len(self.nodes)
        names = []
        for place, operand in enumerate(operands):
            names.append("" if operand is None else f"constant{index}_{place}")
            if operand is not None:
                self.tensors.append(numpy_helper.from_array(np.asarray(operand), names[-1]))
        value = self.nodes[-1].output[0] if self.nodes else "observation"
        takes = [value, *names] if first else [*names, value]
        node = helper.make_node(operator, takes, [f"value{index}"], name=name or f"{operator}_{index}")
        node.attribute.extend(helper.make_attribute(key, value) for key, value in attributes.items())
        self.nodes.append(node)
        return self

    def clip(self) -> Chain:
        """Append the last Clip, which every policy ends with."""
        return self.add("Clip", np.float32(0), np.float32(1))

    def model(self) -> onnx.ModelProto:
        """The model; its last value is called `action`."""
        if self.nodes:
            self.nodes[-1].output[0] = "action"
        ends = [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, n])
            for name, n in (("observation", self.inputs), ("action", self.outputs))
        ]
        graph = helper.make_graph(self.nodes, "policy", ends[:1], ends[1:], self.tensors)
        opset = helper.make_opsetid("", self.opset)
        model = helper.make_model(graph, opset_imports=[opset], ir_version=8)
        helper.set_model_props(model, self.metadata)
        return model

    def data(self) -> bytes:
        """The bytes of the file."""
        return bytes(self.model().SerializeToString())


def graph(body: str, constants: Mapping[str, ArrayLike], opset: int = 17) -> bytes:
    """A policy of six inputs and four motors whose nodes are written in ONNX's text format.

    constants: those that `body` names become initializers.
    """
    ends = "(float[1,6] observation) => (float[1,4] action)"
    built = onnx.parser.parse_graph(f"policy {ends} {{ {body} }}")
    names = sorted({name for node in built.node for name in node.input} & set(constants))
    built.initializer.extend(numpy_helper.from_array(np.asarray(constants[name]), name) for name in names)
    model = helper.make_model(built, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    helper.set_model_props(model, METADATA)
    return bytes(model.SerializeToString())


def weights(rng: np.random.Generator, *shape: int) -> Float32:
    """Random weights of a size that keeps sums near 1."""
    return np.asarray(rng.normal(size=shape) / np.sqrt(shape[-1]), np.float32)


def mlp(widths: Sequence[int] = (6, 64, 64, 4), activation: str = "Tanh", seed: int = 0) -> Chain:
    """A perceptron whose outputs mostly lie inside the clip."""
    rng = np.random.default_rng(seed)
    chain = Chain(widths[0], widths[-1])
    for index, (inputs, outputs) in enumerate(pairwise(widths)):
        last = index == len(widths) - 2
        scale, offset = (0.3, 0.4) if last else (1.0, 0.0)
        bias = (0.1 * weights(rng, outputs) + offset).astype(np.float32)
        chain.add("Gemm", (scale * weights(rng, outputs, inputs)).astype(np.float32), bias, transB=1)
        if not last:
            chain.add(activation)
    return chain.clip()


def observations(count: int, inputs: int, seed: int = 0) -> Float32:
    """Observations (count, inputs): half of unit scale, half of any bits, NaN and infinity included."""
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 1 << 32, (count // 2, inputs), dtype=np.uint32).view(np.float32)
    special = np.array([0, -0.0, np.nan, np.inf, -np.inf, 1e-45, -1e-40, 3.4e38, -3.4e38, 1e-38], np.float32)
    mixed = np.where(rng.random(bits.shape) < 0.3, rng.choice(special, bits.shape), bits)
    lone = rng.normal(size=bits.shape).astype(np.float32)  # one odd value among sane ones
    lone[np.arange(len(lone)), rng.integers(0, inputs, len(lone))] = mixed[:, 0]
    unit = rng.normal(size=(count - len(bits), inputs)).astype(np.float32)
    return np.concatenate([unit, np.where(rng.random((len(bits), 1)) < 0.5, mixed, lone)])


def compiled(source: Chain | bytes) -> CompiledPolicy:
    """A chain, or the bytes of an ONNX file, through the whole compiler."""
    return compile_policy(parse_policy(source if isinstance(source, bytes) else source.data()))


def write(policy: CompiledPolicy, directory: Path) -> Path:
    """policy.c and policy.h in `directory`, nothing else. Returns policy.c."""
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "policy.h").write_text(policy.emission.header)
    source = directory / "policy.c"
    source.write_text(policy.emission.source)
    return source


class HostPolicy:
    """policy.c compiled for this machine and called through ctypes."""

    def __init__(self, policy: CompiledPolicy, directory: Path) -> None:
        """Compile into `directory`."""
        library = directory / "policy.so"
        subprocess.run([*HOST, "-shared", "-fPIC", write(policy, directory), "-o", library], check=True)
        self._library = ctypes.CDLL(str(library))
        self._state = (ctypes.c_uint64 * (2 + policy.plan.state + policy.plan.scratch))()
        self._outputs = policy.policy.action_count
        self.init(None)

    def init(self, table: ctypes.c_void_p | None) -> None:
        """policy_init with another table of weights, None for the compiled-in one."""
        self._library.policy_init(self._state, table)

    def actions(self, observation: Float32) -> Float32:
        """Actions (N, outputs) of observations (N, inputs), one call of policy_step each."""
        observation = np.ascontiguousarray(observation)
        action = np.full((len(observation), self._outputs), np.nan, np.float32)
        step, state = self._library.policy_step, ctypes.byref(self._state)
        for row, out in zip(observation, action, strict=True):
            step(state, ctypes.c_void_p(row.ctypes.data), ctypes.c_void_p(out.ctypes.data))
        return action


def arm(policy: CompiledPolicy, directory: Path, *options: str) -> ArmPolicy:
    """policy.c linked alone for the Cortex-M7 and executed instruction by instruction."""
    directory.mkdir(parents=True, exist_ok=True)
    program = build_policy_elf(policy.emission, directory, *WARNINGS, *options)
    return ArmPolicy(load_program(program), policy.policy.observation_count, policy.policy.action_count)


@dataclass(frozen=True)
class Kit:
    """What a test of the compiler works with."""

    chain: Callable[..., Chain] = Chain
    mlp: Callable[..., Chain] = mlp
    graph: Callable[..., bytes] = graph
    weights: Callable[..., Float32] = weights
    observations: Callable[..., Float32] = observations
    compiled: Callable[[Chain | bytes], CompiledPolicy] = compiled
    write: Callable[[CompiledPolicy, Path], Path] = write
    host: Callable[[CompiledPolicy, Path], HostPolicy] = HostPolicy
    arm: Callable[..., ArmPolicy] = arm
    host_compiler: tuple[str, ...] = HOST
    arm_compiler: tuple[str, ...] = ARM


@pytest.fixture(scope="session")
def kit() -> Kit:
    """The functions and classes above; pytest's importlib mode offers no other way to reach them."""
    return Kit()
