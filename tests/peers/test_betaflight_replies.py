"""Betaflight's SITL of the same MSP API as the judge of how long our replies are."""

from __future__ import annotations

import pytest

from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain.contract import CONFIGURATIONS, Msp
from tests.firmware.conftest import Program

# Of these the length is that of a text or a list of what there is: channels, motors, meters, ports, modes.
OF_THEIR_OWN_LENGTH = {Msp.CURRENT_METER_CONFIG, Msp.VOLTAGE_METER_CONFIG, Msp.GYRO_SENSOR}
# The SITL is a 4.6.0 from before the release. 2025.12.5 of the same API tells 11 bytes, as the app reads them
# (both read in their sources, 2026-11-26).
CHANGED_UNTIL_RELEASE = {Msp.SENSOR_ALIGNMENT: 11}
LIVE = (Msp.API_VERSION, Msp.STATUS, Msp.STATUS_EX, Msp.RAW_IMU, Msp.MOTOR, Msp.ATTITUDE, Msp.ANALOG)


@pytest.fixture
def lengths(betaflight_port: int, host: Program) -> dict[Msp, tuple[int | None, int | None]]:
    """Return the length [bytes] of the reply to each message, theirs and ours; None: refused."""
    asked = [*LIVE, Msp.BATTERY_STATE, *(one.reply.message for one in CONFIGURATIONS)]
    found: dict[Msp, list[int | None]] = {message: [] for message in asked}
    for port in (betaflight_port, host.ports["msp"]):
        with Client(open_transport(f"tcp:127.0.0.1:{port}")) as client:
            for message, told in found.items():
                try:
                    told.append(len(client.request(message)))
                except RefusedError:
                    told.append(None)
    return {message: (theirs, ours) for message, (theirs, ours) in found.items()}


def test_replies_are_as_long_as_those_of_betaflight_of_the_same_api(
    lengths: dict[Msp, tuple[int | None, int | None]],
) -> None:
    assert lengths[Msp.SENSOR_ALIGNMENT][1] == CHANGED_UNTIL_RELEASE[Msp.SENSOR_ALIGNMENT]
    held = {
        message: told
        for message, told in lengths.items()
        if message not in {*OF_THEIR_OWN_LENGTH, *CHANGED_UNTIL_RELEASE} and told[0] is not None
    }
    assert len(held) > 35
    assert {message.name: told for message, told in held.items() if told[0] != told[1]} == {}
