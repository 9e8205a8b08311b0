"""docs/reference/msp.md says what the contract and the firmware's command line say."""

from __future__ import annotations

import shlex

import pytest

from neuroflight.cli.main import parse
from neuroflight.cli.tree import COMMANDS
from neuroflight.toolchain.contract import LAYOUTS, Msp
from neuroflight.toolchain.rendering.msp_page import EXAMPLES, commands, msp_page


def rows() -> list[list[str]]:
    """Cells of the table of messages."""
    lines = msp_page().partition("## Messages")[2].splitlines()
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line[2:3].isdigit()]


def test_every_message_and_layout_has_a_row_when_rendered() -> None:
    found = {(row[1], row[2]) for row in rows()}
    assert {(layout.message.name, layout.direction.value) for layout in LAYOUTS} <= found
    assert {message.name for message in Msp} == {name for name, _ in found}


def test_every_row_says_what_comes_and_when_it_may_be_asked() -> None:
    asked: dict[str, str] = {}
    for _, name, direction, payload, when, refused in rows():
        assert payload
        asked[name] = asked.get(name, "") + when
        if direction == "request":
            assert when
        if when in ("disarmed", "stores"):
            assert "`payload`" in refused
    assert {name for name, when in asked.items() if not when} == {"STREAM_SAMPLE"}


def test_every_subcommand_has_an_example_that_the_parser_takes() -> None:
    shown = [shlex.split(words.partition(" > ")[0]) for words, _ in EXAMPLES]
    found = {parse([*words, "--port", "/dev/ttyUSB0"]).command for words in shown}
    bench = ("board settings", "board info", "board status", "board tasks", "board stream", "board faults")
    asked = {words for words in COMMANDS if words.startswith((*bench, "board acknowledge", "board reboot"))}
    assert found == asked | {"board calibrate"}


def test_fields_of_settings_name_what_stands_behind_them() -> None:
    told = {(row[1], row[2]): row[3] for row in rows()}
    assert "capacity:u16 [mAh] (0: not told; `battery_capacity_mah`)" in told["BATTERY_CONFIG", "reply"]
    assert "spektrum_bind:u8 = 0" in told["SET_RX_CONFIG", "request"]
    assert "kill_switch:u8 (unused)" in told["ARMING_CONFIG", "reply"]


@pytest.mark.parametrize("name", ["help", "diff", "save", "motor", "exit"])
def test_the_command_line_is_told_as_the_firmware_has_it(name: str) -> None:
    assert name in {command for command, _, _ in commands()}
    assert f"| `{name}" in msp_page()
