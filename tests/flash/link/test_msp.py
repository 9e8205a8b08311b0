"""The MSP codec against known frames, against yamspy, in pieces, corrupted, and on arbitrary bytes."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from yamspy import MSPy

from neuroflight.flash.link.msp import (
    FRAME_OVERHEAD_MAX,
    Corrupt,
    Decoder,
    Direction,
    Event,
    Message,
    Reason,
    Version,
    crc8_dvb_s2,
    encode,
    error,
    reply,
    request,
)

V1, V2 = Version.V1, Version.V2
REQUEST, REPLY, ERROR = Direction.REQUEST, Direction.REPLY, Direction.ERROR

# Frames printed in public descriptions of the protocol.
KNOWN_FRAMES = {
    "api-version-request": ("24 4D 3C 00 01 01", Message(V1, REQUEST, 1)),
    "ident-request": ("24 4D 3C 00 64 64", Message(V1, REQUEST, 100)),
    "ident-request-v2": ("24 58 3C 00 64 00 00 00 8F", Message(V2, REQUEST, 100)),
    "hello-v2": (  # with flags 0xA5, which we ignore
        "24 58 3C A5 42 42 12 00 48 65 6C 6C 6F 20 66 6C 79 69 6E 67 20 77 6F 72 6C 64 82",
        Message(V2, REQUEST, 0x4242, b"Hello flying world"),
    ),
}

MESSAGES = {
    "v1-empty": Message(V1, REQUEST, 1),
    "v1-reply": Message(V1, REPLY, 2, b"NRFL"),
    "v1-error": Message(V1, ERROR, 254),
    "v1-longest": Message(V1, REPLY, 10, bytes(range(254))),
    "v1-shortest-jumbo": Message(V1, REPLY, 10, bytes(255)),
    "v1-jumbo": Message(V1, REPLY, 10, bytes(range(256)) * 2),
    "v2-empty": Message(V2, REQUEST, 0x4E01),
    "v2-reply": Message(V2, REPLY, 0x4E01, b"$M<\x00\x01\x01"),
    "v2-error": Message(V2, ERROR, 0xFFFF),
    "v2-longest": Message(V2, REPLY, 1, bytes(range(256)) * 2),
}
every_message = pytest.mark.parametrize("message", MESSAGES.values(), ids=MESSAGES)


def decode(stream: bytes, piece: int = 1 << 20) -> tuple[list[Event], Decoder]:
    """Events of `stream`, fed in pieces of so many bytes and then flushed."""
    decoder = Decoder()
    events: list[Event] = []
    for start in range(0, len(stream), piece):
        events += decoder.feed(stream[start : start + piece])
    return events + decoder.flush(), decoder


def messages(events: list[Event]) -> list[Message]:
    return [event for event in events if isinstance(event, Message)]


# --- Known frames and an independent peer ----------------------------------------------------
@pytest.mark.parametrize(("frame", "message"), KNOWN_FRAMES.values(), ids=KNOWN_FRAMES)
def test_message_is_read_when_frame_is_published(frame: str, message: Message) -> None:
    assert Decoder().feed(bytes.fromhex(frame)) == [message]


@pytest.mark.parametrize("name", ["api-version-request", "ident-request", "ident-request-v2"])
def test_frame_is_the_published_one_when_encoded(name: str) -> None:
    frame, message = KNOWN_FRAMES[name]
    assert encode(message) == bytes.fromhex(frame)


def test_crc_is_the_catalogued_check_value_when_over_the_nine_digits() -> None:
    assert crc8_dvb_s2(b"123456789") == 0xBC


@every_message
def test_yamspy_reads_the_same_when_we_encode(message: Message, yamspy_peer: MSPy) -> None:
    yamspy_peer.conn.incoming = encode(message)
    heard = yamspy_peer.receive_msg()
    if message.direction is ERROR:
        assert heard["unsupported"] == 1
    else:
        assert (heard["msp_version"], heard["code"]) == (message.version, message.command)
        assert bytes(heard["dataView"] or b"") == message.payload
        assert not heard["crcError"] and not heard["packet_error"]


@pytest.mark.parametrize("command", [1, 101, 150, 254, 0x4E01, 0xFFFF])
@pytest.mark.parametrize("payload", [b"", b"\x01", bytes(range(200))], ids=["empty", "byte", "200-bytes"])
def test_we_read_the_same_when_yamspy_encodes(command: int, payload: bytes, yamspy_peer: MSPy) -> None:
    yamspy_peer.send_RAW_msg(command, data=payload)
    assert Decoder().feed(yamspy_peer.conn.written) == [request(command, payload)]


# --- Whole, in pieces, between noise ---------------------------------------------------------
@every_message
def test_message_comes_back_when_encoded_and_fed_whole(message: Message) -> None:
    decoder = Decoder()
    assert decoder.feed(encode(message)) == [message]
    assert (decoder.pending, decoder.skipped) == (0, 0)


@every_message
def test_message_comes_with_its_last_byte_when_fed_byte_by_byte(message: Message) -> None:
    decoder, frame = Decoder(), encode(message)
    for byte in frame[:-1]:
        assert decoder.feed(bytes([byte])) == []
    assert decoder.feed(frame[-1:]) == [message]


@every_message
def test_message_is_read_when_noise_stands_before_and_behind(message: Message) -> None:
    before, behind = b"\x00boot: ok\r\n$", b"$$M$X?trailing"
    events, decoder = decode(before + encode(message) + behind)
    assert events == [message]
    assert decoder.skipped == len(before) + len(behind)


def test_all_messages_come_in_order_when_sent_back_to_back() -> None:
    stream = b"".join(encode(message) for message in MESSAGES.values())
    assert Decoder().feed(stream) == list(MESSAGES.values())


# --- Corruption ------------------------------------------------------------------------------
@every_message
def test_no_message_but_the_next_when_a_checked_bit_is_flipped(message: Message) -> None:
    follower = Message(V2, REPLY, 0x1234, b"next")
    frame = encode(message)
    step = max(1, len(frame) // 40)  # long frames are sampled
    for place in sorted({*range(3, len(frame), step), len(frame) - 1}):
        for bit in range(8):
            damaged = bytearray(frame)
            damaged[place] ^= 1 << bit
            events, _ = decode(bytes(damaged) + encode(follower))
            assert message not in events
            assert messages(events)[-1] == follower
            assert any(isinstance(event, Corrupt) for event in events)


def test_reason_is_checksum_when_the_payload_is_damaged() -> None:
    frame = bytearray(encode(Message(V1, REPLY, 2, b"NRFL")))
    frame[5] ^= 0x10
    (event,) = Decoder().feed(bytes(frame))
    assert isinstance(event, Corrupt) and event.reason is Reason.CHECKSUM
    assert "command 2" in event.detail and "expected 0x" in event.detail


@pytest.mark.parametrize(
    "header",
    [b"$M>\xff\x0a\x01\x02", b"$X>\x00\x0a\x00\x01\x02", b"$X>\x00\x0a\x00\xff\xff"],
    ids=["jumbo-513", "v2-513", "v2-65535"],
)
def test_frame_is_refused_at_its_header_when_it_announces_too_much(header: bytes) -> None:
    decoder = Decoder()
    (event,) = decoder.feed(header)
    assert isinstance(event, Corrupt) and event.reason is Reason.TOO_LONG
    assert decoder.feed(encode(MESSAGES["v1-reply"])) == [MESSAGES["v1-reply"]]


def test_payload_limit_is_obeyed_when_given() -> None:
    at_limit, over = Message(V2, REPLY, 1, bytes(8)), Message(V2, REPLY, 1, bytes(9))
    assert Decoder(payload_max=8).feed(encode(at_limit)) == [at_limit]
    assert not messages(Decoder(payload_max=8).feed(encode(over)))


@every_message
def test_reason_is_truncated_when_the_line_falls_silent_in_a_frame(message: Message) -> None:
    decoder = Decoder()
    assert decoder.feed(encode(message)[:-1]) == []
    first = decoder.flush()[0]
    assert isinstance(first, Corrupt) and first.reason is Reason.TRUNCATED
    assert decoder.pending == 0


def test_true_frame_is_found_when_it_hides_in_the_length_of_a_false_one() -> None:
    decoder, message = Decoder(), MESSAGES["v1-reply"]
    assert decoder.feed(b"$X>\x00\x01\x00\x40\x00" + encode(message)) == []
    assert messages(decoder.flush()) == [message]


# --- Arbitrary bytes -------------------------------------------------------------------------
def arbitrary_stream(rng: random.Random) -> bytes:
    """Frames, torn frames, damaged frames, frame-like bytes and noise, shuffled together."""
    parts = []
    for _ in range(rng.randrange(1, 30)):
        message = replace(rng.choice(list(MESSAGES.values())), payload=rng.randbytes(rng.randrange(40)))
        frame = bytearray(encode(message))
        kind = rng.randrange(5)
        if kind == 1:
            frame = frame[: rng.randrange(len(frame))]
        elif kind == 2:
            frame[rng.randrange(len(frame))] = rng.randrange(256)
        elif kind == 3:
            frame = bytearray(rng.choices(b"$$MMXX<>!\x00\x01\xff", k=rng.randrange(30)))
        elif kind == 4:
            frame = bytearray(rng.randbytes(rng.randrange(60)))
        parts.append(bytes(frame))
    return b"".join(parts)


@pytest.mark.parametrize("seed", range(40))
def test_events_are_the_same_when_the_stream_is_cut_differently(seed: int) -> None:
    stream = arbitrary_stream(random.Random(seed))
    whole, decoder = decode(stream)
    for piece in (1, 2, 3, 7, 64):
        events, other = decode(stream, piece)
        assert (events, other.skipped) == (whole, decoder.skipped)


@pytest.mark.parametrize("seed", range(40))
def test_each_byte_is_in_a_message_or_skipped_when_the_stream_is_arbitrary(seed: int) -> None:
    stream = arbitrary_stream(random.Random(seed))
    events, decoder = decode(stream)
    assert sum(len(encode(message)) for message in messages(events)) + decoder.skipped == len(stream)
    assert decoder.pending == 0


def test_memory_stays_bounded_when_random_bytes_never_end() -> None:
    rng, decoder = random.Random(1), Decoder()
    for _ in range(300):
        decoder.feed(bytes(rng.choices(b"$$$MMXX<>!\x00\x01\xff", k=100)))
        decoder.feed(rng.randbytes(100))
        assert decoder.pending <= FRAME_OVERHEAD_MAX + 512


# --- Building messages -----------------------------------------------------------------------
def test_version_is_the_least_that_can_say_it_when_a_request_is_built() -> None:
    assert [request(command).version for command in (0, 254, 255, 0x4E01)] == [V1, V1, V2, V2]


@pytest.mark.parametrize("command", [1, 0x4E01])
def test_answers_name_the_request_when_built_from_it(command: int) -> None:
    asked = request(command, b"?")
    assert reply(asked, b"!") == Message(asked.version, REPLY, command, b"!")
    assert error(asked) == Message(asked.version, ERROR, command)


@pytest.mark.parametrize(
    "message",
    [
        Message(V1, REQUEST, 255),
        Message(V1, REQUEST, -1),
        Message(V2, REQUEST, 0x10000),
        Message(V2, REPLY, 1, bytes(1 << 16)),
    ],
    ids=["v1-255", "negative", "v2-65536", "too-long"],
)
def test_encoding_is_refused_when_no_frame_can_carry_it(message: Message) -> None:
    with pytest.raises(ValueError, match="expected"):
        encode(message)
