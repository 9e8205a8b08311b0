"""Random models in the many forms that exporters give them, against onnxruntime on the model itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.policy.import_onnx import PolicyClaims, imported_model
from neuroflight.toolchain.policy.model import parse_policy

TERMS = ("rate", "rate_error", "rate_error_delta", "gravity", "rate@1", "rate@2")  # of three values each
MOTORS = 4
OPSETS = range(7, 26)  # onnxruntime takes none older; 25 is the newest that it calls stable
IR_VERSION = 8  # which onnxruntime takes beside each of these opsets
TOLERANCE = 1e-6
TYPES: dict[type, int] = {
    np.float32: TensorProto.FLOAT,
    np.float64: TensorProto.DOUBLE,
    np.int64: TensorProto.INT64,
}


def claims(terms: Sequence[str]) -> PolicyClaims:
    return PolicyClaims(",".join(terms), 1000, "[]", "nf1", "ab" * 32, MOTORS)


@dataclass
class Foreign:
    """A model under construction, and how an observation is fed to it."""

    rng: np.random.Generator
    opset: int
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    tensors: list[onnx.TensorProto] = field(default_factory=list)
    inputs: list[onnx.ValueInfoProto] = field(default_factory=list)
    outputs: list[onnx.ValueInfoProto] = field(default_factory=list)
    feed: dict[str, Callable[[NDArray[np.float32]], NDArray[Any]]] = field(default_factory=dict)
    count: int = 0

    def constant(self, values: Any) -> str:
        self.count += 1
        self.tensors.append(numpy_helper.from_array(np.asarray(values), f"c{self.count}"))
        return f"c{self.count}"

    def add(self, operator: str, *inputs: str, domain: str = "", **attributes: Any) -> str:
        self.count += 1
        node = helper.make_node(operator, list(inputs), [f"v{self.count}"], domain=domain, **attributes)
        self.nodes.append(node)
        return f"v{self.count}"

    def along(self, operator: str, value: str, axes: list[int]) -> str:
        """Add an operator whose axes are an attribute before opset 13 and an input since."""
        if self.opset < 13:
            return self.add(operator, value, axes=axes)
        return self.add(operator, value, self.constant(np.array(axes, np.int64)))

    def clip(self, value: str, low: float, high: float) -> str:
        if self.opset < 11:
            return self.add("Clip", value, min=low, max=high)
        return self.add("Clip", value, self.constant(np.float32(low)), self.constant(np.float32(high)))

    def cast(self, value: str, kind: int) -> str:
        return self.add("Cast", value, to=kind)

    def weights(self, *shape: int) -> NDArray[np.float32]:
        return np.asarray(self.rng.normal(size=shape) / np.sqrt(shape[-1]), np.float32)

    def observed(self, name: str, start: int, width: int) -> str:
        """Add an input of random rank, batch and type; return it as [1, width] in float32."""
        kind = (np.float32, np.float32, np.float64)[self.rng.integers(3)]
        shapes: list[list[int | str]] = [
            [width],
            [1, width],
            [int(self.rng.integers(2, 9)), width],
            ["batch", width],
            ["batch", "n"],
            [1, 1, width],
            ["batch", "time", width],
        ]
        shape = shapes[self.rng.integers(5 if start < 0 else 7)]
        if shape == ["batch", "n"] and start >= 0:
            shape = ["batch", width]
        start = max(start, 0)
        open_axes = {"batch": 1, "time": 1, "n": width}
        sizes = [open_axes[size] if isinstance(size, str) else size for size in shape]
        self.inputs.append(helper.make_tensor_value_info(name, TYPES[kind], shape))
        self.feed[name] = lambda row: np.ascontiguousarray(
            np.broadcast_to(row[start : start + width], sizes).astype(kind)
        )
        value = name
        if kind is np.float64:
            if self.rng.random() < 0.5:  # a normalizer in float64
                mean, spread = self.rng.normal(size=width), 0.5 + self.rng.random(width)
                value = self.add("Sub", value, self.constant(mean))
                value = self.add("Div", value, self.constant(spread))
            value = self.cast(value, TensorProto.FLOAT)
        if len(shape) == 1:
            return self.along("Unsqueeze", value, [0])
        return self.along("Squeeze", value, [1]) if len(shape) == 3 else value

    def hidden(self, value: str, width: int) -> tuple[str, int]:
        """Add a layer of a random kind."""
        kind = self.rng.integers(9)
        if kind < 3:
            outputs = int(self.rng.integers(3, 12))
            if kind == 0:
                value = self.add(
                    "Gemm",
                    value,
                    self.constant(self.weights(outputs, width)),
                    self.constant(self.weights(outputs)),
                    transB=1,
                )
            else:
                value = self.add("MatMul", value, self.constant(self.weights(width, outputs)))
                value = self.add("Add", value, self.constant(self.weights(outputs)))
            return value, outputs
        match kind:
            case 3:
                names = ["Tanh", "Relu", "Elu", "Sigmoid", "Softsign", "LeakyRelu"]
                return self.add(str(self.rng.choice(names)), value), width
            case 4:
                return self.clip(value, -1.5, 1.5), width
            case 5:
                arrays = [
                    0.5 + self.rng.random(width),
                    self.rng.normal(size=width),
                    self.rng.normal(size=width),
                ]
                names = [self.constant(a.astype(np.float32)) for a in (*arrays, 0.5 + self.rng.random(width))]
                return self.add("BatchNormalization", value, *names), width
            case 6:
                return self.add("Dropout", value), width
            case 7:
                return self.add("Mul", value, self.add("Sigmoid", value)), width
        first = int(self.rng.integers(1, width)) if width > 1 else 1
        if self.opset < 10:
            part = self.add("Slice", value, starts=[0], ends=[first], axes=[1])
        else:
            part = self.add("Slice", value, *(self.constant(np.array([n], np.int64)) for n in (0, first, 1)))
        return self.add("Concat", value, part, axis=1), width + first

    def shaped(self, value: str) -> str:
        """Add zeros that have the shape of another value, as SAC's exports do."""
        other = self.add("Exp", self.clip(value, -20.0, 2.0))
        shape = self.add("Shape", other)
        if self.opset < 9:
            return self.add("Expand", value, shape) if self.opset >= 8 else value
        zeros = self.add("ConstantOfShape", shape)
        return self.add("Expand", self.add("Add", value, zeros), shape)

    def output(self, value: str, name: str, shape: Sequence[int | str] | None) -> None:
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        self.outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))

    def data(self) -> bytes:
        opsets = [helper.make_opsetid("", self.opset), helper.make_opsetid("somebody.else", 1)]
        graph = helper.make_graph(self.nodes, "g", self.inputs, self.outputs, self.tensors)
        model = helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION)
        return bytes(model.SerializeToString())


def zeros(kind: type) -> Callable[[NDArray[np.float32]], NDArray[Any]]:
    return lambda _: np.zeros(1, kind)


def random_model(seed: int) -> tuple[Foreign, int]:
    """Return a random model and the width of its observation."""
    rng = np.random.default_rng(seed)
    model = Foreign(rng, int(rng.choice(OPSETS)))
    count = int(rng.integers(1, 4))
    widths = [3 * int(rng.integers(1, 3)) for _ in range(count)]
    starts = [-1] if count == 1 else [int(n) for n in np.cumsum([0, *widths[:-1]])]
    rows = []
    for number in range(count):
        if rng.random() < 0.3:  # an input that nothing reads, before, between or after
            kind = (np.float32, np.int64)[rng.integers(2)]
            model.inputs.append(helper.make_tensor_value_info(f"unread{number}", TYPES[kind], ["batch"]))
            model.feed[f"unread{number}"] = zeros(kind)
            if kind is np.float32 and rng.random() < 0.5:  # and that goes out as it came
                model.output(f"unread{number}", f"passed{number}", ["batch"])
        row = model.observed(f"part{number}", starts[number], widths[number])
        if any(
            isinstance(d, int) and d > 1
            for d in model.feed[f"part{number}"](np.zeros(18, np.float32)).shape[:-1]
        ):
            row = model.add("Gather", row, model.constant(np.array([0], np.int64)), axis=0)
        rows.append(row)
    value, width = (model.add("Concat", *rows, axis=1) if count > 1 else rows[0]), sum(widths)
    for _ in range(int(rng.integers(1, 6))):
        value, width = model.hidden(value, width)
    if rng.random() < 0.4:
        value = model.shaped(value)
    if rng.random() < 0.3:  # a critic
        weight = model.constant(model.weights(width, 1))
        model.output(model.add("MatMul", value, weight), "value", None)
    if rng.random() < 0.2:  # nothing takes it
        model.add("Erf" if model.opset >= 9 else "Acos", value)
    weight = model.constant(model.weights(width, MOTORS))
    value = model.add("MatMul", value, weight)
    if rng.random() < 0.5:
        value = model.add("Sigmoid", value)
    if rng.random() < 0.2:
        value = model.add("Flatten", value, axis=0)
    model.output(value, "action", None)
    return model, sum(widths)


def by_onnxruntime(model: Foreign, observation: NDArray[np.float32]) -> NDArray[np.float32]:
    options = onnxruntime.SessionOptions()
    options.log_severity_level, options.intra_op_num_threads = 4, 1
    session = onnxruntime.InferenceSession(model.data(), options, providers=["CPUExecutionProvider"])
    names = [i.name for i in session.get_inputs()]
    rows = [
        session.run(["action"], {name: model.feed[name](row) for name in names})[0].reshape(-1, MOTORS)[0]
        for row in observation
    ]
    return np.clip(np.array(rows, np.float32), 0, 1)


def differences(seeds: range) -> float:
    """Return the largest distance between imported models with these seeds and onnxruntime."""
    worst = 0.0
    for seed in seeds:
        model, width = random_model(seed)
        data, changes = imported_model(model.data(), claims(TERMS[: width // 3]), clip=True)
        observation = np.random.default_rng(seed).normal(size=(5, width)).astype(np.float32)
        found = np.abs(
            evaluate(parse_policy(data).network, observation) - by_onnxruntime(model, observation)
        ).max()
        assert found <= TOLERANCE, f"seed {seed}, opset {model.opset}: {found}; {changes}"
        worst = max(worst, float(found))
        old = model.opset < 13
        assert old == any(f"converted opset {model.opset} to 13" in change for change in changes)
        for name in model.feed:
            if name.startswith("unread") and f"{name}" in {i.name for i in model.inputs if is_float(i)}:
                assert f"dropped the input {name!r}: the action does not depend on it" in changes
    return worst


def is_float(value: onnx.ValueInfoProto) -> bool:
    return value.type.tensor_type.elem_type == TensorProto.FLOAT


def test_random_models_compute_what_onnxruntime_does_when_imported() -> None:
    assert differences(range(40)) <= TOLERANCE


@pytest.mark.slow
def test_a_thousand_random_models_compute_what_onnxruntime_does_when_imported() -> None:
    assert differences(range(1000)) <= TOLERANCE
