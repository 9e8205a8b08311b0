"""docs/guides/motors-and-channels.md prints commands and scripts that are."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from neuroflight.cli.main import parse
from neuroflight.flash.channels.script import check_script, parse_script
from tests.flash.channels.test_layout import layout

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "guides" / "motors-and-channels.md").read_text()
COMMANDS = re.findall(r"^neuroflight (.+)$", PAGE, re.MULTILINE)


@pytest.mark.parametrize("line", COMMANDS)
def test_a_printed_command_is_understood(line: str) -> None:
    args = parse(shlex.split(line, comments=True))
    # What speaks to an aircraft names its port; what works on files has none.
    assert getattr(args, "port", None) == ("PORT" if "PORT" in line.split() else None)


def test_all_commands_but_those_about_files_name_their_port() -> None:
    assert all("PORT" in line.split() for line in COMMANDS if not line.startswith(("log ", "fly ")))


def test_all_commands_are_printed() -> None:
    assert len(COMMANDS) >= 15
    for word in (
        "motors test",
        "motors spin",
        "motors direction",
        "motors order",
        "motors stop",
        "rc --script",
    ):
        assert any(line.startswith(f"board {word}") for line in COMMANDS)


@pytest.mark.parametrize("suffix", ["csv", "toml"])
def test_a_printed_script_is_read(suffix: str) -> None:
    (text,) = re.findall(rf"```{suffix}\n(.+?)```", PAGE, re.DOTALL)
    script = parse_script(text.encode(), "docs/guides/motors-and-channels.md", f".{suffix}")
    check_script(script, layout(), may_arm=True)
    assert any(layout().arms(row) for row in script.rows)
