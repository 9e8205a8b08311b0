"""Two peers and a pilot in random order around the app's motor wizards, and what must never be, each ms.

A peer that holds the arming lock may turn motors by four slow values; every other way needs a test that
is opened in so many words. No order of requests may make more of it.
"""

from __future__ import annotations

import random
import struct

import pytest

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import (
    CHANNEL_ARM,
    CHANNEL_MAX_US,
    CHANNEL_MIN_US,
    MOTOR_TEST_TIMEOUT_MS,
    Msp,
)
from tests.firmware.joined.ground import FRAME_MS, STANDING, Ground, Request, State

PORTS = range(contract.MSP_PORT_COUNT)
SLOW = contract.DSHOT_MIN + round(contract.DSHOT_SPAN * contract.MOTOR_WIZARD_MAX)
HEARD_MS = 2  # until a frame has been decoded


def motors(*us: int) -> Request:
    return Request(Msp.SET_MOTOR, struct.pack(f"<{len(us)}H", *us))


def dshot(payload: str) -> Request:
    return Request(Msp.SEND_DSHOT_COMMAND, bytes.fromhex(payload))


LOCK, UNLOCK = Request(Msp.ARMING_DISABLE, b"\1\0"), Request(Msp.ARMING_DISABLE, b"\0\0")
LOCK_TOO = Request(Msp.ARMING_DISABLE, b"\1\1")
TURN = [motors(*[1055] * 4), motors(1055, 1000, 1000, 1000), motors(1125, 1125, 1125, 1125)]
STOP = [motors(*[1000] * 4), motors(*[1000] * 8), motors(*[0] * 4)]
WRONG = [
    *(motors(*[us] * 4) for us in (999, 1126, 1500, 2000, 2001, 65535)),
    *(motors(*[1055] * count) for count in (1, 3, 5, 8)),
    *(motors(1055, 1000, 1000, 2000), motors(1055, *[1000] * 7)),
    *(motors(1000, 1500, 1000, 1000), motors(*[1200] * 4), motors(1000, 1400)),
]
TELL = [dshot(text) for text in ("01ff02070c", "010102080c", "01ff010c", "01ff0107", "01ff010d", "01ff0100")]
TELL += [Request(Msp.DSHOT_COMMAND, b"\xff\7"), Request(Msp.DSHOT_COMMAND, b"\0\14")]
WRITES = [Request(Msp.EEPROM_WRITE), Request(Msp.RESET_CONF), Request(Msp.POLICY_SLOT_BEGIN, b"\0\1\0\0")]
OTHERS = [Request(Msp.STATUS_EX), Request(Msp.SET_PID), Request(Msp.SETTINGS_DEFAULT)]
REQUESTS = [*6 * [LOCK, *TURN], UNLOCK, LOCK_TOO, *STOP, *WRONG, *2 * TELL, *WRITES, *OTHERS]
SLIDERS = Request(Msp.ARMING_DISABLE, b"\0\1")
OPENERS = [SLIDERS, Request(Msp.MOTOR_TEST, struct.pack("<I", contract.MOTOR_TEST_MAGIC))]


class Watch:
    """What happens, and that it may."""

    def __init__(self, ground: Ground, *, others: bool) -> None:
        """others: tests that are not a wizard's open as well."""
        self.ground, self.others = ground, others
        self.fastest = contract.DSHOT_MAX if others else SLOW
        self.kept = -(10**6)  # when somebody spoke last who keeps a test open
        self.locks = dict.fromkeys(PORTS, False)
        self.switched: int | None = None  # when it was heard last that the arm switch had been put on
        self.turned = -(10**6)  # a motor did last
        self.stops = 0  # ms in a row that all were told to stop, before now
        self.turns = self.commands = self.flights = 0

    def ask(self, request: Request, port: int) -> None:
        """Send a request and check what it may do at once."""
        ground = self.ground
        writes, turning = ground.board.flash.operations, max(ground.motors) > contract.DSHOT_MIN
        done = ground.ask(request, port)
        if self.others or self.locks[port] or (done and request.command == Msp.SET_MOTOR):
            self.kept = ground.ms
        if request.command == Msp.ARMING_DISABLE:
            self.locks[port] = request.payload[0] == 1
        assert not turning or ground.board.flash.operations == writes, "written while motors turn"

    def run(self, ms: int) -> None:
        for _ in range(ms):
            writes = self.ground.board.flash.operations
            self._hear()
            told = self.ground.run(1)
            assert self.ground.board.flash.operations == writes
            self._look(told, self.ground.ms)

    def _hear(self) -> None:
        ground = self.ground
        if ground.silent or ground.ms % FRAME_MS > 0:
            return
        if ground.channels[CHANNEL_ARM] == CHANNEL_MIN_US:
            self.switched = None
        elif self.switched is None:
            self.switched = ground.ms

    def _look(self, told: list[int], now: int) -> None:
        if self.ground.armed:
            self.flights += 1
            assert self.flights > 1 or not any(self.locks.values()), "armed under a lock"
            assert self.flights > 1 or now - self.turned > MOTOR_TEST_TIMEOUT_MS, "before motors stood"
            assert all(value == 0 or value >= contract.DSHOT_MIN for value in told), "a command in flight"
            self.stops = 0
            return
        self.flights = 0
        if any(0 < value < contract.DSHOT_MIN for value in told):
            self.commands += 1
            assert all(value < contract.DSHOT_MIN for value in told)
            assert self.stops >= 9, "a command without stops before it"
            return
        self.stops = self.stops + 1 if told == STANDING else 0
        if told == STANDING:
            return
        self.turns += 1
        self.turned = now
        assert max(told) <= self.fastest, "faster than it may"
        assert self.others or any(self.locks.values()), "nobody holds a lock"
        assert now - self.kept <= MOTOR_TEST_TIMEOUT_MS, "nobody asks any more"
        assert self.switched is None or now - self.switched <= HEARD_MS, "although the switch is on"


@pytest.mark.parametrize("seed", range(8))
def test_no_order_of_requests_makes_more_of_a_wizard_than_it_is(
    ground: Ground, ready: State, seed: int
) -> None:
    chance = random.Random(seed)
    ground.go_back(ready)
    others = seed % 4 == 3
    watch = Watch(ground, others=others)
    for _ in range(300):
        act = chance.random()
        port = chance.choice(PORTS)
        if act < 0.8:
            watch.ask(chance.choice(REQUESTS + OPENERS if others else REQUESTS), port)
        elif act < 0.84:
            ground.leave(port)
            watch.locks[port] = False
        elif act < 0.86:
            ground.pause(port)
        elif act < 0.93:
            on = ground.channels[CHANNEL_ARM] == CHANNEL_MAX_US
            ground.channels[CHANNEL_ARM] = CHANNEL_MIN_US if on else CHANNEL_MAX_US
        elif act < 0.95:
            ground.silent = not ground.silent
        watch.run(chance.choice((0, 0, 1, 2, 10, 20, 100, 700)))
    assert watch.turns > 0 and watch.commands > 0
