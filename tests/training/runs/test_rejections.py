"""`policy train` rejects invalid input before it trains: one line, exit status 1, nothing written."""

from pathlib import Path

import pytest

from neuroflight.cli.main import main

Capture = pytest.CaptureFixture[str]
WEIGHTS = "[reward]\nname = 'tracking'\nchange = -1\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--set", "reward=bribe"], "reward.name: got 'bribe', expected one of: tracking, dissertation-3"),
        (["--algorithm", "magic"], "algorithm.name: got 'magic', expected one of: ppo"),
        (["--set", "world.randomization.mass=[1.2, 0.8]"], "randomization mass [1.2, 0.8], expected"),
        (["--set", "task.sigma_deg_s=2000"], "task pulse: sigma_deg_s 2000.0, expected 0 to 1000"),
        (["--set", "task=recorded", "task.file=nowhere.csv"], "recording nowhere.csv: no such file"),
        (["--set", "seeed=1"], "override 'seeed=1': seeed: unknown key; nearest: seed"),
        (["--set", "steps=many"], "steps: got 'many', expected a whole number"),
        (["--steps", "0"], "steps 0, expected 1 to 1000000000000"),
        (["--seed", "-1"], "seed -1, expected 0 to 4294967295"),
        (["--config", "nothing"], "config nothing: no such file; give the path"),
        (["--set", f"observation={','.join(['gravity'] * 22)}"], "aircraft nf1: the observation has "),
    ],
)  # fmt: skip
def test_a_bad_configuration_is_rejected_before_training_starts(
    words: list[str], message: str, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "neuroflight.training.runs.train.make_learner", lambda *_, **__: pytest.fail("it trains")
    )
    out = tmp_path / "out"
    config = [] if "--config" in words or "--algorithm" in words else ["--config", "ppo"]
    assert main(["policy", "train", "--out", str(out), *config, *words]) == 1
    seen = capsys.readouterr()
    assert message in seen.err
    assert seen.err.count("\n") == 1
    assert seen.err.startswith("neuroflight: ")
    assert seen.out == ""
    assert not out.exists()


def test_a_bad_file_is_rejected_with_its_name_and_key(tmp_path: Path, capsys: Capture) -> None:
    file, out = tmp_path / "mine.toml", tmp_path / "out"
    file.write_text(WEIGHTS)
    assert main(["policy", "train", "--out", str(out), "--config", str(file)]) == 1
    assert capsys.readouterr().err == (
        f"neuroflight: config {file}: reward: reward tracking: change -1.0, expected 0 to 1e+12\n"
    )
    assert not out.exists()
