"""The list of logs that a firmware keeps; erasing them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.logs.messages import (
    ERRORS,
    STATES,
    LogEntry,
    LogInfo,
    entry_request,
    erase_request,
    erased,
    log_entry,
    log_info,
)
from neuroflight.toolchain.contract import LogError, LogState, Msp, Refusal
from neuroflight.toolchain.errors import LinkError

PAUSE_S = 0.01  # between two polls of a slow operation
STARTING_S = 10.0  # until a card is ready: a second by its specification
ENTRY_S = 10.0  # for one entry: the device searches the log's end
ERASE_S = 1200.0  # for all: 250 ms for each piece of a card, up to 2 s for each 64 KB of a flash chip

Reply = TypeVar("Reply")


@dataclass(frozen=True)
class Wait:
    """Clock and sleep, for waiting while the device is busy."""

    clock: Callable[[], float]  # seconds, never going back
    sleep: Callable[[float], None]


def read_info(client: Client) -> LogInfo:
    """Read the blackbox's state. Raises LinkError for a firmware without one."""
    try:
        return log_info(client.request(Msp.LOG_INFO))
    except RefusedError as error:
        raise refusal_words(client, error) from None


def settled_info(client: Client, wait: Wait) -> LogInfo:
    """Read the blackbox's state once its device is ready, a while after power-up. Raises LinkError."""
    deadline = wait.clock() + STARTING_S
    while wait.clock() < deadline:
        info = read_info(client)
        if info.state is not LogState.STARTING and not info.looking:
            return info
        wait.sleep(PAUSE_S)
    return read_info(client)


def read_entries(client: Client, info: LogInfo, wait: Wait) -> list[LogEntry]:
    """Read the list of logs. Raises LinkError with the reason if they cannot be read."""
    check_readable(client, info)
    return [_read_entry(client, index, wait) for index in range(info.logs)]


def _read_entry(client: Client, index: int, wait: Wait) -> LogEntry:
    return _patiently(client, lambda: _entry(client, index), ENTRY_S, wait, f"log {index + 1}")


def check_readable(client: Client, info: LogInfo) -> None:
    """Raise LinkError if logs cannot be read now."""
    if info.logging:
        raise LinkError(
            f"{client.name}: a log is being written, expected none; disarm, or end the mode BLACKBOX, first"
        )
    if info.state is LogState.STARTING:
        raise LinkError(
            f"{client.name}: the device is still being looked at, or erased, expected it ready; try again"
        )
    if info.logs == 0 and info.error is not LogError.NONE:
        raise LinkError(f"{client.name}: no log can be read: {ERRORS[info.error]}")


def erase(client: Client, wait: Wait) -> None:
    """Make all files empty again. Raises LinkError."""

    def ask() -> bool | None:
        return erased(client.request(Msp.LOG_ERASE, erase_request())) or None

    _patiently(client, ask, ERASE_S, wait, "erasing")


def _entry(client: Client, index: int) -> LogEntry | None:
    return log_entry(client.request(Msp.LOG_ENTRY, entry_request(index)))


def _patiently(
    client: Client, ask: Callable[[], Reply | None], patience: float, wait: Wait, what: str
) -> Reply:
    """Repeat `ask` until it returns something other than None. Raises LinkError after `patience`."""
    deadline = wait.clock() + patience
    while True:
        try:
            told = ask()
        except RefusedError as error:
            raise refusal_words(client, error) from None
        if told is not None:
            return told
        if wait.clock() > deadline:
            raise LinkError(
                f"{client.name}: {what} takes the device longer than {patience:g} s; look with `log list`"
            )
        wait.sleep(PAUSE_S)


def refusal_words(client: Client, error: RefusedError) -> LinkError:
    """Return the error for a refused request about logs, with how to mend it."""
    words = {
        Refusal.ARMED: "the motors are armed or under test: disarm, then try again",
        Refusal.ORDER: "a log is being written, expected none: disarm, or end the mode BLACKBOX, first",
        Refusal.ABSENT: "the firmware keeps no logs here: a log of UART3 goes to the recorder there, and the "
        "SD card's need `blackbox_device=card`",
        Refusal.INDEX: "there is no such log any more: list them again",
        Refusal.LOG: "the device that keeps the logs failed: `neuroflight board logs list` says why",
        None: "this firmware knows no logs, it is older than this tool: `neuroflight board flash` brings one",
    }
    told = words.get(error.reason)
    return error if told is None else LinkError(f"{client.name}: {told}")


def state_words(info: LogInfo) -> str:
    """Describe the state of the log device and its error."""
    told = STATES[info.state]
    return told if info.error is LogError.NONE else f"{told}; {ERRORS[info.error]}"
