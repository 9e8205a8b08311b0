"""What the tests of several rooms share: the shipped policy and the programs built around it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from sim.aircraft.model import load_aircraft
from sim.control.pid_table import pid_table
from toolchain.image.build import build
from toolchain.policy.freeze import to_onnx
from training.config.training_config import OutputMap, TrainingConfig

ROOT = Path(__file__).resolve().parents[1]
ESTIMATED = (
    "rate_error,rate~60Hz,rate_error_integral,previous_motors,"
    "rotor_estimate,rate_estimate,rate_estimate_error,throttle"
)
# Not build/, whose images are the user's. What sanitizers watch (tests/coverage.py) is not for other runs.
BUILD = ROOT / "build" / ("coverage" if os.environ.get("INSTRUMENT") else "tests")


@pytest.fixture(scope="session")
def shipped_policy() -> Path:
    """The policy inside the programs below: the one shipped for the NF1."""
    return ROOT / "training" / "policies" / "nf1" / "policy.onnx"


def build_shipped(target: str, policy: Path) -> None:
    """Build it with the PID of the aircraft that it was trained for."""
    build(target, policy, ROOT, BUILD, pid_table(load_aircraft("nf1")))


@pytest.fixture(scope="session")
def host_program(shipped_policy: Path) -> Path:
    """The firmware as a program of this machine, around `shipped_policy`."""
    build_shipped("HOST", shipped_policy)
    return BUILD / "HOST" / "neuroflight"


@pytest.fixture(scope="session")
def reference_library(host_program: Path) -> Path:
    """The same firmware as a shared library without sockets."""
    return host_program.with_name("libneuroflight.so")


@pytest.fixture(scope="session")
def board_image(shipped_policy: Path) -> Path:
    """The ELF that goes onto the MATEKF722, around `shipped_policy`."""
    build_shipped("MATEKF722", shipped_policy)
    return BUILD / "MATEKF722" / "neuroflight.elf"


@pytest.fixture(scope="session")
def estimating_policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small policy of the NF1 that observes what a model of it estimates, centred, behind the gyro's mean.

    24-8-8-4 tanh with random weights: it computes, it does not fly.
    """
    config = TrainingConfig(
        observation=ESTIMATED,
        hidden=(8, 8),
        output=OutputMap(scale=0.5, offset=0.5),
        idle=0.055,
        mix="centred",
        gyro_filter="mean",
    )
    aircraft, rng = load_aircraft("nf1"), np.random.default_rng(21)
    widths = {
        "mlp_extractor.policy_net.0": (8, 24),
        "mlp_extractor.policy_net.2": (8, 8),
        "action_net": (4, 8),
    }
    state = {}
    for name, (outputs, inputs) in widths.items():
        state[f"{name}.weight"] = rng.normal(0, inputs**-0.5, (outputs, inputs)).astype(np.float32)
        state[f"{name}.bias"] = rng.normal(0, 0.1, outputs).astype(np.float32)
    path = tmp_path_factory.mktemp("estimating") / "policy.onnx"
    path.write_bytes(to_onnx(config.document(aircraft), state))
    return path
