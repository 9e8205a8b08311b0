"""Weights that an exporter put into a file beside the model, as torch does unless told otherwise."""

from __future__ import annotations

import os
from pathlib import Path

import onnx
from onnx import TensorProto

from neuroflight.toolchain.contract import POLICY_FILE_BYTES_MAX
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.files import read_limited
from neuroflight.toolchain.reader.values import shown


def embed_weights(model: onnx.ModelProto, folder: Path) -> list[str]:
    """Move weights of files in `folder` into `model`; returns the names of those files.

    Raises PolicyError for a file elsewhere, a missing or a large one, and for weights beyond its end.
    """
    files: dict[str, bytes] = {}
    left = POLICY_FILE_BYTES_MAX  # bytes: many tensors may name the same ones, and each gets a copy
    for tensor in model.graph.initializer:
        if tensor.data_location != TensorProto.EXTERNAL:
            continue
        entries = {entry.key: entry.value for entry in tensor.external_data}
        name = entries.get("location", "")
        if name not in files:
            files[name] = _read(folder, name, POLICY_FILE_BYTES_MAX - sum(map(len, files.values())))
        part = _part(files[name], entries, tensor.name)
        left -= len(part)
        if left < 0:
            raise PolicyError(
                f"the initializers up to {shown(tensor.name)} take more than {POLICY_FILE_BYTES_MAX} bytes "
                f"of {', '.join(map(shown, files))}; is it a policy?"
            )
        tensor.raw_data = part
        tensor.data_location = TensorProto.DEFAULT
        del tensor.external_data[:]
    return list(files)


def _read(folder: Path, name: str, limit: int) -> bytes:
    # protobuf gives bytes instead of str for what is not UTF-8
    # Path takes the ./ away that some exporters write before a name
    if not isinstance(name, str) or not name.isprintable() or Path(name).name != str(Path(name)):
        raise PolicyError(f"the model keeps weights in {shown(str(name))}, expected a file beside it")
    path = folder / name
    try:
        if Path(os.path.realpath(path, strict=True)).parent != folder.resolve():
            raise PolicyError(f"{path} is a link out of the model's folder; put the weights themselves there")
    except OSError as error:
        raise PolicyError(f"cannot read the weights {path}: {error.strerror}") from error
    return read_limited(path, f"{path}", limit, PolicyError, "; is it a policy?")


def _part(data: bytes, entries: dict[str, str], name: str) -> bytes:
    try:
        start = int(entries.get("offset", "0"))
        count = int(entries.get("length", str(len(data) - start)))
    except ValueError as error:
        raise PolicyError(
            f"initializer {shown(name)} has no sound offset and length, expected numbers of bytes; save the "
            "model again"
        ) from error
    if start < 0 or count < 0 or start + count > len(data):
        raise PolicyError(
            f"initializer {shown(name)} is kept in bytes {start} to {start + count} of a file of "
            f"{len(data)}; do model and weights belong together?"
        )
    return data[start : start + count]
