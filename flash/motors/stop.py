"""Stopping motors that any test turns."""

from __future__ import annotations

import time
from collections.abc import Callable

from neuroflight.flash.board.info import check_ours
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.motors.readiness import UNSENT, await_standing
from neuroflight.flash.motors.session import close_test, end_commands
from neuroflight.toolchain.contract import Refusal
from neuroflight.toolchain.errors import LinkError


def stop(
    client: Client,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Stop the motors at once, close the test, end DShot commands; then check that the motors are stopped.

    Raises LinkError when they do not, and for an armed board, whose motors only its arm switch stops.
    """
    try:
        close_test(client)  # first, before anything is asked
        end_commands(client)
    except RefusedError as error:
        if error.reason is Refusal.ARMED:
            raise LinkError(
                f"{client.name}: the board is armed, which no motor test is: nothing was stopped; "
                "put the arm switch off"
            ) from None
        check_ours(client, UNSENT)
        raise
    await_standing(client, clock, sleep)
