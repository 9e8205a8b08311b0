"""`neuroflight image build`: whose PID stands beside a policy, and what keeps another aircraft's out."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from neuroflight.cli.image import build as command
from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import FOLDER, load_aircraft
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.image.report import AircraftFacts
from neuroflight.toolchain.policy.model import read_policy
from neuroflight.toolchain.rendering.pid_table import PidTable
from tests.conftest import ROOT, build_beside

Capture = pytest.CaptureFixture[str]
NF1 = (FOLDER / "nf1.toml").read_text()
HEAVIER = NF1.replace("mass_kg = 0.194", "mass_kg = 0.254")
NO_PID = NF1[: NF1.index("[pid.")]
SHIPPED = ROOT / "training" / "policies" / "nf1" / "policy.onnx"


class Asked(NeuroflightError):  # noqa: N818 - it stops the command, and is what would be built
    """What would be built; nothing is."""

    def __init__(self, policy: Path, pid: PidTable | None, aircraft: AircraftFacts | None) -> None:
        super().__init__("asked")
        self.policy, self.pid, self.aircraft = policy, pid, aircraft


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> Callable[..., Asked]:
    """Gives a command line to `build`, and what it would build."""
    seen: list[Asked] = []

    def build(
        target: str, policy: Path, root: Path, out: Path | None, pid: Any, aircraft: Any, **_: object
    ) -> None:
        seen.append(Asked(policy, pid, aircraft))
        raise seen[-1]

    monkeypatch.setattr("neuroflight.toolchain.image.build.build", build)

    def ask(*words: str | Path) -> Asked:
        assert main(["image", "build", "--unchecked", *map(str, words)]) == 1
        capsys.readouterr()
        return seen.pop()

    return ask


@pytest.fixture
def refused(capsys: Capture, asked: object) -> Callable[..., str]:
    """Gives a command line to `build`, which refuses it before anything is built; its one line."""

    def refuse(*words: str | Path) -> str:
        assert main(["image", "build", *map(str, words)]) == 1
        told = capsys.readouterr()
        assert told.out == "" and told.err.count("\n") == 1 and "asked" not in told.err
        return told.err

    return refuse


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def trained_on(aircraft: Path | str, path: Path) -> Path:
    """The shipped policy as if it had been trained on that aircraft."""
    known = load_aircraft(aircraft)
    model = onnx.load(str(SHIPPED))
    for entry in model.metadata_props:
        if entry.key == "neuroflight.aircraft_sha256":
            entry.value = known.sha256
        elif entry.key == "neuroflight.aircraft":
            entry.value = known.name
    onnx.save(model, str(path))
    return path


def test_the_shipped_policy_gets_its_own_aircraft_unasked(asked: Callable[..., Asked]) -> None:
    got = asked()
    nf1 = load_aircraft("nf1")
    assert got.policy.resolve() == SHIPPED
    assert got.aircraft == AircraftFacts("nf1", nf1.sha256, "nf1", own=True)
    wanted = pid_table(nf1)
    assert wanted is not None and got.pid is not None
    assert got.pid.name == wanted.name and np.array_equal(got.pid.gains, wanted.gains)
    assert asked("--aircraft", "hexa").policy.parent.name == "hexa"


def test_a_copy_that_keeps_the_name_does_not_get_the_shipped_gains(
    tmp_path: Path, refused: Callable[..., str], asked: Callable[..., Asked]
) -> None:
    own = written(tmp_path / "nf1.toml", HEAVIER.replace("[pid.flying]", "[pid.mine]"))
    policy = trained_on(own, tmp_path / "policy.onnx")
    digest = load_aircraft(own).sha256
    line = refused("--policy", policy)
    assert f"trained on aircraft nf1 ({digest[:12]})" in line and "--aircraft FILE" in line
    line = refused("--policy", policy, "--aircraft", "nf1")
    assert "--other-aircraft" in line and load_aircraft("nf1").sha256[:12] in line
    got = asked("--policy", policy, "--aircraft", own)
    assert got.aircraft == AircraftFacts("nf1", digest, str(own), own=True)
    assert got.pid is not None and got.pid.name == "mine"
    other = asked("--policy", policy, "--aircraft", "nf1", "--other-aircraft").aircraft
    assert other is not None and not other.own


def test_a_retuned_pid_goes_into_the_image_of_the_policy_that_was_there_before(
    tmp_path: Path, asked: Callable[..., Asked]
) -> None:
    own = written(tmp_path / "own.toml", NF1.replace("[pid.flying]", "[pid.retuned]"))
    got = asked("--policy", SHIPPED, "--aircraft", own)
    assert got.aircraft is not None and got.aircraft.own
    assert got.pid is not None and got.pid.name == "retuned"


def test_no_image_without_a_pid_unless_it_is_asked_for_in_words(
    tmp_path: Path, refused: Callable[..., str], asked: Callable[..., Asked]
) -> None:
    own = written(tmp_path / "own.toml", NO_PID)
    line = refused("--policy", SHIPPED, "--aircraft", own)
    assert f"`neuroflight pid tune --aircraft {own} --out {own}`" in line and "--no-pid" in line
    assert asked("--policy", SHIPPED, "--aircraft", own, "--no-pid").pid is None
    heavier = trained_on(written(tmp_path / "heavier.toml", HEAVIER), tmp_path / "policy.onnx")
    got = asked("--policy", heavier, "--no-pid")
    assert got.pid is None and got.aircraft is None
    assert "--other-aircraft" in refused("--policy", heavier, "--aircraft", own, "--no-pid")


def test_propellers_out_are_another_aircraft_with_yaw_the_other_way(
    tmp_path: Path, refused: Callable[..., str], asked: Callable[..., Asked]
) -> None:
    policy = trained_on("nf1:props-out", tmp_path / "policy.onnx")
    got, usual = asked("--policy", policy), asked()
    assert got.aircraft is not None and got.aircraft.file == "nf1:props-out" and got.aircraft.own
    assert got.pid is not None and usual.pid is not None
    assert np.array_equal(got.pid.gains, usual.pid.gains)
    assert np.allclose(got.pid.mixer, usual.pid.mixer * [1.0, 1.0, -1.0])
    assert "--other-aircraft" in refused("--policy", policy, "--aircraft", "nf1")
    assert "--other-aircraft" in refused("--policy", SHIPPED, "--aircraft", "nf1:props-out")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--policy", "none.onnx", "--aircraft", "own.toml"],
            "neuroflight policy train --aircraft own.toml --out .",
        ),
        (["--again", "--policy", "none.onnx"], "--again: got a policy or an aircraft beside it"),
        (["--again", "--no-pid"], "--again: got a policy or an aircraft beside it"),
        (["--aircraft", "nf9"], "aircraft 'nf9': no such file"),
        (["--policy", "any", "--aircraft", "hexa"], "a general policy flies 4; train one of its own"),
        (["--policy", str(SHIPPED), "--aircraft", "nf9"], "aircraft 'nf9': no such file"),
        (["--policy", str(SHIPPED), "--aircraft", "hexa"], "--other-aircraft"),
    ],
)
def test_what_cannot_be_built_is_refused_in_one_line(
    words: list[str], message: str, refused: Callable[..., str]
) -> None:
    assert message in refused(*words)


def test_an_aircraft_without_a_policy_is_flown_by_the_one_for_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: Callable[..., Asked]
) -> None:
    monkeypatch.setattr("neuroflight.sim.control.any_policy.FOLDER", tmp_path)
    got, named = asked("--aircraft", "iris"), asked("--policy", "any", "--aircraft", "iris")
    assert got.policy == named.policy and got.policy.is_relative_to(tmp_path)
    assert got.aircraft is not None and got.aircraft.own and got.pid is not None
    mine = read_policy(got.policy)
    assert mine.aircraft == "iris" and not mine.general
    own = asked("--policy", "any", "--aircraft", written(tmp_path / "own.toml", HEAVIER)).policy
    assert own != got.policy
    hashes = {compile_policy(read_policy(path)).plan.architecture_hash for path in (own, got.policy)}
    assert len(hashes) == 1, "the one goes into the slot of the other's image"


@pytest.mark.slow
def test_what_was_built_last_is_built_again_and_told(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real image: its table, its report, and the next builds of the same target."""
    own = written(tmp_path / "own.toml", HEAVIER.replace('"nf1"', '"mine"'))
    policy = trained_on(own, tmp_path / "policy.onnx")
    build_beside("HOST", SHIPPED, tmp_path)
    words = ["image", "build", "--target", "HOST", "--out", str(tmp_path)]
    assert main([*words, "--policy", str(policy), "--aircraft", str(own)]) == 0
    table = " ".join(capsys.readouterr().out.split())
    digest = load_aircraft(own).sha256
    for line in (f"aircraft mine, digest {digest[:12]}", "the policy's own", "flying of aircraft mine"):
        assert line in table, line
    report = json.loads((tmp_path / "HOST" / "report.json").read_text())
    assert report["policy"]["aircraft_sha256"] == report["aircraft"]["sha256"] == digest
    assert main([*words, "--again"]) == 0
    told = capsys.readouterr()
    assert f"as HOST was built last: policy {policy}, aircraft {own}" in told.err
    assert json.loads((tmp_path / "HOST" / "report.json").read_text())["aircraft"] == report["aircraft"]
    assert main([*words, "--again", "--brief"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith(f"{tmp_path}/HOST/neuroflight: policy {policy}, UNCHECKED: ")
    assert line.endswith(", PID flying beside it")

    own.write_text(own.read_text().replace("mass_kg = 0.254", "mass_kg = 0.264"))
    assert main([*words, "--again"]) == 1  # no consent is left from before
    assert "--other-aircraft" in capsys.readouterr().err
    assert main([*words, "--policy", str(policy), "--aircraft", "nf1", "--other-aircraft", "--no-pid"]) == 0
    table = " ".join(capsys.readouterr().out.split())
    assert "NOT the one that the policy was trained on" in table
    assert "NONE: where the policy must not fly on, the motors stop" in table
    assert main(words) == 0  # of no policy: the NF1's, and it says what was there
    told = capsys.readouterr()
    assert f"no policy is named: building the shipped one of nf1, until now HOST had {policy}" in told.err
    assert command.default_policy("nf1") == SHIPPED
