"""changes.c: NAME=VALUE as a user of the host program writes it."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from neuroflight.toolchain.contract import SETTING_TEXT_BYTES, SETTINGS, Mode, ModeRange

ARM = ModeRange(Mode.ARM, 1, 1700, 2100)


def parse(core: Any, text: str) -> tuple[str, bytes] | None:
    change = core.new("struct setting_change *")
    if not core.lib.change_parse(text.encode(), change):
        return None
    return SETTINGS[change.index].name, bytes(core.ffi.buffer(core.ffi.addressof(change, "value")))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("motor_protocol=dshot300", struct.pack("<I", 0)),
        ("motor_protocol=1", struct.pack("<I", 1)),
        ("mode1=arm aux1 1700 2100", struct.pack("<I", ARM.packed)),
        (f"mode1={ARM.packed}", struct.pack("<I", ARM.packed)),
        ("mode7=none", struct.pack("<I", 0)),
        ("craft_name=NF1", b"NF1"),
        ("craft_name=a=b c", b"a=b c"),
        ("craft_name=", b""),
        ("failsafe_throttle=0.3", struct.pack("<f", 0.3)),
        ("gyro_rate_hz=8000", struct.pack("<I", 8000)),
    ],
)
def test_a_change_is_read_when_it_says_a_value_of_a_setting(scripted: Any, text: str, value: bytes) -> None:
    assert parse(scripted, text) == (text.partition("=")[0], value.ljust(SETTING_TEXT_BYTES, b"\0"))


@pytest.mark.parametrize(
    "text",
    [
        "gyro_rate_hz",
        "gyro_rate=1000",
        "=1",
        "gyro_rate_hz=999",
        "gyro_rate_hz=8000.0",
        "failsafe_throttle=1.1",
        "motor_protocol=pwm",
        "motor_protocol=3",
        "mode1=arm aux1 1701 2100",
        "mode1=1",
        "x" * 60 + "=1",
        "craft_name=seventeen letters",
        "craft_name=café",
        "gyro_rate_hz=",
        "failsafe_throttle=nan",
    ],
)
def test_a_change_is_refused_when_it_says_none(scripted: Any, text: str) -> None:
    assert parse(scripted, text) is None
