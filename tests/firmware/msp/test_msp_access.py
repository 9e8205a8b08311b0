"""When each request is carried out, and why it is refused, is what the contract says of it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from neuroflight.flash.link.msp import Direction
from neuroflight.toolchain.contract import Msp, Refusal
from neuroflight.toolchain.contract.msp_messages import access_of
from neuroflight.toolchain.contract.msp_table import Access, MspWhen
from tests.firmware.msp.test_msp_commands import GOOD, STORED, Server, server

__all__ = ["server"]  # the fixture
SIZES = (*range(45), 64, 100)


def payloads(message: Msp) -> Iterator[bytes]:
    """Of each length: zeros, bytes that count up, ones; and what some messages want to see."""
    for size in SIZES:
        yield bytes(size)
        yield (bytes(range(1, 256)) * 2)[:size]
        yield b"\xff" * size
    yield from (table[message] for table in (GOOD, STORED) if message in table)


def access(message: Msp, payload: bytes) -> Access:
    return (message.row.acknowledges if payload else None) or access_of(message)


@pytest.mark.parametrize("message", Msp, ids=lambda message: message.name)
def test_a_request_is_refused_while_armed_where_the_contract_says_so(server: Server, message: Msp) -> None:
    server.status.trace.armed = 1
    refused: dict[bool, set[bytes]] = {True: set(), False: set()}  # by whether it is carried out at any time
    for payload in payloads(message):
        answer = server.ask(message, payload)
        reason = answer.payload[:1] if answer.direction is Direction.ERROR else b""
        refused[access(message, payload).when is MspWhen.ALWAYS].add(reason)
        assert ("storing", True) not in [call[:2] for call in server.calls]
    armed = bytes([Refusal.ARMED])
    assert armed not in refused[True]
    if refused[False] and message is not Msp.STREAM_SAMPLE:
        assert armed in refused[False]
        assert b"" not in refused[False]  # nothing is carried out, nothing is unknown


@pytest.mark.parametrize("message", Msp, ids=lambda message: message.name)
def test_nothing_arms_meanwhile_where_the_contract_says_so(server: Server, message: Msp) -> None:
    server.answers["storing"] = int(Refusal.ARMED)  # armed since the status was told
    for payload in payloads(message):
        server.calls.clear()
        before = server.chip.operations
        server.ask(message, payload)
        stores = access(message, payload).when is MspWhen.STORING
        assert stores or ("storing", True, before) not in server.calls
        assert server.chip.operations == before
    if access(message, payload).when is MspWhen.STORING or message is Msp.FAULTS:
        server.calls.clear()
        assert server.refusal(message, STORED[message]) == (Refusal.ARMED, 0)
        assert ("storing", True, before) in server.calls


@pytest.mark.parametrize("message", Msp, ids=lambda message: message.name)
def test_a_request_is_refused_for_no_other_reason_than_the_contract_names(
    server: Server, message: Msp
) -> None:
    for payload in payloads(message):
        answer = server.ask(message, payload)
        if answer.direction is Direction.ERROR and answer.payload:
            known = access(message, payload)
            assert Refusal(answer.payload[0]) in {*known.refusals, Refusal.ARMED}, payload
            if known.when is MspWhen.ALWAYS:
                assert Refusal(answer.payload[0]) in known.refusals
