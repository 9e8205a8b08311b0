"""The generated C: golden text, determinism, and compilers that find nothing to say."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from neuroflight.toolchain.codegen.compiler import compile_network
from neuroflight.toolchain.codegen.emit import literal
from neuroflight.toolchain.contract import observation_blocks
from neuroflight.toolchain.cortex_m7.arm_policy import build_policy_elf
from neuroflight.toolchain.cortex_m7.disassembly import disassemble
from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.policy.blob import parse
from neuroflight.toolchain.policy.model import PolicyModel, parse_policy

if TYPE_CHECKING:
    from tests.toolchain.conftest import Chain, Kit

GOLDEN = Path(__file__).parent / "golden"
# In policy.c: tables of numbers, and kernels, whose text is the templates'.
TABLE = re.compile(r"(    \.(?:weights|selftest_\w+) = \{\n)(.*?)(\n    \},)", re.DOTALL)
KERNEL = re.compile(r"^(KERNEL void \w+\(.*?\)\n\{\n)(.*?)(\n\}$)", re.DOTALL | re.MULTILINE)
COMPILE = """
import sys
from pathlib import Path
from neuroflight.toolchain.cortex_m7.arm_policy import build_policy_elf
from neuroflight.toolchain.policy.blob import parse
from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.policy.model import read_policy
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


def every_kernel() -> PolicyModel:
    """3-4: two cells, a norm, branches and each activation; weights that are easy to read."""

    def ramp(*shape: int) -> Float32:
        values: Float32 = np.arange(np.prod(shape), dtype=np.float32).reshape(shape) / np.float32(64)
        return values

    gru = op.Gru(ramp(6, 3), ramp(6, 2), ramp(6), ramp(6))
    lstm = op.Lstm(ramp(8, 2), ramp(8, 2), ramp(8))
    nodes = [
        Node(gru, (0,)),
        Node(lstm, (1,)),
        Node(op.Concat(), (2, 0)),
        Node(op.LayerNorm(1e-5, ramp(5), ramp(5)), (3,)),
        Node(op.Silu(), (4,)),
        Node(op.Linear(ramp(9, 5), ramp(9)), (5,)),
        Node(op.Elu(0.5), (6,)),
        Node(op.LeakyRelu(0.25), (7,)),
        Node(op.Softsign(), (8,)),
        Node(op.Slice(8, 4, -2), (9,)),
        Node(op.Relu(), (10,)),
        Node(op.Multiply(), (10, 11)),
        Node(op.Clip(None, 2.0), (12,)),
        Node(op.Clip(-1.0, 1.5), (13,)),
        Node(op.Affine(np.full(4, 0.5), np.full(4, 0.25)), (14,)),
        Node(op.Add(), (15, 14)),
        Node(op.Erf(), (16,)),
        Node(op.Softplus(), (17,)),
        Node(op.RmsNorm(1e-5, ramp(4), ramp(4)), (18,)),
        Node(op.Softmax(), (19,)),
        Node(op.Select(), (15, 20, 16)),
        Node(op.Clip(0.0, 1.0), (21,)),
    ]
    return PolicyModel(
        blocks=observation_blocks("rate_error~15Hz@2"),
        control_rate_hz=1000,
        filters=(),
        aircraft="nf1",
        aircraft_sha256="0" * 64,
        training={},
        source_sha256="5a" * 32,
        network=Network(3, tuple(nodes)),
        idle=0.25,
    )


@pytest.mark.parametrize("folder", ["small", "every_kernel"])
def test_c_is_the_golden_text_when_the_network_is_known(kit: Kit, tmp_path: Path, folder: str) -> None:
    """After a wanted change of the generator, read the difference and copy the new text over the old."""
    policy = every_kernel()
    if folder == "small":  # the file's bytes, hence its hash, are the onnx package's affair
        policy = replace(parse_policy(small_chain(kit).data()), source_sha256="5a" * 32)
    source = kit.write(compile_network(policy, policy.network), tmp_path)
    source.write_text(KERNEL.sub(digested, TABLE.sub(digested, source.read_text())))
    for name in ("policy.c", "policy.h"):
        golden, written = GOLDEN / folder / name, source.with_name(name)
        if folder == "small":
            written.write_text(
                own_paragraphs(written.read_text(), (GOLDEN / "every_kernel" / name).read_text())
            )
        assert written.read_text() == golden.read_text(), f"after a wanted change: cp {written} {golden}"


def own_paragraphs(text: str, other: str) -> str:
    """A text without the paragraphs that the other one has too."""
    shared = set(other.split("\n\n"))
    return "\n\n".join("..." if part in shared else part for part in text.split("\n\n"))


def digested(found: re.Match[str]) -> str:
    """The golden text of a table or a kernel: its lines' count and digest."""
    head, rows, end = found.groups()
    return f"{head}    {rows.count(chr(10)) + 1} lines, {hashlib.sha256(rows.encode()).hexdigest()}{end}"


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
@pytest.mark.parametrize("chain", ["perceptron", "every kernel"])
def test_c_compiles_alone_and_needs_nothing_when_warnings_are_errors(
    kit: Kit, tmp_path: Path, machine: str, chain: str
) -> None:
    compiler, nm = (kit.host_compiler, "nm") if machine == "host" else (kit.arm_compiler, "arm-none-eabi-nm")
    policy = kit.compiled(kit.mlp())
    if chain == "every kernel":
        policy = compile_network(every_kernel(), every_kernel().network)
    source = kit.write(policy, tmp_path)
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


@pytest.mark.parametrize("optimization", ["-O2", "-O3"])
def test_cortex_m7_code_fuses_stays_single_and_has_no_condition_when_disassembled(
    kit: Kit, tmp_path: Path, optimization: str
) -> None:
    policy = compile_network(every_kernel(), every_kernel().network)
    code = disassemble(build_policy_elf(policy.emission, tmp_path, optimization=optimization))
    mnemonics = Counter(instruction.mnemonic for instruction in code.values())
    assert mnemonics["vfma.f32"] >= 8 * 8 + 4 * 8  # a block of each linear kernel
    assert mnemonics["vldmia"] > 10
    assert not any(".f64" in mnemonic for mnemonic in mnemonics)
    steps = [i for i in code.values() if i.function != "policy_init"]  # which chooses a table, not a value
    assert not [i for i in steps if i.condition and not i.is_branch]
    assert not [i for i in steps if re.fullmatch("it[te]*", i.mnemonic)]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0x0p+0f"), (-1.5, "-0x1.8p+0f"), (0.1, "0x1.99999ap-4f"), (1e-45, "0x1p-149f")],
)
def test_literal_is_exact_and_short_when_written(value: float, text: str) -> None:
    assert literal(value) == text


@pytest.mark.parametrize("machine", ["host", "arm"])
def test_object_holds_the_very_bytes_of_the_blob_when_c_is_compiled(
    kit: Kit, tmp_path: Path, machine: str
) -> None:
    """Also under the names of the parts."""
    compiler = kit.host_compiler if machine == "host" else kit.arm_compiler
    policy = compile_network(every_kernel(), every_kernel().network)
    result = tmp_path / "policy.o"
    subprocess.run([*compiler, "-c", kit.write(policy, tmp_path), "-o", result], check=True)
    with result.open("rb") as file:
        elf = ELFFile(file)
        table = elf.get_section_by_name(".symtab")
        assert isinstance(table, SymbolTableSection)
        symbols = {symbol.name: symbol for symbol in table.iter_symbols()}

        def held(name: str) -> bytes:
            symbol = symbols[name]
            section = elf.get_section(symbol["st_shndx"])
            return section.data()[symbol["st_value"] :][: symbol["st_size"]]

        assert held("policy_blob") == policy.emission.blob
        assert parse(policy.emission.blob).selftest_steps == len(policy.blob.selftest_action)
        for part in ("weights", "selftest_observation", "selftest_action"):
            assert held(f"policy_{part}") == getattr(policy.blob, part).tobytes()
