"""What the tests of several rooms share: the shipped policy and the programs built around it."""

from __future__ import annotations

import gc
import hashlib
import os
import pickle
import shutil
import signal
import sys
import threading
from collections.abc import Generator
from functools import cache
from pathlib import Path

from neuroflight.cli.main import THREADS

# Before numpy and torch are imported: a command of ours in a test takes one thread, as it does for a user.
os.environ.update({name: "1" for name in THREADS if name not in os.environ})

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.toolchain.files import locked
from neuroflight.toolchain.image.build import build, find_target
from neuroflight.toolchain.image.report import AircraftFacts
from neuroflight.toolchain.policy.freeze import to_onnx
from neuroflight.toolchain.rendering.pid_table import PidTable
from neuroflight.training.config.training_config import OutputMap, TrainingConfig

ROOT = Path(__file__).resolve().parents[1]
ESTIMATED = (
    "rate_error,rate~60Hz,rate_error_integral,previous_motors,"
    "rotor_estimate,rate_estimate,rate_estimate_error,throttle"
)
# Not build/, whose images are the user's. What sanitizers watch (tests/coverage.py) is not for other runs.
BUILD = ROOT / "build" / ("coverage" if os.environ.get("INSTRUMENT") else "tests")


SHIPPED = ROOT / "training" / "policies" / "nf1" / "policy.onnx"
WORKER = os.environ.get("PYTEST_XDIST_WORKER", "gw0")


def pytest_configure() -> None:
    """Ctrl-C reaches tests and what they start, also where a shell began the run in the background.

    And nothing is garbage while tests are collected.
    """
    gc.disable()
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    if ignored and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """The collector need not look through the tests again, of which there are thousands."""
    gc.enable()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Every other worker reads the tests from their end: each compiles one half and finds the other."""
    report = yield
    if isinstance(collector, pytest.Directory) and int(WORKER.removeprefix("gw")) % 2:
        report.result.reverse()
    return report


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The tests in the order of all workers."""
    items.sort(key=lambda item: item.path)


@pytest.fixture(scope="session")
def shipped_policy() -> Path:
    """The policy inside the programs below: the one shipped for the NF1."""
    return SHIPPED


@cache
def sources() -> bytes:
    """Return the digest of what makes a build around a policy. It does not change in a run."""
    digest = hashlib.sha256(sys.version.encode())
    for path in sorted(path for folder in ("firmware", "toolchain") for path in (ROOT / folder).rglob("*")):
        if path.is_file() and path.suffix != ".pyc" and "generated" not in path.parts:
            digest.update(path.read_bytes())
    return digest.digest()


def build_once(
    target: str, policy: Path, folder: Path, pid: PidTable | None, aircraft: AircraftFacts | None = None
) -> None:
    """Build into `folder`/<target>, unless the same was built there: to look whether it is takes a second."""
    given = pickle.dumps((target, policy.read_bytes(), pid, aircraft))
    made_of = hashlib.sha256(sources() + given).hexdigest()
    note = folder / target / "made_of.txt"
    if not note.exists() or note.read_text() != made_of:
        note.unlink(missing_ok=True)
        build(target, policy, ROOT, folder, pid, aircraft)
        note.write_text(made_of)


def build_shipped(target: str, policy: Path) -> None:
    """Build it with the PID of the aircraft that it was trained for."""
    build_once(target, policy, BUILD, pid_table(load_aircraft("nf1")))


def build_beside(
    target: str,
    policy: Path,
    folder: Path,
    pid: PidTable | None = None,
    aircraft: AircraftFacts | None = None,
) -> Path:
    """Build into `folder`/<target>, which is returned; what does not see the policy is compiled already.

    Objects are those around the shipped policy, and make knows which of them `policy` changes.
    """
    build_shipped(target, SHIPPED)
    for name in {find_target(target).family, target}:
        made, out = (BUILD / name).resolve(), (folder / name).resolve()
        with locked(folder):
            if not out.exists():
                _copy_build(made, out)
    build_once(target, policy, folder, pid, aircraft)
    return (folder / target).resolve()


def _copy_build(made: Path, out: Path) -> None:
    """Copy what was built in the folder `made`, as if it had been built in `out`."""
    aside = out.with_name(f"{out.name}.copied")
    shutil.rmtree(aside, ignore_errors=True)
    with locked(made):
        shutil.copytree(made, aside)
    for dependencies in aside.rglob("*.d"):  # they name an object by where it was made
        text = dependencies.read_text()
        if str(made) not in text:  # by another name of it: then nobody knows what it depends on
            dependencies.with_suffix(".o").unlink()
        dependencies.write_text(text.replace(str(made), str(out)))
    aside.rename(out)


def build_kept(
    target: str, policy: bytes, name: str, pid: PidTable | None = None, aircraft: AircraftFacts | None = None
) -> Path:
    """Build around a policy that tests make, in a folder that all workers, and the next run, find again."""
    path = BUILD / name / "policy.onnx"
    with locked(path.parent):
        if not path.exists() or path.read_bytes() != policy:
            path.write_bytes(policy)
    return build_beside(target, path, path.parent, pid, aircraft)


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
