"""What clients of PX4's and of ArduPilot's custom mean by numbers."""

from __future__ import annotations

import pytest

from neuroflight.flash.mavlink.customs import (
    CUSTOM_MODE,
    HOLD,
    MODE_OFFBOARD,
    RECEIVER,
    SOURCES_MAX,
    Customs,
    Mode,
    ModeError,
    message_mode,
)
from neuroflight.flash.mavlink.offboard import Source

ONE: Source = (0, 245, 190)
OTHER: Source = (0, 255, 230)
ARMED = 0x80  # MAV_MODE_FLAG_SAFETY_ARMED
PX4_OFFBOARD, PX4_HOLD, PX4_MANUAL = 6 << 16, 4 << 16 | 3 << 24, 1 << 16


@pytest.mark.parametrize(
    ("main", "sub", "mode"),
    [
        (0, 0, RECEIVER),
        (1, 0, Mode(True, MODE_OFFBOARD)),
        (6, 0, Mode(True, PX4_OFFBOARD)),
        (4, 0, Mode(True, 4)),
        (20, 0, Mode(True, 20)),
        (4, 3, HOLD),
    ],
)
@pytest.mark.parametrize("base", [CUSTOM_MODE, CUSTOM_MODE | ARMED])
def test_a_command_chooses_offboard_by_every_customs_number(
    main: int, sub: int, mode: Mode, base: int
) -> None:
    assert Customs().command_mode(ONE, base, main, sub) == mode


@pytest.mark.parametrize(
    ("base", "main", "sub"),
    [
        *((CUSTOM_MODE, main, 0) for main in (2, 3, 5, 7, 8, 9, 21, 255)),
        *((CUSTOM_MODE, 4, sub) for sub in (1, 2, 4, 5, 6, 8)),  # PX4's take-off, mission, return, land ..
        (ARMED, 1, 0),
        (0, 0, 0),
    ],
)
def test_no_other_mode_is_there(base: int, main: int, sub: int) -> None:
    with pytest.raises(ModeError, match="expected"):
        Customs().command_mode(ONE, base, main, sub)


@pytest.mark.parametrize(
    ("custom", "mode"),
    [
        (0, RECEIVER),
        (1, Mode(True, 1)),
        (4, Mode(True, 4)),
        (20, Mode(True, 20)),
        (PX4_OFFBOARD, Mode(True, PX4_OFFBOARD)),
        (PX4_HOLD, HOLD),
    ],
)
def test_a_message_chooses_it_too(custom: int, mode: Mode) -> None:
    assert message_mode(CUSTOM_MODE, custom) == mode


@pytest.mark.parametrize(
    ("base", "custom"),
    [
        (CUSTOM_MODE, 6),  # ArduPilot's RTL: PX4 writes its 6 elsewhere
        (CUSTOM_MODE, PX4_MANUAL),
        (CUSTOM_MODE, 4 << 16),
        (CUSTOM_MODE, PX4_OFFBOARD | 1),
        (CUSTOM_MODE, 2**32 - 1),
        (ARMED, 1),
    ],
)
def test_a_message_chooses_no_other(base: int, custom: int) -> None:
    with pytest.raises(ModeError, match="expected"):
        message_mode(base, custom)


def test_six_is_return_to_launch_for_who_speaks_as_to_ardupilot() -> None:
    customs = Customs()
    customs.hear_stream_request(OTHER)
    with pytest.raises(ModeError):
        customs.command_mode(OTHER, CUSTOM_MODE, 6, 0)
    assert customs.command_mode(ONE, CUSTOM_MODE, 6, 0).offboard


def test_whole_numbers_come_in_bytes_to_who_asks_first_how_they_do() -> None:
    customs = Customs()
    assert not customs.reads_bytes(None) and not customs.reads_bytes(ONE)
    customs.hear_request(ONE)
    customs.hear_parameters(ONE)
    customs.hear_parameters(OTHER)
    customs.hear_request(OTHER)  # MAVProxy, whose user typed `version`
    assert customs.reads_bytes(ONE) and not customs.reads_bytes(OTHER)
    customs.hear_stream_request(ONE)
    customs.hear_request(ONE)
    assert not customs.reads_bytes(ONE), "it speaks as to ArduPilot"


def test_what_is_known_of_sources_has_an_end() -> None:
    customs = Customs()
    for system in range(2 * SOURCES_MAX):
        customs.hear_request((1, system, 1))
    assert [customs.reads_bytes((1, system, 1)) for system in range(2 * SOURCES_MAX)].count(True) == (
        SOURCES_MAX
    )
