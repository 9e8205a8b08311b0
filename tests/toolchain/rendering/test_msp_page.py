"""docs/reference/msp.md says what the contract and the firmware's command line say."""

from __future__ import annotations

import re
import shlex

import pytest

from neuroflight.cli.main import parse
from neuroflight.cli.tree import COMMANDS
from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import LAYOUTS, Msp, Refusal
from neuroflight.toolchain.rendering.msp_page import commands, msp_tables
from tests.reference import FOLDER

PAGE = (FOLDER / "msp.md").read_text()
TOLD = (  # in sentences by hand
    f"versions 1 and 2, API {contract.MSP_API_MAJOR}.{contract.MSP_API_MINOR},",
    {3: "Three"}[contract.MSP_PORT_COUNT] + " peers are served at once",
    f"no motor above {100 * contract.MOTOR_TEST_MAX:g} %, the sum of all not above "
    f"{100 * contract.MOTOR_TEST_SUM_MAX:g} %;",
    f"after {contract.MOTOR_TEST_TIMEOUT_MS} ms without one they stop",
    f"nor above {contract.MSP_STREAM_RATE_MAX_HZ} Hz",
    f"where bit {contract.ARMING_FLAG_FAILSAFE} besides",
    f"bit {contract.ARMING_FLAG_SWITCH} for an arm switch",
)


def rows() -> list[list[str]]:
    """Cells of the table of messages."""
    lines = msp_tables()["messages"].splitlines()[2:]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


@pytest.mark.parametrize("words", TOLD)
def test_numbers_in_sentences_are_the_contracts(words: str) -> None:
    assert words in PAGE


def test_every_refusal_has_its_row() -> None:
    told = re.findall(r"^\| `(\w+)` \| (\d+) \|", PAGE.partition("## Refusals")[2], re.MULTILINE)
    assert told == [(reason.name.lower(), f"{reason:d}") for reason in Refusal]


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
    lines = re.findall(r"^neuroflight (board .*)$", PAGE, re.MULTILINE)
    shown = [shlex.split(re.split(r" [>#] ", line)[0]) for line in lines]
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
    assert f"| `{name}" in msp_tables()["commands"]
