"""Restart of a firmware, and of the boot loader in the chip's ROM."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from neuroflight.flash.board.info import is_ours
from neuroflight.flash.link import records
from neuroflight.flash.link.client import Client, NoAnswerError
from neuroflight.flash.link.transport import Transport
from neuroflight.toolchain.contract import Msp, Reboot
from neuroflight.toolchain.errors import LinkError

WAIT_S = 15.0  # a board is back within a second, the emulated one within some
GOING_S = 5.0  # for a firmware without a boot counter to fall silent
ASK_S = 0.5  # for one answer
LOST_S = 1.0  # after which a firmware that got the request has restarted
PAUSE_S = 0.1  # between two attempts on a line that is gone


def restart(
    client: Client,
    reopen: Callable[[], Transport],
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Client:
    """Restart the firmware and wait for its answer; `client` is closed if that fails.

    reopen: opens the line again where it went with the firmware. Returns a client of the new start. Raises
    LinkError when it refuses, and when it does not come back.
    """
    try:
        ours, answered = is_ours(client), False
        before = records.faults(client.request(Msp.FAULTS)).boots if ours else None
        with contextlib.suppress(NoAnswerError):  # it may restart before its reply is sent
            client.request(Msp.REBOOT)
            answered = True
        if before is None and answered:
            client = _gone(client, reopen, clock, sleep)
        deadline = clock() + WAIT_S
        asked = clock()
        while clock() < deadline:
            try:
                if _has_started(client, before):
                    return client
                if not answered and clock() - asked > LOST_S:  # the request or its reply was lost
                    asked = clock()
                    client.request(Msp.REBOOT, timeout=ASK_S)
                    answered = True
            except NoAnswerError:
                continue
            except LinkError:  # the line is gone
                client.close()
                client = opened(client, reopen, sleep)
    except BaseException:
        client.close()
        raise
    client.close()
    raise LinkError(
        f"{client.name}: the firmware took the request and did not answer again within {WAIT_S:g} s; "
        "a firmware that is a program ends there: start it again; a board may need its plug pulled"
    )


def enter_rom(client: Client) -> None:
    """Start the boot loader in the chip's ROM. Nothing may be written to the line before `flash.rom` does,
    because the ROM sets its speed by the first byte it receives.

    Raises LinkError when the firmware refuses, as the host program does, or does not answer.
    """
    client.request(Msp.REBOOT, bytes([Reboot.ROM]))


def show_card(client: Client) -> None:
    """Have the firmware start anew and show its SD card as a disk by USB until that is ejected or unplugged.

    Raises LinkError when it refuses: while armed or on probation, and without a USB cable.
    """
    client.request(Msp.REBOOT, bytes([Reboot.CARD]))


def _gone(
    client: Client,
    reopen: Callable[[], Transport],
    clock: Callable[[], float],
    sleep: Callable[[float], None],
) -> Client:
    """Wait until a firmware that does not count its boots is silent, or its line is gone: until then it
    answers as the start that was asked to end. Returns a client, of the line opened again where it had gone.
    Raises LinkError."""
    deadline = clock() + GOING_S
    while clock() < deadline:
        try:
            client.request(Msp.API_VERSION, timeout=ASK_S, retries=0)
            sleep(PAUSE_S)
        except NoAnswerError:
            return client
        except LinkError:
            client.close()
            return opened(client, reopen, sleep)
    raise LinkError(
        f"{client.name}: the firmware took the request and answers without a break for {GOING_S:g} s; "
        "it did not start anew, or too fast to be seen: look at its state"
    )


def _has_started(client: Client, before: int | None) -> bool:
    """Return True if the firmware answers after a new start."""
    if before is None:
        return bool(client.request(Msp.API_VERSION, timeout=ASK_S, retries=0))
    return records.faults(client.request(Msp.FAULTS, timeout=ASK_S, retries=0)).boots != before


def opened(client: Client, reopen: Callable[[], Transport], sleep: Callable[[float], None]) -> Client:
    """Return a client on the line opened again, or the closed one if it does not open."""
    sleep(PAUSE_S)
    try:
        return Client(reopen())
    except LinkError:
        return client
