"""The MATEKF722 image around a policy of the shipped size, built once."""

from __future__ import annotations

import io
import itertools
import subprocess
from pathlib import Path

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from toolchain.compiler import compile_policy
from toolchain.contract import observation_blocks
from toolchain.header import render_contract
from toolchain.layers import Clip, Layer, Linear, Tanh
from toolchain.network import PolicyModel
from toolchain.registers import RegisterTable, load

ROOT = Path(__file__).resolve().parents[3]
TARGET = ROOT / "firmware" / "targets" / "MATEKF722"
WIDTHS = (6, 64, 64, 4)


def random_policy() -> PolicyModel:
    """A 6-64-64-4 network of random weights, as large as the shipped one."""
    rng = np.random.default_rng(1)
    layers: list[Layer] = []
    for inputs, outputs in itertools.pairwise(WIDTHS):
        weight = rng.normal(0, inputs**-0.5, (outputs, inputs)).astype(np.float32)
        layers += [Linear(weight, np.zeros(outputs, np.float32)), Tanh()]
    return PolicyModel(
        blocks=observation_blocks("rate_error,rate_error_delta"),
        control_rate_hz=1000,
        filters=(),
        aircraft="random",
        aircraft_sha256="0" * 64,
        training={},
        source_sha256="0" * 64,
        observation_count=WIDTHS[0],
        action_count=WIDTHS[-1],
        layers=(*layers[:-1], Clip(0.0, 1.0)),
    )


@pytest.fixture(scope="session")
def image_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where make has left neuroflight.elf, .bin and .hex."""
    scratch = tmp_path_factory.mktemp("matekf722")
    emission = compile_policy(random_policy()).emission
    (scratch / "policy.c").write_text(emission.source)
    (scratch / "policy.h").write_text(emission.header)
    (scratch / "nf_contract.h").write_text(render_contract())
    make = ["make", "-s", "-C", str(ROOT / "firmware"), "TARGET=MATEKF722"]
    done = subprocess.run(
        [*make, f"GENERATED={scratch}", f"BUILD={scratch / 'build'}"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return scratch / "build"


@pytest.fixture(scope="session")
def elf(image_folder: Path) -> ELFFile:
    """The linked image."""
    return ELFFile(io.BytesIO((image_folder / "neuroflight.elf").read_bytes()))


@pytest.fixture(scope="session")
def symbols(elf: ELFFile) -> dict[str, int]:
    """Address of every name the image defines, bit 0 set for Thumb code."""
    table = elf.get_section_by_name(".symtab")
    assert isinstance(table, SymbolTableSection)
    return {s.name: s["st_value"] for s in table.iter_symbols() if s["st_shndx"] != "SHN_UNDEF"}


@pytest.fixture(scope="session")
def registers() -> RegisterTable:
    """The committed register table."""
    return load(TARGET)
