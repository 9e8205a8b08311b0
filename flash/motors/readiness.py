"""A board's readiness to turn its motors on the bench."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from neuroflight.flash.board.hints import HINTS, words
from neuroflight.flash.board.info import check_ours
from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.messages import BatteryLevel
from neuroflight.flash.settings.values import Settings
from neuroflight.toolchain.contract import ARMING_FLAG_SWITCH, FlightState, Msp
from neuroflight.toolchain.errors import LinkError

UNSENT = "nothing that acts was sent"
STANDING_US = (0, 1000)  # MOTOR's values for a motor that is stopped, or missing
STAND_S = 3.0  # until MOTOR reports stopped motors, and a closed test is over
PAUSE_S = 0.02  # between two looks
TEST = "MOTOR_TEST"  # the arming reason from the opening of a test until MOTOR_TEST_TIMEOUT_MS after its end

NOT_READY = {  # why a state other than disarmed forbids turning motors
    FlightState.BOOT: "it is starting; wait a moment",
    FlightState.CALIBRATING: "its gyro is being calibrated; keep the aircraft still",
    FlightState.ARMED: "it is armed; put the arm switch off",
    FlightState.FAILSAFE_HOLD: "it is armed; put the arm switch off",
    FlightState.FAILSAFE_DROP: "it is armed; put the arm switch off",
    FlightState.CRASHED: HINTS["CRASHED"],
    FlightState.FAULT: "it has stopped for a fault; see `neuroflight board monitor`, start it anew",
}
BATTERY = {  # why a battery forbids it
    BatteryLevel.CRITICAL: "the battery is low: charge it first",
    BatteryLevel.ABSENT: "no battery is seen: plug it in; battery_cells says how many cells it has",
    BatteryLevel.STARTING: "the battery is being looked at: ask again in a second",
}


@dataclass(frozen=True)
class Bench:
    """A board whose motors may turn now."""

    aircraft: str  # that its policy was trained for
    motor_count: int
    outputs: tuple[int, ...]  # that each motor's ESC is wired to, motor order, from 1
    reversed: bool  # by the setting motors_reversed: all turn the other way than in the aircraft's file
    warning: str  # note that does not forbid turning them; "" for none


def read_bench(client: Client) -> Bench:
    """Look at the board. Raises LinkError unless its motors may turn: armed, not ready, battery."""
    check_ours(client, UNSENT)
    policy = messages.policy_info(client.request(Msp.POLICY_INFO))
    settings = Settings(client)
    outputs = tuple(int(settings.get(f"motor{n}_output")) for n in range(1, policy.action_count + 1))
    level = check_ready(client)
    return Bench(
        aircraft=policy.name,
        motor_count=policy.action_count,
        outputs=outputs,
        reversed=bool(settings.get("motors_reversed")),
        warning="the battery is below its warning voltage" if level is BatteryLevel.WARNING else "",
    )


def check_ready(client: Client) -> BatteryLevel:
    """Raise LinkError unless it is disarmed with its arm switch off and its battery suffices."""
    state = records.safety(client.request(Msp.SAFETY)).state
    if state is not FlightState.DISARMED:
        raise LinkError(
            f"{client.name}: got the state {words(state.name)}, expected disarmed: {NOT_READY[state]}; "
            "no motor turned"
        )
    extended = messages.status_ex(client.request(Msp.STATUS_EX))
    if extended.arming_flags >> ARMING_FLAG_SWITCH & 1:
        raise LinkError(f"{client.name}: the arm switch is on, expected off; put it off; no motor turned")
    level = messages.battery_state(client.request(Msp.BATTERY_STATE)).level
    if level in BATTERY:
        raise LinkError(f"{client.name}: {BATTERY[level]}; no motor turned")
    return level


def motors_stand(client: Client) -> bool:
    """Return True if every motor is stopped."""
    return all(us in STANDING_US for us in messages.motor(client.request(Msp.MOTOR)))


def await_standing(
    client: Client,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Wait until the motors are stopped and the firmware has ended the test. Raises LinkError."""
    deadline = clock() + STAND_S
    while True:
        flags = records.safety(client.request(Msp.SAFETY)).arming_flags
        stand = motors_stand(client)
        if stand and TEST not in messages.arming_reasons(flags):
            return
        if clock() >= deadline:
            raise LinkError(
                f"{client.name}: the firmware took the stop and tells "
                f"{'that a motor test is still open' if stand else 'that motors still turn'} after "
                f"{STAND_S:g} s; unplug the battery; another program may be testing motors"
            )
        sleep(PAUSE_S)
