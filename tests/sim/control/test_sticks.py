"""Sticks against the firmware's C core."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.control import sticks
from neuroflight.sim.ports.library import Reference
from neuroflight.sim.ports.port import flight_settings
from neuroflight.toolchain.contract import (
    CHANNEL_ARM,
    CHANNEL_COUNT,
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_THROTTLE,
    CHANNEL_YAW,
    RECEIVER_RECOVERY_MS,
    SWITCH_ON_US,
)
from neuroflight.toolchain.errors import ScenarioError


def test_setpoint_and_throttle_are_the_cores_bits_when_every_stick_is_tried(reference_library: Path) -> None:
    rng = np.random.default_rng(1)
    channels = np.full((1001, CHANNEL_COUNT), 1500, np.uint16)
    for channel in (CHANNEL_ROLL, CHANNEL_PITCH, CHANNEL_YAW, CHANNEL_THROTTLE):
        channels[:, channel] = rng.permutation(np.arange(1000, 2001))
    core = Reference(reference_library, 1000, flight_settings({}))
    for _ in range(RECEIVER_RECOVERY_MS + 1):  # then the receiver is believed
        core.receiver([1500] * CHANNEL_COUNT)
        core.sample(np.zeros(3), np.zeros(3))
    setpoints, throttles = [], []
    for row in channels.tolist():
        core.receiver(row)
        core.sample(np.zeros(3), np.zeros(3))
        trace = core.trace()
        setpoints.append(list(trace.setpoint))
        throttles.append(trace.throttle)
    assert sticks.setpoint(channels).tobytes() == np.array(setpoints, np.float32).tobytes()
    assert sticks.throttle(channels).tobytes() == np.array(throttles, np.float32).tobytes()


def test_channels_say_the_nearest_microsecond_when_a_command_lies_between() -> None:
    wanted = np.random.default_rng(2).uniform(-1000, 1000, (500, 3))
    said = np.rad2deg(sticks.setpoint(sticks.channels(wanted, np.zeros(500), armed=True)))
    assert np.abs(said - wanted).max() <= 1.0 + 1e-3  # half a microsecond of 2 deg/s


def test_channels_follow_the_receivers_conventions_when_all_sticks_move() -> None:
    us = sticks.channels((100.0, -200.0, 300.0), 0.25, armed=True)
    assert us[[CHANNEL_ROLL, CHANNEL_PITCH, CHANNEL_YAW, CHANNEL_THROTTLE]].tolist() == [
        1550,
        1400,
        1350,
        1250,
    ]
    assert us[CHANNEL_ARM] > SWITCH_ON_US
    assert sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False)[CHANNEL_ARM] < SWITCH_ON_US


@pytest.mark.parametrize("rate", [1000.5, -1001.0, np.nan, np.inf])
def test_channels_refuse_when_the_setpoint_is_beyond_full_stick(rate: float) -> None:
    with pytest.raises(ScenarioError, match="full stick is 1000 deg/s"):
        sticks.channels((0.0, rate, 0.0), 0.0, armed=True)


@pytest.mark.parametrize("thrust", [-0.1, 1.1, np.nan])
def test_channels_refuse_when_the_throttle_is_out_of_range(thrust: float) -> None:
    with pytest.raises(ScenarioError, match="throttle"):
        sticks.channels((0.0, 0.0, 0.0), thrust, armed=True)
