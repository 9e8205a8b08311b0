"""For tests of policy slots: policies like the shipped one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper


def another_policy(
    source: Path, path: Path, seed: int = 1, metadata: Mapping[str, str] | None = None
) -> Path:
    """A policy of the same architecture with weights of its own; metadata: by key, changed in it."""
    model, rng = onnx.load(source), np.random.default_rng(seed)
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.ndim == 2:
            noisy = values * (1 + 0.01 * rng.standard_normal(values.shape)).astype(np.float32)
            tensor.CopyFrom(numpy_helper.from_array(noisy.astype(np.float32), tensor.name))
    for entry in model.metadata_props:
        entry.value = (metadata or {}).get(entry.key, entry.value)
    onnx.save(model, path)
    return path
