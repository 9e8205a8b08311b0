"""Whatever comes over a line: no motor turns, no flash is written where arming or interlock forbid it.

No list of commands is kept here: every number that MSP has is tried with payloads of every length, and what
changes something then is a command that acts. Each of those is tried with wrong lengths and checksums, cut
short, in between another peer's requests, and while something forbids it.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import pytest

from neuroflight.flash.link import requests
from neuroflight.flash.link.layouts import decode, encode
from neuroflight.flash.link.msp import Decoder, Message, Version
from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import (
    MOTOR_TEST_MAGIC,
    MOTOR_TEST_TIMEOUT_MS,
    MSP_PAYLOAD_MAX,
    SETTINGS,
    ArmingReason,
    Msp,
    Refusal,
    policy_header,
)
from neuroflight.toolchain.contract.msp_configuration import CONFIGURATIONS
from neuroflight.toolchain.contract.msp_layouts import Direction
from neuroflight.toolchain.contract.msp_messages import layout_of
from neuroflight.toolchain.policy.blob import pack
from tests.firmware.conftest import scripted_blob
from tests.firmware.images import header_of, make_image
from tests.firmware.joined.ground import API_VERSION, STANDING, Ground, Request, State

IMAGE = pack(replace(scripted_blob(), sequence=1))  # a policy that it takes
BANK_IMAGE = make_image(1, policy=policy_header(IMAGE))  # an image for its spare bank
SWITCH = Request(Msp.IMAGE_SWITCH, hashlib.sha256(BANK_IMAGE).digest())
LENGTHS = (*range(42), 64, 100, MSP_PAYLOAD_MAX)
FEW_LENGTHS = (0, 1, 2, 8)
OTHER_NUMBERS = (*range(256), *range(0x1000, 0x1010), *range(0x3000, 0x3010), *range(0x4E00, 0x4E70))
LAST_AT = (len(BANK_IMAGE) - 1) // 64 * 64
LAST_OF_IMAGE = Request(Msp.IMAGE_WRITE, struct.pack("<I", LAST_AT) + BANK_IMAGE[LAST_AT:])
STEP_MS = 30  # in which a request has its effect
HALF_READ_MAX = (MSP_PAYLOAD_MAX + 16) // len(API_VERSION)  # requests that one cut short can swallow
OPENERS = {
    Msp.MOTOR_TEST,
    Msp.ARMING_DISABLE,
}  # ours, and the ecosystem's as the app sends it for a motor test
TELLS_MOTORS = {Msp.DSHOT_COMMAND, Msp.SEND_DSHOT_COMMAND, Msp.SET_MOTOR}
SETTING = next(index for index, setting in enumerate(SETTINGS) if setting.name == "failsafe_delay_ms")
TEXT = next(index for index, setting in enumerate(SETTINGS) if setting.kind == "text")
SETS = {
    Msp.SET_MODE_RANGE,
    Msp.COMMON_SET_SERIAL_CONFIG,
}  # and those of fields: refused, a part of them counts
SETS |= {pair.request.message for pair in CONFIGURATIONS if pair.request is not None}
READS = [int(pair.reply.message) for pair in CONFIGURATIONS] + [int(Msp.MODE_RANGES)]


def made(command: Msp, **values: object) -> Request:
    """The request with these fields."""
    layout = layout_of(command, Direction.REQUEST)
    assert layout is not None
    return Request(command, encode(layout, values))


# What some commands want to see; others are found by their length, or by what their counterpart tells.
OPEN = Request(Msp.MOTOR_TEST, requests.motor_test(MOTOR_TEST_MAGIC))
TURN = Request(Msp.SET_MOTOR, requests.set_motor([1100, 1200, 1000, 1000]))
APP_OPENS = made(Msp.ARMING_DISABLE, disabled=0, runaway_off=1)
LOCKS = made(Msp.ARMING_DISABLE, disabled=1, runaway_off=0)
WIZARD = Request(Msp.SET_MOTOR, requests.set_motor([1055, 1000, 1000, 1000]))  # as the app's wizards give it
PORT = {"msp_baud": 5, "gps_baud": 0, "telemetry_baud": 0, "blackbox_baud": 14}  # 2 Mbaud
MEANT = [
    OPEN,
    TURN,
    APP_OPENS,
    LOCKS,
    WIZARD,
    Request(Msp.SET_MOTOR, requests.set_motor([1100] * 8)),
    Request(Msp.DSHOT_COMMAND, requests.dshot_command(contract.DshotCommand.BEACON_1)),
    made(Msp.SEND_DSHOT_COMMAND, type=1, motor=255, commands=[{"command": 1}]),
    made(Msp.SEND_DSHOT_COMMAND, type=1, motor=1, commands=[{"command": 8}, {"command": 12}]),
    Request(Msp.SETTING_SET, requests.setting_set(SETTING, 700, "uint32_t")),
    Request(Msp.SETTING_SET, requests.setting_set(TEXT, "NF", "text")),
    Request(Msp.POLICY_SLOT_BEGIN, struct.pack("<I", len(IMAGE))),
    Request(Msp.IMAGE_BEGIN, header_of(BANK_IMAGE)),
    made(Msp.SET_TEXT, kind=2, text="NF"),
    made(Msp.SET_MODE_RANGE, slot=9, mode=13, aux=3, low=20, high=30, logic=0, linked=0),
    made(Msp.SET_MOTOR_OUTPUT_REORDERING, outputs=[{"output": output} for output in (1, 0, 2, 3)]),
    made(Msp.COMMON_SET_SERIAL_CONFIG, ports=[{"port": 2, "functions": 1, **PORT}]),
    made(Msp.SET_RXFAIL_CONFIG, channel=0, mode=0, value=1500),
]


def payloads(lengths: tuple[int, ...]) -> Iterator[bytes]:
    """Of each length: zeros, and bytes that count up."""
    for length in lengths:
        yield bytes(length)
        if length:
            yield (bytes(range(1, 256)) * 3)[:length]


@pytest.fixture(scope="module")
def ready(ground: Ground) -> State:
    """The switch would arm it."""
    ground.get_ready()
    for port in range(contract.MSP_PORT_COUNT):  # some changes are taken only of a peer that has read before
        for command in READS:
            ground.ask(Request(command), port)
    return ground.keep()


@pytest.fixture(scope="module")
def every_request(ground: Ground, ready: State) -> list[Request]:
    """All numbers: those of the contract with every length, and what they tell with one byte another."""
    known = [Request(int(number), data) for number in Msp for data in payloads(LENGTHS)]
    others = set(OTHER_NUMBERS) - {int(number) for number in Msp}
    unknown = [Request(number, data) for number in others for data in payloads(FEW_LENGTHS)]
    return [*MEANT, *changed(ground, ready), *known, *unknown]


def changed(ground: Ground, ready: State) -> Iterator[Request]:
    """Each configuration as it is told, and with a byte that is one more or less."""
    for pair in CONFIGURATIONS:
        if pair.request is None:
            continue
        ground.go_back(ready)
        (told,) = Decoder().feed(ground.send(Request(pair.reply.message).frame()))
        assert isinstance(told, Message)
        values, names = decode(pair.reply, told.payload), {field.name for field in pair.request.fields}
        same = encode(pair.request, {name: value for name, value in values.items() if name in names})
        yield Request(pair.request.message, same)
        for at, step in product(range(len(same)), (1, -1)):
            other = bytearray(same)
            other[at] = (other[at] + step) % 256
            yield Request(pair.request.message, bytes(other))


@pytest.fixture(scope="module")
def flying(ground: Ground, ready: State) -> State:
    """Armed, motors turning."""
    ground.go_back(ready)
    ground.take_off()
    return ground.keep()


@pytest.fixture(scope="module")
def under_test(ground: Ground, ready: State) -> State:
    """A motor test is open, and a motor turns."""
    ground.go_back(ready)
    assert ground.ask(OPEN)
    ground.run(5)
    assert ground.ask(TURN)
    assert ground.run(5) != STANDING
    return ground.keep()


@pytest.fixture(scope="module")
def under_app_test(ground: Ground, ready: State) -> State:
    """The same, opened as the app does."""
    ground.go_back(ready)
    assert ground.ask(APP_OPENS)
    ground.run(5)
    assert ground.ask(TURN)
    assert ground.run(5) != STANDING
    return ground.keep()


@pytest.fixture(scope="module")
def locked(ground: Ground, ready: State) -> State:
    """Return a state in which a peer holds the arming lock, as the app does while connected."""
    ground.go_back(ready)
    assert ground.ask(LOCKS)
    return ground.keep()


@pytest.fixture(scope="module")
def slot_begun(ground: Ground, ready: State) -> State:
    """A slot is erased, and a policy is written into it but for its end."""
    ground.go_back(ready)
    assert ground.ask(Request(Msp.POLICY_SLOT_BEGIN, struct.pack("<I", len(IMAGE))))
    for at in range(0, len(IMAGE) - 64, 64):
        assert ground.ask(Request(Msp.POLICY_SLOT_WRITE, struct.pack("<I", at) + IMAGE[at : at + 64]))
    return ground.keep()


@pytest.fixture(scope="module")
def slot_full(ground: Ground, slot_begun: State) -> State:
    """All of it is written."""
    ground.go_back(slot_begun)
    at = (len(IMAGE) - 1) // 64 * 64
    assert ground.ask(Request(Msp.POLICY_SLOT_WRITE, struct.pack("<I", at) + IMAGE[at:]))
    return ground.keep()


@pytest.fixture(scope="module")
def image_begun(ground: Ground, ready: State) -> State:
    """The spare bank is erased, and an image is written into it but for its end."""
    ground.go_back(ready)
    assert ground.ask(Request(Msp.IMAGE_BEGIN, header_of(BANK_IMAGE)))
    for at in range(0, len(BANK_IMAGE) - 64, 64):
        assert ground.ask(Request(Msp.IMAGE_WRITE, struct.pack("<I", at) + BANK_IMAGE[at : at + 64]))
    return ground.keep()


@pytest.fixture(scope="module")
def image_full(ground: Ground, image_begun: State) -> State:
    """All of it is written, and was found whole."""
    ground.go_back(image_begun)
    assert ground.ask(LAST_OF_IMAGE)
    assert ground.ask(Request(Msp.IMAGE_END))
    return ground.keep()


@pytest.fixture(scope="module")
def slot_flown(ground: Ground, ready: State) -> State:
    """The policy in slot B flies, as after a restart with it; slot A has the one before."""
    ground.go_back(ready)
    ground.chip.fill(contract.FLASH_POLICY_SLOTS[1].address, IMAGE)
    ground.board.flash.operations += 1  # so that going back takes the flash along
    ground.background.slots.flown, ground.background.slots.sequence = 1, 1
    return ground.keep()


@dataclass(frozen=True)
class Act:
    """A request that changes something, and where it does."""

    where: State
    request: Request


def acts(ground: Ground, state: State, requests: Iterable[Request]) -> list[Request]:
    """Those of the requests that change something in that state: up to three of each command."""
    found: dict[int, list[Request]] = {}
    for request in requests:
        kept = found.setdefault(request.command, [])
        if len(kept) == 3:
            continue
        ground.go_back(state)
        before, motors = ground.seen, ground.motors
        ground.ask(request)
        if ground.seen != before or ground.run(STEP_MS) != motors or ground.seen != before:
            kept.append(request)
    return [request for kept in found.values() for request in kept]


@pytest.fixture(scope="module")
def acting(ground: Ground, ready: State, every_request: list[Request]) -> list[Request]:
    """Requests that change something on the ground, with no other before them."""
    return acts(ground, ready, every_request)


@pytest.fixture(scope="module")
def everywhere(
    ground: Ground,
    ready: State,
    under_test: State,
    locked: State,
    slot_begun: State,
    slot_full: State,
    image_begun: State,
    image_full: State,
    slot_flown: State,
    acting: list[Request],
) -> list[Act]:
    """Those, and requests that change something only after others."""
    at = (len(IMAGE) - 1) // 64 * 64
    last = Request(Msp.POLICY_SLOT_WRITE, struct.pack("<I", at) + IMAGE[at:])
    after = [
        (under_test, TURN),
        (locked, WIZARD),
        (slot_begun, last),
        (slot_full, Request(Msp.POLICY_SLOT_END)),
    ]
    after += [(image_begun, LAST_OF_IMAGE), (image_full, SWITCH)]
    after += [(slot_flown, Request(Msp.POLICY_SLOT_REVERT))]
    for state, request in after:
        assert acts(ground, state, [request]) == [request]
    return [Act(ready, request) for request in acting] + [Act(*one) for one in after]


def frames(request: Request) -> list[bytes]:
    """The request in each version that can say it."""
    versions = [Version.V2] + ([Version.V1] if request.command < 255 else [])
    return [request.frame(version) for version in versions]


def test_each_command_of_the_contract_is_carried_out_with_some_payload(
    ground: Ground, ready: State, every_request: list[Request]
) -> None:
    """Else the tests below do not reach it, and it needs a row in MEANT."""
    needs_another = {
        *(Msp.POLICY_SLOT_WRITE, Msp.POLICY_SLOT_END, Msp.POLICY_SLOT_REVERT, Msp.SET_RAW_RC, Msp.SET_MOTOR),
        *(Msp.IMAGE_WRITE, Msp.IMAGE_END, Msp.IMAGE_HASH, Msp.IMAGE_SWITCH),
        *(Msp.LOG_ENTRY, Msp.LOG_READ, Msp.LOG_ERASE),  # another bench, with a device that keeps logs
    }
    accepted = set()
    for request in every_request:
        if request.command not in accepted:
            ground.go_back(ready)
            if ground.ask(request):
                accepted.add(request.command)
    no_request = {Msp.STREAM_SAMPLE}
    assert set(Msp) - accepted <= needs_another | no_request


def test_the_commands_that_act_are_found(acting: list[Request]) -> None:
    found = {request.command for request in acting}
    assert {Msp.EEPROM_WRITE, Msp.SETTING_SET, Msp.MOTOR_TEST, Msp.DSHOT_COMMAND, Msp.REBOOT} <= found
    assert {Msp.POLICY_SLOT_BEGIN, Msp.IMAGE_BEGIN} <= found
    assert not found & {Msp.API_VERSION, Msp.STATUS, Msp.TASKS, Msp.SETTING_INFO, Msp.SETTING_GET}


def test_nothing_is_written_and_no_motor_changes_when_any_request_comes_in_flight(
    ground: Ground, flying: State, every_request: list[Request]
) -> None:
    ground.go_back(flying)
    before, motors = ground.seen, ground.motors
    assert min(motors) > contract.DSHOT_MIN
    for count, request in enumerate(every_request):
        ground.ask(request, port=count % 2)
        if count % 16 == 0:
            assert ground.run(1) == motors, request
        assert ground.armed
        # What forbids the next arming may change, and channels may be told: neither is anything to a flight.
        after = replace(ground.seen, forbidden=before.forbidden, posted=before.posted)
        assert after == before, request
    assert ground.run(STEP_MS) == motors
    assert ground.answers(0) and ground.answers(1)


def test_nothing_happens_when_the_checksum_is_wrong(ground: Ground, everywhere: list[Act]) -> None:
    for act in everywhere:
        request = act.request
        for frame in frames(request):
            ground.go_back(act.where)
            before, motors = ground.seen, ground.motors
            for wrong in (1, 0x80, 0xFF):
                assert ground.send(frame[:-1] + bytes([frame[-1] ^ wrong])) == b""
            assert ground.seen == before, request
            assert ground.answers()
            assert ground.run(STEP_MS) == motors
            assert ground.seen == before


def test_nothing_happens_when_a_byte_within_a_frame_is_another(ground: Ground, everywhere: list[Act]) -> None:
    """One byte of version 2, whose checksum sees it. The peer then pauses, as it gets no answer."""
    for act in everywhere:
        request = act.request
        frame = request.frame()
        for at in range(len(frame)):
            ground.go_back(act.where)
            before = ground.seen
            ground.send(frame[:at] + bytes([frame[at] ^ 0x11]) + frame[at + 1 :])
            ground.pause()
            assert ground.seen == before, (request, at)
            assert ground.answers()


@pytest.mark.parametrize("then", ["pause", "leave"])
def test_nothing_happens_and_the_line_goes_on_when_a_frame_is_abandoned(
    ground: Ground, everywhere: list[Act], then: str
) -> None:
    for act in everywhere:
        request = act.request
        for frame in frames(request):
            for length in range(1, len(frame)):
                ground.go_back(act.where)
                before = ground.seen
                if then == "leave":  # its lock and its motor test go with it
                    reasons, wish = before.forbidden & ~(1 << ArmingReason.MSP), before.wish + before.wish % 2
                    before = replace(before, forbidden=reasons, wish=wish)
                assert ground.send(frame[:length]) == b""
                getattr(ground, then)()
                assert ground.seen == before, (request, length)
                assert ground.answers(0)
                assert ground.answers(1)


def test_the_line_goes_on_when_a_frame_is_abandoned_and_nobody_pauses(
    ground: Ground, everywhere: list[Act]
) -> None:
    longest = [Act(act.where, Request(act.request.command, bytes(MSP_PAYLOAD_MAX))) for act in everywhere]
    for act in everywhere + longest:
        request = act.request
        for frame in frames(request):
            for length in {3, 4, 5, 6, 7, 8, len(frame) // 2, len(frame) - 1}:
                ground.go_back(act.where)
                motors = ground.motors
                ground.send(frame[:length])
                assert any(ground.answers() for _ in range(HALF_READ_MAX + 1)), (request, length)
                assert ground.run(1) == motors


def test_a_request_does_what_it_does_alone_when_another_peer_speaks_in_between(
    ground: Ground, everywhere: list[Act]
) -> None:
    for act in everywhere:
        request = act.request
        frame = request.frame()
        ground.go_back(act.where)
        alone = ground.send(frame), ground.seen
        ground.go_back(act.where)
        said, heard = b"", b""
        for at in range(max(len(frame), len(API_VERSION))):
            said += ground.send(frame[at : at + 1], port=0)
            heard += ground.send(API_VERSION[at : at + 1], port=1)
        assert heard.startswith(b"$M>\x03\x01") and len(heard) == 9, request
        assert (said, ground.seen) == alone, request


def test_two_peers_do_not_mix_when_both_are_cut_short(ground: Ground, everywhere: list[Act]) -> None:
    """Each port gets the first half of a frame and then the other port's second half."""
    for act in everywhere:
        request = act.request
        frame, ground_frame = request.frame(), Request(Msp.SETTING_GET, bytes(2)).frame()
        half = len(frame) // 2
        ground.go_back(act.where)
        before = ground.seen
        ground.send(frame[:half], port=0)
        ground.send(ground_frame[:5], port=1)
        ground.send(frame[half:], port=1)
        ground.pause(0)
        ground.pause(1)
        assert ground.seen == before, request
        assert ground.answers(0) and ground.answers(1)


def test_a_refused_request_changes_nothing_when_its_length_is_another(
    ground: Ground, everywhere: list[Act]
) -> None:
    for act in everywhere:
        request = act.request
        shorter = [request.payload[:length] for length in range(len(request.payload))]
        longer = [request.payload + bytes(more) for more in (1, 2, 3, 64)]
        for data in (*shorter, *longer):
            ground.go_back(act.where)
            before, motors = ground.seen, ground.motors
            if not ground.ask(Request(request.command, data)):
                after = ground.seen
                if request.command in SETS and ground.reason != Refusal.PAYLOAD:  # the rest of it counts
                    after = replace(after, settings=before.settings)
                assert after == before, (request, data)
            told = OPENERS | TELLS_MOTORS
            assert ground.run(STEP_MS) == motors or request.command in told
            assert ground.answers()


def turns(ground: Ground) -> bool:
    """Does a motor turn within a while? Commands to its controller do not turn it."""
    return any(value >= contract.DSHOT_MIN for _ in range(STEP_MS) for value in ground.run(1))


def test_no_two_requests_turn_a_motor_but_those_of_a_motor_test(
    ground: Ground, ready: State, acting: list[Request]
) -> None:
    tried = [*acting, *(request for request in MEANT if request not in acting)]
    turned = set()
    for first in tried:
        for second in tried:
            ground.go_back(ready)
            ground.ask(first)
            ground.run(2)
            ground.ask(second)
            if turns(ground):
                turned.add((first.command, second.command))
    assert (Msp.MOTOR_TEST, Msp.SET_MOTOR) in turned
    assert turned <= {(opener, Msp.SET_MOTOR) for opener in OPENERS}


@pytest.mark.parametrize("then", ["nothing", "pause", "leave"])
def test_motors_stop_within_the_time_out_when_a_motor_test_is_left_alone(
    ground: Ground, under_test: State, then: str
) -> None:
    ground.go_back(under_test)
    if then != "nothing":
        getattr(ground, then)()
    assert ground.run(MOTOR_TEST_TIMEOUT_MS + 1) == STANDING
    assert ground.run(MOTOR_TEST_TIMEOUT_MS) == STANDING
    assert ground.answers(0) and ground.answers(1)


@pytest.mark.parametrize("then", ["nothing", "leave"])
def test_motors_stop_within_the_time_out_when_the_app_goes(
    ground: Ground, under_app_test: State, then: str
) -> None:
    """While it asks for anything the test goes on; another peer's requests are none of its."""
    ground.go_back(under_app_test)
    turning = ground.motors
    for _ in range(20):
        assert ground.ask(Request(Msp.STATUS_EX), port=0)
        assert ground.run(MOTOR_TEST_TIMEOUT_MS // 5) == turning
    if then == "leave":
        ground.leave(0)
    for _ in range(6):
        ground.ask(Request(Msp.STATUS_EX), port=1)
        ground.run(MOTOR_TEST_TIMEOUT_MS // 5)
    assert ground.motors == STANDING
    assert ground.answers(0) and ground.answers(1)


def test_no_request_of_another_peer_writes_flash_when_a_motor_test_is_open(
    ground: Ground, under_test: State, every_request: list[Request]
) -> None:
    ground.go_back(under_test)
    before = ground.seen
    for request in every_request:
        if request.command in OPENERS | {Msp.SET_MOTOR}:
            continue
        ground.ask(request, port=1)
        assert ground.seen.flash_operations == before.flash_operations, request
        assert not ground.seen.rebooting, request


def test_values_are_refused_when_they_turn_motors_faster_than_a_test_may(
    ground: Ground, under_test: State
) -> None:
    limit = round(1000 + 1000 * contract.MOTOR_TEST_MAX)
    for values in ([limit + 1], [2000] * 4, [1400] * 4, [1], [999], [2001], [65535], [1100] * 5, [1100] * 8):
        ground.go_back(under_test)
        before = ground.run(1)
        assert not ground.ask(Request(Msp.SET_MOTOR, struct.pack(f"<{len(values)}H", *values))), values
        assert ground.run(5) == before


def test_motors_stop_and_nothing_turns_them_when_the_arm_switch_goes_on_in_a_test(
    ground: Ground, under_test: State, acting: list[Request]
) -> None:
    ground.go_back(under_test)
    ground.channels[contract.CHANNEL_ARM] = contract.CHANNEL_MAX_US
    assert ground.run(STEP_MS) == STANDING
    switched = ground.keep()
    for first in (*acting, *MEANT):
        ground.go_back(switched)
        ground.ask(first)
        ground.run(2)
        ground.ask(TURN)
        assert not turns(ground), first


def test_nothing_arms_and_nothing_turns_when_a_reboot_is_under_way(
    ground: Ground, ready: State, acting: list[Request]
) -> None:
    ground.go_back(ready)
    assert ground.ask(Request(Msp.REBOOT))
    rebooting = ground.keep()
    for opener in (OPEN, APP_OPENS, LOCKS):
        ground.go_back(rebooting)
        ground.ask(opener)
        ground.ask(WIZARD)
        assert not turns(ground), opener
    for request in acting:
        ground.go_back(rebooting)
        ground.ask(request)
        ground.channels[contract.CHANNEL_ARM] = contract.CHANNEL_MAX_US
        ground.run(STEP_MS)
        assert not ground.armed, request
