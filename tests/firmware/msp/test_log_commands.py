"""Logs over MSP: what the blackbox's device tells and gives, asked again, refused, failed."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from neuroflight.flash.link import layouts
from neuroflight.toolchain.contract import LOG_ERASE_MAGIC, LogDevice, LogError, LogState, Msp, Refusal
from neuroflight.toolchain.contract.msp_layouts import Direction
from neuroflight.toolchain.contract.msp_messages import layout_of
from tests.firmware.msp.test_msp_commands import GOOD, Server, server

__all__ = ["server"]  # the fixture
KEPT = (Msp.LOG_ENTRY, Msp.LOG_READ, Msp.LOG_ERASE)


def told(s: Server, command: Msp, payload: bytes = b"") -> dict[str, Any]:
    """The reply, read by its layout."""
    layout = layout_of(command, Direction.REPLY)
    assert layout is not None
    return dict(layouts.decode(layout, s.reply(command, payload), whole=True))


def read(index: int, offset: int, count: int) -> bytes:
    return struct.pack("<HIH", index, offset, count)


def test_the_device_is_told_as_it_is_when_asked_for(server: Server) -> None:
    server.log.state, server.log.error = LogState.FULL, LogError.WRITE
    info = told(server, Msp.LOG_INFO)
    assert (info["device"], info["state"], info["error"]) == (LogDevice.CARD, LogState.FULL, LogError.WRITE)
    assert (info["logs"], info["empty"], info["capacity"], info["free"]) == (2, 7, 0x90000, 0x80000)
    assert (info["flags"], info["frames"], info["dropped"], info["bytes"]) == (0, 0, 0, 0)


def test_a_log_is_read_to_its_end_when_asked_piece_by_piece(server: Server) -> None:
    entry = told(server, Msp.LOG_ENTRY, struct.pack("<H", 1))
    assert (entry["log"], entry["state"], entry["name"], entry["bytes"]) == (1, 0, "LOG00002.BBL", 512)
    whole = b""
    while piece := told(server, Msp.LOG_READ, read(1, len(whole), 0xFFFF)):
        assert (piece["log"], piece["offset"], piece["state"]) == (1, len(whole), 0)
        if not piece["data"]:
            break
        whole += piece["data"]
    assert whole == server.log.logs[1]
    assert told(server, Msp.LOG_READ, read(0, 4, 2))["data"] == b"lo"


def test_it_is_asked_again_when_the_device_is_not_ready(server: Server) -> None:
    server.log.answer = server.log.LATER
    assert told(server, Msp.LOG_ENTRY, GOOD[Msp.LOG_ENTRY]) == {"log": 0, "state": 1, "name": "", "bytes": 0}
    assert told(server, Msp.LOG_READ, read(1, 8, 16)) == {"log": 1, "offset": 8, "state": 1, "data": b""}
    assert told(server, Msp.LOG_ERASE, GOOD[Msp.LOG_ERASE]) == {"state": 1}
    assert server.log.asked == [("entry", 0), ("read", 1, 8, 16), ("erase",)]


def test_the_logs_are_gone_when_erased_and_erasing_again_is_no_mistake(server: Server) -> None:
    for _ in range(2):
        assert told(server, Msp.LOG_ERASE, GOOD[Msp.LOG_ERASE]) == {"state": 0}
        assert told(server, Msp.LOG_INFO)["logs"] == 0


@pytest.mark.parametrize("magic", [0, LOG_ERASE_MAGIC ^ 1, LOG_ERASE_MAGIC ^ 1 << 31])
def test_nothing_is_erased_when_the_magic_is_another(server: Server, magic: int) -> None:
    assert server.refusal(Msp.LOG_ERASE, struct.pack("<I", magic)) == (Refusal.PAYLOAD, 0)
    assert server.log.asked == []


@pytest.mark.parametrize("command", KEPT)
@pytest.mark.parametrize("state", [LogState.LOGGING, LogState.ENDING])
def test_the_device_is_left_alone_while_a_log_is_written(
    server: Server, command: Msp, state: LogState
) -> None:
    server.log.state = state
    assert server.refusal(command, GOOD[command]) == (Refusal.ORDER, 0)
    assert server.log.asked == []


def test_a_log_is_refused_when_there_is_none_of_that_index(server: Server) -> None:
    assert server.refusal(Msp.LOG_ENTRY, struct.pack("<H", 2)) == (Refusal.INDEX, 0)
    assert server.refusal(Msp.LOG_READ, read(0xFFFF, 0, 1)) == (Refusal.INDEX, 0)
    assert server.log.asked == []


@pytest.mark.parametrize("command", KEPT)
def test_the_devices_error_is_told_when_it_fails(server: Server, command: Msp) -> None:
    server.log.answer, server.log.error = server.log.FAILED, LogError.READ
    assert server.refusal(command, GOOD[command]) == (Refusal.LOG, LogError.READ)


@pytest.mark.parametrize("command", KEPT)
def test_logs_are_absent_when_the_device_keeps_none(server: Server, command: Msp) -> None:
    null = server.core.ffi.NULL
    server.log.device.entry = server.log.device.read = server.log.device.erase = null
    assert server.refusal(command, GOOD[command]) == (Refusal.ABSENT, 0)
    server.keep_logs(null)
    assert server.refusal(command, GOOD[command]) == (Refusal.ABSENT, 0)
    info = told(server, Msp.LOG_INFO)
    assert (info["device"], info["state"]) == (LogDevice.CARD, LogState.ABSENT)


# --- As the ecosystem tells a card ----------------------------------------------------------------
CARD_STATES = {  # and errors of this device; the ecosystem's: 0 no card, 1 fault, 2 starting, 4 ready
    (LogState.ABSENT, LogError.NONE): (0, 0),
    (LogState.STARTING, LogError.NONE): (2, 0),
    (LogState.READY, LogError.NONE): (4, 0),
    (LogState.READY, LogError.WRITE): (4, 1),
    (LogState.LOGGING, LogError.NONE): (4, 0),
    (LogState.ENDING, LogError.NONE): (4, 0),
    (LogState.FULL, LogError.NONE): (4, 0),
    (LogState.FAULT, LogError.NO_CARD): (0, 1),
    (LogState.FAULT, LogError.CARD): (1, 1),
    (LogState.FAULT, LogError.FILE_SYSTEM): (1, 3),
    (LogState.FAULT, LogError.NO_FILE): (1, 1),
    (LogState.FAULT, LogError.FRAGMENTED): (1, 1),
}


@pytest.mark.parametrize(("state", "error"), CARD_STATES)
def test_the_card_is_told_to_the_ecosystem_as_it_is(server: Server, state: LogState, error: LogError) -> None:
    server.log.state, server.log.error = state, error
    card = told(server, Msp.SDCARD_SUMMARY)
    assert (card["state"], card["last_error"]) == CARD_STATES[state, error]
    assert (card["flags"], card["free"], card["total"]) == (1, 0x80000, 0x90000)


@pytest.mark.parametrize("device", [LogDevice.NONE, LogDevice.SERIAL])
def test_there_is_no_card_when_the_log_goes_elsewhere(server: Server, device: LogDevice) -> None:
    server.settings.blackbox_device = device
    card = told(server, Msp.SDCARD_SUMMARY)
    assert card == {"flags": 1, "state": 0, "last_error": 0, "free": 0, "total": 0}


def test_there_is_no_flash_for_logs(server: Server) -> None:
    assert not any(told(server, Msp.DATAFLASH_SUMMARY).values())
