"""The client over a scripted line with its own clock, and over a real socket."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.flash.board.info import read_info
from neuroflight.flash.link.client import Client, NoAnswerError
from neuroflight.flash.link.msp import Decoder, Direction, Message, Version, encode, error, reply, request
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain.contract import Msp, Refusal
from neuroflight.toolchain.errors import LinkError
from tests.flash.peers import answering

Lines = Callable[[list[bytes | None]], Any]

ASKED = request(Msp.FC_VARIANT)
ANSWER = encode(reply(ASKED, b"NRFL"))
SILENCE = None


def ask(line: Any, **limits: Any) -> bytes:
    return Client(line, clock=line.clock).request(Msp.FC_VARIANT, **limits)


def failure(line: Any, **limits: Any) -> str:
    """The one line that asking ends in."""
    with pytest.raises(LinkError) as caught:
        ask(line, **limits)
    text = str(caught.value)
    assert "\n" not in text and text.startswith("test line: ") and "expected a reply" in text
    return text


# --- A reply comes ---------------------------------------------------------------------------
@pytest.mark.parametrize(
    "script",
    [
        [ANSWER],
        [ANSWER[i : i + 1] for i in range(len(ANSWER))],
        [b"boot: gyro ok\r\n\xff$M", ANSWER],
        [encode(ASKED), ANSWER],
        [encode(reply(request(Msp.API_VERSION), b"\0\1\56")) + ANSWER],
        [ANSWER + b"$M>\x04"],
    ],
    ids=["whole", "byte-by-byte", "after-garbage", "after-echo", "after-a-late-reply", "trailing"],
)
def test_payload_is_returned_when_the_reply_comes(script: list[bytes | None], scripted_line: Lines) -> None:
    line = scripted_line(script)
    assert ask(line) == b"NRFL"
    assert line.written == [encode(ASKED)]


def test_second_try_succeeds_when_the_first_meets_silence(scripted_line: Lines) -> None:
    line = scripted_line([SILENCE, ANSWER])
    assert ask(line, timeout=0.5) == b"NRFL"
    assert len(line.written) == 2
    assert 0.5 <= line.now < 0.6


def test_second_try_succeeds_when_the_first_reply_is_damaged(scripted_line: Lines) -> None:
    damaged = ANSWER[:-1] + bytes([ANSWER[-1] ^ 1])
    assert ask(scripted_line([damaged, SILENCE, ANSWER])) == b"NRFL"


def test_reply_is_found_without_a_retry_when_it_hides_behind_a_false_header(scripted_line: Lines) -> None:
    line = scripted_line([b"$M>\x80\x05" + ANSWER, SILENCE])
    assert ask(line, retries=0) == b"NRFL"


def test_request_is_v2_when_the_command_needs_it(scripted_line: Lines) -> None:
    line = scripted_line([encode(Message(Version.V2, Direction.REPLY, Msp.POLICY_INFO, b"x"))])
    assert Client(line, clock=line.clock).request(Msp.POLICY_INFO, b"payload") == b"x"
    assert line.written[0].startswith(b"$X<\x00\x01\x4e\x07\x00payload")


# --- No reply comes --------------------------------------------------------------------------
def test_error_says_refused_and_asks_once_when_the_firmware_refuses(scripted_line: Lines) -> None:
    line = scripted_line([encode(error(ASKED))])
    assert "the firmware refuses MSP FC_VARIANT (2)" in failure(line)
    assert len(line.written) == 1


@pytest.mark.parametrize(
    ("command", "seconds"), [(Msp.NAME, 1), (Msp.EEPROM_WRITE, 5), (Msp.POLICY_SLOT_BEGIN, 5)]
)
def test_the_client_waits_longer_when_the_firmware_writes_flash(
    scripted_line: Lines, command: Msp, seconds: int
) -> None:
    line = scripted_line([])
    with pytest.raises(LinkError, match=f"within {seconds} s, asked 1 time"):
        Client(line, clock=line.clock).request(command, retries=0)
    assert line.now == pytest.approx(seconds)


def test_the_reason_is_told_when_the_firmware_gives_one(scripted_line: Lines) -> None:
    refused = Message(Version.V2, Direction.ERROR, Msp.POLICY_SLOT_END, struct.pack("<Bh", Refusal.BLOB, -10))
    line = scripted_line([encode(refused)])
    with pytest.raises(LinkError, match=r"refuses MSP POLICY_SLOT_END: the policy is none .* \(error -10\)"):
        Client(line, clock=line.clock).request(Msp.POLICY_SLOT_END)


def test_error_says_silence_when_nothing_comes(scripted_line: Lines) -> None:
    line = scripted_line([])
    text = failure(line, timeout=0.25, retries=3)
    assert "got silence" in text and "MSP FC_VARIANT within 0.25 s, asked 4 time(s)" in text
    assert line.written == [encode(ASKED)] * 4
    assert line.now == pytest.approx(1.0)


def test_error_counts_corrupt_frames_when_every_reply_is_damaged(scripted_line: Lines) -> None:
    damaged = ANSWER[:-1] + bytes([ANSWER[-1] ^ 1])
    text = failure(scripted_line([damaged, SILENCE] * 3))
    assert "got 3 corrupt frame(s), the last with wrong checksum" in text and "baud rate" in text


def test_error_says_cut_short_when_replies_never_end(scripted_line: Lines) -> None:
    assert "the last with frame cut short" in failure(scripted_line([ANSWER[:-2], SILENCE] * 3))


def test_error_says_no_msp_when_the_line_talks_something_else(scripted_line: Lines) -> None:
    text = failure(scripted_line([b"login: ", SILENCE] * 3))
    assert "got 21 bytes that are no MSP" in text and "MSP port" in text


def test_client_gives_up_in_time_when_the_line_never_stops_talking(scripted_line: Lines) -> None:
    line = scripted_line([b"noise"] * 10_000)
    assert "bytes that are no MSP" in failure(line, timeout=0.1, retries=1)
    assert line.now < 0.21


def test_line_is_closed_when_the_client_leaves_its_block(scripted_line: Lines) -> None:
    line = scripted_line([])
    with pytest.raises(LinkError), Client(line, clock=line.clock) as client:
        client.request(Msp.NAME)
    assert line.closed


# --- Asking again ----------------------------------------------------------------------------
def frames(written: list[bytes]) -> list[tuple[int, bytes]]:
    """Command and payload of each frame written."""
    events = Decoder().feed(b"".join(written))
    return [(event.command, event.payload) for event in events if isinstance(event, Message)]


@pytest.mark.parametrize(
    ("command", "payload", "times"),
    [
        (Msp.STATUS, b"", 3),
        (Msp.SETTING_GET, b"\x01\x00", 3),
        (Msp.FAULTS, b"", 3),
        (Msp.SETTING_SET, b"\x01\x00\x00\x00\x00\x00", 3),  # twice is as once
        (Msp.EEPROM_WRITE, b"", 3),
        (Msp.FAULTS, b"\x01\x00\x00\x00", 1),
        (Msp.ACKNOWLEDGE, b"", 1),
        (Msp.REBOOT, b"", 1),
        (Msp.SET_MOTOR, b"\xe8\x03", 1),
        (Msp.SET_RAW_RC, bytes(8), 1),
        (Msp.MOTOR_TEST, bytes(4), 1),
        (Msp.DSHOT_COMMAND, bytes(2), 1),
        (Msp.POLICY_SLOT_BEGIN, bytes(4), 1),
        (Msp.POLICY_SLOT_WRITE, bytes(8), 1),
        (Msp.POLICY_SLOT_END, b"", 1),
    ],
)
def test_a_command_is_asked_again_only_where_twice_is_as_once(
    scripted_line: Lines, command: Msp, payload: bytes, times: int
) -> None:
    line = scripted_line([])
    with pytest.raises(NoAnswerError, match=rf"asked {times} time") as caught:
        Client(line, clock=line.clock).request(command, payload)
    assert frames(line.written) == [(command, payload)] * times
    assert ("it may have been carried out" in str(caught.value)) == (times == 1)


def test_a_late_reply_is_not_taken_for_that_to_a_later_request(scripted_line: Lines) -> None:
    """The replies to the first request come late, both: they say nothing of the setting asked for next."""
    get = request(Msp.SETTING_GET)
    api = encode(reply(request(Msp.API_VERSION), b"\0\1\56"))
    line = scripted_line(
        [
            SILENCE,
            encode(reply(get, b"first")),
            encode(reply(get, b"first")),
            api,
            encode(reply(get, b"second")),
        ]
    )
    client = Client(line, clock=line.clock)
    assert client.request(Msp.SETTING_GET, b"\x01\x00") == b"first"
    assert client.request(Msp.SETTING_GET, b"\x02\x00") == b"second"
    asked = [(Msp.SETTING_GET, b"\x01\x00")] * 2 + [(Msp.API_VERSION, b""), (Msp.SETTING_GET, b"\x02\x00")]
    assert frames(line.written) == asked


def test_no_further_request_is_made_when_nothing_was_late(scripted_line: Lines) -> None:
    get = request(Msp.SETTING_GET)
    line = scripted_line([encode(reply(get, b"1")), encode(reply(get, b"2"))])
    client = Client(line, clock=line.clock)
    assert [client.request(Msp.SETTING_GET, bytes(2)) for _ in range(2)] == [b"1", b"2"]
    assert len(line.written) == 2


def test_messages_that_nobody_asked_for_are_kept_when_they_come_before_a_reply(scripted_line: Lines) -> None:
    unasked = [encode(Message(Version.V2, Direction.REPLY, Msp.RC, bytes([n]))) for n in range(3)]
    line = scripted_line([unasked[0] + unasked[1][:5], unasked[1][5:] + ANSWER + unasked[2], SILENCE])
    client = Client(line, clock=line.clock)
    assert client.request(Msp.FC_VARIANT) == b"NRFL"
    assert [client.receive(Msp.RC, 0.1) for _ in range(4)] == [b"\0", b"\1", b"\2", None]


# --- Over a real socket ----------------------------------------------------------------------
STATUS_EX = bytes.fromhex("f401 0000 2100 01000000 00 0a00 03 00 00 1d 05000080 00 2900")
BETAFLIGHT: dict[int, bytes] = {
    Msp.API_VERSION: b"\x00\x01\x2e",
    Msp.FC_VARIANT: b"BTFL",
    Msp.FC_VERSION: b"\x04\x05\x01",
    Msp.BOARD_INFO: b"S7X2\x00\x00\x02\x37\x09MATEKF722\x00\x04MTKS",
    Msp.BUILD_INFO: b"Jan  1 2025" + b"12:00:00" + b"0123abc",
    Msp.NAME: b"",
    Msp.STATUS_EX: STATUS_EX,
    Msp.UID: bytes(12),
}


def test_info_has_no_policy_and_bare_bits_when_the_firmware_is_of_another_make(
    tcp_server: Callable[..., str],
) -> None:
    with Client(open_transport(tcp_server(answering(BETAFLIGHT)))) as client:
        info = read_info(client)
    assert (info.variant, info.version, info.policy) == ("BTFL", "4.5.1", None)
    assert info.armed and info.control_period_us == 500
    assert info.arming_reasons == ("NO_GYRO", "RX_FAILSAFE", "BIT_31")


def test_betaflights_year_is_told_when_its_api_is_1_47(tcp_server: Callable[..., str]) -> None:
    newer: dict[int, bytes] = {Msp.API_VERSION: b"\x00\x01\x2f", Msp.FC_VERSION: b"\x19\x0c\x05\x092025.12.5"}
    with Client(open_transport(tcp_server(answering(BETAFLIGHT | newer)))) as client:
        info = read_info(client)
    assert (info.version, info.api.minor) == ("2025.12.5", 47)


def test_info_is_refused_when_the_api_is_of_another_major_version(tcp_server: Callable[..., str]) -> None:
    port = tcp_server(answering(BETAFLIGHT | {Msp.API_VERSION: b"\x00\x02\x00"}))
    with (
        Client(open_transport(port)) as client,
        pytest.raises(LinkError, match=r"speaks MSP 0\.2\.0, expected 0\.1\.x"),
    ):
        read_info(client)


def test_silence_times_out_when_a_tcp_server_never_answers(tcp_server: Callable[..., str]) -> None:
    port = tcp_server(lambda data: b"")
    with (
        Client(open_transport(port)) as client,
        pytest.raises(LinkError, match=r"got silence, expected a reply to MSP NAME within 0\.02 s"),
    ):
        client.request(Msp.NAME, timeout=0.02, retries=1)
