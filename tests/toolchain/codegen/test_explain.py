"""`neuroflight policy compile`: what it writes, what --explain tells, and one line where it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from onnx import helper

from neuroflight.cli.main import main
from neuroflight.cli.report import WIDTH
from neuroflight.toolchain.codegen.explain import describe, explain_policy
from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.ir.onnx_export import to_model
from neuroflight.toolchain.passes import PASSES
from neuroflight.toolchain.policy.model import parse_policy

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

Capture = pytest.CaptureFixture[str]


def array(*shape: int, seed: int = 0) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return (0.4 * np.random.default_rng(seed).normal(size=shape)).astype(np.float32)


def linear(outputs: int, inputs: int, seed: int = 0) -> op.Linear:
    return op.Linear(array(outputs, inputs, seed=seed), array(outputs, seed=seed + 1))


def every_pass() -> Network:
    """A network in which each pass finds something."""
    nodes = list[Node]()

    def add(operation: op.Operation, *taken: int) -> int:
        nodes.append(Node(operation, taken, f"node_{len(nodes)}"))
        return len(nodes)

    moved = add(op.Affine(np.ones(6), array(6).astype(float)), 0)
    scaled = add(op.Affine(array(6).astype(float), np.zeros(6)), moved)
    errors = add(op.Slice(0, 5), scaled)
    gate = add(op.Sigmoid(), add(linear(16, 5), errors))
    still = linear(12, 16)
    still.weight[4] = 0
    hidden = add(op.Clip(-1.0, 1.0), add(op.Tanh(), add(still, gate)))
    twin, other = add(linear(7, 16, 3), gate), add(linear(7, 16, 3), gate)
    deltas = add(op.Relu(), add(linear(4, 2), add(op.Slice(1, 2), errors)))
    joined = add(op.Concat(), hidden, add(op.Softsign(), twin), add(op.Softsign(), other), deltas)
    add(linear(9, 30), joined)  # a critic's head: nobody takes it
    wide = add(linear(20, 30), joined)
    last = add(op.Affine(np.ones(4), np.zeros(4)), add(op.Tanh(), add(linear(4, 20), wide)))
    add(op.Clip(0.0, 1.0), add(op.Affine(np.full(4, 0.5), np.full(4, 0.5)), last))
    return Network(6, tuple(nodes))


def data(kit: Kit, network: Network) -> bytes:
    """The bytes of an ONNX file of `network`."""
    model = to_model(network)
    helper.set_model_props(model, kit.chain().metadata)
    return bytes(model.SerializeToString())


@pytest.fixture
def policy_file(kit: Kit, tmp_path: Path) -> Path:
    """A policy that every pass finds something in."""
    path = tmp_path / "policy.onnx"
    path.write_bytes(data(kit, every_pass()))
    return path


def document(arguments: list[str], capsys: Capture) -> dict[str, Any]:
    """What `neuroflight policy compile --json` prints."""
    assert main(["policy", "compile", *arguments, "--json"]) == 0
    printed = capsys.readouterr()
    facts = json.loads(printed.out)
    assert isinstance(facts, dict)
    return facts


def refused(arguments: list[str], capsys: Capture) -> str:
    """The one line on stderr of a command that fails."""
    assert main(["policy", "compile", *arguments]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("neuroflight: ")
    assert printed.err.count("\n") == 1
    return printed.err


def test_every_pass_is_told_with_its_proof_when_explained(policy_file: Path, capsys: Capture) -> None:
    facts = document([str(policy_file), "--explain"], capsys)
    assert [saving["rewrite"] for saving in facts["savings"]] == [step.name for step in PASSES]
    for proof in [facts["proof"], *(saving["proof"] for saving in facts["savings"])]:
        assert proof["observations"] > 0
        assert proof["unit"] <= proof["bound"]
        assert proof["beyond"] <= proof["bound"]


def test_savings_and_networks_agree_when_explained(policy_file: Path, capsys: Capture) -> None:
    facts = document([str(policy_file), "--explain"], capsys)
    for figure in ("nodes", "operations", "bytes"):
        saved = sum(saving[figure] for saving in facts["savings"])
        assert saved == facts["before"][figure] - facts["after"][figure] > 0
    for side in ("before", "after"):
        nodes = facts[side]["network"]
        assert len(nodes) == facts[side]["nodes"]
        assert sum(node["operations"] for node in nodes) == facts[side]["operations"]
        assert sum(node["bytes"] for node in nodes) == facts[side]["bytes"]
    memory = facts["memory"]
    assert memory["weights"] >= facts["after"]["bytes"]
    assert 0 < memory["scratch"] < memory["scratch_unshared"]
    assert memory["state"] == 0


def test_state_is_told_when_the_policy_remembers(kit: Kit) -> None:
    cell = op.Gru(array(15, 6), array(15, 5, seed=1), array(15), array(15))
    network = Network(6, (Node(cell, (0,)), Node(linear(4, 5), (1,)), Node(op.Clip(0.0, 1.0), (2,))))
    explanation = explain_policy(parse_policy(data(kit, network)))
    assert explanation.memory.state >= 4 * 5
    assert [node.operation for node in explanation.after] == ["Gru 6 → 5", "Linear 5 → 4", "Clip 0 to 1"]


def test_table_is_printed_when_explained(policy_file: Path, tmp_path: Path, capsys: Capture) -> None:
    assert main(["policy", "compile", str(policy_file), "--explain"]) == 0
    printed = capsys.readouterr().out
    for step in PASSES:
        assert sum(line.startswith(f"{step.name} ") for line in printed.splitlines()) == 1
    assert "Linear 16 → 12" in printed
    assert "scratch" in printed
    assert max(map(len, printed.splitlines())) <= WIDTH
    assert list(tmp_path.iterdir()) == [policy_file]


def test_nothing_is_claimed_when_no_pass_finds_anything(kit: Kit, tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "plain.onnx"
    path.write_bytes(kit.mlp((6, 8, 4)).data())
    facts = document([str(path), "--explain"], capsys)
    assert facts["savings"] == []
    assert facts["proof"] is None
    assert facts["before"] == facts["after"]
    assert main(["policy", "compile", str(path), "--explain"]) == 0
    assert f"none of {len(PASSES)} found anything to do" in capsys.readouterr().out


def test_explained_policy_is_the_same_when_it_is_written(
    policy_file: Path, tmp_path: Path, capsys: Capture
) -> None:
    plain, explained = tmp_path / "plain", tmp_path / "explained"
    document([str(policy_file), "--out", str(plain)], capsys)
    document([str(policy_file), "--out", str(explained), "--explain"], capsys)
    for name in ("policy.c", "policy.h"):
        assert (explained / name).read_bytes() == (plain / name).read_bytes()


def test_onnxruntime_is_not_waited_for_when_nothing_is_explained(policy_file: Path, tmp_path: Path) -> None:
    code = "import sys; from neuroflight.cli.main import main; main(sys.argv[1:]); "
    code += "sys.exit('onnxruntime' in sys.modules)"
    words = ["policy", "compile", str(policy_file), "--out", str(tmp_path / "out")]
    subprocess.run([sys.executable, "-c", code, *words], check=True, capture_output=True)


def test_name_from_the_file_commands_no_terminal_when_it_holds_codes(
    kit: Kit, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    path = tmp_path / "odd.onnx"
    path.write_bytes(kit.chain(6, 6).add("Tanh", name="[bold]/layer[0]\n\x1b[31m").clip().data())
    assert main(["policy", "compile", str(path), "--explain"]) == 0
    printed = capsys.readouterr().out
    assert "/layer_0_" in printed
    assert "\x1b" not in printed


def test_compile_is_refused_when_it_has_nothing_to_do(policy_file: Path, capsys: Capture) -> None:
    assert "--out is missing" in refused([str(policy_file)], capsys)


def test_compile_is_refused_when_out_is_a_file(policy_file: Path, tmp_path: Path, capsys: Capture) -> None:
    taken = tmp_path / "taken"
    taken.write_text("mine")
    assert "is no directory" in refused([str(policy_file), "--out", str(taken)], capsys)
    assert taken.read_text() == "mine"


@pytest.mark.parametrize(
    ("operation", "text"),
    [
        (op.Affine(np.full(3, 2.0), np.zeros(3)), "Affine a x"),
        (op.Affine(np.ones(3), np.ones(3)), "Affine x + b"),
        (op.Affine(np.full(3, 2.0), np.ones(3)), "Affine a x + b"),
        (op.LeakyRelu(0.01), "LeakyRelu 0.01"),
        (op.Clip(None, 0.5), "Clip … to 0.5"),
        (op.Slice(2, 3), "Slice 2 to 4"),
        (op.Slice(5, 3, -2), "Slice 5 to 1, every -2"),
        (op.Softsign(), "Softsign"),
    ],
)
def test_operation_is_told_in_a_few_words_when_it_is(operation: op.Operation, text: str) -> None:
    assert describe(operation) == text
