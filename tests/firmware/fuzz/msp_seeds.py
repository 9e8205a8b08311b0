"""Inputs of the MSP target: every command of the contract, and stories of peers, pilots and flash."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import replace
from enum import IntEnum

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import DshotCommand, Msp
from neuroflight.toolchain.policy.blob import pack
from tests.firmware.conftest import scripted_blob
from tests.firmware.images import header_of, make_image

BOOTING, READY, FLYING, READY_MSP, FLYING_MSP = range(5)
OTHER, V2, BAD, CUT, TWICE = 0x08, 0x10, 0x20, 0x40, 0x80  # bits of a request's step


class Step(IntEnum):
    """What happens next; msp.c's table."""

    BYTES = 0
    REQUEST = 1
    TIME = 2
    PILOT = 3
    HANG_UP = 4
    FLASH = 5
    SHAKE = 6
    LISTEN = 7


def raw(data: bytes, bits: int = 0) -> bytes:
    """Bytes as they are."""
    return bytes([Step.BYTES | bits, len(data)]) + data


def ask(command: int, payload: bytes = b"", bits: int = 0) -> bytes:
    """A request."""
    return bytes([Step.REQUEST | bits]) + struct.pack("<HB", command, len(payload)) + payload


def wait(ms: int) -> bytes:
    """So much time, in steps of 8 ms where it is long."""
    long = bytes([Step.TIME | 0x10, min(ms // 8, 255)])
    return long if ms > 255 else bytes([Step.TIME, ms])


def pilot(*, arm: bool = False, throttle: bool = False, silent: bool = False) -> bytes:
    """What the pilot does from now on."""
    return bytes([Step.PILOT | arm * 0x10 | throttle * 0x20 | silent * 0x40])


def motors(*us: int) -> bytes:
    """Values of a motor test, stops for those that are not told."""
    return ask(Msp.SET_MOTOR, struct.pack(f"<{len(us)}H", *us))


OPEN = ask(Msp.MOTOR_TEST, struct.pack("<I", contract.MOTOR_TEST_MAGIC))
TURN = motors(1100, 1000, 1200, 1000)
SAVE = ask(Msp.EEPROM_WRITE)
STICKS = struct.pack("<16H", 1500, 1500, 1500, 1000, 2000, *[1500] * 11)
IMAGE = pack(replace(scripted_blob(), sequence=1))  # a policy that the target's firmware takes
BEGIN = struct.pack("<I", len(IMAGE))
BANK_IMAGE = make_image(1)  # for its spare bank
PIECE = 128  # bytes of them in a request


def upload(image: bytes) -> bytes:
    """A policy as a client writes it into a slot."""
    written = (
        ask(Msp.POLICY_SLOT_WRITE, struct.pack("<I", at) + image[at : at + PIECE])
        for at in range(0, len(image), PIECE)
    )
    return ask(Msp.POLICY_SLOT_BEGIN, BEGIN) + b"".join(written) + ask(Msp.POLICY_SLOT_END)


def bank_upload(image: bytes) -> bytes:
    """An image as a client writes it into the spare bank, and switches to it."""
    written = (
        ask(Msp.IMAGE_WRITE, struct.pack("<I", at) + image[at : at + PIECE])
        for at in range(0, len(image), PIECE)
    )
    end = ask(Msp.IMAGE_END) + ask(Msp.IMAGE_HASH, b"\1")
    switch = ask(Msp.IMAGE_SWITCH, hashlib.sha256(image).digest() + b"\0")
    return ask(Msp.IMAGE_BEGIN, header_of(image)) + b"".join(written) + end + switch


# A payload that a command takes; any other command is asked without one, and with a few bytes.
PAYLOADS = {
    Msp.SET_RAW_RC: STICKS,
    Msp.SET_MOTOR: struct.pack("<4H", 1100, 1100, 1100, 1100),
    Msp.MOTOR_TEST: struct.pack("<I", contract.MOTOR_TEST_MAGIC),
    Msp.DSHOT_COMMAND: bytes([contract.DSHOT_ALL_MOTORS, DshotCommand.BEACON_1]),
    Msp.POLICY_SLOT_BEGIN: BEGIN,
    Msp.POLICY_SLOT_WRITE: struct.pack("<I", 0) + IMAGE[:16],
    Msp.POLICY_SLOT_INFO: b"\2",
    Msp.IMAGE_BEGIN: header_of(BANK_IMAGE),
    Msp.IMAGE_WRITE: struct.pack("<I", 0) + BANK_IMAGE[:16],
    Msp.IMAGE_HASH: b"\1",
    Msp.IMAGE_SWITCH: hashlib.sha256(BANK_IMAGE).digest() + b"\1",
    Msp.FAULTS: struct.pack("<I", 1),
    Msp.STREAM: struct.pack("<H", 500),
    Msp.LOG_READ: struct.pack("<HIH", 0, 0, 64),
    Msp.LOG_ERASE: struct.pack("<I", contract.LOG_ERASE_MAGIC),
}


def command_seed(command: Msp) -> bytes:
    """The command with no payload, with the one that it takes, with others; then the same while it flies."""
    payload = PAYLOADS.get(command, bytes(2))
    asked = ask(command) + ask(command, payload) + ask(command, bytes(8), V2) + ask(command, payload, BAD)
    return bytes([READY]) + asked + wait(50)


def flying_seed(command: Msp) -> bytes:
    """The same while motors turn."""
    payload = PAYLOADS.get(command, bytes(2))
    return bytes([FLYING]) + ask(command) + ask(command, payload) + ask(command, bytes(8), OTHER) + wait(20)


def msp_seeds() -> dict[str, bytes]:
    """All of them, by name."""
    seeds = {f"command_{command.name.lower()}": command_seed(command) for command in Msp}
    seeds |= {f"flying_{command.name.lower()}": flying_seed(command) for command in Msp}
    ready, other = bytes([READY]), OTHER
    seeds |= {
        "nothing": b"",
        "image": ready + bank_upload(BANK_IMAGE) + ask(Msp.IMAGE_INFO),
        "image_damaged": ready + bank_upload(BANK_IMAGE[:-4] + bytes(4)) + ask(Msp.IMAGE_INFO),
        "noise": ready + raw(bytes(range(250))),
        "boot": bytes([BOOTING]) + ask(Msp.STATUS) + SAVE + wait(2000) + ask(Msp.STATUS),
        "motor_test": ready + OPEN + wait(5) + TURN + wait(100) + TURN + wait(100),
        "motor_test_forgotten": ready + OPEN + wait(5) + TURN + wait(800) + TURN + wait(50),
        "motor_test_unopened": ready + TURN + wait(50),
        "motor_test_too_fast": ready + OPEN + wait(5) + ask(Msp.SET_MOTOR, b"\xd0\x07" * 4) + wait(50),
        "motor_test_one_too_fast": ready + OPEN + wait(5) + motors(2000) + wait(50),
        "motor_test_all_too_fast": ready + OPEN + wait(5) + motors(1400, 1400, 1400, 1400) + wait(50),
        "motor_test_fastest": ready
        + OPEN
        + wait(5)
        + motors(1500, 1500)
        + wait(50)
        + motors(1250)
        + wait(50),
        "motor_test_too_many": ready + OPEN + wait(5) + motors(*[1050] * 8) + wait(50),
        "motor_test_switch": ready + OPEN + wait(5) + TURN + pilot(arm=True) + wait(400) + TURN + wait(250),
        "motor_test_link": ready + OPEN + wait(5) + TURN + pilot(silent=True) + wait(400) + TURN + wait(250),
        "motor_test_save": ready + OPEN + wait(5) + TURN + wait(5) + SAVE + wait(50),
        "motor_test_two_peers": ready + OPEN + wait(5) + ask(214, b"\x4c\x04" * 4, other) + wait(50),
        "motor_test_hang_up": ready + OPEN + wait(5) + TURN + bytes([Step.HANG_UP]) + wait(200),
        "dshot_busy": ready + ask(Msp.DSHOT_COMMAND, b"\xff\x01") + OPEN + TURN + SAVE + wait(400),
        "save_then_arm": ready + SAVE + pilot(arm=True) + wait(100) + SAVE,
        "save_refused": ready + bytes([Step.FLASH, 3]) + SAVE + wait(100) + SAVE,
        "settings": ready
        + b"".join(
            ask(Msp.SETTING_GET, struct.pack("<H", index)) + ask(Msp.SETTING_INFO, struct.pack("<H", index))
            for index in range(0, len(contract.SETTINGS), 4)
        ),
        "settings_set": ready
        + b"".join(
            ask(Msp.SETTING_SET, struct.pack("<HI", index, 1)) for index in range(len(contract.SETTINGS))
        )
        + SAVE,
        "settings_not_a_number": ready
        + b"".join(
            ask(Msp.SETTING_SET, struct.pack("<HI", index, 0x7FC00000))
            for index in range(len(contract.SETTINGS))
        ),
        "policy": ready + upload(IMAGE) + ask(Msp.POLICY_INFO) + wait(50) + upload(IMAGE),
        "policy_two_peers": ready
        + upload(IMAGE)[:160]
        + ask(Msp.POLICY_SLOT_BEGIN, BEGIN, other)
        + upload(IMAGE),
        "policy_no_flash": ready + bytes([Step.FLASH, 2]) + upload(IMAGE),
        "policy_broken": ready + upload(IMAGE[:-4] + bytes(4)),
        "policy_in_flight": bytes([FLYING]) + upload(IMAGE),
        "reboot_then_arm": ready + ask(Msp.REBOOT) + pilot(arm=True) + wait(200),
        "acknowledge": ready + ask(Msp.FAULTS) + ask(Msp.ACKNOWLEDGE) + wait(20),
        "crash": bytes([FLYING]) + bytes([Step.SHAKE | 0x10]) + wait(600) + ask(Msp.SAFETY) + SAVE,
        "landing": bytes([FLYING]) + pilot() + wait(50) + SAVE + TURN + wait(50),
        "sticks": bytes([READY_MSP]) + (ask(Msp.SET_RAW_RC, STICKS) + wait(10)) * 5,
        "sticks_silent": bytes([FLYING_MSP])
        + pilot(silent=True)
        + (ask(Msp.SET_RAW_RC, STICKS) + wait(10)) * 3
        + wait(1600),
        "sticks_wild": bytes([READY_MSP]) + ask(Msp.SET_RAW_RC, b"\xff\xff" * 16) + wait(10),
        "abandoned": ready + ask(Msp.SET_MOTOR, bytes(16), CUT) + OPEN + TURN + wait(20),
        "abandoned_long": ready + raw(b"$X<\0\x32\x4e\xff\x01") + ask(1) * 5,
        "abandoned_then_pause": ready + raw(b"$M<\x10\xd6") + bytes([Step.HANG_UP | 0x10]) + ask(1),
        "interleaved": ready + raw(b"$M<\x00") + raw(b"$M<\x00", other) + raw(b"\1\1") + raw(b"\1\1", other),
        "jumbo": ready + ask(Msp.SET_MOTOR, bytes(200), TWICE) + ask(1),
        "longer_than_any": ready + raw(b"$X<\0\x01\0\x58\x02") + raw(bytes(240)) * 3 + ask(1),
        "too_long": ready + raw(b"$X<\0\x01\0\xff\xff" + bytes(20)) + ask(1),
        "no_room": ready + raw(b"$M<\0\1\1", V2) + raw(b"$M<\0\4\4" * 20, V2),
        "many_at_once": ready + raw(b"$M<\0\4\4" * 40),
        "stream": ready + ask(Msp.STREAM, struct.pack("<H", 500)) + (wait(4) + bytes([Step.LISTEN])) * 30,
        "stream_in_flight": bytes([FLYING])
        + ask(Msp.STREAM, struct.pack("<H", 100))
        + ask(Msp.STREAM, struct.pack("<H", 333), other)
        + (wait(7) + bytes([Step.LISTEN, Step.LISTEN | other]) + ask(1)) * 10,
        "stream_unheard": ready + ask(Msp.STREAM, struct.pack("<H", 500)) + wait(800) + ask(1) * 3,
        "stream_hang_up": ready
        + ask(Msp.STREAM, struct.pack("<H", 500))
        + bytes([Step.HANG_UP])
        + (wait(9) + bytes([Step.LISTEN])) * 3,
        "listening": ready + bytes([Step.LISTEN, Step.LISTEN | other]) * 3 + wait(10),
        "byte_by_byte": ready + b"".join(raw(bytes([byte])) for byte in b"$X<\0\x01\x4e\0\0\xcf" * 2),
    }
    return seeds
