"""The firmware and the Python client agree on frames: a thousand of each kind, cut anywhere."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from neuroflight.flash.link.msp import (
    JUMBO_MARK,
    V1_COMMAND_MAX,
    Decoder,
    Direction,
    Message,
    Version,
    encode,
)
from neuroflight.toolchain.contract import MSP_PAYLOAD_MAX
from tests.firmware.conftest import Core
from tests.sampling import examples

REPLY_MAX = 240  # MSP_REPLY_MAX of msp.h
THOUSAND = settings(
    max_examples=examples(1000), deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)
NOISE = st.binary(max_size=20).map(lambda data: data.replace(b"$", b"#"))


@dataclass(frozen=True)
class Kind:
    """A form of frame: which commands and how long a payload it carries."""

    version: Version
    commands: tuple[int, int]
    sizes: tuple[int, int]

    def messages(self, directions: list[Direction]) -> st.SearchStrategy[Message]:
        """Messages of this form."""
        low, high = self.sizes
        return st.builds(
            Message,
            st.just(self.version),
            st.sampled_from(directions),
            st.integers(*self.commands),
            st.integers(low, high).flatmap(lambda size: st.binary(min_size=size, max_size=size)),
        )


KINDS = {
    "v1": Kind(Version.V1, (0, V1_COMMAND_MAX), (0, JUMBO_MARK - 1)),
    "jumbo": Kind(Version.V1, (0, V1_COMMAND_MAX), (JUMBO_MARK, MSP_PAYLOAD_MAX)),
    "v2": Kind(Version.V2, (0, 0xFFFF), (0, MSP_PAYLOAD_MAX)),
}
REPLIES = {
    "v1": Kind(Version.V1, (0, V1_COMMAND_MAX), (0, REPLY_MAX)),
    "v2": Kind(Version.V2, (0, 0xFFFF), (0, REPLY_MAX)),
}


def pieces(stream: bytes, cuts: list[int]) -> list[bytes]:
    """The stream in pieces that end there."""
    ends = sorted({cut % (len(stream) + 1) for cut in cuts} | {0, len(stream)})
    return [stream[begin:end] for begin, end in pairwise(ends)]


def read_by_core(core: Core, stream: bytes) -> list[Message]:
    """Requests that the firmware finds."""
    parser, found = core.new("struct msp *"), []
    core.lib.msp_reset(parser)
    for byte in stream:
        if core.lib.msp_push(parser, byte):
            payload = bytes(core.ffi.buffer(parser.payload, parser.size))
            version = Version(parser.version)
            found.append(Message(version, Direction.REQUEST, parser.command, payload))
    return found


def written_by_core(core: Core, message: Message, capacity: int = 1024) -> bytes:
    """The frame of a reply, as the firmware makes it."""
    frame = core.new("uint8_t[]", capacity)
    refused, size = message.direction is Direction.ERROR, len(message.payload)
    parts = (int(message.version), message.command, refused, message.payload, size)
    return bytes(core.ffi.buffer(frame, core.lib.msp_frame(*parts, frame, capacity)))


@pytest.mark.parametrize("kind", KINDS)
def test_the_core_reads_what_the_client_writes(scripted: Core, kind: str) -> None:
    messages = st.lists(st.tuples(NOISE, KINDS[kind].messages([Direction.REQUEST])), min_size=1, max_size=3)

    @THOUSAND
    @given(messages, NOISE)
    def check(sent: list[tuple[bytes, Message]], end: bytes) -> None:
        stream = b"".join(noise + encode(message) for noise, message in sent) + end
        assert read_by_core(scripted, stream) == [message for _, message in sent]

    check()


@pytest.mark.parametrize("kind", REPLIES)
def test_the_client_reads_what_the_core_writes(scripted: Core, kind: str) -> None:
    messages = st.lists(
        st.tuples(st.binary(max_size=20), REPLIES[kind].messages([Direction.REPLY, Direction.ERROR])),
        min_size=1,
        max_size=3,
    )

    @THOUSAND
    @given(messages, st.lists(st.integers(0, 2000), max_size=20))
    def check(sent: list[tuple[bytes, Message]], cuts: list[int]) -> None:
        # What a line's noise makes of a frame's beginning, the client finds out and looks behind it.
        stream = b"".join(noise + written_by_core(scripted, message) for noise, message in sent)
        decoder = Decoder()
        heard = [event for piece in pieces(stream, cuts) for event in decoder.feed(piece)]
        heard += decoder.feed(bytes(MSP_PAYLOAD_MAX + 9))  # the end of what noise began
        assert [event for event in heard if isinstance(event, Message)] == [message for _, message in sent]

    check()


@pytest.mark.parametrize("kind", REPLIES)
def test_both_write_the_same_bytes(scripted: Core, kind: str) -> None:
    @THOUSAND
    @given(REPLIES[kind].messages([Direction.REPLY, Direction.ERROR]))
    def check(message: Message) -> None:
        frame = encode(message)
        assert written_by_core(scripted, message) == frame
        assert written_by_core(scripted, message, len(frame)) == frame
        assert written_by_core(scripted, message, len(frame) - 1) == b""

    check()


@pytest.mark.parametrize("kind", KINDS)
def test_neither_reads_a_frame_whose_byte_is_another(scripted: Core, kind: str) -> None:
    """One byte of header, payload or checksum: version 1's sum and version 2's CRC see each single one."""

    @THOUSAND
    @given(KINDS[kind].messages([Direction.REQUEST]), st.integers(min_value=3), st.integers(1, 255))
    def check(message: Message, at: int, change: int) -> None:
        frame = bytearray(encode(message))
        frame[3 + at % (len(frame) - 3)] ^= change
        stream = bytes(frame) + bytes(MSP_PAYLOAD_MAX + 9)
        read = [event for event in Decoder().feed(stream) if isinstance(event, Message)]
        assert message not in read
        assert message not in read_by_core(scripted, stream)

    check()
