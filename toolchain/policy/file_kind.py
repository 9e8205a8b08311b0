"""Recognition of files that people pass in place of an ONNX model or a checkpoint, with advice."""

from __future__ import annotations

import io
import struct
import zipfile
from codecs import getincrementaldecoder

SAFETENSORS_HEADER_MAX = 100_000_000  # bytes, as its own reader has it
TEXT_BYTES = 4096  # that are looked at to call a file text
TORCH_EXPORT = "export its actor with torch.onnx.export(actor.eval(), (torch.zeros(1, n),), 'actor.onnx')"
KERAS_EXPORT = "export it with model.export('actor.onnx', format='onnx') or tf2onnx"
# The number that torch's files before 1.6 begin with.
OLD_TORCH = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19."
STARTS = (
    (
        b"version https://git-lfs",
        "a Git LFS pointer, not the file that it stands for; fetch that with `git lfs pull`",
    ),
    (b"GGUF", "a GGUF model of llama.cpp, not a policy; " + TORCH_EXPORT),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file, as Keras saves models and weights; " + KERAS_EXPORT),
    (OLD_TORCH, "a torch file of the form before torch 1.6; " + TORCH_EXPORT),
    (b"\x80", "a Python pickle, which could run any code and is not opened; " + TORCH_EXPORT),
    (b"\x93NUMPY", "a numpy array, not a model; export the model as ONNX"),
    (b"\x1f\x8b", "compressed with gzip; unpack it first"),
    (b"\xfd7zXZ", "compressed with xz; unpack it first"),
    (b"BZh", "compressed with bzip2; unpack it first"),
    (b"\x28\xb5\x2f\xfd", "compressed with zstd; unpack it first"),
    (b"Rar!", "a RAR archive; unpack it first"),
    (b"7z\xbc\xaf", "a 7-Zip archive; unpack it first"),
    (b"\x7fELF", "a compiled program or library; freeze the ONNX model that it was made from"),
    (b"ftrt", "a TensorRT engine; freeze the ONNX model that it was built from"),
)
IDENTIFIERS = {  # of flatbuffers, at byte 4
    b"TFL3": "a TensorFlow Lite model; convert it with "
    "`python -m tf2onnx.convert --tflite FILE --output actor.onnx`",
    b"ORTM": "a model in onnxruntime's own form (.ort), optimized for one machine; freeze the .onnx that it "
    "was made from",
    b"ET12": "an ExecuTorch program; " + TORCH_EXPORT,
}
ARCHIVES = (  # an entry's name, or its end, and what the archive is then
    ("/constants.pkl", "a TorchScript archive; load it with torch.jit.load and " + TORCH_EXPORT),
    (
        "models/model.json",
        "a program of torch.export (.pt2); load it with torch.export.load and give it to torch.onnx.export",
    ),
    (
        "policy.pth",
        "a model of Stable-Baselines3 (.zip); export its actor as ONNX (docs/guides/policies.md)",
    ),
    ("model.weights.h5", "a Keras model (.keras); " + KERAS_EXPORT),
    (".npy", "an archive of numpy arrays (.npz), not a model; export the model as ONNX"),
    (".onnx", "an archive with an ONNX model in it; unpack it first"),
    (".mlmodel", "a Core ML model; freeze the ONNX model that it was made from"),
    ("saved_model.pb", "a TensorFlow SavedModel; convert it with tf2onnx"),
)


def foreign_kind(data: bytes) -> str | None:
    """Return what kind of file it is and what to do about it; None if it may be a model or a checkpoint."""
    if not data:
        return "empty; was it downloaded or written to its end?"
    for start, words in STARTS:
        if data.startswith(start):
            return words
    if data[4:8] in IDENTIFIERS:
        return IDENTIFIERS[data[4:8]]
    if data.startswith(b"PK"):
        return _archive(data)
    if data[257:262] == b"ustar":
        return "a tar archive; unpack it first"
    if (
        len(data) > 8
        and data[8:9] == b"{"
        and 2 <= struct.unpack("<Q", data[:8])[0] <= SAFETENSORS_HEADER_MAX
    ):
        return "weights alone (safetensors), without the network that they belong to; " + TORCH_EXPORT
    return _text(data[:TEXT_BYTES])


def _archive(data: bytes) -> str | None:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError):
        return None  # perhaps a damaged checkpoint
    for end, words in ARCHIVES:
        if any(name.endswith(end) for name in names):
            return words
    return None if any(name.endswith("/data.pkl") for name in names) else "a zip archive; unpack it first"


def _text(begin: bytes) -> str | None:
    # ONNX's first byte is the number of a field: 8, a backspace, which no text holds.
    text = begin.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not text or any(byte < 32 and byte not in b"\t\n\r\f\x1b" for byte in begin):
        return None
    try:
        getincrementaldecoder("utf-8")().decode(begin)
    except UnicodeDecodeError:
        return None
    lower = text[:512].lower()
    if lower.startswith((b"<!doctype html", b"<html")) or b"<html" in lower:
        return "a web page (HTML), not the file itself; download what its raw or download link gives"
    if lower.startswith(b"<?xml") and b"<net" in text:
        return "a model of OpenVINO; freeze the ONNX model that it was made from"
    if lower.startswith((b"{", b"[")):
        return "JSON text, not a model; export the model as ONNX"
    return "text, not a model; export the model as ONNX"
