"""help, version, status, tasks, faults: what the firmware is and does, as text."""

from __future__ import annotations

from neuroflight.flash.link import records
from neuroflight.toolchain.contract import ArmingReason, Msp, Task
from neuroflight.toolchain.rendering.msp_page import commands
from tests.firmware.command_line.conftest import IdleFirmware

COMMANDS = ("help", "version", "status", "tasks", "get", "set", "diff", "dump", "save", "defaults", "motor")


def test_help_lists_every_command_and_explains_one(idle: IdleFirmware) -> None:
    idle.open()
    lines = idle.tell("help")
    names = [line.split()[0] for line in lines]
    assert names == [*COMMANDS, "faults", "mixer", "exit"]
    for name, line in zip(names, lines, strict=True):
        assert " - " in line
        assert idle.tell(f"help {name}") == [line]


def test_version_says_firmware_board_and_policy(idle: IdleFirmware) -> None:
    idle.open()
    assert idle.tell("version") == ["Neuroflight 0.1.0 on HOST, MSP API 1.47, policy scripted 00112233"]


def test_status_says_state_reasons_battery_policy_and_load(idle: IdleFirmware) -> None:
    idle.open()
    idle.run(20)
    text = dict(line.split(": ", 1) if ": " in line else line.split(":", 1) for line in idle.tell("status"))
    assert text["state"].startswith("DISARMED, last stop NONE, up 1 s")
    assert text["arming forbidden by"].split() == ["CLI"]
    assert text["battery"] == "good, 16.80 V, 4 cells, 0.00 A, 0 mAh drawn"
    assert text["policy"].startswith("scripted 00112233, good, the policy flies, last fallback NONE")
    assert text["load"] == "0 % of a gyro period at most"
    assert text["gyro"].startswith("1000 Hz, GOOD, ")
    assert text["receiver"] == "good, quality 100 %"
    assert text["motors"] == "4, outputs that had stuck set up anew 0 times"
    assert text["log"] == "CARD, ABSENT, error NONE, logs 0, dropped steps 0"


def test_every_reason_is_told_by_name(idle: IdleFirmware) -> None:
    idle.open()
    firmware = idle.ffi.cast("struct firmware *", idle._memory)
    for reason in ArmingReason:
        idle.lib.firmware_forbid(firmware, reason, True)
    idle.run(20, heard=False)
    (line,) = (line for line in idle.tell("status") if line.startswith("arming"))
    flags = records.safety(idle.ask(Msp.SAFETY).payload).arming_flags
    wanted = [reason.name for reason in ArmingReason if flags >> reason & 1]
    assert line.removeprefix("arming forbidden by: ").split() == wanted
    assert len(wanted) > 12  # some are found anew at each sample


def test_tasks_are_those_of_msp(idle: IdleFirmware) -> None:
    idle.open()
    head, *rows = idle.tell("tasks")
    assert head.split()[:2] == ["task", "rate"]
    told = records.tasks(idle.ask(Msp.TASKS).payload)
    assert [row.split()[0] for row in rows] == [task.name for task in Task]
    for row, load in zip(rows[: Task.STORAGE], told.loads, strict=False):
        assert [int(cell) for cell in row.split()[1:4]] == [load.rate_hz, load.runs, load.misses]


def test_faults_are_told_and_acknowledged(idle: IdleFirmware) -> None:
    idle.open()
    assert idle.tell("faults") == ["boots: 1, no fault is pending"]
    assert idle.tell("faults ack") == ["acknowledged: faults, and a policy that was refused in flight"]


def test_nothing_that_configurators_ask_of_their_own_accord_is_an_error(idle: IdleFirmware) -> None:
    idle.open()
    said = "".join(idle.type(line) for line in ("help", "# 0.123", "dump", "get", "mixer list", "diff all"))
    assert "ERROR" not in said
    assert "saved" in idle.type("save")


def test_help_says_what_the_page_of_msp_says(idle: IdleFirmware) -> None:
    idle.open()
    page = [f"{name} {arguments}".strip() + f" - {meaning}" for name, arguments, meaning in commands()]
    assert idle.tell("help") == page
