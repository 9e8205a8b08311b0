"""What `make` hands to the command: which policy, and which aircraft."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.cli.main import parse
from neuroflight.toolchain.boards.board_file import board_text
from neuroflight.toolchain.boards.table import find_board

ROOT = Path(__file__).resolve().parents[1]
NF1, HEXA = "training/policies/nf1/policy.onnx", "training/policies/hexa/policy.onnx"
PLAIN = (None, None, False)


def commands(*words: str) -> list[str]:
    """The commands that `make` would call, as it writes them."""
    told = subprocess.run(
        ["make", "--dry-run", "--always-make", *words], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.replace("\\\n", " ")
    return [line for line in told.splitlines() if "-m neuroflight.cli.main " in line]


def calls(*words: str) -> list[list[str]]:
    """The calls of the command that `make` would do."""
    return [[word.strip('"') for word in line.split("cli.main ", 1)[1].split()] for line in commands(*words)]


@pytest.mark.parametrize(
    ("words", "policy", "aircraft", "again"),
    [
        (["firmware"], *PLAIN),
        (["firmware", "TARGET=MATEKF722"], *PLAIN),
        (["host"], *PLAIN),
        (["test"], *PLAIN),
        (["firmware", "POLICY=my.onnx"], "my.onnx", None, False),
        (["firmware", f"POLICY={NF1}"], NF1, None, False),
        (["firmware", "AIRCRAFT=hexa"], HEXA, "hexa", False),
        (["firmware", "AIRCRAFT=dir/mine.toml"], "runs/mine-1/policy.onnx", "dir/mine.toml", False),
        (["host", "AIRCRAFT=mine.toml", "SEED=3"], "runs/mine-3/policy.onnx", "mine.toml", False),
        (["firmware", "AIRCRAFT=nf1:props-out"], "runs/nf1-props-out-1/policy.onnx", "nf1:props-out", False),
        (["emulate"], None, None, True),
        (["fly"], None, None, True),
        (["flash", "PORT=x"], None, None, True),
        (["flash", "PORT=x", "POLICY=my.onnx"], "my.onnx", None, False),
        (["fly", "AIRCRAFT=mine.toml", "POLICY=my.onnx"], "my.onnx", "mine.toml", False),
    ],
)
def test_an_image_is_built_of_what_was_said(
    words: list[str], policy: str | None, aircraft: str | None, again: bool
) -> None:
    for call in calls(*words):
        args = parse(call)
        if args.command == "image build":
            assert (args.policy and str(args.policy), args.aircraft, args.again) == (policy, aircraft, again)
        elif args.command == "fly":  # of the build's own aircraft, unless another is named
            assert args.aircraft == aircraft


def test_what_is_flashed_and_emulated_is_what_is_built_for_a_board(tmp_path: Path) -> None:
    file = tmp_path / "my board.toml"
    file.write_text(board_text(replace(find_board("MATEKF722SE"), name="MINE")))
    for target, name in (
        ("MATEKF722", "MATEKF722"),
        ("SPEEDYBEEF7MINI", "SPEEDYBEEF7MINI"),
        (str(file), "MINE"),
    ):
        (built, flashed) = commands("flash", f"TARGET={target}", "PORT=x")
        assert f'image build --target "{target}"' in built
        assert f"board flash build/{name}/neuroflight.nfi" in flashed
        assert f"--build build/{name} " in commands("emulate", f"TARGET={target}")[-1]


def test_what_is_trained_is_what_is_built() -> None:
    (train,) = calls("train", "AIRCRAFT=dir/mine.toml", "SEED=2")
    (build,) = calls("firmware", "AIRCRAFT=dir/mine.toml", "SEED=2")
    trained, built = parse(train), parse(build)
    assert built.policy == trained.out / "policy.onnx"
    assert built.aircraft == trained.aircraft


def test_what_the_build_is_told_in_words_reaches_it() -> None:
    (build,) = calls("firmware", "POLICY=my.onnx", "BUILD=--no-pid --other-aircraft")
    args = parse(build)
    assert args.no_pid and args.other_aircraft
