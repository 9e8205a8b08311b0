"""One motor on a dynamometer, up to its full speed; it turns only while values come.

The firmware ends the test by itself: without fresh values for MOTOR_TEST_TIMEOUT_MS, by the arm switch, by
any change of the receiver's link. Up to MOTOR_TEST_MAX this is the motor test of everybody; above it the test
is opened by another number, so that no program gets there by mistake.
"""

from __future__ import annotations

from types import TracebackType

from neuroflight.flash.board.hints import words
from neuroflight.flash.board.info import check_ours
from neuroflight.flash.link import messages, records, requests
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.motors.readiness import UNSENT, check_ready
from neuroflight.flash.motors.session import close_test
from neuroflight.toolchain.contract import (
    CHANNEL_MAX_US,
    CHANNEL_MIN_US,
    MOTOR_BENCH_MAGIC,
    MOTOR_BENCH_MAX,
    MOTOR_TEST_MAGIC,
    MOTOR_TEST_MAX,
    MOTOR_TEST_TIMEOUT_MS,
    ArmingReason,
    FlightState,
    Msp,
)
from neuroflight.toolchain.errors import LinkError, NeuroflightError

REPLY_S = 0.2  # a board answers within some milliseconds; two of these are less than the firmware's time-out
SPAN_US = CHANNEL_MAX_US - CHANNEL_MIN_US


class MotorBench:
    """A motor that turns between entering and leaving; leaving stops it, however it is left."""

    def __init__(self, client: Client, motor: int, most: float = MOTOR_TEST_MAX) -> None:
        """motor: its index, from 0. most: largest fraction that will be asked for, 0..1.

        Raises LinkError where the firmware is another's, has no such motor, or may turn none (readiness.py).
        """
        if not 0.0 < most <= MOTOR_BENCH_MAX:
            raise ValueError(f"most {most}, expected above 0 to {MOTOR_BENCH_MAX:g}")
        self._client, self._motor, self._most = client, motor, most
        check_ours(client, UNSENT)
        count = messages.policy_info(client.request(Msp.POLICY_INFO)).action_count
        if not 0 <= motor < count:
            raise LinkError(
                f"{client.name}: motor {motor + 1}, expected 1 to {count}; the firmware has no other"
            )
        check_ready(client)

    def __enter__(self) -> MotorBench:
        magic = MOTOR_TEST_MAGIC if self._most <= MOTOR_TEST_MAX else MOTOR_BENCH_MAGIC
        try:
            self._open(magic)
        except BaseException as error:  # the test may be open nevertheless
            self.__exit__(type(error), error, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._stopped():
            before = f"{error}; " if isinstance(error, NeuroflightError) else ""
            raise LinkError(
                f"{before}{self._client.name}: the board did not confirm that the motor stops, expected a "
                f"reply; it stops it by itself {MOTOR_TEST_TIMEOUT_MS} ms after the last value: look before "
                f"you go near"
            ) from error

    def give(self, throttle: float) -> float:
        """Turn the motor at this fraction, 0..most, for MOTOR_TEST_TIMEOUT_MS at most; return it as rounded.

        Raises LinkError when the firmware refuses or nobody answers.
        """
        if not 0.0 <= throttle <= self._most:
            raise ValueError(f"throttle {throttle}, expected 0 to {self._most:g}")
        us = CHANNEL_MIN_US + round(SPAN_US * throttle)
        values = [CHANNEL_MIN_US] * self._motor + [us]
        self._client.request(Msp.SET_MOTOR, requests.set_motor(values), REPLY_S)
        return (us - CHANNEL_MIN_US) / SPAN_US

    def check(self) -> None:
        """Raise LinkError unless the firmware is disarmed and its motor test open."""
        safety = records.safety(self._client.request(Msp.SAFETY, timeout=REPLY_S, retries=1))
        if safety.state is not FlightState.DISARMED:
            raise LinkError(
                f"{self._client.name}: the firmware is {words(safety.state.name)}, expected disarmed; switch "
                "off and wait until it is ready"
            )
        if not safety.arming_flags >> ArmingReason.MOTOR_TEST & 1:
            raise LinkError(
                f"{self._client.name}: the firmware has ended the motor test, expected it open; was the arm "
                "switch on, or did the receiver's link change?"
            )

    def _open(self, magic: int) -> None:
        try:
            self._client.request(Msp.MOTOR_TEST, requests.motor_test(magic), REPLY_S)
        except RefusedError as error:
            mend = f"; below {MOTOR_TEST_MAX:.0%} throttle an older firmware turns it too"
            raise RefusedError(f"{error}{mend if magic == MOTOR_BENCH_MAGIC else ''}") from error

    def _stopped(self) -> bool:
        """Stop the motor and close the test. Returns whether the firmware confirmed."""
        try:
            close_test(self._client)
        except LinkError:
            return False
        return True
