"""The command that a result names, as a shell takes it."""

from __future__ import annotations

import shlex
from pathlib import Path

from neuroflight.cli.output import command_line


def test_a_command_can_be_typed_when_its_words_have_spaces() -> None:
    line = command_line("evaluate", "my policy.onnx", set=["hidden=[64, 64]", "a='b'"], note="$HOME; x")
    assert shlex.split(line) == [
        *("neuroflight", "evaluate", "my policy.onnx"),
        *("--set", "hidden=[64, 64]", "a='b'", "--note", "$HOME; x"),
    ]
    assert "'$HOME; x'" in line  # nothing for the shell to expand


def test_a_command_has_options_that_say_something_and_no_folders_of_this_machine() -> None:
    policy = str(Path("/somewhere/runs/policy.onnx"))
    given = {
        "no_noise": True,
        "battery": None,
        "json": False,
        "seed": 3,
        "limit": 0.25,
        "throttle": (0.0, 1.0),
    }
    line = command_line("fly", policy, **given)
    assert line == "neuroflight fly policy.onnx --no-noise --seed 3 --limit 0.25 --throttle 0 1"
