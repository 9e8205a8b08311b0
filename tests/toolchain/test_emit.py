"""The generated C: golden text, determinism, and compilers that find nothing to say."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from toolchain.compiler import compile_policy
from toolchain.emit import literal
from toolchain.network import parse_policy

if TYPE_CHECKING:
    from tests.toolchain.conftest import Chain, Kit

GOLDEN = Path(__file__).parent / "golden"
COMPILE = """
import sys
from pathlib import Path
from toolchain.compiler import compile_policy
from toolchain.network import read_policy
emission = compile_policy(read_policy(Path(sys.argv[1]))).emission
sys.stdout.write(emission.header + emission.source)
"""


def small_chain(kit: Kit) -> Chain:
    """3-9-4, with a scaled observation and each kind of activation; weights that are easy to read."""
    steps = np.arange(27, dtype=np.float32).reshape(9, 3)
    chain = kit.chain(3, 4)
    chain.metadata["neuroflight.observation"] = "rate_error"
    chain.add("Mul", np.float32(0.5)).add("Gemm", steps / 16, np.full(9, 0.25, np.float32), transB=1)
    chain.add("Tanh").add("Gemm", np.eye(4, 9, dtype=np.float32), np.zeros(4, np.float32), transB=1)
    return chain.add("Relu").add("Mul", np.full(4, 2, np.float32)).clip()


@pytest.mark.parametrize("name", ["policy.c", "policy.h"])
def test_c_is_the_golden_text_when_the_network_is_small(kit: Kit, tmp_path: Path, name: str) -> None:
    """After a wanted change of the generator, read the difference and copy the new text over the old."""
    policy = parse_policy(small_chain(kit).data())
    fixed = replace(policy, source_sha256="5a" * 32)  # the file's bytes are the onnx package's affair
    source = kit.write(compile_policy(fixed), tmp_path)
    assert source.with_name(name).read_text() == (GOLDEN / name).read_text()


def test_c_is_the_same_when_another_process_writes_it(kit: Kit, tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    path.write_bytes(small_chain(kit).data())
    texts = {
        subprocess.run(
            [sys.executable, "-c", COMPILE, path],
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(GOLDEN.parents[2])},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    emission = kit.compiled(small_chain(kit)).emission
    assert texts == {emission.header + emission.source}


@pytest.mark.parametrize("machine", ["host", "arm"])
@pytest.mark.parametrize("chain", ["perceptron", "small"])
def test_c_compiles_alone_and_needs_nothing_when_warnings_are_errors(
    kit: Kit, tmp_path: Path, machine: str, chain: str
) -> None:
    compiler, nm = (kit.host_compiler, "nm") if machine == "host" else (kit.arm_compiler, "arm-none-eabi-nm")
    source = kit.write(kit.compiled(kit.mlp() if chain == "perceptron" else small_chain(kit)), tmp_path)
    result = tmp_path / "policy.o"
    done = subprocess.run([*compiler, "-c", source, "-o", result], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    undefined = subprocess.run([nm, "-u", result], capture_output=True, text=True, check=True).stdout
    assert not undefined.split()


def test_c_compiles_alone_when_only_the_standard_is_named(kit: Kit, tmp_path: Path) -> None:
    source = kit.write(kit.compiled(kit.mlp()), tmp_path)
    for compiler in ("gcc", "arm-none-eabi-gcc"):
        command = [compiler, "-std=c11", "-Wall", "-Wextra", "-Werror", "-c", source, "-o", tmp_path / "p.o"]
        subprocess.run(command, check=True)


def test_cortex_m7_code_fuses_and_stays_single_when_disassembled(kit: Kit, tmp_path: Path) -> None:
    source = kit.write(kit.compiled(kit.mlp()), tmp_path)
    result = tmp_path / "policy.o"
    subprocess.run([*kit.arm_compiler, "-c", source, "-o", result], check=True)
    dump = ["arm-none-eabi-objdump", "-d"]
    text = subprocess.run([*dump, result], capture_output=True, text=True, check=True).stdout
    assert text.count("vfma.f32") >= 8 + 4  # a block of each layer
    assert ".f64" not in text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0x0p+0f"), (-1.5, "-0x1.8p+0f"), (0.1, "0x1.99999ap-4f"), (1e-45, "0x1p-149f")],
)
def test_literal_is_exact_and_short_when_written(value: float, text: str) -> None:
    assert literal(value) == text
