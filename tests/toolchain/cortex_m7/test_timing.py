"""What a policy takes on the board: figures that can be counted by hand, and the command that prints them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.contract import DTCM, FLASH_BASE, FLASH_BYTES, ITCM, Region, observation_blocks
from neuroflight.toolchain.cortex_m7.arm_policy import ArmPolicy, build_policy_elf, compile_arm, state_bytes
from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ
from neuroflight.toolchain.cortex_m7.emulator import load_program
from neuroflight.toolchain.cortex_m7.llvm_mca import find_pricer
from neuroflight.toolchain.cortex_m7.timing import mixed_observations, step_cost, time_policy
from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.ir.network import chain
from neuroflight.toolchain.policy.model import PolicyModel, read_policy
from tests.sampling import sampled

if TYPE_CHECKING:
    from tests.toolchain.conftest import Float32, Kit

Capture = pytest.CaptureFixture[str]

COUNTING = """
#include "policy.h"
const float policy_weights[8] = { 1 };
void policy_init(struct policy *p, const float *weights) { p->weights = weights ? weights : policy_weights; }
__attribute__((naked)) void policy_step(struct policy *p, const float *observation, float *action)
{
    __asm__ volatile(
        "push {r4, lr}\\n ldr r3, [r1]\\n movs r4, #10\\n cmp r3, #0\\n beq 1f\\n movs r4, #20\\n"
        "1: nop\\n nop\\n subs r4, #1\\n bne 1b\\n movs r3, #0\\n str r3, [r2]\\n pop {r4, pc}");
}
"""


@pytest.fixture
def counting(tmp_path: Path) -> ArmPolicy:
    """A policy of known instructions: ten rounds of its loop for 0, twenty for another observation."""
    (tmp_path / "policy.h").write_text("struct policy { const float *weights; float state[4]; };\n")
    (tmp_path / "policy.c").write_text(COUNTING)
    link = ("-nostdlib", "-Wl,-Ttext=0x10000,-Tdata=0x20000000,-z,separate-code,-z,max-page-size=0x1000")
    compile_arm(
        "-std=gnu11", "-g", "-O2", *link, "-Wl,-e,policy_step", "policy.c", out=tmp_path / "policy.elf"
    )
    return ArmPolicy(load_program(tmp_path / "policy.elf"), 1, 1)


def test_instructions_are_those_counted_by_hand_when_routes_differ(counting: ArmPolicy) -> None:
    cost = step_cost(counting, np.array([[0], [1], [0], [2]], np.float32))
    before, rounds, after = 5, 4, 3
    assert len(cost.routes) == 2
    assert cost.instructions == (before + 10 * rounds + after, before + 1 + 20 * rounds + after)
    assert cost.worst.instructions == cost.instructions[1]
    assert cost.stack_bytes == 8
    assert {block.instructions[0].function for block in cost.worst.blocks} == {"policy_step"}


def test_size_of_the_state_is_the_structs_when_the_program_tells(counting: ArmPolicy, tmp_path: Path) -> None:
    assert state_bytes(counting.machine.program.path) == 4 + 4 * 4
    link = ("-nostdlib", "-Wl,-Ttext=0x10000,-e,policy_step")
    compile_arm("-std=gnu11", "-O2", *link, "policy.c", out=tmp_path / "bare.elf")
    with pytest.raises(
        BuildError, match=r"bare\.elf does not tell the size of struct policy; compile it with -g"
    ):
        state_bytes(tmp_path / "bare.elf")


def test_observations_hold_every_extreme_when_there_are_hundreds() -> None:
    observations = mixed_observations(300, 6)
    assert observations.shape == (300, 6)
    assert observations.dtype == np.float32
    for found in (np.isnan, np.isposinf, np.isneginf, lambda x: x == 0, lambda x: abs(x) > 1e38):
        assert found(observations[2::3]).any()
        assert not found(observations[0::3]).any()
    assert np.ptp(np.log10(abs(observations[1::3]))) > 10
    np.testing.assert_array_equal(observations, mixed_observations(300, 6))


def test_policy_takes_one_route_when_observations_are_anything(kit: Kit, tmp_path: Path) -> None:
    policy = kit.compiled(kit.mlp((6, 16, 4)))
    timing = time_policy(policy, tmp_path, mixed_observations(60, 6))
    assert len(timing.cost.routes) == 1
    assert timing.multiply_accumulates == 6 * 16 + 16 * 4
    assert timing.weight_bytes == 4 * policy.plan.table.size
    assert timing.cost.instructions[0] > timing.multiply_accumulates
    assert 0 < timing.cost.stack_bytes <= 1024
    assert timing.code_bytes > 200
    assert (timing.cost.cycles is None) == (find_pricer() is None)
    if timing.cost.cycles:
        assert timing.cost.cycles[0] > timing.multiply_accumulates, "one a cycle is the limit"
    assert timing.microseconds(CORE_HZ) == 1e6
    assert timing.share(CORE_HZ / timing.control_rate_hz) == pytest.approx(1)
    assert timing.limit_ratio(2 * timing.multiply_accumulates) == 2


RNG = np.random.default_rng(11)


def values(*shape: int) -> Float32:
    return RNG.normal(size=shape).astype(np.float32)


def linear(inputs: int, outputs: int) -> op.Linear:
    return op.Linear(values(outputs, inputs), values(outputs))


HIDDEN: dict[str, list[op.Operation]] = {
    **{
        str(operation): [operation]
        for operation in (op.Tanh(), op.Sigmoid(), op.Silu(), op.Softsign(), op.Relu())
    },
    **{str(operation): [operation] for operation in (op.LeakyRelu(0.1), op.Elu(1.0), op.Clip(-0.5, None))},
    "LayerNorm": [op.LayerNorm(1e-5, values(9), values(9))],
    "Gru": [op.Gru(values(15, 9), values(15, 5), values(15), values(15)), linear(5, 9)],
    "Lstm": [op.Lstm(values(20, 9), values(20, 5), values(20)), linear(5, 9)],
}


def policy_with(hidden: list[op.Operation]) -> PolicyModel:
    """A policy of these operations on nine values."""
    network = chain(6, [linear(6, 9), *hidden, linear(9, 4), op.Clip(0.0, 1.0)])
    blocks = observation_blocks("rate_error,rate_error_delta")
    return PolicyModel(blocks, 1000, (), "nf1", "0" * 64, {}, "0" * 64, network)


@pytest.mark.parametrize("name", sampled(HIDDEN, str(op.Tanh()), str(op.Elu(1.0)), "LayerNorm", "Lstm"))
def test_no_instruction_depends_on_the_observation_when_the_operation_is_any(
    name: str, tmp_path: Path
) -> None:
    policy = compile_policy(policy_with(HIDDEN[name]))
    arm = ArmPolicy(load_program(build_policy_elf(policy.emission, tmp_path)), 6, 4)
    cost = step_cost(arm, mixed_observations(90, 6))
    assert len(cost.routes) == 1
    assert cost.worst.conditional == 0
    assert cost.no_cycles_reason is None or find_pricer() is None, "every instruction has a price"


@pytest.mark.slow
@pytest.mark.parametrize("optimization", ["-O2", "-O3"])
def test_bars_hold_on_one_route_when_observations_are_ten_thousand(
    kit: Kit, tmp_path: Path, optimization: str
) -> None:
    for widths, instructions, cycles in (((6, 32, 32, 4), 3300, 5200), ((6, 64, 64, 4), 9500, 14500)):
        policy = kit.compiled(kit.mlp(widths))
        timing = time_policy(policy, tmp_path, mixed_observations(10_000, 6), optimization=optimization)
        assert len(timing.cost.routes) == 1
        assert timing.cost.instructions[1] <= instructions
        assert timing.cost.cycles is None or timing.cost.cycles[1] <= cycles
        assert timing.code_bytes + timing.constant_bytes <= 4096
        assert timing.cost.stack_bytes <= 1024
        assert timing.state_bytes <= 2048


def test_emulated_policy_gives_the_evaluators_bits_when_its_table_is_replaced(
    kit: Kit, tmp_path: Path
) -> None:
    ours, other = kit.compiled(kit.mlp((6, 8, 4), seed=1)), kit.compiled(kit.mlp((6, 8, 4), seed=2))
    arm = ArmPolicy(load_program(build_policy_elf(ours.emission, tmp_path)), 6, 4)
    observation = kit.observations(50, 6)
    for table, policy in ((other.plan.table, other), (None, ours)):
        arm.init(table)
        expected = evaluate(policy.network, observation)
        np.testing.assert_array_equal(arm.actions(observation).view(np.uint32), expected.view(np.uint32))


def test_step_inside_the_image_is_counted_when_it_was_linked_for_the_board(
    board_image: Path, shipped_policy: Path
) -> None:
    memory = (ITCM, DTCM, Region("flash", FLASH_BASE, FLASH_BYTES))
    network = read_policy(shipped_policy).network
    policy = ArmPolicy(load_program(board_image), network.inputs, network.outputs, memory)
    cost = step_cost(policy, mixed_observations(3, network.inputs))
    assert len(cost.routes) == 1
    assert cost.instructions[0] > network.multiply_adds
    assert any(block.instructions[0].address < ITCM.size for block in cost.worst.blocks)


def test_command_prints_one_document_when_asked_for_json(shipped_policy: Path, capsys: Capture) -> None:
    assert main(["policy", "time", str(shipped_policy), "--inputs", "12", "--json", "--blocks"]) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert err == ""
    assert document["observations"] == 12
    assert document["multiply_accumulates"] == read_policy(shipped_policy).network.multiply_adds
    counted = sum(block["times"] * block["instructions"] for block in document["blocks"])
    assert counted == document["instructions"]["worst"]
    if find_pricer():
        cycles = sum(block["times"] * block["cycles"] for block in document["blocks"])
        assert cycles == pytest.approx(document["predicted_cycles"]["worst"]["cycles"])
        assert document["predicted_cycles_reason"] is None


def test_command_prints_a_table_when_a_person_asks(shipped_policy: Path, capsys: Capture) -> None:
    assert main(["timing", str(shipped_policy), "--inputs", "3", "--blocks"]) == 0
    out = capsys.readouterr().out
    for words in (
        f"{read_policy(shipped_policy).network.text} at 1000 Hz",
        "instructions",
        "stack, bytes",
        "3 observations, all on one route",
    ):
        assert words in out


def test_instructions_are_there_when_the_pricer_is_missing(
    shipped_policy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    for tool in ("gcc", "objdump", "as", "ld"):
        place = shutil.which(f"arm-none-eabi-{tool}")
        assert place is not None
        (tmp_path / f"arm-none-eabi-{tool}").symlink_to(place)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["timing", str(shipped_policy), "--inputs", "3", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["instructions"]["worst"] > 4736
    assert document["predicted_cycles"] is None
    assert document["predicted_cycles_reason"] == "llvm-mca is not installed; run: sudo apt-get install llvm"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--inputs", "0"], "--inputs 0, expected 1 to 1000000"),
        ([], "arm-none-eabi-gcc is not installed; run: sudo apt-get install gcc-arm-none-eabi"),
    ],
)
def test_command_refuses_in_one_line_when_it_cannot_count(
    shipped_policy: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
    arguments: list[str],
    words: str,
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["timing", str(shipped_policy), *arguments]) == 1
    assert capsys.readouterr().err == f"neuroflight: {words}\n"
