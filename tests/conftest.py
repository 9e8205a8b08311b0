"""What the tests of several rooms share: the shipped policy and the programs built around it."""

from __future__ import annotations

from pathlib import Path

import pytest

from toolchain.build import build

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build" / "tests"  # not build/, whose images are the user's


@pytest.fixture(scope="session")
def shipped_policy() -> Path:
    """The policy inside the programs below: the one shipped for the NF1."""
    return ROOT / "training" / "policies" / "nf1" / "policy.onnx"


@pytest.fixture(scope="session")
def host_program(shipped_policy: Path) -> Path:
    """The firmware as a program of this machine, around `shipped_policy`."""
    build("HOST", shipped_policy, ROOT, BUILD)
    return BUILD / "HOST" / "neuroflight"


@pytest.fixture(scope="session")
def reference_library(host_program: Path) -> Path:
    """The same firmware as a shared library without sockets."""
    return host_program.with_name("libneuroflight.so")


@pytest.fixture(scope="session")
def board_image(shipped_policy: Path) -> Path:
    """The ELF that goes onto the MATEKF722, around `shipped_policy`."""
    build("MATEKF722", shipped_policy, ROOT, BUILD)
    return BUILD / "MATEKF722" / "neuroflight.elf"
