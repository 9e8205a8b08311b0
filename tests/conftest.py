"""What the tests of several rooms share: the shipped policy and the programs built around it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from toolchain.build import build
from toolchain.freeze import to_onnx

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shipped_policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The policy inside the programs below: the one shipped for the NF1, or a random one before it ships."""
    shipped = ROOT / "training" / "policies" / "nf1" / "policy.onnx"
    if shipped.is_file():
        return shipped
    path = tmp_path_factory.mktemp("policy") / "policy.onnx"
    path.write_bytes(random_policy())
    return path


def random_policy() -> bytes:
    """A 6-64-64-4 policy with weights of seed 0."""
    rng = np.random.default_rng(0)
    names = ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")
    state: dict[str, NDArray[np.float32]] = {}
    for name, inputs, outputs in zip(names, (6, 64, 64), (64, 64, 4), strict=True):
        state[f"{name}.weight"] = (rng.normal(size=(outputs, inputs)) / inputs**0.5).astype(np.float32)
        state[f"{name}.bias"] = np.zeros(outputs, np.float32)
    configuration = {
        "aircraft": {"name": "nf1", "sha256": "0" * 64},
        "observation": "rate_error,rate_error_delta",
        "observation_scale": [0.3] * 3 + [10.0] * 3,
        "control_rate_hz": 1000,
        "filters": [],
        "hidden": [64, 64],
        "activation": "tanh",
        "output": {"scale": 0.1, "offset": 0.15},
        "motors": 4,
    }
    return to_onnx(configuration, state)


@pytest.fixture(scope="session")
def host_program(shipped_policy: Path) -> Path:
    """The firmware as a program of this machine, around `shipped_policy`."""
    build("HOST", shipped_policy, ROOT)
    return ROOT / "build" / "HOST" / "neuroflight"


@pytest.fixture(scope="session")
def reference_library(host_program: Path) -> Path:
    """The same firmware as a shared library without sockets."""
    return host_program.with_name("libneuroflight.so")


@pytest.fixture(scope="session")
def board_image(shipped_policy: Path) -> Path:
    """The ELF that goes onto the MATEKF722, around `shipped_policy`."""
    build("MATEKF722", shipped_policy, ROOT)
    return ROOT / "build" / "MATEKF722" / "neuroflight.elf"
