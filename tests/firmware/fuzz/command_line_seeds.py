"""Inputs of the command line's target: every command as a pilot types it, pastes it, and gets it wrong."""

from __future__ import annotations

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import SETTINGS, Msp
from tests.firmware.fuzz.msp_seeds import (
    BOOTING,
    FLYING,
    OTHER,
    READY,
    READY_MSP,
    Step,
    ask,
    pilot,
    raw,
    wait,
)

OPENS, ENDS, FRAME, FRAME_END = b"#", b"\r\n", b"\x02", b"\x03"
LISTEN = bytes([Step.LISTEN])
# As firmware/src/command_line/commands.c has them; the fuzzer finds what is missing.
COMMANDS = (
    *("help", "help get", "help nothing", "version", "status", "tasks", "get", "get rate", "get nothing"),
    *("set", "set gyro_rate_hz", "set gyro_rate_hz = 2000", "set gyro_rate_hz = 2001", "set nothing = 1"),
    *("set failsafe_delay_ms=700", "set failsafe_throttle = 0.25", "set failsafe_throttle = nan"),
    *("set craft_name = A B", "set craft_name = ", "set receiver_protocol = crsf", "set map_roll = 9"),
    *(
        "diff",
        "diff all",
        "dump",
        "save",
        "save force",
        "defaults",
        "motor",
        "motor test on",
        "motor test off",
    ),
    *("motor 1 1200 2", "motor 9 1200 2", "motor 1 2000 2", "motor 1 1200 60", "faults", "faults ack"),
    *("mixer", "mixer list", "exit", "unknown", "", "   status", "STATUS", "# a comment"),
)


def typed(*lines: str, bits: int = 0) -> bytes:
    """Lines of an open session, and what it says to them."""
    return b"".join(raw(line.encode() + b"\n", bits) + bytes([Step.LISTEN | bits]) * 3 for line in lines)


def session(*lines: str, bits: int = 0) -> bytes:
    """A session with these lines."""
    return raw(OPENS, bits) + bytes([Step.LISTEN | bits]) + typed(*lines, bits=bits)


def framed(line: str) -> bytes:
    """A line as newer versions of the app send it."""
    return raw(FRAME + line.encode() + b"\n" + FRAME_END) + LISTEN * 4


def command_line_seeds() -> dict[str, bytes]:
    """All of them, by name."""
    ready, flying = bytes([READY]), bytes([FLYING])
    seeds = {}
    for number, line in enumerate(COMMANDS):
        name = "".join(c if c.isalnum() else "_" for c in line) or "empty"
        seeds[f"typed_{number:02}_{name}"] = ready + session(line) + wait(20) + LISTEN
        if number % 3 == 0:
            seeds[f"framed_{number:02}_{name}"] = ready + framed(line) + wait(20)
    kinds = {setting.kind: setting for setting in SETTINGS}
    for kind, setting in kinds.items():
        lines = [f"get {setting.name}", f"set {setting.name} = 1", f"set {setting.name} = x" * 3]
        seeds[f"setting_{kind}"] = ready + session(*lines, "diff all")
    seeds |= {
        "opened_only": ready + raw(OPENS) + LISTEN + wait(20),
        "opened_by_noise": ready + raw(bytes(range(250))) + LISTEN,
        "opened_in_flight": flying + session("motor test on", "motor 1 1300 2", "save", "exit"),
        "opened_at_boot": bytes([BOOTING]) + session("save", "motor test on") + wait(2000),
        "arm_while_open": ready + session("status") + pilot(arm=True) + wait(100),
        "motor_turns": ready + session("motor test on", "motor 1 1300 1") + (wait(40) + LISTEN) * 30,
        "motor_stopped": ready
        + session("motor test on", "motor 2 1300 5")
        + (wait(40) + LISTEN) * 5
        + raw(b"x"),
        "motor_hang_up": ready
        + session("motor test on", "motor 2 1300 5")
        + (wait(40) + LISTEN) * 5
        + bytes([Step.HANG_UP])
        + wait(700),
        "motor_left_alone": ready + session("motor test on", "motor 2 1300 5") + wait(2000),
        "motor_by_msp_meanwhile": ready
        + session("motor test on", "motor 1 1300 3")
        + ask(Msp.SET_MOTOR, b"\x4c\x04" * 4, OTHER)
        + (wait(40) + LISTEN) * 5,
        "motor_switch": ready + session("motor test on", "motor 1 1300 3") + pilot(arm=True) + wait(400),
        "save_in_a_test": ready + session("motor test on", "motor 1 1300 3", "save") + wait(100) + LISTEN,
        "save_after_an_error": ready + session("set nothing = 1", "save", "save force") + wait(50),
        "save_without_flash": ready + bytes([Step.FLASH, 2]) + session("save") + wait(50),
        "two_sessions": ready
        + session("status")
        + session("version", bits=OTHER)
        + typed("exit", bits=OTHER),
        "request_ends_it": ready + session("status") + ask(Msp.API_VERSION) + typed("save"),
        "request_within_a_line": ready + raw(OPENS + b"sa") + ask(Msp.API_VERSION) + raw(b"ve\n") + LISTEN,
        "line_too_long": ready + session("set craft_name = " + "x" * 200, "save"),
        "line_without_end": ready + raw(OPENS + b"save") + wait(2000),
        "no_text": ready + raw(OPENS + b"sa\x80ve\n\x1bx\n") + LISTEN,
        "edited": ready + raw(OPENS + b"savx\x08e\x7f\x7f\x7f\x7f\x7f\x7f\x7fversion\r\n") + LISTEN,
        "dropped_line": ready + raw(OPENS + b"save\x03version\r") + LISTEN,
        "frame_without_end": ready + raw(FRAME + b"save") + wait(2000) + wait(1000),
        "frame_of_two_lines": ready + raw(FRAME + b"status\nversion\n" + FRAME_END) + LISTEN * 8,
        "pasted": ready
        + raw(OPENS + b"defaults\nset gyro_rate_hz = 4000\nset msp_baud = 921600\nsave\n")
        + LISTEN * 9,
        "pasted_too_fast": ready + raw(OPENS) + raw(b"dump\n" * 40) * 4 + LISTEN * 9,
        "hang_up_in_a_line": ready + raw(OPENS + b"sav") + bytes([Step.HANG_UP]) + raw(b"e\n") + LISTEN,
        "pause_in_a_line": ready + raw(OPENS + b"sav") + bytes([Step.HANG_UP | 0x10]) + raw(b"e\n") + LISTEN,
        "sticks_by_msp": bytes([READY_MSP]) + session("status", "exit") + wait(50),
        "reboot_pending": ready
        + session("exit")
        + typed("motor test on", "save")
        + pilot(arm=True)
        + wait(100),
    }
    return seeds


def words() -> str:
    """A dictionary for libFuzzer: the words of the command line, and MSP's beginnings."""
    said = {word for line in COMMANDS for word in line.split()} | {setting.name for setting in SETTINGS}
    said |= {"$M<", "$X<", "= ", "on", "off", "force", "all", "ack", str(contract.CHANNEL_MID_US)}
    return "".join(f'"{word}"\n' for word in sorted(said) if word.isascii() and '"' not in word)
