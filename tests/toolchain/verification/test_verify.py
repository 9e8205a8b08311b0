"""`neuroflight policy verify`: it holds for a sound policy, and each planted fault is caught by its name."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import onnx
import pytest
import torch

from neuroflight.cli.main import main
from neuroflight.toolchain.codegen.compiler import CompiledPolicy
from neuroflight.toolchain.codegen.emit import literal
from neuroflight.toolchain.contract import CHECKPOINT_FORMAT, CHECKPOINT_VERSION
from neuroflight.toolchain.ir.interpreter import State, advance
from neuroflight.toolchain.ir.network import Network, chain
from neuroflight.toolchain.ir.onnx_export import to_model
from neuroflight.toolchain.ir.operations import Clip, Gru, Linear
from neuroflight.toolchain.policy.freeze import freeze
from neuroflight.toolchain.verification.inputs import Inputs, make_inputs
from neuroflight.toolchain.verification.machines import Machine, open_evaluator
from neuroflight.toolchain.verification.tolerance import standard
from neuroflight.toolchain.verification.verify import Candidate, Finding, Verification, all_candidates, verify

if TYPE_CHECKING:
    from tests.toolchain.conftest import Chain, Float32, Kit

SIZES = (6, 8, 5, 4)
COUNT, STEPS = 40, 20


@pytest.fixture(scope="module")
def policy(kit: Kit) -> Chain:
    return kit.mlp(SIZES)


@pytest.fixture(scope="module")
def compiled(kit: Kit, policy: Chain) -> CompiledPolicy:
    return kit.compiled(policy)


def seen_on(
    names: Iterable[str],
    compiled: CompiledPolicy,
    data: bytes,
    directory: Path,
    checkpoint: Path | None = None,
) -> Verification:
    """What the machines called `names` see of a policy."""
    candidates = [c for c in all_candidates(compiled, data, directory, checkpoint) if c.name in names]
    assert len(candidates) == len(list(names))
    return verify(compiled, candidates, make_inputs(compiled.policy.observation_count, COUNT, 0, STEPS))


def finding(seen: Verification) -> Finding:
    assert seen.verdict == "fails"
    assert seen.finding is not None
    return seen.finding


def with_source(compiled: CompiledPolicy, change: Callable[[str], str]) -> CompiledPolicy:
    source = change(compiled.emission.source)
    assert source != compiled.emission.source
    return replace(compiled, emission=replace(compiled.emission, source=source))


def with_last_words(compiled: CompiledPolicy, words: str) -> CompiledPolicy:
    """policy.c whose policy_step does its work and then what `words` say."""
    wrapper = f"""
void policy_step(struct policy *p, const float observation[POLICY_OBSERVATION_COUNT],
                 float action[POLICY_ACTION_COUNT])
{{
    sound_step(p, observation, action);
    {words}
}}
"""
    return with_source(
        compiled, lambda source: source.replace("void policy_step(", "static void sound_step(") + wrapper
    )


def test_everything_holds_when_the_policy_is_sound(
    compiled: CompiledPolicy, policy: Chain, tmp_path: Path
) -> None:
    names = ("onnxruntime", "evaluator", "host C, gcc", "host C, sanitized", "Cortex-M7, emulated")
    seen = seen_on(names, compiled, policy.data(), tmp_path)
    assert seen.finding is None
    assert seen.verdict == "holds"
    assert [machine.name for machine in seen.machines] == list(names)
    for machine in seen.machines:
        assert [group.inputs for group in machine.figures] == [
            group.name for group in make_inputs(6, COUNT, 0, STEPS)
        ]
        unit = machine.figures[0]
        assert unit.compared == unit.count == COUNT
        assert unit.error is not None
        assert 0 < unit.error < 1e-6


def test_bits_differ_when_one_coefficient_of_the_c_is_another(
    compiled: CompiledPolicy, policy: Chain, tmp_path: Path
) -> None:
    weights = compiled.plan.table[compiled.plan.table != 0]
    weight, next_to_it = literal(weights[-1]), literal(np.nextafter(weights[-1], np.float32(9)))

    def change(source: str) -> str:
        head, table = source.split(".weights = {")
        return f"{head}.weights = {{{table.replace(weight, next_to_it, 1)}"

    planted = with_source(compiled, change)
    for name in ("host C, gcc", "Cortex-M7, emulated"):
        found = finding(seen_on(("evaluator", name), planted, policy.data(), tmp_path / name[:4]))
        assert found.machine == name
        assert found.law == "bits"
        assert found.got != found.expected


def test_bits_differ_when_the_evaluator_adds_in_another_order(
    compiled: CompiledPolicy, policy: Chain, tmp_path: Path
) -> None:
    operations = [node.operation for node in compiled.network.nodes]
    first = next(op for op in operations if isinstance(op, Linear))
    reversed_first = Linear(np.ascontiguousarray(first.weight[:, ::-1]), first.bias)
    backwards = chain(6, [reversed_first, *operations[operations.index(first) + 1 :]])
    evaluator = open_evaluator(backwards)

    def other_order() -> Machine:
        return replace(evaluator, actions=lambda x: evaluator.actions(np.ascontiguousarray(x[..., ::-1])))

    host = [c for c in all_candidates(compiled, policy.data(), tmp_path, None) if c.name == "host C, gcc"]
    seen = verify(
        compiled, [Candidate("evaluator", True, other_order), *host], make_inputs(6, COUNT, 0, STEPS)
    )
    found = finding(seen)
    assert (found.machine, found.law) == ("host C, gcc", "bits")
    assert "has not the evaluator's bits" in found.message


def test_onnxruntime_is_named_when_the_file_has_other_weights(
    kit: Kit, compiled: CompiledPolicy, tmp_path: Path
) -> None:
    found = finding(seen_on(("onnxruntime",), compiled, kit.mlp(SIZES, seed=1).data(), tmp_path))
    assert (found.machine, found.law, found.inputs) == ("onnxruntime", "error", "unit")
    assert found.index is not None
    assert len(found.observation) == 6


def test_evaluator_is_named_when_its_actions_are_off_by_3e_6(compiled: CompiledPolicy) -> None:
    evaluator = open_evaluator(compiled.network)
    off = replace(evaluator, actions=lambda x: np.maximum(evaluator.actions(x) - np.float32(3e-6), 0))
    seen = verify(compiled, [Candidate("evaluator", True, lambda: off)], make_inputs(6, COUNT, 0, STEPS)[:1])
    assert (finding(seen).machine, finding(seen).law) == ("evaluator", "error")


def test_evaluator_is_named_when_a_pass_has_changed_the_network(
    kit: Kit, compiled: CompiledPolicy, policy: Chain, tmp_path: Path
) -> None:
    planted = replace(compiled, network=kit.compiled(kit.mlp(SIZES, seed=1)).network)
    found = finding(seen_on(("onnxruntime", "evaluator"), planted, policy.data(), tmp_path))
    assert (found.machine, found.law) == ("evaluator", "error")


@pytest.mark.parametrize(
    "beyond", ["observation[POLICY_OBSERVATION_COUNT]", "p->weights[POLICY_WEIGHT_COUNT]"]
)
def test_sanitizer_is_named_when_the_c_reads_beyond_an_array(
    compiled: CompiledPolicy, policy: Chain, tmp_path: Path, beyond: str
) -> None:
    planted = with_last_words(compiled, f"volatile float beyond = {beyond}; (void)beyond;")
    found = finding(
        seen_on(("evaluator", "host C, gcc", "host C, sanitized"), planted, policy.data(), tmp_path)
    )
    assert (found.machine, found.law) == ("host C, sanitized", "sanitizer")
    assert "heap-buffer-overflow" in found.message
    assert "\n" not in found.message


def test_sanitizer_is_named_when_the_c_overflows_an_int(
    compiled: CompiledPolicy, policy: Chain, tmp_path: Path
) -> None:
    planted = with_last_words(
        compiled, "volatile int most = 0x7FFFFFFF; most = most + (observation[0] < 2e9f);"
    )
    found = finding(seen_on(("host C, sanitized",), planted, policy.data(), tmp_path))
    assert (found.machine, found.law) == ("host C, sanitized", "sanitizer")
    assert "signed integer overflow" in found.message


@pytest.mark.parametrize(
    ("words", "law"),
    [
        ('if (observation[5] == 0x1p-149f) action[3] = __builtin_nanf("");', "bits"),
        ("if (observation[2] != observation[2]) action[1] = 0.5f;", "door"),
        ("if (observation[2] > 3e38f) action[1] = 1.5f;", "bounds"),
        ("if (observation[5] == 0x1p-149f) action[3] = 0.5f * action[3] + 0x1p-2f;", "bits"),
        ("static int steps; if (steps++ == 300) action[0] = action[1];", "bits"),
    ],
    ids=["nan from a number", "nan moves a motor", "huge leaks", "rare bits", "an early step tells"],
)
def test_law_is_named_when_the_c_breaks_it(
    compiled: CompiledPolicy, policy: Chain, tmp_path: Path, words: str, law: str
) -> None:
    planted = with_last_words(compiled, words)
    found = finding(seen_on(("evaluator", "host C, gcc"), planted, policy.data(), tmp_path))
    assert (found.machine, found.law) == ("host C, gcc", law)


def test_c_that_does_not_compile_or_return_is_one_line(
    compiled: CompiledPolicy, policy: Chain, tmp_path: Path
) -> None:
    planted = with_last_words(compiled, "p->nothing = 0;")
    found = finding(seen_on(("host C, gcc",), planted, policy.data(), tmp_path / "a"))
    assert (found.machine, found.law) == ("host C, gcc", "runs")
    assert "nothing" in found.message
    planted = with_last_words(compiled, "if (observation[0] > 10.0f) __builtin_trap();")
    for name in ("host C, gcc", "Cortex-M7, emulated"):
        found = finding(seen_on((name,), planted, policy.data(), tmp_path / name[:4]))
        assert (found.machine, found.law) == (name, "runs")
        assert "\n" not in found.message


@pytest.fixture(scope="module")
def remembering(kit: Kit) -> bytes:
    """A policy with a GRU, as a file."""
    rng = np.random.default_rng(3)
    cell = Gru(*(kit.weights(rng, *shape) for shape in ((15, 6), (15, 5), (15,), (15,))))
    model = to_model(chain(6, [cell, Linear(kit.weights(rng, 4, 5), kit.weights(rng, 4)), Clip(0.0, 1.0)]))
    onnx.helper.set_model_props(model, kit.chain().metadata)
    return bytes(model.SerializeToString())


def test_recurrent_policy_recovers_when_its_path_had_faults(
    kit: Kit, remembering: bytes, tmp_path: Path
) -> None:
    compiled = kit.compiled(remembering)
    names = ("onnxruntime", "evaluator", "host C, gcc")
    candidates = [c for c in all_candidates(compiled, remembering, tmp_path, None) if c.name in names]
    seen = verify(compiled, candidates, make_inputs(6, COUNT, 0, 100)[-2:])
    assert seen.finding is None
    assert seen.recovery is not None
    assert seen.recovery < 1e-3


def test_bits_differ_when_policy_init_leaves_the_state(kit: Kit, remembering: bytes, tmp_path: Path) -> None:
    forgetful = "\nvoid policy_init(struct policy *p, const float *weights)\n"
    forgetful += "{ static int ready; if (!ready++) sound_init(p, weights); }\n"
    planted = with_source(
        kit.compiled(remembering),
        lambda source: source.replace("void policy_init(", "static void sound_init(") + forgetful,
    )
    found = finding(seen_on(("evaluator", "host C, gcc"), planted, remembering, tmp_path))
    assert (found.machine, found.law, found.step) == ("host C, gcc", "bits", 0)


def test_state_is_named_when_it_does_not_stay_finite(
    kit: Kit, remembering: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = kit.compiled(remembering)

    def leaking(network: Network, x: Float32, state: State) -> tuple[Float32, State]:
        actions, after = advance(network, x, state)
        return actions, (np.where(np.isfinite(x[:, :1]), after[0], np.nan),)

    monkeypatch.setattr("neuroflight.toolchain.verification.machines.advance", leaking)
    found = finding(seen_on(("evaluator",), compiled, remembering, tmp_path))
    assert (found.machine, found.law) == ("evaluator", "state")


def checkpoint(path: Path, seed: int = 0, *, squash: bool = False, recurrent: bool = False) -> Path:
    """A small network as training leaves it, in `path`, with the policy frozen from it beside."""
    generator = torch.Generator().manual_seed(seed)
    shapes = {
        "mlp_extractor.policy_net.0": (8, 6),
        "mlp_extractor.policy_net.2": (5, 8),
        "action_net": (4, 5),
    }
    state = {}
    for name, (outputs, inputs) in shapes.items():
        state[f"{name}.weight"] = torch.randn(outputs, inputs, generator=generator) / inputs**0.5
        state[f"{name}.bias"] = 0.1 * torch.randn(outputs, generator=generator)
    if recurrent:
        names: dict[str, tuple[int, ...]] = {
            "recurrent.weight_ih_l0": (24, 6),
            "recurrent.weight_hh_l0": (24, 8),
        }
        names |= {"recurrent.bias_ih_l0": (24,), "recurrent.bias_hh_l0": (24,)}
        state = {name: 0.5 * torch.randn(shape, generator=generator) for name, shape in names.items()} | {
            "mlp_extractor.policy_net.0.weight": state["mlp_extractor.policy_net.2.weight"],
            "mlp_extractor.policy_net.0.bias": state["mlp_extractor.policy_net.2.bias"],
            **{name: value for name, value in state.items() if name.startswith("action_net")},
        }
    config = {
        "aircraft": {"name": "nf1", "sha256": "0" * 64},
        "observation": "rate_error,rate_error_delta",
        "observation_scale": [0.3] * 3 + [2.0] * 3,
        "control_rate_hz": 1000,
        "filters": [],
        "hidden": [8, 5],
        "recurrent": "gru" if recurrent else "none",
        "activation": "tanh",
        "output": {"scale": 0.5, "offset": 0.5, "squash": squash},
        "motors": 4,
    }
    content = {"format": CHECKPOINT_FORMAT, "version": CHECKPOINT_VERSION, "config": json.dumps(config)}
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({**content, "state_dict": state, "progress": {}}, path)
    freeze(path, path.with_name("policy.onnx"))
    return path


@pytest.mark.parametrize("kind", [{}, {"squash": True}, {"recurrent": True}], ids=["plain", "squash", "gru"])
def test_torch_agrees_when_the_policy_was_frozen_from_the_checkpoint(
    kit: Kit, tmp_path: Path, kind: dict[str, bool]
) -> None:
    own = checkpoint(tmp_path / "a" / "checkpoint.pt", **kind)
    other = checkpoint(tmp_path / "b" / "checkpoint.pt", 1, **kind)
    data = own.with_name("policy.onnx").read_bytes()
    compiled = kit.compiled(data)
    assert seen_on(("torch", "evaluator"), compiled, data, tmp_path, own).verdict == "holds"
    found = finding(seen_on(("torch", "evaluator"), compiled, data, tmp_path, other))
    assert (found.machine, found.law) == ("torch", "error")


def test_command_leaves_torch_out_when_asked_although_a_checkpoint_lies_beside(
    policy: Chain, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda _name: None)  # no compiler is needed for it
    path = checkpoint(tmp_path / "checkpoint.pt").with_name("policy.onnx")
    path.write_bytes(policy.data())
    command = ["policy", "verify", str(path), "--count", "5", "--allow-missing"]
    assert main(command) == 1
    assert "is the checkpoint the one it was frozen from?" in capsys.readouterr().err
    assert main([*command, "--no-torch"]) == 0


def test_command_refuses_a_checkpoint_whose_network_does_not_fit(
    kit: Kit, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = checkpoint(tmp_path / "checkpoint.pt").with_name("policy.onnx")
    three = kit.mlp((3, 8, 4))
    three.metadata["neuroflight.observation"] = "rate_error"
    path.write_bytes(three.data())
    assert main(["policy", "verify", str(path), "--count", "5"]) == 1
    assert "its network does not take 3 values" in capsys.readouterr().err


def test_verdict_is_incomplete_when_a_required_tool_is_missing(
    compiled: CompiledPolicy, policy: Chain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    which = shutil.which
    gone = ("gcc", "clang", "arm-none-eabi-gcc")
    monkeypatch.setattr(shutil, "which", lambda name: None if name in gone else which(name))
    seen = verify(compiled, all_candidates(compiled, policy.data(), tmp_path, None), make_inputs(6, 5, 0, 5))
    assert seen.verdict == "incomplete"
    assert [m.name for m in seen.missing] == ["host C, gcc", "host C, sanitized", "Cortex-M7, emulated"]
    reasons = {machine.name: machine.not_run for machine in seen.machines if machine.not_run}
    assert "gcc is not installed" in reasons["host C, gcc"]
    assert "arm-none-eabi-gcc is not installed" in reasons["Cortex-M7, emulated"]
    assert "clang is not installed" in reasons["host C, clang"]
    assert "--checkpoint" in reasons["torch"]


@pytest.fixture
def file(policy: Chain, tmp_path: Path) -> Path:
    """The policy as a file."""
    path = tmp_path / "policy.onnx"
    path.write_bytes(policy.data())
    return path


def test_command_prints_one_document_when_json_is_asked_for(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["policy", "verify", str(file), "--count", "20", "--json"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert document["verdict"] == "holds"
    assert document["first_failure"] is None
    verdicts = {machine["name"]: machine["verdict"] for machine in document["machines"]}
    assert verdicts["Cortex-M7, emulated"] == "holds"
    assert verdicts["torch"] == "not run"


def test_command_exits_1_with_one_line_when_something_fails(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    other = checkpoint(tmp_path / "other" / "checkpoint.pt")
    assert main(["policy", "verify", str(file), "--count", "20", "--json", "--checkpoint", str(other)]) == 1
    told = capsys.readouterr()
    failure = json.loads(told.out)["first_failure"]
    assert failure["machine"] == "torch"
    assert len(failure["observation"]) == 6
    assert told.err.count("\n") == 1
    assert "torch is further from the float64 reference than allowed" in told.err


def test_command_exits_0_on_a_missing_tool_only_when_that_is_allowed(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    assert main(["policy", "verify", str(file), "--count", "5"]) == 1
    told = capsys.readouterr()
    assert told.err.count("\n") == 1
    assert "incomplete: host C, gcc not run: gcc is not installed" in told.err
    assert "Incomplete" in told.out
    assert main(["policy", "verify", str(file), "--count", "5", "--allow-missing"]) == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--count", "0"], "--count 0, expected 1 to"),
        (["--seed", "-1"], "--seed -1, expected 0 or more"),
        (["--checkpoint", "nowhere.pt"], "cannot read the checkpoint nowhere.pt"),
    ],
)
def test_command_refuses_in_one_line_when_an_option_is_wrong(
    file: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert main(["policy", "verify", str(file), "--count", "5", *arguments]) == 1
    told = capsys.readouterr()
    assert words in told.err
    assert told.err.count("\n") == 1


def by_name(inputs: Iterable[Inputs]) -> dict[str, Inputs]:
    return {group.name: group for group in inputs}


def test_inputs_repeat_when_the_seed_does() -> None:
    first, again, other = (make_inputs(6, 300, seed, STEPS) for seed in (4, 4, 5))
    for a, b, c in zip(first, again, other, strict=True):
        assert a.observation.tobytes() == b.observation.tobytes()
        assert a.name in ("grid", c.name)
        assert a.name == "grid" or a.observation.tobytes() != c.observation.tobytes()


@pytest.mark.parametrize("width", [1, 2, 6, 40])
def test_adversarial_inputs_hold_each_odd_number_in_each_place_alone(width: int) -> None:
    words = by_name(make_inputs(width, 100, 0, STEPS))["adversarial"].observation[:, 0].view(np.uint32)
    for odd in (
        0x7FC00000,
        0x7FC12345,
        0x7F800001,
        0xFF800001,
        0x7F800000,
        0xFF800000,
        0x80000000,
        1,
        0x7F7FFFFF,
    ):
        rows = words[(words == odd).sum(axis=1) == 1]
        others_finite = np.isfinite(np.where(rows == odd, 0, rows).view(np.float32)).all(axis=1)
        assert (rows[others_finite] == odd).any(axis=0).all(), hex(odd)
        assert (words == odd).all(axis=1).any(), hex(odd)


def test_grid_crosses_every_pair_of_axes_when_count_allows() -> None:
    grid = by_name(make_inputs(6, 2000, 0, STEPS))["grid"].observation[:, 0]
    assert np.abs(grid).max() == np.float32(35)
    used = {tuple(np.flatnonzero(row)) for row in grid}
    assert {(axis,) for axis in range(6)} <= used
    assert {(a, b) for a in range(6) for b in range(a + 1, 6)} <= used


def test_more_is_allowed_only_when_rounding_must_do_more() -> None:
    rng = np.random.default_rng(0)
    inputs = Inputs("nearly equal", (1 + 1e-3 * rng.normal(size=(50, 1, 6))).astype(np.float32))

    def allowed(gain: float) -> float:
        """For a sum whose terms are as large as `gain` and nearly cancel."""
        weight = np.tile(np.array([gain, -gain] * 3, np.float32), (4, 1))
        network = chain(6, [Linear(weight, np.full(4, 0.5, np.float32)), Clip(0.0, 1.0)])
        return float(np.median(standard(network, inputs, rng).allowed))

    assert allowed(0.01) == 1e-6
    assert 1e-6 < allowed(1.0) < 1e-5
    assert 1e-4 < allowed(100.0) < 1e-3


def test_huge_and_not_finite_observations_are_not_compared_from_their_step_on() -> None:
    path = np.zeros((3, 5, 6), np.float32)
    path[1, 2, 3], path[2, 3, 0] = 1e10, np.nan
    network = chain(6, [Linear(np.ones((4, 6), np.float32), np.zeros(4, np.float32)), Clip(0.0, 1.0)])
    comparable = standard(network, Inputs("paths", path), np.random.default_rng(0)).comparable
    assert comparable.tolist() == [
        [True] * 5,
        [True, True, False, False, False],
        [True, True, True, False, False],
    ]
