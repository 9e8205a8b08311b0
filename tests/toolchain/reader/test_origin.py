"""Models that a tool changed after the export are called what they are; so are other files."""

from __future__ import annotations

import io
import json
import struct
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnxruntime.quantization import (
    CalibrationDataReader,
    QuantFormat,
    quant_pre_process,
    quantize_dynamic,
    quantize_static,
)
from onnxruntime.transformers.float16 import convert_float_to_float16

from neuroflight.cli.main import main
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy.model import parse_policy, read_policy
from tests.sampling import sampled

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

OPTIONS = ("--observation", "rate_error,rate_error_delta", "--rate", "1000", "--aircraft", "nf1", "--clip")


class Samples(CalibrationDataReader):  # type: ignore[misc]
    """Some observations."""

    def __init__(self) -> None:
        self.rows = iter(np.random.default_rng(0).normal(size=(8, 1, 6)).astype(np.float32))

    def get_next(self) -> dict[str, object] | None:
        """Return the next observation; None at the end."""
        row = next(self.rows, None)
        return None if row is None else {"observation": row}


def statically(form: QuantFormat) -> Callable[[Path, Path], None]:
    def make(source: Path, out: Path) -> None:
        ready = source.with_name("ready.onnx")
        quant_pre_process(source, ready)
        quantize_static(ready, out, Samples(), quant_format=form)

    return make


def in_halves(keep: bool) -> Callable[[Path, Path], None]:
    def make(source: Path, out: Path) -> None:
        onnx.save(convert_float_to_float16(onnx.load(source), keep_io_types=keep), out)

    return make


def optimized(form: str) -> Callable[[Path, Path], None]:
    def make(source: Path, out: Path) -> None:
        options = onnxruntime.SessionOptions()
        options.optimized_model_filepath = str(out)
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_EXTENDED
        options.add_session_config_entry("session.save_model_format", form)
        onnxruntime.InferenceSession(source, options, providers=["CPUExecutionProvider"])

    return make


CHANGED: dict[str, tuple[Callable[[Path, Path], None], str]] = {
    "dynamic": (lambda source, out: quantize_dynamic(source, out), "the model is quantized: node "),
    "QDQ": (statically(QuantFormat.QDQ), "the model is quantized: node "),
    "QOperator": (statically(QuantFormat.QOperator), "the model is quantized: node "),
    "float16": (in_halves(keep=False), "the model computes in float16: "),
    "float16 inside": (in_halves(keep=True), "the model computes in float16: "),
    "fused": (optimized("ONNX"), "the model was optimized by onnxruntime: node "),
    "ort": (optimized("ORT"), "a model in onnxruntime's own form (.ort)"),
}


@pytest.mark.parametrize("name", CHANGED)
def test_model_is_called_what_it_is_when_a_tool_changed_it(
    kit: Kit, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    source, changed = tmp_path / "model.onnx", tmp_path / "changed.onnx"
    source.write_bytes(kit.mlp(activation="Relu").data())
    make, words = CHANGED[name]
    make(source, changed)
    capsys.readouterr()
    assert main(["policy", "import", str(changed), *OPTIONS, "--out", str(tmp_path / "policy.onnx")]) == 1
    told = capsys.readouterr().err
    assert words in told
    assert told.count("\n") == 1
    assert "export it in float32" in told or "give the model that the exporter wrote" in told or name == "ort"
    assert not (tmp_path / "policy.onnx").exists()
    with pytest.raises(PolicyError, match=words[:20]):
        read_policy(changed)


def archive(**entries: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as made:
        for name, content in entries.items():
            made.writestr(name.replace("__", "/").replace("_DOT_", "."), content)
    return file.getvalue()


def script() -> bytes:
    file = io.BytesIO()
    torch.jit.save(torch.jit.script(torch.nn.Linear(2, 2)), file)  # type: ignore[no-untyped-call]
    return file.getvalue()


def weights() -> bytes:
    """Return a state dictionary in the form in which other trainers save actors."""
    file = io.BytesIO()
    torch.save({"model_state_dict": torch.nn.Linear(2, 2).state_dict(), "iter": 1}, file)
    return file.getvalue()


def program() -> bytes:
    file = io.BytesIO()
    torch.export.save(torch.export.export(torch.nn.Linear(2, 2), (torch.zeros(1, 2),)), file)
    return file.getvalue()


def tar() -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as made:
        made.addfile(tarfile.TarInfo("model.onnx"))
    return file.getvalue()


def arrays() -> bytes:
    file = io.BytesIO()
    np.savez(file, a=np.zeros(3))
    return file.getvalue()


def safetensors() -> bytes:
    header = json.dumps({"a": {"dtype": "F32", "shape": [1], "data_offsets": [0, 4]}}).encode()
    return struct.pack("<Q", len(header)) + header + bytes(4)


FILES: dict[str, tuple[Callable[[], bytes], str]] = {
    "lfs": (
        lambda: b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n",
        "a Git LFS pointer",
    ),
    "page": (lambda: b"\n<!DOCTYPE html>\n<html lang=en>", "a web page (HTML)"),
    "text": (lambda: "seen: 1 ° of roll\n".encode() * 400, "text, not a model"),
    "json": (lambda: b'{"layers": []}', "JSON text"),
    "gguf": (lambda: b"GGUF\3\0\0\0" + bytes(40), "a GGUF model"),
    "tflite": (lambda: b"\x1c\0\0\0TFL3" + bytes(40), "a TensorFlow Lite model"),
    "h5": (lambda: b"\x89HDF\r\n\x1a\n" + bytes(40), "an HDF5 file"),
    "keras": (
        lambda: archive(config_DOT_json=b"{}", model_DOT_weights_DOT_h5=b"x"),
        "a Keras model (.keras)",
    ),
    "sb3": (lambda: archive(data=b"{}", policy_DOT_pth=b"x"), "a model of Stable-Baselines3"),
    "torchscript": (script, "a TorchScript archive"),
    "state dict": (weights, "if it is of another trainer, export its actor"),
    "pt2": (program, "a program of torch.export (.pt2)"),
    "tar": (tar, "a tar archive; unpack it first"),
    "npz": (arrays, "an archive of numpy arrays (.npz)"),
    "zip": (lambda: archive(readme=b"x"), "a zip archive; unpack it first"),
    "gzip": (lambda: b"\x1f\x8b\x08\0" + bytes(20), "compressed with gzip"),
    "safetensors": (safetensors, "weights alone (safetensors)"),
    "pickle": (lambda: b"\x80\x04\x95\x00", "a Python pickle"),
    "empty": (lambda: b"", "it is empty"),
}


@pytest.mark.parametrize("name", sampled(FILES, *(name for name in FILES if name != "pt2")))
def test_file_is_called_what_it_is_when_it_is_no_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = tmp_path / "given.onnx"
    make, words = FILES[name]
    path.write_bytes(make())
    for arguments in (
        ["policy", "import", str(path), "--out", str(tmp_path / "policy.onnx")],
        ["policy", "import", str(path), *OPTIONS, "--out", str(tmp_path / "policy.onnx")],
        ["policy", "verify", str(path)],
        ["policy", "compile", str(path), "--explain"],
    ):
        if name == "state dict" and arguments[1] != "import":
            words = "a checkpoint, which `neuroflight policy import` makes a policy of"
        if name == "state dict" and OPTIONS[0] in arguments:
            continue  # taken for a checkpoint, which knows these itself
        assert main(arguments) == 1
        told = capsys.readouterr().err
        assert words in told, arguments
        assert told.count("\n") == 1


def test_model_is_called_quantized_when_its_operators_are_of_another_domain(kit: Kit) -> None:
    model = onnx.load_from_string(kit.mlp().data())
    model.graph.node[1].op_type, model.graph.node[1].domain = "Quant", "qonnx.custom_op.general"
    with pytest.raises(PolicyError, match="the model is quantized: node 'Tanh_1'"):
        parse_policy(model.SerializeToString())


def test_policy_is_read_when_it_is_a_policy(kit: Kit) -> None:
    assert parse_policy(kit.mlp().data()).action_count == 4
