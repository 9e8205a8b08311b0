"""Models of random operators, as exporters write them, against onnxruntime."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
import onnxruntime
import pytest
from onnx import NodeProto, TensorProto, helper, numpy_helper
from pytest import param

from neuroflight.toolchain.ir.float64_reference import reference
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.policy.model import parse_policy
from neuroflight.toolchain.verification.tolerance import ROUNDING, TOLERANCE

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

OPSET = 23  # the first with RMSNormalization
PLAIN = (
    "Tanh",
    "Sigmoid",
    "Relu",
    "Softsign",
    "Erf",
    "Softplus",
    "Mish",
    "HardSwish",
    "Softmax",
    "Abs",
    "Neg",
)
PARAMETERS = {  # operator: attributes and between which they lie
    "LeakyRelu": {"alpha": (-0.5, 0.5)},
    "Elu": {"alpha": (0.1, 2.0)},
    "Celu": {"alpha": (0.2, 3.0)},
    "Selu": {"alpha": (0.5, 2.0), "gamma": (0.5, 2.0)},
    "HardSigmoid": {"alpha": (0.1, 0.4), "beta": (0.2, 0.8)},
}
OTHERS: tuple[str, ...] = (
    "Gelu",
    "Gelu tanh",
    "GELU in parts",
    "SiLU in parts",
    "PRelu",
    "RMSNormalization",
    "RMS in parts",
)
OTHERS += ("LayerNormalization", "softplus with threshold", "Max", "Where", "residual", "ReduceMean")
KINDS = (*PLAIN, *PARAMETERS, *OTHERS)


class Model:
    """A model under construction; `width` values at a time."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.width = rng, int(rng.integers(3, 12))
        self.nodes, self.tensors, self.value = list[NodeProto](), list[TensorProto](), "observation"
        self.used: Counter[str] = Counter()

    def constant(self, values: object) -> str:
        name = f"c{len(self.tensors)}"
        self.tensors.append(numpy_helper.from_array(np.asarray(values, np.float32), name))
        return name

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        name = f"v{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, inputs, [name], **attributes))
        return name

    def layer(self, outputs: int) -> None:
        weight = self.rng.normal(size=(outputs, self.width)) / np.sqrt(self.width)
        bias = 0.3 * self.rng.normal(size=outputs)
        self.value = self.add("Gemm", self.value, self.constant(weight), self.constant(bias), transB=1)
        self.width = outputs

    def activate(self, kind: str) -> None:
        self.used[kind] += 1
        x, rng = self.value, self.rng
        match kind:
            case "Gelu" | "Gelu tanh":
                self.value = self.add("Gelu", x, approximate="tanh" if "tanh" in kind else "none")
            case "GELU in parts":
                error = self.add("Erf", self.add("Div", x, self.constant(np.sqrt(2))))
                product = self.add("Mul", x, self.add("Add", error, self.constant(1)))
                self.value = self.add("Mul", product, self.constant(0.5))
            case "SiLU in parts":
                self.value = self.add("Mul", x, self.add("Sigmoid", x))
            case "PRelu":
                slopes = rng.uniform(-0.5, 0.8, 1 if rng.random() < 0.5 else self.width)
                self.value = self.add("PRelu", x, self.constant(slopes))
            case "RMSNormalization" | "LayerNormalization":
                self.value = self.add(kind, x, self.constant(rng.normal(size=self.width)), epsilon=1e-5)
            case "RMS in parts":
                axes = f"axes{len(self.tensors)}"
                self.tensors.append(numpy_helper.from_array(np.array([-1]), axes))
                mean = self.add("ReduceMean", self.add("Pow", x, self.constant(2)), axes)
                root = self.add("Sqrt", self.add("Add", mean, self.constant(1e-5)))
                self.value = self.add("Div", x, root)
            case "softplus with threshold":
                above = self.add("Greater", x, self.constant(20))
                self.value = self.add("Where", above, x, self.add("Softplus", x))
            case "Max":
                self.value = self.add("Max", x, self.add("Mul", x, self.constant(-0.3)))
            case "Where":  # continuous: where it bends, both are 0
                below = self.add("LessOrEqual", x, self.constant(0))
                self.value = self.add("Where", below, self.add("Tanh", x), x)
            case "residual":
                self.value = self.add("Add", x, self.add("Tanh", x))
            case "ReduceMean":
                axes = f"axes{len(self.tensors)}"
                self.tensors.append(numpy_helper.from_array(np.array([1]), axes))
                self.value = self.add("Sub", x, self.add("ReduceMean", x, axes))
            case _:
                ends = PARAMETERS.get(kind, {})
                self.value = self.add(kind, x, **{name: float(rng.uniform(*at)) for name, at in ends.items()})

    def finished(self, metadata: dict[str, str]) -> bytes:
        self.layer(4)
        self.nodes.append(helper.make_node("Sigmoid", [self.value], ["action"]))
        ends = [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, width])
            for name, width in (("observation", 6), ("action", 4))
        ]
        graph = helper.make_graph(self.nodes, "random", ends[:1], ends[1:], self.tensors)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=10)
        helper.set_model_props(model, metadata)
        return bytes(model.SerializeToString())


def check(seed: int, metadata: dict[str, str]) -> Counter[str]:
    """Compare a random model with onnxruntime. Returns the model's operators."""
    rng = np.random.default_rng(seed)
    model = Model(rng)
    model.width = 6
    for _ in range(int(rng.integers(1, 5))):
        model.layer(int(rng.integers(3, 12)))
        for _ in range(int(rng.integers(1, 3))):
            model.activate(str(rng.choice(KINDS)))
    data = model.finished(metadata)
    observation = (rng.normal(size=(24, 6)) * rng.choice([0.1, 1.0, 10.0], size=(24, 1))).astype(np.float32)
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    theirs = np.concatenate([session.run(None, {"observation": row[None]})[0] for row in observation])
    network = parse_policy(data).network
    ours = evaluate(network, observation)
    exact = reference(network, observation[:, None])[:, 0]
    allowed = TOLERANCE + ROUNDING * np.abs(theirs - exact).max() + 1e-7 * np.abs(observation).max()
    assert np.abs(ours - exact).max() <= allowed, seed
    assert np.abs(theirs - exact).max() <= 2e-5, seed  # the reference computes what the model says
    return model.used


@pytest.mark.parametrize("seeds", [range(30), param(range(1000, 2000), marks=pytest.mark.slow)], ids=len)
def test_policy_computes_what_onnxruntime_does_when_its_operators_are_random(kit: Kit, seeds: range) -> None:
    metadata = dict(kit.chain().metadata)
    used = sum((check(seed, metadata) for seed in seeds), Counter())
    assert set(used) == set(KINDS)
