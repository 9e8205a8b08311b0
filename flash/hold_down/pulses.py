"""Pulses of one motor after the other on an aircraft that is held, and the gyro beside them.

What stops the motors: all that ends a motor test (session.py), and here an aircraft that turns too fast or
too far to be held, or samples that stay away. The time of pulses is the firmware's own, of its stream.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from neuroflight.flash.hold_down.reaction import Array, Record
from neuroflight.flash.link import messages
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.monitoring.stream import Sample, Stream, decode_sample
from neuroflight.flash.motors.session import MotorTest
from neuroflight.toolchain.contract import DSHOT_MIN, DSHOT_SPAN, Msp
from neuroflight.toolchain.errors import LinkError

RATE_HZ = 100  # of the samples: 7 kB/s of the 11.5 that a line at 115200 baud carries
SILENCE_S = 0.2  # without a sample the motor is stopped
RATE_MAX_DEG_S, TURN_MAX_DEG = 150.0, 15.0  # of an aircraft that is held
REFRESH_S = 0.1  # between two values
IDLE = 0.05  # motor fraction between two pulses: most ESCs need longer to start than to speed up
START_S = 0.6  # of the idle before the first pulse
PULSE_S = 0.2
PAUSE_S = 0.25, 0.5  # between two pulses, at least and at most


@dataclass
class _Told:
    """The samples so far, while one motor turns."""

    times: list[float] = field(default_factory=list)  # [s], of the firmware
    rates: list[Array] = field(default_factory=list)  # (3,) [rad/s]
    values: list[int] = field(default_factory=list)  # DShot, of the motor
    turned: Array = field(default_factory=lambda: np.zeros(3))  # [rad] since the motor's value changed


class Pulses:
    """An open motor test beside a stream of samples; leaving it stops the motors, however it is left."""

    def __init__(
        self,
        client: Client,
        motor_count: int,
        control_rate_hz: int,
        fraction: float,
        rng: np.random.Generator,
    ) -> None:
        """fraction: of a pulse, above IDLE. rng: of the pauses between two.

        Raises LinkError where the firmware gives no motor so much.
        """
        if not fraction > IDLE:
            raise LinkError(
                f"--fraction got {fraction:g}, expected more than the idle between pulses, {IDLE:g}"
            )
        self._client, self._control_hz, self._fraction = client, control_rate_hz, fraction
        self._count, self._rng = motor_count, rng
        self._test = MotorTest(client, motor_count, fraction)
        self._stream = Stream(client, RATE_HZ, control_rate_hz)

    def __enter__(self) -> Pulses:
        self._stream.begin()
        try:
            self._test.__enter__()
        except BaseException:
            self._stream.stop()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._test.__exit__(*error)  # first
        self._stream.stop()

    def record(self, motor: int, count: int) -> Record:
        """Give so many pulses to a motor; return what the gyro told, about the firmware's body axes.

        Raises LinkError, with the motors stopped at once, where the aircraft is not held, no sample comes, or
        the test was ended.
        """
        told = _Told()
        self._give(told, motor, IDLE, START_S)
        for _ in range(count):
            self._give(told, motor, self._fraction, PULSE_S)
            rpm = self._rpm(motor)
            # By chance, or a mount that swings would meet all pulses in the same phase.
            self._give(told, motor, IDLE, float(self._rng.uniform(*PAUSE_S)))
        self._test.turn([0.0] * self._count)
        level = np.array(told.values) >= (_dshot(IDLE) + _dshot(self._fraction)) / 2
        return Record(np.array(told.times), np.array(told.rates), level.astype(float), rpm)

    def _give(self, told: _Told, motor: int, fraction: float, seconds: float) -> None:
        """Turn the motor at `fraction` for so long, by the firmware's time, once it does."""
        values = [0.0] * self._count
        values[motor] = fraction
        self._test.turn(values)
        begin, refreshed = None, told.times[-1] if told.times else 0.0
        told.turned[:] = 0.0
        for payload in self._stream.payloads(silence_s=SILENCE_S):
            sample = decode_sample(payload)
            now = self._take(told, motor, sample)
            if begin is None and abs(sample.dshot[motor] - _dshot(fraction)) <= 1:
                begin = now
            if begin is not None and now - begin >= seconds:
                return
            if now - refreshed >= REFRESH_S:
                self._test.turn(values)
                refreshed = now

    def _take(self, told: _Told, motor: int, sample: Sample) -> float:
        """Keep a sample; return its time [s]. Raises LinkError where the aircraft is not held."""
        now, rate = sample.step / self._control_hz, np.array(sample.gyro)
        told.turned += rate * (now - told.times[-1] if told.times else 0.0)
        told.times.append(now)
        told.rates.append(rate)
        told.values.append(sample.dshot[motor])
        fast, far = np.degrees(np.abs(rate).max()), np.degrees(np.abs(told.turned).max())
        if fast > RATE_MAX_DEG_S or far > TURN_MAX_DEG:
            self._test.__exit__()
            raise LinkError(
                f"motor {motor + 1}: the aircraft turned by {far:.0f} degrees and at {fast:.0f} deg/s, "
                f"expected at most {TURN_MAX_DEG:g} and {RATE_MAX_DEG_S:g} of one that is held; the motors "
                "were stopped: tie it down better, or lower --fraction"
            )
        return now

    def _rpm(self, motor: int) -> float | None:
        """Return what the motor's ESC tells of its speed; None: nothing."""
        try:
            told = messages.motor_telemetry(self._client.request(Msp.MOTOR_TELEMETRY))
        except RefusedError:
            return None
        return float(told[motor].speed_rpm) if motor < len(told) and told[motor].errors < 1.0 else None


def _dshot(fraction: float) -> int:
    return DSHOT_MIN + int(DSHOT_SPAN * fraction + 0.5)
