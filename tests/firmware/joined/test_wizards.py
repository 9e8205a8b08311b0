"""The Betaflight app's motor wizards: as they go, and attempts to turn a motor as none of them would.

Reorder turns one motor after the other, 250 ms each; Direction turns all, stops one, tells its controller the
other direction and to save it, and turns them all again. Both hold the arming lock, and give four values for
four motors; the app's sliders give eight. The bytes are those that the app 2026.12 sends.
"""

from __future__ import annotations

import struct

import pytest

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import CHANNEL_ARM, MOTOR_TEST_TIMEOUT_MS, ArmingReason, Msp
from tests.firmware.joined.ground import STANDING, Ground, Request, State

LOCK = Request(Msp.ARMING_DISABLE, b"\1\0")
UNLOCK = Request(Msp.ARMING_DISABLE, b"\0\0")
SLIDERS = Request(Msp.ARMING_DISABLE, b"\0\1")
POLL = Request(Msp.STATUS_EX)
SAVE = Request(Msp.EEPROM_WRITE)
IDLE_US, FAST_US = 1055, 1126
ONE = Request(Msp.SET_MOTOR, struct.pack("<4H", IDLE_US, 1000, 1000, 1000))
ALL = Request(Msp.SET_MOTOR, struct.pack("<4H", *[IDLE_US] * 4))
BUT_SECOND = Request(Msp.SET_MOTOR, struct.pack("<4H", IDLE_US, 1000, IDLE_US, IDLE_US))
STOP = Request(Msp.SET_MOTOR, struct.pack("<4H", *[1000] * 4))
REVERSE_SECOND = Request(Msp.SEND_DSHOT_COMMAND, bytes.fromhex("010102080c"))
NORMAL_ALL = Request(Msp.SEND_DSHOT_COMMAND, bytes.fromhex("01ff02070c"))
TURNS = contract.DSHOT_MIN + round(1999 * 0.055)
QUEUE_MS, PAUSE_MS = 100, 400  # between its requests; until a motor that it stopped stands


@pytest.fixture(scope="module")
def ready(ground: Ground) -> State:
    """Return a state in which the arm switch would arm it, but for the app's lock on port 0."""
    ground.get_ready()
    assert ground.ask(LOCK)
    ground.run(2)
    return ground.keep()


@pytest.fixture(scope="module")
def turning(ground: Ground, ready: State) -> State:
    """Return a state in which the wizard Direction turns all motors."""
    ground.go_back(ready)
    assert ground.ask(ALL)
    assert ground.run(5) == [TURNS] * 4
    return ground.keep()


def values(ground: Ground, ms: int) -> list[list[int]]:
    """Return the motors' commands in so many milliseconds, repetitions left out."""
    seen: list[list[int]] = []
    for _ in range(ms):
        now = ground.run(1)
        if not seen or seen[-1] != now:
            seen.append(now)
    return seen


# --- As they go ------------------------------------------------------------------------------------
def test_reorder_turns_one_motor_at_a_time_and_its_order_is_stored_when_saved(
    ground: Ground, ready: State
) -> None:
    ground.go_back(ready)
    for motor in range(4):
        spin = [IDLE_US if index == motor else 1000 for index in range(4)]
        for _ in range(3):
            assert ground.ask(Request(Msp.SET_MOTOR, struct.pack("<4H", *spin)))
            assert values(ground, 250)[-1] == [TURNS if index == motor else 0 for index in range(4)]
            assert ground.ask(STOP)
            ground.run(1)
            assert values(ground, 499) == [STANDING]
    before = ground.board.flash.operations
    assert ground.ask(ALL) and ground.run(3) == [TURNS] * 4
    assert ground.ask(STOP)
    assert ground.ask(Request(Msp.SET_MOTOR_OUTPUT_REORDERING, bytes([4, 1, 0, 2, 3])))
    ground.run(100)  # the app waits no longer
    assert ground.ask(SAVE)
    assert ground.board.flash.operations > before
    assert ground.background.edited.motor1_output == 2


def test_direction_stops_a_motor_tells_it_both_commands_and_turns_it_again(
    ground: Ground, turning: State
) -> None:
    ground.go_back(turning)
    assert ground.ask(BUT_SECOND)
    ground.run(1)
    for _ in range(PAUSE_MS // QUEUE_MS):
        assert ground.ask(POLL)
        assert values(ground, QUEUE_MS) == [[TURNS, 0, TURNS, TURNS]]
    assert ground.ask(REVERSE_SECOND)
    told = values(ground, QUEUE_MS)
    commands = [seen for seen in told if any(0 < value < contract.DSHOT_MIN for value in seen)]
    assert commands == [[0, 8, 0, 0], [0, 12, 0, 0]]
    assert all(value < contract.DSHOT_MIN for seen in told[1:] for value in seen)
    assert ground.ask(ALL)
    ground.run(2)
    assert values(ground, 50) == [[TURNS] * 4]


def test_motors_turn_behind_the_commands_when_the_values_come_before_they_are_done(
    ground: Ground, ready: State
) -> None:
    ground.go_back(ready)
    assert ground.ask(NORMAL_ALL)
    ground.run(2)
    assert ground.ask(ALL)
    told = values(ground, 150)
    assert told[-1] == [TURNS] * 4
    assert [seen for seen in told if seen != STANDING] == [[7] * 4, [12] * 4, [TURNS] * 4]


# --- Attempts to defeat the interlock --------------------------------------------------------------
def test_nothing_turns_when_the_lock_is_not_this_peers(ground: Ground, ready: State) -> None:
    for before in ((UNLOCK,), (LOCK, UNLOCK), (UNLOCK, POLL)):
        ground.go_back(ready)
        for request in before:
            ground.ask(request)
        assert not ground.ask(ALL)
        assert values(ground, 20) == [STANDING]
    ground.go_back(ready)
    assert not ground.ask(ALL, port=1), "port 0 holds it"
    assert values(ground, 20) == [STANDING]
    ground.leave()
    assert not ground.ask(ALL), "another peer has come"
    assert values(ground, 20) == [STANDING]


@pytest.mark.parametrize(
    "us",
    [
        *([IDLE_US] * count for count in (1, 2, 3, 5, 8)),
        *([IDLE_US, 1000, 1000, 1000, *[1000] * more] for more in (1, 4)),
        *([1000, FAST_US, 1000, 1000], [1500] * 4, [2000] * 4, [IDLE_US, 1000, 1000, 2000]),
        *([IDLE_US, 1000, 1000, 999], [IDLE_US, 1000, 1000, 2001], [IDLE_US, 1000, 1000, 65535]),
    ],
    ids=str,
)
def test_nothing_turns_and_no_test_opens_when_the_values_are_no_wizards(
    ground: Ground, ready: State, us: list[int]
) -> None:
    ground.go_back(ready)
    assert not ground.ask(Request(Msp.SET_MOTOR, struct.pack(f"<{len(us)}H", *us)))
    assert values(ground, 20) == [STANDING]
    assert ground.ask(SAVE), "nothing is open that keeps it from storing"
    odd = Request(Msp.SET_MOTOR, ALL.payload[:-1])
    assert not ground.ask(odd)
    assert values(ground, 20) == [STANDING]


def test_no_motor_turns_faster_when_a_wizards_test_is_open(ground: Ground, turning: State) -> None:
    for port in (0, 1):
        for us in ([FAST_US, *[1000] * 3], [1500] * 4, [1500, *[1000] * 7]):
            ground.go_back(turning)
            assert not ground.ask(Request(Msp.SET_MOTOR, struct.pack(f"<{len(us)}H", *us)), port)
            for _ in range(20):
                assert all(value <= TURNS for value in ground.run(1))


@pytest.mark.parametrize("then", ["silence", "leave", "unlock", "lock again", "sliders", "stop"])
def test_motors_stop_when_the_wizard_is_gone(ground: Ground, turning: State, then: str) -> None:
    ground.go_back(turning)
    for _ in range(6):  # while it asks for anything they turn
        assert ground.ask(POLL)
        assert values(ground, MOTOR_TEST_TIMEOUT_MS // 3) == [[TURNS] * 4]
    if then == "leave":
        ground.leave()
    elif then != "silence":
        ground.ask({"unlock": UNLOCK, "lock again": LOCK, "sliders": SLIDERS, "stop": STOP}[then])
    wait = MOTOR_TEST_TIMEOUT_MS if then == "silence" else 1
    ground.ask(POLL, port=1)  # what another peer asks keeps nothing turning
    ground.run(wait)
    assert values(ground, MOTOR_TEST_TIMEOUT_MS) == [STANDING]
    assert ground.ask(ALL) == (then in ("silence", "lock again", "stop"))


@pytest.mark.parametrize("what", ["switch", "link lost", "link found", "gyro silent"])
def test_motors_stop_at_once_when_something_happens(ground: Ground, ready: State, what: str) -> None:
    ground.go_back(ready)
    if what == "link found":
        ground.silent = True
        ground.run(contract.RECEIVER_LOST_MS + 50)
    assert ground.ask(ALL)
    assert ground.run(5) == [TURNS] * 4
    if what == "switch":
        ground.channels[CHANNEL_ARM] = contract.CHANNEL_MAX_US
        ground.run(11)
    elif what == "gyro silent":
        ground.lib.firmware_gyro_silent(ground.firmware, ground.core.new("uint16_t[4]"))
    else:
        ground.silent = what == "link lost"
        for _ in range(contract.RECEIVER_LOST_MS // 100 + 1):
            ground.ask(POLL)
            ground.run(100)
    assert values(ground, 300) == [STANDING]
    assert not ground.armed
    if what == "switch":
        assert not ground.ask(ALL) or values(ground, 50) == [STANDING], "the switch is still on"
        assert values(ground, 50) == [STANDING]


def test_nothing_arms_before_the_motors_have_stood_when_the_lock_is_lifted(
    ground: Ground, turning: State
) -> None:
    ground.go_back(turning)
    assert ground.ask(STOP) and ground.ask(UNLOCK)
    for _ in range(MOTOR_TEST_TIMEOUT_MS - 1):
        ground.run(1)
        assert ground.firmware.status.arming_reasons >> ArmingReason.MOTOR_TEST & 1
    ground.run(2)
    assert ground.firmware.status.arming_reasons == 0


def test_nothing_is_written_while_motors_turn(ground: Ground, turning: State) -> None:
    for request in (SAVE, Request(Msp.RESET_CONF), Request(Msp.REBOOT)):
        ground.go_back(turning)
        before = ground.board.flash.operations
        assert not ground.ask(request)
        assert ground.board.flash.operations == before and not ground.background.rebooting
        assert ground.ask(STOP) and not ground.ask(request), "the last value is still at the motors"
    for command in (b"save", b"exit", b"motor test on", b"motor 1 1500 5", b"defaults nosave"):
        for port, typed in ((0, False), (1, False), (1, True)):
            ground.go_back(turning)
            before = ground.board.flash.operations
            ground.send(b"#\r\n" + command + b"\r\n" if typed else b"\2" + command + b"\n\3", port)
            for _ in range(20):
                ground.send(b"", port)
                assert all(value <= TURNS for value in ground.run(1))
            assert ground.board.flash.operations == before and not ground.background.rebooting, command


@pytest.mark.parametrize(
    "payload",
    [
        *("01", "01ff", "01ff00", "01ff01", "01ff02", "01ff0207", "01ff03070c0c", "01ffff" + "0c" * 255),
        *("01ff010d", "01ff0207080c", "01ff02070d", "01ff020708", "01ff020d0c", "01ff02000c", "01ff022f0c"),
        *("01040107", "0104020 70c".replace(" ", ""), "01fe02070c"),
    ],
)
def test_no_command_is_sent_when_the_message_is_none_of_ours(
    ground: Ground, ready: State, turning: State, payload: str
) -> None:
    for state in (ready, turning):
        ground.go_back(state)
        assert not ground.ask(Request(Msp.SEND_DSHOT_COMMAND, bytes.fromhex(payload)))
        assert all(value in (0, TURNS) for seen in values(ground, 60) for value in seen)


def test_a_command_is_refused_to_another_peer_while_a_wizard_turns_motors(
    ground: Ground, turning: State
) -> None:
    for request in (NORMAL_ALL, Request(Msp.DSHOT_COMMAND, b"\xff\x07")):
        ground.go_back(turning)
        assert not ground.ask(request, port=1)
        assert values(ground, 60) == [[TURNS] * 4]


def test_a_stop_command_ends_both_commands(ground: Ground, ready: State) -> None:
    ground.go_back(ready)
    assert ground.ask(NORMAL_ALL)
    ground.run(12)
    assert ground.ask(Request(Msp.SEND_DSHOT_COMMAND, bytes.fromhex("01ff0100")))
    ground.run(1)
    assert values(ground, 100) == [STANDING]


def test_the_wizards_do_nothing_when_armed(ground: Ground, ready: State) -> None:
    ground.go_back(ready)
    ground.ask(UNLOCK)
    ground.run(2)
    ground.take_off()
    flying = ground.motors
    assert ground.ask(LOCK)
    for request in (ALL, ONE, REVERSE_SECOND):
        assert not ground.ask(request)
    assert ground.run(100) == flying
