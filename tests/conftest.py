"""What the tests of several rooms share: the shipped policy and the programs built around it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sim.aircraft.model import load_aircraft
from sim.control.pid_table import pid_table
from toolchain.image.build import build

ROOT = Path(__file__).resolve().parents[1]
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
