"""pymsp, unchanged: a second stranger's idea of MSP frames finds in our answers what our own client finds."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
from pymsp import MSPStreamProcessor, MSPv1, MSPv2

from neuroflight.flash.link import messages
from neuroflight.flash.link.msp import Decoder, Direction, Message, Version, encode
from neuroflight.toolchain.contract import Msp
from tests.peers.yamspy_client import WAIT_S, readers

V1_MAX = 254
# What does not change while nobody flies, whatever the time.
STEADY = {Msp.API_VERSION, Msp.FC_VERSION, Msp.BOARD_INFO, Msp.BUILD_INFO, Msp.UID, Msp.NAME}
TIMED = {Msp.TASKS}  # what it says changes by the asking
NEED_PAYLOAD = {Msp.SETTING_INFO, Msp.SETTING_GET, Msp.POLICY_SLOT_BEGIN}
ASKED = sorted(({*readers().values()} | set(messages.DECODERS)) - TIMED - NEED_PAYLOAD)


def exchange(line: Any, request: bytes) -> Iterator[bytes]:
    """Send it; hand out what comes, in pieces."""
    line.write(request)
    end = time.monotonic() + WAIT_S
    while time.monotonic() < end:
        yield line.read(max(1, line.in_waiting))


def ours(line: Any, version: Version, command: int) -> Message:
    """What our own codec makes of the answer."""
    decoder = Decoder()
    for piece in exchange(line, encode(Message(version, Direction.REQUEST, command))):
        for event in decoder.feed(piece):
            assert isinstance(event, Message)
            return event
    raise AssertionError(f"no answer to {command}")


def theirs(line: Any, version: Version, command: int) -> tuple[int, int, bytes]:
    """What pymsp makes of it: version, command, payload."""
    stream = MSPStreamProcessor()
    codec = MSPv1() if version is Version.V1 else MSPv2()
    for piece in exchange(line, codec.pack(command)):
        for frame in stream.push_bytes(piece):
            return frame.protocol_version, frame.message_id, frame.payload
    raise AssertionError(f"no answer to {command}")


@pytest.mark.parametrize("version", Version, ids=str)
def test_pymsp_reads_what_our_client_reads_when_both_ask(line: Any, version: Version) -> None:
    read = 0
    for command in ASKED:
        if version is Version.V1 and command > V1_MAX:
            continue
        said = ours(line, version, command)
        if said.direction is Direction.ERROR:  # pymsp knows no refusals
            continue
        told = theirs(line, version, command)
        assert told[:2] == (int(version), command)
        if command in STEADY:
            assert told[2] == said.payload
        assert len(told[2]) == len(said.payload)
        read += 1
    assert read >= 15


def test_pymsp_reads_every_answer_when_they_come_in_one_stream(line: Any) -> None:
    """Requests of both versions back to back: as many frames, in order."""
    asked = [command for command in sorted(STEADY) for _ in range(3)]
    stream = MSPStreamProcessor()
    heard: list[int] = []
    line.write(
        b"".join((MSPv1() if at % 2 else MSPv2()).pack(int(command)) for at, command in enumerate(asked))
    )
    end = time.monotonic() + WAIT_S
    while len(heard) < len(asked) and time.monotonic() < end:
        heard += [frame.message_id for frame in stream.push_bytes(line.read(max(1, line.in_waiting)))]
    assert heard == asked
