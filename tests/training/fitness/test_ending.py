"""The end of a training that must be fit: back to the best checkpoint that is, or an error where none is."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import neuroflight.training.fitness.ending
import neuroflight.training.fitness.references
from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.toolchain.policy.check_stamp import read_stamp
from neuroflight.toolchain.policy.freeze import load_checkpoint
from neuroflight.toolchain.policy.model import read_policy
from neuroflight.training.fitness.bars import Bar, Case
from neuroflight.training.fitness.check import Verdict
from neuroflight.training.fitness.course import AXES
from tests.cli.test_train import TINY

WORDS = ["policy", "train", "--algorithm", "ppo", *TINY, "checkpoint_steps=128", "selection.fit=true"]
Capture = pytest.CaptureFixture[str]
Checked = list[str]  # SHA-256 of the policies that were checked, in their order
Judge = Callable[[set[int]], Checked]


class NoReferences:
    """Stands for references that nobody flies."""

    def __init__(self, *_: object) -> None:
        pass

    def begin(self) -> None:
        """Nothing begins."""

    def close(self) -> None:
        """Nothing ends."""


@pytest.fixture
def judge(monkeypatch: pytest.MonkeyPatch) -> Judge:
    """Find only those policies fit that are checked as the given ones, counted from 0."""

    def set_up(fit: set[int]) -> Checked:
        seen: Checked = []

        def check(policy: Path, aircraft: Aircraft, *_: object) -> Verdict:
            sha256 = hashlib.sha256(policy.read_bytes()).hexdigest()
            good = len(seen) in fit
            seen.append(sha256)
            case = Case("", 0.5 if good else 2.0, 1.0, f"swings at 65 Hz in a {AXES[1]} turn")
            return Verdict(sha256, aircraft, (), (), (Bar("swing", "of range", "a test", (case,)),), {})

        monkeypatch.setattr(neuroflight.training.fitness.ending, "check", check)
        monkeypatch.setattr(neuroflight.training.fitness.references, "References", NoReferences)
        return seen

    return set_up


def train(out: Path, *words: str) -> int:
    return main([*WORDS, "--steps", "512", "--out", str(out), *words])


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run whose check was interrupted: all that a test does is check it anew."""
    out = tmp_path_factory.mktemp("trained") / "run"
    with pytest.MonkeyPatch.context() as patch:

        def check(*_: object) -> Verdict:
            raise KeyboardInterrupt

        patch.setattr(neuroflight.training.fitness.ending, "check", check)
        patch.setattr(neuroflight.training.fitness.references, "References", NoReferences)
        assert train(out) == 130
    return out


@pytest.fixture
def run(trained: Path, tmp_path: Path) -> Path:
    """A copy of the finished run."""
    return shutil.copytree(trained, tmp_path / "run")


def by_rule(out: Path) -> list[int]:
    """Steps of the checkpoints, best first: these of a test keep no limits, so by MAE times the excesses."""
    readings = json.loads((out / "monitor.json").read_text())["readings"]
    limits = {"output": 0.12, "change": 0.012}

    def rank(reading: dict[str, Any]) -> tuple[bool, float]:
        excess = 1.0
        for name, limit in limits.items():
            excess *= max(1.0, reading[name]["mean"] / limit)
        return excess > 1.0, reading["mae"]["mean"] * excess

    return [reading["steps"] for reading in sorted(readings, key=rank)]


def chosen(out: Path) -> tuple[int, int, int]:
    """Steps of the policy as the three files tell them."""
    record, monitor = (json.loads((out / name).read_text()) for name in ("training.json", "monitor.json"))
    _, _, progress = load_checkpoint(out / "checkpoint.pt")
    return record["chosen"]["steps"], monitor["chosen_steps"], progress["chosen_steps"]


def stamp_holds(out: Path) -> bool:
    policy = out / "policy.onnx"
    stamp = read_stamp(policy)
    assert stamp is not None and stamp.policy_sha256 == read_policy(policy).source_sha256
    return stamp.fit


def test_an_interruption_of_the_check_leaves_the_run_without_a_stamp(run: Path) -> None:
    assert read_stamp(run / "policy.onnx") is None
    assert chosen(run) == (by_rule(run)[0],) * 3


def test_the_chosen_checkpoint_stays_when_it_is_fit(run: Path, judge: Judge, capsys: Capture) -> None:
    checked = judge({0})
    assert train(run, "--resume") == 0
    assert len(checked) == 1 and stamp_holds(run)
    assert chosen(run) == (by_rule(run)[0],) * 3
    assert "policy.onnx is fit to fly nf1: 1 of 1 bars met" in capsys.readouterr().out


def test_it_goes_back_to_the_best_checkpoint_that_is_fit(run: Path, judge: Judge, capsys: Capture) -> None:
    checked = judge({2})
    assert train(run, "--resume") == 0
    steps = by_rule(run)
    assert len(steps) == 4 and len(checked) == len(set(checked)) == 3
    assert chosen(run) == (steps[2],) * 3 and stamp_holds(run)
    assert read_policy(run / "policy.onnx").source_sha256 == checked[2]
    out = capsys.readouterr().out
    assert f"not fit to fly: seed 1, {steps[0]:,} steps: swings at 65 Hz" in out
    assert f"went back to: seed 1, {steps[2]:,} steps" in out
    # A finished run is checked again, the checkpoint that was left first: all of them are still there.
    again = judge({3})
    assert train(run, "--resume", "--json") == 0
    assert chosen(run) == (steps[3],) * 3
    assert again[:3] == checked
    assert json.loads(capsys.readouterr().out)["check"]["rejected"][0]["reasons"]


def test_it_ends_with_an_error_when_no_checkpoint_is_fit(run: Path, judge: Judge, capsys: Capture) -> None:
    checked = judge(set())
    assert train(run, "--resume") == 1
    assert len(checked) == 4 and not stamp_holds(run)
    assert chosen(run) == (by_rule(run)[0],) * 3
    out = capsys.readouterr().out
    assert "no checkpoint of 4 is fit to fly" in out and "is NOT fit to fly nf1" in out


def test_of_several_seeds_the_best_that_is_fit_is_kept(tmp_path: Path, judge: Judge) -> None:
    judge({5})
    assert train(tmp_path, "--seeds", "2") == 0
    record = json.loads((tmp_path / "training.json").read_text())
    best = tmp_path / f"seed-{record['seed']}"
    for name in ("policy.onnx", "checkpoint.pt", "policy.check.json"):
        assert (tmp_path / name).read_bytes() == (best / name).read_bytes()
    assert stamp_holds(tmp_path)


def test_a_recipe_that_is_not_to_be_flown_ends_well_and_says_the_command(
    tmp_path: Path, judge: Judge, capsys: Capture
) -> None:
    checked = judge(set())
    assert train(tmp_path, "--set", "selection.fit=false") == 0
    assert not checked and read_stamp(tmp_path / "policy.onnx") is None
    command = f"neuroflight policy check {tmp_path / 'policy.onnx'} --aircraft nf1"
    assert f"not checked; to fly it: {command}" in capsys.readouterr().out
