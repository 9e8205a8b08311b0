"""A check that a board's policy may be changed now."""

from __future__ import annotations

from neuroflight.flash.board.info import check_ours
from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.messages import BatteryLevel
from neuroflight.flash.policy.slots import Policies
from neuroflight.toolchain.contract import ArmingReason, FlightState, Msp
from neuroflight.toolchain.errors import LinkError

# FAULT stops the motors until the next start, and a swap ends with a start.
STANDING = (FlightState.BOOT, FlightState.CALIBRATING, FlightState.DISARMED, FlightState.FAULT)
TESTING = 1 << ArmingReason.MOTOR_TEST


def check_ready(client: Client, unwritten: str) -> None:
    """Raise LinkError unless it is our firmware, its motors stand and its battery is not low.

    The firmware refuses for itself while motors are armed or under test; asked before, the user reads it
    before anything is erased. unwritten: what is not done then.
    """
    check_ours(client, unwritten)
    safety = records.safety(client.request(Msp.SAFETY))
    if safety.arming_flags & TESTING:
        raise LinkError(f"{client.name}: a motor test is open; {unwritten}: end it, then try again")
    if safety.state not in STANDING:
        state = safety.state.name.lower().replace("_", " ")
        raise LinkError(f"{client.name}: the board is in state {state}; {unwritten}: disarm, then try again")
    battery = messages.battery_state(client.request(Msp.BATTERY_STATE))
    if battery.level is BatteryLevel.CRITICAL:
        raise LinkError(
            f"{client.name}: the battery is low, {battery.voltage_v:.2f} V of {battery.cells} cells; "
            f"{unwritten}: charge it, or supply the board from USB"
        )


def check_started(name: str, policies: Policies, unwritten: str) -> None:
    """Raise LinkError if the flown slot was given up: until its next start the firmware accepts no policy."""
    if policies.given_up:
        raise LinkError(
            f"{name}: {policies.flown_text} was given up and is flown until the next start; {unwritten}: "
            "start the board anew first (`neuroflight board reboot --port PORT`)"
        )
