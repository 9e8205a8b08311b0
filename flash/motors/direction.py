"""Setting the direction of motors by DShot commands, which each ESC stores."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from neuroflight.flash.link import requests
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.toolchain.contract import DshotCommand, Msp, Refusal
from neuroflight.toolchain.errors import LinkError

DIRECTIONS = {  # as users say them
    "normal": DshotCommand.DIRECTION_NORMAL,
    "reversed": DshotCommand.DIRECTION_REVERSED,
}
BUSY_S = 2.0  # a command takes some 50 ms on the wire; the emulated board runs slower than real time
PAUSE_S = 0.01  # between two tries


def set_direction(
    client: Client,
    motors: Sequence[int],
    direction: DshotCommand,
    *,
    save: bool,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Send the direction to the ESC of each motor, by index; with `save` have each store it.

    No ESC answers: only the motor shows whether it was understood. Raises LinkError.
    """
    for motor in motors:
        _send(client, direction, motor, clock, sleep)
        if save:
            _send(client, DshotCommand.SAVE, motor, clock, sleep)


def _send(
    client: Client,
    command: DshotCommand,
    motor: int,
    clock: Callable[[], float],
    sleep: Callable[[float], None],
) -> None:
    """Send one command to one motor, once the one before it is done."""
    deadline = clock() + BUSY_S
    while True:
        try:
            client.request(Msp.DSHOT_COMMAND, requests.dshot_command(command, motor))
            return
        except RefusedError as error:
            if error.reason is Refusal.INDEX:
                raise LinkError(
                    f"motor got {motor + 1}, and the aircraft has fewer; nothing was sent"
                ) from None
            if error.reason is not Refusal.ORDER or clock() >= deadline:
                raise
        sleep(PAUSE_S)
