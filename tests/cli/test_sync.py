"""`neuroflight aircraft sync` as a pilot types it, with logs whose truth is known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.analysis.confidence import Mean
from neuroflight.training.fitness.margin import Margin
from neuroflight.training.fitness.proof import Flown
from tests.refusal import refused
from tests.sim.identification.test_changes import NF1, flown, heavier

Capture = pytest.CaptureFixture[str]
POLICY = "training/policies/nf1/policy.onnx"


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The trace of an NF1 that carries 100 g, which stand 30 mm ahead of its origin."""
    return flown(tmp_path_factory.mktemp("flown") / "heavy.npz", heavier())


def test_a_heavier_aircraft_is_named_and_written(heavy: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "mine-2.toml"
    assert main(["aircraft", "sync", str(heavy), "--aircraft", "nf1", "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    inertia = np.diag(NF1.mass_properties.inertia) / np.diag(heavier().mass_properties.inertia)
    for axis, ratio in zip(("roll", "pitch", "yaw"), inertia, strict=True):
        one = told["changes"]["numbers"][f"authority.{axis}"]
        assert one["after"] / one["before"] == pytest.approx(ratio, rel=0.15 if axis == "yaw" else 0.05)
    causes = " ".join(told["changes"]["causes"])
    assert "turns less for the same motors about all axes" in causes and "heavier" in causes
    assert "the weight sits 6 mm further forward" in causes
    assert told["changes"]["motor_thrust"] == [1.0] * 4
    moments = np.diag(load_aircraft(out).mass_properties.inertia) / np.diag(NF1.mass_properties.inertia)
    assert moments[:2] == pytest.approx(1.0 / inertia[:2], rel=0.06)


@pytest.mark.slow
def test_a_policy_s_margin_and_what_to_do_are_told(heavy: Path, capsys: Capture) -> None:
    assert main(["aircraft", "sync", str(heavy), "--aircraft", "nf1", "--policy", POLICY]) == 0
    told = capsys.readouterr().out
    assert "heavier" in told and "policy check on the log's aircraft" in told
    assert "policy train --from training/policies/nf1 --aircraft mine-2.toml" in told


@pytest.mark.slow
def test_of_the_unchanged_aircraft_nothing_is_written(tmp_path: Path, capsys: Capture) -> None:
    log, out = flown(tmp_path / "same.npz", NF1), tmp_path / "mine-2.toml"
    assert main(["aircraft", "sync", str(log), "--aircraft", "nf1", "--out", str(out)]) == 0
    assert "nothing changed" in capsys.readouterr().out and not out.exists()


@pytest.mark.parametrize(("error", "refine"), [(1.0, False), (1.04, False), (1.06, True)])
def test_a_refinement_is_worth_it_from_a_twentieth_more_error_on(error: float, refine: bool) -> None:
    own, synced = (
        Flown(Mean(*(np.array(mae),) * 3, np.array(9)), None, 0.003, 1.0, None)  # type: ignore[arg-type]
        for mae in (1.0, error)
    )
    assert Margin(own, synced, None).refine is refine


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.npz", "--aircraft", "nf1"], "none.npz"),
        (["heavy.npz", "--aircraft", "hexa"], "4 motors, the aircraft has 6"),
        (["heavy.npz", "--aircraft", "none.toml"], "none.toml"),
        (["heavy.npz", "--aircraft", "nf1", "--out", "mine.csv"], "mine.csv"),
        (["heavy.npz", "--aircraft", "nf1", "--to", "1"], "expected at least 3"),
        (["heavy.npz", "--aircraft", "nf1", "--out", "other.toml"], "other.toml: exists; name a new file"),
    ],
)
def test_mistake_is_one_line_and_nothing_is_written(
    words: list[str], message: str, heavy: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(heavy.parent)
    Path("other.toml").write_text("of before")
    before = set(Path().iterdir())
    assert message in refused(capsys, ["aircraft", "sync", *words])
    assert set(Path().iterdir()) == before
