"""An open motor test: opens it, gives values often enough, and stops the motors however it is left.

Three things stop the motors, each without the others: leaving the `with` block; the firmware, which ends a
test that got no values for MOTOR_TEST_TIMEOUT_MS of its own time, when this program or the line is gone; and
the arm switch or a change of the receiver's link, which end it in the firmware as well.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from neuroflight.flash.link import requests
from neuroflight.flash.link.client import Client, NoAnswerError, RefusedError
from neuroflight.toolchain.contract import (
    CHANNEL_MAX_US,
    CHANNEL_MIN_US,
    DSHOT_STOP,
    MOTOR_TEST_MAGIC,
    MOTOR_TEST_MAX,
    MOTOR_TEST_SUM_MAX,
    MOTOR_TEST_TIMEOUT_MS,
    Msp,
    Refusal,
)
from neuroflight.toolchain.errors import LinkError

LIMIT_DEFAULT = 0.15  # motor fraction: turns every motor, moves no clamped aircraft
REFRESH_S = 0.05  # between two values: the firmware stops the motors after ten lost ones
STOP_TIMEOUT_S, STOP_RETRIES = 0.3, 5  # of the stop request, which may be repeated
CLOSED = 0  # as the magic of MOTOR_TEST


class MotorTest:
    """A motor test of a firmware: open inside its `with` block, all motors stopped at first."""

    def __init__(self, client: Client, motor_count: int, limit: float = LIMIT_DEFAULT) -> None:
        """limit: motor fraction that no motor may exceed, as checked by `check_limit`."""
        check_limit(limit)
        self._client, self._motor_count, self._limit = client, motor_count, limit

    def __enter__(self) -> MotorTest:
        try:
            self._client.request(Msp.MOTOR_TEST, requests.motor_test(MOTOR_TEST_MAGIC))
        except RefusedError as error:
            if error.reason is Refusal.ARMED:
                raise RefusedError(
                    f"{self._client.name}: the firmware opens no motor test: it is armed, not ready, or a "
                    "DShot command is under way; no motor turned; see what `neuroflight board monitor` tells",
                    error.reason,
                ) from None
            raise
        except BaseException:  # the test may be open nevertheless
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def turn(self, fractions: Sequence[float]) -> None:
        """Turn the motors at these fractions, motor order, until the next call; 0 stops one.

        Raises LinkError above the limit, before anything is sent, and where the test is over.
        """
        if len(fractions) != self._motor_count:
            raise ValueError(f"{len(fractions)} fractions, expected {self._motor_count}")
        for motor, fraction in enumerate(fractions, 1):
            check_fraction(f"motor {motor}", fraction, self._limit)
        check_sum(fractions)
        span = CHANNEL_MAX_US - CHANNEL_MIN_US
        values_us = [CHANNEL_MIN_US + round(span * fraction) for fraction in fractions]
        try:
            # Sending the same values twice is harmless, so a request whose reply is lost is repeated.
            self._client.request(Msp.SET_MOTOR, requests.set_motor(values_us), retries=1)
        except RefusedError as error:
            if error.reason not in (Refusal.ORDER, Refusal.ARMED):
                raise
            raise RefusedError(
                f"{self._client.name}: the firmware has ended the motor test and stopped the motors: the arm "
                "switch was moved, the receiver came or went, another program closed it, or nothing came for "
                f"{MOTOR_TEST_TIMEOUT_MS} ms",
                error.reason,
            ) from None
        except NoAnswerError as error:
            raise NoAnswerError(
                f"{error}; the firmware stops the motors by itself after {MOTOR_TEST_TIMEOUT_MS} ms"
            ) from None

    def _close(self) -> None:
        """Stop the motors and close the test; if the line is lost, the firmware does it by itself."""
        with contextlib.suppress(LinkError):
            close_test(self._client)


def close_test(client: Client) -> None:
    """Stop the motors of whatever test is open, and close it. Raises LinkError; RefusedError while armed."""
    client.request(Msp.MOTOR_TEST, requests.motor_test(CLOSED), timeout=STOP_TIMEOUT_S, retries=STOP_RETRIES)


def end_commands(client: Client) -> None:
    """End a DShot command that is under way. Raises LinkError."""
    stop = requests.dshot_command(DSHOT_STOP)
    client.request(Msp.DSHOT_COMMAND, stop, timeout=STOP_TIMEOUT_S, retries=STOP_RETRIES)


def check_limit(limit: float) -> None:
    """Raise LinkError for a limit that the firmware would not turn a motor at."""
    if not 0.0 < limit <= MOTOR_TEST_MAX:
        raise LinkError(
            f"--limit got {limit:g}, expected above 0 and at most {MOTOR_TEST_MAX:g}, "
            "where the firmware's own limit is"
        )


def check_fraction(what: str, fraction: float, limit: float) -> None:
    """Raise LinkError for a motor fraction above the limit, below 0 or NaN."""
    if not 0.0 <= fraction <= limit:
        mend = f"; give --limit, up to {MOTOR_TEST_MAX:g}, if that is meant" if fraction > limit else ""
        raise LinkError(f"{what} got {fraction:g}, expected a motor fraction of 0 to {limit:g}{mend}")


def check_sum(fractions: Sequence[float]) -> None:
    """Raise LinkError for more than the firmware turns all motors at together."""
    if sum(fractions) > MOTOR_TEST_SUM_MAX:
        raise LinkError(
            f"all motors together got {sum(fractions):g}, expected at most {MOTOR_TEST_SUM_MAX:g}: the "
            "firmware lets no test lift an aircraft; turn fewer motors, or all of them slower"
        )
