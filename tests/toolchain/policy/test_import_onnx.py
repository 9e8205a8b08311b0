"""freeze of another trainer's model: what it adds, what it says, what it refuses."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.estimator import model_constants
from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import POLICY_FILE_BYTES_MAX, Mix
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.policy.gyro_filters import MEAN
from neuroflight.toolchain.policy.import_onnx import PolicyClaims, import_onnx, imported_model
from neuroflight.toolchain.policy.model import parse_policy, read_policy
from neuroflight.toolchain.reader.external import embed_weights

if TYPE_CHECKING:
    from neuroflight.toolchain.ir.network import Network
    from tests.toolchain.conftest import Chain, Kit

Capture = pytest.CaptureFixture[str]
OPTIONS = ["--observation", "rate_error,rate_error_delta", "--rate", "1000", "--aircraft", "nf1"]
CLAIMS = PolicyClaims("rate_error,rate_error_delta", 1000, "[]", "nf1", "ab" * 32, 4)


def foreign(chain: Chain, edit: Callable[[onnx.GraphProto], object] = lambda graph: None) -> bytes:
    """The chain as another trainer leaves it: no metadata, other names, any batch."""
    chain.metadata.clear()
    model = chain.model()
    for value, name in ((model.graph.input[0], "obs"), (model.graph.output[0], "act")):
        for node in model.graph.node:
            for names in (node.input, node.output):
                names[:] = [name if old == value.name else old for old in names]
        value.name = name
        value.type.tensor_type.shape.dim[0].dim_param = "batch"
    edit(model.graph)
    return bytes(model.SerializeToString())


@pytest.fixture
def source(kit: Kit, tmp_path: Path) -> Path:
    """A model of another trainer without a Clip."""
    path = tmp_path / "model.onnx"
    chain = kit.mlp((6, 8, 4))
    chain.nodes.pop()
    path.write_bytes(foreign(chain))
    return path


def adopt(source: Path, out: Path, *options: str) -> None:
    """Make a policy of the model as a user does."""
    assert main(["policy", "import", str(source), *OPTIONS, *options, "--out", str(out)]) == 0


def assert_same(network: Network, kit: Kit) -> None:
    """Hold a network to that of `kit.mlp((6, 8, 4))`."""
    observation = kit.observations(20, 6)
    expected = evaluate(parse_policy(kit.mlp((6, 8, 4)).data()).network, observation)
    np.testing.assert_array_equal(evaluate(network, observation), expected)


def refused(arguments: list[str], capsys: Capture) -> str:
    """The one line of a freeze that fails."""
    assert main(["policy", "import", *arguments]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    return printed.err


def test_model_becomes_a_policy_when_frozen_with_what_it_does_not_say(
    source: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "policy.onnx"
    adopt(source, out, "--clip")
    printed = capsys.readouterr().out.splitlines()
    assert re.fullmatch(
        r"compared with onnxruntime on the model itself, 300 steps: at most \d\.\de-0\d apart",
        printed.pop(-3),
    )
    assert printed == [
        "fixed axis 0 of 'obs' to 1 (was batch)",
        "renamed the input 'obs' to 'observation'",
        "renamed the output 'act' to 'action'",
        "appended a Clip to [0, 1]",
        f"{source} -> {out}: 6-8-4 tanh, nf1, 1000 Hz, mix attitude-first, filters []",
        "idle 0; at a zero observation its outputs are 0.437 0.438 0.334 0.376: with this mix the motors "
        "turn so with the throttle closed; if outputs only turn the aircraft, use --mix centred",
    ]
    policy = read_policy(out)
    assert (policy.aircraft, policy.aircraft_sha256) == ("nf1", load_aircraft("nf1").sha256)
    assert (policy.control_rate_hz, policy.filters) == (1000, ())


def test_model_computes_the_same_when_frozen(kit: Kit) -> None:
    data, changes = imported_model(foreign(kit.mlp((6, 8, 4))), CLAIMS, clip=True)
    assert_same(parse_policy(data).network, kit)
    assert "appended a Clip to [0, 1]" not in changes


def test_metadata_are_replaced_when_the_model_has_some(kit: Kit) -> None:
    chain = kit.mlp((6, 8, 4))
    model = chain.model()
    model.metadata_props.add(key="trainer", value="another")
    data, changes = imported_model(model.SerializeToString(), CLAIMS, clip=False)
    assert not changes
    kept = {entry.key: entry.value for entry in onnx.load_from_string(data).metadata_props}
    assert (kept["trainer"], kept["neuroflight.aircraft_sha256"]) == ("another", "ab" * 32)
    assert len(kept) == 9


def test_freeze_tells_all_it_did_when_asked_for_json(source: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "policy.onnx"
    adopt(source, out, "--clip", "--json")
    document = json.loads(capsys.readouterr().out)
    assert document["policy_sha256"] == read_policy(out).source_sha256
    assert len(document["changes"]) == 5
    assert document["idle"] == read_policy(out).idle == 0.0


def test_policy_has_the_idle_that_it_is_frozen_with(source: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "policy.onnx"
    adopt(source, out, "--clip", "--idle", "0.23")
    assert read_policy(out).idle == 0.23


def test_policy_has_mix_filters_and_its_aircrafts_model_when_frozen_with_them(
    kit: Kit, tmp_path: Path, capsys: Capture
) -> None:
    source, out = tmp_path / "model.onnx", tmp_path / "policy.onnx"
    source.write_bytes(foreign(kit.mlp((6, 8, 4))))
    told = ["--observation", "rate_estimate,rate_estimate_error", "--rate", "2000", "--aircraft", "nf1"]
    told += ["--mix", "centred", "--filters", '[["mean"]]', "--out", str(out)]
    assert main(["policy", "import", str(source), *told]) == 0
    assert capsys.readouterr().out.splitlines()[-2].endswith(', 2000 Hz, mix centred, filters [["mean"]]')
    policy, model = read_policy(out), model_constants(load_aircraft("nf1"), 2000)
    assert (policy.mix, policy.gyro_filters, policy.model) == (Mix.CENTRED, MEAN, model)
    assert main(["policy", "import", str(source), *told, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["mix"], document["filters"]) == ("centred", [["mean"]])
    assert document["model"] == json.loads(json.dumps(model.document()))


def test_freeze_refuses_a_model_that_the_aircraft_has_not_at_that_rate(
    kit: Kit, tmp_path: Path, capsys: Capture
) -> None:
    source, out = tmp_path / "model.onnx", tmp_path / "policy.onnx"
    source.write_bytes(foreign(kit.mlp((6, 8, 4))))
    told = ["--observation", "rate_estimate,rate_estimate_error", "--aircraft", "nf1", "--out", str(out)]
    assert "its delay 0.002 s is 16 control steps" in refused([str(source), *told, "--rate", "8000"], capsys)
    assert "neuroflight.control_rate_hz is '0'" in refused([str(source), *told, "--rate", "0"], capsys)


@pytest.mark.parametrize(("name", "words"), [("", "is a directory"), ("file/policy.onnx", "is no directory")])
def test_freeze_refuses_at_once_when_the_output_cannot_be_written(
    source: Path, tmp_path: Path, capsys: Capture, name: str, words: str
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.onnx").mkdir()
    out = tmp_path / name if name else tmp_path / "folder.onnx"
    assert words in refused([str(source), *OPTIONS, "--clip", "--out", str(out)], capsys)


def test_freeze_names_what_it_must_be_told_when_a_model_comes_alone(
    source: Path, tmp_path: Path, capsys: Capture
) -> None:
    line = refused([str(source), "--out", str(tmp_path / "policy.onnx")], capsys)
    assert "must be told --observation, --rate, --aircraft" in line


REFUSED = {
    "takes 6 values, but its blocks rate_error make 3": {"--observation": "rate_error"},
    "unknown observation block 'altitude'": {"--observation": "altitude"},
    "neuroflight.control_rate_hz is '-5'": {"--rate": "-5"},
    "neuroflight.filters is '{}', expected a JSON list": {"--filters": "{}"},
    "--idle 0.6, expected 0 to 0.5": {"--idle": "0.6"},
    "--idle nan, expected 0 to 0.5": {"--idle": "nan"},
    "drives 4 motors, aircraft hexa has 6": {"--aircraft": "hexa"},
    "no such file": {"--aircraft": "absent"},
}


@pytest.mark.parametrize("words", REFUSED)
def test_nothing_is_written_when_a_claim_does_not_fit(
    source: Path, tmp_path: Path, capsys: Capture, words: str
) -> None:
    options = dict(zip(OPTIONS[::2], OPTIONS[1::2], strict=True)) | REFUSED[words]
    flat = [word for pair in options.items() for word in pair]
    out = tmp_path / "out" / "policy.onnx"
    assert words in refused([str(source), *flat, "--clip", "--out", str(out)], capsys)
    assert not out.parent.exists()


def test_clip_is_asked_for_when_nothing_bounds_the_motors(
    source: Path, tmp_path: Path, capsys: Capture
) -> None:
    line = refused([str(source), *OPTIONS, "--out", str(tmp_path / "policy.onnx")], capsys)
    assert "ends with Linear, expected Clip within [0, 1]" in line
    assert "--clip" in line


def ending(kit: Kit, tmp_path: Path, *last: tuple[Any, ...]) -> Path:
    """Write a model of another trainer that ends with the operators `last`."""
    path = tmp_path / "model.onnx"
    chain = kit.mlp((6, 8, 4))
    chain.nodes.pop()
    del chain.tensors[-2:]  # the Clip's bounds
    for operator, *constants in last:
        chain.add(operator, *constants)
    path.write_bytes(foreign(chain))
    return path


@pytest.mark.parametrize(
    ("last", "words"),
    [
        (
            [("Tanh",)],
            "its outputs lie in -1 to 1: if these mean 0 to full power, `neuroflight policy import --output-",
        ),
        (
            [("Clip", np.float32(-1), np.float32(1))],
            "`neuroflight policy import --output-range -1,1` maps them",
        ),
        ([("Tanh",), ("Mul", np.float32(3))], "`neuroflight policy import --output-range -3,3` maps them"),
        ([("Softsign",)], "--output-range -1,1"),
        ([], "--output-range LO,HI` (-1,1 for most trainers), or, if they are motor fractions"),
    ],
)
def test_refusal_names_the_range_and_not_the_clip_when_outputs_leave_motor_fractions(
    kit: Kit, tmp_path: Path, capsys: Capture, last: list[tuple[Any, ...]], words: str
) -> None:
    path = ending(kit, tmp_path, *last)
    line = refused([str(path), *OPTIONS, "--out", str(tmp_path / "policy.onnx")], capsys)
    assert words in line
    assert ("--clip" in line) == (not last)


@pytest.mark.parametrize(
    ("last", "asked", "low", "high"),
    [
        ([("Tanh",)], "-1,1", -1.0, 1.0),
        ([("Tanh",), ("Mul", np.float32(3))], "-3,3", -3.0, 3.0),
        ([("Mul", np.float32(4))], "-0.5,1.5", -0.5, 1.5),
        ([("Sigmoid",), ("Mul", np.float32(2000)), ("Add", np.float32(1000))], "1000,3000", 1000.0, 3000.0),
    ],
)
def test_outputs_are_mapped_when_their_range_is_told(
    kit: Kit,
    tmp_path: Path,
    capsys: Capture,
    last: list[tuple[Any, ...]],
    asked: str,
    low: float,
    high: float,
) -> None:
    path, out = ending(kit, tmp_path, *last), tmp_path / "policy.onnx"
    observation = np.random.default_rng(2).normal(size=(200, 6)).astype(np.float32)
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    theirs = np.concatenate([session.run(None, {"obs": row[None]})[0] for row in observation])
    expected = np.clip((theirs.astype(np.float64) - low) / (high - low), 0, 1)
    adopt(path, out, "--output-range", asked)
    printed = capsys.readouterr().out
    assert f"mapped outputs from {low:g} to {high:g} to motor fractions from 0 to 1" in printed
    assert "warning" not in printed
    network = read_policy(out).network
    np.testing.assert_allclose(evaluate(network, observation), expected, rtol=0, atol=1e-6)
    resting = evaluate(network, np.zeros((1, 6), np.float32))[0]
    listed = " ".join(f"{value:.3f}" for value in resting)
    assert f"idle 0; at a zero observation its outputs are {listed}" in printed
    assert ("use --mix centred" in printed) == bool(resting.min() > 0.2)


@pytest.mark.parametrize(
    ("last", "warned"),
    [
        (
            [("Tanh",)],
            "its outputs lie in -1 to 1, so the Clip holds motors at 0 or full: on observations of",
        ),
        ([("Mul", np.float32(20))], "its outputs leave 0 to 1, so the Clip holds"),
        ([], None),
    ],
)
def test_freeze_warns_when_a_clip_holds_what_the_model_means(
    kit: Kit, tmp_path: Path, capsys: Capture, last: list[tuple[Any, ...]], warned: str | None
) -> None:
    path = ending(kit, tmp_path, *last)
    adopt(path, tmp_path / "policy.onnx", "--clip")
    printed = capsys.readouterr().out
    assert ("warning" in printed) == (warned is not None)
    assert warned is None or (warned in printed and "use --output-range -1,1 instead of --clip" in printed)


@pytest.mark.parametrize(
    ("last", "asked", "words"),
    [
        ([("Tanh",)], "2,3", "100% of the outputs are below 2 and 0% above 3"),
        ([("Tanh",)], "-0.05,0.05", "of the outputs are below -0.05 and"),
        ([("Add", np.float32(1500))], "-1,1", "0% of the outputs are below -1 and 100% above 1"),
        ([("Tanh",)], "-2,2", None),
        ([("Tanh",), ("Mul", np.float32(1.0001))], "-1,1", None),
        ([], "-1,1", None),
    ],
)
def test_freeze_warns_when_outputs_lie_beyond_the_range_that_is_told(
    kit: Kit, tmp_path: Path, capsys: Capture, last: list[tuple[Any, ...]], asked: str, words: str | None
) -> None:
    path, out = ending(kit, tmp_path, *last), tmp_path / "policy.onnx"
    adopt(path, out, "--output-range", asked)
    printed = capsys.readouterr().out
    assert ("warning: the Clip holds motors at 0 or full" in printed) == (words is not None)
    assert words is None or words in printed


@pytest.mark.parametrize(
    ("last", "options", "words"),
    [
        ([("Sigmoid",)], ("--output-range", "-1,1"), "its outputs stay within 0 to 1 by themselves"),
        ([("Tanh",)], ("--output-range", "1,-1"), "expected two finite numbers, the lower one first"),
        ([("Tanh",)], ("--output-range", "-1"), "expected LO,HI, such as -1,1"),
        ([("Tanh",)], ("--output-range", "0,inf"), "expected two finite numbers"),
        ([("Tanh",)], ("--output-range", "0,1e-45"), "expected ends of at most 1e+09 that differ by"),
        ([("Tanh",)], ("--output-range", "1e30,3e38"), "expected ends of at most 1e+09"),
        ([("Tanh",)], ("--output-range", "1e8,100000001"), "differ by a thousandth of the larger one"),
        ([("Tanh",)], ("--output-range", "-1,1", "--clip"), "leave out --clip"),
    ],
)
def test_range_is_refused_when_it_does_not_fit(
    kit: Kit,
    tmp_path: Path,
    capsys: Capture,
    last: list[tuple[Any, ...]],
    options: tuple[str, ...],
    words: str,
) -> None:
    path, out = ending(kit, tmp_path, *last), tmp_path / "policy.onnx"
    assert words in refused([str(path), *OPTIONS, *options, "--out", str(out)], capsys)
    assert not out.exists()


def test_weights_are_refused_when_a_link_leads_out_of_the_folder(
    kit: Kit, tmp_path: Path, capsys: Capture
) -> None:
    folder, elsewhere = tmp_path / "model", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    model = onnx.load_from_string(kit.mlp((6, 8, 4)).data())
    onnx.save(model, folder / "model.onnx", save_as_external_data=True, location="weights", size_threshold=0)
    (folder / "weights").rename(elsewhere / "weights")
    (folder / "weights").symlink_to(elsewhere / "weights")
    out = tmp_path / "policy.onnx"
    words = "is a link out of the model's folder; put the weights themselves there"
    assert words in refused([str(folder / "model.onnx"), *OPTIONS, "--out", str(out)], capsys)
    (folder / "weights").unlink()
    (folder / "weights").symlink_to("weights")
    line = refused([str(folder / "model.onnx"), *OPTIONS, "--out", str(out)], capsys)
    assert "cannot read the weights" in line
    assert "symbolic links" in line
    (folder / "weights").unlink()
    (folder / "kept").write_bytes((elsewhere / "weights").read_bytes())
    (folder / "weights").symlink_to("kept")  # within the folder it may lead
    adopt(folder / "model.onnx", out)


def test_refusal_asks_for_the_mean_when_outputs_are_twice_the_motors(
    kit: Kit, tmp_path: Path, capsys: Capture
) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(foreign(kit.mlp((6, 8, 8))))
    line = refused([str(path), *OPTIONS, "--out", str(tmp_path / "policy.onnx")], capsys)
    assert "drives 8 motors, aircraft nf1 has 4; if half of these are standard deviations, export" in line


def test_checkpoint_is_refused_when_it_is_told_what_it_knows(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "model.onnx"  # content decides, not the name
    form = {"format": contract.CHECKPOINT_FORMAT, "version": contract.CHECKPOINT_VERSION}
    torch.save({**form, "config": "{}", "state_dict": {}}, path)
    line = refused([str(path), "--rate", "1000", "--out", str(tmp_path / "policy.onnx")], capsys)
    assert "is a checkpoint, which knows its own" in line
    assert "leave out --rate" in line


@pytest.mark.parametrize("content", [torch.nn.Linear(6, 4), torch.nn.Linear(6, 4).state_dict()])
def test_file_of_another_trainer_is_not_called_a_checkpoint_when_claims_are_made(
    tmp_path: Path, capsys: Capture, content: object
) -> None:
    torch.save(content, tmp_path / "actor.pt")
    line = refused([str(tmp_path / "actor.pt"), *OPTIONS, "--out", str(tmp_path / "policy.onnx")], capsys)
    assert "is no checkpoint" in line
    assert "if it is of another trainer, export its actor with torch.onnx.export" in line


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "it is empty"),
        (b"text", "it is text"),
        (b"\xff" * 100, "is no checkpoint and no ONNX model, or damaged"),
    ],
)
def test_file_is_refused_when_it_is_neither_checkpoint_nor_model(
    tmp_path: Path, capsys: Capture, content: bytes, words: str
) -> None:
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(content)
    line = refused([str(path), *OPTIONS, "--out", str(tmp_path / "policy.onnx")], capsys)
    assert words in line


def taken_name(graph: onnx.GraphProto) -> None:
    graph.node[0].output[0] = graph.node[1].input[0] = "action"


def fixed_batch(graph: onnx.GraphProto) -> None:
    """Fix the model's batch at 64 observations, in a Reshape inside it, too."""
    graph.input[0].type.tensor_type.shape.dim[0].dim_value = 64
    shape = onnx.numpy_helper.from_array(np.array([64, 6], np.int64), "shape")
    graph.initializer.append(shape)
    graph.node.insert(0, onnx.helper.make_node("Reshape", ["obs", "shape"], ["rows"], name="rows"))
    graph.node[1].input[0] = "rows"


def dynamic_width(graph: onnx.GraphProto) -> None:
    graph.input[0].type.tensor_type.shape.dim[1].dim_param = "n"


def two_actions(graph: onnx.GraphProto) -> None:
    graph.node.append(onnx.helper.make_node("Tanh", [graph.node[-1].output[0]], ["actions"]))
    graph.output.add().CopyFrom(graph.output[0])
    graph.output[1].name = "actions"


def two_widths(graph: onnx.GraphProto) -> None:
    dynamic_width(graph)
    graph.input.add().CopyFrom(graph.input[0])
    graph.input[1].name = "command"
    graph.node.insert(0, onnx.helper.make_node("Add", ["obs", "command"], ["sum"]))
    graph.node[1].input[0] = "sum"


def two_outputs(graph: onnx.GraphProto) -> None:
    """A critic beside the actor, with an operator that no policy may have."""
    graph.node.append(onnx.helper.make_node("Erf", [graph.node[0].output[0]], ["value"]))
    graph.output.add().CopyFrom(graph.output[0])
    graph.output[1].name = "value"


def with_data_beside(kit: Kit, folder: Path, **edits: str) -> Path:
    """A model whose weights lie in `weights.data`; `edits` replaces entries of the first one."""
    model = onnx.load_from_string(foreign(kit.mlp((6, 8, 4))))
    data = b""
    for tensor in model.graph.initializer:
        entries = {"location": "weights.data", "offset": str(len(data)), "length": str(len(tensor.raw_data))}
        data += tensor.raw_data
        tensor.ClearField("raw_data")
        tensor.data_location = onnx.TensorProto.EXTERNAL
        for key, value in entries.items():
            tensor.external_data.add(key=key, value=value)
    for entry in model.graph.initializer[0].external_data:
        entry.value = edits.get(entry.key, entry.value)
    (folder / "weights.data").write_bytes(data)
    path = folder / "model.onnx"
    path.write_bytes(model.SerializeToString())
    return path


@pytest.mark.parametrize("location", ["weights.data", "./weights.data"])
def test_weights_are_embedded_when_they_lie_beside_the_model(kit: Kit, tmp_path: Path, location: str) -> None:
    out = tmp_path / "out" / "policy.onnx"
    path = with_data_beside(kit, tmp_path, location=location)
    policy, changes = import_onnx(path, out, CLAIMS, clip=False)
    assert changes[0].startswith(f"took the weights out of '{location}'")
    assert_same(read_policy(out).network, kit)
    assert policy.source_sha256 == read_policy(out).source_sha256


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        ({"location": "../weights.data"}, "keeps weights in '../weights.data', expected a file beside it"),
        ({"location": "/etc/hostname"}, "keeps weights in '/etc/hostname', expected a file beside it"),
        ({"location": "absent.data"}, "absent.data: No such file"),
        ({"location": ""}, "keeps weights in '', expected a file beside it"),
        ({"offset": "-4"}, "is kept in bytes -4 to"),
        ({"length": "100000"}, "do model and weights belong together?"),
        ({"length": "many"}, "has no sound offset and length"),
        ({"offset": "9" * 5000}, "has no sound offset and length, expected numbers of bytes"),
        ({"length": "8"}, "raw_data size (8 bytes) is too small"),
    ],
)
def test_model_is_refused_when_its_weights_beside_it_are_not_sound(
    kit: Kit, tmp_path: Path, edits: dict[str, str], words: str
) -> None:
    source, out = with_data_beside(kit, tmp_path, **edits), tmp_path / "out" / "policy.onnx"
    with pytest.raises(PolicyError) as caught:
        import_onnx(source, out, CLAIMS, clip=False)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not out.parent.exists()


def test_critic_is_dropped_when_the_output_is_chosen(kit: Kit) -> None:
    source = foreign(kit.mlp((6, 8, 4)), two_outputs)
    data, changes = imported_model(source, CLAIMS, clip=False, output="act")
    assert changes[0] == "kept the output 'act', dropped 1 other(s) and 1 node(s)"
    assert_same(parse_policy(data).network, kit)
    with pytest.raises(PolicyError, match="no output 'motors', its outputs are 'act', 'value'"):
        imported_model(source, CLAIMS, clip=False, output="motors")


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (
            two_actions,
            "outputs are 'act' (4 values), 'actions' (4 values), expected one of 4 values, one a motor",
        ),
        (
            fixed_batch,
            "values it takes: cannot reshape array of size 6 into shape (64,6) (fixed axis 0 of 'obs' to 1 "
            "(was 64): export it for one observation, [1, n])",
        ),
        (two_widths, "the input 'obs' has the dynamic shape [batch, n], and its size cannot be told"),
    ],
)
def test_model_is_refused_when_its_ends_are_not_one_row(
    kit: Kit, edit: Callable[[onnx.GraphProto], object], words: str
) -> None:
    with pytest.raises(PolicyError) as caught:
        imported_model(foreign(kit.mlp((6, 8, 4)), edit), CLAIMS, clip=True)
    assert words in str(caught.value)


def whole_numbers(graph: onnx.GraphProto) -> None:
    graph.input[0].type.tensor_type.elem_type = onnx.TensorProto.INT64
    graph.node.insert(0, onnx.helper.make_node("Cast", ["obs"], ["floats"], to=1))
    graph.node[1].input[0] = "floats"


def test_model_is_refused_when_it_observes_whole_numbers(kit: Kit) -> None:
    with pytest.raises(PolicyError, match="the model's inputs are 'obs', expected an observation of floats"):
        imported_model(foreign(kit.mlp((6, 8, 4)), whole_numbers), CLAIMS, clip=True)


def negative_batch(graph: onnx.GraphProto) -> None:
    graph.input[0].type.tensor_type.shape.dim[0].dim_value = -1


@pytest.mark.parametrize("edit", [taken_name, dynamic_width, negative_batch])
def test_model_is_adopted_when_a_value_has_the_actions_name_or_the_width_is_open(
    kit: Kit, edit: Callable[[onnx.GraphProto], object]
) -> None:
    data, _ = imported_model(foreign(kit.mlp((6, 8, 4)), edit), CLAIMS, clip=True)
    assert_same(parse_policy(data).network, kit)


def two_parts(kit: Kit, first: int = 3) -> bytes:
    """Return a model that takes its observation as `gyro` and `command`, and joins them itself."""

    def edit(graph: onnx.GraphProto) -> None:
        graph.input.add().CopyFrom(graph.input[0])
        for value, name, width in zip(graph.input, ("gyro", "command"), (first, 6 - first), strict=True):
            value.name = name
            value.type.tensor_type.shape.dim[1].dim_value = width
        graph.node.insert(0, onnx.helper.make_node("Concat", ["gyro", "command"], ["obs"], axis=1))

    return foreign(kit.mlp((6, 8, 4)), edit)


def test_inputs_are_joined_in_the_order_told_when_there_are_two(
    kit: Kit, tmp_path: Path, capsys: Capture
) -> None:
    source, out = tmp_path / "model.onnx", tmp_path / "policy.onnx"
    source.write_bytes(two_parts(kit))
    observation = np.random.default_rng(0).normal(size=(20, 6)).astype(np.float32)
    expected = evaluate(parse_policy(kit.mlp((6, 8, 4)).data()).network, observation)
    for order, words in (
        ([], "'gyro' and 'command' (the model's, --input-order names another): 'gyro' takes {}; 'command'"),
        (["--input-order", "command,gyro"], "'command' and 'gyro' (as told): 'command' takes {}; 'gyro'"),
    ):
        adopt(source, out, *order)
        line = f"joined the inputs {words.format('rate_error')} takes rate_error_delta"
        assert line in capsys.readouterr().out.splitlines()
        given = np.roll(observation, 3, axis=1) if order else observation
        np.testing.assert_array_equal(evaluate(read_policy(out).network, given), expected)


def test_inputs_are_refused_when_their_order_is_not_theirs_or_cuts_a_term(kit: Kit) -> None:
    with pytest.raises(PolicyError) as caught:
        imported_model(two_parts(kit), CLAIMS, clip=False, input_order=["gyro", "setpoint"])
    assert str(caught.value) == (
        "--input-order names 'gyro', 'setpoint', but the observation of the model is 'gyro', 'command'; name "
        "each of these once"
    )
    with pytest.raises(PolicyError) as caught:
        imported_model(two_parts(kit, first=4), CLAIMS, clip=False)
    assert str(caught.value).startswith(
        "the input 'gyro' takes 4 values and so ends inside rate_error_delta of --observation, whose terms "
        "follow the inputs 'gyro', 'command'; name the terms in that order"
    )


def episode_starts(graph: onnx.GraphProto) -> None:
    """Add an input that only the trainer has, by which the observation is multiplied."""
    graph.input.add().CopyFrom(graph.input[0])
    graph.input[1].name = "episode_starts"
    graph.input[1].type.tensor_type.shape.dim[1].dim_value = 1
    one = onnx.numpy_helper.from_array(np.array(1, np.float32), "one_")
    graph.initializer.append(one)
    nodes = [("Sub", ["one_", "episode_starts"], "going_on"), ("Mul", ["obs", "going_on"], "kept")]
    for place, (operator, inputs, output) in enumerate(nodes):
        graph.node.insert(place, onnx.helper.make_node(operator, inputs, [output]))
    graph.node[2].input[0] = "kept"


def test_input_is_a_constant_when_it_is_told_so(kit: Kit, tmp_path: Path, capsys: Capture) -> None:
    source, out = tmp_path / "model.onnx", tmp_path / "policy.onnx"
    source.write_bytes(foreign(kit.mlp((6, 8, 4)), episode_starts))
    assert (
        "the model takes 'obs' (6 values), 'episode_starts' (1 values), together 7, but the blocks of "
        "--observation make 6 with 4 motors"
    ) in refused([str(source), *OPTIONS, "--out", str(out)], capsys)
    for text, words in (
        ("episode_starts", "--constant episode_starts, expected NAME=VALUE"),
        ("episode_starts=nan", "--constant episode_starts=nan, expected NAME=VALUE"),
        ("dones=0", "--constant: the model has no input 'dones', its inputs are 'obs', 'episode_starts'"),
    ):
        assert words in refused([str(source), *OPTIONS, "--constant", text, "--out", str(out)], capsys)
    adopt(source, out, "--constant", "episode_starts=0")
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "took 0 for the input 'episode_starts' throughout"
    assert printed[-3].startswith("compared with onnxruntime on the model itself")
    assert_same(read_policy(out).network, kit)


def test_model_is_refused_when_it_draws_random_numbers(kit: Kit) -> None:
    def noisy(graph: onnx.GraphProto) -> None:
        helper, name = onnx.helper, graph.node[-2].output[0]
        graph.node.insert(-1, helper.make_node("Exp", [name], ["spread"]))
        graph.node.insert(-1, helper.make_node("RandomNormalLike", ["spread"], ["draw"], name="draw"))
        graph.node.insert(-1, helper.make_node("Mul", ["spread", "draw"], ["noise"]))
        graph.node.insert(-1, helper.make_node("Add", [name, "noise"], ["noisy"]))
        graph.node[-1].input[0] = "noisy"

    with pytest.raises(PolicyError) as caught:
        imported_model(foreign(kit.mlp((6, 8, 4)), noisy), CLAIMS, clip=False)
    assert str(caught.value).startswith(
        "node 'draw' (RandomNormalLike) draws random numbers, expected the same"
    )


def unread_state(graph: onnx.GraphProto) -> None:
    """Add a state that nothing reads and that is put out unchanged, as Godot RL exports one."""
    graph.input.add().CopyFrom(graph.input[0])
    graph.input[1].name = "state_ins"
    del graph.input[1].type.tensor_type.shape.dim[1]
    graph.output.add().CopyFrom(graph.input[1])
    graph.output[1].name = "state_outs"
    graph.node.append(onnx.helper.make_node("Identity", ["state_ins"], ["state_outs"]))


def shape_of_a_spread(graph: onnx.GraphProto) -> None:
    """Use the shape of e^x, an operation no policy has, as Stable-Baselines3's export of SAC does."""
    helper, name = onnx.helper, graph.node[-2].output[0]
    graph.node.insert(-1, helper.make_node("Exp", [name], ["spread"], name="exp"))
    graph.node.insert(-1, helper.make_node("Shape", ["spread"], ["shape"]))
    graph.node.insert(-1, helper.make_node("Expand", [name, "shape"], ["wide"]))
    graph.node[-1].input[0] = "wide"


def foreign_branch(graph: onnx.GraphProto) -> None:
    """Add a node of an unknown operator whose output nothing reads."""
    graph.node.append(onnx.helper.make_node("Unheard", [graph.node[0].output[0]], ["lost"], domain="else"))


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (unread_state, "dropped the input 'state_ins': the action does not depend on it"),
        (shape_of_a_spread, "left out node 'exp' (Exp): nothing but a shape is read of what they compute"),
        (foreign_branch, "dropped 1 node(s) that no output needs"),
    ],
)
def test_what_the_action_does_not_need_is_dropped_and_told(
    kit: Kit, edit: Callable[[onnx.GraphProto], object], words: str
) -> None:
    data, changes = imported_model(foreign(kit.mlp((6, 8, 4)), edit), CLAIMS, clip=False)
    assert words in changes
    assert_same(parse_policy(data).network, kit)


def test_old_opset_is_refused_with_the_converters_words_when_it_cannot_be_converted(kit: Kit) -> None:
    model = onnx.load_from_string(foreign(kit.mlp((6, 8, 4))))
    model.graph.node.insert(0, onnx.helper.make_node("Upsample", ["obs", "scales"], ["wide"], mode="nearest"))
    model.graph.node[1].input[0] = "wide"
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.ones(2, np.float32), "scales"))
    model.opset_import[0].version = 9
    with pytest.raises(PolicyError) as caught:
        imported_model(model.SerializeToString(), CLAIMS, clip=False)
    assert "the model is of opset 9, which onnx.version_converter cannot convert to 13: " in str(caught.value)
    assert str(caught.value).endswith("; export it again with opset_version=13 or newer, 17 for one")
    assert "\n" not in str(caught.value)


def with_functions(calls: int, depth: int) -> bytes:
    """Return tanh(x W) written as nested functions, `depth` deep, each calling `calls` others."""
    helper = onnx.helper
    opsets = [helper.make_opsetid("", 17), helper.make_opsetid("own", 1)]
    functions = [
        helper.make_function(
            "own", "Layer0", ["x", "w"], ["y"],
            [helper.make_node("MatMul", ["x", "w"], ["m"]), helper.make_node("Tanh", ["m"], ["y"])], opsets,
        )
    ]  # fmt: skip
    for level in range(1, depth + 1):
        names = ["x", *(f"v{call}" for call in range(1, calls)), "y"]
        nodes = [
            helper.make_node(f"Layer{level - 1}", [before, "w"], [after], domain="own")
            for before, after in pairwise(names)
        ]
        functions.append(helper.make_function("own", f"Layer{level}", ["x", "w"], ["y"], nodes, opsets))
    ends = [helper.make_tensor_value_info(name, 1, ["n", width]) for name, width in (("obs", 6), ("act", 4))]
    rng = np.random.default_rng(0)
    tensors = [
        onnx.numpy_helper.from_array(rng.normal(size=shape).astype(np.float32), name)
        for name, shape in (("w", (6, 6)), ("last", (6, 4)))
    ]
    nodes = [
        helper.make_node(f"Layer{depth}", ["obs", "w"], ["hidden"], domain="own"),
        helper.make_node("MatMul", ["hidden", "last"], ["act"]),
    ]
    graph = helper.make_graph(nodes, "g", ends[:1], ends[1:], tensors)
    model = helper.make_model(graph, functions=functions, opset_imports=opsets, ir_version=8)
    return bytes(model.SerializeToString())


def test_functions_of_the_model_are_inlined_when_it_is_frozen(kit: Kit) -> None:
    source = with_functions(2, 2)
    data, changes = imported_model(source, CLAIMS, clip=True)
    assert changes[0] == "inlined the model's own functions 'Layer0', 'Layer1', 'Layer2'"
    observation = np.random.default_rng(1).normal(size=(20, 6)).astype(np.float32)
    (expected,) = onnxruntime.InferenceSession(source).run(["act"], {"obs": observation})
    network = parse_policy(data).network
    np.testing.assert_allclose(evaluate(network, observation), expected.clip(0, 1), rtol=0, atol=1e-6)


def test_functions_are_refused_when_they_inflate_or_call_themselves() -> None:
    with pytest.raises(PolicyError, match=r"make [0-9]{7,} nodes of it, expected at most 4096"):
        imported_model(with_functions(10, 6), CLAIMS, clip=True)
    model = onnx.load_from_string(with_functions(1, 1))
    model.functions[0].node[1].op_type, model.functions[0].node[1].domain = "Layer1", "own"
    with pytest.raises(PolicyError, match="own function 'Layer1' calls itself"):
        imported_model(model.SerializeToString(), CLAIMS, clip=True)


def test_freeze_never_crashes_when_bytes_are_damaged(kit: Kit) -> None:
    data = foreign(kit.mlp((6, 3, 4)))
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(300):
        damaged = bytearray(data)
        for place in rng.integers(0, len(data), 2):
            damaged[place] = rng.integers(0, 256)
        try:
            imported_model(bytes(damaged), CLAIMS, clip=True)
        except PolicyError as error:
            assert "\n" not in str(error)
            refused += 1
    assert refused > 50


def test_weights_are_refused_when_many_tensors_name_the_same_bytes(kit: Kit, tmp_path: Path) -> None:
    path = with_data_beside(kit, tmp_path)
    (tmp_path / "weights.data").write_bytes(bytes(POLICY_FILE_BYTES_MAX // 2))
    model = onnx.load(path, load_external_data=False)
    del model.graph.initializer[:]
    for number in range(4):
        tensor = model.graph.initializer.add(
            name=f"w{number}", dims=[POLICY_FILE_BYTES_MAX // 8], data_type=1
        )
        tensor.data_location = onnx.TensorProto.EXTERNAL
        tensor.external_data.add(key="location", value="weights.data")
    with pytest.raises(PolicyError, match="up to 'w2' take more than"):
        embed_weights(model, tmp_path)
    assert sum(len(tensor.raw_data) for tensor in model.graph.initializer) == POLICY_FILE_BYTES_MAX


def test_weights_are_refused_when_the_name_of_their_file_is_not_utf_8(kit: Kit, tmp_path: Path) -> None:
    path = with_data_beside(kit, tmp_path)
    path.write_bytes(path.read_bytes().replace(b"weights.data", b"\xff\xfeights.data"))
    with pytest.raises(PolicyError, match=r"keeps weights in .*, expected a file beside it"):
        import_onnx(path, tmp_path / "policy.onnx", CLAIMS, clip=False)
    assert not (tmp_path / "policy.onnx").exists()
