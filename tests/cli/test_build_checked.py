"""`neuroflight image build` and the stamp of a check: an image for a board wants it, or --unchecked."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

import neuroflight.toolchain.image.build
import neuroflight.toolchain.image.report
from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.policy.check_stamp import Stamp, stamp_document, stamp_path, write_stamp
from neuroflight.toolchain.policy.model import read_policy
from tests.refusal import refused

Build = dict[str, Any]


@pytest.fixture
def policy(shipped_policy: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(shipped_policy, tmp_path / "mine.onnx"))


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> Build:
    """What the build is called with; nothing is compiled."""
    seen: Build = {}

    def build(*args: object, **words: object) -> None:
        seen.update(words)

    monkeypatch.setattr(neuroflight.toolchain.image.build, "build", build)
    monkeypatch.setattr(neuroflight.toolchain.image.report, "print_report", lambda *_: None)
    return seen


def stamped(policy: Path, aircraft: str = "nf1", **words: object) -> Path:
    facts = {"aircraft": aircraft, "aircraft_sha256": load_aircraft(aircraft).sha256, "fit": True}
    facts |= {"policy_sha256": read_policy(policy).source_sha256, "figures": {}}
    write_stamp(policy, stamp_document(**{**facts, **words}))  # type: ignore[arg-type]
    return policy


def test_an_image_is_built_of_a_policy_that_a_check_found_fit(policy: Path, built: Build) -> None:
    assert main(["image", "build", "--policy", str(stamped(policy))]) == 0
    assert isinstance(built["check"], Stamp) and built["check"].fit


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (None, "was not checked"),
        ({"fit": False}, "is NOT fit to fly nf1"),
        ({"policy_sha256": "0" * 64}, "was changed after its check"),
        ({"aircraft": "iris"}, "was checked for another aircraft or another state of its file (iris)"),
    ],
)
def test_no_image_is_built_of_another_one(
    policy: Path,
    built: Build,
    capsys: pytest.CaptureFixture[str],
    words: dict[str, Any] | None,
    said: str,
) -> None:
    if words is not None:
        stamped(policy, **words)
    error = refused(capsys, ["image", "build", "--policy", str(policy)])
    assert said in error and not built
    assert f"run: neuroflight policy check {policy} --aircraft nf1, or add --unchecked" in error
    assert main(["image", "build", "--policy", str(policy), "--unchecked"]) == 0
    assert built == {"check": None} or built["check"] is None
    assert main(["image", "build", "--policy", str(policy), "--target", "HOST"]) == 0


def test_no_image_is_built_when_policy_or_stamp_change_after_the_check(
    policy: Path, built: Build, capsys: pytest.CaptureFixture[str]
) -> None:
    stamped(policy)
    data = bytearray(policy.read_bytes())
    policy.write_bytes(data + b"\x72\x00")  # an empty field more: the same network, other bytes
    assert read_policy(policy).action_count == 4
    assert main(["image", "build", "--policy", str(policy)]) == 1
    assert "was changed after its check" in capsys.readouterr().err
    policy.write_bytes(data)
    path = stamp_path(policy)
    path.write_text(path.read_text().replace("nf1", "nf2"))
    assert main(["image", "build", "--policy", str(policy)]) == 1
    assert "it was changed after the check" in capsys.readouterr().err
    assert not built


def test_the_stamp_of_another_policy_does_not_help(
    policy: Path, built: Build, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.onnx"
    other.write_bytes(policy.read_bytes() + b"\x72\x00")
    shutil.copy(stamp_path(stamped(policy)), stamp_path(other))
    assert main(["image", "build", "--policy", str(other)]) == 1
    assert "was changed after its check" in capsys.readouterr().err and not built
