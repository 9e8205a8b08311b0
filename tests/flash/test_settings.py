"""Settings as people write them; tests/sim/board/serial/test_idle_board.py changes those of a firmware."""

from __future__ import annotations

import pytest

from neuroflight.flash.settings.values import as_stored, in_order, parse_change
from neuroflight.toolchain.errors import LinkError


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("gyro_rate_hz=8000", ("gyro_rate_hz", 8000.0)),
        (" roll_expo = 0.25 ", ("roll_expo", 0.25)),
        ("filter1_kind=notch", ("filter1_kind", 5.0)),
        ("filter1_kind=5", ("filter1_kind", 5.0)),
        ("motor_stop=on", ("motor_stop", 1.0)),
    ],
)
def test_a_change_is_read_when_it_is_written_as_a_number_or_a_choice(
    text: str, change: tuple[str, float]
) -> None:
    assert parse_change(text) == change


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gyro_rate_hz", "setting 'gyro_rate_hz', expected NAME=VALUE"),
        ("gyro_rat=1", "setting 'gyro_rat' is unknown"),
        ("roll_expo=much", "setting roll_expo got 'much', expected a number"),
        ("motor_stop=maybe", "setting motor_stop got 'maybe', expected one of off, on"),
        ("roll_expo=", "setting roll_expo got '', expected a number"),
        ("battery_scale=nan", "setting battery_scale got 'nan', expected a number within its limits"),
        ("battery_scale=-inf", "setting battery_scale got '-inf', expected a number within its limits"),
        ("battery_scale=1e300", "setting battery_scale got '1e300', expected a number within its limits"),
    ],
)
def test_a_change_is_refused_with_the_reason_when_it_makes_no_sense(text: str, words: str) -> None:
    with pytest.raises(LinkError, match=words):
        parse_change(text)


def test_a_value_is_rounded_when_the_firmware_keeps_it_as_float32() -> None:
    assert as_stored("roll_expo", 0.1) == 0.10000000149011612
    assert as_stored("gyro_rate_hz", 16_777_217.0) == 16_777_217.0


def test_the_style_of_rates_comes_first_when_changes_are_put_in_order() -> None:
    changes = {"yaw_max": 0.5, "rates_style": 1.0, "deadband_us": 3.0}
    assert list(in_order(changes)) == ["rates_style", "yaw_max", "deadband_us"]
    assert in_order(changes) == changes
