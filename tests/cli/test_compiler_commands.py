"""The compiler's commands: what they write and print, and one line where they refuse."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from neuroflight.cli.main import THREADS, main
from neuroflight.toolchain.policy.blob import parse
from tests.refusal import refused
from tests.sampling import sampled_rows

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def policy_file(kit: Kit, tmp_path: Path) -> Path:
    """A small policy."""
    path = tmp_path / "policy.onnx"
    path.write_bytes(kit.mlp((6, 8, 4)).data())
    return path


def test_compile_writes_all_files_when_the_policy_is_good(
    policy_file: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    assert main(["policy", "compile", str(policy_file), "--out", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert sorted(path.name for path in out.iterdir()) == ["policy.blob", "policy.c", "policy.h"]
    assert parse((out / "policy.blob").read_bytes()).weights.size == facts["weights"]
    header = (out / "policy.h").read_text()
    assert facts["weights"] >= 6 * 8 + 8 + 8 * 4 + 4
    assert re.search(rf"POLICY_WEIGHT_COUNT +{facts['weights']}$", header, re.MULTILINE)
    assert f'POLICY_SHA256 "{facts["policy_sha256"]}"' in header


def test_compile_writes_nothing_when_the_policy_is_refused(
    policy_file: Path, tmp_path: Path, capsys: Capture
) -> None:
    policy_file.write_bytes(policy_file.read_bytes()[:300])
    assert "truncated" in refused(
        capsys, ["policy", "compile", str(policy_file), "--out", str(tmp_path / "out")]
    )
    assert not (tmp_path / "out").exists()


def test_freeze_writes_nothing_when_the_checkpoint_is_none(
    policy_file: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "frozen.onnx"
    policy_file.write_bytes(b"no checkpoint")
    assert "is no ONNX model: it is text" in refused(
        capsys, ["policy", "import", str(policy_file), "--out", str(out)]
    )
    assert not out.exists()


def test_build_names_the_known_targets_when_the_target_is_unknown(policy_file: Path, capsys: Capture) -> None:
    line = refused(capsys, ["image", "build", "--target", "KAKUTE", "--policy", str(policy_file)])
    assert line.startswith("neuroflight: unknown board 'KAKUTE', did you mean KAKUTEF7MINIV3?")


def test_build_prints_its_report_when_it_succeeds(
    shipped_policy: Path, host_program: Path, capsys: Capture
) -> None:
    out = host_program.parents[1]
    arguments = ["image", "build", "--target", "HOST", "--policy", str(shipped_policy), "--out", str(out)]
    assert main([*arguments, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report == json.loads((host_program.parent / "report.json").read_text())
    assert main(arguments) == 0
    table = capsys.readouterr().out
    for word in ("synthesis", "optimization", "compilation", "network", "nothing changed"):
        assert word in table


@pytest.mark.parametrize("command", ["build", "compile", "freeze"])
def test_help_is_shown_when_asked_for(command: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    assert "usage: neuroflight" in capsys.readouterr().out


def test_ends_quietly_when_its_reader_goes_away() -> None:
    program = [sys.executable, "-m", "neuroflight.cli.main", "aircraft", "check", "nf1", "--json"]
    process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    words = process.stderr.read()
    process.stderr.close()
    assert process.wait() == 1
    assert words == ""


@pytest.mark.parametrize(("given", "expected"), sampled_rows([(None, "1"), ("2", "2")], (None, "1")))
def test_small_matrices_stay_on_one_thread_unless_the_user_says_otherwise(
    given: str | None, expected: str
) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in THREADS}
    if given is not None:
        environment["OPENBLAS_NUM_THREADS"] = given
    asks = (
        "import sys, os, neuroflight.cli.main as cli; assert 'numpy' not in sys.modules; "
        "cli.main(['aircraft', 'check', 'nf1', '--json']); "
        "print(os.environ['OPENBLAS_NUM_THREADS'], file=sys.stderr)"
    )
    program = [sys.executable, "-c", asks]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr.splitlines()[-1] == expected
