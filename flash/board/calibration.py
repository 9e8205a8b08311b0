"""Has the gyro's bias measured anew, and waits until it is known."""

from __future__ import annotations

import time
from collections.abc import Callable

from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.toolchain.contract import CALIBRATION_MS, Msp
from neuroflight.toolchain.errors import LinkError

WAIT_S = 10.0  # a still gyro takes CALIBRATION_MS
PAUSE_S = 0.05  # between two looks
BEGIN_S = 1.0  # until the calibration has begun: earlier answers may still give the old bias
UNCALIBRATED = "GYRO_NOT_CALIBRATED"


def calibrate(
    client: Client,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Ask for it and wait for its end. Raises LinkError when the firmware refuses or the gyro never rests."""
    client.request(Msp.CALIBRATE)
    asked = clock()
    begun = False
    while True:
        safety = records.safety(client.request(Msp.SAFETY))
        busy = UNCALIBRATED in messages.arming_reasons(safety.arming_flags)
        begun |= busy
        if not busy and (begun or clock() - asked >= BEGIN_S):
            return
        if clock() - asked >= WAIT_S:
            raise LinkError(
                f"{client.name}: the gyro is not calibrated after {WAIT_S:g} s, expected it within "
                f"{CALIBRATION_MS} ms of rest; lay the aircraft down, keep it still, and ask again"
            )
        sleep(PAUSE_S)
