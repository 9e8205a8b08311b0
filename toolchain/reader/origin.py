"""Models that a tool changed after the export: quantized, in float16, fused by onnxruntime."""

from __future__ import annotations

import re
from collections.abc import Iterator

import onnx
from onnx import TensorProto

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.reader.values import STANDARD_DOMAINS, label, shown

QUANTIZED = re.compile(
    r".*Quantize.*|QLinear.*|QGemm|QAttention|.*Integer(ToFloat)?|.*NBits|.*BnB4|(Bipolar|Int)?Quant"
)
HALVES: dict[int, str] = {TensorProto.FLOAT16: "float16", TensorProto.BFLOAT16: "bfloat16"}
FLOAT8 = {code for name, code in TensorProto.DataType.items() if name.startswith(("FLOAT8", "FLOAT4"))}
FUSED_DOMAINS = ("com.microsoft", "com.ms.internal")  # operators of onnxruntime alone
FUSED_OPERATORS = ("SimplifiedLayerNormalization", "MemcpyFromHost", "MemcpyToHost")  # in the standard domain
QUANTIZED_MEND = (
    "export it in float32: the model from before quantize_static, quantize_dynamic or "
    "quantization-aware training"
)
HALF_MEND = (
    "export it in float32: model.float() before torch.onnx.export, no convert_float_to_float16 or autocast"
)
FUSED_MEND = (
    "give the model that the exporter wrote, or optimize with GraphOptimizationLevel.ORT_ENABLE_BASIC at most"
)


def check_origin(model: onnx.ModelProto) -> None:
    """Raise PolicyError, one line on how to export it, for a quantized, float16 or fused model."""
    for node in model.graph.node:
        if QUANTIZED.fullmatch(node.op_type):
            raise PolicyError(f"the model is quantized: {label(node)}; {QUANTIZED_MEND}")
    for name, code in _types(model.graph):
        if code in HALVES:
            raise PolicyError(f"the model computes in {HALVES[code]}: {name}; {HALF_MEND}")
        if code in FLOAT8:
            raise PolicyError(f"the model is quantized: {name} is of 8 bits or fewer; {QUANTIZED_MEND}")
    for node in model.graph.node:
        own = node.domain not in STANDARD_DOMAINS and node.domain.startswith(FUSED_DOMAINS)
        if own or node.op_type in FUSED_OPERATORS:
            raise PolicyError(f"the model was optimized by onnxruntime: {label(node)}; {FUSED_MEND}")


def _types(graph: onnx.GraphProto) -> Iterator[tuple[str, int]]:
    """Yield each tensor and value of the model, and the target of each conversion, with its type."""
    for tensor in graph.initializer:
        yield f"initializer {shown(tensor.name)}", tensor.data_type
    for value in (*graph.input, *graph.output):
        yield f"value {shown(value.name)}", value.type.tensor_type.elem_type
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.HasField("t"):
                yield label(node), attribute.t.data_type
            if node.op_type == "Cast" and attribute.name == "to":
                yield label(node), attribute.i
